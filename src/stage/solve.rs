//! The adjustment of a survey: models of rising flexibility, each solved with ties measured anew, the held-out ties
//! as judges.

mod choose;
mod measure;
mod setup;

use anyhow::{Context, Result};
use rayon::prelude::*;
use tieline_graph::{
    AdjustOptions, Adjustment, Calibration, Line, Model, PoseCorrection, TimeModel, adjust, model::Parameter,
};

pub use choose::{Trial, name as model_name};
pub use measure::CLASSES;
pub use measure::corrected_patch;
pub use setup::{CalibrationBlock, Setup};

use crate::project::{Project, StripModelChoice};
use crate::stage::places::row;
use crate::stage::ties::Ties;
use crate::stage::trajectory::Poses;

/// The solution of a survey.
#[derive(Debug)]
pub struct Solution {
    /// What was adjusted.
    pub setup: Setup,
    /// The model with its estimate.
    pub model: Model,
    /// Its quality.
    pub adjustment: Adjustment,
    /// The lines as measured in the last iteration; rows match [`Solution::rows`], then [`Solution::places`].
    pub lines: Vec<Line>,
    /// The lines as measured before any correction.
    pub lines_before: Vec<Line>,
    /// Row of [`Ties::lines`] and ends of it for each line.
    pub rows: Vec<(usize, Vec<usize>)>,
    /// Row of [`Ties::places`] and direction of it for each line after these.
    pub places: Vec<(usize, usize)>,
    /// The model of each strip in use.
    pub time_models: Vec<Option<TimeModel>>,
    /// Models tried.
    pub trials: Vec<Trial>,
    /// Outer iterations of the last model.
    pub iterations: usize,
}

/// One model solved.
struct Solved {
    model: Model,
    adjustment: Adjustment,
    lines: Vec<Line>,
    iterations: usize,
}

/// Fewest outer iterations: ties are measured anew after each.
const OUTER_ITERATIONS: usize = 3;

impl Solution {
    /// Correction of a strip's pose at a time.
    #[must_use]
    pub fn pose_correction(&self, strip: u32, time_s: f64) -> PoseCorrection {
        self.model.pose_correction(strip as usize, time_s)
    }

    /// Correction of the scanner of a strip.
    #[must_use]
    pub fn calibration(&self, strip: u32, scanner: u16) -> Calibration {
        self.model.calibration(self.setup.block(strip, scanner))
    }

    /// The unknowns.
    #[must_use]
    pub fn parameters(&self) -> &[Parameter] {
        self.model.parameters()
    }
}

/// Adjusts a survey.
///
/// # Errors
/// When there are no ties, or the normal equations cannot be factorised.
pub fn solve(project: &Project, setup: Setup, ties: &Ties, poses: &Poses) -> Result<Solution> {
    let rows = measure::rows(ties, &setup, poses);
    let iterations = project.solve.iterations.unwrap_or(OUTER_ITERATIONS).max(1);
    let places = row::rows(&ties.places, &setup, poses);
    let measured = |model: &Model| -> Vec<Line> {
        let lines = rows.par_iter().map(|row| measure::line(row, ties, &setup, poses, model));
        lines.chain(places.par_iter().map(|row| row::measured(row, model))).collect()
    };
    let solve_model = |time_models: &[Option<TimeModel>]| -> Result<Solved> {
        let mut model = setup.model(time_models);
        let mut scales = Vec::new();
        let mut last = None;
        for iteration in 1..=iterations + 2 {
            let lines = measured(&model);
            let adjustment =
                adjust(&mut model, &lines, &scales, &AdjustOptions::default()).context("adjusting strips")?;
            scales.clone_from(&adjustment.class_scale);
            let settled = adjustment.last_step < 1e-3;
            last = Some((adjustment, lines, iteration));
            if iteration >= iterations && (settled || iteration >= iterations + 2) {
                break;
            }
        }
        let (adjustment, _, iterations) = last.context("no iteration was made")?;
        // residuals and differences after the correction come from ties measured once more
        let lines = measured(&model);
        Ok(Solved { model, adjustment, lines, iterations })
    };
    let before = measured(&setup.model(&[]));
    let ladder = ladder(project, &setup);
    let (solved, time_models, trials) = choose::choose(&ladder, &setup.strips, solve_model, &measured)?;
    told(ties, &places, &solved, &before);
    Ok(Solution {
        model: solved.model,
        adjustment: solved.adjustment,
        lines: solved.lines,
        lines_before: before,
        rows: rows.into_iter().map(|r| (r.line, r.ends)).collect(),
        places: places.into_iter().map(|r| (r.tie, r.direction)).collect(),
        time_models,
        trials,
        iterations: solved.iterations,
        setup,
    })
}

/// The models to try, from stiff to flexible.
fn ladder(project: &Project, setup: &Setup) -> Vec<Option<TimeModel>> {
    let longest_s = setup.strips.iter().filter(|s| !s.fixed).map(|s| s.end_s - s.start_s).fold(0.0, f64::max);
    let knot_spacing_s = project.solve.knot_spacing_s.unwrap_or_else(|| (longest_s / 6.0).clamp(5.0, 30.0));
    let spline = Some(TimeModel::Spline { knot_spacing_s });
    match project.solve.strips {
        StripModelChoice::None => vec![None],
        StripModelChoice::Constant => vec![Some(TimeModel::Constant)],
        StripModelChoice::Linear => vec![Some(TimeModel::Linear)],
        StripModelChoice::Spline => vec![spline],
        StripModelChoice::Auto => {
            // The prior says that every strip has its own error: the constant model is the start, not a luxury.
            let mut models = vec![Some(TimeModel::Constant), Some(TimeModel::Linear)];
            if longest_s > 3.0 * knot_spacing_s {
                models.push(spline);
            }
            models
        }
    }
}

/// Tells of every row of a tie of places, for those who ask for it.
fn told(ties: &Ties, places: &[row::PlaceRow], solved: &Solved, before: &[Line]) {
    let first = solved.lines.len() - places.len();
    for (row, k) in places.iter().zip(first..) {
        let (tie, line, ends) = (&ties.places.ties[row.tie], &solved.lines[k], &solved.adjustment.ends[k]);
        let distance_mm = |l: &Line| (l.ends[0].offset_m - l.ends[1].offset_m) * 1e3;
        let sigma_mm = tie.directions[row.direction].sigma_m * 1e3;
        let d = line.normal;
        tracing::debug!(
            "place {} {} {:?} {:?} along {:.2} {:.2} {:.2}: {:+.1} -> {:+.1} mm, sigma {sigma_mm:.1} mm, redundancy {:.2}{}{}",
            row.tie,
            tie.kind.as_str(),
            tie.sightings.map(|s| (s.strip, s.scanner)),
            tie.points_m[0].map(|v| v.round()).as_slice(),
            d.x,
            d.y,
            d.z,
            distance_mm(&before[k]),
            distance_mm(line),
            ends[0].redundancy + ends[1].redundancy,
            if line.held_out { ", held out" } else { "" },
            if ends[0].outlier { ", outlier" } else { "" }
        );
    }
}
