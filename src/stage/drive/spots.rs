//! Spots of pavement as points for the smoother, and which of all points it gets.
//!
//! All matches of one spot share its first sighting: those that hold all directions become one tie with all their ends, those that leave the same one free another. Like lines, spots a moment apart tell nearly the same
//! of the trajectory; of each class the most precise stay, as far apart in time as it takes.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use tieline_matching::xyz::texture::{SpotEnd, SpotTie};
use tieline_matching::xyz::{XyzEnd, XyzKind, XyzPoint};

use super::points::{PointTie, most_live};
use crate::job::Matched;

/// States that the smoother holds for points that were found, beside those for lines: of several visits, and of one.
const LIVE: [usize; 2] = [60, 24];
/// States for them in all.
pub const MOST_LIVE: usize = LIVE[0] + LIVE[1];

/// The accepted spots as points, variances times `factor`.
#[must_use]
pub fn points_of(matched: &Matched, factor: f64) -> Vec<XyzPoint> {
    let mut by_spot: BTreeMap<u32, Vec<&SpotTie>> = BTreeMap::new();
    for spot in matched.spots.iter().filter(|s| s.rejection.is_none()) {
        by_spot.entry(spot.spot).or_default().push(spot);
    }
    let groups = by_spot.values().flat_map(|of_spot| alike(of_spot));
    groups
        .filter_map(|matches| {
            // half of a match's covariance each; the first end is shared and has that of the worst
            let worst = matches.iter().max_by(|a, b| a.covariance_m2.trace().total_cmp(&b.covariance_m2.trace()))?;
            let first = end(matched, &matches[0].ends[0], worst, factor);
            let others = matches.iter().map(|m| end(matched, &m.ends[1], m, factor));
            let ends = first.into_iter().chain(others.flatten()).collect();
            Some(XyzPoint { kind: XyzKind::Texture, name: None, free: matches[0].free, ends, known: None })
        })
        .collect()
}

/// An end with half of the covariance of its match.
fn end(matched: &Matched, end: &SpotEnd, of: &SpotTie, factor: f64) -> Option<XyzEnd> {
    let (strip, scanner) = matched.strips.find(end.source, end.time_s)?;
    Some(XyzEnd {
        strip,
        scanner,
        time_s: end.time_s,
        place_m: end.place_m,
        covariance_m2: of.covariance_m2 * (0.5 * factor),
        // pavement is level but for its slope
        normal: Vector3::z(),
        points: end.points,
        intensity: end.intensity,
    })
}

/// Matches of one spot that hold the same directions: those that hold all, and those that leave one free which is the same but for a few degrees, the most precise first.
fn alike<'a>(of_spot: &[&'a SpotTie]) -> Vec<Vec<&'a SpotTie>> {
    /// Square of the cosine of six degrees.
    const SAME: f64 = 0.989;
    let mut order = of_spot.to_vec();
    order.sort_by(|a, b| a.covariance_m2.trace().total_cmp(&b.covariance_m2.trace()));
    let mut groups: Vec<Vec<&SpotTie>> = Vec::new();
    for tie in order {
        let is_alike = |other: &SpotTie| match (tie.free, other.free) {
            (None, None) => true,
            (Some(a), Some(b)) => a.dot(&b).powi(2) > SAME,
            _ => false,
        };
        match groups.iter_mut().find(|g| is_alike(g[0])) {
            Some(group) => group.push(tie),
            None => groups.push(vec![tie]),
        }
    }
    groups
}

/// What there is to say of spots, all and those for the smoother, with the factor of their variances.
#[must_use]
pub fn note((all, taken): (&[PointTie], &[PointTie]), factor: f64) -> Option<String> {
    let spots = |of: &[PointTie]| of.iter().filter(|t| t.found == XyzKind::Texture).count();
    (spots(taken) > 0).then(|| {
        format!(
            "{} of {} spots of pavement went to the smoother, {} of them without one direction; their sigmas, as they turned out over as measured: {:.2}",
            spots(taken),
            spots(all),
            taken.iter().filter(|t| t.found == XyzKind::Texture && t.rank() == 2).count(),
            factor.sqrt()
        )
    })
}

/// Those that hold all directions before those that do not, and the most precise of either, so far apart in time that the smoother holds them all; what a person picked stays. Numbers count from `first_id`.
#[must_use]
pub fn thinned(ties: &[PointTie], first_id: u64) -> Vec<PointTie> {
    let is_picked = |k: &usize| ties[*k].found == XyzKind::Picked;
    let found = || (0..ties.len()).filter(|k| !is_picked(k));
    let mut kept: Vec<usize> = [true, false]
        .into_iter()
        .zip(LIVE)
        .flat_map(|(is_loop, live)| {
            let mut order: Vec<usize> = found().filter(|k| ties[*k].is_loop() == is_loop).collect();
            order.sort_by(|a, b| {
                let (a_tie, b_tie) = (&ties[*a], &ties[*b]);
                let by_rank = b_tie.rank().cmp(&a_tie.rank());
                by_rank.then(a_tie.variance_m2().total_cmp(&b_tie.variance_m2())).then(a.cmp(b))
            });
            spaced(ties, &order, live)
        })
        .chain((0..ties.len()).filter(is_picked))
        .collect();
    kept.sort_unstable();
    let numbered = kept.into_iter().zip(first_id..).map(|(k, id)| {
        let mut tie = ties[k].clone();
        tie.tie.id = id;
        tie
    });
    numbered.collect()
}

/// Rows in order of preference, without those that begin and end too near to one before.
fn spaced(ties: &[PointTie], order: &[usize], live: usize) -> Vec<usize> {
    let mut spacing_s = 0.05;
    loop {
        let mut kept: Vec<usize> = Vec::new();
        for k in order {
            let (first_s, last_s) = ties[*k].span_s();
            let is_near = |other: &usize| {
                let (a, b) = ties[*other].span_s();
                (a - first_s).abs().max((b - last_s).abs()) < spacing_s
            };
            if !kept.iter().any(is_near) {
                kept.push(*k);
            }
        }
        if most_live(kept.iter().map(|k| &ties[*k].tie)) <= live || spacing_s > 100.0 {
            return kept;
        }
        spacing_s *= 1.3;
    }
}
