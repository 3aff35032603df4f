//! A scenario: what is flown over what, and with which errors. Every key has a default and its unit in its name.

use std::path::Path;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tieline_io::crs::Crs;

use crate::error::SimulateError;

/// The whole scenario, as in its TOML file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scenario {
    /// Name of the survey.
    pub name: String,
    /// Everything random follows from this number.
    pub seed: u64,
    /// `"local"` (east-north-up about the origin) or a projected system as in the project file.
    pub crs: String,
    /// Latitude \[deg\], longitude \[deg\], ellipsoidal height \[m\] of the middle of the area.
    pub origin: [f64; 3],
    /// GPS week of the flight.
    pub week: u32,
    /// Seconds of week at which the first line begins \[s\].
    pub start_s: f64,
    /// The ground that is delivered.
    pub area: Area,
    /// What stands on it.
    pub world: WorldOptions,
    /// What is flown.
    pub flight: Flight,
    /// The scanners, in the order of their channels.
    #[serde(rename = "scanner")]
    pub scanners: Vec<ScannerOptions>,
    /// What is wrong with the delivered trajectory.
    pub errors: TrajectoryErrors,
    /// How the files are written.
    pub output: OutputOptions,
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            name: "survey".into(),
            seed: 1,
            crs: "local".into(),
            origin: [46.8, 9.6, 560.0],
            week: 2330,
            start_s: 209_000.0,
            area: Area::default(),
            world: WorldOptions::default(),
            flight: Flight::default(),
            scanners: vec![ScannerOptions::default()],
            errors: TrajectoryErrors::default(),
            output: OutputOptions::default(),
        }
    }
}

/// A rectangle about the origin; points outside are not delivered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Area {
    /// Extent to the east \[m\].
    pub east_m: f64,
    /// Extent to the north \[m\].
    pub north_m: f64,
}

impl Default for Area {
    fn default() -> Self {
        Self { east_m: 500.0, north_m: 400.0 }
    }
}

/// What stands on the ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldOptions {
    /// Height of the hills above the mean, roughly \[m\].
    pub relief_m: f64,
    /// Buildings with gable, hip or flat roofs; fewer where there is no room.
    pub buildings: u32,
    /// Trees; fewer where there is no room.
    pub trees: u32,
    /// Boxes of the size of a car that are there in one strip only.
    pub moving_objects: u32,
    /// Roughness of the ground, one sigma \[m\]: grass; roads and roofs are smooth.
    pub ground_roughness_m: f64,
}

impl Default for WorldOptions {
    fn default() -> Self {
        Self { relief_m: 8.0, buildings: 110, trees: 120, moving_objects: 12, ground_roughness_m: 0.005 }
    }
}

/// What is flown.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Flight {
    /// Speed over ground \[m/s\].
    pub speed_mps: f64,
    /// Time between the end of a line and the begin of the next \[s\]; nothing is recorded then.
    pub turn_s: f64,
    /// Way flown before and after the area \[m\].
    pub lead_m: f64,
    /// Size of the slow oscillations of roll; pitch and heading move half as much \[deg\].
    pub oscillation_deg: f64,
    /// Largest angle between course and heading \[deg\].
    pub crab_deg: f64,
    /// Groups of parallel lines.
    #[serde(rename = "group")]
    pub groups: Vec<LineGroup>,
}

impl Default for Flight {
    fn default() -> Self {
        Self { speed_mps: 55.0, turn_s: 60.0, lead_m: 60.0, oscillation_deg: 1.5, crab_deg: 3.0, groups: Vec::new() }
    }
}

/// Parallel flight lines, flown to and fro in turn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LineGroup {
    /// Course of the first line, clockwise from north \[deg\].
    pub direction_deg: f64,
    /// Height above the mean ground \[m\].
    pub height_m: f64,
    /// Number of lines.
    pub lines: u32,
    /// Distance between them \[m\].
    pub spacing_m: f64,
    /// Distance of the middle of the group from the origin, to the right of the first line \[m\].
    pub offset_m: f64,
}

impl Default for LineGroup {
    fn default() -> Self {
        Self { direction_deg: 0.0, height_m: 600.0, lines: 2, spacing_m: 200.0, offset_m: 0.0 }
    }
}

/// How the mirror moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScannerKind {
    /// Parallel lines, left to right at constant rate.
    Rotating,
    /// To and fro as a sine.
    Oscillating,
}

/// A scanner: what it is, what its user believes about it, and what is true.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScannerOptions {
    /// How the mirror moves.
    pub kind: ScannerKind,
    /// Full opening angle \[deg\].
    pub field_of_view_deg: f64,
    /// Pulses per second \[Hz\].
    pub pulse_rate_hz: f64,
    /// Scan lines per second (periods, for an oscillating mirror) \[Hz\].
    pub line_rate_hz: f64,
    /// Noise of the range, one sigma \[m\].
    pub range_noise_m: f64,
    /// Noise of the beam's direction, one sigma per axis \[deg\].
    pub angular_noise_deg: f64,
    /// Largest range \[m\].
    pub max_range_m: f64,
    /// From the IMU to the scanner, body frame, as the user believes \[m\].
    pub lever_arm_m: [f64; 3],
    /// Roll, pitch, yaw of the mounting \[deg\]: `body_from_scanner = Rz(yaw) Ry(pitch) Rx(roll)`.
    pub mounting_deg: [f64; 3],
    /// Boresight as the user believes: body rotation vector, on the left of the mounting \[deg\].
    pub boresight_deg: [f64; 3],
    /// True boresight minus that of the user \[deg\].
    pub boresight_error_deg: [f64; 3],
    /// True lever arm minus that of the user \[m\].
    pub lever_arm_error_m: [f64; 3],
    /// Constant part of `f`: true range = measured range + f \[m\].
    pub range_offset_m: f64,
    /// Part of `f` that grows with the measured range \[1e-6\].
    pub range_scale_ppm: f64,
}

impl Default for ScannerOptions {
    fn default() -> Self {
        Self {
            kind: ScannerKind::Rotating,
            field_of_view_deg: 40.0,
            pulse_rate_hz: 112_000.0,
            line_rate_hz: 120.0,
            range_noise_m: 0.008,
            angular_noise_deg: 0.0002,
            max_range_m: 3000.0,
            lever_arm_m: [0.12, -0.05, 0.21],
            mounting_deg: [0.0; 3],
            boresight_deg: [0.0; 3],
            boresight_error_deg: [0.0; 3],
            lever_arm_error_m: [0.0; 3],
            range_offset_m: 0.0,
            range_scale_ppm: 0.0,
        }
    }
}

/// Errors of the delivered trajectory: for each strip and component a constant and a linear part, normal with these
/// standard deviations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrajectoryErrors {
    /// Constant part of north, east, down, one sigma \[m\].
    pub position_constant_sd_m: f64,
    /// Linear part: its value at the end of the line, minus that at the begin, halved; one sigma \[m\].
    pub position_linear_sd_m: f64,
    /// Constant part of roll, pitch, heading, one sigma \[deg\].
    pub attitude_constant_sd_deg: f64,
    /// Linear part, as for the position \[deg\].
    pub attitude_linear_sd_deg: f64,
}

impl Default for TrajectoryErrors {
    fn default() -> Self {
        Self {
            position_constant_sd_m: 0.03,
            position_linear_sd_m: 0.03,
            attitude_constant_sd_deg: 0.002,
            attitude_linear_sd_deg: 0.002,
        }
    }
}

/// How the files are written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputOptions {
    /// Step of the coordinates in the LAZ files \[m\].
    pub scale_m: f64,
    /// Epochs of the trajectory per second \[Hz\].
    pub trajectory_rate_hz: f64,
}

impl Default for OutputOptions {
    fn default() -> Self {
        Self { scale_m: 0.001, trajectory_rate_hz: 100.0 }
    }
}

impl Scenario {
    /// Reads a scenario and checks it.
    ///
    /// # Errors
    /// [`SimulateError`] names the key and what would make sense.
    pub fn read(path: &Path) -> Result<Self, SimulateError> {
        let io = |source| SimulateError::Io { path: path.to_path_buf(), source };
        let text = std::fs::read_to_string(path).map_err(io)?;
        let scenario: Self = toml::from_str(&text)
            .map_err(|source| SimulateError::Toml { path: path.to_path_buf(), source: Box::new(source) })?;
        scenario.check()?;
        Ok(scenario)
    }

    /// Checks that every number makes sense.
    ///
    /// # Errors
    /// [`SimulateError::Scenario`] names the first that does not; [`SimulateError::Crs`].
    pub fn check(&self) -> Result<(), SimulateError> {
        positive("area.east_m", self.area.east_m)?;
        positive("area.north_m", self.area.north_m)?;
        positive("flight.speed_mps", self.flight.speed_mps)?;
        positive("output.scale_m", self.output.scale_m)?;
        positive("output.trajectory_rate_hz", self.output.trajectory_rate_hz)?;
        not_negative("flight.turn_s", self.flight.turn_s)?;
        not_negative("flight.lead_m", self.flight.lead_m)?;
        not_negative("world.relief_m", self.world.relief_m)?;
        not_negative("world.ground_roughness_m", self.world.ground_roughness_m)?;
        not_negative("start_s", self.start_s)?;
        for (key, value) in [
            ("errors.position_constant_sd_m", self.errors.position_constant_sd_m),
            ("errors.position_linear_sd_m", self.errors.position_linear_sd_m),
            ("errors.attitude_constant_sd_deg", self.errors.attitude_constant_sd_deg),
            ("errors.attitude_linear_sd_deg", self.errors.attitude_linear_sd_deg),
        ] {
            not_negative(key, value)?;
        }
        let lines = self.flight.groups.iter().map(|group| u64::from(group.lines)).sum::<u64>();
        require("flight.group", (1..=60_000).contains(&lines), &lines, "one to 60000 flight lines in all")?;
        for group in &self.flight.groups {
            let above = group.height_m > 3.0 * self.world.relief_m + 50.0;
            require("flight.group.height_m", above, &group.height_m, "well above hills and houses")?;
        }
        let channels = self.scanners.len();
        require("scanner", (1..=4).contains(&channels), &channels, "one to four scanners")?;
        for scanner in &self.scanners {
            let opening = scanner.field_of_view_deg;
            let is_angle = opening > 0.0 && opening <= 120.0;
            require("scanner.field_of_view_deg", is_angle, &opening, "more than 0 and at most 120 deg")?;
            positive("scanner.pulse_rate_hz", scanner.pulse_rate_hz)?;
            positive("scanner.line_rate_hz", scanner.line_rate_hz)?;
            positive("scanner.max_range_m", scanner.max_range_m)?;
            not_negative("scanner.range_noise_m", scanner.range_noise_m)?;
            not_negative("scanner.angular_noise_deg", scanner.angular_noise_deg)?;
        }
        self.local_crs()?;
        self.strip_crs()?;
        Ok(())
    }

    /// The system that the world stands in: east, north, up about the origin.
    ///
    /// # Errors
    /// When the origin is no place.
    pub fn local_crs(&self) -> Result<Crs, SimulateError> {
        let [latitude_deg, longitude_deg, height_m] = self.origin;
        Ok(Crs::local(Vector3::new(latitude_deg.to_radians(), longitude_deg.to_radians(), height_m))?)
    }

    /// The system that the strips are delivered in; `None` when it is the local one.
    ///
    /// # Errors
    /// When it is not understood.
    pub fn strip_crs(&self) -> Result<Option<Crs>, SimulateError> {
        match self.crs.trim().eq_ignore_ascii_case("local") {
            true => Ok(None),
            false => Ok(Some(Crs::parse(&self.crs)?)),
        }
    }
}

pub(crate) fn require(
    key: &'static str,
    is_good: bool,
    value: &dyn std::fmt::Display,
    expected: &'static str,
) -> Result<(), SimulateError> {
    match is_good {
        true => Ok(()),
        false => Err(SimulateError::Scenario { key, value: value.to_string(), expected }),
    }
}

pub(crate) fn positive(key: &'static str, value: f64) -> Result<(), SimulateError> {
    require(key, value > 0.0 && value.is_finite(), &value, "a number above zero was due")
}

pub(crate) fn not_negative(key: &'static str, value: f64) -> Result<(), SimulateError> {
    require(key, value >= 0.0 && value.is_finite(), &value, "a number of zero or more was due")
}
