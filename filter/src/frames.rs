//! Frames and the rotations between them.
//!
//! | frame | axes |
//! |---|---|
//! | body **b** | x forward, y right, z down; right-handed, origin in the IMU |
//! | navigation **n** | north, east, down at the IMU |
//! | map **m** | easting, northing, height of the strips' coordinate reference system |
//!
//! Attitude is yaw-pitch-roll, Z-Y'-X'': `ned_from_body = Rz(heading) Ry(pitch) Rx(roll)`.
//! A small attitude correction `psi` is a rotation vector in **n** and acts on the left:
//! `C ← exp([psi]×) C`. A boresight `b` is a rotation vector in **b** and acts on the left of the mounting.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Rotation from body to north-east-down of roll, pitch and true heading \[rad\].
#[must_use]
pub fn ned_from_body(roll_rad: f64, pitch_rad: f64, heading_rad: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(roll_rad, pitch_rad, heading_rad)
}

/// Roll, pitch and heading \[rad\] of a rotation from body to north-east-down; the inverse of [`ned_from_body`].
#[must_use]
pub fn roll_pitch_heading_rad(ned_from_body: &UnitQuaternion<f64>) -> (f64, f64, f64) {
    ned_from_body.euler_angles()
}

/// Rotation matrix of a rotation vector \[rad\]: `exp([v]×)`.
#[must_use]
pub fn rotation_from_vector(vector_rad: &Vector3<f64>) -> Matrix3<f64> {
    *Rotation3::new(*vector_rad).matrix()
}

/// Linear map that turns a short vector in north-east-down \[m\] into map axes (E, N, up) \[m\].
///
/// `convergence_rad` is the bearing of grid north from true north (positive when grid north lies east of
/// true north), `scale` the point scale factor of the projection, applied to the horizontal part.
#[must_use]
pub fn map_from_ned(convergence_rad: f64, scale: f64) -> Matrix3<f64> {
    let (s, c) = convergence_rad.sin_cos();
    Matrix3::new(-scale * s, scale * c, 0.0, scale * c, scale * s, 0.0, 0.0, 0.0, -1.0)
}

/// The matrix of the cross product: `skew(a) b = a × b`.
#[must_use]
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_right_wing_goes_down_when_roll_is_positive() {
        let right_wing = ned_from_body(0.1, 0.0, 0.0) * Vector3::y();
        assert!(right_wing.z > 0.09, "down is positive: {right_wing}");
    }

    #[test]
    fn the_nose_goes_up_when_pitch_is_positive_and_east_when_heading_is() {
        let nose = ned_from_body(0.0, 0.1, 0.0) * Vector3::x();
        assert!(nose.z < -0.09);
        let nose = ned_from_body(0.0, 0.0, std::f64::consts::FRAC_PI_2) * Vector3::x();
        assert!((nose - Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn angles_go_there_and_back() {
        let (roll, pitch, heading) = (0.2, -0.3, 2.9);
        let (r, p, h) = roll_pitch_heading_rad(&ned_from_body(roll, pitch, heading));
        assert!((r - roll).abs() < 1e-14 && (p - pitch).abs() < 1e-14 && (h - heading).abs() < 1e-14);
    }

    #[test]
    fn true_north_lies_west_of_grid_north_when_the_convergence_is_positive() {
        let north_in_map = map_from_ned(0.02, 0.9996) * Vector3::x();
        assert!(north_in_map.x < -0.019 && north_in_map.y > 0.999);
        assert!((north_in_map.norm() - 0.9996).abs() < 1e-12);
        assert!((map_from_ned(0.0, 1.0) * Vector3::y() - Vector3::new(1.0, 0.0, 0.0)).norm() < 1e-15);
    }
}
