//! A whole simulation from one seed.

use nalgebra::Vector3;
use tieline_filter::imu::{Imu, ImuError};
use tieline_filter::strapdown::ImuErrors;
use tieline_filter::{ImuNoise, Inputs, NavState};

use super::aiding::{GnssScenario, OdometerScenario};
use super::inertial::{ImuScenario, add_errors, ideal_increments};
use super::motion::Motion;
use super::route::Vehicle;
use super::ties::{IncrementScenario, LoopScenario};

/// What is simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct NavigationScenario {
    /// Seed of everything random.
    pub seed: u64,
    /// First and last time \[s\].
    pub span_s: (f64, f64),
    /// What moves, and where.
    pub vehicle: Vehicle,
    /// IMU.
    pub imu: ImuScenario,
    /// GNSS.
    pub gnss: GnssScenario,
    /// Odometer, if there is one.
    pub odometer: Option<OdometerScenario>,
    /// Loop ties.
    pub loops: Vec<LoopScenario>,
    /// Height increments.
    pub increments: Vec<IncrementScenario>,
}

/// What the platform really did; the estimator never sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct NavigationTruth {
    /// The motion.
    pub motion: Motion,
    /// When each sample of the IMU ended \[s\], and its errors.
    pub imu_errors: Vec<(f64, ImuErrors)>,
}

/// Data and truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedNavigation {
    /// What the sensors deliver.
    pub inputs: Inputs,
    /// What was.
    pub truth: NavigationTruth,
}

impl NavigationScenario {
    /// A car with an IMU of a grade, 100 samples a second, and GNSS without outages.
    #[must_use]
    pub fn car(noise: ImuNoise, duration_s: f64, seed: u64) -> Self {
        Self {
            seed,
            span_s: (1000.0, 1000.0 + duration_s),
            vehicle: Vehicle::car(),
            imu: ImuScenario { noise: Some(noise), rate_hz: 100.0 },
            gnss: GnssScenario::default(),
            odometer: None,
            loops: Vec::new(),
            increments: Vec::new(),
        }
    }

    /// The true motion.
    #[must_use]
    pub fn motion(&self) -> Motion {
        self.vehicle.motion(self.span_s, self.seed)
    }

    /// Simulates.
    ///
    /// # Errors
    /// [`ImuError`] when the span is too short for two samples.
    pub fn simulate(&self) -> Result<SimulatedNavigation, ImuError> {
        let motion = self.motion();
        let mut samples = ideal_increments(&motion, self.span_s, self.imu.rate_hz);
        let errors = match &self.imu.noise {
            Some(noise) => add_errors(&mut samples, noise, self.imu.rate_hz, self.seed),
            None => vec![ImuErrors::default(); samples.len()],
        };
        let imu_errors = samples.iter().map(|s| s.time_s).zip(errors).collect();
        let gnss = self.gnss.fixes(&motion, self.span_s, self.seed);
        let odometer = self.odometer.map_or_else(Vec::new, |o| o.readings(&motion, self.span_s, self.seed));
        let mut ties = Vec::new();
        for (k, scenario) in (0_u64..).zip(&self.loops) {
            ties.extend(scenario.ties(&motion, ties.len() as u64, self.seed.wrapping_add(k << 32)));
        }
        for (k, scenario) in (0_u64..).zip(&self.increments) {
            ties.extend(scenario.ties(&motion, ties.len() as u64, self.seed.wrapping_add(k << 32)));
        }
        let inputs = Inputs { imu: Imu::new(samples)?, gnss, odometer, points: Vec::new(), ties };
        Ok(SimulatedNavigation { inputs, truth: NavigationTruth { motion, imu_errors } })
    }
}

impl NavigationTruth {
    /// The pose at a time.
    #[must_use]
    pub fn nav_at(&self, time_s: f64) -> NavState {
        self.motion.nav_at(time_s)
    }

    /// Errors of the IMU in the sample that holds a time.
    #[must_use]
    pub fn imu_errors_at(&self, time_s: f64) -> ImuErrors {
        let next = self.imu_errors.partition_point(|e| e.0 < time_s).min(self.imu_errors.len().saturating_sub(1));
        self.imu_errors.get(next).map_or_else(ImuErrors::default, |e| e.1)
    }

    /// True minus estimated pose: position \[m\] and attitude \[rad\], north, east, down.
    #[must_use]
    pub fn error_of(&self, estimate: &NavState) -> (Vector3<f64>, Vector3<f64>) {
        let (position, _, attitude) = tieline_filter::state::nav_minus(&self.nav_at(estimate.time_s), estimate);
        (position, attitude)
    }
}
