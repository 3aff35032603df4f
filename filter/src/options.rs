//! What the smoother is told beside the measurements.

use nalgebra::Vector3;

use crate::grade::ImuNoise;
use crate::state::{
    ACCELEROMETER_BIAS, ACCELEROMETER_SCALE, ATTITUDE, GYRO_BIAS, GYRO_SCALE, Layout, NAV, Optional, POSITION,
    Parameters, VELOCITY,
};
use crate::strapdown::NavState;

/// How GNSS positions err.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssModel {
    /// From the IMU to the antenna, body axes \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// Its standard deviation, each axis \[m\]; above zero it is estimated.
    pub lever_arm_sigma_m: f64,
    /// Share of the stated variance that is correlated over time, 0 to 1.
    pub correlated_share: f64,
    /// Correlation time of that share \[s\].
    pub correlation_s: f64,
    /// Least standard deviation of a fix, each axis \[m\]: a receiver's own figure does not know its multipath.
    pub least_sigma_m: f64,
    /// Factor on the stated standard deviations.
    pub sigma_factor: f64,
    /// Delay of positions against the IMU \[s\] and its standard deviation; above zero it is estimated.
    pub delay_s: (f64, f64),
    /// Delay of velocities against the IMU \[s\] and its standard deviation; above zero it is estimated.
    pub velocity_delay_s: (f64, f64),
    /// Whether velocities are used.
    pub use_velocity: bool,
    /// Least standard deviation of a velocity, each axis \[m/s\].
    pub least_velocity_sigma_mps: f64,
}

impl Default for GnssModel {
    fn default() -> Self {
        Self {
            lever_arm_m: Vector3::zeros(),
            lever_arm_sigma_m: 0.0,
            correlated_share: 0.2,
            correlation_s: 100.0,
            least_sigma_m: 0.003,
            sigma_factor: 1.0,
            delay_s: (0.0, 0.0),
            velocity_delay_s: (0.0, 0.0),
            use_velocity: true,
            least_velocity_sigma_mps: 0.01,
        }
    }
}

/// The odometer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometerModel {
    /// From the IMU to the wheel, body axes \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// White noise of a reading \[m/s\].
    pub noise_mps: f64,
    /// Standard deviation of the scale error.
    pub scale_sigma: f64,
}

/// A vehicle that neither slides nor jumps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstraintModel {
    /// From the IMU to the axle that does not steer, body axes \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// Standard deviation of the velocity to the right and down \[m/s\]: a car slides a little in every bend, for a
    /// second or more; it is a state of its own, not white noise.
    pub slip_sigma_mps: [f64; 2],
    /// Correlation time of the slip \[s\].
    pub slip_correlation_s: f64,
    /// White noise beside it \[m/s\].
    pub noise_mps: f64,
    /// Standard deviation of pitch and yaw of the vehicle in the body frame \[rad\].
    pub mounting_sigma_rad: f64,
    /// Interval between constraints \[s\].
    pub interval_s: f64,
}

impl Default for ConstraintModel {
    fn default() -> Self {
        Self {
            lever_arm_m: Vector3::zeros(),
            slip_sigma_mps: [0.04, 0.04],
            slip_correlation_s: 1.0,
            noise_mps: 0.01,
            mounting_sigma_rad: 2.0_f64.to_radians(),
            interval_s: 0.5,
        }
    }
}

/// A platform at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandstillModel {
    /// Standard deviation of the velocity \[m/s\].
    pub velocity_sigma_mps: f64,
    /// Standard deviation of a change of attitude during the rest, each axis \[rad\].
    pub sway_rad: f64,
    /// Interval between updates \[s\].
    pub interval_s: f64,
}

impl Default for StandstillModel {
    fn default() -> Self {
        Self { velocity_sigma_mps: 0.005, sway_rad: 0.01_f64.to_radians(), interval_s: 1.0 }
    }
}

/// In which form ties enter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TieForm {
    /// A landmark enters the state with its first sighting and leaves with its last (EKF-SLAM).
    #[default]
    Landmark,
    /// Every sighting but the last leaves a clone; the last compares them all at once (delayed state).
    Delayed,
}

/// Ties.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TieModel {
    /// Most landmark and clone states alive at one time.
    pub most_live: usize,
    /// Form.
    pub form: TieForm,
}

impl Default for TieModel {
    fn default() -> Self {
        Self { most_live: 64, form: TieForm::Landmark }
    }
}

/// Where the trajectory begins, with standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InitialState {
    /// Pose at the beginning.
    pub nav: NavState,
    /// Position north, east, down \[m\].
    pub position_sigma_m: Vector3<f64>,
    /// Velocity north, east, down \[m/s\].
    pub velocity_sigma_mps: Vector3<f64>,
    /// Attitude about north, east, down \[rad\].
    pub attitude_sigma_rad: Vector3<f64>,
    /// Biases that the beginning gave away (zero where nothing is known).
    pub gyro_bias_radps: Vector3<f64>,
}

/// Everything.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Noise of the IMU.
    pub noise: ImuNoise,
    /// GNSS.
    pub gnss: GnssModel,
    /// Odometer, when its readings are to be used.
    pub odometer: Option<OdometerModel>,
    /// Non-holonomic constraint, when the platform is a vehicle on wheels.
    pub constraint: Option<ConstraintModel>,
    /// Zero velocity and rotation at rest.
    pub standstill: Option<StandstillModel>,
    /// Ties.
    pub ties: TieModel,
    /// Probability that a good measurement is down-weighted.
    pub false_alarm: f64,
    /// Longest interval between stored nodes \[s\].
    pub node_interval_s: f64,
    /// Covariance beforehand of the constants that sightings of ties depend on, row-major, each in a unit of its own; they
    /// are estimated together with the trajectory. See [`crate::Sighting::by_constant`].
    pub calibration_covariance: Vec<f64>,
    /// Longest step of the covariance \[s\].
    pub step_s: f64,
    /// Most runs over the data.
    pub most_runs: usize,
    /// Bytes kept in memory before records are spilled to a temporary file.
    pub memory_bytes: usize,
}

impl Options {
    /// Everything by default for an IMU.
    #[must_use]
    pub fn new(noise: ImuNoise) -> Self {
        Self {
            noise,
            gnss: GnssModel::default(),
            odometer: None,
            constraint: None,
            standstill: Some(StandstillModel::default()),
            ties: TieModel::default(),
            false_alarm: 1e-4,
            node_interval_s: 1.0,
            calibration_covariance: Vec::new(),
            step_s: 0.05,
            most_runs: 10,
            memory_bytes: 256 << 20,
        }
    }

    /// The states that follow from it.
    #[must_use]
    pub fn layout(&self) -> Layout {
        Layout::new(&Optional {
            gnss_lever_arm: self.gnss.lever_arm_sigma_m > 0.0,
            gnss_error: self.gnss.correlated_share > 0.0,
            gnss_delay: self.gnss.delay_s.1 > 0.0,
            velocity_delay: self.gnss.velocity_delay_s.1 > 0.0,
            odometer_scale: self.odometer.is_some_and(|o| o.scale_sigma > 0.0),
            mounting: self.odometer.is_some() || self.constraint.is_some(),
            slip: self.constraint.is_some(),
            calibration: self.calibration_covariance.len().isqrt(),
        })
    }

    /// Parameters at the beginning.
    #[must_use]
    pub fn parameters(&self, initial: &InitialState) -> Parameters {
        let mut parameters = Parameters {
            gnss_lever_arm_m: self.gnss.lever_arm_m,
            gnss_delay_s: self.gnss.delay_s.0,
            velocity_delay_s: self.gnss.velocity_delay_s.0,
            ..Parameters::default()
        };
        parameters.imu.gyro_bias_radps = initial.gyro_bias_radps;
        parameters
    }

    /// Variances of the errors at the beginning, one a state of the layout, in the squares of the states' units: of the pose as
    /// `initial` says, of the sensors as their models do. The correlated GNSS error counts in standard deviations of a fix.
    #[must_use]
    pub fn initial_variances(&self, layout: &Layout, initial: &InitialState) -> Vec<f64> {
        let mut sigma = vec![0.0; layout.base];
        let mut three = |at: usize, s: &Vector3<f64>| sigma[at..at + 3].copy_from_slice(s.as_slice());
        three(POSITION, &initial.position_sigma_m);
        three(VELOCITY, &initial.velocity_sigma_mps);
        three(ATTITUDE, &initial.attitude_sigma_rad);
        let switch_on = self.noise.switch_on.max(1.0);
        three(GYRO_BIAS, &Vector3::repeat(self.noise.gyro_bias_radps * switch_on));
        three(ACCELEROMETER_BIAS, &Vector3::repeat(self.noise.accelerometer_bias_mps2 * switch_on));
        three(GYRO_SCALE, &Vector3::repeat(self.noise.gyro_scale));
        three(ACCELEROMETER_SCALE, &Vector3::repeat(self.noise.accelerometer_scale));
        if let Some(at) = layout.gnss_lever_arm {
            three(at, &Vector3::repeat(self.gnss.lever_arm_sigma_m));
        }
        if let Some(at) = layout.gnss_error {
            three(at, &Vector3::repeat(1.0));
        }
        let mut one = |at: Option<usize>, s: f64| {
            if let Some(at) = at {
                sigma[at] = s;
            }
        };
        one(layout.gnss_delay, self.gnss.delay_s.1);
        one(layout.velocity_delay, self.gnss.velocity_delay_s.1);
        one(layout.odometer_scale, self.odometer.map_or(0.0, |o| o.scale_sigma));
        let mounting = self.constraint.unwrap_or_default().mounting_sigma_rad;
        let slip = self.constraint.unwrap_or_default().slip_sigma_mps;
        for (k, slip) in slip.into_iter().enumerate() {
            one(layout.mounting.map(|at| at + k), mounting);
            one(layout.slip.map(|at| at + k), slip);
        }
        if let Some(at) = layout.calibration {
            let count = layout.base - at;
            for (k, s) in sigma[at..].iter_mut().enumerate() {
                *s = self.calibration_covariance[k * (count + 1)].sqrt();
            }
        }
        sigma.iter().map(|s| s * s).collect()
    }

    /// How each state from the gyro biases on changes by itself.
    #[must_use]
    pub fn processes(&self, layout: &Layout) -> Vec<Process> {
        let mut processes = vec![Process::Constant; layout.base - NAV];
        let mut put = |at: usize, count: usize, process: Process| processes[at - NAV..at - NAV + count].fill(process);
        let n = &self.noise;
        let bias = |sigma: f64| {
            // what the switch-on adds does not decay: a random walk of the same strength about it
            if n.switch_on > 1.0 {
                Process::Walk { variance_per_s: 2.0 * sigma * sigma / n.correlation_s }
            } else {
                Process::GaussMarkov { sigma, correlation_s: n.correlation_s }
            }
        };
        put(GYRO_BIAS, 3, bias(n.gyro_bias_radps));
        put(ACCELEROMETER_BIAS, 3, bias(n.accelerometer_bias_mps2));
        // scale errors are those of the build: they change over hours, however fast the biases wander
        let hours_s = n.correlation_s.max(3600.0);
        put(GYRO_SCALE, 3, Process::GaussMarkov { sigma: n.gyro_scale, correlation_s: hours_s });
        put(ACCELEROMETER_SCALE, 3, Process::GaussMarkov { sigma: n.accelerometer_scale, correlation_s: hours_s });
        if let Some(at) = layout.gnss_error {
            put(at, 3, Process::GaussMarkov { sigma: 1.0, correlation_s: self.gnss.correlation_s });
        }
        if let (Some(at), Some(c)) = (layout.slip, self.constraint) {
            for (k, sigma) in c.slip_sigma_mps.into_iter().enumerate() {
                put(at + k, 1, Process::GaussMarkov { sigma, correlation_s: c.slip_correlation_s });
            }
        }
        processes
    }
}

/// How a state changes by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Process {
    /// Not at all.
    Constant,
    /// First-order Gauss-Markov.
    GaussMarkov {
        /// Standard deviation.
        sigma: f64,
        /// Correlation time \[s\].
        correlation_s: f64,
    },
    /// Random walk.
    Walk {
        /// Variance gained a second.
        variance_per_s: f64,
    },
}

impl Process {
    /// Factor of the state and variance gained over an interval \[s\].
    #[must_use]
    pub fn over(&self, interval_s: f64) -> (f64, f64) {
        match *self {
            Self::Constant => (1.0, 0.0),
            Self::GaussMarkov { sigma, correlation_s } => {
                let factor = (-interval_s / correlation_s).exp();
                (factor, sigma * sigma * (1.0 - factor * factor))
            }
            Self::Walk { variance_per_s } => (1.0, variance_per_s * interval_s),
        }
    }
}
