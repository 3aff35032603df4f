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
    /// How far the nearest other of a like direction is \[s\].
    nearest_s: f64,
}

impl Live {
    /// How far another is in time \[s\].
    fn apart_s(&self, other: &Self) -> f64 {
        (other.first_s - self.first_s).abs().max((other.last_s - self.last_s).abs())
    }

    /// Whether another looks the same way.
    fn is_like(&self, other: &Self) -> bool {
        self.direction.dot(&other.direction).abs() > 0.7
    }

    /// What it tells that no other does.
    fn novelty(&self) -> f64 {
        self.weight * (self.nearest_s / APART_S).min(1.0)
    }
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
            nearest_s: f64::INFINITY,
        });
    }
    waiting.sort_by(|a, b| a.first_s.total_cmp(&b.first_s).then(a.tie.cmp(&b.tie)));
    let mut live: Vec<Live> = Vec::new();
    let mut dropped = 0;
    for next in waiting {
        while let Some(i) = live.iter().position(|l| l.last_s < next.first_s) {
            take_away(&mut live, i);
        }
        add(&mut live, next);
        while live.iter().map(|l| l.rank).sum::<usize>() > slots {
            let least = live.iter().min_by(|a, b| a.novelty().total_cmp(&b.novelty()).then(b.tie.cmp(&a.tie)));
            let Some(i) = least.map(|l| l.tie).and_then(|tie| live.iter().position(|l| l.tie == tie)) else { break };
            why_not[take_away(&mut live, i).tie] = Some("budget");
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

/// Adds a tie to those alive.
fn add(live: &mut Vec<Live>, mut next: Live) {
    for other in live.iter_mut() {
        let apart_s = next.apart_s(other);
        if (apart_s < next.nearest_s || apart_s < other.nearest_s) && next.is_like(other) {
            next.nearest_s = next.nearest_s.min(apart_s);
            other.nearest_s = other.nearest_s.min(apart_s);
        }
    }
    live.push(next);
}

/// Takes a tie away from those alive; whose nearest it was looks for another.
fn take_away(live: &mut Vec<Live>, i: usize) -> Live {
    let gone = live.swap_remove(i);
    for j in 0..live.len() {
        let me = &live[j];
        if me.apart_s(&gone) <= me.nearest_s {
            let others = live.iter().enumerate().filter(|(k, other)| *k != j && me.is_like(other));
            live[j].nearest_s = others.map(|(_, other)| me.apart_s(other)).fold(f64::INFINITY, f64::min);
        }
    }
    gone
}
