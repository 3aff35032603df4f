//! What the stages of a drive leave for each other: `stages/calibrate.json` and `stages/solve.json`.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};

use super::{VERSION, read, write};
use crate::project::{CalibrateSection, Project};
use crate::report::drive::data::{DriveCharts, DriveSummary};
use crate::stage::drive::Decisions;
use crate::stage::drive::correction::{DriveCorrection, ScannerCorrection};
use crate::stage::trajectory::StoredPath;

/// The result of `calibrate` on disk.
#[derive(Debug, Serialize, Deserialize)]
struct CalibrateState {
    version: u32,
    /// What was asked for.
    asked: CalibrateSection,
    decisions: Decisions,
}

/// The result of `solve` on disk.
#[derive(Debug, Serialize, Deserialize)]
struct SolveState {
    version: u32,
    path: StoredPath,
    scanners: Vec<ScannerCorrection>,
    summary: DriveSummary,
    charts: DriveCharts,
}

/// The result of `solve` for the stages after it.
#[derive(Debug)]
pub(crate) struct SolvedDrive {
    /// What corrects points.
    pub(crate) correction: DriveCorrection,
    /// What `report` writes; corrected files, times and memory as far as they are known.
    pub(crate) summary: DriveSummary,
    /// What its charts show.
    pub(crate) charts: DriveCharts,
}

/// Leaves what `calibrate` decided in the output folder; what `solve` left there is of another calibration and goes.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn save_calibrate(out: &Path, project: &Project, decisions: &Decisions) -> Result<()> {
    super::forget(out, &["solve"])?;
    let state = CalibrateState { version: VERSION, asked: project.calibrate.clone(), decisions: decisions.clone() };
    write(&out.join("stages/calibrate.json"), &state)
}

/// What `calibrate` decided, where it was run; a note where it was run with another `[calibrate]`.
///
/// # Errors
/// When the file cannot be read.
pub(crate) fn load_calibrate(out: &Path, project: &Project) -> Result<(Option<Decisions>, Option<String>)> {
    let path = out.join("stages/calibrate.json");
    if !path.is_file() {
        return Ok((None, None));
    }
    let state: CalibrateState = read(&path, "calibrate")?;
    ensure_version(state.version, &path, "calibrate")?;
    if state.asked != project.calibrate {
        let note = String::from(
            "[calibrate] has changed since `tieline calibrate` was run: what that decided is not taken, terms are judged anew",
        );
        return Ok((None, Some(note)));
    }
    Ok((Some(state.decisions), None))
}

/// Leaves the result of `solve` in the output folder.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn save_drive(out: &Path, solved: &SolvedDrive) -> Result<()> {
    let state = SolveState {
        version: VERSION,
        path: StoredPath::of_poses(&solved.correction.trajectory),
        scanners: solved.correction.scanners.clone(),
        summary: solved.summary.clone(),
        charts: solved.charts.clone(),
    };
    write(&out.join("stages/solve.json"), &state)
}

/// Takes up the result of `solve`.
///
/// # Errors
/// When it is not there or of another version.
pub(crate) fn load_drive(out: &Path) -> Result<SolvedDrive> {
    let path = out.join("stages/solve.json");
    let state: SolveState = read(&path, "solve")?;
    ensure_version(state.version, &path, "solve")?;
    let trajectory = state
        .path
        .trajectory()
        .with_context(|| format!("{} cannot be used: run `tieline solve` again", path.display()))?;
    let correction = DriveCorrection { trajectory, scanners: state.scanners };
    Ok(SolvedDrive { correction, summary: state.summary, charts: state.charts })
}

fn ensure_version(version: u32, path: &Path, stage: &str) -> Result<()> {
    ensure!(version == VERSION, "{} is of another version of tieline: run `tieline {stage}` again", path.display());
    Ok(())
}
