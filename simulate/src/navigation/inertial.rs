//! Inertial measurements: the integrals of what an ideal IMU feels, and the errors of a real one.

use nalgebra::Vector3;
use tieline_filter::strapdown::ImuErrors;
use tieline_filter::{ImuNoise, ImuSample};

use super::motion::Motion;
use super::process::{Correlated, normal3};
use crate::random::Random;

/// The IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuScenario {
    /// Errors; none for an ideal IMU.
    pub noise: Option<ImuNoise>,
    /// Samples a second.
    pub rate_hz: f64,
}

/// Abscissae on 0 to 1 and weights of the Gauss-Legendre quadrature with four points.
const QUADRATURE: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// Number of intervals of a rate in a span.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub(crate) fn count(span_s: f64, interval_s: f64) -> u32 {
    (span_s / interval_s + 1e-9).floor().max(0.0) as u32
}

/// The samples of an ideal IMU from one time to another.
#[must_use]
pub fn ideal_increments(motion: &Motion, (start_s, end_s): (f64, f64), rate_hz: f64) -> Vec<ImuSample> {
    let interval_s = 1.0 / rate_hz;
    (0..count(end_s - start_s, interval_s))
        .map(|k| {
            let from_s = start_s + f64::from(k) / rate_hz;
            let mut sample = ImuSample {
                time_s: start_s + f64::from(k + 1) / rate_hz,
                angle_rad: Vector3::zeros(),
                velocity_mps: Vector3::zeros(),
            };
            for (x, weight) in QUADRATURE {
                let rates = motion.body_rates(from_s + x * interval_s);
                sample.angle_rad += rates.rotation_radps * (weight * interval_s);
                sample.velocity_mps += rates.force_mps2 * (weight * interval_s);
            }
            sample
        })
        .collect()
}

/// Adds the errors of a grade to ideal samples; gives the errors after every sample.
///
/// Biases are a constant of the switch-on plus a stationary first-order Gauss-Markov process; scale errors are such a
/// process with the same correlation time, but an hour at least.
pub(crate) fn add_errors(samples: &mut [ImuSample], noise: &ImuNoise, rate_hz: f64, seed: u64) -> Vec<ImuErrors> {
    let mut random = Random::new(seed, &[21]);
    let interval_s = 1.0 / rate_hz;
    let beyond = (noise.switch_on.powi(2) - 1.0).max(0.0).sqrt();
    let gyro_constant = normal3(&mut random) * (noise.gyro_bias_radps * beyond);
    let accelerometer_constant = normal3(&mut random) * (noise.accelerometer_bias_mps2 * beyond);
    let scale_s = noise.correlation_s.max(3600.0);
    let mut processes = [noise.correlation_s, noise.correlation_s, scale_s, scale_s]
        .map(|correlation_s| Correlated::new(&mut random, correlation_s));
    let mut all = Vec::with_capacity(samples.len());
    for sample in samples {
        for p in &mut processes {
            p.advance(&mut random, interval_s);
        }
        let errors = ImuErrors {
            gyro_bias_radps: gyro_constant + processes[0].value * noise.gyro_bias_radps,
            accelerometer_bias_mps2: accelerometer_constant + processes[1].value * noise.accelerometer_bias_mps2,
            gyro_scale: processes[2].value * noise.gyro_scale,
            accelerometer_scale: processes[3].value * noise.accelerometer_scale,
        };
        let white = interval_s.sqrt();
        sample.angle_rad += sample.angle_rad.component_mul(&errors.gyro_scale)
            + errors.gyro_bias_radps * interval_s
            + normal3(&mut random) * (noise.angle_random_walk * white);
        sample.velocity_mps += sample.velocity_mps.component_mul(&errors.accelerometer_scale)
            + errors.accelerometer_bias_mps2 * interval_s
            + normal3(&mut random) * (noise.velocity_random_walk * white);
        all.push(errors);
    }
    all
}
