//! Ties of places in the summary: counts by kind, and how far their places lie apart.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use tieline_graph::Line;

use crate::job::Matched;
use crate::report::data::{Discrepancy, PlaceSummary, TieCounts, TiePoint};
use crate::stage::places::PlaceKind;
use crate::stage::solve::Solution;
use tieline_matching::Sighting;

/// The key among the kinds of ties: what is held, not how it was found.
pub(crate) fn key(kind: PlaceKind) -> &'static str {
    match kind {
        PlaceKind::Submap => "submap",
        PlaceKind::Ridge => "line",
        PlaceKind::Corner => "xyz_point",
    }
}

/// One direction of a tie in the solution: row of the tie, distances before and after \[m\], the line after, whether it was taken out.
pub(crate) struct Found<'a> {
    pub(crate) tie: usize,
    pub(crate) before_m: f64,
    pub(crate) after_m: f64,
    pub(crate) before: &'a Line,
    pub(crate) line: &'a Line,
    pub(crate) sigma_m: f64,
    pub(crate) outlier: bool,
}

/// The directions of all ties of places in a solution. Distances are first less second place.
pub(crate) fn found(solution: &Solution) -> impl Iterator<Item = Found<'_>> {
    let first = solution.rows.len();
    solution.places.iter().enumerate().filter_map(move |(k, (tie, _))| {
        let (before, line) = (&solution.lines_before[first + k], &solution.lines[first + k]);
        let [a, b] = solution.adjustment.ends[first + k].as_slice() else { return None };
        Some(Found {
            tie: *tie,
            before_m: before.ends[0].offset_m - before.ends[1].offset_m,
            after_m: line.ends[0].offset_m - line.ends[1].offset_m,
            before,
            line,
            sigma_m: a.sigma_m.hypot(b.sigma_m),
            outlier: a.outlier || b.outlier,
        })
    })
}

/// Counts and distances by kind; kinds that were not found are not there.
pub(super) fn places(matched: &Matched, solution: &Solution) -> BTreeMap<String, PlaceSummary> {
    let ties = &matched.ties.places.ties;
    let mut kinds = BTreeMap::new();
    for kind in PlaceKind::ALL {
        let rows: Vec<Found<'_>> = found(solution).filter(|f| ties[f.tie].kind == kind).collect();
        let count = |held_out: bool| {
            let mut of: Vec<usize> =
                rows.iter().filter(|f| !f.outlier && f.line.held_out == held_out).map(|f| f.tie).collect();
            of.dedup();
            of
        };
        let of_kind = ties.iter().filter(|t| t.kind == kind).count() as u64;
        if of_kind == 0 {
            continue;
        }
        let used = count(false);
        let mut rank = [0; 3];
        for tie in &used {
            rank[ties[*tie].rank().clamp(1, 3) - 1] += 1;
        }
        let values = |held_out: bool, f: fn(&Found<'_>) -> f64| -> Vec<f64> {
            rows.iter().filter(|r| !r.outlier && r.line.held_out == held_out).map(f).collect()
        };
        let before = Discrepancy::of(&values(false, |f| f.before_m));
        let after = Discrepancy::of(&values(false, |f| f.after_m));
        let held_out_after = Discrepancy::of(&values(true, |f| f.after_m));
        let counts = TieCounts { found: of_kind, used: used.len() as u64, held_out: count(true).len() as u64 };
        kinds.insert(kind.as_str().to_string(), PlaceSummary { counts, rank, before, after, held_out_after });
    }
    kinds
}

/// Sightings, difference (second less first) and direction of every direction of every tie, as of surface lines.
pub(super) fn points(matched: &Matched, solution: &Solution) -> Vec<(Sighting, Sighting, TiePoint, Vector3<f64>)> {
    let point = |f: Found<'_>| {
        let [a, b] = matched.ties.places.ties[f.tie].sightings.map(|s| Sighting { pass: 0, ..s });
        // the order of the pair turns the direction of the difference
        let (a, b, sign) = if a <= b { (a, b, -1.0) } else { (b, a, 1.0) };
        let point = TiePoint {
            map_m: f.before.ends[0].point_m.into(),
            pair: 0,
            normal_up: f.line.normal.z,
            before_m: sign * f.before_m,
            after_m: sign * f.after_m,
            held_out: f.line.held_out,
            outlier: f.outlier,
        };
        (a, b, point, f.line.normal)
    };
    found(solution).map(point).collect()
}
