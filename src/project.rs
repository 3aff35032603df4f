//! The project file: what a job is, in TOML. Keys are public; every one has a default but the paths.

pub mod measurements;
mod stations;
mod strips;
mod xyz;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use stations::{ExtrinsicsSection, StationsSection};
pub use strips::{
    CalibrateSection, CorrectSection, KnownTerm, MatchSection, RangeOver, ReturnsChoice, ScannerChoice, SolveSection,
    SplitChoice, SplitWord, StripModelChoice, StripsSection, SurfaceWord,
};
pub use xyz::{XyzChoice, XyzWord};

use measurements::{
    GnssSection, ImuSection, InitialSection, OdometerSection, PointsSection, TiesSection, VehicleSection,
};

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Project {
    /// Name, reference system and time.
    #[serde(default)]
    pub project: ProjectSection,
    /// Where the strips are; may be left out where a trajectory is estimated only.
    #[serde(default)]
    pub strips: Vec<StripsSection>,
    /// Points in the frames of their scanners, each station one pose: `calibrate` compares the scanners.
    #[serde(default)]
    pub stations: Vec<StationsSection>,
    /// Rough mounting of the scanners of stations.
    pub extrinsics: Option<ExtrinsicsSection>,
    /// Inertial measurements: with them `solve` estimates the trajectory.
    pub imu: Option<ImuSection>,
    /// GNSS fixes.
    pub gnss: Option<GnssSection>,
    /// Odometer.
    pub odometer: Option<OdometerSection>,
    /// A vehicle on wheels.
    pub vehicle: Option<VehicleSection>,
    /// Known points of the platform.
    #[serde(default)]
    pub points: Vec<PointsSection>,
    /// Ties of a file for the smoother.
    pub ties: Option<TiesSection>,
    /// Where the trajectory begins.
    pub initial: Option<InitialSection>,
    /// The trajectory; rebuilt from multi-return pulses when left out.
    pub trajectory: Option<TrajectorySection>,
    /// Mounting of the scanners.
    #[serde(default)]
    pub platform: PlatformSection,
    /// Known surfaces and points.
    #[serde(default)]
    pub control: Vec<ControlSection>,
    /// How ties are found.
    #[serde(default, rename = "match")]
    pub matching: MatchSection,
    /// Which calibration terms are estimated.
    #[serde(default)]
    pub calibrate: CalibrateSection,
    /// How strips are adjusted.
    #[serde(default)]
    pub solve: SolveSection,
    /// How corrected strips are written.
    #[serde(default)]
    pub correct: CorrectSection,
    /// Folder of the project file; paths are relative to it.
    #[serde(skip)]
    pub folder: PathBuf,
}

/// `[project]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProjectSection {
    /// Name in the report; the file's stem when left out.
    pub name: Option<String>,
    /// `EPSG:32633`, WKT, a proj string or `local`; from the strips' headers when left out.
    pub crs: Option<String>,
    /// Origin of a local system: latitude, longitude \[deg\], height \[m\].
    pub origin: Option<[f64; 3]>,
    /// How GPS times are to be read.
    pub time: TimeChoice,
    /// GPS week of files with seconds of week.
    pub week: Option<u32>,
}

/// `time`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TimeChoice {
    /// By the values in the files.
    #[default]
    Auto,
    /// Seconds of week.
    GpsWeek,
    /// Adjusted standard time.
    Adjusted,
}

/// `[trajectory]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrajectorySection {
    /// SBET, TRJ or text.
    pub path: PathBuf,
    /// SMRMSG file with its accuracy.
    pub accuracy: Option<PathBuf>,
    /// `sbet`, `trj` or `text`; by its content when left out.
    pub format: Option<TrajectoryFormatChoice>,
    /// Columns of a text file.
    pub columns: Option<Vec<String>>,
    /// Accuracy where no file gives it: position, each axis \[m\].
    pub position_sigma_m: Option<f64>,
    /// Accuracy where no file gives it: attitude, each axis \[deg\].
    pub attitude_sigma_deg: Option<f64>,
    /// How its times are to be read.
    #[serde(default)]
    pub time: TimeChoice,
}

/// `format`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TrajectoryFormatChoice {
    /// Applanix SBET.
    Sbet,
    /// `TerraScan` trajectory.
    Trj,
    /// Text with columns.
    Text,
}

/// `[platform]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlatformSection {
    /// From the IMU to the GNSS antenna, body frame \[m\].
    pub gnss_lever_arm_m: Option<[f64; 3]>,
    /// One for each scanner.
    pub scanner: Vec<ScannerSection>,
}

/// `[[platform.scanner]]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScannerSection {
    /// 0-based.
    pub id: u16,
    /// From the IMU to the scanner, body frame \[m\].
    pub lever_arm_m: [f64; 3],
    /// Roll, pitch, yaw of `body_from_scanner` \[deg\].
    pub mounting_deg: [f64; 3],
    /// Rotation vector in the body frame, on the left of the mounting \[deg\].
    pub boresight_deg: [f64; 3],
}

/// `[[control]]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSection {
    /// Points: text with easting, northing, height and optionally sigma. Surface: LAS or LAZ, a pattern may be used.
    pub path: String,
    /// Which of them.
    pub kind: ControlKind,
    /// Sigma where the file gives none \[m\].
    #[serde(default = "ControlSection::default_sigma_m")]
    pub sigma_m: f64,
}

impl ControlSection {
    fn default_sigma_m() -> f64 {
        0.01
    }
}

/// `kind`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControlKind {
    /// Points on a surface.
    Points,
    /// A point cloud of a surface.
    Surface,
}

/// Why a project file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProjectError {
    /// Cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not a project file.
    #[error("{}: {message}", path.display())]
    Parse {
        /// File.
        path: PathBuf,
        /// Line, caret and cause.
        message: String,
    },
    /// A value that cannot be right.
    #[error("{key} = {value}: {remedy}")]
    Value {
        /// Key with its section.
        key: String,
        /// What was found.
        value: String,
        /// What to write.
        remedy: String,
    },
}

impl Project {
    /// Reads and checks a project file.
    ///
    /// # Errors
    /// [`ProjectError`] names file, key and remedy.
    pub fn load(path: &Path) -> Result<Self, ProjectError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| ProjectError::Read { path: path.to_path_buf(), source })?;
        let mut project = parse_str(&text).map_err(|error| match error {
            ProjectError::Parse { message, .. } => ProjectError::Parse { path: path.to_path_buf(), message },
            other => other,
        })?;
        project.folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
        if project.project.name.is_none() {
            project.project.name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        }
        Ok(project)
    }

    /// A path of the project file as it is found from here.
    #[must_use]
    pub fn resolve(&self, path: impl AsRef<Path>) -> PathBuf {
        self.folder.join(path)
    }

    /// Name in the report.
    #[must_use]
    pub fn name(&self) -> &str {
        self.project.name.as_deref().unwrap_or("tieline")
    }
}

/// Parses and checks the text of a project file.
///
/// # Errors
/// [`ProjectError`] with line and key.
pub fn parse_str(text: &str) -> Result<Project, ProjectError> {
    let project: Project = toml::from_str(text)
        .map_err(|error| ProjectError::Parse { path: PathBuf::from("project"), message: error.to_string() })?;
    check(&project)?;
    Ok(project)
}

fn check(project: &Project) -> Result<(), ProjectError> {
    let wrong = |key: &str, value: String, remedy: &str| {
        Err(ProjectError::Value { key: key.to_string(), value, remedy: remedy.to_string() })
    };
    if project.imu.is_none() {
        for (key, given) in [
            ("gnss", project.gnss.is_some()),
            ("odometer", project.odometer.is_some()),
            ("vehicle", project.vehicle.is_some()),
            ("points", !project.points.is_empty()),
            ("ties", project.ties.as_ref().is_some_and(|t| t.path.is_some())),
            ("initial", project.initial.is_some()),
        ] {
            if given {
                return wrong(key, String::from("given"), "it needs [imu] beside it");
            }
        }
    }
    if let Some((key, value, remedy)) = project.ties.as_ref().and_then(|t| t.wrong(project)) {
        return wrong(key, value, remedy);
    }
    if !project.stations.is_empty() && (project.imu.is_some() || !project.strips.is_empty()) {
        return wrong(
            "stations",
            String::from("given"),
            "stations have no trajectory: give [[strips]] and [imu] a project of their own",
        );
    }
    if let Some(path) = project.calibrate.known.as_ref().filter(|_| project.imu.is_none() || project.strips.is_empty())
    {
        return wrong(
            "calibrate.known",
            path.display().to_string(),
            "it is for drives, which have [[strips]] and [imu]; elsewhere copy its [platform] into the project",
        );
    }
    let is_drive = project.imu.is_some() && !project.strips.is_empty();
    if let Some((value, remedy)) = project.calibrate.wrong_range_over(is_drive) {
        return wrong("calibrate.range_over", value, remedy);
    }
    if let Some((key, value, remedy)) = xyz::wrong(&project.matching, is_drive) {
        return wrong(key, value, &remedy);
    }
    if project.matching.surfaces.as_ref().is_some_and(Vec::is_empty) {
        return wrong("match.surfaces", String::from("[]"), "name \"level\", \"steep\" or both, or leave it out");
    }
    if project.extrinsics.is_some() && project.stations.is_empty() {
        return wrong("extrinsics", String::from("given"), "it needs [[stations]] beside it; strips have [platform]");
    }
    if project.strips.is_empty() && project.imu.is_none() && project.stations.is_empty() {
        return wrong("strips", String::from("[]"), "name at least one file or pattern under [[strips]]");
    }
    let positive = [
        ("match.patch_m", project.matching.patch_m),
        ("match.max_roughness_m", project.matching.max_roughness_m),
        ("match.search_m", project.matching.search_m),
        ("match.normal_angle_deg", project.matching.normal_angle_deg),
        ("solve.knot_spacing_s", project.solve.knot_spacing_s),
        ("solve.position_sigma_m", project.solve.position_sigma_m),
        ("solve.attitude_sigma_deg", project.solve.attitude_sigma_deg),
        ("correct.scale_m", project.correct.scale_m),
        ("calibrate.boresight_sigma_deg", Some(project.calibrate.boresight_sigma_deg)),
        ("calibrate.lever_arm_sigma_m", Some(project.calibrate.lever_arm_sigma_m)),
        ("calibrate.range_offset_sigma_m", Some(project.calibrate.range_offset_sigma_m)),
        ("calibrate.range_scale_sigma_ppm", Some(project.calibrate.range_scale_sigma_ppm)),
        ("extrinsics.boresight_sigma_deg", project.extrinsics.as_ref().map(|e| e.boresight_sigma_deg)),
        ("extrinsics.lever_arm_sigma_m", project.extrinsics.as_ref().map(|e| e.lever_arm_sigma_m)),
        ("gnss.sigma_factor", project.gnss.as_ref().and_then(|g| g.sigma_factor)),
        ("gnss.least_sigma_m", project.gnss.as_ref().and_then(|g| g.least_sigma_m)),
        ("gnss.correlation_s", project.gnss.as_ref().and_then(|g| g.correlation_s)),
        ("odometer.noise_mps", project.odometer.as_ref().map(|o| o.noise_mps)),
        ("vehicle.slip_correlation_s", project.vehicle.as_ref().and_then(|v| v.slip_correlation_s)),
        ("imu.correlation_h", project.imu.as_ref().and_then(|i| i.correlation_h)),
        ("imu.angle_random_walk_deg_rth", project.imu.as_ref().and_then(|i| i.angle_random_walk_deg_rth)),
        ("imu.velocity_random_walk_mps_rth", project.imu.as_ref().and_then(|i| i.velocity_random_walk_mps_rth)),
        ("trajectory.position_sigma_m", project.trajectory.as_ref().and_then(|t| t.position_sigma_m)),
        ("trajectory.attitude_sigma_deg", project.trajectory.as_ref().and_then(|t| t.attitude_sigma_deg)),
    ];
    for (key, value) in positive {
        if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
            return wrong(key, value.to_string(), "give a number above 0");
        }
    }
    for control in &project.control {
        if !(control.sigma_m.is_finite() && control.sigma_m > 0.0) {
            return wrong("control.sigma_m", control.sigma_m.to_string(), "give a number above 0");
        }
    }
    for section in &project.strips {
        if let Some(gap) = section.time_gap_s.filter(|g| !(g.is_finite() && *g > 0.0)) {
            return wrong("strips.time_gap_s", gap.to_string(), "give a number of seconds above 0");
        }
    }
    if let Some(share) = project.matching.hold_out.filter(|h| !(0.0..=0.5).contains(h)) {
        return wrong("match.hold_out", share.to_string(), "give a share from 0 to 0.5");
    }
    if let Some(levels) = project.matching.patch_levels.filter(|l| *l > 4) {
        return wrong("match.patch_levels", levels.to_string(), "give 0 to 4");
    }
    if let Some(points) = project.matching.min_points.filter(|p| *p < 4) {
        return wrong("match.min_points", points.to_string(), "a plane with a residual needs 4 points or more");
    }
    if let Some(deg) = project.matching.max_incidence_deg.filter(|deg| !(*deg > 0.0 && *deg <= 90.0)) {
        return wrong("match.max_incidence_deg", format!("{deg}"), "give an angle above 0 and up to 90 degrees");
    }
    if let Some([near, far]) = project.matching.range_m.filter(|[a, b]| !(*a >= 0.0 && b > a)) {
        return wrong("match.range_m", format!("[{near}, {far}]"), "give nearest and farthest range in metres");
    }
    if let Some([latitude, longitude, _]) = project.project.origin
        && !(latitude.abs() <= 90.0 && longitude.abs() <= 360.0)
    {
        let value = format!("[{latitude}, {longitude}, …]");
        return wrong("project.origin", value, "give latitude and longitude in degrees and height in metres");
    }
    let mut ids: Vec<u16> = project.platform.scanner.iter().map(|s| s.id).collect();
    ids.sort_unstable();
    if let Some(twice) = ids.windows(2).find(|w| w[0] == w[1]) {
        return wrong("platform.scanner.id", twice[0].to_string(), "give each scanner a number of its own");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_project_of_one_line_has_a_default_for_everything_else() {
        let project = parse_str("[[strips]]\npath = \"*.laz\"\n").expect("enough");
        assert!(project.calibrate.terms().boresight);
        assert_eq!(project.solve.strips, StripModelChoice::Auto);
        assert!(project.strips[0].split.has(SplitWord::Auto));
    }

    #[test]
    fn a_misspelt_key_is_named_with_its_line() {
        let error = parse_str("[[strips]]\npath = \"*.laz\"\n[solve]\nknot_spacing = 2.0\n").expect_err("misspelt");
        let message = error.to_string();
        assert!(message.contains("knot_spacing") && message.contains("line 4"), "{message}");
    }

    #[test]
    fn a_misspelt_calibration_term_is_refused() {
        assert!(parse_str("[[strips]]\npath = \"*.laz\"\n[calibrate]\nboresigth = false\n").is_err());
    }

    #[test]
    fn a_value_out_of_range_is_named_with_its_remedy() {
        let error = parse_str("[[strips]]\npath = \"*.laz\"\n[match]\nhold_out = 0.9\n").expect_err("too much");
        assert!(error.to_string().contains("match.hold_out"));
        let error =
            parse_str("[[strips]]\npath = \"*.laz\"\n[match]\nmax_incidence_deg = 175.0\n").expect_err("too much");
        assert!(error.to_string().contains("match.max_incidence_deg") && error.to_string().contains("175"));
    }

    #[test]
    fn split_takes_a_word_or_a_list() {
        let project = parse_str("[[strips]]\npath = \"a\"\nsplit = [\"file\", \"time-gap\"]\n").expect("a list");
        assert!(project.strips[0].split.has(SplitWord::File) && project.strips[0].split.has(SplitWord::TimeGap));
    }
}
