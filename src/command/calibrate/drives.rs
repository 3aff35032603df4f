//! `calibrate` of drives: one alone, or several of one platform in one calibration.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use nalgebra::DMatrix;
use tieline_filter::CalibrationEstimate;
use tieline_io::output::write_whole;

use crate::cli::{CalibrateArgs, Common};
use crate::command::drive::{Solving, create, take_up};
use crate::command::project::out_folder;
use crate::job::{Clock, JobOptions};
use crate::memory::peak_bytes;
use crate::outputs::drive::write_calibration;
use crate::progress::Progress;
use crate::project::Project;
use crate::report::drive::calibration_run::{CalibrationRun, DriveOfRun};
use crate::report::drive::{calibrated, calibration};
use crate::stage::drive::alike::{check_alike, check_numbers};
use crate::stage::drive::calibrated::Calibrated;
use crate::stage::drive::combine::{Combined, combine};
use crate::stage::drive::constants::Constants;
use crate::stage::drive::known::{self, Known};
use crate::stage::drive::seen::widen_all;
use crate::stage::drive::{Decisions, Prepared};
use crate::state::drive::save_calibrate;

/// Calibrates the scanners of one drive or more.
///
/// # Errors
/// Whatever stops a stage; when drives are not of one platform.
pub(super) fn run(args: &CalibrateArgs, projects: &[Project], common: &Common, out: &mut impl Write) -> Result<()> {
    let progress = Progress::new(common.quiet || common.json);
    let memory_bytes = args.memory.max(16) << 20;
    let mut clock = Clock::default();
    let (mut run, folder) = match (args.projects.as_slice(), projects) {
        ([file], [project]) => {
            let options = JobOptions { out: out_folder(file, args.out.as_ref()), memory_bytes, progress };
            (one(project, &options, &mut clock)?, options.out)
        }
        _ => {
            let folder = args.out.clone().unwrap_or_else(|| PathBuf::from("out/calibration"));
            let drives: Vec<Drive<'_>> = names(&args.projects)
                .into_iter()
                .zip(projects)
                .map(|(name, project)| {
                    let options = JobOptions { out: folder.join(&name), memory_bytes, progress };
                    Ok(Drive { name, project, known: known::load(project)?, options })
                })
                .collect::<Result<_>>()?;
            (several(&drives, &folder, &mut clock)?, folder)
        }
    };
    run.timing = clock.timing(0);
    run.peak_memory_bytes = peak_bytes();
    let value = serde_json::to_value(&run).context("the summary cannot be written as JSON")?;
    let path = folder.join("summary.json");
    write_whole(&path, format!("{value:#}\n").as_bytes()).with_context(|| format!("writing {}", path.display()))?;
    if common.json {
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        for note in &run.notes {
            tracing::info!("{note}");
        }
        for e in run.calibration.estimates.iter().filter(|_| common.verbose) {
            writeln!(out, "scanner {} {}: {:.5} ± {:.5} {}", e.scanner, e.name, e.value, e.sigma, e.unit)?;
        }
        writeln!(out, "{}.", calibrated(&run.calibration))?;
        writeln!(out, "Calibration: {}", folder.join("calibration.toml").display())?;
    }
    Ok(())
}

/// One drive: what `solve` estimates, and what it decides for the `solve` that comes after.
fn one(project: &Project, options: &JobOptions, clock: &mut Clock) -> Result<CalibrationRun> {
    let (matched, measurements, found) = take_up(project, options, clock)?;
    let solved = Solving { project, options, matched: &matched, measurements: &measurements }.estimate(None, clock)?;
    write_calibration(project, &solved.calibrated(), &options.out)?;
    save_calibrate(&options.out, project, &solved)?;
    let drive = DriveOfRun {
        name: project.name().to_string(),
        ties: solved.chosen.ties.len(),
        sigma_factors: solved.decisions.factors.0.map(f64::sqrt).to_vec(),
        agrees: true,
        ..DriveOfRun::default()
    };
    let mut run = CalibrationRun::new(calibration(&solved.calibrated()), vec![drive]);
    run.notes.extend(found.then(found_now));
    run.notes.extend(solved.notes.iter().cloned());
    Ok(run)
}

fn found_now() -> String {
    String::from("no ties of `tieline match` were there: found now and left for the next time")
}

/// One of several drives.
struct Drive<'a> {
    name: String,
    project: &'a Project,
    known: Vec<Known>,
    options: JobOptions,
}

impl Drive<'_> {
    /// Works on the drive with its parts loaded: no more than one is in memory at a time.
    fn with<T>(&self, clock: &mut Clock, work: impl FnOnce(&Prepared<'_>, &mut Clock) -> Result<T>) -> Result<T> {
        let context = || format!("drive {}", self.name);
        let (matched, measurements, _) = take_up(self.project, &self.options, clock).with_context(context)?;
        let memory_bytes = self.options.memory_bytes;
        let prepared = Prepared::new(self.project, &matched, &measurements, &self.known, memory_bytes, clock);
        work(&prepared.with_context(context)?, clock).with_context(context)
    }
}

/// Several drives of one platform.
fn several(drives: &[Drive<'_>], folder: &Path, clock: &mut Clock) -> Result<CalibrationRun> {
    let named: Vec<(&str, &Project, &[Known])> =
        drives.iter().map(|d| (d.name.as_str(), d.project, d.known.as_slice())).collect();
    check_alike(&named)?;
    create(folder)?;
    let (mut ranges_m, mut inner_m): (Spans, Spans) = (Vec::new(), Vec::new());
    let mut seen = Vec::new();
    let (mut numbers, mut notes) = (Vec::new(), Vec::new());
    for drive in drives {
        drive.with(clock, |prepared, _| {
            widen(&mut ranges_m, &prepared.ranges_m);
            widen(&mut inner_m, &prepared.inner_ranges_m);
            widen_all(&mut seen, &prepared.over);
            numbers.push((drive.name.as_str(), prepared.scanner_numbers().to_vec()));
            notes.extend(prepared.notes.iter().map(|note| format!("drive {}: {note}", drive.name)));
            Ok(())
        })?;
    }
    check_numbers(&numbers)?;
    let mut decisions = vec![Decisions::default(); drives.len()];
    let mut rounds = vec![0; drives.len()];
    let mut joint = Decisions::default();
    let (constants, combined, ties) = loop {
        let mut ties = Vec::new();
        let mut adjusted: Vec<(Constants, CalibrationEstimate)> = Vec::new();
        for (i, drive) in drives.iter().enumerate() {
            let bar = drive.options.progress.spinner("estimating trajectory and calibration");
            decisions[i].verdicts.clone_from(&joint.verdicts);
            drive.with(clock, |prepared, clock| {
                let one = prepared.adjust(&ranges_m, &seen, &mut decisions[i], &mut rounds[i], clock)?;
                ties.push(one.solution.ties.iter().filter(|t| t.why_not.is_none()).count());
                adjusted.push((one.constants, one.solution.calibration));
                Ok(())
            })?;
            bar.finish_and_clear();
        }
        let estimates: Vec<&CalibrationEstimate> = adjusted.iter().map(|a| &a.1).collect();
        let constants = adjusted.first().map(|a| a.0.clone()).context("no drive")?;
        let n = constants.count();
        let prior = DMatrix::from_row_slice(n, n, &constants.covariance());
        let combined = combine(&prior, &estimates).context("the estimate of a drive has no usable covariance")?;
        if joint.judge(&constants, &combined.estimate) {
            break (constants, combined, ties);
        }
    };
    let found = Calibrated {
        constants: &constants,
        estimate: &combined.estimate,
        ranges_m: &inner_m,
        verdicts: &joint.verdicts,
    };
    write_calibration(drives[0].project, &found, folder)?;
    let of_run = |(i, drive): (usize, &Drive<'_>)| {
        let agreement = combined.agreements[i];
        DriveOfRun {
            name: drive.name.clone(),
            ties: ties[i],
            sigma_factors: decisions[i].factors.0.map(f64::sqrt).to_vec(),
            chi_squared: agreement.squared,
            degrees_of_freedom: agreement.freedom,
            chi_squared_limit: agreement.limit(),
            agrees: agreement.holds(),
        }
    };
    let mut run = CalibrationRun::new(calibration(&found), drives.iter().enumerate().map(of_run).collect());
    run.sigma_factor = combined.sigma_factor;
    run.notes = notes;
    run.notes.extend(contradictions(drives, &combined));
    run.notes.extend(crate::stage::drive::notes_of_terms(&joint.verdicts));
    Ok(run)
}

/// What there is to say of drives that do not agree.
fn contradictions(drives: &[Drive<'_>], combined: &Combined) -> Vec<String> {
    let mut notes = Vec::new();
    let bad = || drives.iter().zip(&combined.agreements).filter(|(_, a)| !a.holds());
    let remedy = "check that no scanner was moved between them, and that their strips were made with this [platform]";
    match bad().count() {
        0 => {}
        _ if drives.len() == 2 => notes.push(format!(
            "warning: drives {} and {} contradict each other: chi-squared {:.0} of {} degrees of freedom, {:.0} at most by chance; {remedy}",
            drives[0].name,
            drives[1].name,
            combined.agreements[0].squared.max(combined.agreements[1].squared),
            combined.agreements[0].freedom,
            combined.agreements[0].limit()
        )),
        _ => notes.extend(bad().map(|(drive, a)| {
            format!(
                "warning: drive {} contradicts the others: chi-squared {:.0} of {} degrees of freedom, {:.0} at most by chance; {remedy}",
                drive.name,
                a.squared,
                a.freedom,
                a.limit()
            )
        })),
    }
    if combined.sigma_factor > 1.0 {
        notes.push(format!(
            "drives differ by {:.2} times what their sigmas say: what each says counts with sigmas larger by that",
            combined.sigma_factor
        ));
    }
    notes
}

/// Nearest and farthest range of each scanner \[m\].
type Spans = Vec<(f64, f64)>;

/// Spans that hold others as well.
fn widen(spans: &mut Spans, others: &[(f64, f64)]) {
    for (i, other) in others.iter().enumerate() {
        match spans.get_mut(i) {
            Some(span) => *span = (span.0.min(other.0), span.1.max(other.1)),
            None => spans.push(*other),
        }
    }
}

/// Names of drives by their project files: the stem, with the folder in front where stems are alike, with a number where that does not tell
/// them apart.
fn names(files: &[PathBuf]) -> Vec<String> {
    let stem = |file: &PathBuf| file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let long = |file: &PathBuf| {
        let folder = file.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
        if folder.is_empty() { stem(file) } else { format!("{folder}_{}", stem(file)) }
    };
    let name = |(i, file): (usize, &PathBuf)| {
        let is_alone = |of: &dyn Fn(&PathBuf) -> String| files.iter().filter(|f| of(f) == of(file)).count() == 1;
        match (is_alone(&stem), is_alone(&long)) {
            (true, _) => stem(file),
            (false, true) => long(file),
            (false, false) => format!("{}_{}", long(file), i + 1),
        }
    };
    files.iter().enumerate().map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drives_are_told_apart_by_name() {
        let of = |files: &[&str]| names(&files.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(of(&["a/monday.toml", "b/tuesday.toml"]), ["monday", "tuesday"]);
        assert_eq!(of(&["a/project.toml", "b/project.toml", "c.toml"]), ["a_project", "b_project", "c"]);
        assert_eq!(of(&["x/a/project.toml", "y/a/project.toml"]), ["a_project_1", "a_project_2"]);
    }

    #[test]
    fn spans_hold_those_of_all_drives() {
        let mut spans = Vec::new();
        widen(&mut spans, &[(2.0, 30.0), (3.0, 40.0)]);
        widen(&mut spans, &[(1.5, 20.0), (4.0, 60.0)]);
        assert_eq!(spans, [(1.5, 30.0), (3.0, 60.0)]);
    }
}
