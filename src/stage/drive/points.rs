//! XYZ points as ties of the smoother: three directions each, or two where one is free.
//!
//! Whoever found a point, its ends become body vectors by the trajectory that the strips were made with, with what each constant of the calibration makes of them.

use std::collections::BTreeMap;

use anyhow::Result;
use nalgebra::{Matrix3, Vector3};
use tieline_filter::earth::{ecef_from_geodetic, ned_from_ecef};
use tieline_filter::{FilterTie, Pose, Sighting, TieFit, TieKind, Trajectory};
use tieline_io::crs::Crs;
use tieline_matching::xyz::{XyzEnd, XyzKind, XyzPoint};

use super::constants::{Beam, Constants};
use super::over::Target;
use super::spread::Spread;
use super::ties::{Class, VISIT_GAP_S};
use crate::job::Matched;

/// Least sum of redundancies that a factor is estimated from, and factors that are believed.
const LEAST_REDUNDANCY: f64 = 30.0;
const BELIEVED: std::ops::RangeInclusive<f64> = 0.25..=25.0;

/// One end of a point.
#[derive(Debug, Clone)]
pub struct PointEnd {
    /// Strip.
    pub strip: u32,
    /// Scanner.
    pub scanner: u16,
    /// From the scanner to the point \[m\].
    pub range_m: f64,
    /// Where the strips have it, map \[m\].
    pub map_m: Vector3<f64>,
    /// Body vector as the strips have it \[m\].
    pub delivered_m: Vector3<f64>,
    /// Points behind it.
    pub points: u32,
}

/// A point with all its sightings.
#[derive(Debug, Clone)]
pub struct PointTie {
    /// How it was found.
    pub found: XyzKind,
    /// Its name, where a person gave one.
    pub name: Option<String>,
    /// For the smoother; its directions are `held_map`, and covariances along them.
    pub tie: FilterTie,
    /// Unit vectors that it holds, map axes: east, north and up, or two at right angles to what is free.
    pub held_map: Vec<Vector3<f64>>,
    /// In the order of the sightings.
    pub ends: Vec<PointEnd>,
    /// Where it is known to be, map \[m\].
    pub known_map_m: Option<Vector3<f64>>,
    /// What it binds.
    pub class: Class,
}

impl PointTie {
    /// Whether its sightings are of several visits.
    #[must_use]
    pub fn is_loop(&self) -> bool {
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
    #[must_use]
    pub fn variance_m2(&self) -> f64 {
        let level = |k: &usize| self.held_map[*k].z.abs() < 0.7;
        let plan = |s: &Sighting| (0..self.rank()).filter(level).map(|k| s.covariance_m2[(k, k)]).fold(0.0, f64::max);
        self.tie.sightings.iter().map(plan).fold(0.0, f64::max)
    }

    /// First and last time \[s\].
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        span_s(&self.tie)
    }
}

fn span_s(tie: &FilterTie) -> (f64, f64) {
    let s = &tie.sightings;
    (s.first().map_or(0.0, |s| s.time_s), s.last().map_or(0.0, |s| s.time_s))
}

/// States that the smoother holds for some ties at one time, at most. Known points take none.
pub fn most_live<'a>(ties: impl Iterator<Item = &'a FilterTie>) -> usize {
    let mut changes: Vec<(f64, isize)> = ties
        .filter(|t| t.known_m.is_none())
        .flat_map(|tie| {
            let (first_s, last_s) = span_s(tie);
            let states = isize::try_from(tie.directions.len()).unwrap_or(3);
            [(first_s, states), (last_s, -states)]
        })
        .collect();
    changes.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let (mut now, mut most) = (0, 0);
    for (_, change) in changes {
        now += change;
        most = most.max(now);
    }
    usize::try_from(most).unwrap_or(0)
}

/// Ties of points, in their order; those without a pose at two ends, or at one where they are known, are left out. `clock_shift_s` leads from the strips' clock to the smoother's.
///
/// # Errors
/// When a place cannot be projected.
pub fn point_ties(
    matched: &Matched,
    points: &[XyzPoint],
    crs: &Crs,
    constants: &Constants,
    clock_shift_s: f64,
) -> Result<Vec<PointTie>> {
    let Some(trajectory) = matched.poses.shared() else { return Ok(Vec::new()) };
    let origin_m = matched.survey.origin();
    let mut ties = Vec::new();
    for point in points {
        let held_map = point.held();
        let mut seen: Vec<(PointEnd, Sighting, Pose)> = point
            .ends
            .iter()
            .filter_map(|end| sighted(&origin_m, trajectory, constants, (end, &held_map), clock_shift_s))
            .collect();
        seen.sort_by(|a, b| a.1.time_s.total_cmp(&b.1.time_s));
        let due = if point.known.is_some() { 1 } else { 2 };
        if seen.len() < due {
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
        let (ends, mut sightings): (Vec<PointEnd>, Vec<Sighting>) =
            seen.into_iter().map(|(end, sighting, _)| (end, sighting)).unzip();
        let id = ties.len() as u64;
        let mut kind = if held_map.len() == 3 { TieKind::XyzPoint } else { TieKind::Line };
        let (mut known_m, mut known_map_m) = (None, None);
        if let Some((place_m, covariance_m2)) = &point.known {
            kind = TieKind::Control;
            let map_m = place_m + origin_m;
            let ecef_m = ecef_from_geodetic(&crs.geodetic_from_map(&map_m)?);
            known_m = Some(directions.iter().map(|u| u.dot(&ecef_m)).collect());
            known_map_m = Some(map_m);
            // sightings are taken for independent: with n times the variance of what they share each, their mean has it once
            let shared_m2 = along(&held_map, covariance_m2) * f64::from(u32::try_from(sightings.len()).unwrap_or(1));
            sightings.iter_mut().for_each(|s| s.covariance_m2 += shared_m2);
        }
        let tie = FilterTie { id, kind, directions, sightings, known_m };
        ties.push(PointTie { found: point.kind, name: point.name.clone(), tie, held_map, ends, known_map_m, class });
    }
    Ok(ties)
}

/// A covariance along some directions, in the upper left of a matrix.
fn along(directions: &[Vector3<f64>], covariance_m2: &Matrix3<f64>) -> Matrix3<f64> {
    let of = |i: usize, j: usize| Some(directions.get(i)?.dot(&(covariance_m2 * directions.get(j)?)));
    Matrix3::from_fn(|i, j| of(i, j).unwrap_or(0.0))
}

/// An end as the smoother takes it.
fn sighted(
    origin_m: &Vector3<f64>,
    trajectory: &Trajectory,
    constants: &Constants,
    (end, held_map): (&XyzEnd, &[Vector3<f64>]),
    clock_shift_s: f64,
) -> Option<(PointEnd, Sighting, Pose)> {
    const STEP_S: f64 = 0.02;
    let map_m = end.place_m + origin_m;
    let pose = trajectory.pose_at(end.time_s)?;
    let (from, to) = (trajectory.pose_at(end.time_s - STEP_S)?, trajectory.pose_at(end.time_s + STEP_S)?);
    let velocity_ned_mps = from.ned_vector_m(&to.position) / (2.0 * STEP_S);
    let delivered = Beam {
        scanner: usize::from(end.scanner),
        body_vector_m: pose.body_vector_m(&map_m),
        velocity_body_mps: pose.ned_from_body.inverse_transform_vector(&velocity_ned_mps),
        rate_body_radps: (from.ned_from_body.inverse() * to.ned_from_body).scaled_axis() / (2.0 * STEP_S),
        patch: Spread::default(),
        target: Target {
            normal_body: pose.body_vector_m(&(pose.position + end.normal)).normalize(),
            intensity: end.intensity,
        },
    };
    let beam = constants.known_applied(&delivered);
    let range_m = constants.range_m(beam.scanner, &delivered.body_vector_m);
    let point = PointEnd {
        strip: end.strip,
        scanner: end.scanner,
        range_m,
        map_m,
        delivered_m: delivered.body_vector_m,
        points: end.points,
    };
    let sighting = Sighting {
        time_s: end.time_s + clock_shift_s,
        body_vector_m: beam.body_vector_m,
        covariance_m2: along(held_map, &end.covariance_m2),
        by_constant: constants.derivatives(&beam),
    };
    Some((point, sighting, pose))
}

/// What the variances of points turned out to be multiplied by, by how they were found; 1 for what is not in it.
pub type PointFactors = BTreeMap<XyzKind, f64>;

/// The factors after a solution that was made with those before; `points` stand from row `first` on among its ties. A person's sigmas stay as given.
#[must_use]
pub fn factors_after(fits: &[TieFit], first: usize, points: &[PointTie], before: &PointFactors) -> PointFactors {
    let mut sums: BTreeMap<XyzKind, (f64, f64)> = BTreeMap::new();
    for fit in fits {
        let Some(point) = fit.tie.checked_sub(first).and_then(|row| points.get(row)) else { continue };
        if point.found != XyzKind::Picked {
            let (squared, redundancy) = sums.entry(point.found).or_default();
            *squared += fit.squared;
            *redundancy += fit.redundancy;
        }
    }
    let mut factors = before.clone();
    for (kind, (squared, redundancy)) in sums.into_iter().filter(|(_, s)| s.1 >= LEAST_REDUNDANCY) {
        let factor = factors.entry(kind).or_insert(1.0);
        *factor = (*factor * squared / redundancy).clamp(*BELIEVED.start(), *BELIEVED.end());
    }
    factors
}
