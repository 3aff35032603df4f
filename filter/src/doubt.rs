//! Which ties to doubt: each is judged by all that the others say, before it and after.
//!
//! An innovation is judged by what came before. In an outage that is little: a false tie passes, and good ones that
//! follow look wrong. The deletion residual is judged by everything else. With the adjoint λ, Λ after an update,
//!
//! ```text
//! u = S⁻¹ v + Kᵀ λ        D = S⁻¹ + Kᵀ Λ K        residual without the measurement = D⁻¹ u, its covariance D⁻¹
//! ```
//!
//! (de Jong, *A cross-validation filter for time series models*, Biometrika 75 (1988) 594–600.)

use std::collections::HashMap;

use crate::adjoint::Deletion;
use crate::innovation::chi_squared_limit;
use crate::kalman::invert;

/// Weight of what is left out: none for the solution, but enough to go on judging it.
pub(crate) const LEFT_OUT_WEIGHT: f64 = 1e-10;
/// A tie goes when none near by is this many times as doubtful: false ones make good ones look false.
const FAR_WORSE: f64 = 3.0;
/// Ties nearer than this lead one another astray \[s\].
const NEAR_S: f64 = 60.0;

/// An update that came of a sighting.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TieUpdate {
    /// Record on the tape and operation in it.
    pub place: (usize, usize),
    /// Tie and sighting.
    pub sighting: (usize, usize),
    /// When \[s\].
    pub time_s: f64,
    /// Weight it was given.
    pub weight: f64,
    /// Its covariance at weight one, row-major.
    pub noise: Vec<f64>,
}

/// A sighting judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Judged {
    sighting: (usize, usize),
    time_s: f64,
    /// Squared deletion residual over its limit.
    ratio: f64,
    fit: TieFit,
}

/// How a sighting of a tie fits the whole solution, for the estimation of variance components: over many sightings with
/// the right sigmas the sum of `squared` is that of `redundancy`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TieFit {
    /// Tie, as given.
    pub tie: usize,
    /// Squared smoothed residual over its variance of measurement: `eᵀ R⁻¹ e = uᵀ R u`.
    pub squared: f64,
    /// Share of the measurement that the others control, times its components: `tr (R D)`.
    pub redundancy: f64,
}

impl TieFit {
    /// Of the sightings that nothing speaks against.
    pub(crate) fn of_all(judged: &[Judged]) -> Vec<Self> {
        judged.iter().filter(|j| j.ratio <= 1.0).map(|j| j.fit).collect()
    }
}

/// Weights of sightings that are not one.
pub(crate) type Trust = HashMap<(usize, usize), f64>;

/// Judges a sighting by all the rest.
pub(crate) fn judge(deletion: &Deletion, of: &TieUpdate, false_alarm: f64) -> Option<Judged> {
    let m = deletion.pull.len();
    let u = &deletion.pull;
    let along = |k: &[f64], g: &[f64]| k.iter().zip(g).map(|(k, g)| k * g).sum::<f64>();
    let with_noise = invert(&deletion.information, m).ok()?;
    let residual: Vec<f64> = (0..m).map(|a| along(&with_noise[a * m..(a + 1) * m], u)).collect();
    // its covariance had the measurement weight one
    let variance: Vec<f64> = with_noise.iter().zip(&of.noise).map(|(d, r)| d + r * (1.0 - 1.0 / of.weight)).collect();
    let precision = invert(&variance, m).ok()?;
    let squared: f64 = (0..m * m).map(|k| residual[k / m] * precision[k] * residual[k % m]).sum();
    let ratio = squared / chi_squared_limit(m, false_alarm);
    let noise = |k: usize| of.noise[k] / of.weight;
    let fit = TieFit {
        tie: of.sighting.0,
        squared: (0..m * m).map(|k| u[k / m] * noise(k) * u[k % m]).sum(),
        redundancy: (0..m * m).map(|k| noise(k) * deletion.information[(k % m) * m + k / m]).sum(),
    };
    Some(Judged { sighting: of.sighting, time_s: of.time_s, ratio, fit })
}

/// What to trust after a first run, that tested innovations: what it doubted goes, unless that is so much that a false tie
/// may have led the others astray; then all are heard.
#[allow(clippy::cast_precision_loss)]
pub(crate) fn after_first(weights: &[Vec<Option<f64>>], judged: &[Judged], false_alarm: f64) -> Trust {
    let of_all =
        weights.iter().enumerate().flat_map(|(t, of_tie)| of_tie.iter().enumerate().map(move |(s, w)| ((t, s), w)));
    let given = of_all.filter_map(|(sighting, weight)| Some((sighting, (*weight)?)));
    let count = given.clone().count();
    let mut trust: Trust = given.filter(|w| w.1 < 1.0).map(|w| (w.0, LEFT_OUT_WEIGHT)).collect();
    trust.extend(judged.iter().filter(|j| j.ratio > 1.0).map(|j| (j.sighting, LEFT_OUT_WEIGHT)));
    if trust.len() as f64 > 1.0 + 3.0 * false_alarm * count as f64 {
        trust.clear();
    }
    trust
}

/// What to trust next: what no longer looks false comes back, and of what does the worst goes.
pub(crate) fn after(trust: &Trust, judged: &[Judged]) -> Trust {
    let mut doubtful: Vec<&Judged> = judged.iter().filter(|j| j.ratio > 1.0).collect();
    doubtful.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    let heard: Vec<&Judged> = doubtful.iter().copied().filter(|j| !trust.contains_key(&j.sighting)).collect();
    let worst_near = |time_s: f64| {
        let from = heard.partition_point(|j| j.time_s < time_s - NEAR_S);
        heard[from..].iter().take_while(|j| j.time_s <= time_s + NEAR_S).map(|j| j.ratio).fold(0.0, f64::max)
    };
    doubtful
        .iter()
        .filter(|j| trust.contains_key(&j.sighting) || worst_near(j.time_s) < FAR_WORSE * j.ratio)
        .map(|j| (j.sighting, LEFT_OUT_WEIGHT))
        .collect()
}
