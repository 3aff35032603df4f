//! Ties judged by their neighbours: what two sightings differ by changes slowly along the way.

use std::collections::BTreeMap;

use super::tie::{SpotRejection, SpotTie};
use crate::block::SourceKey;

/// What neighbours are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JudgeOptions {
    /// Both ends lie no further apart in time \[s\].
    pub near_s: f64,
    /// What the mismatch may change by in that time \[m\].
    pub drift_m: f64,
    /// Fewer neighbours judge nothing.
    pub fewest: usize,
}

impl Default for JudgeOptions {
    fn default() -> Self {
        Self { near_s: 8.0, drift_m: 0.02, fewest: 3 }
    }
}

/// So many neighbours, the nearest in time, are asked.
const MOST: usize = 12;
/// A tie knows a direction of which so much lies in what it holds: a square of a cosine.
const KNOWN: f64 = 0.99;
/// Sigmas of a difference that is chance.
const SIGMAS: f64 = 4.0;

/// Ties of the same two strips, or of the same two scanners in one strip, in order of time; each with +1, or -1 where its ends stand the other way
/// round.
type Group = Vec<(usize, f64)>;

/// What a tie binds, and whether its ends stand in that order. Between strips the scanners do not matter: what their calibration may still be wrong by
/// is less than the drift that is allowed.
fn bound(tie: &SpotTie) -> ([SourceKey; 2], bool) {
    let [a, b] = tie.ends.each_ref().map(|e| e.source);
    let strips = [a.without_scanner(), b.without_scanner()];
    let [a, b] = if strips[0] == strips[1] { [a, b] } else { strips };
    if a <= b { ([a, b], true) } else { ([b, a], false) }
}

/// Times of a tie's ends in the order of its group \[s\].
fn times_s(ties: &[SpotTie], (row, sign): (usize, f64)) -> [f64; 2] {
    let [a, b] = ties[row].ends.each_ref().map(|e| e.time_s);
    if sign > 0.0 { [a, b] } else { [b, a] }
}

/// Gives ties that their neighbours do not bear out a reason.
pub fn judge(ties: &mut [SpotTie], options: &JudgeOptions) {
    let mut groups: BTreeMap<_, Group> = BTreeMap::new();
    for (k, tie) in ties.iter().enumerate().filter(|(_, t)| t.rejection.is_none()) {
        let (what, forward) = bound(tie);
        groups.entry(what).or_default().push((k, if forward { 1.0 } else { -1.0 }));
    }
    for group in groups.values_mut() {
        group.sort_by(|a, b| times_s(ties, *a)[0].total_cmp(&times_s(ties, *b)[0]).then(a.0.cmp(&b.0)));
        // once with all, and once with those that are left
        for _ in 0..2 {
            let verdicts: Vec<_> = (0..group.len()).map(|k| verdict(ties, group, k, options)).collect();
            for ((k, _), rejection) in group.iter().zip(&verdicts) {
                ties[*k].rejection = *rejection;
            }
            group.retain(|(k, _)| ties[*k].rejection.is_none());
        }
    }
}

/// The others of a group near to one in both times, the nearest first.
fn neighbours(ties: &[SpotTie], group: &Group, k: usize, options: &JudgeOptions) -> Group {
    let here = times_s(ties, group[k]);
    let apart_s = |other: &(usize, f64)| {
        let there = times_s(ties, *other);
        (there[0] - here[0]).abs().max((there[1] - here[1]).abs())
    };
    let from = group.partition_point(|other| times_s(ties, *other)[0] < here[0] - options.near_s);
    let near = group[from..].iter().take_while(|other| times_s(ties, **other)[0] <= here[0] + options.near_s);
    let spot = ties[group[k].0].spot;
    let mut near: Group =
        near.filter(|other| ties[other.0].spot != spot && apart_s(other) <= options.near_s).copied().collect();
    near.sort_by(|a, b| apart_s(a).total_cmp(&apart_s(b)).then(a.0.cmp(&b.0)));
    near
}

fn verdict(ties: &[SpotTie], group: &Group, k: usize, options: &JudgeOptions) -> Option<SpotRejection> {
    let near = neighbours(ties, group, k, options);
    let (row, sign) = group[k];
    let tie = &ties[row];
    let mut verdict = None;
    for direction in tie.held() {
        // of the others those that know this direction
        let knows = |other: &SpotTie| other.held().iter().map(|h| h.dot(&direction).powi(2)).sum::<f64>() > KNOWN;
        let mut others: Vec<f64> = near
            .iter()
            .filter(|(r, _)| knows(&ties[*r]))
            .take(MOST)
            .map(|(r, sign)| sign * ties[*r].shift_m().dot(&direction))
            .collect();
        if others.len() < options.fewest {
            return Some(SpotRejection::Alone);
        }
        others.sort_by(f64::total_cmp);
        let middle = others.len() / 2;
        let median = if others.len() % 2 == 1 { others[middle] } else { 0.5 * (others[middle - 1] + others[middle]) };
        let sigma_m = tie.variance_along_m2(&direction).sqrt();
        if (sign * tie.shift_m().dot(&direction) - median).abs() > SIGMAS * sigma_m + options.drift_m {
            verdict = Some(SpotRejection::Neighbours);
        }
    }
    verdict
}
