//! The choice of a model by held-out ties: the guard against over-adjustment.

use std::collections::BTreeMap;

use anyhow::Result;
use tieline_graph::{Adjustment, Line, TimeModel};

use super::Solved;
use crate::report::data::Discrepancy;

/// A model that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The model of the strips; `None`: calibration only.
    pub model: Option<TimeModel>,
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

/// Gain in standard errors that the more flexible model must show.
const LEAST_GAIN_T: f64 = 2.0;
/// Relative gain in the held-out loss below which it is not worth the unknowns.
const LEAST_GAIN: f64 = 0.002;

/// What a model is called.
pub(super) fn name(model: Option<TimeModel>) -> String {
    match model {
        None => String::from("calibration only"),
        Some(TimeModel::Constant) => String::from("constant"),
        Some(TimeModel::Linear) => String::from("constant and drift"),
        Some(TimeModel::Spline { knot_spacing_s }) => format!("spline, knots every {knot_spacing_s:.1} s"),
    }
}

/// Solves the models of a ladder from stiff to flexible; a step up is taken when the held-out ties agree.
pub(super) fn choose(
    ladder: &[Option<TimeModel>],
    before: &[Line],
    solve: impl Fn(Option<TimeModel>, &[f64]) -> Result<Solved>,
) -> Result<(Solved, Vec<Trial>)> {
    let mut trials: Vec<Trial> = Vec::new();
    let mut best: Option<(Solved, usize)> = None;
    let none_held_out = !before.iter().any(|l| l.held_out);
    for model in ladder {
        let solved = solve(*model, &[])?;
        let used = Discrepancy::of(&differences(&solved.lines, &solved.adjustment, |l| !l.held_out));
        let held_out = Discrepancy::of(&differences(&solved.lines, &solved.adjustment, |l| l.held_out));
        let (gain, gain_t) = best.as_ref().map_or((f64::INFINITY, f64::INFINITY), |(b, _)| gain(b, &solved));
        let agrees = gain_t >= LEAST_GAIN_T && gain >= LEAST_GAIN;
        let (taken, reason) = match (&best, none_held_out) {
            (None, _) => (true, String::from("the stiffest")),
            (_, true) => (false, String::from("no tie is held out to judge it (match.hold_out)")),
            _ if agrees => {
                (true, format!("held-out ties agree: {:.1} % less misfit, {gain_t:.1} standard errors", gain * 100.0))
            }
            _ => (
                false,
                format!(
                    "held-out ties do not ask for it ({:+.1} % misfit, {gain_t:.1} standard errors)",
                    -gain * 100.0
                ),
            ),
        };
        trials.push(Trial {
            model: *model,
            unknowns: solved.model.count(),
            used,
            held_out,
            gain_t,
            taken: false,
            reason,
        });
        if taken {
            best = Some((solved, trials.len() - 1));
        }
    }
    let Some((solved, row)) = best else { anyhow::bail!("no model to solve") };
    trials[row].taken = true;
    Ok((solved, trials))
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

/// Robust loss of the held-out lines in squares of 20 m: Huber's, of offsets from the line's weighted mean.
fn losses(solved: &Solved) -> BTreeMap<(i64, i64), f64> {
    let mut losses = BTreeMap::new();
    for line in solved.lines.iter().filter(|l| l.held_out && l.ends.len() >= 2) {
        let scale = solved.adjustment.class_scale.get(line.class).copied().unwrap_or(1.0);
        // one scale for all models would need a reference; offsets are weighed by a-priori sigmas only
        let _ = scale;
        let weights: Vec<f64> = line.ends.iter().map(|e| e.sigma_m.powi(-2)).collect();
        let total: f64 = weights.iter().sum();
        let mean = line.ends.iter().zip(&weights).map(|(e, w)| e.offset_m * w).sum::<f64>() / total;
        let point = line.ends[0].point_m;
        #[allow(clippy::cast_possible_truncation)]
        let place = ((point.x / 20.0).floor() as i64, (point.y / 20.0).floor() as i64);
        let loss: f64 = line
            .ends
            .iter()
            .map(|e| {
                let t = ((e.offset_m - mean) / e.sigma_m).abs();
                let k = 6.0; // a-priori sigmas are small against real surfaces
                if t < k { t * t } else { k * (2.0 * t - k) }
            })
            .sum();
        *losses.entry(place).or_insert(0.0) += loss;
    }
    losses
}

/// Relative gain of the second over the first in held-out loss, and that gain in standard errors over places.
#[allow(clippy::cast_precision_loss)]
fn gain(first: &Solved, second: &Solved) -> (f64, f64) {
    let (a, b) = (losses(first), losses(second));
    let differences: Vec<f64> = a.iter().map(|(place, loss)| loss - b.get(place).copied().unwrap_or(*loss)).collect();
    let n = differences.len() as f64;
    if n < 4.0 {
        return (0.0, 0.0);
    }
    let sum: f64 = differences.iter().sum();
    let mean = sum / n;
    let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (sum / a.values().sum::<f64>().max(1e-12), mean / (variance / n).sqrt().max(1e-12))
}
