//! The report of a drive.

mod calibration;
pub mod data;
#[cfg(test)]
mod example;
mod fit;
mod gather;
mod headline;
mod map;
mod page;
mod pairs;
mod ranges;
mod timeline;

use std::path::Path;

use anyhow::{Context, Result};
use tieline_io::output::write_whole;

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
pub fn write_report(out: &Path, report: &DriveReport<'_>) -> Result<serde_json::Value> {
    let (summary, charts) = gather::gather(report);
    let value = serde_json::to_value(&summary).context("the summary cannot be written as JSON")?;
    let write = |name: &str, text: &str| {
        write_whole(&out.join(name), text.as_bytes()).with_context(|| format!("writing {}", out.join(name).display()))
    };
    write("summary.json", &format!("{value:#}\n"))?;
    write("report.html", &page::render(&summary, &charts))?;
    Ok(value)
}

/// What got better, what was calibrated and how sure the trajectory is, and where the report lies.
#[must_use]
pub fn three_lines(report: &DriveReport<'_>, page: &Path) -> String {
    let (summary, charts) = gather::gather(report);
    format!("{}\nReport: {}", headline::two_lines(&summary, &charts), page.display())
}
