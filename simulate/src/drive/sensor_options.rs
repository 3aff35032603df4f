//! What is on the vehicle: IMU, GNSS, odometer, scanners, and what is wrong with them.

use serde::{Deserialize, Serialize};

/// The IMU. What is left out is as the grade says; the project file names what is not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImuOptions {
    /// Grade, as in the project file.
    pub grade: String,
    /// Samples a second \[Hz\].
    pub rate_hz: f64,
    /// Angle random walk \[deg/√h\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle_random_walk_deg_rth: Option<f64>,
    /// Velocity random walk \[m/s/√h\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_random_walk_mps_rth: Option<f64>,
    /// Standard deviation of the gyro biases \[deg/h\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyro_bias_degph: Option<f64>,
    /// Standard deviation of the accelerometer biases \[mGal\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accelerometer_bias_mgal: Option<f64>,
    /// Significant digits in the file.
    pub digits: usize,
}

impl Default for ImuOptions {
    fn default() -> Self {
        Self {
            grade: "ap60".into(),
            rate_hz: 200.0,
            angle_random_walk_deg_rth: None,
            velocity_random_walk_mps_rth: None,
            gyro_bias_degph: None,
            accelerometer_bias_mgal: None,
            digits: 10,
        }
    }
}

/// GNSS.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GnssOptions {
    /// Fixes a second \[Hz\].
    pub rate_hz: f64,
    /// White noise north, east, down, one sigma \[m\].
    pub white_m: [f64; 3],
    /// Correlated noise north, east, down, one sigma \[m\].
    pub correlated_m: [f64; 3],
    /// Its correlation time \[s\].
    pub correlation_s: f64,
    /// From the IMU to the antenna, body axes \[m\].
    pub lever_arm_m: [f64; 3],
    /// Outages.
    #[serde(rename = "outage")]
    pub outages: Vec<Outage>,
}

impl Default for GnssOptions {
    fn default() -> Self {
        Self {
            rate_hz: 5.0,
            white_m: [0.010, 0.010, 0.020],
            correlated_m: [0.005, 0.005, 0.008],
            correlation_s: 100.0,
            lever_arm_m: [0.35, 0.12, -0.38],
            outages: Vec::new(),
        }
    }
}

/// A time without fixes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outage {
    /// Begin, counted from the begin of the data \[s\].
    pub start_s: f64,
    /// Length \[s\].
    pub length_s: f64,
}

/// The odometer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdometerOptions {
    /// Whether there is one.
    pub used: bool,
    /// Readings a second \[Hz\].
    pub rate_hz: f64,
    /// It reads (1 + this) times the speed.
    pub scale_error: f64,
    /// White noise of a reading, one sigma \[m/s\].
    pub noise_mps: f64,
    /// Standard deviation of the scale error, as the user believes.
    pub scale_sd: f64,
    /// From the IMU to the wheel, body axes \[m\].
    pub lever_arm_m: [f64; 3],
}

impl Default for OdometerOptions {
    fn default() -> Self {
        Self {
            used: true,
            rate_hz: 20.0,
            scale_error: 0.002,
            noise_mps: 0.02,
            scale_sd: 0.005,
            lever_arm_m: [-0.6, -0.78, 1.9],
        }
    }
}

/// The vehicle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VehicleOptions {
    /// From the IMU to the ground below the axle that does not steer, body axes \[m\].
    pub axle_lever_arm_m: [f64; 3],
    /// Whether the handed-out trajectory knows that the vehicle neither slides nor jumps.
    pub constrained: bool,
}

impl Default for VehicleOptions {
    fn default() -> Self {
        Self { axle_lever_arm_m: [-0.6, 0.0, 1.9], constrained: true }
    }
}

/// A 360° profile scanner: what it is, what its user believes about it, and what is true.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DriveScannerOptions {
    /// Pulses per second \[Hz\].
    pub pulse_rate_hz: f64,
    /// Profiles per second \[Hz\].
    pub profile_rate_hz: f64,
    /// Noise of the range, one sigma \[m\].
    pub range_noise_m: f64,
    /// Divergence of the beam, full angle \[mrad\].
    pub divergence_mrad: f64,
    /// Smallest range \[m\].
    pub min_range_m: f64,
    /// Largest range \[m\].
    pub max_range_m: f64,
    /// Range at which half the pulses come back from a surface that reflects a tenth, hit squarely \[m\].
    pub reach_m: f64,
    /// From the IMU to the scanner, body frame, as the user believes \[m\].
    pub lever_arm_m: [f64; 3],
    /// Roll, pitch, yaw of the mounting as the user believes \[deg\]: `body_from_scanner = Rz(yaw) Ry(pitch) Rx(roll)`.
    pub mounting_deg: [f64; 3],
    /// True boresight: body rotation vector, on the left of the mounting \[deg\].
    pub boresight_error_deg: [f64; 3],
    /// True lever arm minus that of the user \[m\].
    pub lever_arm_error_m: [f64; 3],
    /// True time of a pulse minus its stamp \[s\].
    pub latency_s: f64,
    /// Range bias (measured minus true): constant part \[m\].
    pub bias_offset_m: f64,
    /// Part that grows with the range \[1e-6\].
    pub bias_ppm: f64,
    /// Gaussian bumps.
    #[serde(rename = "bias_bump")]
    pub bias_bumps: Vec<BiasBump>,
    /// Pairs of range \[m\] and bias \[m\], growing in range: added as straight lines, level beyond the ends.
    pub bias_knots_m: Vec<[f64; 2]>,
    /// Pairs of incidence \[deg\] and bias \[m\], growing in incidence: added smoothly between, level at and beyond each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub bias_incidence: Vec<[f64; 2]>,
    /// Pairs of intensity as the strips have it and bias \[m\], growing in intensity: added smoothly over its logarithm, level at and beyond each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub bias_intensity: Vec<[f64; 2]>,
}

/// A bump of the range bias: `height · exp(-(r - range)² / (2 width²))`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BiasBump {
    /// Height \[m\].
    pub height_m: f64,
    /// Middle \[m\].
    pub range_m: f64,
    /// Width \[m\].
    pub width_m: f64,
}

impl Default for DriveScannerOptions {
    fn default() -> Self {
        Self {
            pulse_rate_hz: 50_000.0,
            profile_rate_hz: 100.0,
            range_noise_m: 0.005,
            divergence_mrad: 0.35,
            min_range_m: 1.5,
            max_range_m: 100.0,
            reach_m: 90.0,
            lever_arm_m: [-0.55, -0.42, -0.3],
            mounting_deg: [0.3, 20.1, -134.8],
            boresight_error_deg: [0.0; 3],
            lever_arm_error_m: [0.0; 3],
            latency_s: 0.0,
            bias_offset_m: 0.0,
            bias_ppm: 0.0,
            bias_bumps: Vec::new(),
            bias_knots_m: Vec::new(),
            bias_incidence: Vec::new(),
            bias_intensity: Vec::new(),
        }
    }
}

impl DriveScannerOptions {
    /// Two scanners on a roof, tilted across each other, without errors.
    #[must_use]
    pub fn roof_pair() -> Vec<Self> {
        let left = Self::default();
        let right = Self { lever_arm_m: [-0.55, 0.42, -0.3], mounting_deg: [-0.2, 19.9, 135.2], ..Self::default() };
        vec![left, right]
    }
}
