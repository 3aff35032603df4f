//! Overlap of footprints: of patches in their plane, and of whole strips.
//!
//! This is the only door to parry, which speaks glam and `f32`: boxes of strips are given to it in a local origin,
//! where single precision is a millimetre at ten kilometres. Its intersection of convex polygons goes wrong when
//! edges coincide (measured: a square with itself), so the footprints of patches are clipped here.

use nalgebra::Vector2;
use parry3d::math::{Pose, Rotation, Vector};
use parry3d::query::intersection_test;
use parry3d::shape::Cuboid;

/// A convex polygon in a plane, counter-clockwise, vertices \[m\] from a point close by.
#[derive(Debug, Clone, PartialEq)]
pub struct Footprint {
    vertices: Vec<Vector2<f64>>,
}

fn cross(a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    a.x * b.y - a.y * b.x
}

impl Footprint {
    /// A parallelogram about `centre` spanned by the half axes `a` and `b` \[m\].
    #[must_use]
    pub fn parallelogram(centre: [f64; 2], a: [f64; 2], b: [f64; 2]) -> Self {
        let (centre, a, b) = (Vector2::from(centre), Vector2::from(a), Vector2::from(b));
        let mut vertices = vec![centre - a - b, centre + a - b, centre + a + b, centre - a + b];
        if cross(&a, &b) < 0.0 {
            vertices.reverse();
        }
        Self { vertices }
    }

    fn edges(&self) -> impl Iterator<Item = (&Vector2<f64>, &Vector2<f64>)> {
        self.vertices.iter().zip(self.vertices.iter().cycle().skip(1))
    }

    /// Area \[m²\].
    #[must_use]
    pub fn area_m2(&self) -> f64 {
        self.edges().map(|(p, q)| 0.5 * cross(p, q)).sum::<f64>().abs()
    }

    /// Centroid \[m\]; the mean vertex when the area vanishes.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn centroid(&self) -> [f64; 2] {
        let area: f64 = self.edges().map(|(p, q)| cross(p, q)).sum();
        let sum: Vector2<f64> = if area.abs() < 1e-9 {
            self.vertices.iter().sum::<Vector2<f64>>() / self.vertices.len().max(1) as f64
        } else {
            self.edges().map(|(p, q)| (p + q) * cross(p, q)).sum::<Vector2<f64>>() / (3.0 * area)
        };
        [sum.x, sum.y]
    }

    /// What two footprints share, by clipping with each edge in turn (Sutherland and Hodgman, 1974); `None` when
    /// they do not meet.
    #[must_use]
    pub fn intersection(&self, other: &Self) -> Option<Self> {
        let mut kept = self.vertices.clone();
        for (from, to) in other.edges() {
            let edge = to - from;
            let side = |p: &Vector2<f64>| cross(&edge, &(p - from));
            let mut next = Vec::with_capacity(kept.len() + 1);
            for (p, q) in kept.iter().zip(kept.iter().cycle().skip(1)) {
                let (sp, sq) = (side(p), side(q));
                if sp >= 0.0 {
                    next.push(*p);
                }
                if (sp > 0.0 && sq < 0.0) || (sp < 0.0 && sq > 0.0) {
                    next.push(p + (q - p) * (sp / (sp - sq)));
                }
            }
            kept = next;
        }
        (kept.len() >= 3).then_some(Self { vertices: kept })
    }
}

/// An upright box about the points of a strip, turned to its course.
#[derive(Debug, Clone, PartialEq)]
pub struct StripBox {
    /// Centre in the local frame \[m\].
    pub centre_m: [f64; 3],
    /// Half lengths along the course, across it and upward \[m\].
    pub half_m: [f64; 3],
    /// Angle of the course from the x axis, counter-clockwise \[rad\].
    pub turn_rad: f64,
}

impl StripBox {
    /// The smallest box, over turns in steps of 5°, about points in the local frame; `None` without points.
    #[must_use]
    pub fn about(points_m: &[[f64; 3]]) -> Option<Self> {
        let range = |f: &dyn Fn(&[f64; 3]) -> f64| {
            points_m.iter().map(f).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
        };
        let up = range(&|p| p[2]);
        let candidates = (0..18).map(|step| {
            let turn_rad = f64::from(step) * 5.0_f64.to_radians();
            let (s, c) = turn_rad.sin_cos();
            let (along, across) = (range(&|p| c * p[0] + s * p[1]), range(&|p| c * p[1] - s * p[0]));
            let mid = |r: (f64, f64)| 0.5 * (r.0 + r.1);
            let half = |r: (f64, f64)| 0.5 * (r.1 - r.0);
            let centre_m = [c * mid(along) - s * mid(across), s * mid(along) + c * mid(across), mid(up)];
            Self { centre_m, half_m: [half(along), half(across), half(up)], turn_rad }
        });
        let area = |b: &Self| b.half_m[0] * b.half_m[1];
        candidates.min_by(|a, b| area(a).total_cmp(&area(b))).filter(|_| !points_m.is_empty())
    }

    /// Whether two strips' boxes, widened by `margin_m`, have ground in common.
    #[must_use]
    pub fn overlaps(&self, other: &Self, margin_m: f64) -> bool {
        let (a, b) = (self.parry(margin_m), other.parry(margin_m));
        intersection_test(&a.0, &a.1, &b.0, &b.1).map_or(true, |answer| answer.intersecting)
    }

    #[allow(clippy::cast_possible_truncation)] // local coordinates, see the module
    fn parry(&self, margin_m: f64) -> (Pose, Cuboid) {
        let vector = |v: [f64; 3]| Vector::new(v[0] as f32, v[1] as f32, v[2] as f32);
        let pose = Pose::from_parts(vector(self.centre_m), Rotation::from_rotation_z(self.turn_rad as f32));
        (pose, Cuboid::new(vector(self.half_m.map(|h| h + margin_m))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, half: f64) -> Footprint {
        Footprint::parallelogram([x, y], [half, 0.0], [0.0, half])
    }

    #[test]
    fn two_shifted_squares_share_the_area_of_the_textbook() {
        let shared = square(0.0, 0.0, 1.0).intersection(&square(1.0, 0.5, 1.0)).expect("they meet");
        assert!((shared.area_m2() - 1.5).abs() < 1e-6);
        let centroid = shared.centroid();
        assert!((centroid[0] - 0.5).abs() < 1e-6 && (centroid[1] - 0.25).abs() < 1e-6);
    }

    #[test]
    fn a_square_inside_another_is_what_they_share() {
        for (a, b) in [(square(0.0, 0.0, 2.0), square(0.1, 0.0, 0.5)), (square(0.1, 0.0, 0.5), square(0.0, 0.0, 2.0))] {
            assert!((a.intersection(&b).expect("they meet").area_m2() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_square_shares_its_whole_area_with_itself() {
        let turned = Footprint::parallelogram([0.0, 0.0], [0.3, 0.4], [0.4, -0.3]);
        let shared = turned.intersection(&turned.clone()).expect("they meet");
        assert!((shared.area_m2() - turned.area_m2()).abs() < 1e-6);
    }

    #[test]
    fn strips_that_cross_overlap_and_parallel_ones_apart_do_not() {
        let line = |angle: f64, shift: f64| -> Vec<[f64; 3]> {
            let (s, c) = angle.sin_cos();
            (-100..=100)
                .flat_map(|i| {
                    [-20.0, 20.0].map(|w| {
                        [c * f64::from(i) * 10.0 - s * (w + shift), s * f64::from(i) * 10.0 + c * (w + shift), 0.0]
                    })
                })
                .collect()
        };
        let strip = |angle: f64, shift: f64| StripBox::about(&line(angle, shift)).expect("points");
        assert!(strip(0.785, 0.0).overlaps(&strip(-0.785, 300.0), 1.0));
        assert!(!strip(0.785, 0.0).overlaps(&strip(0.785, 300.0), 1.0));
        assert!(StripBox::about(&[]).is_none());
    }

    #[test]
    fn squares_apart_share_nothing() {
        assert!(square(0.0, 0.0, 1.0).intersection(&square(5.0, 0.0, 1.0)).is_none());
    }
}
