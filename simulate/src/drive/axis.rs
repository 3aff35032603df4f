//! Lines of streets and ways: straights and arcs.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector2;

/// Bends below this stay sharp \[rad\].
const STRAIGHT_RAD: f64 = 0.002;

/// A straight or an arc.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Piece {
    Line { from: Vector2<f64>, direction: Vector2<f64>, length_m: f64 },
    Arc { centre: Vector2<f64>, radius_m: f64, start_rad: f64, sweep_rad: f64 },
}

/// Where one is on an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// East, north \[m\].
    pub(super) point: Vector2<f64>,
    /// Unit vector along.
    pub(super) direction: Vector2<f64>,
}

impl Place {
    /// Unit vector to the right.
    pub(super) fn right(&self) -> Vector2<f64> {
        Vector2::new(self.direction.y, -self.direction.x)
    }
}

/// A line of points with rounded bends.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Axis {
    pieces: Vec<Piece>,
    starts_m: Vec<f64>,
    /// Length \[m\].
    pub(super) length_m: f64,
    /// Way to each of the points, or to the middle of the bend there \[m\].
    pub(super) vertices_m: Vec<f64>,
    /// Whether the end is the begin.
    pub(super) closed: bool,
}

impl Piece {
    fn length_m(&self) -> f64 {
        match self {
            Self::Line { length_m, .. } => *length_m,
            Self::Arc { radius_m, sweep_rad, .. } => radius_m * sweep_rad.abs(),
        }
    }

    fn at(&self, way_m: f64) -> Place {
        match self {
            Self::Line { from, direction, .. } => Place { point: from + direction * way_m, direction: *direction },
            Self::Arc { centre, radius_m, start_rad, sweep_rad } => {
                let angle = start_rad + sweep_rad.signum() * way_m / radius_m;
                let out = Vector2::new(angle.cos(), angle.sin());
                Place { point: centre + out * *radius_m, direction: Vector2::new(-out.y, out.x) * sweep_rad.signum() }
            }
        }
    }

    /// Distance of a point from the piece, infinite beside an arc's sector.
    fn distance_m(&self, point: &Vector2<f64>) -> f64 {
        match self {
            Self::Line { from, direction, length_m } => {
                let along = direction.dot(&(point - from)).clamp(0.0, *length_m);
                (point - from - direction * along).norm()
            }
            Self::Arc { centre, radius_m, start_rad, sweep_rad } => {
                let out = point - centre;
                let turned = (out.y.atan2(out.x) - start_rad) * sweep_rad.signum();
                match turned.rem_euclid(TAU) <= sweep_rad.abs() {
                    true => (out.norm() - radius_m).abs(),
                    false => f64::INFINITY,
                }
            }
        }
    }
}

impl Axis {
    /// A line through points, each at least a metre from the next, with bends of a radius or what fits.
    pub(super) fn new(points: &[Vector2<f64>], radius_m: f64) -> Self {
        let count = points.len();
        let closed = count > 2 && (points[0] - points[count - 1]).norm() < 1e-6;
        // how far from each point its bend begins
        let bends: Vec<(f64, f64)> = (0..count)
            .map(|k| {
                let (before, after) = match (k, closed) {
                    (0, true) => (points[count - 2], points[1]),
                    (0, false) => return (0.0, 0.0),
                    (k, true) if k + 1 == count => (points[count - 2], points[1]),
                    (k, false) if k + 1 == count => return (0.0, 0.0),
                    (k, _) => (points[k - 1], points[k + 1]),
                };
                let (a, b) = (points[k] - before, after - points[k]);
                let turn = (a.x * b.y - a.y * b.x).atan2(a.dot(&b));
                if turn.abs() < STRAIGHT_RAD {
                    return (0.0, 0.0);
                }
                let wanted = radius_m * (0.5 * turn.abs()).tan();
                (wanted.min(0.5 * a.norm()).min(0.5 * b.norm()), turn)
            })
            .collect();
        let mut axis = Self { pieces: Vec::new(), starts_m: Vec::new(), length_m: 0.0, vertices_m: vec![0.0], closed };
        for k in 0..count - 1 {
            let (from, to) = (points[k], points[k + 1]);
            let direction = (to - from).normalize();
            let length_m = (to - from).norm() - bends[k].0 - bends[k + 1].0;
            axis.push(Piece::Line { from: from + direction * bends[k].0, direction, length_m });
            let (tangent_m, turn) = bends[k + 1];
            let before_m = axis.length_m;
            if tangent_m > 0.0 && (k + 2 < count || closed) {
                let radius_m = tangent_m / (0.5 * turn.abs()).tan();
                let left = Vector2::new(-direction.y, direction.x) * turn.signum();
                let begin = to - direction * tangent_m;
                let centre = begin + left * radius_m;
                let out = begin - centre;
                axis.push(Piece::Arc { centre, radius_m, start_rad: out.y.atan2(out.x), sweep_rad: turn });
            }
            axis.vertices_m.push(0.5 * (before_m + axis.length_m));
        }
        axis
    }

    fn push(&mut self, piece: Piece) {
        if piece.length_m() > 1e-9 {
            self.starts_m.push(self.length_m);
            self.length_m += piece.length_m();
            self.pieces.push(piece);
        }
    }

    /// Place at a way \[m\]; beyond the ends the outermost pieces go on.
    pub(super) fn at(&self, way_m: f64) -> Place {
        let way_m = if self.closed { way_m.rem_euclid(self.length_m) } else { way_m };
        let k = self.starts_m.partition_point(|s| *s <= way_m).saturating_sub(1);
        self.pieces[k].at(way_m - self.starts_m[k])
    }

    /// Distance of a point from the axis \[m\].
    pub(super) fn distance_m(&self, point: &Vector2<f64>) -> f64 {
        self.pieces.iter().map(|piece| piece.distance_m(point)).fold(f64::INFINITY, f64::min)
    }

    /// Whether the axis is straight from one way to another \[m\].
    pub(super) fn is_straight(&self, from_m: f64, to_m: f64) -> bool {
        let (a, b) = (self.at(from_m), self.at(to_m));
        a.direction.dot(&b.direction) > 1.0 - 1e-9 && ((b.point - a.point).norm() - (to_m - from_m)).abs() < 1e-6
    }
}

/// An angle between -π and π.
pub(super) fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Axis {
        let p = |x: f64, y: f64| Vector2::new(x, y);
        Axis::new(&[p(0.0, 0.0), p(100.0, 0.0), p(100.0, 60.0), p(0.0, 60.0), p(0.0, 0.0)], 12.0)
    }

    #[test]
    fn a_block_with_rounded_corners_has_the_length_of_its_sides_and_arcs() {
        let axis = square();
        let expected = 2.0 * (76.0 + 36.0) + TAU * 12.0;
        assert!((axis.length_m - expected).abs() < 1e-9, "{} {expected}", axis.length_m);
        let mut step = 0.0;
        while step < axis.length_m {
            let (a, b) = (axis.at(step), axis.at(step + 0.01));
            assert!(((b.point - a.point).norm() - 0.01).abs() < 1e-6, "no jump at {step}");
            assert!(axis.distance_m(&(a.point + a.right() * 2.0)) - 2.0 < 1e-9);
            step += 0.37;
        }
    }

    #[test]
    fn the_middle_of_a_bend_is_the_way_to_its_point() {
        let axis = square();
        let corner = Vector2::new(100.0, 0.0);
        let nearest = axis.at(axis.vertices_m[1]).point;
        assert!(((nearest - corner).norm() - 12.0 * (2.0_f64.sqrt() - 1.0)).abs() < 1e-9);
    }
}
