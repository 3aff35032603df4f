//! Grades of inertial sensors: the noise that a filter expects of them.

use std::f64::consts::PI;

/// Degrees an hour in radians a second.
pub const DEG_PER_HOUR: f64 = PI / 180.0 / 3600.0;
/// Degrees a root hour in radians a root second.
pub const DEG_PER_ROOT_HOUR: f64 = PI / 180.0 / 60.0;
/// Metres a second a root hour in metres a second a root second.
pub const MPS_PER_ROOT_HOUR: f64 = 1.0 / 60.0;
/// Milligal in metres a second squared.
pub const MILLIGAL: f64 = 1e-5;
/// Parts in a million.
pub const PPM: f64 = 1e-6;

/// Noise of an IMU: white noise of the rates, and biases and scale errors as first-order Gauss-Markov processes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuNoise {
    /// Angle random walk \[rad/√s\].
    pub angle_random_walk: f64,
    /// Velocity random walk \[m/s/√s\].
    pub velocity_random_walk: f64,
    /// Standard deviation of the gyro biases \[rad/s\].
    pub gyro_bias_radps: f64,
    /// Standard deviation of the accelerometer biases \[m/s²\].
    pub accelerometer_bias_mps2: f64,
    /// Standard deviation of the gyros' scale errors.
    pub gyro_scale: f64,
    /// Standard deviation of the accelerometers' scale errors.
    pub accelerometer_scale: f64,
    /// Correlation time of biases and scale errors \[s\].
    pub correlation_s: f64,
    /// Standard deviation of the biases when the IMU is switched on, over that in the run.
    pub switch_on: f64,
}

/// Named grades.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ImuGrade {
    /// Ring laser or fibre-optic gyros of navigation grade.
    Navigation,
    /// Applanix AP60 and its like.
    Ap60,
    /// Leador A15 (KF-GINS, dataset/kf-gins.yaml).
    LeadorA15,
    /// Sensonor STIM300.
    Stim300,
    /// Analog Devices ADIS16465.
    Adis16465,
    /// Consumer MEMS on a vehicle.
    Consumer,
}

impl ImuGrade {
    /// All, from best to worst.
    pub const ALL: [Self; 6] =
        [Self::Navigation, Self::Ap60, Self::LeadorA15, Self::Stim300, Self::Adis16465, Self::Consumer];

    /// The name used in project files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Navigation => "navigation",
            Self::Ap60 => "ap60",
            Self::LeadorA15 => "leador-a15",
            Self::Stim300 => "stim300",
            Self::Adis16465 => "adis16465",
            Self::Consumer => "consumer",
        }
    }

    /// What the filter expects of it.
    #[must_use]
    pub fn noise(self) -> ImuNoise {
        // ARW deg/√h, VRW m/s/√h, gyro bias deg/h, accelerometer bias mGal, scales ppm, hours, switch-on
        let (arw, vrw, bg, ba, sg, sa, hours, switch_on) = match self {
            Self::Navigation => (0.001, 0.01, 0.005, 15.0, 10.0, 50.0, 4.0, 1.0),
            // data sheet: 0.01 deg/h residual drift, 0.002 deg/√h; accelerometers of 100 µg class, calibrated
            Self::Ap60 => (0.002, 0.015, 0.01, 10.0, 50.0, 100.0, 4.0, 1.0),
            Self::LeadorA15 => (0.003, 0.03, 0.027, 15.0, 300.0, 300.0, 4.0, 1.0),
            // data sheet: 0.15 deg/√h, 0.06 m/s/√h, bias instability 0.5 deg/h and 0.05 mg, scale 500 and 300 ppm
            Self::Stim300 => (0.15, 0.06, 3.0, 75.0, 500.0, 300.0, 1.0, 3.0),
            // KF-GINS and OB_GINS, published with the sets of that sensor
            Self::Adis16465 => (0.1, 0.1, 25.0, 200.0, 1000.0, 1000.0, 1.0, 1.0),
            // on the road: vibration beyond half the sampling rate shows as noise and as biases that wander within minutes
            Self::Consumer => (0.3, 1.0, 300.0, 3000.0, 3000.0, 3000.0, 100.0 / 3600.0, 5.0),
        };
        ImuNoise {
            angle_random_walk: arw * DEG_PER_ROOT_HOUR,
            velocity_random_walk: vrw * MPS_PER_ROOT_HOUR,
            gyro_bias_radps: bg * DEG_PER_HOUR,
            accelerometer_bias_mps2: ba * MILLIGAL,
            gyro_scale: sg * PPM,
            accelerometer_scale: sa * PPM,
            correlation_s: hours * 3600.0,
            switch_on,
        }
    }
}

impl std::str::FromStr for ImuGrade {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|g| g.as_str() == text).ok_or_else(|| {
            let known: Vec<&str> = Self::ALL.iter().map(|g| g.as_str()).collect();
            format!("IMU grade \"{text}\" is unknown; known are {}", known.join(", "))
        })
    }
}
