//! Ties of corners and poles between two sightings, and how those about them judge them.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::corner_match::NotTied;
use super::point::{XyzEnd, XyzKind, held_beside};

/// A corner, an edge or a pole that two sightings have.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FeatureTie {
    /// What it is.
    pub kind: XyzKind,
    /// Its number: ties of one feature share the first sighting.
    pub feature: u32,
    /// As the first sighting has it, and as the second has, each with its own covariance.
    pub ends: [XyzEnd; 2],
    /// The unit vector along which nothing is known, local frame; none where all directions are held.
    pub free: Option<Vector3<f64>>,
    /// Why it is no tie.
    pub rejection: Option<NotTied>,
}

impl FeatureTie {
    /// Second place less first \[m\].
    #[must_use]
    pub fn shift_m(&self) -> Vector3<f64> {
        self.ends[1].place_m - self.ends[0].place_m
    }

    /// Its covariance \[m²\].
    #[must_use]
    pub fn covariance_m2(&self) -> Matrix3<f64> {
        self.ends[0].covariance_m2 + self.ends[1].covariance_m2
    }

    /// Unit vectors that the tie holds: see [`held_beside`].
    #[must_use]
    pub fn held(&self) -> Vec<Vector3<f64>> {
        held_beside(self.free)
    }
}

/// What neighbours are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgreeOptions {
    /// Both ends lie no further apart in time \[s\].
    pub near_s: f64,
    /// What the mismatch may change by in that time \[m\].
    pub drift_m: f64,
    /// Fewer neighbours judge nothing.
    pub fewest: usize,
    /// Ties nearer to each other than this share surfaces, and do not judge each other \[m\].
    pub apart_m: f64,
}

impl Default for AgreeOptions {
    fn default() -> Self {
        Self { near_s: 12.0, drift_m: 0.02, fewest: 2, apart_m: 4.0 }
    }
}

/// So many neighbours, the nearest in time, are asked.
const MOST: usize = 12;
/// A tie knows a direction of which so much lies in what it holds: a square of a cosine.
const KNOWN: f64 = 0.9;
/// Sigmas of a difference that is chance.
const SIGMAS: f64 = 4.0;

/// Ties of the same two strips, or of the same two scanners in one strip, in order of time; each with +1, or -1 where its ends stand the other way round.
type Group = Vec<(usize, f64)>;

fn bound(tie: &FeatureTie) -> ([(u32, u16); 2], bool) {
    let [a, b] = tie.ends.each_ref().map(|e| (e.strip, e.scanner));
    let [a, b] = if a.0 == b.0 { [a, b] } else { [(a.0, 0), (b.0, 0)] };
    if a < b || (a == b && tie.ends[0].time_s <= tie.ends[1].time_s) { ([a, b], true) } else { ([b, a], false) }
}

/// Gives ties that their neighbours do not bear out a reason: in each direction that a tie holds it must agree with the median of the others that know it.
pub fn agree(ties: &mut [FeatureTie], options: &AgreeOptions) {
    let mut groups: BTreeMap<_, Group> = BTreeMap::new();
    for (k, tie) in ties.iter().enumerate().filter(|(_, t)| t.rejection.is_none()) {
        let (what, forward) = bound(tie);
        groups.entry(what).or_default().push((k, if forward { 1.0 } else { -1.0 }));
    }
    for group in groups.values_mut() {
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

fn times_s(ties: &[FeatureTie], (row, sign): (usize, f64)) -> [f64; 2] {
    let [a, b] = ties[row].ends.each_ref().map(|e| e.time_s);
    if sign > 0.0 { [a, b] } else { [b, a] }
}

fn verdict(ties: &[FeatureTie], group: &Group, k: usize, options: &AgreeOptions) -> Option<NotTied> {
    let (row, sign) = group[k];
    let (tie, here) = (&ties[row], times_s(ties, group[k]));
    let apart_s = |other: &(usize, f64)| {
        let there = times_s(ties, *other);
        (there[0] - here[0]).abs().max((there[1] - here[1]).abs())
    };
    let elsewhere = |other: &FeatureTie| (other.ends[0].place_m - tie.ends[0].place_m).xy().norm() > options.apart_m;
    let mut near: Group =
        group.iter().filter(|o| elsewhere(&ties[o.0]) && apart_s(o) <= options.near_s).copied().collect();
    near.sort_by(|a, b| apart_s(a).total_cmp(&apart_s(b)).then(a.0.cmp(&b.0)));
    let mut verdict = None;
    for direction in tie.held() {
        let knows = |o: &FeatureTie| o.held().iter().map(|h| h.dot(&direction).powi(2)).sum::<f64>() > KNOWN;
        let others = near.iter().filter(|(r, _)| knows(&ties[*r])).take(MOST);
        let mut others: Vec<f64> = others.map(|(r, sign)| sign * ties[*r].shift_m().dot(&direction)).collect();
        if others.len() < options.fewest {
            return Some(NotTied::Alone);
        }
        others.sort_by(f64::total_cmp);
        let middle = others.len() / 2;
        let median = if others.len() % 2 == 1 { others[middle] } else { 0.5 * (others[middle - 1] + others[middle]) };
        let sigma_m = direction.dot(&(tie.covariance_m2() * direction)).max(0.0).sqrt();
        if (sign * tie.shift_m().dot(&direction) - median).abs() > SIGMAS * sigma_m + options.drift_m {
            verdict = Some(NotTied::Neighbours);
        }
    }
    verdict
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tie(at: f64, shift_m: Vector3<f64>, free: Option<Vector3<f64>>) -> FeatureTie {
        let end = |strip, time_s, place_m| XyzEnd {
            strip,
            scanner: 0,
            time_s,
            place_m,
            covariance_m2: Matrix3::from_diagonal_element(4e-6),
            normal: Vector3::x(),
            points: 100,
            intensity: 1.0,
        };
        let place_m = Vector3::new(10.0 * at, 0.0, 0.0);
        let ends = [end(0, at, place_m), end(1, 100.0 + at, place_m + shift_m)];
        FeatureTie { kind: XyzKind::Corner, feature: 0, ends, free, rejection: None }
    }

    #[test]
    fn the_one_that_differs_goes_and_a_lone_one_too() {
        let common = Vector3::new(0.3, -0.2, 0.05);
        let mut ties: Vec<FeatureTie> = (0..5).map(|k| tie(f64::from(k), common, None)).collect();
        ties.push(tie(5.0, common + Vector3::new(0.05, 0.0, 0.0), None));
        // off along what it does not hold, which does no harm; its ends the other way round
        let mut turned = tie(6.0, common + Vector3::z(), Some(Vector3::z()));
        turned.ends.reverse();
        ties.push(turned);
        ties.push(tie(80.0, common, None));
        agree(&mut ties, &AgreeOptions::default());
        let found: Vec<_> = ties.iter().map(|t| t.rejection).collect();
        assert_eq!(found[..5], [None; 5]);
        assert_eq!(found[5..], [Some(NotTied::Neighbours), None, Some(NotTied::Alone)]);
    }

    #[test]
    fn ties_at_one_place_do_not_bear_each_other_out() {
        let mut ties: Vec<FeatureTie> = (0..4).map(|k| tie(0.01 * f64::from(k), Vector3::zeros(), None)).collect();
        agree(&mut ties, &AgreeOptions::default());
        assert!(ties.iter().all(|t| t.rejection == Some(NotTied::Alone)));
    }
}
