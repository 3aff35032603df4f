//! GNSS fixes and odometer readings.

use nalgebra::{Matrix3, Vector3};
use tieline_filter::earth::{geodetic_from_ecef, ned_from_ecef};
use tieline_filter::{FixQuality, GnssFix, GnssVelocity, OdometerSample};

use super::inertial::count;
use super::motion::Motion;
use super::process::{Correlated, normal3};
use crate::random::Random;

/// GNSS.
#[derive(Debug, Clone, PartialEq)]
pub struct GnssScenario {
    /// Interval between fixes \[s\].
    pub interval_s: f64,
    /// Standard deviation north, east, down \[m\]: stated and true.
    pub sigma_ned_m: Vector3<f64>,
    /// Share of the variance that is correlated over time.
    pub correlated_share: f64,
    /// Its correlation time \[s\].
    pub correlation_s: f64,
    /// From the IMU to the antenna, body axes \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// Standard deviation of velocities, each axis \[m/s\], when the receiver gives them.
    pub velocity_sigma_mps: Option<f64>,
    /// A fix stamped t was measured at t plus this, on the clock of the IMU \[s\].
    pub delay_s: f64,
    /// Outages: no fix later than the first time and up to the second \[s\].
    pub outages_s: Vec<(f64, f64)>,
    /// Share of fixes that are blunders, and their size \[m\].
    pub blunders: (f64, f64),
}

impl Default for GnssScenario {
    fn default() -> Self {
        Self {
            interval_s: 1.0,
            sigma_ned_m: Vector3::new(0.01, 0.01, 0.02),
            correlated_share: 0.5,
            correlation_s: 100.0,
            lever_arm_m: Vector3::new(0.3, -0.2, -1.1),
            velocity_sigma_mps: None,
            delay_s: 0.0,
            outages_s: Vec::new(),
            blunders: (0.0, 0.0),
        }
    }
}

/// The odometer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometerScenario {
    /// Interval between readings \[s\].
    pub interval_s: f64,
    /// It reads (1 + this) times the speed.
    pub scale: f64,
    /// White noise of a reading \[m/s\].
    pub noise_mps: f64,
    /// From the IMU to the wheel, body axes \[m\].
    pub lever_arm_m: Vector3<f64>,
}

impl GnssScenario {
    /// The fixes of a motion.
    #[must_use]
    pub fn fixes(&self, motion: &Motion, (start_s, end_s): (f64, f64), seed: u64) -> Vec<GnssFix> {
        let mut random = Random::new(seed, &[31]);
        let mut correlated = Correlated::new(&mut random, self.correlation_s);
        let mut fixes = Vec::new();
        for k in 1..=count(end_s - start_s, self.interval_s) {
            correlated.advance(&mut random, self.interval_s);
            let white = normal3(&mut random);
            let slow = normal3(&mut random);
            let (is_blunder, blunder) = (random.uniform() < self.blunders.0, normal3(&mut random).normalize());
            let time_s = start_s + f64::from(k) * self.interval_s;
            if self.outages_s.iter().any(|(a, b)| time_s > *a && time_s <= *b) {
                continue;
            }
            let measured_s = time_s + self.delay_s;
            let ecef_from_body = motion.ecef_from_body(measured_s);
            let nav = motion.nav_at(measured_s);
            let ned_from_ecef = ned_from_ecef(nav.geodetic.x, nav.geodetic.y);
            let mut error = (white * (1.0 - self.correlated_share).sqrt()
                + correlated.value * self.correlated_share.sqrt())
            .component_mul(&self.sigma_ned_m);
            if is_blunder {
                error += blunder * self.blunders.1;
            }
            let antenna =
                motion.ecef_m(measured_s) + ecef_from_body * self.lever_arm_m + ned_from_ecef.transpose() * error;
            let turning = motion.rotation_against_earth_radps(measured_s).cross(&self.lever_arm_m);
            let velocity = self.velocity_sigma_mps.map(|sigma| GnssVelocity {
                ned_mps: nav.velocity_ned_mps + ned_from_ecef * ecef_from_body * turning + slow * sigma,
                covariance_m2ps2: Matrix3::identity() * (sigma * sigma),
            });
            fixes.push(GnssFix {
                time_s,
                geodetic: geodetic_from_ecef(&antenna),
                covariance_ned_m2: Matrix3::from_diagonal(&self.sigma_ned_m.map(|s| s * s)),
                velocity,
                quality: FixQuality::Fixed,
            });
        }
        fixes
    }
}

impl OdometerScenario {
    /// The readings of a motion.
    #[must_use]
    pub fn readings(&self, motion: &Motion, (start_s, end_s): (f64, f64), seed: u64) -> Vec<OdometerSample> {
        let mut random = Random::new(seed, &[41]);
        (1..=count(end_s - start_s, self.interval_s))
            .map(|k| {
                let time_s = start_s + f64::from(k) * self.interval_s;
                let wheel = motion.velocity_body_mps(time_s)
                    + motion.rotation_against_earth_radps(time_s).cross(&self.lever_arm_m);
                let speed_mps = (1.0 + self.scale) * wheel.x + self.noise_mps * random.normal();
                OdometerSample { time_s, speed_mps }
            })
            .collect()
    }
}
