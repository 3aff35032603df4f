//! The files of a drive: what the user receives, and apart from it the truth.
//!
//! ```text
//! out/project.toml                    ready for `tieline run`
//! out/strips/pass1.laz …              LAS 1.4 format 6, a file per lap, point source id = number of the lap
//! out/trajectory.sbet, _rms.out       the smoother's solution, and its own standard deviations at 1 Hz
//! out/imu.txt.gz                      seconds of week, increments of angle [rad] and velocity [m/s], front-right-down
//! out/gnss.pos, out/odometer.csv      RTKLIB's format, antenna; speed of a wheel
//! out/calibration.toml                nominal lever arms, mounting, noise
//! out/truth/                          truth.sbet, calibration_true.toml, bias_functions.csv, outages.csv, passes.csv,
//!                                     features.csv, range_hist.csv, manifest.json, scenario.toml, strips/; bias_over.csv
//!                                     where a scanner errs with incidence or intensity
//! ```

mod sensors;
mod strips;
mod truth;

use std::io::Write;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use tieline_filter::Trajectory;
use tieline_io::output::{WholeFile, write_whole};
use tieline_io::trajectory::{write_sbet, write_smrmsg};

use super::scenario::DriveScenario;
use super::survey::DriveSurvey;
use crate::error::SimulateError;
use crate::output::{StripReport, remove_old};

/// What was written.
#[derive(Debug, Clone)]
pub struct DriveReport {
    /// The project file.
    pub project: PathBuf,
    /// The strips.
    pub strips: Vec<StripReport>,
    /// Duration of the data \[s\].
    pub duration_s: f64,
    /// Length of the way \[m\].
    pub length_m: f64,
}

impl DriveReport {
    /// Points of all strips.
    #[must_use]
    pub fn points(&self) -> u64 {
        self.strips.iter().map(|strip| strip.points).sum()
    }
}

/// Simulates a drive into the folder `out`, which is created. `progress` hears how many pulses are done of how many.
///
/// # Errors
/// [`SimulateError`] when a number makes no sense or the disk refuses.
pub fn simulate_drive(
    scenario: &DriveScenario,
    out: &Path,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<DriveReport, SimulateError> {
    let survey = DriveSurvey::new(scenario)?;
    write(&survey, out, progress)
}

/// Writes a drive.
///
/// # Errors
/// When the disk refuses, or the drive leaves the strips' reference system.
pub fn write(
    survey: &DriveSurvey,
    out: &Path,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<DriveReport, SimulateError> {
    let scenario = survey.scenario();
    let truth_folder = out.join("truth");
    let mut folders = vec![out.join("strips"), truth_folder.clone()];
    if scenario.output.true_points {
        folders.push(truth_folder.join("strips"));
    }
    for folder in folders {
        std::fs::create_dir_all(&folder).map_err(|source| SimulateError::Io { path: folder.clone(), source })?;
    }
    remove_old(&out.join("odometer.csv"))?;
    for folder in [out.join("strips"), truth_folder.join("strips")] {
        for pass in 1.. {
            if !remove_old(&folder.join(format!("pass{pass}.laz")))? {
                break;
            }
        }
    }
    sensors::write_imu(&out.join("imu.txt.gz"), survey)?;
    write_text(&out.join("gnss.pos"), &sensors::gnss(survey))?;
    if scenario.odometer.used {
        write_text(&out.join("odometer.csv"), &sensors::odometer(survey))?;
    }
    write_sbet(&out.join("trajectory.sbet"), survey.delivered())?;
    write_smrmsg(&out.join("trajectory_rms.out"), &each_second(survey.delivered())?)?;
    write_text(&out.join("calibration.toml"), &sensors::calibration(survey))?;
    let project = out.join("project.toml");
    write_text(&project, &sensors::project(survey))?;

    let mut histogram = truth::RangeHistogram::new(survey);
    let strips = strips::write(survey, out, &mut histogram, progress)?;

    write_sbet(&truth_folder.join("truth.sbet"), survey.truth())?;
    let files = [
        ("calibration_true.toml", truth::calibration(survey)),
        ("bias_functions.csv", truth::bias_functions(survey)),
        ("outages.csv", truth::outages(survey)),
        ("passes.csv", truth::passes(survey)),
        ("features.csv", truth::features(survey)?),
        ("range_hist.csv", histogram.text()),
        ("manifest.json", truth::manifest(survey, &strips)),
        ("scenario.toml", toml::to_string(scenario).unwrap_or_default()),
    ];
    for (name, text) in files {
        write_text(&truth_folder.join(name), &text)?;
    }
    remove_old(&truth_folder.join("bias_over.csv"))?;
    if let Some(text) = truth::bias_over(survey) {
        write_text(&truth_folder.join("bias_over.csv"), &text)?;
    }
    let (start_s, end_s) = survey.span_s();
    Ok(DriveReport { project, strips, duration_s: end_s - start_s, length_m: survey.length_m() })
}

fn write_text(path: &Path, text: &str) -> Result<(), SimulateError> {
    write_whole(path, text.as_bytes()).map_err(|source| SimulateError::Io { path: path.to_path_buf(), source })
}

/// Writes a file piece by piece, whole or not at all.
fn write_stream(path: &Path, write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<(), SimulateError> {
    let refused = |source| SimulateError::Io { path: path.to_path_buf(), source };
    let mut file = WholeFile::create(path).map_err(refused)?;
    write(file.writer()).map_err(refused)?;
    file.finish().map_err(refused)
}

/// An epoch a second, with its standard deviations.
#[allow(clippy::cast_precision_loss)]
fn each_second(trajectory: &Trajectory) -> Result<Trajectory, SimulateError> {
    let (start_s, _) = trajectory.span_s();
    let mut kept: Vec<usize> = Vec::new();
    for (k, time_s) in trajectory.time_s().iter().enumerate() {
        if *time_s >= start_s + kept.len() as f64 - 1e-6 || k + 1 == trajectory.len() {
            kept.push(k);
        }
    }
    let thinned = Trajectory::new(
        trajectory.frame(),
        kept.iter().map(|&k| trajectory.time_s()[k]).collect(),
        kept.iter().map(|&k| trajectory.position()[k]).collect(),
        kept.iter().map(|&k| trajectory.ned_from_body()[k]).collect(),
        Vec::new(),
    )?;
    Ok(thinned.with_sigma(kept.iter().map(|&k| trajectory.sigma()[k]).collect())?)
}

/// Three numbers as a TOML array.
fn array(v: [f64; 3]) -> String {
    format!("[{:?}, {:?}, {:?}]", v[0], v[1], v[2])
}

/// The same of a vector.
fn vector(v: &Vector3<f64>) -> String {
    array([v.x, v.y, v.z])
}
