//! The georeferencing equation: how corrections of pose and mounting move a point.
//!
//! `x = p + G C [ a + R(b) r (1 + f(ρ)/ρ) ]` with `C` = `ned_from_body`, `G` = `map_from_ned`, `a` the lever arm, `r`
//! the nominal beam in the body frame, `ρ = |r|`, `f(ρ) = f₀ + f₁ ρ` (DESIGN, *Observation equations*). A correction
//! replaces `p` by `p + G δp`, `C` by `exp([δψ]×) C`, `a` by `a + δa`. Points are moved by the *difference* of the
//! equation with and without correction, so that whatever made the cloud otherwise stays as it was.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use tieline_filter::{Pose, frames::rotation_from_vector};

/// Correction of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PoseCorrection {
    /// To be added to the position, north-east-down \[m\].
    pub position_ned_m: Vector3<f64>,
    /// Rotation vector in north-east-down \[rad\], acting on the left of `ned_from_body`.
    pub rotation_ned_rad: Vector3<f64>,
}

/// Correction of the mounting and ranging of one scanner.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Calibration {
    /// Rotation vector in the body frame \[rad\], on the left of the mounting.
    pub boresight_rad: Vector3<f64>,
    /// To be added to the lever arm, body frame \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// To be added to every range \[m\].
    pub range_offset_m: f64,
    /// To be added to every range, per metre of range.
    pub range_scale: f64,
}

/// How points measured from one pose move: `Δ = e + D w + (f₀/ρ + f₁)(w + D w)`, `w` from scanner to point.
///
/// All in map axes. Exact for every point of that pose; entries may be interpolated between poses that are close.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointMap {
    /// Position of the scanner before the correction \[m\].
    pub scanner_m: Vector3<f64>,
    /// Shift of the scanner \[m\].
    pub shift_m: Vector3<f64>,
    /// Rotation of the beams, less the identity.
    pub turn: Matrix3<f64>,
    /// `f₀` \[m\].
    pub range_offset_m: f64,
    /// `f₁`.
    pub range_scale: f64,
}

impl PointMap {
    /// The map of a pose with nominal lever arm \[m\] under corrections.
    #[must_use]
    pub fn new(
        pose: &Pose,
        lever_arm_m: &Vector3<f64>,
        correction: &PoseCorrection,
        calibration: &Calibration,
    ) -> Self {
        let g = pose.map_from_ned;
        let g_inverse = inverse_grid(&g);
        let c = *pose.ned_from_body.to_rotation_matrix().matrix();
        let corrected = rotation_from_vector(&correction.rotation_ned_rad) * c;
        let beams = corrected * rotation_from_vector(&calibration.boresight_rad) * c.transpose();
        let arm = corrected * (lever_arm_m + calibration.lever_arm_m) - c * lever_arm_m;
        Self {
            scanner_m: pose.position + g * (c * lever_arm_m),
            shift_m: g * (correction.position_ned_m + arm),
            turn: g * (beams - Matrix3::identity()) * g_inverse,
            range_offset_m: calibration.range_offset_m,
            range_scale: calibration.range_scale,
        }
    }

    /// What is to be added to a point in the map frame \[m\].
    #[must_use]
    #[inline]
    pub fn delta_m(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        let w = point_m - self.scanner_m;
        let turned = self.turn * w;
        let stretch = self.range_offset_m / w.norm().max(1e-3) + self.range_scale;
        self.shift_m + turned + (w + turned) * stretch
    }

    /// The point that the map takes to `moved_m`: the inverse of adding [`PointMap::delta_m`].
    #[must_use]
    pub fn undo(&self, moved_m: &Vector3<f64>) -> Vector3<f64> {
        let mut point = moved_m - self.delta_m(moved_m);
        // a contraction by the size of the rotation: a few steps for corrections, twenty for one radian's tenth
        for _ in 0..20 {
            let next = moved_m - self.delta_m(&point);
            let step = (next - point).norm();
            point = next;
            if step < 1e-10 {
                break;
            }
        }
        point
    }

    /// A map between two that are close in time.
    #[must_use]
    #[inline]
    pub fn between(&self, other: &Self, u: f64) -> Self {
        Self {
            scanner_m: self.scanner_m + (other.scanner_m - self.scanner_m) * u,
            shift_m: self.shift_m + (other.shift_m - self.shift_m) * u,
            turn: self.turn + (other.turn - self.turn) * u,
            range_offset_m: self.range_offset_m,
            range_scale: self.range_scale,
        }
    }
}

fn inverse_grid(g: &Matrix3<f64>) -> Matrix3<f64> {
    let k2 = g[(0, 0)].powi(2) + g[(0, 1)].powi(2);
    let mut inverse = g.transpose();
    for row in 0..2 {
        for column in 0..3 {
            inverse[(row, column)] /= k2;
        }
    }
    inverse
}

/// Derivatives of `n · x` by the corrections, `n` a unit vector in map axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Derivatives {
    /// By position, north-east-down \[1\].
    pub position: Vector3<f64>,
    /// By rotation vector, north-east-down \[m/rad\].
    pub rotation: Vector3<f64>,
    /// By boresight, body \[m/rad\].
    pub boresight: Vector3<f64>,
    /// By lever arm, body \[1\].
    pub lever_arm: Vector3<f64>,
    /// By range offset \[1\].
    pub range_offset: f64,
    /// By range scale \[m\].
    pub range_scale: f64,
}

impl Derivatives {
    /// The derivatives at the present corrections for a point measured at `point_m` (before correction).
    #[must_use]
    pub fn new(
        pose: &Pose,
        lever_arm_m: &Vector3<f64>,
        correction: &PoseCorrection,
        calibration: &Calibration,
        point_m: &Vector3<f64>,
        normal: &Vector3<f64>,
    ) -> Self {
        let c = *pose.ned_from_body.to_rotation_matrix().matrix();
        let beam_nominal = c.transpose() * pose.ned_vector_m(point_m) - lever_arm_m;
        let range_m = beam_nominal.norm().max(1e-3);
        let stretch = 1.0 + calibration.range_offset_m / range_m + calibration.range_scale;
        let beam = rotation_from_vector(&calibration.boresight_rad) * beam_nominal * stretch;
        let corrected = rotation_from_vector(&correction.rotation_ned_rad) * c;
        let arm = corrected * (lever_arm_m + calibration.lever_arm_m + beam);
        let n_ned = pose.map_from_ned.transpose() * normal;
        let n_body = corrected.transpose() * n_ned;
        let along = n_body.dot(&beam) / (range_m * stretch);
        Self {
            position: n_ned,
            rotation: arm.cross(&n_ned),
            boresight: beam.cross(&n_body),
            lever_arm: n_body,
            range_offset: along,
            range_scale: along * range_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tieline_filter::{map_from_ned, ned_from_body};

    fn pose(angles: [f64; 3]) -> Pose {
        Pose {
            time_s: 0.0,
            position: Vector3::new(500_000.0, 4_000_000.0, 1_000.0),
            ned_from_body: ned_from_body(angles[0], angles[1], angles[2] * 5.0),
            map_from_ned: map_from_ned(0.02, 0.9996),
        }
    }

    fn parts(v: &[f64; 14]) -> (PoseCorrection, Calibration) {
        let vector = |i: usize, scale: f64| Vector3::new(v[i], v[i + 1], v[i + 2]) * scale;
        let correction = PoseCorrection { position_ned_m: vector(0, 0.3), rotation_ned_rad: vector(3, 0.01) };
        let calibration = Calibration {
            boresight_rad: vector(6, 0.01),
            lever_arm_m: vector(9, 0.2),
            range_offset_m: v[12] * 0.1,
            range_scale: v[13] * 1e-3,
        };
        (correction, calibration)
    }

    proptest! {
        #[test]
        fn the_analytic_derivatives_equal_the_central_differences(
            angles in prop::array::uniform3(-0.5_f64..0.5), v in prop::array::uniform14(-1.0_f64..1.0),
            d in prop::array::uniform3(-300.0_f64..300.0), n in prop::array::uniform3(-1.0_f64..1.0))
        {
            let pose = pose(angles);
            let lever = Vector3::new(0.4, -0.2, 0.7);
            let point = pose.position + Vector3::new(d[0], d[1], -800.0 + d[2]);
            prop_assume!(Vector3::from(n).norm() > 0.1);
            let normal = Vector3::from(n).normalize();
            let height = |v: &[f64; 14]| {
                let (correction, calibration) = parts(v);
                normal.dot(&PointMap::new(&pose, &lever, &correction, &calibration).delta_m(&point))
            };
            let (correction, calibration) = parts(&v);
            let a = Derivatives::new(&pose, &lever, &correction, &calibration, &point, &normal);
            // A rotation vector added inside exp() is not one multiplied on the left: compare at the left side.
            let numeric = |i: usize, scale: f64| {
                let h = 1e-4;
                let (mut up, mut down) = (v, v);
                up[i] += h;
                down[i] -= h;
                (height(&up) - height(&down)) / (2.0 * h * scale)
            };
            for k in 0..3 {
                prop_assert!((numeric(k, 0.3) - a.position[k]).abs() < 1e-6);
                prop_assert!((numeric(9 + k, 0.2) - a.lever_arm[k]).abs() < 1e-6);
                prop_assert!((left(&pose, &lever, &v, &point, &normal, k, true) - a.rotation[k]).abs() < 2e-3);
                prop_assert!((left(&pose, &lever, &v, &point, &normal, k, false) - a.boresight[k]).abs() < 2e-3);
            }
            // the stretch is by map distance, 4e-4 from true distance in this projection
            prop_assert!((numeric(12, 0.1) - a.range_offset).abs() < 1e-3);
            prop_assert!((numeric(13, 1e-3) - a.range_scale).abs() < 1e-2);
        }

        #[test]
        fn undoing_a_correction_gives_the_point_back(
            angles in prop::array::uniform3(-0.5_f64..0.5), v in prop::array::uniform14(-1.0_f64..1.0))
        {
            let pose = pose(angles);
            let (correction, calibration) = parts(&v);
            let map = PointMap::new(&pose, &Vector3::new(0.4, -0.2, 0.7), &correction, &calibration);
            let point = pose.position + Vector3::new(200.0, -90.0, -700.0);
            let back = map.undo(&(point + map.delta_m(&point)));
            prop_assert!((back - point).norm() < 1e-7);
        }
    }

    /// Central difference by a rotation vector multiplied on the left of the one in `v`.
    fn left(
        p: &Pose,
        lever: &Vector3<f64>,
        v: &[f64; 14],
        x: &Vector3<f64>,
        n: &Vector3<f64>,
        k: usize,
        attitude: bool,
    ) -> f64 {
        let h = 1e-5;
        let value = |sign: f64| {
            let (mut correction, mut calibration) = parts(v);
            let target = if attitude { &mut correction.rotation_ned_rad } else { &mut calibration.boresight_rad };
            let mut step = Vector3::zeros();
            step[k] = sign * h;
            let turned = nalgebra::Rotation3::new(step) * nalgebra::Rotation3::new(*target);
            *target = turned.scaled_axis();
            n.dot(&PointMap::new(p, lever, &correction, &calibration).delta_m(x))
        };
        (value(1.0) - value(-1.0)) / (2.0 * h)
    }
}
