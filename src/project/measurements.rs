//! Sections of the project file on the measurements of a trajectory: `[imu]`, `[gnss]`, `[odometer]`, `[vehicle]`,
//! `[initial]`, `[[points]]`, `[ties]`.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tieline_io::measurements::Axes;

use super::Project;

/// `[imu]`: inertial measurements; with them `solve` estimates the trajectory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuSection {
    /// The file, plain or gzipped.
    pub path: PathBuf,
    /// `text`, `kf-gins` or `binary`; recognised when left out.
    pub format: Option<ImuFormatChoice>,
    /// Columns of a text file.
    pub columns: Option<Vec<String>>,
    /// `increments` or `rates`; by the columns when left out.
    pub kind: Option<ImuKindChoice>,
    /// Where the axes of the sensor point.
    #[serde(default)]
    pub axes: Axes,
    /// Grade of the sensors: `navigation`, `ap60`, `leador-a15`, `stim300`, `adis16465`, `consumer`.
    pub grade: String,
    /// Angle random walk \[deg/√h\], in place of that of the grade.
    pub angle_random_walk_deg_rth: Option<f64>,
    /// Velocity random walk \[m/s/√h\].
    pub velocity_random_walk_mps_rth: Option<f64>,
    /// Standard deviation of the gyro biases \[deg/h\].
    pub gyro_bias_degph: Option<f64>,
    /// Standard deviation of the accelerometer biases \[mGal\].
    pub accelerometer_bias_mgal: Option<f64>,
    /// Standard deviation of the gyros' scale errors \[ppm\].
    pub gyro_scale_ppm: Option<f64>,
    /// Standard deviation of the accelerometers' scale errors \[ppm\].
    pub accelerometer_scale_ppm: Option<f64>,
    /// Correlation time of biases and scale errors \[h\].
    pub correlation_h: Option<f64>,
}

/// `format` in `[imu]`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ImuFormatChoice {
    /// Text with named columns.
    Text,
    /// Seven bare columns.
    KfGins,
    /// Seven f64 a record.
    Binary,
}

/// `kind` in `[imu]`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ImuKindChoice {
    /// Increments of angle and velocity.
    Increments,
    /// Angular rate and specific force.
    Rates,
}

/// `[gnss]`: fixes of the antenna.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GnssSection {
    /// The file, plain or gzipped.
    pub path: PathBuf,
    /// `rtklib-pos`, `kf-gins` or `csv`; recognised when left out.
    pub format: Option<GnssFormatChoice>,
    /// Columns of a CSV file.
    pub columns: Option<Vec<String>>,
    /// Factor on the standard deviations of the file.
    pub sigma_factor: Option<f64>,
    /// Least standard deviation of a position, each axis \[m\].
    pub least_sigma_m: Option<f64>,
    /// Share of the variance that is correlated over time, 0 to 1.
    pub correlated_share: Option<f64>,
    /// Correlation time of that share \[s\].
    pub correlation_s: Option<f64>,
    /// Whether velocities of the file are used.
    pub velocity: Option<bool>,
    /// Delay of the fixes against the clock of the IMU \[s\].
    pub delay_s: Option<f64>,
    /// Its standard deviation \[s\]; above zero it is estimated.
    pub delay_sigma_s: Option<f64>,
    /// Standard deviation of the delay of velocities \[s\]; above zero it is estimated.
    pub velocity_delay_sigma_s: Option<f64>,
    /// Standard deviation of the lever arm, each axis \[m\]; above zero it is estimated.
    pub lever_arm_sigma_m: Option<f64>,
}

/// `format` in `[gnss]`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GnssFormatChoice {
    /// Solution of RTKLIB.
    RtklibPos,
    /// Seven, ten or thirteen bare columns.
    KfGins,
    /// Named columns.
    Csv,
}

/// `[odometer]`: speed of a wheel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OdometerSection {
    /// The file, plain or gzipped.
    pub path: PathBuf,
    /// Columns.
    pub columns: Option<Vec<String>>,
    /// From the IMU to the wheel, body axes \[m\].
    #[serde(default)]
    pub lever_arm_m: [f64; 3],
    /// White noise of a reading \[m/s\].
    #[serde(default = "OdometerSection::default_noise_mps")]
    pub noise_mps: f64,
    /// Standard deviation of the scale error.
    #[serde(default = "OdometerSection::default_scale_sd")]
    pub scale_sd: f64,
}

impl OdometerSection {
    fn default_noise_mps() -> f64 {
        0.03
    }
    fn default_scale_sd() -> f64 {
        0.02
    }
}

/// `[vehicle]`: a vehicle on wheels, which neither slides nor jumps: the non-holonomic constraint.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VehicleSection {
    /// From the IMU to the axle that does not steer, body axes \[m\].
    pub lever_arm_m: [f64; 3],
    /// Standard deviation of the slip to the right and down \[m/s\].
    pub slip_mps: Option<[f64; 2]>,
    /// Correlation time of the slip \[s\].
    pub slip_correlation_s: Option<f64>,
    /// Standard deviation of pitch and yaw of the vehicle in the body frame \[deg\].
    pub mounting_sigma_deg: Option<f64>,
}

/// `[[points]]`: known points of the platform at moments.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointsSection {
    /// The file, plain or gzipped.
    pub path: PathBuf,
    /// Columns.
    pub columns: Option<Vec<String>>,
}

/// `[ties]`: ties that are given. In `solve` those of a file, such as `ties.txt` of `run`; in drives points picked by hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TiesSection {
    /// The file of ties for the smoother, plain or gzipped.
    pub path: Option<PathBuf>,
    /// Points picked by hand in the strips of a drive: CSV, plain or gzipped.
    pub points: Option<PathBuf>,
}

impl TiesSection {
    /// What is wrong with it: key, value, what to do.
    pub(super) fn wrong(&self, project: &Project) -> Option<(&'static str, String, &'static str)> {
        let is_drive = project.imu.is_some() && !project.strips.is_empty();
        let shown = |path: &Path| path.display().to_string();
        match (&self.path, &self.points) {
            (None, None) => {
                let remedy =
                    "name a file of ties (path) or one of points picked by hand (points), or take the section out";
                Some(("ties", String::from("without a file"), remedy))
            }
            (Some(_), Some(points)) => {
                let remedy = "points are picked in strips, ties of a file are for tieline solve without strips: take one of both out";
                Some(("ties.points", shown(points), remedy))
            }
            (None, Some(points)) if !is_drive => {
                let remedy = "points picked by hand are for drives, which have [[strips]] and [imu]; strips without [imu] do not take them";
                Some(("ties.points", shown(points), remedy))
            }
            _ => None,
        }
    }
}

/// `[initial]`: where the trajectory begins, when it cannot be found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialSection {
    /// GPS seconds of week.
    pub gps_time_s: f64,
    /// Latitude \[deg\].
    pub lat_deg: f64,
    /// Longitude \[deg\].
    pub lon_deg: f64,
    /// Ellipsoidal height \[m\].
    pub h_m: f64,
    /// Velocity north, east, down \[m/s\].
    #[serde(default)]
    pub velocity_ned_mps: [f64; 3],
    /// Roll, pitch, heading \[deg\].
    pub roll_pitch_heading_deg: [f64; 3],
    /// Standard deviation of position north, east, down \[m\].
    #[serde(default = "InitialSection::default_position_sigma_m")]
    pub position_sigma_m: [f64; 3],
    /// Standard deviation of velocity north, east, down \[m/s\].
    #[serde(default = "InitialSection::default_velocity_sigma_mps")]
    pub velocity_sigma_mps: [f64; 3],
    /// Standard deviation of roll, pitch, heading \[deg\].
    #[serde(default = "InitialSection::default_attitude_sigma_deg")]
    pub attitude_sigma_deg: [f64; 3],
}

impl InitialSection {
    fn default_position_sigma_m() -> [f64; 3] {
        [1.0; 3]
    }
    fn default_velocity_sigma_mps() -> [f64; 3] {
        [0.2; 3]
    }
    fn default_attitude_sigma_deg() -> [f64; 3] {
        [1.0, 1.0, 5.0]
    }
}
