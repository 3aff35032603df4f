//! The scenario of a drive: which streets, what is driven, with which sensors. Every key has a default and its unit in
//! its name; what a scenario without streets or laps would do is an error instead.

use serde::{Deserialize, Serialize};

use super::scene_options::SceneOptions;
use super::sensor_options::{DriveScannerOptions, GnssOptions, ImuOptions, OdometerOptions, VehicleOptions};

/// The whole scenario, as in its TOML file. A file with a table `[drive]` is one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DriveScenario {
    /// Name of the survey.
    pub name: String,
    /// Sensor noise, sway, parked and moving cars follow from this number.
    pub seed: u64,
    /// The streets' own seed, so that other noise meets the same scene.
    pub scene_seed: u64,
    /// The projected system of the strips, ellipsoidal heights.
    pub crs: String,
    /// Latitude \[deg\], longitude \[deg\], ellipsoidal height \[m\] of the point that nodes count from.
    pub origin: [f64; 3],
    /// GPS week.
    pub week: u32,
    /// Seconds of week at which the data begin \[s\].
    pub start_s: f64,
    /// Points that streets and laps are made of.
    #[serde(rename = "node")]
    pub nodes: Vec<Node>,
    /// Streets.
    #[serde(rename = "street")]
    pub streets: Vec<Street>,
    /// What stands and lies there.
    pub scene: SceneOptions,
    /// How and where is driven.
    pub drive: DriveOptions,
    /// The IMU.
    pub imu: ImuOptions,
    /// GNSS.
    pub gnss: GnssOptions,
    /// The odometer; `[odometer]` with `used = false` for none.
    pub odometer: OdometerOptions,
    /// The vehicle as the smoother knows it.
    pub vehicle: VehicleOptions,
    /// The scanners, in the order of their channels.
    #[serde(rename = "scanner")]
    pub scanners: Vec<DriveScannerOptions>,
    /// How the files are written.
    pub output: DriveOutputOptions,
}

impl Default for DriveScenario {
    fn default() -> Self {
        Self {
            name: "drive".into(),
            seed: 1,
            scene_seed: 1,
            crs: "EPSG:32633".into(),
            origin: [48.2, 16.4, 200.0],
            week: 2330,
            start_s: 209_000.0,
            nodes: Vec::new(),
            streets: Vec::new(),
            scene: SceneOptions::default(),
            drive: DriveOptions::default(),
            imu: ImuOptions::default(),
            gnss: GnssOptions::default(),
            odometer: OdometerOptions::default(),
            vehicle: VehicleOptions::default(),
            scanners: DriveScannerOptions::roof_pair(),
            output: DriveOutputOptions::default(),
        }
    }
}

/// A named point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Node {
    /// Name.
    pub name: String,
    /// East of the origin \[m\].
    pub east_m: f64,
    /// North of the origin \[m\].
    pub north_m: f64,
}

/// Which sides of a street have façades.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sides {
    /// Both.
    Both,
    /// Left of the order of its nodes.
    Left,
    /// Right of it.
    Right,
    /// None: an open street.
    None,
}

/// A street: a line of nodes with rounded bends. Where streets meet, their corners are rounded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Street {
    /// Names of its nodes; the first again at the end closes a ring.
    pub nodes: Vec<String>,
    /// From the middle to the curbs \[m\].
    #[serde(default = "Street::default_half_width_m")]
    pub half_width_m: f64,
    /// From the curbs to the building line \[m\].
    #[serde(default = "Street::default_pavement_m")]
    pub pavement_m: f64,
    /// Sides with façades.
    #[serde(default = "Street::default_facades")]
    pub facades: Sides,
    /// Whether the façades are one even wall without windows or gaps, as in an underpass.
    #[serde(default)]
    pub walled: bool,
}

impl Street {
    fn default_half_width_m() -> f64 {
        5.0
    }
    fn default_pavement_m() -> f64 {
        3.0
    }
    fn default_facades() -> Sides {
        Sides::Both
    }
}

/// How and where is driven.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DriveOptions {
    /// Highest speed \[m/s\].
    pub speed_mps: f64,
    /// Share of the speed by which it wanders about over some seconds, 0 to 0.8.
    pub speed_changes: f64,
    /// Largest acceleration along the way \[m/s²\].
    pub acceleration_mps2: f64,
    /// Largest acceleration across the way \[m/s²\].
    pub lateral_mps2: f64,
    /// From the middle of the street to the lane, to the right \[m\].
    pub lane_m: f64,
    /// Standard deviation of the place across the lane \[m\].
    pub lane_sd_m: f64,
    /// Radius of bends and turns, middle of the street \[m\].
    pub turn_radius_m: f64,
    /// Time stood at the begin \[s\].
    pub first_rest_s: f64,
    /// Time stood at the end \[s\].
    pub last_rest_s: f64,
    /// Size of slow pitching and rolling over uneven ground \[deg\], of heaving in centimetres.
    pub sway_deg: f64,
    /// Amplitude of the vibration of the roof at full speed \[m\]; a fifth of it at rest.
    pub vibration_m: f64,
    /// Laps: each is a strip.
    #[serde(rename = "lap")]
    pub laps: Vec<Lap>,
    /// Stops.
    #[serde(rename = "stop")]
    pub stops: Vec<Stop>,
}

impl Default for DriveOptions {
    fn default() -> Self {
        Self {
            speed_mps: 9.0,
            speed_changes: 0.1,
            acceleration_mps2: 1.5,
            lateral_mps2: 2.0,
            lane_m: 1.6,
            lane_sd_m: 0.12,
            turn_radius_m: 12.0,
            first_rest_s: 30.0,
            last_rest_s: 15.0,
            sway_deg: 0.1,
            vibration_m: 0.000_05,
            laps: Vec::new(),
            stops: Vec::new(),
        }
    }
}

/// A lap; it begins where the one before ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lap {
    /// Names of the nodes in driving order.
    pub nodes: Vec<String>,
}

/// A stop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stop {
    /// Way from the begin of the drive \[m\].
    pub way_m: f64,
    /// Time stood there \[s\].
    pub rest_s: f64,
}

/// How the files are written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DriveOutputOptions {
    /// Step of the coordinates in the LAZ files \[m\].
    pub scale_m: f64,
    /// Epochs of the trajectory per second \[Hz\]; at most those of the IMU.
    pub trajectory_rate_hz: f64,
    /// Whether `truth/strips/` with the true coordinates of every point is written.
    pub true_points: bool,
}

impl Default for DriveOutputOptions {
    fn default() -> Self {
        Self { scale_m: 0.001, trajectory_rate_hz: 200.0, true_points: true }
    }
}
