//! A whole job: scan → trajectory → ties → solve → correct → report.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, anyhow, bail};
use nalgebra::Vector3;
use rayon::prelude::*;
use tieline_graph::Model;
use tieline_io::las::Columns;
use tieline_matching::xyz::texture::SpotTie;
use tieline_matching::xyz::{FeatureTie, StreetCornerOptions};
use tieline_matching::{CONTROL_FILE, SourceKey, SourceRule, StripIndex, geometry::StripBox};

use crate::cpu;
use crate::progress::Progress;
use crate::project::{ControlKind, Project, XyzWord};
use crate::report::data::{FileSummary, Timing};
use crate::sample::Sample;
use crate::settings::{Grouping, Setting, Settings};
use crate::stage::corners::corners;
use crate::stage::correct::{Corrections, correct_file, output_names};
use crate::stage::drive::check;
use crate::stage::drive::correction::DriveCorrection;
use crate::stage::drive::cut::{Collector, Cut, CutPoint};
use crate::stage::navigate::Measurements;
use crate::stage::nearby::Nearby;
use crate::stage::places::{self, keep::SubmapPoints};
use crate::stage::poles::poles_of;
use crate::stage::scan::scan;
use crate::stage::solve::{Setup, Solution, solve};
use crate::stage::texture::spots;
use crate::stage::ties::{ControlPoint, Found, Ties, find};
use crate::stage::trajectory::{Poses, load};
use crate::survey::Survey;

/// What a job is run with, beside its project.
#[derive(Debug, Clone)]
pub struct JobOptions {
    /// Output folder.
    pub out: PathBuf,
    /// Memory for patches \[bytes\].
    pub memory_bytes: u64,
    /// Whether bars are drawn.
    pub progress: Progress,
}

/// Memory for patches when none is asked for \[bytes\].
pub const DEFAULT_MEMORY_BYTES: u64 = 256 << 20;

/// The seconds of each stage.
#[derive(Debug, Default)]
pub struct Clock {
    timing: Timing,
}

impl Clock {
    /// Runs a stage and notes its time.
    pub fn time<T>(&mut self, stage: &str, work: impl FnOnce() -> T) -> T {
        let (start, cpu_s) = (Instant::now(), cpu::seconds());
        let result = work();
        *self.timing.stage.entry(stage.to_string()).or_default() += start.elapsed().as_secs_f64();
        let used_s = cpu::seconds() - cpu_s;
        if cpu_s > 0.0 || used_s > 0.0 {
            *self.timing.cpu.entry(stage.to_string()).or_default() += used_s;
        }
        result
    }

    /// Notes that a stage went over so many points of a survey of `all`.
    #[allow(clippy::cast_precision_loss)]
    pub fn passed(&mut self, stage: &str, points: u64, all: u64) {
        *self.timing.passes.entry(stage.to_string()).or_default() += points as f64 / all.max(1) as f64;
    }

    /// The seconds of each stage, and points per second over all.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn timing(&self, points: u64) -> Timing {
        let total: f64 = self.timing.stage.values().sum();
        Timing { points_per_second: points as f64 / total.max(1e-9), ..self.timing.clone() }
    }
}

/// A survey with its ties: the result of `match`.
#[derive(Debug)]
pub struct Matched {
    /// The survey.
    pub survey: Survey,
    /// What tells sources apart.
    pub rule: SourceRule,
    /// Floor of the sigma of a tie end \[m\].
    pub sigma_floor_m: f64,
    /// How patches became ties.
    pub grouping: Grouping,
    /// Settings with their reasons.
    pub settings: Vec<Setting>,
    /// Strips.
    pub strips: StripIndex,
    /// Their poses.
    pub poses: Poses,
    /// Ties.
    pub ties: Ties,
    /// Spots of pavement, where they were looked for.
    pub spots: Vec<SpotTie>,
    /// Corners and poles, where they were looked for.
    pub features: Vec<FeatureTie>,
    /// Points read.
    pub points: u64,
}

/// Opens a survey and finds its ties.
///
/// # Errors
/// Whatever makes the survey unusable; when no two strips overlap.
pub fn match_strips(project: &Project, options: &JobOptions, clock: &mut Clock) -> Result<Matched> {
    match_all(project, None, options, clock)
}

/// Opens a drive and finds its ties; what can be seen of its parts before all points are read is looked at first.
///
/// # Errors
/// As [`match_strips`], and what does not fit together.
pub fn match_drive(
    project: &Project,
    measurements: &Measurements,
    options: &JobOptions,
    clock: &mut Clock,
) -> Result<Matched> {
    match_all(project, Some(measurements), options, clock)
}

fn match_all(
    project: &Project,
    measurements: Option<&Measurements>,
    options: &JobOptions,
    clock: &mut Clock,
) -> Result<Matched> {
    let survey = clock.time("open", || Survey::open(project))?;
    let mut notes = Vec::new();
    let given = clock.time("trajectory", || load(project, &survey, &mut notes))?;
    let (settings, sampled) = clock.time("open", || {
        let sample = Sample::read(&survey)?;
        let settings = Settings::derive(project, &survey, &sample, options.memory_bytes, rayon::current_num_threads())?;
        if let Some(measurements) = measurements {
            check::before_scan(project, &survey, &sample, &settings.grid.rule, given.as_ref(), measurements)?;
        }
        anyhow::Ok((settings, sample.chunks.iter().map(|c| c.1.len() as u64).sum()))
    })?;
    let is_asked = |word: XyzWord| measurements.is_some() && project.matching.xyz.has(word);
    let wanted = [is_asked(XyzWord::Texture), is_asked(XyzWord::Pole)];
    let nearby = given.as_ref().filter(|_| wanted.contains(&true)).map(|given| {
        Nearby::new(project, given, survey.origin_m, wanted, (options.memory_bytes, rayon::current_num_threads()))
    });
    let submaps = SubmapPoints::new(&settings, survey.points(), options.memory_bytes, rayon::current_num_threads());
    let mut scanned =
        clock.time("scan", || scan(&survey, &settings, nearby.as_ref(), submaps.as_ref(), &options.progress))?;
    let (points_of_pavement, points_beside) = (scanned.pavement.take(), scanned.posts.take());
    let points_of_submaps = scanned.submaps.take();
    let points = scanned.counts.read;
    clock.passed("open", sampled, survey.points());
    clock.passed("scan", points, survey.points());
    if scanned.counts.without_time > 0 {
        return Err(first_without_time(&survey, scanned.counts.without_time));
    }
    let strips = StripIndex::new(&scanned.sketches, settings.strips, |source, number, of| {
        strip_name(&survey, source, number, of)
    });
    check_fixed(project, &strips)?;
    let mut poses = clock.time("trajectory", || Poses::new(project, &survey, given, &strips, &scanned.sketches))?;
    notes.append(&mut poses.notes);
    poses.notes = notes;
    check_overlap(&strips, &scanned.sketches)?;
    let control = control_points(project, &survey)?;
    let street = is_asked(XyzWord::Corner).then(StreetCornerOptions::default);
    let Found { mut ties, faces, corners: found_corners } =
        clock.time("ties", || find(scanned, &strips, &settings, &control, &poses, street.as_ref()))?;
    if !settings.xyz.is_empty() && !settings.is_drive {
        ties.places = clock.time("xyz", || places::find(points_of_submaps.as_ref(), faces, &strips, &settings))?;
    }
    let mut features = Vec::new();
    if let Some(trajectory) = poses.shared().filter(|_| street.is_some()) {
        let origin_m = survey.origin();
        let (found, note) = clock.time("corners", || corners(found_corners, &mut ties, project, trajectory, &origin_m));
        features = found;
        poses.notes.push(note);
    }
    let mut spots_of_pavement = Vec::new();
    if let Some((points, trajectory)) = points_of_pavement.zip(poses.shared()) {
        let (found, note) = clock.time("texture", || spots(&points, trajectory))?;
        spots_of_pavement = found;
        poses.notes.push(note);
    }
    if let Some((points, trajectory)) = points_beside.zip(poses.shared()) {
        let origin_m = survey.origin();
        let (found, note) = clock.time("poles", || poles_of(&points, &strips, project, trajectory, &origin_m))?;
        features.extend(found);
        poses.notes.push(note);
    }
    let (rule, sigma_floor_m, grouping) = (settings.grid.rule, settings.pairing.sigma_floor_m, settings.grouping());
    let (settings, spots) = (settings.list, spots_of_pavement);
    Ok(Matched { survey, rule, sigma_floor_m, grouping, settings, strips, poses, ties, spots, features, points })
}

/// The error of points whose time is not a number: names the first of them.
fn first_without_time(survey: &Survey, count: u64) -> anyhow::Error {
    let (mut records, mut columns) = (Vec::new(), Columns::default());
    for file in &survey.files {
        for chunk in 0..file.las.chunk_count() {
            if let Err(error) = file.las.read_columns(chunk, &mut records, &mut columns) {
                return error.into();
            }
            if let Some(index) = columns.gps_time.iter().position(|t| !t.is_finite()) {
                return anyhow!(
                    "{}: point {} has a GPS time that is not a number, as {count} points of the survey have; \
                     remove them or export the strips again",
                    file.las.path().display(),
                    file.las.chunk_points(chunk).start + index as u64
                );
            }
        }
    }
    anyhow!("{count} points have a GPS time that is not a number; remove them or export the strips again")
}

/// Strips that the project holds fixed must be there.
fn check_fixed(project: &Project, strips: &StripIndex) -> Result<()> {
    let names: Vec<&str> = strips.strips().iter().map(|s| s.name.as_str()).collect();
    if let Some(unknown) = project.solve.fixed.iter().find(|name| !names.contains(&name.as_str())) {
        bail!("solve.fixed names \"{unknown}\", which is no strip of this survey: there are {}", names.join(", "));
    }
    Ok(())
}

/// Name of a strip: what tells it apart, with a number when one source has several strips.
fn strip_name(survey: &Survey, source: SourceKey, number: usize, of: usize) -> String {
    let file = survey.files.iter().find(|f| f.number == source.file());
    let stem = file.and_then(|f| f.las.path().file_stem()).map(|s| s.to_string_lossy().into_owned());
    let base = match (source.file() >= CONTROL_FILE, source.point_source_id()) {
        (true, _) => format!("control {}", stem.unwrap_or_default()),
        (false, 0) if source.file() > 0 || survey.strip_files().count() == 1 && of == 1 => stem.unwrap_or_default(),
        (false, 0) => String::from("strip"),
        (false, id) => id.to_string(),
    };
    if of > 1 { format!("{base}.{}", number + 1) } else { base }
}

fn check_overlap(strips: &StripIndex, sketches: &[((SourceKey, i64), tieline_matching::BinSketch)]) -> Result<()> {
    let mut points: Vec<Vec<[f64; 3]>> = vec![Vec::new(); strips.strips().len()];
    for ((source, _), bin) in sketches {
        if let Some((strip, _)) = strips.find(*source, bin.first_s) {
            points[strip as usize].extend(bin.samples().map(|s| s.point_m));
        }
    }
    let boxes: Vec<Option<StripBox>> = points.iter().map(|p| StripBox::about(p)).collect();
    let several_scanners = strips.strips().iter().any(|s| s.scanners.len() > 1);
    let meets = boxes.iter().enumerate().any(|(i, a)| {
        boxes[i + 1..].iter().any(|b| a.as_ref().zip(b.as_ref()).is_some_and(|(a, b)| a.overlaps(b, 5.0)))
    });
    if !meets && !several_scanners {
        let names: Vec<&str> = strips.strips().iter().map(|s| s.name.as_str()).collect();
        bail!(
            "no two strips overlap ({} found: {}); give strips that overlap, or say how they are told apart (strips.split)",
            names.len(),
            names.join(", ")
        );
    }
    Ok(())
}

/// Known points of the project, in the local frame.
fn control_points(project: &Project, survey: &Survey) -> Result<Vec<ControlPoint>> {
    let mut points = Vec::new();
    for section in project.control.iter().filter(|c| c.kind == ControlKind::Points) {
        let path = project.resolve(&section.path);
        let text = std::fs::read_to_string(&path).with_context(|| format!("control.path {}", path.display()))?;
        for (number, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let fields: Vec<&str> = line.split([',', ';', ' ', '\t']).filter(|f| !f.is_empty()).collect();
            let values: Vec<f64> = fields.iter().filter_map(|f| f.parse().ok()).collect();
            if values.len() < 3 || values.len() != fields.len() {
                if number == 0 {
                    continue; // a header
                }
                bail!(
                    "{}, line {}: easting, northing, height and optionally sigma in metres are due, found \"{line}\"",
                    path.display(),
                    number + 1
                );
            }
            points.push(ControlPoint {
                point_m: Vector3::new(values[0], values[1], values[2]) - survey.origin(),
                sigma_m: values.get(3).copied().unwrap_or(section.sigma_m),
            });
        }
    }
    Ok(points)
}

/// Strips, scanners and priors of a matched survey.
#[must_use]
pub fn setup_of(project: &Project, matched: &Matched) -> Setup {
    Setup::new(project, &matched.survey, &matched.strips, &matched.poses, matched.sigma_floor_m)
}

/// Solves for the corrections of a matched survey.
///
/// # Errors
/// When there are too few ties.
pub fn solve_strips(project: &Project, matched: &Matched, clock: &mut Clock) -> Result<Solution> {
    check_fixed(project, &matched.strips)?;
    let setup = setup_of(project, matched);
    clock.time("solve", || solve(project, setup, &matched.ties, &matched.poses))
}

/// Writes the corrected strips into `out/corrected`; with `inverse` the corrections are taken off.
///
/// # Errors
/// When a file cannot be read or written; files already complete stay.
pub fn correct_strips(
    project: &Project,
    matched: &Matched,
    (setup, model): (&Setup, &Model),
    inverse: bool,
    folder: &Path,
    progress: Progress,
    clock: &mut Clock,
) -> Result<Vec<FileSummary>> {
    let files = clock.time("correct", || {
        let corrections = Corrections::new(setup, model, &matched.strips, &matched.poses, matched.rule, inverse)?;
        write_corrected(project, matched, &corrections, &Collector::new(&[]), folder, progress)
    })?;
    clock.passed("correct", files.iter().map(|f| f.points).sum(), matched.survey.points());
    Ok(files)
}

/// Writes the corrected strips of a drive into a folder; with `inverse` the corrections are taken off. Gives what was written, and the points
/// of cuts through the cloud.
///
/// # Errors
/// When a trajectory does not cover a strip, or a file cannot be read or written; files already complete stay.
pub fn correct_drive(
    project: &Project,
    matched: &Matched,
    (drive, cuts): (&DriveCorrection, &[Cut]),
    inverse: bool,
    folder: &Path,
    progress: Progress,
    clock: &mut Clock,
) -> Result<(Vec<FileSummary>, Vec<Vec<CutPoint>>)> {
    let collector = Collector::new(cuts);
    let files = clock.time("correct", || {
        let corrections = Corrections::of_drive(drive, matched, inverse)?;
        write_corrected(project, matched, &corrections, &collector, folder, progress)
    })?;
    clock.passed("correct", files.iter().map(|f| f.points).sum(), matched.survey.points());
    Ok((files, collector.points()))
}

fn write_corrected(
    project: &Project,
    matched: &Matched,
    corrections: &Corrections<'_>,
    collector: &Collector<'_>,
    folder: &Path,
    progress: Progress,
) -> Result<Vec<FileSummary>> {
    std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    let bar = progress.bar("correcting strips", matched.survey.points());
    // files side by side as well: small ones leave cores idle while one is being finished
    let files = output_names(&matched.survey)
        .into_par_iter()
        .map(|(i, name)| {
            let file = &matched.survey.files[i];
            correct_file(file, &folder.join(name), corrections, collector, project.correct.scale_m, &|n| bar.inc(n))
        })
        .collect();
    bar.finish();
    files
}
