//! What the stages of a drive leave for each other: `stages/calibrate.json` and `stages/solve.json`.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};

use super::{VERSION, read, write};
use crate::project::{CalibrateSection, Project};
use crate::report::drive::data::{CorrectedDrive, DriveCharts, DriveSummary};
use crate::stage::drive::correction::{DriveCorrection, ScannerCorrection};
use crate::stage::drive::{Decided, Decisions, DriveSolution};
use crate::stage::trajectory::StoredPath;

/// The result of `calibrate` on disk.
#[derive(Debug, Serialize, Deserialize)]
struct CalibrateState {
    version: u32,
    /// What was asked for.
    asked: CalibrateSection,
    decisions: Decisions,
    moved_by: Option<MovedBy>,
}

/// What patches were moved by to measure ties again.
#[derive(Debug, Serialize, Deserialize)]
struct MovedBy {
    path: StoredPath,
    scanners: Vec<ScannerCorrection>,
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

/// The result of `correct` on disk.
#[derive(Debug, Serialize, Deserialize)]
struct CorrectState {
    version: u32,
    corrected: CorrectedDrive,
}

/// Leaves what `correct` has for the report in the output folder.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn save_corrected(out: &Path, corrected: &CorrectedDrive) -> Result<()> {
    write(&out.join("stages/correct.json"), &CorrectState { version: VERSION, corrected: corrected.clone() })
}

/// What `correct` left for the report; nothing where it was not run.
///
/// # Errors
/// When the file cannot be read.
pub(crate) fn load_corrected(out: &Path) -> Result<CorrectedDrive> {
    let path = out.join("stages/correct.json");
    if !path.is_file() {
        return Ok(CorrectedDrive::default());
    }
    let state: CorrectState = read(&path, "correct")?;
    ensure_version(state.version, &path, "correct")?;
    Ok(state.corrected)
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
pub(crate) fn save_calibrate(out: &Path, project: &Project, solved: &DriveSolution) -> Result<()> {
    super::forget(out, &["solve", "correct"])?;
    let moved_by = solved.moved_by.as_ref();
    let state = CalibrateState {
        version: VERSION,
        asked: project.calibrate.clone(),
        decisions: solved.decisions.clone(),
        moved_by: moved_by.map(|m| MovedBy { path: StoredPath::of_poses(&m.trajectory), scanners: m.scanners.clone() }),
    };
    write(&out.join("stages/calibrate.json"), &state)
}

/// What `calibrate` decided, where it was run; a note where it was run with another `[calibrate]`.
///
/// # Errors
/// When the file cannot be read.
pub(crate) fn load_calibrate(out: &Path, project: &Project) -> Result<(Option<Decided>, Option<String>)> {
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
    let unusable = || format!("{} cannot be used: run `tieline calibrate` again", path.display());
    let moved_by = match state.moved_by {
        Some(MovedBy { path, scanners }) => {
            Some(DriveCorrection { trajectory: path.trajectory().with_context(unusable)?, scanners })
        }
        None => None,
    };
    Ok((Some(Decided { decisions: state.decisions, moved_by }), None))
}

/// Leaves the result of `solve` in the output folder; what `correct` left there is of another solution and goes.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn save_drive(out: &Path, solved: &SolvedDrive) -> Result<()> {
    super::forget(out, &["correct"])?;
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
