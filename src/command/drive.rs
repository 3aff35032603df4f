//! `run` of a drive: strips, inertial measurements and GNSS in one adjustment.

use std::io::Write;

use anyhow::{Context, Result, bail};

use crate::cli::{Common, JobArgs};
use crate::command::navigate::write_navigation;
use crate::job::{Clock, JobOptions, correct_drive, match_strips};
use crate::memory::peak_bytes;
use crate::outputs::drive::write_drive;
use crate::outputs::tie_text::write_tie_text_of;
use crate::project::Project;
use crate::report::drive::{DriveReport, three_lines, write_report};
use crate::stage::drive;
use crate::stage::drive::known;
use crate::stage::drive::residuals::residuals;
use crate::stage::navigate::load;

/// The whole way of a drive.
///
/// # Errors
/// Whatever stops a stage.
pub fn run(
    project: &Project,
    args: &JobArgs,
    options: &JobOptions,
    common: &Common,
    out: &mut impl Write,
) -> Result<()> {
    if project.ties.is_some() {
        bail!(
            "[ties] beside [[strips]]: run finds ties in the strips; take [ties] out, or use tieline solve, which needs no strips"
        );
    }
    let known = known::load(project)?;
    let mut clock = Clock::default();
    let measurements = clock.time("read", || load(project, &[]))?;
    let matched = match_strips(project, options, &mut clock)?;
    let bar = options.progress.spinner("estimating trajectory and calibration");
    let memory_bytes = args.memory.max(16) << 20;
    let solved = drive::solve(project, &matched, &measurements, &known, memory_bytes, &mut clock)?;
    bar.finish_and_clear();
    std::fs::create_dir_all(&options.out)
        .with_context(|| format!("the output folder {} cannot be created", options.out.display()))?;
    let residuals = clock.time("write", || residuals(&solved, &matched));
    let written = clock.time("write", || -> Result<_> {
        write_drive(project, &matched, &solved, &residuals, &options.out, args.csv)?;
        let (crs, path) = (matched.survey.crs.as_ref(), options.out.join("ties.txt"));
        write_tie_text_of(&solved, &measurements.clock, crs, &path)?;
        write_navigation(&options.out, &solved.solution, &solved.inputs, &measurements.clock)
    })?;
    let folder = options.out.join("corrected");
    let files = correct_drive(project, &matched, &solved, &folder, options.progress, &mut clock)?;
    let mut notes = measurements.notes.clone();
    notes.extend(matched.survey.notes.iter().chain(&matched.poses.notes).cloned());
    notes.extend(solved.notes.iter().chain(&solved.solution.notes).cloned());
    let report = DriveReport {
        project,
        matched: &matched,
        drive: &solved,
        measurements: &measurements,
        residuals: &residuals,
        written,
        files: &files,
        notes: &notes,
        timing: clock.timing(matched.points),
        peak_memory_bytes: peak_bytes(),
    };
    let summary = write_report(&options.out, &report)?;
    if common.json {
        writeln!(out, "{summary:#}")?;
    } else if !common.quiet {
        for note in &notes {
            tracing::info!("{note}");
        }
        writeln!(out, "{}", three_lines(&report, &options.out.join("report.html")))?;
    }
    Ok(())
}
