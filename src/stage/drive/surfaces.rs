//! Where surfaces lie and how they lean, for points that have no neighbours at hand: the incidence of a beam on one of them.
//!
//! The matched patches, moved to where the correction takes them, are looked up by place. What a point is given is a weighted mean over the patches near it,
//! and changes with its place as slowly as patches are wide: a point that is moved along its ray by some millimetres finds the same again, and what
//! was added can be taken off.

use std::collections::{BTreeMap, HashMap};

use nalgebra::Vector3;
use tieline_matching::normal_bin;

use super::curve::Spline;
use super::over::incidence_deg;

/// A patch says how a surface leans so far from its middle \[m\], along it and across.
const REACH_M: f64 = 1.0;
const HEIGHT_M: f64 = 0.1;
/// One patch of each direction and square of this width is kept \[m\].
const SQUARE_M: f64 = 0.5;
/// With less weight than this the surface of a point is not known well enough: what it is given fades.
const ENOUGH: f64 = 0.25;
/// Cells hold all that reaches into half of them.
const CELL_M: f64 = 2.0 * REACH_M;

/// A piece of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Its middle, where the correction takes it, local frame \[m\].
    pub middle_m: Vector3<f64>,
    /// Unit normal, either way.
    pub normal: Vector3<f64>,
    /// Points that it was seen with.
    pub points: u32,
}

/// Pieces by place.
#[derive(Debug, Default)]
pub struct Surfaces {
    cells: HashMap<[i32; 3], Vec<Piece>>,
}

impl Surfaces {
    /// Of each direction and square the piece of most points, the first of equals.
    #[must_use]
    pub fn new(pieces: impl Iterator<Item = Piece>) -> Self {
        let mut best: BTreeMap<([i32; 3], u8), Piece> = BTreeMap::new();
        for piece in pieces.filter(|p| p.middle_m.iter().chain(p.normal.iter()).all(|v| v.is_finite())) {
            let up = if piece.normal.z < 0.0 { -piece.normal } else { piece.normal };
            let kept = best.entry((cell(&piece.middle_m, SQUARE_M), normal_bin(&up))).or_insert(piece);
            if piece.points > kept.points {
                *kept = piece;
            }
        }
        let mut cells: HashMap<_, Vec<_>> = HashMap::new();
        for piece in best.into_values() {
            cells.entry(cell(&piece.middle_m, CELL_M)).or_default().push(piece);
        }
        Self { cells }
    }

    /// What curves over the incidence add to a ray of this unit vector that ends here \[m\], and whether the surface is known well enough: else they add
    /// a part of it, or nothing.
    #[must_use]
    pub fn longer_m(
        &self,
        curves: &[(Spline, Vec<f64>)],
        point_m: &Vector3<f64>,
        direction: &Vector3<f64>,
    ) -> (f64, bool) {
        let (mut sum_m, mut weight) = (0.0, 0.0);
        let from = cell(&point_m.add_scalar(-0.5 * CELL_M), CELL_M);
        for corner in 0..8 {
            let at = [from[0] + (corner & 1), from[1] + (corner >> 1 & 1), from[2] + (corner >> 2)];
            for Piece { middle_m, normal, .. } in self.cells.get(&at).into_iter().flatten() {
                let off_m = point_m - middle_m;
                let height_m = off_m.dot(normal);
                let along = (off_m.norm_squared() - height_m * height_m) / (REACH_M * REACH_M);
                let across = height_m * height_m / (HEIGHT_M * HEIGHT_M);
                if along >= 1.0 || across >= 1.0 {
                    continue;
                }
                let own = ((1.0 - along) * (1.0 - across)).powi(2);
                let deg = incidence_deg(normal, direction);
                let longer_m: f64 = curves.iter().map(|(spline, coefficients)| spline.at(coefficients, deg)).sum();
                sum_m += own * longer_m;
                weight += own;
            }
        }
        (sum_m / weight.max(ENOUGH), weight >= ENOUGH)
    }
}

#[allow(clippy::cast_possible_truncation)] // saturates far outside of any survey
fn cell(place_m: &Vector3<f64>, width_m: f64) -> [i32; 3] {
    [place_m.x, place_m.y, place_m.z].map(|v| (v / width_m).floor() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::drive::over::Over;

    /// Level ground with a wall across it, at x = 3 m.
    fn street() -> Surfaces {
        let ground = (-8..12).flat_map(|i| (-8..8).map(move |k| (i, k))).map(|(i, k)| Piece {
            middle_m: Vector3::new(0.25 + 0.5 * f64::from(i), 0.25 + 0.5 * f64::from(k), 0.0),
            normal: if k % 2 == 0 { Vector3::z() } else { -Vector3::z() },
            points: 20,
        });
        let wall = (-8..8).flat_map(|i| (0..8).map(move |k| (i, k))).map(|(i, k)| Piece {
            middle_m: Vector3::new(3.0, 0.25 + 0.5 * f64::from(i), 0.25 + 0.5 * f64::from(k)),
            normal: Vector3::x(),
            points: 20,
        });
        Surfaces::new(ground.chain(wall))
    }

    /// As many millimetres as the incidence has tens of degrees.
    fn curves() -> Vec<(Spline, Vec<f64>)> {
        let spline = Over::Incidence.spline_of(0.0, 90.0, 12).expect("a span");
        let coefficients = (0..12).map(|k| 1e-4 * spline.centre(k)).collect();
        vec![(spline, coefficients)]
    }

    #[test]
    fn ground_and_wall_have_each_their_own_incidence() {
        let (street, curves) = (street(), curves());
        let down = Vector3::new(0.5, 0.0, -0.75_f64.sqrt());
        let at = |x: f64, z: f64| street.longer_m(&curves, &Vector3::new(x, 0.1, z), &down);
        // 30° from the vertical, 60° from the normal of the wall
        let (on_ground, on_wall) = (at(1.0, 0.02), at(3.01, 1.2));
        assert!((on_ground.0 - 0.003).abs() < 1e-9 && on_ground.1, "{on_ground:?}");
        assert!((on_wall.0 - 0.006).abs() < 1e-9 && on_wall.1, "{on_wall:?}");
        // 0.2 m beside the wall there is nothing of it
        assert!((at(2.8, 0.0).0 - 0.003).abs() < 1e-9);
        // where no surface is known, nothing
        assert_eq!(at(1.0, 1.5), (0.0, false));
        assert_eq!(at(90.0, 0.0), (0.0, false));
        let edge = at(-4.6, 0.0);
        assert!(edge.0 > 0.0 && edge.0 < 0.003 && !edge.1, "{edge:?}");
    }

    #[test]
    fn what_is_added_changes_slowly_with_the_place() {
        let (street, curves) = (street(), curves());
        let down = Vector3::new(0.5, 0.2, -0.9).normalize();
        // through the corner, over the edge, along a beam: by far less than a point moves
        for start in [Vector3::new(2.5, 0.1, 0.8), Vector3::new(2.9, 0.3, 0.3), Vector3::new(-5.2, 0.0, 0.3)] {
            let at = |way_m: f64| street.longer_m(&curves, &(start + down * way_m), &down).0;
            let mut before_m = at(0.0);
            for k in 1..2000 {
                let here_m = at(0.0005 * f64::from(k));
                assert!((here_m - before_m).abs() < 0.5 * 0.0005, "{start} {k}: {before_m} {here_m}");
                before_m = here_m;
            }
        }
    }
}
