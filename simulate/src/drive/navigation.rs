//! What IMU, GNSS and odometer deliver, rounded as in their files, and the trajectory that our own smoother makes of it:
//! the one the user is given.

use nalgebra::{Matrix3, Vector3};
use tieline_filter::earth::{geodetic_from_ecef, ned_from_ecef};
use tieline_filter::options::{ConstraintModel, OdometerModel};
use tieline_filter::{
    FixQuality, GnssFix, Imu, Inputs, OdometerSample, Options, PositionFrame, Smoother, Solution, Trajectory,
};

use super::motion::Driven;
use super::scenario::DriveScenario;
use crate::error::SimulateError;
use crate::navigation::inertial::{add_errors, count};
use crate::navigation::process::{Correlated, normal3};
use crate::navigation::{Motion, OdometerScenario, ideal_increments};
use crate::random::Random;

/// Decimals of latitude and longitude \[deg\] and of heights and sigmas \[m\] in the file of GNSS.
pub(super) const ANGLE_DECIMALS: usize = 10;
pub(super) const LENGTH_DECIMALS: usize = 4;
/// Decimals of speeds \[m/s\] in the file of the odometer.
pub(super) const SPEED_DECIMALS: usize = 4;

/// What the sensors deliver.
///
/// # Errors
/// [`SimulateError::Imu`] when the drive is too short for two samples.
pub(super) fn inputs(scenario: &DriveScenario, driven: &Driven) -> Result<Inputs, SimulateError> {
    let (motion, span_s) = (&driven.motion, driven.span_s);
    let rate_hz = scenario.imu.rate_hz;
    let mut samples = ideal_increments(motion, span_s, rate_hz);
    add_errors(&mut samples, &scenario.imu_noise()?, rate_hz, scenario.seed);
    for sample in &mut samples {
        let digits = scenario.imu.digits;
        sample.angle_rad.iter_mut().chain(sample.velocity_mps.iter_mut()).for_each(|v| *v = significant(*v, digits));
        sample.time_s = decimals(sample.time_s, 6);
    }
    let odometer = match scenario.odometer.used {
        true => readings(scenario, driven),
        false => Vec::new(),
    };
    Ok(Inputs {
        imu: Imu::new(samples)?,
        gnss: fixes(scenario, motion, span_s),
        odometer,
        points: Vec::new(),
        ties: Vec::new(),
    })
}

/// A number as it stands in a file, with so many significant digits.
fn significant(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

/// A number as it stands in a file, with so many decimals.
fn decimals(value: f64, decimals: usize) -> f64 {
    format!("{value:.decimals$}").parse().unwrap_or(value)
}

/// Stated standard deviations of the fixes: white and correlated noise together \[m\].
pub(super) fn stated_sigma_m(scenario: &DriveScenario) -> Vector3<f64> {
    let (white, slow) = (Vector3::from(scenario.gnss.white_m), Vector3::from(scenario.gnss.correlated_m));
    white.zip_map(&slow, f64::hypot)
}

/// Share of the variance of a fix that is correlated, in the plane.
pub(super) fn correlated_share(scenario: &DriveScenario) -> f64 {
    let slow = scenario.gnss.correlated_m;
    let part = slow[0] * slow[0] + slow[1] * slow[1];
    let all = stated_sigma_m(scenario).xy().norm_squared();
    decimals(part / all, 4)
}

fn fixes(scenario: &DriveScenario, motion: &Motion, (start_s, end_s): (f64, f64)) -> Vec<GnssFix> {
    let options = &scenario.gnss;
    let mut random = Random::new(scenario.seed, &[31]);
    let mut slow = Correlated::new(&mut random, options.correlation_s);
    let lever_arm_m = Vector3::from(options.lever_arm_m);
    let sigma_m = stated_sigma_m(scenario).map(|s| decimals(s, LENGTH_DECIMALS));
    let interval_s = 1.0 / options.rate_hz;
    let mut fixes = Vec::new();
    for k in 1..=count(end_s - start_s, interval_s) {
        slow.advance(&mut random, interval_s);
        let error_m = normal3(&mut random).component_mul(&Vector3::from(options.white_m))
            + slow.value.component_mul(&Vector3::from(options.correlated_m));
        let since_s = f64::from(k) / options.rate_hz;
        if options.outages.iter().any(|o| since_s > o.start_s && since_s <= o.start_s + o.length_s) {
            continue;
        }
        let time_s = decimals(start_s + since_s, 3);
        let nav = motion.nav_at(time_s);
        let ned_from_ecef = ned_from_ecef(nav.geodetic.x, nav.geodetic.y);
        let antenna =
            motion.ecef_m(time_s) + motion.ecef_from_body(time_s) * lever_arm_m + ned_from_ecef.transpose() * error_m;
        let place = geodetic_from_ecef(&antenna);
        let angle = |rad: f64| decimals(rad.to_degrees(), ANGLE_DECIMALS).to_radians();
        fixes.push(GnssFix {
            time_s,
            geodetic: Vector3::new(angle(place.x), angle(place.y), decimals(place.z, LENGTH_DECIMALS)),
            covariance_ned_m2: Matrix3::from_diagonal(&sigma_m.map(|s| s * s)),
            velocity: None,
            quality: FixQuality::Fixed,
        });
    }
    fixes
}

fn readings(scenario: &DriveScenario, driven: &Driven) -> Vec<OdometerSample> {
    let options = &scenario.odometer;
    let odometer = OdometerScenario {
        interval_s: 1.0 / options.rate_hz,
        scale: options.scale_error,
        noise_mps: options.noise_mps,
        lever_arm_m: Vector3::from(options.lever_arm_m),
    };
    let mut readings = odometer.readings(&driven.motion, driven.span_s, scenario.seed);
    for reading in &mut readings {
        reading.time_s = decimals(reading.time_s, 4);
        reading.speed_mps = decimals(reading.speed_mps, SPEED_DECIMALS);
    }
    readings
}

/// What the user's project file tells the smoother.
fn smoother_options(scenario: &DriveScenario) -> Result<Options, SimulateError> {
    let mut options = Options::new(scenario.imu_noise()?);
    options.gnss.lever_arm_m = Vector3::from(scenario.gnss.lever_arm_m);
    options.gnss.correlated_share = correlated_share(scenario);
    options.gnss.correlation_s = scenario.gnss.correlation_s;
    options.odometer = scenario.odometer.used.then(|| OdometerModel {
        lever_arm_m: Vector3::from(scenario.odometer.lever_arm_m),
        noise_mps: scenario.odometer.noise_mps,
        scale_sigma: scenario.odometer.scale_sd,
    });
    options.constraint = scenario.vehicle.constrained.then(|| ConstraintModel {
        lever_arm_m: Vector3::from(scenario.vehicle.axle_lever_arm_m),
        ..ConstraintModel::default()
    });
    Ok(options)
}

/// The smoother's trajectory with its own standard deviations, thinned to the rate of the file.
///
/// # Errors
/// [`SimulateError::Smoother`] when the data do not make a trajectory.
pub(super) fn delivered(scenario: &DriveScenario, inputs: &Inputs) -> Result<Trajectory, SimulateError> {
    let solution: Solution = Smoother::run(inputs, &smoother_options(scenario)?)?;
    let is_thinned = scenario.output.trajectory_rate_hz < scenario.imu.rate_hz;
    let interval_s = if is_thinned { 1.0 / scenario.output.trajectory_rate_hz } else { 0.0 };
    Ok(solution.trajectory(inputs, interval_s)?)
}

/// The true poses at the epochs of a trajectory.
///
/// # Errors
/// Never: the epochs were those of a trajectory.
pub(super) fn truth_at(motion: &Motion, epochs: &Trajectory) -> Result<Trajectory, SimulateError> {
    let states: Vec<_> = epochs.time_s().iter().map(|t| motion.nav_at(*t)).collect();
    Ok(Trajectory::new(
        PositionFrame::Geodetic,
        epochs.time_s().to_vec(),
        states.iter().map(|s| s.geodetic).collect(),
        states.iter().map(|s| s.ned_from_body).collect(),
        states.iter().map(|s| s.velocity_ned_mps).collect(),
    )?)
}
