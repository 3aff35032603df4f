//! Commands that work on a project: run, match, solve, correct, report.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use tieline_graph::Model;

use crate::cli::{Common, CorrectArgs, JobArgs};
use crate::command::{calibrate, drive, navigate};
use crate::job::{Clock, JobOptions, Matched, correct_strips, match_strips, setup_of, solve_strips};
use crate::memory::peak_bytes;
use crate::outputs::{write_calibration, write_corrections, write_ties};
use crate::progress::Progress;
use crate::project::Project;
use crate::report::data::{Summary, TiePoint};
use crate::report::{three_lines, write_all};
use crate::stage::navigate::Mask;
use crate::stage::solve::{Setup, Solution};
use crate::state::drive::load_drive;
use crate::state::{StoredPoint, is_matched, load_match, load_solve, save_match, save_solve};
use crate::summary::summarise;

/// Output folder of a project: as asked, else `out/<stem of the project file>`.
#[must_use]
pub fn out_folder(project: &Path, asked: Option<&PathBuf>) -> PathBuf {
    asked.cloned().unwrap_or_else(|| PathBuf::from("out").join(project.file_stem().unwrap_or_default()))
}

fn options(args: &JobArgs, common: &Common) -> JobOptions {
    JobOptions {
        out: out_folder(&args.project, args.out.as_ref()),
        memory_bytes: args.memory.max(16) << 20,
        progress: Progress::new(common.quiet || common.json),
    }
}

fn create(out: &Path) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("the output folder {} cannot be created", out.display()))
}

/// The whole way.
///
/// # Errors
/// Whatever stops a stage; and a folder that is in use.
pub fn run(args: &JobArgs, overwrite: bool, common: &Common, out: &mut impl Write) -> Result<()> {
    let options = options(args, common);
    let in_use = std::fs::read_dir(&options.out).is_ok_and(|mut entries| entries.next().is_some());
    if in_use && !overwrite {
        bail!("the output folder {} is not empty: name another with --out, or give --overwrite", options.out.display());
    }
    let project = Project::load(&args.project)?;
    if !project.stations.is_empty() {
        return calibrate::of_stations(&project, &options.out, args.csv, common, out);
    }
    if project.strips.is_empty() {
        return navigate::solve(&project, args, &[], common, out);
    }
    if drive::is_drive(&project) {
        return drive::run(&project, args, &options, common, out);
    }
    let mut clock = Clock::default();
    let matched = match_strips(&project, &options, &mut clock)?;
    tell(common, || notes_of(&matched));
    let solution = solve_strips(&project, &matched, &mut clock)?;
    create(&options.out)?;
    let (mut summary, points) = summarise(&project, &matched, &solution);
    save_match(&options.out, &matched)?;
    clock.time("report", || after_solve(&project, &matched, &solution, &summary, &points, &options.out, args.csv))?;
    let state = (&solution.setup, &solution.model);
    let folder = options.out.join("corrected");
    summary.files = correct_strips(&project, &matched, state, false, &folder, options.progress, &mut clock)?;
    clock.time("report", || report(&matched, &mut summary, &points, &options.out))?;
    summary.timing = clock.timing(matched.points);
    summary.peak_memory_bytes = peak_bytes();
    report(&matched, &mut summary, &points, &options.out)?;
    finish(&summary, &options.out, common, out)
}

fn tell(common: &Common, lines: impl FnOnce() -> Vec<String>) {
    if !common.quiet && !common.json {
        for line in lines() {
            tracing::info!("{line}");
        }
    }
}

fn notes_of(matched: &Matched) -> Vec<String> {
    let mut notes = matched.survey.notes.clone();
    notes.extend(matched.poses.notes.iter().cloned());
    notes
}

/// Files that follow from a solution.
fn after_solve(
    project: &Project,
    matched: &Matched,
    solution: &Solution,
    summary: &Summary,
    points: &[TiePoint],
    out: &Path,
    csv: bool,
) -> Result<()> {
    write_ties(project, matched, Some(solution), out, csv)?;
    write_calibration(project, matched, solution, out)?;
    write_corrections(matched, solution, out)?;
    let stored: Vec<StoredPoint> =
        points.iter().map(|p| (p.map_m, p.pair, p.normal_up, p.before_m, p.after_m, p.held_out, p.outlier)).collect();
    save_solve(out, solution, summary, &stored)
}

fn restore(points: &[StoredPoint]) -> Vec<TiePoint> {
    points
        .iter()
        .map(|(map_m, pair, normal_up, before_m, after_m, held_out, outlier)| TiePoint {
            map_m: *map_m,
            pair: *pair,
            normal_up: *normal_up,
            before_m: *before_m,
            after_m: *after_m,
            held_out: *held_out,
            outlier: *outlier,
        })
        .collect()
}

fn report(matched: &Matched, summary: &mut Summary, points: &[TiePoint], out: &Path) -> Result<()> {
    let epsg = matched.survey.crs.as_ref().and_then(tieline_io::crs::Crs::epsg);
    write_all(out, summary, points, epsg).with_context(|| format!("writing the report into {}", out.display()))
}

fn finish(summary: &Summary, folder: &Path, common: &Common, out: &mut impl Write) -> Result<()> {
    if common.json {
        serde_json::to_writer_pretty(&mut *out, summary)?;
        writeln!(out)?;
    } else if !common.quiet {
        if common.verbose {
            for s in &summary.settings {
                writeln!(out, "{} = {} ({})", s.key, s.value, s.reason)?;
            }
            for t in &summary.calibration.trials {
                writeln!(out, "{}{}: {}", if t.taken { "* " } else { "  " }, t.model, t.reason)?;
            }
        }
        writeln!(out, "{}", three_lines(summary, &folder.join("report.html")))?;
    }
    Ok(())
}

/// Finds the ties.
///
/// # Errors
/// As the stage.
pub fn match_only(args: &JobArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let options = options(args, common);
    let project = Project::load(&args.project)?;
    let mut clock = Clock::default();
    let matched = if drive::is_drive(&project) {
        drive::find_ties(&project, &options, &mut clock)?.0
    } else {
        match_strips(&project, &options, &mut clock)?
    };
    tell(common, || notes_of(&matched));
    create(&options.out)?;
    save_match(&options.out, &matched)?;
    write_ties(&project, &matched, None, &options.out, args.csv)?;
    let held = matched.ties.held_out.iter().filter(|h| **h).count();
    if common.json {
        let value = serde_json::json!({
            "strips": matched.strips.strips().iter().map(|s| &s.name).collect::<Vec<_>>(),
            "points": matched.points, "patches": matched.ties.patches, "found": matched.ties.found,
            "selected": matched.ties.selected.len(), "held_out": held, "rejected": matched.ties.rejected,
            "settings": matched.settings, "timing": clock.timing(matched.points),
            "peak_memory_bytes": peak_bytes(),
        });
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        if common.verbose {
            for s in &matched.settings {
                writeln!(out, "{} = {} ({})", s.key, s.value, s.reason)?;
            }
        }
        writeln!(
            out,
            "{} strips, {} points, {} ties found, {} selected, {held} of them held out: {}",
            matched.strips.strips().len(),
            matched.points,
            matched.ties.found,
            matched.ties.selected.len(),
            options.out.join("ties.parquet").display()
        )?;
    }
    Ok(())
}

/// Solves for the errors with the ties of `match`.
///
/// # Errors
/// As the stage; when `match` was not run.
pub fn solve_only(args: &JobArgs, masks: &[Mask], common: &Common, out: &mut impl Write) -> Result<()> {
    let options = options(args, common);
    let project = Project::load(&args.project)?;
    let given = project.ties.as_ref();
    let of_points = given.is_some_and(|t| t.points.is_some());
    if drive::is_drive(&project) && given.is_none_or(|t| t.path.is_none()) && (of_points || is_matched(&options.out)) {
        // where match was not run, picked points say so
        return drive::solve(&project, args, masks, &options, common, out);
    }
    if project.imu.is_some() {
        return navigate::solve(&project, args, masks, common, out);
    }
    if !masks.is_empty() {
        bail!("--mask-gnss is for projects with [imu] and [gnss]; this one has no [imu]");
    }
    let matched = load_match(&project, &options.out)?;
    let mut clock = Clock::default();
    let solution = solve_strips(&project, &matched, &mut clock)?;
    let (mut summary, points) = summarise(&project, &matched, &solution);
    summary.timing = clock.timing(matched.points);
    summary.peak_memory_bytes = peak_bytes();
    after_solve(&project, &matched, &solution, &summary, &points, &options.out, args.csv)?;
    report(&matched, &mut summary, &points, &options.out)?;
    finish(&summary, &options.out, common, out)
}

/// Writes the report anew.
///
/// # Errors
/// When `solve` was not run, or a file cannot be written.
pub fn report_only(args: &JobArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let options = options(args, common);
    let project = Project::load(&args.project)?;
    if drive::is_drive(&project) {
        return drive::report(&options.out, common, out);
    }
    let matched = load_match(&project, &options.out)?;
    let (_, mut state) = load_solve(&setup_of(&project, &matched), &options.out)?;
    let points = restore(&state.points);
    report(&matched, &mut state.summary, &points, &options.out)?;
    finish(&state.summary, &options.out, common, out)
}

/// Writes the corrected strips of a project, or takes its corrections off strips.
///
/// # Errors
/// When `solve` was not run, or a file cannot be read or written.
pub fn correct(args: &CorrectArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let (file, strips) = args.inputs.split_first().context("no project file")?;
    let folder = out_folder(file, args.out.as_ref());
    let project = Project::load(file)?;
    let mut matched = load_match(&project, &folder)?;
    let progress = Progress::new(common.quiet || common.json);
    let target = folder.join(if args.inverse { "restored" } else { "corrected" });
    let files = if drive::is_drive(&project) {
        let solved = load_drive(&folder)?;
        replace_strips(&mut matched, args.inverse, strips)?;
        drive::correct(&project, &matched, solved, args.inverse, (&folder, &target), progress)?
    } else {
        let setup: Setup = setup_of(&project, &matched);
        let (model, mut state): (Model, _) = load_solve(&setup, &folder)?;
        replace_strips(&mut matched, args.inverse, strips)?;
        let (model, mut clock) = ((&setup, &model), Clock::default());
        let files = correct_strips(&project, &matched, model, args.inverse, &target, progress, &mut clock)?;
        if !args.inverse {
            state.summary.files.clone_from(&files);
            report(&matched, &mut state.summary, &restore(&state.points), &folder)?;
        }
        files
    };
    if common.json {
        serde_json::to_writer_pretty(&mut *out, &files)?;
        writeln!(out)?;
    } else if !common.quiet {
        for file in &files {
            writeln!(out, "{}: {} points, moved by up to {:.3} m", file.output, file.points, file.largest_shift_m)?;
        }
    }
    Ok(())
}

/// With `inverse` the corrected strips stand in for those of the project; without it none may be named.
fn replace_strips(matched: &mut Matched, inverse: bool, strips: &[PathBuf]) -> Result<()> {
    if !inverse {
        if let Some(extra) = strips.first() {
            bail!("{}: strips are named with --inverse, or with --from and --to", extra.display());
        }
        return Ok(());
    }
    if strips.is_empty() {
        bail!("--inverse takes the corrections off strips: name the corrected files after the project file");
    }
    matched.survey.replace_files(strips)
}
