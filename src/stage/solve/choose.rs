//! The choice of a model by held-out ties: the guard against over-adjustment.

use std::collections::BTreeMap;

use anyhow::Result;
use rayon::prelude::*;
use tieline_graph::{AdjustOptions, Adjustment, Line, Model, StripSpec, TimeModel, adjust};
use tieline_matching::mix;

use super::Solved;
use crate::report::data::Discrepancy;

/// A model that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The model of the strips; `None`: calibration only.
    pub model: Option<TimeModel>,
    /// Strips that it was given to.
    pub strips: usize,
    /// Unknowns.
    pub unknowns: usize,
    /// Differences of used ties.
    pub used: Discrepancy,
    /// Differences of held-out ties.
    pub held_out: Discrepancy,
    /// Gain against the model in use before, in standard errors.
    pub gain_t: f64,
    /// Whether it was taken.
    pub taken: bool,
    /// Why, or why not.
    pub reason: String,
}

/// Evidence, in standard errors of a strip's own gain, at which mixtures are formed: the strips that ask for the more
/// flexible model at least so clearly get it.
const EVIDENCE_T: [f64; 4] = [3.0, 2.0, 1.0, 0.0];
/// The one-standard-error rule of cross-validation (Breiman et al., Classification and Regression Trees, 1984, §3.4.3):
/// the stiffest model whose held-out loss is within one standard error of the best.
const ONE_STANDARD_ERROR: f64 = 1.0;
/// Relative gain in the held-out loss below which it is not worth the unknowns: half a per cent of the rms.
const LEAST_GAIN: f64 = 0.01;
/// Parts that are held out in turn.
const FOLDS: u64 = 5;

/// What a model is called.
#[must_use]
pub fn name(model: Option<TimeModel>) -> String {
    match model {
        None => String::from("calibration only"),
        Some(TimeModel::Constant) => String::from("constant"),
        Some(TimeModel::Linear) => String::from("constant and drift"),
        Some(TimeModel::Spline { knot_spacing_s }) => format!("spline, knots every {knot_spacing_s:.1} s"),
    }
}

/// Loss by strip and place.
type Losses = BTreeMap<(Option<usize>, (i64, i64)), f64>;

/// Solves the models of a ladder from stiff to flexible. Strips step up by mixtures: those whose own held-out ties ask
/// for it most clearly, then more of them. Held-out means that each fifth of the places is held out in turn and judged
/// by the solution of the others. Of the mixtures and the model before, the stiffest within one standard error of the
/// best is taken.
pub(super) fn choose(
    ladder: &[Option<TimeModel>],
    strips: &[StripSpec],
    solve: impl Fn(&[Option<TimeModel>]) -> Result<Solved>,
    measured: &(dyn Fn(&Model) -> Vec<Line> + Sync),
) -> Result<(Solved, Vec<Option<TimeModel>>, Vec<Trial>)> {
    let Some((stiffest, more)) = ladder.split_first() else { anyhow::bail!("no model to solve") };
    let models = vec![*stiffest; strips.len()];
    let first = solve(&models)?;
    let scales = first.adjustment.class_scale.clone();
    let mut trials =
        vec![trial(&first, *stiffest, models.len(), if more.is_empty() { "as asked" } else { "the stiffest" })];
    if more.is_empty() {
        trials[0].taken = true;
        return Ok((first, models, trials));
    }
    let mut taken = 0;
    let mut best = Candidate { losses: cross_validated(&first, &scales, measured)?, solved: first, models };
    let evaluated = |models: Vec<Option<TimeModel>>| -> Result<Candidate> {
        let solved = solve(&models)?;
        Ok(Candidate { losses: cross_validated(&solved, &scales, measured)?, solved, models })
    };
    for model in more {
        let able = |i: usize| !strips[i].fixed && spans(*model, &strips[i]);
        let flexible = |wanted: &dyn Fn(usize) -> bool| -> Vec<Option<TimeModel>> {
            (0..strips.len()).map(|i| if able(i) && wanted(i) { *model } else { best.models[i] }).collect()
        };
        let mut all = Some(evaluated(flexible(&|_| true))?);
        let losses_of_all = all.as_ref().map_or_else(Losses::new, |c| c.losses.clone());
        let evidence: Vec<f64> = (0..strips.len())
            .map(|i| {
                let (g, t) = gain(&best.losses, &losses_of_all, |strip| strip == Some(i));
                tracing::debug!("strip {i}, {}: {:+.1} % misfit, {t:+.1} standard errors", name(*model), -100.0 * g);
                if g >= LEAST_GAIN { t } else { f64::NEG_INFINITY }
            })
            .collect();
        let everyone = flexible(&|_| true);
        let mut mixtures: Vec<Candidate> = Vec::new();
        for least_t in EVIDENCE_T {
            let mixed = flexible(&|i| evidence[i] >= least_t);
            if mixed == best.models || mixtures.last().is_some_and(|last| last.models == mixed) {
                continue;
            }
            let known = if mixed == everyone { all.take() } else { None };
            mixtures.push(known.map_or_else(|| evaluated(mixed), Ok)?);
        }
        let chosen = one_standard_error(&best, &mixtures);
        let shown = chosen.or_else(|| lowest(&mixtures));
        let Some(shown) = shown else {
            let (g, t) = gain(&best.losses, &losses_of_all, |_| true);
            let reason = format!("held-out ties of no strip ask for it ({} over all)", stated(g, t));
            trials.push(Trial { gain_t: t, reason, strips: 0, model: *model, ..trials[taken].clone() });
            continue;
        };
        let candidate = mixtures.swap_remove(shown);
        let (g, t) = gain(&best.losses, &candidate.losses, |_| true);
        let count = candidate.models.iter().zip(&best.models).filter(|(a, b)| a != b).count();
        let verdict = if chosen.is_some() { "held-out ties agree" } else { "held-out ties do not agree" };
        let reason = format!("{verdict} for {count} of {} strips: {}", strips.len(), stated(g, t));
        trials.push(Trial { gain_t: t, ..trial(&candidate.solved, *model, count, &reason) });
        if chosen.is_some() {
            best = candidate;
            taken = trials.len() - 1;
        }
    }
    trials[taken].taken = true;
    Ok((best.solved, best.models, trials))
}

/// A solution and its cross-validated losses.
struct Candidate {
    solved: Solved,
    losses: Losses,
    models: Vec<Option<TimeModel>>,
}

/// The mixture of lowest loss.
fn lowest(mixtures: &[Candidate]) -> Option<usize> {
    let total = |c: &Candidate| c.losses.values().sum::<f64>();
    (0..mixtures.len()).min_by(|&a, &b| total(&mixtures[a]).total_cmp(&total(&mixtures[b])))
}

/// The stiffest mixture within one standard error of the best; `None` when the model before is.
fn one_standard_error(before: &Candidate, mixtures: &[Candidate]) -> Option<usize> {
    let best = lowest(mixtures)?;
    let close = |c: &Candidate| {
        let (g, t) = gain(&c.losses, &mixtures[best].losses, |_| true);
        g < LEAST_GAIN || t < ONE_STANDARD_ERROR
    };
    if close(before) { None } else { (0..mixtures.len()).find(|&i| close(&mixtures[i])) }
}

fn stated(gain: f64, t: f64) -> String {
    format!("{:+.1} % misfit, {t:+.1} standard errors", -100.0 * gain)
}

/// A spline needs a strip that is longer than its support.
fn spans(model: Option<TimeModel>, strip: &StripSpec) -> bool {
    match model {
        Some(TimeModel::Spline { knot_spacing_s }) => strip.end_s - strip.start_s > 3.0 * knot_spacing_s,
        _ => true,
    }
}

fn trial(solved: &Solved, model: Option<TimeModel>, strips: usize, reason: &str) -> Trial {
    Trial {
        model,
        strips,
        unknowns: solved.model.count(),
        used: Discrepancy::of(&differences(&solved.lines, &solved.adjustment, |l| !l.held_out)),
        held_out: Discrepancy::of(&differences(&solved.lines, &solved.adjustment, |l| l.held_out)),
        gain_t: 0.0,
        taken: false,
        reason: reason.to_string(),
    }
}

/// All differences between ends in use of the lines wanted \[m\].
pub(super) fn differences(lines: &[Line], adjustment: &Adjustment, wanted: impl Fn(&Line) -> bool) -> Vec<f64> {
    let mut all = Vec::new();
    for (line, results) in lines.iter().zip(&adjustment.ends).filter(|(l, _)| wanted(l)) {
        let kept: Vec<(Option<usize>, f64)> =
            line.ends.iter().zip(results).filter(|(_, r)| !r.outlier).map(|(e, _)| (e.strip, e.offset_m)).collect();
        for a in 0..kept.len() {
            for b in a + 1..kept.len() {
                let sign = if kept[a].0 <= kept[b].0 { 1.0 } else { -1.0 };
                all.push(sign * (kept[b].1 - kept[a].1));
            }
        }
    }
    all
}

/// Robust loss of the lines wanted, in squares of 10 m: Huber's, of offsets from each line's weighted mean, in
/// sigmas scaled by class.
fn losses(lines: &[Line], scales: &[f64], wanted: impl Fn(usize) -> bool) -> Losses {
    const HUBER_K: f64 = 3.0;
    let mut losses = BTreeMap::new();
    for line in lines.iter().enumerate().filter(|(i, l)| wanted(*i) && l.ends.len() >= 2).map(|(_, l)| l) {
        let scale = scales.get(line.class).copied().unwrap_or(1.0);
        let weights: Vec<f64> = line.ends.iter().map(|e| e.sigma_m.powi(-2)).collect();
        let total: f64 = weights.iter().sum();
        let mean = line.ends.iter().zip(&weights).map(|(e, w)| e.offset_m * w).sum::<f64>() / total;
        let loss = |offset_m: f64, sigma_m: f64| {
            let t = ((offset_m - mean) / (sigma_m * scale)).abs();
            if t < HUBER_K { t * t } else { HUBER_K * (2.0 * t - HUBER_K) }
        };
        for end in &line.ends {
            *losses.entry((end.strip, place(line))).or_insert(0.0) += loss(end.offset_m, end.sigma_m);
        }
    }
    losses
}

#[allow(clippy::cast_possible_truncation)]
fn place(line: &Line) -> (i64, i64) {
    let point = line.ends.first().map_or_else(nalgebra::Vector3::zeros, |e| e.point_m);
    ((point.x / 10.0).floor() as i64, (point.y / 10.0).floor() as i64)
}

/// Loss of every line by a solution that was made without its place: each fifth of the places held out in turn.
pub(super) fn cross_validated(
    solved: &Solved,
    scales: &[f64],
    measured: &(dyn Fn(&Model) -> Vec<Line> + Sync),
) -> Result<Losses> {
    let fold_of = |line: &Line| {
        let (x, y) = place(line);
        #[allow(clippy::cast_sign_loss)]
        let hash = mix(mix(x as u64) ^ y as u64);
        hash % FOLDS
    };
    // a submap has seen what lies in its tile, in whichever part: where surface lines take part, they choose alone
    let by_surfaces = solved.lines.iter().any(|l| l.tie.is_none() && !l.judges_only);
    let left_out = |line: &Line| line.judges_only || by_surfaces && line.tie.is_some();
    // started at the solution of all ties: a few iterations settle it
    let quick =
        AdjustOptions { huber_iterations: 1, tukey_iterations: 2, variance_rounds: 1, ..AdjustOptions::default() };
    let folds: Vec<Result<Losses>> = (0..FOLDS)
        .into_par_iter()
        .map(|fold| {
            let mut lines = solved.lines.clone();
            for line in &mut lines {
                line.held_out = left_out(line) || fold_of(line) == fold;
            }
            let mut model = solved.model.clone();
            adjust(&mut model, &lines, &solved.adjustment.class_scale, &quick)?;
            let after = measured(&model);
            Ok(losses(&after, scales, |i| lines[i].held_out && !left_out(&lines[i])))
        })
        .collect();
    let mut all = BTreeMap::new();
    for fold in folds {
        all.extend(fold?);
    }
    Ok(all)
}

/// Relative gain of the second over the first in the loss of the strips wanted, and that gain in standard errors over
/// places.
#[allow(clippy::cast_precision_loss)]
fn gain(first: &Losses, second: &Losses, wanted: impl Fn(Option<usize>) -> bool) -> (f64, f64) {
    let mut places: BTreeMap<(i64, i64), f64> = BTreeMap::new();
    let mut total = 0.0;
    for ((strip, place), loss) in first.iter().filter(|((strip, _), _)| wanted(*strip)) {
        if let Some(other) = second.get(&(*strip, *place)) {
            *places.entry(*place).or_insert(0.0) += loss - other;
            total += loss;
        }
    }
    let n = places.len() as f64;
    if n < 6.0 {
        return (0.0, 0.0);
    }
    let sum: f64 = places.values().sum();
    let mean = sum / n;
    let variance = places.values().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (sum / total.max(1e-12), mean / (variance / n).sqrt().max(1e-12))
}
