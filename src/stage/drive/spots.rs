//! Spots of pavement as ties of the smoother: three directions each, or two where one along the ground is not held.
//!
//! All matches of one spot share its first sighting: those that hold all directions become one tie with all their ends, those that leave the same one free another. Like lines, spots a moment apart tell nearly the same
//! of the trajectory; of each class the most precise stay, as far apart in time as it takes.

use std::collections::BTreeMap;

use anyhow::Result;
use nalgebra::{Matrix3, Vector3};
use tieline_filter::earth::ned_from_ecef;
use tieline_filter::{FilterTie, Pose, Sighting, TieFit, TieKind, Trajectory};
use tieline_io::crs::Crs;
use tieline_matching::xyz::texture::{SpotEnd, SpotTie};

use super::constants::{Beam, Constants};
use super::over::Target;
use super::spread::Spread;
use super::ties::{Class, VISIT_GAP_S};
use crate::job::Matched;

/// States that the smoother holds for spots, beside those for lines: of several visits, and of one.
const LIVE: [usize; 2] = [60, 24];
/// States for spots in all.
pub const MOST_LIVE: usize = LIVE[0] + LIVE[1];
/// Least sum of redundancies that a factor is estimated from, and factors that are believed.
const LEAST_REDUNDANCY: f64 = 30.0;
const BELIEVED: std::ops::RangeInclusive<f64> = 0.25..=25.0;

/// One end of a spot.
#[derive(Debug, Clone)]
pub struct PointEnd {
    /// Strip.
    pub strip: u32,
    /// Scanner.
    pub scanner: u16,
    /// From the scanner to the spot \[m\].
    pub range_m: f64,
    /// Where the strips have it, map \[m\].
    pub map_m: Vector3<f64>,
    /// Body vector as the strips have it \[m\].
    pub delivered_m: Vector3<f64>,
    /// Points behind it.
    pub points: u32,
}

/// A spot with all its sightings.
#[derive(Debug, Clone)]
pub struct PointTie {
    /// For the smoother; its directions are `held_map`, and covariances along them.
    pub tie: FilterTie,
    /// Unit vectors that it holds, map axes: east, north and up, or across the free direction and up from the ground.
    pub held_map: Vec<Vector3<f64>>,
    /// In the order of the sightings.
    pub ends: Vec<PointEnd>,
    /// What it binds.
    pub class: Class,
}

impl PointTie {
    /// Whether its sightings are of several visits.
    fn is_loop(&self) -> bool {
        self.class != Class::ScannerToScanner
    }

    /// Directions that it holds.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.held_map.len()
    }

    /// Covariance of an end in map axes; nothing along what is not held \[m²\].
    #[must_use]
    pub fn covariance_map_m2(&self, sighting: &Sighting) -> Matrix3<f64> {
        let of = |i: usize, j: usize| self.held_map[i] * self.held_map[j].transpose() * sighting.covariance_m2[(i, j)];
        (0..self.rank()).flat_map(|i| (0..self.rank()).map(move |j| (i, j))).map(|(i, j)| of(i, j)).sum()
    }

    /// Largest variance of an end in plan \[m²\].
    fn variance_m2(&self) -> f64 {
        // the last direction is up
        let plan = |s: &Sighting| (0..self.rank() - 1).map(|k| s.covariance_m2[(k, k)]).fold(0.0, f64::max);
        self.tie.sightings.iter().map(plan).fold(0.0, f64::max)
    }

    fn span_s(&self) -> (f64, f64) {
        let s = &self.tie.sightings;
        (s.first().map_or(0.0, |s| s.time_s), s.last().map_or(0.0, |s| s.time_s))
    }
}

/// Ties of the accepted spots, variances times `factor`; numbers count from `first_id`, `clock_shift_s` leads from the strips' clock to the
/// smoother's.
///
/// # Errors
/// When a place cannot be projected.
pub fn point_ties(
    matched: &Matched,
    crs: &Crs,
    constants: &Constants,
    clock_shift_s: f64,
    factor: f64,
) -> Result<Vec<PointTie>> {
    let Some(trajectory) = matched.poses.shared() else { return Ok(Vec::new()) };
    let mut by_spot: BTreeMap<u32, Vec<&SpotTie>> = BTreeMap::new();
    for spot in matched.spots.iter().filter(|s| s.rejection.is_none()) {
        by_spot.entry(spot.spot).or_default().push(spot);
    }
    let mut ties = Vec::new();
    for matches in by_spot.values().flat_map(|of_spot| alike(of_spot)) {
        // half of a match's covariance each; the first end is shared and has that of the worst
        let held_map = matches[0].held();
        let half = |m: &SpotTie| along(&held_map, &m.covariance_m2) * (0.5 * factor);
        let Some(worst) = matches.iter().max_by(|a, b| a.covariance_m2.trace().total_cmp(&b.covariance_m2.trace()))
        else {
            continue;
        };
        let first = [(&matches[0].ends[0], half(worst))];
        let ends = first.into_iter().chain(matches.iter().map(|m| (&m.ends[1], half(m))));
        let mut seen: Vec<(PointEnd, Sighting, Pose)> = ends
            .filter_map(|(end, covariance_m2)| {
                sighted(matched, trajectory, constants, (end, covariance_m2), clock_shift_s)
            })
            .collect();
        seen.sort_by(|a, b| a.1.time_s.total_cmp(&b.1.time_s));
        if seen.len() < 2 {
            continue;
        }
        let pose = seen[0].2;
        let geodetic = crs.geodetic_from_map(&pose.position)?;
        let ecef_from_ned = ned_from_ecef(geodetic.x, geodetic.y).transpose();
        let direction = |axis: Vector3<f64>| ecef_from_ned * pose.ned_vector_m(&(pose.position + axis)).normalize();
        let directions: Vec<Vector3<f64>> = held_map.iter().map(|d| direction(*d)).collect();
        let strips = seen.iter().any(|s| s.0.strip != seen[0].0.strip);
        let visits = seen[seen.len() - 1].1.time_s - seen[0].1.time_s > VISIT_GAP_S;
        let class = match (strips, visits) {
            (true, _) => Class::StripToStrip,
            (false, true) => Class::PassToPass,
            (false, false) => Class::ScannerToScanner,
        };
        let (ends, sightings) = seen.into_iter().map(|(end, sighting, _)| (end, sighting)).unzip();
        let id = ties.len() as u64;
        let kind = if held_map.len() == 3 { TieKind::XyzPoint } else { TieKind::Line };
        let tie = FilterTie { id, kind, directions, sightings, known_m: None };
        ties.push(PointTie { tie, held_map, ends, class });
    }
    Ok(ties)
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

/// A covariance along some directions, in the upper left of a matrix.
fn along(directions: &[Vector3<f64>], covariance_m2: &Matrix3<f64>) -> Matrix3<f64> {
    let of = |i: usize, j: usize| Some(directions.get(i)?.dot(&(covariance_m2 * directions.get(j)?)));
    Matrix3::from_fn(|i, j| of(i, j).unwrap_or(0.0))
}

/// An end as the smoother takes it.
fn sighted(
    matched: &Matched,
    trajectory: &Trajectory,
    constants: &Constants,
    (end, covariance_m2): (&SpotEnd, Matrix3<f64>),
    clock_shift_s: f64,
) -> Option<(PointEnd, Sighting, Pose)> {
    const STEP_S: f64 = 0.02;
    let (strip, scanner) = matched.strips.find(end.source, end.time_s)?;
    let map_m = end.place_m + matched.survey.origin();
    let pose = trajectory.pose_at(end.time_s)?;
    let (from, to) = (trajectory.pose_at(end.time_s - STEP_S)?, trajectory.pose_at(end.time_s + STEP_S)?);
    let velocity_ned_mps = from.ned_vector_m(&to.position) / (2.0 * STEP_S);
    let delivered = Beam {
        scanner: usize::from(scanner),
        body_vector_m: pose.body_vector_m(&map_m),
        velocity_body_mps: pose.ned_from_body.inverse_transform_vector(&velocity_ned_mps),
        rate_body_radps: (from.ned_from_body.inverse() * to.ned_from_body).scaled_axis() / (2.0 * STEP_S),
        patch: Spread::default(),
        // pavement is level but for its slope
        target: Target {
            normal_body: pose.body_vector_m(&(pose.position + Vector3::z())).normalize(),
            intensity: end.intensity,
        },
    };
    let beam = constants.known_applied(&delivered);
    let range_m = constants.range_m(beam.scanner, &delivered.body_vector_m);
    let point = PointEnd { strip, scanner, range_m, map_m, delivered_m: delivered.body_vector_m, points: end.points };
    let sighting = Sighting {
        time_s: end.time_s + clock_shift_s,
        body_vector_m: beam.body_vector_m,
        covariance_m2,
        by_constant: constants.derivatives(&beam),
    };
    Some((point, sighting, pose))
}

/// What there is to say of spots, all and those for the smoother, with the factor of their variances.
#[must_use]
pub fn note((all, taken): &(Vec<PointTie>, Vec<PointTie>), factor: f64) -> Option<String> {
    (!taken.is_empty()).then(|| {
        format!(
            "{} of {} spots of pavement went to the smoother, {} of them without one direction; their sigmas, as they turned out over as measured: {:.2}",
            taken.len(),
            all.len(),
            taken.iter().filter(|t| t.rank() == 2).count(),
            factor.sqrt()
        )
    })
}

/// Those that hold all directions before those that do not, and the most precise of either, so far apart in time that the smoother holds them all; numbers count from `first_id`.
#[must_use]
pub fn thinned(ties: &[PointTie], first_id: u64) -> Vec<PointTie> {
    let mut kept: Vec<usize> = [true, false]
        .into_iter()
        .zip(LIVE)
        .flat_map(|(is_loop, live)| {
            let mut order: Vec<usize> = (0..ties.len()).filter(|k| ties[*k].is_loop() == is_loop).collect();
            order.sort_by(|a, b| {
                let (a_tie, b_tie) = (&ties[*a], &ties[*b]);
                let by_rank = b_tie.rank().cmp(&a_tie.rank());
                by_rank.then(a_tie.variance_m2().total_cmp(&b_tie.variance_m2())).then(a.cmp(b))
            });
            spaced(ties, &order, live)
        })
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
        let mut changes: Vec<(f64, i64)> = kept
            .iter()
            .flat_map(|k| {
                let (first_s, last_s) = ties[*k].span_s();
                let states = if ties[*k].rank() == 3 { 3 } else { 2 };
                [(first_s, states), (last_s, -states)]
            })
            .collect();
        changes.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (mut now, mut most) = (0, 0);
        for (_, change) in changes {
            now += change;
            most = most.max(now);
        }
        if most <= i64::try_from(live).unwrap_or(i64::MAX) || spacing_s > 100.0 {
            return kept;
        }
        spacing_s *= 1.3;
    }
}

/// The factor of the variances after a solution that was made with another; ties of spots stand from row `first` on.
#[must_use]
pub fn factor_after(fits: &[TieFit], first: usize, factor: f64) -> f64 {
    let of_spots = fits.iter().filter(|f| f.tie >= first);
    let (squared, redundancy) = of_spots.fold((0.0, 0.0), |(s, r), f| (s + f.squared, r + f.redundancy));
    if redundancy < LEAST_REDUNDANCY {
        return factor;
    }
    (factor * squared / redundancy).clamp(*BELIEVED.start(), *BELIEVED.end())
}
