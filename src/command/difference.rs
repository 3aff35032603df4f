//! `correct --from OLD --to NEW STRIPS…`: strips corrected by the difference of two trajectories.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{Correction, CorrectionRow, SurveyClock, TimeEncoding, Trajectory};
use tieline_io::correction::read_correction;

use crate::cli::{Common, CorrectArgs};
use crate::navigation::{in_map, on_clock, read_trajectory};
use crate::progress::Progress;
use crate::project::{Project, ProjectSection, SplitChoice, StripsSection};
use crate::stage::correct::output_names;
use crate::stage::difference::{Difference, Target, correct_file_by};
use crate::survey::Survey;

/// Folder of the output when none is named.
const DEFAULT_OUT: &str = "out/corrected";
/// Times \[s\] above this are adjusted standard time, no longer seconds of a week.
const LONGEST_WEEK_TIME_S: f64 = 1.0e7;
/// First columns of a correction.
const CORRECTION_HEADER: &[u8] = b"gps_time_s,dE_m";

/// Corrects strips by the difference of two trajectories.
///
/// # Errors
/// Whatever is wrong with an input is found before the first file is written: files that cannot be read, two reference
/// systems, times that a trajectory does not cover, outputs that exist.
pub fn correct(args: &CorrectArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let (Some(from), Some(to)) = (&args.from, &args.to) else { bail!("--from and --to belong together") };
    let survey = Survey::open(&project_of(args))?;
    let old = trajectory_of(from, args, &survey)?;
    let target = match is_correction(to)? {
        true => Target::Correction(correction_of(to, &survey.clock)?),
        false => Target::Trajectory(trajectory_of(to, args, &survey)?),
    };
    let difference = Difference::new(old, target)?;
    for file in survey.strip_files() {
        difference.check(file)?;
    }
    let folder = args.out.clone().unwrap_or_else(|| PathBuf::from(DEFAULT_OUT));
    let outputs = outputs_of(&survey, &folder, args.overwrite)?;

    if !common.quiet && !common.json {
        for note in &survey.notes {
            tracing::info!("{note}");
        }
    }
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("the output folder {} cannot be created", folder.display()))?;
    let bar = Progress::new(common.quiet || common.json).bar("correcting strips", survey.points());
    let written = survey
        .strip_files()
        .zip(&outputs)
        .map(|(file, output)| correct_file_by(file, output, &difference, &|n| bar.inc(n)))
        .collect::<Result<Vec<_>>>();
    bar.finish_and_clear();
    let written = written?;
    if common.json {
        serde_json::to_writer_pretty(&mut *out, &written)?;
        writeln!(out)?;
    } else if !common.quiet {
        for file in &written {
            writeln!(out, "{}: {} points, moved by up to {:.3} m", file.output, file.points, file.largest_shift_m)?;
        }
    }
    Ok(())
}

/// A project of nothing but the strips.
fn project_of(args: &CorrectArgs) -> Project {
    let section = |path: &PathBuf| StripsSection {
        path: path.display().to_string(),
        split: SplitChoice::default(),
        time_gap_s: None,
        scanner: crate::project::ScannerChoice::default(),
        fixed: false,
    };
    Project {
        stations: Vec::new(),
        extrinsics: None,
        imu: None,
        ties: None,
        gnss: None,
        odometer: None,
        vehicle: None,
        points: Vec::new(),
        initial: None,
        project: ProjectSection { crs: args.crs.clone(), week: args.week, ..ProjectSection::default() },
        strips: args.inputs.iter().map(section).collect(),
        trajectory: None,
        platform: Default::default(),
        control: Vec::new(),
        matching: Default::default(),
        calibrate: Default::default(),
        solve: Default::default(),
        correct: Default::default(),
        folder: PathBuf::new(),
    }
}

fn trajectory_of(path: &Path, args: &CorrectArgs, survey: &Survey) -> Result<Trajectory> {
    let file = read_trajectory(path, args.columns.as_deref(), None)?;
    let map = in_map(&file, path, survey.crs.as_ref(), "name it with --crs")?;
    on_clock(map, &file, path, file.time_encoding, &survey.clock, "name it with --week")
}

/// Whether a file is a `correction.csv`, by its first bytes.
fn is_correction(path: &Path) -> Result<bool> {
    let mut head = Vec::new();
    let file = File::open(path).with_context(|| format!("--to {}", path.display()))?;
    file.take(CORRECTION_HEADER.len() as u64).read_to_end(&mut head).with_context(|| path.display().to_string())?;
    Ok(head == CORRECTION_HEADER)
}

/// A correction on the clock of the survey. Its times are those of the strips, in either encoding.
fn correction_of(path: &Path, clock: &SurveyClock) -> Result<Correction> {
    let correction = read_correction(path)?;
    let rows = correction.rows();
    let is_adjusted = rows.iter().any(|r| r.time_s.abs() >= LONGEST_WEEK_TIME_S || r.time_s < -SECONDS_PER_WEEK);
    let encoding = if is_adjusted { TimeEncoding::AdjustedStandard } else { TimeEncoding::SecondsOfWeek };
    let shift_s = clock.shift_s(encoding).with_context(|| {
        format!("{}: adjusted GPS time, while the strips' week is unknown; name it with --week", path.display())
    })?;
    let shifted = rows.iter().map(|row| CorrectionRow { time_s: row.time_s + shift_s, ..*row }).collect();
    Ok(Correction::new(shifted)?)
}

/// Where each strip is written to; nothing that is there is overwritten unasked, an input never.
fn outputs_of(survey: &Survey, folder: &Path, overwrite: bool) -> Result<Vec<PathBuf>> {
    let outputs: Vec<PathBuf> = output_names(survey).into_iter().map(|(_, name)| folder.join(name)).collect();
    let inputs: BTreeSet<PathBuf> =
        survey.strip_files().filter_map(|f| std::fs::canonicalize(f.las.path()).ok()).collect();
    let mut seen = BTreeSet::new();
    for output in &outputs {
        if std::fs::canonicalize(output).is_ok_and(|path| inputs.contains(&path)) {
            bail!("{} is an input: strips are never overwritten; name another folder with --out", output.display());
        }
        if output.exists() && !overwrite {
            bail!("{} exists already: name another folder with --out, or give --overwrite", output.display());
        }
        if !seen.insert(output) {
            bail!("two strips would be written to {}: give strips of different names", output.display());
        }
    }
    Ok(outputs)
}
