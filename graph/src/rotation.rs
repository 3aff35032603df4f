//! Rotations and rigid motions: Jacobians of their logarithms (Barfoot, State Estimation for Robotics, §7.1).

use nalgebra::{Matrix2, Matrix3, Matrix6, Vector2, Vector3, Vector6};

/// The matrix of `v ×`.
#[must_use]
pub fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// `(1 - (θ/2) cot(θ/2)) / θ²`, by its series near zero.
fn half_cotangent(angle: f64) -> f64 {
    if angle < 1e-2 {
        let s = angle * angle;
        1.0 / 12.0 + s / 720.0 + s * s / 30_240.0 + s * s * s / 1_209_600.0
    } else {
        let half = 0.5 * angle;
        (1.0 - half / half.tan()) / (angle * angle)
    }
}

/// Inverse of the right Jacobian of SO(3): `log(exp(φ) exp(δ)) = φ + J δ` (eq. 7.83b with the sign of φ turned).
#[must_use]
pub fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let k = cross(phi);
    Matrix3::identity() + 0.5 * k + half_cotangent(phi.norm()) * k * k
}

/// Inverse of the left Jacobian of SO(3): `V⁻¹` of the logarithm of a rigid motion.
#[must_use]
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    right_jacobian_inverse(&-phi)
}

/// Logarithm of a rigid motion in space: translation part, rotation part.
#[must_use]
pub fn log_se3(translation: &Vector3<f64>, phi: &Vector3<f64>) -> Vector6<f64> {
    let rho = left_jacobian_inverse(phi) * translation;
    Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
}

/// The matrix `Q` of the left Jacobian of SE(3) (eq. 7.86).
fn q_matrix(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Matrix3<f64> {
    let (p, r) = (cross(phi), cross(rho));
    let t = phi.norm();
    let (a, b, c) = if t < 5e-2 {
        let s = t * t;
        (
            1.0 / 6.0 - s / 120.0 + s * s / 5040.0,
            1.0 / 24.0 - s / 720.0 + s * s / 40_320.0,
            1.0 / 120.0 - s / 2520.0 + s * s / 120_960.0,
        )
    } else {
        let (sin, cos) = t.sin_cos();
        let (t2, t3, t4, t5) = (t * t, t.powi(3), t.powi(4), t.powi(5));
        ((t - sin) / t3, (t2 + 2.0 * cos - 2.0) / (2.0 * t4), (2.0 * t - 3.0 * sin + t * cos) / (2.0 * t5))
    };
    0.5 * r
        + a * (p * r + r * p + p * r * p)
        + b * (p * p * r + r * p * p - 3.0 * p * r * p)
        + c * (p * r * p * p + p * p * r * p)
}

/// Inverse of the right Jacobian of SE(3), translation first.
#[must_use]
pub fn right_jacobian_inverse_se3(xi: &Vector6<f64>) -> Matrix6<f64> {
    let rho = -Vector3::new(xi[0], xi[1], xi[2]);
    let phi = -Vector3::new(xi[3], xi[4], xi[5]);
    let j = left_jacobian_inverse(&phi);
    let corner = -j * q_matrix(&rho, &phi) * j;
    let mut out = Matrix6::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&j);
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(&j);
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(&corner);
    out
}

/// `V⁻¹` of the logarithm of a rigid motion in the plane, and its derivative by the angle.
#[must_use]
pub fn log_se2_matrix(angle: f64) -> (Matrix2<f64>, Matrix2<f64>) {
    let half = 0.5 * angle;
    let a = 1.0 - angle * angle * half_cotangent(angle.abs());
    let da = if angle.abs() < 1e-3 {
        -angle / 6.0 - angle.powi(3) / 180.0
    } else {
        0.5 / half.tan() - 0.5 * half / half.sin().powi(2)
    };
    (Matrix2::new(a, half, -half, a), Matrix2::new(da, 0.5, -0.5, da))
}

/// The matrix of a turn in the plane.
#[must_use]
pub fn turn(angle_rad: f64) -> Matrix2<f64> {
    let (sin, cos) = angle_rad.sin_cos();
    Matrix2::new(cos, -sin, sin, cos)
}

/// A vector of the plane turned by a right angle to the left.
#[must_use]
pub fn perpendicular(v: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-v.y, v.x)
}
