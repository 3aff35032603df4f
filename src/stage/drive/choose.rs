//! Which lines become ties: as many as carry information of their own.
//!
//! Errors of the trajectory change slowly. Two ties of like direction, seen within a fraction of a second at like ranges, tell the
//! same twice: they go in as one ([`super::merge`]). Of each kind the best comes first and what lies near in time to one already taken joins it,
//! where the same scanners saw it, or is left out; the nearness grows until no more live at one time than the smoother holds. Loop ties matter where
//! the trajectory is not known well without them: elsewhere they stand further apart.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector2;
use tieline_filter::{FilterTie, TieKind, Trajectory};

use super::merge::{LIKE_HEIGHT_M, Part, are_like, ends, merged};
use super::ties::{DriveLine, End};
use crate::project::SurfaceWord;

/// The choice.
#[derive(Debug, Clone, Default)]
pub struct Chosen {
    /// Ties for the smoother.
    pub ties: Vec<FilterTie>,
    /// What each was made of, the most precise first: lines, and visits (none: all visits).
    pub of: Vec<Vec<Part>>,
    /// Nearness in time \[s\].
    pub spacing_s: Spacing,
}

/// Nearness in time \[s\] of like ties of each kind.
#[derive(Debug, Clone, Copy, Default)]
pub struct Spacing {
    /// Of loop ties on walls that were seen from another side.
    pub turned_s: f64,
    /// Of other loop ties.
    pub loop_s: f64,
    /// Of increments.
    pub increment_s: f64,
}

/// Shares of the states that the smoother holds: for loop ties on turned walls, for all loop ties, and for increments.
const TURNED_SHARE: f64 = 0.25;
const LOOP_SHARE: f64 = 0.58;
const INCREMENT_SHARE: f64 = 0.38;
/// Lines whose ends are further apart in time than this are not made one tie \[s\].
const MERGED_S: f64 = 0.5;

/// Chooses for a number of live states, strays left out. The trajectory is that which the strips were made with; `clock_shift_s` leads from its clock to
/// the smoother's.
#[must_use]
#[allow(clippy::cast_precision_loss)]
pub fn choose(
    lines: &[DriveLine],
    strays: &BTreeSet<Part>,
    most_live: usize,
    trajectory: &Trajectory,
    clock_shift_s: f64,
) -> Chosen {
    let (mut turned, mut loops) = (Vec::new(), Vec::new());
    let mut increments = Vec::new();
    for (i, line) in lines.iter().enumerate().filter(|(_, l)| !l.held_out) {
        if line.visits() > 1 && !strays.contains(&(i, None)) {
            let kind = if is_turned(line) { &mut turned } else { &mut loops };
            kind.push(Candidate::new(line, (i, None)));
        }
        for visit in 0..line.visits() {
            if ends(line, Some(visit)).count() > 1 && !strays.contains(&(i, Some(visit))) {
                increments.push(Candidate::new(line, (i, Some(visit))));
            }
        }
    }
    let most_live = most_live as f64;
    let (mut of_loops, turned_s) = thin(turned, lines, most_live * TURNED_SHARE);
    let live = busiest_of(&of_loops, lines);
    let (others, loop_s) = thin(loops, lines, most_live * LOOP_SHARE - live);
    of_loops.extend(others);
    let taken: BTreeSet<usize> = of_loops.iter().flatten().map(|(line, _)| *line).collect();
    increments.retain(|c| !taken.contains(&c.part.0));
    let (of_increments, increment_s) = thin(increments, lines, most_live * INCREMENT_SHARE);
    let mut chosen = Chosen { spacing_s: Spacing { turned_s, loop_s, increment_s }, ..Chosen::default() };
    for parts in of_loops.iter().chain(&of_increments) {
        let kind = if parts[0].1.is_none() { TieKind::SurfaceLine } else { TieKind::Increment };
        let id = chosen.ties.len() as u64;
        if let Some((tie, of)) = merged(lines, parts, trajectory, clock_shift_s, id, kind) {
            chosen.ties.push(tie);
            chosen.of.push(of);
        }
    }
    chosen
}

/// Ties of one kind tell the same: direction, height on a wall, and scanner and range class of the first two ends.
type Kind = (u8, i8, Vec<(u16, u8)>);

struct Candidate {
    part: Part,
    first_s: f64,
    last_s: f64,
    variance_m2: f64,
    /// Worst standard deviation of the position at its ends \[m\].
    position_sigma_m: f64,
    /// Whether its loop tie is on a wall seen from another side.
    is_turned: bool,
    kind: Kind,
}

impl Candidate {
    fn new(line: &DriveLine, part: Part) -> Self {
        let (mut first_s, mut last_s) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut variance_m2, mut count, mut position_sigma_m) = (0.0, 0.0, 0.0_f64);
        let mut seen = Vec::new();
        for end in ends(line, part.1) {
            first_s = first_s.min(end.sighting.time_s);
            last_s = last_s.max(end.sighting.time_s);
            variance_m2 += end.sighting.covariance_m2[(0, 0)];
            position_sigma_m = position_sigma_m.max(end.position_sigma_m);
            count += 1.0;
            if seen.len() < 2 {
                seen.push((end.scanner, range_class(end.range_m)));
            }
        }
        let is_turned = part.1.is_none() && is_turned(line);
        // loop ties bind the trajectory, at whatever range and height; those on turned walls bind the scanners too
        let height = if part.1.is_some() || is_turned { height_class(line, part.1) } else { 0 };
        Self {
            part,
            first_s,
            last_s,
            variance_m2: variance_m2 / count,
            position_sigma_m,
            is_turned,
            kind: (direction_class(line), height, if part.1.is_some() { seen } else { vec![(0, u8::from(is_turned))] }),
        }
    }
}

/// Level, or the direction of a steep surface from the vehicle in eighths of a turn.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub(super) fn direction_class(line: &DriveLine) -> u8 {
    if SurfaceWord::of(line.normal_up) == SurfaceWord::Level {
        return 0;
    }
    let normal_body = &line.ends[0].normal_body;
    let azimuth = normal_body.y.atan2(normal_body.x).rem_euclid(std::f64::consts::TAU);
    1 + ((azimuth / std::f64::consts::TAU * 8.0 + 0.5) as u8 % 8)
}

/// Loop ties between well-known stretches stand this many times further apart.
const WELL_KNOWN_SPACING: f64 = 6.0;
/// Of the standard deviations of loop ties, this many times the least still count as well known.
const WELL_KNOWN: f64 = 2.0;

/// Whether a wall was seen from another side in another visit: after a turn by 45° or more, or from the other way. Such ties are few, and little else tells a scanner's
/// roll from its pitch: on a block driven round twice, 430 of 18,000 loop ties took the sigma of the pitch between two scanners from 0.0025° to 0.0019°, all of them
/// to 0.0017°.
fn is_turned(line: &DriveLine) -> bool {
    if SurfaceWord::of(line.normal_up) == SurfaceWord::Level {
        return false;
    }
    let pairs = line.ends.iter().enumerate().flat_map(|(k, a)| line.ends[k + 1..].iter().map(move |b| (a, b)));
    let level = |e: &End| Vector2::new(e.normal_body.x, e.normal_body.y).normalize();
    let least = pairs.filter(|(a, b)| a.visit != b.visit).map(|(a, b)| level(a).dot(&level(b))).fold(1.0, f64::min);
    least < std::f64::consts::FRAC_1_SQRT_2
}

/// Height above the vehicle at which a part of a wall was first seen, in steps of [`LIKE_HEIGHT_M`]; ground has none. A mean over foot and eaves would
/// not say any more how far a beam leans: only that tells the pitch of a scanner (on walls ahead) and its roll (abeam) from the way that the vehicle went.
#[allow(clippy::cast_possible_truncation)]
fn height_class(line: &DriveLine, visit: Option<usize>) -> i8 {
    if SurfaceWord::of(line.normal_up) == SurfaceWord::Level {
        return 0;
    }
    ends(line, visit).next().map_or(0, |e| (-e.delivered_m.z / LIKE_HEIGHT_M).floor() as i8)
}

/// Half doublings of the range.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn range_class(range_m: f64) -> u8 {
    (range_m.max(1.0).log2() * 2.0) as u8
}

/// Thins candidates until no more than `most_live` live at one time on average of the busiest minute; each that is kept stands first among those
/// that join it.
fn thin(mut candidates: Vec<Candidate>, lines: &[DriveLine], most_live: f64) -> (Vec<Vec<Part>>, f64) {
    candidates.sort_by(|a, b| a.variance_m2.total_cmp(&b.variance_m2).then(a.part.cmp(&b.part)));
    let least_m = candidates.iter().map(|c| c.position_sigma_m).fold(f64::INFINITY, f64::min);
    let widened = |c: &Candidate| {
        let known = c.part.1.is_none() && !c.is_turned && c.position_sigma_m <= WELL_KNOWN * least_m;
        if known { WELL_KNOWN_SPACING } else { 1.0 }
    };
    let names: BTreeSet<&Kind> = candidates.iter().map(|c| &c.kind).collect();
    let number: BTreeMap<&Kind, usize> = names.into_iter().enumerate().map(|(k, kind)| (kind, k)).collect();
    let of_kind: Vec<usize> = candidates.iter().map(|c| number[&c.kind]).collect();
    let kept_at = |spacing_s: f64| {
        let mut kept = Kept { by_kind: vec![BTreeMap::new(); number.len()], ..Kept::default() };
        for (i, c) in candidates.iter().enumerate() {
            kept.take(i, of_kind[i], c, spacing_s * widened(c));
        }
        let live = busiest(kept.clusters.iter().map(|i| (candidates[i[0]].first_s, candidates[i[0]].last_s)));
        (kept, live)
    };
    // the wider apart, the fewer live: halving finds the least of the steps that will do, the widest where none does
    let (mut low, mut high) = (0, WIDEST);
    while low < high {
        let middle = (low + high) / 2;
        if kept_at(step_s(middle)).1 <= most_live {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    (kept_at(step_s(low)).0.parts(&candidates, lines), step_s(low))
}

/// The last of the steps of spacing: a minute.
const WIDEST: i32 = 39;

/// Steps of spacing, each a fifth wider than the one before \[s\].
fn step_s(step: i32) -> f64 {
    0.05 * 1.2_f64.powi(step)
}

/// What is kept, by kind in order of the first end's time: clusters of rows of candidates, the first of each its seed.
#[derive(Default)]
struct Kept<'a> {
    by_kind: Vec<BTreeMap<Moment, usize>>,
    clusters: Vec<Vec<usize>>,
    seeds: Vec<&'a Candidate>,
}

/// A time that sorts, and the row that makes it unique.
#[derive(PartialEq, Clone, Copy)]
struct Moment(f64, usize);

impl Eq for Moment {}

impl PartialOrd for Moment {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Moment {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0).then(self.1.cmp(&other.1))
    }
}

impl<'a> Kept<'a> {
    /// Keeps a candidate, or lets it join the seed that is nearest.
    fn take(&mut self, row: usize, kind: usize, c: &'a Candidate, apart_s: f64) {
        let of_kind = &mut self.by_kind[kind];
        let around = of_kind.range(Moment(c.first_s - apart_s, 0)..Moment(c.first_s + apart_s, usize::MAX));
        let off_s = |cluster: &usize| {
            let seed = self.seeds[*cluster];
            (seed.first_s - c.first_s).abs().max((seed.last_s - c.last_s).abs())
        };
        let nearest = around.map(|(_, cluster)| *cluster).min_by(|a, b| off_s(a).total_cmp(&off_s(b)));
        match nearest.filter(|cluster| off_s(cluster) < apart_s) {
            Some(cluster) => {
                if off_s(&cluster) < MERGED_S {
                    self.clusters[cluster].push(row);
                }
            }
            None => {
                of_kind.insert(Moment(c.first_s, row), self.clusters.len());
                self.clusters.push(vec![row]);
                self.seeds.push(c);
            }
        }
    }

    /// The clusters, without candidates that are not like their seed.
    fn parts(&self, candidates: &[Candidate], lines: &[DriveLine]) -> Vec<Vec<Part>> {
        let of_cluster = |rows: &Vec<usize>| {
            let seed = candidates[rows[0]].part;
            let parts = rows.iter().map(|row| candidates[*row].part);
            parts.filter(|part| *part == seed || are_like(lines, seed, *part)).collect()
        };
        self.clusters.iter().map(of_cluster).collect()
    }
}

/// Most loop ties that live at one time, of those made of these parts.
fn busiest_of(of_loops: &[Vec<Part>], lines: &[DriveLine]) -> f64 {
    let time_s = |end: Option<&End>| end.map_or(0.0, |e| e.sighting.time_s);
    busiest(of_loops.iter().map(|parts| &lines[parts[0].0].ends).map(|e| (time_s(e.first()), time_s(e.last()))))
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

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};
    use tieline_filter::Sighting;

    use super::*;

    /// A wall, seen in two visits with its normal at these azimuths \[deg\] and at this height above the vehicle \[m\].
    fn wall(azimuth_deg: [f64; 2], height_m: f64) -> DriveLine {
        let ends = azimuth_deg.iter().enumerate().map(|(visit, azimuth_deg)| {
            let (sin, cos) = azimuth_deg.to_radians().sin_cos();
            let body_m = Vector3::new(-9.0 * cos, -9.0 * sin, -height_m);
            End {
                number: visit,
                strip: 0,
                scanner: 0,
                range_m: body_m.norm(),
                visit,
                position_sigma_m: 0.01,
                delivered_m: body_m,
                normal_body: Vector3::new(cos, sin, 0.0),
                measured_variance_m2: 1e-6,
                sighting: Sighting {
                    time_s: 100.0 * visit as f64,
                    body_vector_m: body_m,
                    covariance_m2: Matrix3::from_diagonal_element(1e-6),
                    by_constant: Vec::new(),
                },
            }
        });
        DriveLine {
            row: 0,
            direction: Vector3::x(),
            normal_map: Vector3::x(),
            point_map_m: Vector3::zeros(),
            normal_up: 0.0,
            ends: ends.collect(),
            held_out: false,
        }
    }

    #[test]
    fn a_wall_seen_from_another_side_is_turned() {
        assert!(!is_turned(&wall([85.0, 120.0], 1.0)), "35 degrees are not enough");
        assert!(is_turned(&wall([85.0, 170.0], 1.0)) && is_turned(&wall([90.0, -90.0], 1.0)));
        assert!(!is_turned(&wall([175.0, -175.0], 1.0)), "ten degrees over the seam");
        let ground = DriveLine { normal_up: 1.0, ..wall([85.0, 170.0], 1.0) };
        assert!(!is_turned(&ground), "level ground has no side");
    }

    #[test]
    fn foot_and_eaves_are_not_made_one() {
        let lines = [wall([90.0; 2], 0.2), wall([90.0; 2], 0.9), wall([90.0; 2], 6.0)];
        assert!(are_like(&lines, (0, Some(0)), (1, Some(0))) && !are_like(&lines, (0, Some(0)), (2, Some(0))));
        let kind = |line: &DriveLine, part| Candidate::new(line, part).kind;
        assert_ne!(kind(&lines[0], (0, Some(0))), kind(&lines[2], (2, Some(0))));
        // of a loop tie from the same side the height does not matter, of one on a turned wall it does
        assert_eq!(kind(&lines[0], (0, None)), kind(&lines[2], (2, None)));
        let (foot, eaves) = (wall([90.0, 0.0], 0.2), wall([90.0, 0.0], 6.0));
        assert_ne!(kind(&foot, (0, None)), kind(&eaves, (2, None)));
    }
}
