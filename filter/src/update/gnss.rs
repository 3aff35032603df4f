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

/// Standard deviations \[m\] that the correlated error of each fix is counted in: those of the correlated share of the
/// variances that fixes within a correlation time state, in their geometric mean.
///
/// The stated ones themselves will not do. They change from fix to fix, an error that is correlated does not; counted in
/// them it would show by how residuals go with them, and be told from the position by what is noise.
#[must_use]
pub fn correlated_sigmas_m(fixes: &[GnssFix], model: &GnssModel) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros()];
    for fix in fixes {
        let log = covariance_of(fix, model).diagonal().map(|v| v.max(f64::MIN_POSITIVE).ln());
        sums.push(sums[sums.len() - 1] + log);
    }
    let (mut from, mut to) = (0, 0);
    fixes
        .iter()
        .map(|fix| {
            while fixes[from].time_s < fix.time_s - model.correlation_s {
                from += 1;
            }
            while to < fixes.len() && fixes[to].time_s <= fix.time_s + model.correlation_s {
                to += 1;
            }
            #[allow(clippy::cast_precision_loss)] // far below 2^52
            let mean = (sums[to] - sums[from]) / (to - from).max(1) as f64;
            mean.map(|log| (model.correlated_share * log.exp()).sqrt())
        })
        .collect()
}

/// A GNSS position: `z = p + C l + c + v τ`, with the lever arm l, the correlated error c and the delay τ. The event
/// takes place `event_delay_s` after the stamp; what the delay is estimated beyond that enters with the velocity.
/// `correlated_sigma_m`: what the correlated error is counted in ([`correlated_sigmas_m`]).
#[must_use]
pub fn position(
    nominal: &Nominal,
    layout: &Layout,
    fix: &GnssFix,
    model: &GnssModel,
    correlated_sigma_m: &Vector3<f64>,
    motion: &Motion,
    event_delay_s: f64,
) -> Measurement {
    let c = *nominal.nav.ned_from_body.to_rotation_matrix().matrix();
    let p = &nominal.parameters;
    let lever_ned = c * p.gnss_lever_arm_m;
    let antenna_velocity = nominal.nav.velocity_ned_mps + c * motion.rate_body_radps.cross(&p.gnss_lever_arm_m);
    let covariance = covariance_of(fix, model);
    let share = if layout.gnss_error.is_some() { model.correlated_share } else { 0.0 };
    let sigma = correlated_sigma_m;
    let late_s = p.gnss_delay_s - event_delay_s;
    let residual = offset_ned_m(nominal, &fix.geodetic)
        - lever_ned
        - p.gnss_error_ned.component_mul(sigma)
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

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(time_s: f64, sigma_m: f64) -> GnssFix {
        GnssFix {
            time_s,
            geodetic: Vector3::zeros(),
            covariance_ned_m2: Matrix3::from_diagonal_element(sigma_m * sigma_m),
            velocity: None,
            quality: crate::aiding::FixQuality::Fixed,
        }
    }

    #[test]
    fn what_the_correlated_error_is_counted_in_follows_the_level_and_not_each_fix() {
        let stated = |k: u32| if k.is_multiple_of(2) { 0.011 } else { 0.009 };
        let mut fixes: Vec<GnssFix> = (0..2000).map(|k| fix(f64::from(k), stated(k))).collect();
        fixes.extend((2000..4000).map(|k| fix(f64::from(k), 10.0 * stated(k))));
        let model = GnssModel { correlated_share: 0.25, ..GnssModel::default() };
        let sigma_m = correlated_sigmas_m(&fixes, &model);
        for k in 1..4000 {
            let level_m = if k < 2000 { 0.005 } else { 0.05 };
            if !(1850..2150).contains(&k) {
                assert!((sigma_m[k].x / level_m - 1.0).abs() < 0.01, "{k}: {}", sigma_m[k].x);
            }
            assert!((sigma_m[k].x / sigma_m[k - 1].x - 1.0).abs() < 0.03, "{k}: no jump");
        }
    }
}
