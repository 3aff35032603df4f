//! The report of a drive.

mod calibration;
pub mod calibration_run;
pub mod curves;
mod cuts;
pub mod data;
#[cfg(test)]
mod example;
mod fit;
mod gather;
mod headline;
mod innovation;
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
use crate::report::drive::data::{DriveCharts, DriveSummary};
use crate::stage::drive::DriveSolution;
use crate::stage::drive::cut::CutPoint;
use crate::stage::drive::residuals::Residual;
use crate::stage::navigate::Measurements;

pub(crate) use gather::{calibration, gather};
pub(crate) use headline::calibrated;

/// All that the report of a drive tells but for corrected files, times and memory, which come later.
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
    /// Remarks of all stages.
    pub notes: &'a [String],
}

/// Writes `report.html` and `summary.json`.
///
/// # Errors
/// When one cannot be written.
pub(crate) fn write_report(
    out: &Path,
    summary: &DriveSummary,
    charts: &DriveCharts,
    cut_points: &[Vec<CutPoint>],
) -> Result<()> {
    let value = serde_json::to_value(summary).context("the summary cannot be written as JSON")?;
    let write = |name: &str, text: &str| {
        write_whole(&out.join(name), text.as_bytes()).with_context(|| format!("writing {}", out.join(name).display()))
    };
    write("summary.json", &format!("{value:#}\n"))?;
    write("report.html", &page::render(summary, charts, cut_points))
}

/// What got better, what was calibrated and how sure the trajectory is, and where the report lies.
#[must_use]
pub(crate) fn three_lines(summary: &DriveSummary, charts: &DriveCharts, page: &Path) -> String {
    format!("{}\nReport: {}", headline::two_lines(summary, charts), page.display())
}
