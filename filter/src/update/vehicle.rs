//! A vehicle on wheels: odometer and non-holonomic constraint.
//!
//! The vehicle's forward, right and down axes are those of the body turned by a small pitch θ and yaw ψ: with the body
//! velocity u at the wheel, forward is `u_x + ψ u_y - θ u_z`, right `u_y - ψ u_x`, down `u_z + θ u_x`.

use nalgebra::{Matrix3, Vector3};

use super::{Motion, put};
use crate::kalman::{Measurement, SparseRow};
use crate::options::{ConstraintModel, OdometerModel};
use crate::state::{ATTITUDE, GYRO_BIAS, Layout, Nominal, VELOCITY};

/// Body velocity at a lever arm \[m/s\], with its derivatives by velocity, attitude and gyro bias.
fn body_velocity(nominal: &Nominal, lever_arm_m: &Vector3<f64>, motion: &Motion) -> (Vector3<f64>, [Matrix3<f64>; 3]) {
    let body_from_ned = nominal.nav.ned_from_body.to_rotation_matrix().matrix().transpose();
    let v = nominal.nav.velocity_ned_mps;
    let u = body_from_ned * v + motion.rate_body_radps.cross(lever_arm_m);
    // ω = measured - bias: a bias greater by δ makes ω × l smaller by δ × l
    (u, [body_from_ned, body_from_ned * v.cross_matrix(), lever_arm_m.cross_matrix()])
}

/// Weights of the body velocity in an axis of the vehicle, applied to the derivatives.
fn row_of(weights: &Vector3<f64>, [by_velocity, by_attitude, by_gyro]: &[Matrix3<f64>; 3]) -> SparseRow {
    let mut row = Vec::with_capacity(12);
    for (at, block) in [(VELOCITY, by_velocity), (ATTITUDE, by_attitude), (GYRO_BIAS, by_gyro)] {
        let of_block = weights.transpose() * block;
        put(&mut row, at, &Matrix3::from_rows(&[of_block, of_block, of_block]), 0);
    }
    row
}

/// A reading of the odometer: `z = (1 + s) u_forward`.
#[must_use]
pub fn odometer(
    nominal: &Nominal,
    layout: &Layout,
    speed_mps: f64,
    model: &OdometerModel,
    motion: &Motion,
    variance: f64,
) -> Measurement {
    let (u, derivatives) = body_velocity(nominal, &model.lever_arm_m, motion);
    let p = &nominal.parameters;
    let [pitch, yaw] = p.mounting_rad;
    let factor = 1.0 + p.odometer_scale;
    let weights = Vector3::new(1.0, yaw, -pitch);
    let forward = weights.dot(&u);
    let mut row = row_of(&(weights * factor), &derivatives);
    if let Some(at) = layout.odometer_scale {
        row.push((at, forward));
    }
    if let Some(at) = layout.mounting {
        row.push((at, -factor * u.z));
        row.push((at + 1, factor * u.y));
    }
    Measurement { residual: vec![speed_mps - factor * forward], rows: vec![row], noise: vec![variance] }
}

/// The non-holonomic constraint: right and down velocity are the slip, and nothing else.
#[must_use]
pub fn constraint(nominal: &Nominal, layout: &Layout, model: &ConstraintModel, motion: &Motion) -> Measurement {
    let (u, derivatives) = body_velocity(nominal, &model.lever_arm_m, motion);
    let p = &nominal.parameters;
    let [pitch, yaw] = p.mounting_rad;
    let right = Vector3::new(-yaw, 1.0, 0.0);
    let down = Vector3::new(pitch, 0.0, 1.0);
    let mut rows = vec![row_of(&right, &derivatives), row_of(&down, &derivatives)];
    if let Some(at) = layout.mounting {
        rows[0].push((at + 1, -u.x));
        rows[1].push((at, u.x));
    }
    if let Some(at) = layout.slip {
        rows[0].push((at, -1.0));
        rows[1].push((at + 1, -1.0));
    }
    let residual = vec![p.slip_mps[0] - right.dot(&u), p.slip_mps[1] - down.dot(&u)];
    let variance = model.noise_mps.powi(2);
    Measurement { residual, rows, noise: vec![variance, 0.0, 0.0, variance] }
}
