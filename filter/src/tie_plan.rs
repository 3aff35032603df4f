//! Which ties are used: no more at one time than there are slots for their states.
//!
//! Sweeping over time, whenever the ties alive need more states than there are slots, the one that tells least goes: that
//! whose sightings lie nearest in time to those of another tie of a like direction that stays, weighed by precision.

use nalgebra::Vector3;

use crate::update::tie::FilterTie;

/// The choice.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct TiePlan {
    /// Ties that are used.
    pub used: Vec<usize>,
    /// Why a tie is not used.
    pub why_not: Vec<Option<&'static str>>,
    /// What is to be said.
    pub notes: Vec<String>,
}

/// Seconds between sightings from which two ties tell different things.
const APART_S: f64 = 20.0;

struct Live {
    tie: usize,
    first_s: f64,
    last_s: f64,
    rank: usize,
    weight: f64,
    direction: Vector3<f64>,
}

/// Chooses the ties for a span of time and a number of slots.
pub(crate) fn plan_ties(ties: &[FilterTie], slots: usize, (start_s, end_s): (f64, f64)) -> TiePlan {
    let mut why_not: Vec<Option<&'static str>> = vec![None; ties.len()];
    let mut waiting: Vec<Live> = Vec::new();
    for (tie, t) in ties.iter().enumerate() {
        let within: Vec<f64> = t.sightings.iter().map(|s| s.time_s).filter(|s| *s > start_s && *s <= end_s).collect();
        let enough = if t.known_m.is_some() { 1 } else { 2 };
        if within.len() < enough || within.len() < t.sightings.len() {
            why_not[tie] = Some("beyond_trajectory");
            continue;
        }
        if t.known_m.is_some() {
            continue; // takes no slot
        }
        let variance = t.sightings.iter().map(|s| s.covariance_m2[(0, 0)]).fold(0.0, f64::max);
        waiting.push(Live {
            tie,
            first_s: within[0],
            last_s: within[within.len() - 1],
            rank: t.directions.len(),
            weight: 1.0 / variance.max(1e-12),
            direction: t.directions[0],
        });
    }
    waiting.sort_by(|a, b| a.first_s.total_cmp(&b.first_s).then(a.tie.cmp(&b.tie)));
    let mut live: Vec<Live> = Vec::new();
    let mut dropped = 0;
    for next in waiting {
        live.retain(|l| l.last_s >= next.first_s);
        live.push(next);
        while live.iter().map(|l| l.rank).sum::<usize>() > slots {
            let least =
                (0..live.len()).map(|i| (novelty(&live, i), i)).min_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
            let Some((_, i)) = least else { break };
            why_not[live.swap_remove(i).tie] = Some("budget");
            dropped += 1;
        }
    }
    let used = (0..ties.len()).filter(|i| why_not[*i].is_none()).collect();
    let mut notes = Vec::new();
    if dropped > 0 {
        notes.push(format!(
            "{dropped} of {} ties dropped: more than {slots} landmark states at one time; the batch adjustment takes them all",
            ties.len()
        ));
    }
    TiePlan { used, why_not, notes }
}

/// What a live tie tells that no other does.
fn novelty(live: &[Live], i: usize) -> f64 {
    let me = &live[i];
    let nearest = live
        .iter()
        .enumerate()
        .filter(|(j, other)| *j != i && me.direction.dot(&other.direction).abs() > 0.7)
        .map(|(_, other)| (other.first_s - me.first_s).abs().max((other.last_s - me.last_s).abs()))
        .fold(f64::INFINITY, f64::min);
    me.weight * (nearest / APART_S).min(1.0)
}
