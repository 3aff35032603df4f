//! Drives: strips, inertial measurements and GNSS in one adjustment; the whole way, and its stages one by one.

use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};

use crate::cli::{Common, JobArgs};
use crate::command::navigate::write_navigation;
use crate::job::{Clock, JobOptions, Matched, correct_drive, match_drive};
use crate::memory::peak_bytes;
use crate::outputs::drive::write_drive;
use crate::outputs::tie_text::write_tie_text_of;
use crate::progress::Progress;
use crate::project::Project;
use crate::report::data::FileSummary;
use crate::report::drive::data::CorrectedDrive;
use crate::report::drive::{DriveReport, gather, three_lines, write_report};
use crate::report::spots;
use crate::stage::drive;
use crate::stage::drive::correction::DriveCorrection;
use crate::stage::drive::cut::CutPoint;
use crate::stage::drive::residuals::residuals;
use crate::stage::drive::{Decided, DriveSolution, known, picked};
use crate::stage::navigate::{Mask, Measurements, load};
use crate::state::drive::{SolvedDrive, load_calibrate, load_corrected, load_drive, save_corrected, save_drive};
use crate::state::{is_matched, load_match, save_match};

/// Whether a project is a drive with strips.
#[must_use]
pub fn is_drive(project: &Project) -> bool {
    project.imu.is_some() && !project.strips.is_empty()
}

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
    if project.ties.as_ref().is_some_and(|t| t.path.is_some()) {
        bail!(
            "[ties] path beside [[strips]]: run finds ties in the strips; take it out, or use tieline solve, which needs no strips"
        );
    }
    let mut clock = Clock::default();
    let (matched, measurements) = find_ties(project, options, &mut clock)?;
    let solving = Solving { project, options, matched: &matched, measurements: &measurements };
    let mut solved = {
        let solved = solving.estimate(None, &mut clock)?;
        create(&options.out)?;
        clock.time("write", || save_match(&options.out, &matched))?;
        solving.write(&solved, &[], args.csv, &mut clock)?
    };
    let folder = options.out.join("corrected");
    let correction = (&solved.correction, &solved.charts.cuts[..]);
    let (files, cut_points) =
        correct_drive(project, &matched, correction, false, &folder, options.progress, &mut clock)?;
    let corrected = CorrectedDrive { files, cut_points };
    clock.time("write", || save_corrected(&options.out, &corrected))?;
    solved.summary.files = corrected.files;
    conclude(solved, &corrected.cut_points, matched.points, options, &clock, common, out)
}

/// Writes the report with what the job took, and says how it went; `points` were read.
fn conclude(
    mut solved: SolvedDrive,
    cut_points: &[Vec<CutPoint>],
    points: u64,
    options: &JobOptions,
    clock: &Clock,
    common: &Common,
    out: &mut impl Write,
) -> Result<()> {
    solved.summary.timing = clock.timing(points);
    solved.summary.peak_memory_bytes = peak_bytes();
    write_report(&options.out, &solved.summary, &solved.charts, cut_points)?;
    finish(&solved, &options.out, common, out)
}

/// The ties that `match` left in the folder of a job, else those found now, which are left there; with a word when they were found.
///
/// # Errors
/// As [`find_ties`], and when the folder cannot be used.
pub(crate) fn take_up(
    project: &Project,
    options: &JobOptions,
    clock: &mut Clock,
) -> Result<(Matched, Measurements, bool)> {
    if is_matched(&options.out) {
        let matched = load_match(project, &options.out)?;
        return Ok((matched, clock.time("read", || load(project, &[]))?, false));
    }
    let (matched, measurements) = find_ties(project, options, clock)?;
    create(&options.out)?;
    clock.time("write", || save_match(&options.out, &matched))?;
    Ok((matched, measurements, true))
}

/// Reads the measurements of a drive and finds its ties; everything that can be wrong is looked at before the points are read.
///
/// # Errors
/// Whatever is wrong with a file, or does not fit.
pub fn find_ties(project: &Project, options: &JobOptions, clock: &mut Clock) -> Result<(Matched, Measurements)> {
    known::load(project)?;
    picked::load(project)?;
    let measurements = clock.time("read", || load(project, &[]))?;
    let matched = match_drive(project, &measurements, options, clock)?;
    Ok((matched, measurements))
}

/// Trajectory and calibration with the ties of `match`, and with what `calibrate` decided where it was run.
///
/// # Errors
/// When `match` was not run, or as the stage.
pub fn solve(
    project: &Project,
    args: &JobArgs,
    masks: &[Mask],
    options: &JobOptions,
    common: &Common,
    out: &mut impl Write,
) -> Result<()> {
    let mut clock = Clock::default();
    let matched = load_match(project, &options.out)?;
    let (mut decided, note) = load_calibrate(&options.out, project)?;
    if !masks.is_empty() {
        // what is masked is in the trajectory that patches were moved by
        decided.iter_mut().for_each(|d| d.moved_by = None);
    }
    let measurements = clock.time("read", || load(project, masks))?;
    let solving = Solving { project, options, matched: &matched, measurements: &measurements };
    let solved = solving.estimate(decided.as_ref(), &mut clock)?;
    let solved = solving.write(&solved, note.as_slice(), args.csv, &mut clock)?;
    conclude(solved, &[], matched.points, options, &clock, common, out)
}

/// Writes the corrected strips of a drive into the second of two folders, or takes its corrections off strips; the report in the first then
/// names them.
///
/// # Errors
/// When a file cannot be read or written.
pub(crate) fn correct(
    project: &Project,
    matched: &Matched,
    mut solved: SolvedDrive,
    inverse: bool,
    (folder, target): (&Path, &Path),
    progress: Progress,
) -> Result<Vec<FileSummary>> {
    let mut clock = Clock::default();
    // what is taken off again is not looked at
    let cuts = if inverse { &[] } else { &solved.charts.cuts[..] };
    let correction = (&solved.correction, cuts);
    let (files, cut_points) = correct_drive(project, matched, correction, inverse, target, progress, &mut clock)?;
    if !inverse {
        let corrected = CorrectedDrive { files: files.clone(), cut_points };
        save_corrected(folder, &corrected)?;
        solved.summary.files = corrected.files;
        write_report(folder, &solved.summary, &solved.charts, &corrected.cut_points)?;
    }
    Ok(files)
}

/// Writes the report of a drive anew.
///
/// # Errors
/// When `solve` was not run, or a file cannot be written.
pub fn report(folder: &Path, common: &Common, out: &mut impl Write) -> Result<()> {
    let mut solved = load_drive(folder)?;
    let corrected = load_corrected(folder)?;
    solved.summary.files = corrected.files;
    write_report(folder, &solved.summary, &solved.charts, &corrected.cut_points)?;
    finish(&solved, folder, common, out)
}

/// What an estimate is made of.
pub(crate) struct Solving<'a> {
    pub(crate) project: &'a Project,
    pub(crate) options: &'a JobOptions,
    pub(crate) matched: &'a Matched,
    pub(crate) measurements: &'a Measurements,
}

impl Solving<'_> {
    /// Estimates trajectory and calibration.
    pub(crate) fn estimate(&self, decided: Option<&Decided>, clock: &mut Clock) -> Result<DriveSolution> {
        let known = known::load(self.project)?;
        let bar = self.options.progress.spinner("estimating trajectory and calibration");
        let memory_bytes = self.options.memory_bytes;
        let solved = drive::solve(self.project, self.matched, self.measurements, &known, decided, memory_bytes, clock)?;
        bar.finish_and_clear();
        Ok(solved)
    }

    /// Writes all files that follow from an estimate but the report and the corrected strips.
    fn write(&self, drive: &DriveSolution, more: &[String], csv: bool, clock: &mut Clock) -> Result<SolvedDrive> {
        let Self { project, matched, measurements, .. } = *self;
        let folder = &self.options.out;
        let residuals = clock.time("write", || residuals(drive, matched));
        let written = clock.time("write", || -> Result<_> {
            write_drive(project, matched, drive, &residuals, folder, csv)?;
            spots::write(folder, &matched.spots)?;
            let (crs, path) = (matched.survey.crs.as_ref(), folder.join("ties.txt"));
            write_tie_text_of(drive, &measurements.clock, crs, &path)?;
            write_navigation(folder, &drive.solution, &drive.inputs, &measurements.clock)
        })?;
        let mut notes = measurements.notes.clone();
        notes.extend(matched.survey.notes.iter().chain(&matched.poses.notes).cloned());
        notes.extend(drive.notes.iter().chain(&drive.solution.notes).chain(more).cloned());
        let report =
            DriveReport { project, matched, drive, measurements, residuals: &residuals, written, notes: &notes };
        let (summary, charts) = gather(&report);
        let solved = SolvedDrive { correction: DriveCorrection::of(drive), summary, charts };
        clock.time("write", || save_drive(folder, &solved))?;
        Ok(solved)
    }
}

pub(crate) fn create(out: &Path) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("the output folder {} cannot be created", out.display()))
}

/// What is said at the end.
fn finish(solved: &SolvedDrive, folder: &Path, common: &Common, out: &mut impl Write) -> Result<()> {
    let summary = &solved.summary;
    if common.json {
        writeln!(out, "{:#}", serde_json::to_value(summary).context("the summary cannot be written as JSON")?)?;
    } else if !common.quiet {
        for note in &summary.notes {
            tracing::info!("{note}");
        }
        writeln!(out, "{}", three_lines(summary, &solved.charts, &folder.join("report.html")))?;
    }
    Ok(())
}
