//! What one stage leaves for the next: `stages/match.json` and `stages/solve.json` in the output folder.

pub(crate) mod drive;

use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use nalgebra::DVector;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use tieline_graph::{Model, TimeModel};
use tieline_io::output::WholeFile;
use tieline_matching::xyz::FeatureTie;
use tieline_matching::xyz::texture::SpotTie;
use tieline_matching::{SourceRule, StripIndex};

use crate::job::Matched;
use crate::project::Project;
use crate::report::data::Summary;
use crate::settings::{Grouping, Setting};
use crate::stage::solve::{Setup, Solution};
use crate::stage::ties::Ties;
use crate::stage::trajectory::{PathReport, Poses, StoredPath};
use crate::survey::Survey;

/// Version of the files; a change of their shape raises it.
const VERSION: u32 = 4;

/// The result of `match` on disk.
#[derive(Debug, Serialize, Deserialize)]
struct MatchState {
    version: u32,
    files: Vec<(PathBuf, u64)>,
    rule: SourceRule,
    sigma_floor_m: f64,
    grouping: Grouping,
    settings: Vec<Setting>,
    strips: StripIndex,
    paths: Vec<Option<StoredPath>>,
    reports: Vec<PathReport>,
    notes: Vec<String>,
    ties: Ties,
    spots: Vec<SpotTie>,
    features: Vec<FeatureTie>,
    points: u64,
}

/// The result of `solve` on disk.
#[derive(Debug, Serialize, Deserialize)]
pub struct SolveState {
    version: u32,
    time_models: Vec<Option<TimeModel>>,
    state: Vec<f64>,
    /// The summary as far as it is known.
    pub summary: Summary,
    /// Differences for the pictures: map position, pair, upward part of the normal, before, after, held out, outlier.
    pub points: Vec<StoredPoint>,
}

/// A [`crate::report::data::TiePoint`] on disk.
pub type StoredPoint = ([f64; 3], u32, f64, f64, f64, bool, bool);

fn write<T: Serialize>(path: &Path, value: &T) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    }
    let mut file = WholeFile::create(path).with_context(|| format!("writing {}", path.display()))?;
    {
        let mut writer = BufWriter::new(file.writer());
        serde_json::to_writer(&mut writer, value).with_context(|| format!("writing {}", path.display()))?;
        writer.flush().with_context(|| format!("writing {}", path.display()))?;
    }
    file.finish().with_context(|| format!("writing {}", path.display()))
}

fn read<T: DeserializeOwned>(path: &Path, stage: &str) -> Result<T> {
    let file = File::open(path)
        .with_context(|| format!("{} is not there: run `tieline {stage}` with the same --out first", path.display()))?;
    serde_json::from_reader(BufReader::new(file))
        .with_context(|| format!("{} cannot be read: run `tieline {stage}` again", path.display()))
}

/// Takes away what later stages left: it does not belong to what an earlier one leaves now.
fn forget(out: &Path, stages: &[&str]) -> Result<()> {
    for stage in stages {
        let path = out.join(format!("stages/{stage}.json"));
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error)
                    .with_context(|| format!("{} is of an earlier run and cannot be removed", path.display()));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Leaves the result of `match` in the output folder; what later stages left there goes.
///
/// # Errors
/// When it cannot be written.
pub fn save_match(out: &Path, matched: &Matched) -> Result<()> {
    forget(out, &["calibrate", "solve", "correct"])?;
    let state = MatchState {
        version: VERSION,
        files: files_of(&matched.survey),
        rule: matched.rule,
        sigma_floor_m: matched.sigma_floor_m,
        grouping: matched.grouping,
        settings: matched.settings.clone(),
        strips: matched.strips.clone(),
        paths: matched.poses.stored(),
        reports: matched.poses.reports.clone(),
        notes: matched.poses.notes.clone(),
        ties: matched.ties.clone(),
        spots: matched.spots.clone(),
        features: matched.features.clone(),
        points: matched.points,
    };
    write(&out.join("stages/match.json"), &state)
}

fn files_of(survey: &Survey) -> Vec<(PathBuf, u64)> {
    survey.files.iter().map(|f| (f.las.path().to_path_buf(), f.las.header().point_count)).collect()
}

/// Whether `match` left its result in an output folder.
#[must_use]
pub fn is_matched(out: &Path) -> bool {
    out.join("stages/match.json").is_file()
}

/// Takes up the result of `match` from the output folder.
///
/// # Errors
/// When it is not there, of another version, or of other strips.
pub fn load_match(project: &Project, out: &Path) -> Result<Matched> {
    let path = out.join("stages/match.json");
    let state: MatchState = read(&path, "match")?;
    ensure!(state.version == VERSION, "{} is of another version of tieline: run `tieline match` again", path.display());
    let survey = Survey::open(project)?;
    let names = |files: &[(PathBuf, u64)]| -> Vec<(Option<std::ffi::OsString>, u64)> {
        files.iter().map(|(p, n)| (p.file_name().map(std::ffi::OsStr::to_os_string), *n)).collect()
    };
    ensure!(
        names(&files_of(&survey)) == names(&state.files),
        "the strips have changed since `tieline match` was run: run it again"
    );
    let poses = Poses::restored(project, &survey, state.paths, state.reports, state.notes)?;
    Ok(Matched {
        survey,
        rule: state.rule,
        sigma_floor_m: state.sigma_floor_m,
        grouping: state.grouping,
        settings: state.settings,
        strips: state.strips,
        poses,
        ties: state.ties,
        spots: state.spots,
        features: state.features,
        points: state.points,
    })
}

/// Leaves the result of `solve` in the output folder.
///
/// # Errors
/// When it cannot be written.
pub fn save_solve(out: &Path, solution: &Solution, summary: &Summary, points: &[StoredPoint]) -> Result<()> {
    let state = SolveState {
        version: VERSION,
        time_models: solution.time_models.clone(),
        state: solution.model.state().iter().copied().collect(),
        summary: summary.clone(),
        points: points.to_vec(),
    };
    write(&out.join("stages/solve.json"), &state)
}

/// Takes up the result of `solve`: the model with its estimate, and the summary.
///
/// # Errors
/// When it is not there or does not fit the result of `match`.
pub fn load_solve(setup: &Setup, out: &Path) -> Result<(Model, SolveState)> {
    let path = out.join("stages/solve.json");
    let state: SolveState = read(&path, "solve")?;
    ensure!(state.version == VERSION, "{} is of another version of tieline: run `tieline solve` again", path.display());
    let mut model = setup.model(&state.time_models);
    ensure!(
        model.count() == state.state.len(),
        "{} does not fit the project: run `tieline solve` again",
        path.display()
    );
    model.set_state(DVector::from_column_slice(&state.state));
    Ok((model, state))
}
