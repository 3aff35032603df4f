//! How a patch moves when its cloud is corrected: like a rigid body, as the plane through its points does.

use nalgebra::{Matrix3, Rotation3, Vector3};
use tieline_matching::Patch;

use super::correction::Moved;

/// How a patch moves from the cloud as delivered to the corrected one, both in the local frame of the survey.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    turned: Rotation3<f64>,
    from_m: Vector3<f64>,
    to_m: Vector3<f64>,
}

/// Places along an axis of a patch at which its motion is looked at, in standard deviations of its points: the outer ones of Gauss's three on a
/// uniformly filled side, and their share of the mean.
const OUTER: f64 = 1.341_640_786_499_874;
const SHARE: f64 = 5.0 / 18.0;

impl Motion {
    /// A patch that stays where it is.
    pub(super) const NONE: Self = Self::shifted(Vector3::new(0.0, 0.0, 0.0));

    /// A patch that is shifted \[m\] and not turned.
    pub(super) const fn shifted(shift_m: Vector3<f64>) -> Self {
        Self { turned: Rotation3::from_matrix_unchecked(IDENTITY), from_m: Vector3::new(0.0, 0.0, 0.0), to_m: shift_m }
    }

    /// The motion of a patch whose centroid is the end of a beam: as the correction moves that, and as rays that become longer by so much move the plane
    /// that is fitted to all points: its centroid by their mean, its axes by what they differ over it. Longer they become by ray and range \[m\]. `rays_m` is what the ray changes by for one standard
    /// deviation of the points along either axis, nominal body axes. `None` for what is no number.
    #[must_use]
    pub fn new(
        patch: &Patch,
        moved: &Moved,
        rays_m: &[Vector3<f64>; 2],
        origin_m: &Vector3<f64>,
        longer_m: impl Fn(&Vector3<f64>, f64) -> f64,
    ) -> Option<Self> {
        let longer = |ray_m: Vector3<f64>| {
            let range_m = ray_m.norm().max(1e-3);
            moved.map_from_body * ray_m * (longer_m(&ray_m, range_m) / range_m)
        };
        let middle_m = longer(moved.ray_m);
        let mut to_m = moved.point_m - origin_m + middle_m;
        let mut along = [Vector3::zeros(); 2];
        for (k, axis) in [patch.long_axis, patch.cross_axis()].into_iter().enumerate() {
            let step_m = rays_m[k] * OUTER;
            let (ahead_m, behind_m) = (longer(moved.ray_m + step_m), longer(moved.ray_m - step_m));
            to_m += (ahead_m + behind_m - middle_m * 2.0) * SHARE;
            along[k] = moved.turned * axis + (ahead_m - behind_m) / (2.0 * OUTER * patch.spread_m[k].max(1e-3));
        }
        let normal = along[0].cross(&along[1]).normalize();
        let long = along[0].normalize();
        let axes = |n: Vector3<f64>, u: Vector3<f64>| Matrix3::from_columns(&[u, n.cross(&u), n]);
        let turned = axes(normal, long) * axes(patch.normal, patch.long_axis).transpose();
        let whole = to_m.iter().chain(turned.iter()).all(|v| v.is_finite());
        whole.then(|| Self { turned: Rotation3::from_matrix_unchecked(turned), from_m: patch.centroid_m, to_m })
    }

    /// The patch where it comes to lie.
    #[must_use]
    pub fn patch(&self, patch: &Patch) -> Patch {
        Patch {
            centroid_m: self.to_m + self.turned * (patch.centroid_m - self.from_m),
            normal: self.turned * patch.normal,
            long_axis: self.turned * patch.long_axis,
            ..patch.clone()
        }
    }

    /// Where a point of the moved patch lies in the cloud as delivered \[m\].
    #[must_use]
    pub fn back(&self, moved_m: &Vector3<f64>) -> Vector3<f64> {
        self.from_m + self.turned.inverse() * (moved_m - self.to_m)
    }

    /// How far its centroid moves \[m\].
    #[must_use]
    pub fn shift_m(&self) -> Vector3<f64> {
        self.to_m - self.from_m
    }
}

const IDENTITY: Matrix3<f64> = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use tieline_matching::Sighting;

    /// A patch of 0.3 m, a little out of level, of a strip at a time \[s\] and a place \[m\].
    pub(in super::super) fn patch(strip: u32, time_s: f64, centroid_m: [f64; 3]) -> Patch {
        let normal = Vector3::new(0.1, -0.05, 1.0).normalize();
        Patch {
            sighting: Sighting { strip, pass: 0, scanner: 0 },
            time_s,
            centroid_m: Vector3::from(centroid_m),
            normal,
            long_axis: normal.cross(&Vector3::x()).normalize(),
            spread_m: [0.29, 0.14],
            roughness_m: 0.005,
            points: 40,
            intensity: 0.0,
        }
    }

    fn moved(turned: Rotation3<f64>, point_m: Vector3<f64>, ray_m: Vector3<f64>) -> Moved {
        Moved { point_m, turned: *turned.matrix(), map_from_body: Matrix3::identity(), ray_m }
    }

    #[test]
    fn a_rigid_motion_is_made_and_taken_back() {
        let turn = Rotation3::new(Vector3::new(0.002, -0.003, 0.01));
        let (shift_m, origin_m) = (Vector3::new(0.4, -0.5, 0.1), Vector3::new(463_000.0, 5_340_000.0, 200.0));
        let goes_to = |p: &Vector3<f64>| turn * p + shift_m;
        let one = patch(0, 5.0, [30.0, -20.0, 2.0]);
        let of = moved(turn, goes_to(&one.centroid_m) + origin_m, Vector3::new(3.0, 4.0, 1.0));
        let motion = Motion::new(&one, &of, &[Vector3::x(), Vector3::y()], &origin_m, |_, _| 0.0).expect("a motion");
        let there = motion.patch(&one);
        assert!((there.centroid_m - goes_to(&one.centroid_m)).norm() < 1e-8);
        assert!((there.normal - turn * one.normal).norm() < 1e-9);
        assert!((there.long_axis - turn * one.long_axis).norm() < 1e-9);
        let feature_m = Vector3::new(30.2, -20.1, 2.05);
        assert!((motion.back(&goes_to(&feature_m)) - feature_m).norm() < 1e-8);
        assert!(Motion::new(&one, &of, &[Vector3::zeros(); 2], &origin_m, |_, _| f64::NAN).is_none());
    }

    #[test]
    fn rays_that_become_longer_move_a_patch_as_the_plane_through_its_points() {
        // level ground 3 m ahead and 2 m below, and a correction that bends over the patch
        let one = Patch { normal: Vector3::z(), long_axis: Vector3::x(), ..patch(0, 5.0, [0.0; 3]) };
        let ray_m = Vector3::new(3.0, 0.5, -2.0);
        let longer_m = |range_m: f64| 0.004 * (range_m - 3.2).powi(2) + 0.002 * (range_m - 3.6);
        let rays_m = [Vector3::x() * one.spread_m[0], Vector3::y() * one.spread_m[1]];
        let of = moved(Rotation3::identity(), Vector3::zeros(), ray_m);
        let there =
            Motion::new(&one, &of, &rays_m, &Vector3::zeros(), |_, r| longer_m(r)).expect("a motion").patch(&one);
        // least squares through a fine grid of points
        let (mut sum_m, mut slopes, n) = (Vector3::zeros(), [0.0; 2], 200);
        for i in 0..n {
            for k in 0..n {
                let step = |m: i32| (f64::from(m) + 0.5) * 2.0 / f64::from(n) - 1.0;
                let half_m = one.half_extent_m();
                let off = [step(i) * half_m[0], step(k) * half_m[1]];
                let ray = ray_m + Vector3::new(off[0], off[1], 0.0);
                let up_m = ray / ray.norm() * longer_m(ray.norm());
                sum_m += up_m;
                slopes[0] += up_m.z * off[0] / one.spread_m[0].powi(2);
                slopes[1] += up_m.z * off[1] / one.spread_m[1].powi(2);
            }
        }
        let count = f64::from(n * n);
        let mean_m = sum_m / count;
        assert!((there.centroid_m - mean_m).norm() < 2e-6, "{} {mean_m}", there.centroid_m);
        let normal = Vector3::new(-slopes[0] / count, -slopes[1] / count, 1.0).normalize();
        assert!((there.normal - normal).norm() < 3e-5 && (normal - Vector3::z()).norm() > 5e-4, "{}", there.normal);
    }
}
