//! The files of a survey: what the user receives, and apart from it the truth.
//!
//! ```text
//! out/project.toml               ready for `tieline run`
//! out/strips/strip_01.laz …      LAS 1.4 format 6, one file per strip, point source id = number
//! out/trajectory.sbet            with its errors; on the lines only
//! out/trajectory_rms.out         the accuracy that is claimed for it, 1 Hz
//! out/truth/                     calibration_true.toml, trajectory_true.sbet, strip_errors.csv, scenario.toml
//! ```

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use rayon::prelude::*;
use tieline_filter::time::{ADJUSTED_OFFSET_S, SECONDS_PER_WEEK};
use tieline_filter::{PoseSigma, TimeEncoding, Trajectory};
use tieline_io::crs::Crs;
use tieline_io::las::{Columns, LasWriter, LasWriterOptions};
use tieline_io::output::write_whole;
use tieline_io::trajectory::{write_sbet, write_smrmsg};

use crate::error::SimulateError;
use crate::scenario::{Scenario, TrajectoryErrors};
use crate::survey::{Echo, Survey};
use crate::truth::Truth;

mod text;

/// Blocks that are simulated together: bounds the memory.
const BATCH: usize = 64;

/// What was written.
#[derive(Debug, Clone)]
pub struct SimulationReport {
    /// The project file.
    pub project: PathBuf,
    /// The strips.
    pub strips: Vec<StripReport>,
    /// What an estimator is to find.
    pub truth: Truth,
}

/// A strip that was written.
#[derive(Debug, Clone, PartialEq)]
pub struct StripReport {
    /// The file.
    pub path: PathBuf,
    /// Its points.
    pub points: u64,
    /// First and last moment of the line \[s of week\].
    pub span_s: (f64, f64),
}

impl SimulationReport {
    /// Points of all strips.
    #[must_use]
    pub fn points(&self) -> u64 {
        self.strips.iter().map(|strip| strip.points).sum()
    }
}

/// Simulates a scenario into the folder `out`, which is created.
///
/// # Errors
/// [`SimulateError`] when a number makes no sense or the disk refuses.
pub fn simulate(scenario: &Scenario, out: &Path) -> Result<SimulationReport, SimulateError> {
    let survey = Survey::new(scenario)?;
    let place = StripPlace::new(scenario)?;
    for folder in [out.join("strips"), out.join("truth")] {
        std::fs::create_dir_all(&folder).map_err(|source| SimulateError::Io { path: folder.clone(), source })?;
    }
    for strip in 0.. {
        if !remove_old(&out.join("strips").join(format!("{}.laz", strip_name(strip))))? {
            break;
        }
    }
    let mut strips = Vec::new();
    for strip in 0..survey.lines().len() {
        strips.push(write_strip(&survey, strip, &place, &out.join("strips"))?);
    }
    let local = scenario.local_crs()?;
    let delivered = local.to_geodetic(survey.delivered_trajectory())?;
    write_sbet(&out.join("trajectory.sbet"), &delivered)?;
    write_smrmsg(&out.join("trajectory_rms.out"), &claimed_accuracy(&survey, &delivered)?)?;
    let truth_folder = out.join("truth");
    write_sbet(&truth_folder.join("trajectory_true.sbet"), &local.to_geodetic(survey.true_trajectory())?)?;
    write_text(&truth_folder.join("calibration_true.toml"), &text::calibration_true(&survey))?;
    write_text(&truth_folder.join("strip_errors.csv"), &text::strip_errors(&survey))?;
    write_text(&truth_folder.join("scenario.toml"), &text::scenario(scenario))?;
    let project = out.join("project.toml");
    write_text(&project, &text::project(scenario))?;
    Ok(SimulationReport { project, strips, truth: survey.truth().clone() })
}

/// Removes a file of an earlier survey, which the project would take for its own; says whether there was one.
pub(crate) fn remove_old(path: &Path) -> Result<bool, SimulateError> {
    match std::fs::remove_file(path) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(source) => Err(SimulateError::Io { path: path.to_path_buf(), source }),
    }
}

fn write_text(path: &Path, text: &str) -> Result<(), SimulateError> {
    write_whole(path, text.as_bytes()).map_err(|source| SimulateError::Io { path: path.to_path_buf(), source })
}

/// Name of a strip's file, from its number.
#[must_use]
pub fn strip_name(strip: usize) -> String {
    format!("strip_{:02}", strip + 1)
}

/// How points get from the world to the strips' system.
struct StripPlace {
    systems: Option<(Crs, Crs)>,
    offset_m: [f64; 3],
}

impl StripPlace {
    fn new(scenario: &Scenario) -> Result<Self, SimulateError> {
        let systems = match scenario.strip_crs()? {
            Some(crs) => Some((scenario.local_crs()?, crs)),
            None => None,
        };
        let mut place = Self { systems, offset_m: [0.0; 3] };
        let middle = place.map_m(&Vector3::zeros())?;
        let round = |v: f64, step: f64| (v / step).round() * step;
        place.offset_m = [round(middle.x, 1000.0), round(middle.y, 1000.0), 0.0];
        Ok(place)
    }

    fn map_m(&self, local_m: &Vector3<f64>) -> Result<Vector3<f64>, SimulateError> {
        match &self.systems {
            None => Ok(*local_m),
            Some((local, strips)) => Ok(strips.map_from_geodetic(&local.geodetic_from_map(local_m)?)?),
        }
    }
}

fn write_strip(survey: &Survey, strip: usize, place: &StripPlace, folder: &Path) -> Result<StripReport, SimulateError> {
    let path = folder.join(format!("{}.laz", strip_name(strip)));
    let scenario = survey.scenario();
    let number = u16::try_from(strip + 1).unwrap_or(u16::MAX);
    let scale_m = scenario.output.scale_m;
    let mut writer = LasWriter::create(
        &path,
        LasWriterOptions {
            scale: [scale_m; 3],
            offset: place.offset_m,
            time: TimeEncoding::AdjustedStandard,
            system_identifier: "simulated".into(),
            file_source_id: number,
            ..LasWriterOptions::default()
        },
    )?;
    let blocks: Vec<usize> = (0..survey.blocks(strip)).collect();
    let shift_s = f64::from(scenario.week) * SECONDS_PER_WEEK - ADJUSTED_OFFSET_S;
    let mut points = 0;
    for batch in blocks.chunks(BATCH) {
        let columns: Vec<Result<Columns, SimulateError>> = batch
            .par_iter()
            .map(|&block| columns(&survey.block(strip, block), place, scale_m, shift_s, number))
            .collect();
        for block in columns {
            let block = block?;
            points += block.len() as u64;
            writer.write(&block)?;
        }
    }
    writer.finish()?;
    Ok(StripReport { path, points, span_s: survey.lines()[strip].span_s })
}

/// Echoes as LAS columns.
fn columns(
    echoes: &[Echo],
    place: &StripPlace,
    scale_m: f64,
    shift_s: f64,
    number: u16,
) -> Result<Columns, SimulateError> {
    let mut columns = Columns::default();
    for echo in echoes {
        let map = place.map_m(&echo.delivered_m)?;
        let stored = |axis: usize| step((map[axis] - place.offset_m[axis]) / scale_m);
        columns.x.push(stored(0));
        columns.y.push(stored(1));
        columns.z.push(stored(2));
        columns.gps_time.push(echo.time_s + shift_s);
        columns.intensity.push(echo.intensity);
        columns.return_number.push(echo.return_number);
        columns.number_of_returns.push(echo.number_of_returns);
        columns.classification.push(echo.class);
        columns.flags.push(0);
        columns.scanner_channel.push(echo.scanner);
        columns.scan_angle_deg.push(degrees(echo.scan_angle_rad));
        columns.user_data.push(0);
        columns.point_source_id.push(number);
    }
    Ok(columns)
}

#[allow(clippy::cast_possible_truncation)] // saturates far outside of any area
fn step(steps: f64) -> i32 {
    steps.round() as i32
}

/// A rate as a number of epochs.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few hundred, checked to be above zero
fn whole(rate_hz: f64) -> usize {
    rate_hz as usize
}

#[allow(clippy::cast_possible_truncation)] // a scan angle needs no more
fn degrees(radians: f64) -> f32 {
    radians.to_degrees() as f32
}

/// The accuracy that is claimed for the trajectory: the root mean square over a line of what was put in, once a
/// second.
fn claimed_accuracy(survey: &Survey, delivered: &Trajectory) -> Result<Trajectory, SimulateError> {
    let rate_hz = survey.scenario().output.trajectory_rate_hz;
    let a_second = whole(rate_hz.ceil());
    let mut kept = Vec::new();
    let mut first = 0;
    for line in survey.lines() {
        let epochs = line.epochs_s(rate_hz).count();
        kept.extend(
            (first..first + epochs).filter(|i| (i - first).is_multiple_of(a_second) || i + 1 == first + epochs),
        );
        first += epochs;
    }
    let sigma = vec![claimed_sigma(&survey.scenario().errors); kept.len()];
    let thinned = Trajectory::new(
        delivered.frame(),
        kept.iter().map(|&i| delivered.time_s()[i]).collect(),
        kept.iter().map(|&i| delivered.position()[i]).collect(),
        kept.iter().map(|&i| delivered.ned_from_body()[i]).collect(),
        Vec::new(),
    )?;
    Ok(thinned.with_sigma(sigma)?)
}

/// Constant part and a third of the square of the linear one: the mean square over a line.
fn claimed_sigma(errors: &TrajectoryErrors) -> PoseSigma {
    let rms = |constant: f64, linear: f64| (constant * constant + linear * linear / 3.0).sqrt();
    let position_m = rms(errors.position_constant_sd_m, errors.position_linear_sd_m);
    let attitude_rad = rms(errors.attitude_constant_sd_deg, errors.attitude_linear_sd_deg).to_radians();
    PoseSigma {
        position_ned_m: Vector3::repeat(position_m),
        velocity_ned_mps: Vector3::repeat(0.005),
        attitude_rph_rad: Vector3::repeat(attitude_rad),
    }
}
