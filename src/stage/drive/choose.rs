//! Which lines become ties: as many as carry information of their own.
//!
//! Errors of the trajectory change slowly. Two ties of like direction, seen within a fraction of a second at like ranges, tell the
//! same twice. Of each kind the best comes first, and what lies too near in time to one already taken is left out; the nearness
//! grows until no more live at one time than the smoother holds. Loop ties matter where the trajectory is not known well
//! without them: elsewhere they stand further apart.

use std::collections::BTreeMap;

use tieline_filter::{FilterTie, TieKind};

use super::ties::{DriveLine, End};

/// The choice.
#[derive(Debug, Clone, Default)]
pub struct Chosen {
    /// Ties for the smoother.
    pub ties: Vec<FilterTie>,
    /// Line and visit (none: all visits) of each.
    pub of: Vec<(usize, Option<usize>)>,
    /// Nearness in time \[s\]: of loop ties, of increments.
    pub spacing_s: (f64, f64),
}

/// Shares of the states that the smoother holds: for loop ties and for increments.
const LOOP_SHARE: f64 = 0.5;
const INCREMENT_SHARE: f64 = 0.45;

/// Chooses for a number of live states.
#[must_use]
#[allow(clippy::cast_precision_loss)]
pub fn choose(lines: &[DriveLine], most_live: usize) -> Chosen {
    let mut loops = Vec::new();
    let mut increments = Vec::new();
    for (i, line) in lines.iter().enumerate().filter(|(_, l)| !l.held_out) {
        if line.visits() > 1 {
            loops.push(Candidate::new(i, None, line, |_| true));
        }
        for visit in 0..line.visits() {
            if line.ends.iter().filter(|e| e.visit == visit).count() > 1 {
                increments.push(Candidate::new(i, Some(visit), line, |e| e.visit == visit));
            }
        }
    }
    let (of_loops, loop_s) = thin(loops, most_live as f64 * LOOP_SHARE);
    let taken: std::collections::BTreeSet<usize> = of_loops.iter().map(|c| c.line).collect();
    increments.retain(|c| !taken.contains(&c.line));
    let (of_increments, increment_s) = thin(increments, most_live as f64 * INCREMENT_SHARE);
    let mut chosen = Chosen { spacing_s: (loop_s, increment_s), ..Chosen::default() };
    for candidate in of_loops.into_iter().chain(of_increments) {
        let line = &lines[candidate.line];
        let id = chosen.ties.len() as u64;
        let tie = match candidate.visit {
            None => line.tie(id, TieKind::SurfaceLine, |_| true),
            Some(visit) => line.tie(id, TieKind::Increment, |e| e.visit == visit),
        };
        chosen.ties.push(tie);
        chosen.of.push((candidate.line, candidate.visit));
    }
    chosen
}

/// Ties of one kind tell the same: direction, and scanner and range class of the first two ends.
type Kind = (u8, Vec<(u16, u8)>);

struct Candidate {
    line: usize,
    visit: Option<usize>,
    first_s: f64,
    last_s: f64,
    variance_m2: f64,
    /// Worst standard deviation of the position at its ends \[m\].
    position_sigma_m: f64,
    kind: Kind,
}

impl Candidate {
    fn new(line: usize, visit: Option<usize>, of: &DriveLine, ends: impl Fn(&End) -> bool) -> Self {
        let ends: Vec<&End> = of.ends.iter().filter(|e| ends(e)).collect();
        let mut seen: Vec<(u16, u8)> = ends.iter().map(|e| (e.scanner, range_class(e.range_m))).collect();
        seen.truncate(2);
        Self {
            line,
            visit,
            first_s: ends[0].sighting.time_s,
            last_s: ends[ends.len() - 1].sighting.time_s,
            variance_m2: ends.iter().map(|e| e.sighting.covariance_m2[(0, 0)]).sum::<f64>() / ends.len() as f64,
            position_sigma_m: ends.iter().map(|e| e.position_sigma_m).fold(0.0, f64::max),
            // loop ties bind the trajectory: their ranges do not matter
            kind: (direction_class(of), if visit.is_some() { seen } else { Vec::new() }),
        }
    }
}

/// Level, or the direction of a steep surface from the vehicle in eighths of a half turn.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn direction_class(line: &DriveLine) -> u8 {
    if line.normal_up.abs() > 0.7 {
        return 0;
    }
    let azimuth = line.normal_body.y.atan2(line.normal_body.x).rem_euclid(std::f64::consts::PI);
    1 + ((azimuth / std::f64::consts::PI * 4.0 + 0.5) as u8 % 4)
}

/// Loop ties between well-known stretches stand this many times further apart.
const WELL_KNOWN_SPACING: f64 = 6.0;
/// Of the standard deviations of loop ties, this many times the least still count as well known.
const WELL_KNOWN: f64 = 2.0;

/// Half doublings of the range.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn range_class(range_m: f64) -> u8 {
    (range_m.max(1.0).log2() * 2.0) as u8
}

/// Thins candidates until no more than `most_live` live at one time on average of the busiest minute.
fn thin(mut candidates: Vec<Candidate>, most_live: f64) -> (Vec<Candidate>, f64) {
    candidates.sort_by(|a, b| a.variance_m2.total_cmp(&b.variance_m2).then(a.line.cmp(&b.line)));
    let least_m = candidates.iter().map(|c| c.position_sigma_m).fold(f64::INFINITY, f64::min);
    let widened = |c: &Candidate| {
        let known = c.visit.is_none() && c.position_sigma_m <= WELL_KNOWN * least_m;
        if known { WELL_KNOWN_SPACING } else { 1.0 }
    };
    let mut spacing_s = 0.05;
    loop {
        let mut taken: BTreeMap<&Kind, Vec<(f64, f64)>> = BTreeMap::new();
        let mut kept = Vec::new();
        for (i, c) in candidates.iter().enumerate() {
            let of_kind = taken.entry(&c.kind).or_default();
            let apart_s = spacing_s * widened(c);
            let near = |t: &(f64, f64)| (t.0 - c.first_s).abs() < apart_s && (t.1 - c.last_s).abs() < apart_s;
            if !of_kind.iter().any(near) {
                of_kind.push((c.first_s, c.last_s));
                kept.push(i);
            }
        }
        if busiest(kept.iter().map(|i| (candidates[*i].first_s, candidates[*i].last_s))) <= most_live
            || spacing_s > 60.0
        {
            let mut row = 0;
            candidates.retain(|_| {
                row += 1;
                kept.binary_search(&(row - 1)).is_ok()
            });
            return (candidates, spacing_s);
        }
        spacing_s *= 1.2;
    }
}

/// Most that live at one time.
fn busiest(spans: impl Iterator<Item = (f64, f64)>) -> f64 {
    let mut changes: Vec<(f64, f64)> = spans.flat_map(|(a, b)| [(a, 1.0), (b, -1.0)]).collect();
    changes.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut live = 0.0;
    changes.iter().fold(0.0_f64, |most, (_, change)| {
        live += change;
        most.max(live)
    })
}
