//! GNSS position and velocity, and known points.

use nalgebra::{Matrix3, Vector3};

use super::{Motion, put, row_major};
use crate::aiding::{GnssFix, GnssVelocity, KnownPoint};
use crate::earth::{ecef_from_geodetic, ned_from_ecef};
use crate::kalman::Measurement;
use crate::options::GnssModel;
use crate::state::{ATTITUDE, GYRO_BIAS, Layout, Nominal, POSITION, VELOCITY};

/// Offset north, east, down \[m\] from the nominal position to a place.
fn offset_ned_m(nominal: &Nominal, geodetic: &Vector3<f64>) -> Vector3<f64> {
    let here = &nominal.nav.geodetic;
    ned_from_ecef(here.x, here.y) * (ecef_from_geodetic(geodetic) - ecef_from_geodetic(here))
}

/// Covariance of a fix as the filter takes it: the factor and the least standard deviation of the model applied.
#[must_use]
pub fn covariance_of(fix: &GnssFix, model: &GnssModel) -> Matrix3<f64> {
    let mut covariance = fix.covariance_ned_m2 * model.sigma_factor.powi(2);
    for k in 0..3 {
        covariance[(k, k)] = covariance[(k, k)].max(model.least_sigma_m.powi(2));
    }
    covariance
}

/// A GNSS position: `z = p + C l + c + v τ`, with the lever arm l, the correlated error c and the delay τ. The event
/// takes place `event_delay_s` after the stamp; what the delay is estimated beyond that enters with the velocity.
#[must_use]
pub fn position(
    nominal: &Nominal,
    layout: &Layout,
    fix: &GnssFix,
    model: &GnssModel,
    motion: &Motion,
    event_delay_s: f64,
) -> Measurement {
    let c = *nominal.nav.ned_from_body.to_rotation_matrix().matrix();
    let p = &nominal.parameters;
    let lever_ned = c * p.gnss_lever_arm_m;
    let antenna_velocity = nominal.nav.velocity_ned_mps + c * motion.rate_body_radps.cross(&p.gnss_lever_arm_m);
    let covariance = covariance_of(fix, model);
    let share = if layout.gnss_error.is_some() { model.correlated_share } else { 0.0 };
    let sigma = covariance.diagonal().map(|v| (v * share).sqrt());
    let late_s = p.gnss_delay_s - event_delay_s;
    let residual = offset_ned_m(nominal, &fix.geodetic)
        - lever_ned
        - p.gnss_error_ned.component_mul(&sigma)
        - antenna_velocity * late_s;
    let by_attitude = -lever_ned.cross_matrix();
    let rows = (0..3)
        .map(|i| {
            let mut row = vec![(POSITION + i, 1.0)];
            put(&mut row, ATTITUDE, &by_attitude, i);
            if let Some(at) = layout.gnss_lever_arm {
                put(&mut row, at, &c, i);
            }
            if let Some(at) = layout.gnss_error {
                row.push((at + i, sigma[i]));
            }
            if let Some(at) = layout.gnss_delay {
                row.push((at, antenna_velocity[i]));
                row.push((VELOCITY + i, late_s));
            }
            row
        })
        .collect();
    Measurement { residual: residual.iter().copied().collect(), rows, noise: row_major(&(covariance * (1.0 - share))) }
}

/// A GNSS velocity: `z = v + C (ω × l) + a τ`.
#[must_use]
pub fn velocity(
    nominal: &Nominal,
    layout: &Layout,
    measured: &GnssVelocity,
    model: &GnssModel,
    motion: &Motion,
    event_delay_s: f64,
) -> Measurement {
    let c = *nominal.nav.ned_from_body.to_rotation_matrix().matrix();
    let p = &nominal.parameters;
    let swing = c * motion.rate_body_radps.cross(&p.gnss_lever_arm_m);
    let late_s = p.velocity_delay_s - event_delay_s;
    let residual = measured.ned_mps - nominal.nav.velocity_ned_mps - swing - motion.acceleration_ned_mps2 * late_s;
    let by_attitude = -swing.cross_matrix();
    let by_gyro = c * p.gnss_lever_arm_m.cross_matrix();
    let by_lever = c * motion.rate_body_radps.cross_matrix();
    let rows = (0..3)
        .map(|i| {
            let mut row = vec![(VELOCITY + i, 1.0)];
            put(&mut row, ATTITUDE, &by_attitude, i);
            put(&mut row, GYRO_BIAS, &by_gyro, i);
            if let Some(at) = layout.gnss_lever_arm {
                put(&mut row, at, &by_lever, i);
            }
            if let Some(at) = layout.velocity_delay {
                row.push((at, motion.acceleration_ned_mps2[i]));
            }
            row
        })
        .collect();
    let mut covariance = measured.covariance_m2ps2 * model.sigma_factor.powi(2);
    for k in 0..3 {
        covariance[(k, k)] = covariance[(k, k)].max(model.least_velocity_sigma_mps.powi(2));
    }
    Measurement { residual: residual.iter().copied().collect(), rows, noise: row_major(&covariance) }
}

/// A point of the platform whose place is known.
#[must_use]
pub fn known_point(nominal: &Nominal, point: &KnownPoint) -> Measurement {
    let c = *nominal.nav.ned_from_body.to_rotation_matrix().matrix();
    let lever_ned = c * point.body_vector_m;
    let residual = offset_ned_m(nominal, &point.geodetic) - lever_ned;
    let by_attitude = -lever_ned.cross_matrix();
    let rows = (0..3)
        .map(|i| {
            let mut row = vec![(POSITION + i, 1.0)];
            put(&mut row, ATTITUDE, &by_attitude, i);
            row
        })
        .collect();
    Measurement { residual: residual.iter().copied().collect(), rows, noise: row_major(&point.covariance_ned_m2) }
}
