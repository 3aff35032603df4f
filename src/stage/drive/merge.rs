//! Many like ties as one.
//!
//! Lines of like direction that the same scanners saw at nearly the same moments tell the smoother one thing: how far its trajectory
//! went wrong between those moments, and what the calibration adds. Instead of one of them it gets their weighted mean, with the sigma of a
//! mean. With weights w, normals n and places X of the ends by the trajectory that the strips were made with, the mean says
//! `Σ w nᵀ(X_e - X_0) / Σ w` for each end e; its body vectors are those that say so at the mean times, and its derivatives are the
//! means of theirs. What varies within a cluster (half a second at most) is the change of the trajectory's error, of
//! second order in time.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use tieline_filter::{FilterTie, Pose, Sighting, TieKind, Trajectory};

use crate::project::SurfaceWord;

use super::ties::{DriveLine, End, direction_body};

/// Normals of one cluster differ by less than this (cosine of 3°).
const LIKE_DIRECTION: f64 = 0.998_63;
/// Heights of walls in one cluster differ by less than this \[m\].
pub(super) const LIKE_HEIGHT_M: f64 = 2.5;
/// A line whose ends differ from the others' median by more than so many of its standard deviations, and by more than
/// [`ASTRAY_M`] on top, is a false one.
const ASTRAY: f64 = 4.0;
/// What calibration and trajectory may change within a cluster \[m\].
const ASTRAY_M: f64 = 0.003;

/// A line, or one visit of it, that is to become a tie or a part of one.
pub type Part = (usize, Option<usize>);

/// The ends of a part.
pub fn ends(line: &DriveLine, visit: Option<usize>) -> impl Iterator<Item = &End> {
    line.ends.iter().filter(move |e| visit.is_none_or(|v| e.visit == v))
}

/// Whether two parts were seen by the same scanners in the same order, on surfaces of like direction, those that stand at like heights: a mean over foot and
/// eaves would not say any more how a scanner leans.
#[must_use]
pub fn are_like(lines: &[DriveLine], a: Part, b: Part) -> bool {
    let (of_a, of_b) = (&lines[a.0], &lines[b.0]);
    let who = |(line, visit): Part| {
        let first = ends(&lines[line], visit).next().map_or(0, |e| e.visit);
        ends(&lines[line], visit).map(move |e| (e.strip, e.scanner, e.visit - first))
    };
    let height_m = |(line, visit): Part| ends(&lines[line], visit).next().map_or(0.0, |e| e.delivered_m.z);
    let is_level = SurfaceWord::of(of_a.normal_up) == SurfaceWord::Level;
    let is_beside = is_level || (height_m(a) - height_m(b)).abs() < LIKE_HEIGHT_M;
    of_a.normal_map.dot(&of_b.normal_map) > LIKE_DIRECTION && is_beside && who(a).eq(who(b))
}

/// The ends of a part by the trajectory that the strips were made with.
struct Seen<'a> {
    line: &'a DriveLine,
    ends: Vec<(&'a End, Pose, Vector3<f64>)>,
    /// One over the mean variance of its ends \[1/m²\].
    weight: f64,
}

impl<'a> Seen<'a> {
    fn new(line: &'a DriveLine, visit: Option<usize>, at: &impl Fn(f64) -> Option<Pose>) -> Option<Self> {
        let mut seen = Vec::new();
        let mut variance_m2 = 0.0;
        for end in ends(line, visit) {
            let pose = at(end.sighting.time_s)?;
            let place_m = pose.position + pose.map_from_ned * (pose.ned_from_body * end.sighting.body_vector_m);
            variance_m2 += end.sighting.covariance_m2[(0, 0)];
            seen.push((end, pose, place_m));
        }
        let weight = seen.len() as f64 / variance_m2;
        (!seen.is_empty() && weight.is_finite()).then_some(Self { line, ends: seen, weight })
    }

    /// How far an end lies from the first along the normal \[m\].
    fn apart_m(&self, end: usize) -> f64 {
        self.line.normal_map.dot(&(self.ends[end].2 - self.ends[0].2))
    }

    /// Standard deviation of that \[m\].
    fn sigma_m(&self, end: usize) -> f64 {
        let variance = |k: usize| self.ends[k].0.sighting.covariance_m2[(0, 0)];
        (variance(0) + variance(end)).sqrt()
    }
}

/// Leaves out lines that say something else than most of the cluster.
fn without_strays(mut seen: Vec<Seen<'_>>) -> Vec<Seen<'_>> {
    if seen.len() < 3 {
        // two that contradict each other: the first of them, which is the most precise
        let astray = seen.len() == 2
            && (1..seen[0].ends.len()).any(|e| {
                let sigma_m = seen[0].sigma_m(e).hypot(seen[1].sigma_m(e));
                (seen[0].apart_m(e) - seen[1].apart_m(e)).abs() > ASTRAY * sigma_m + ASTRAY_M
            });
        if astray {
            seen.truncate(1);
        }
        return seen;
    }
    for end in 1..seen[0].ends.len() {
        let mut apart: Vec<f64> = seen.iter().map(|s| s.apart_m(end)).collect();
        apart.sort_by(f64::total_cmp);
        let middle_m = apart[apart.len() / 2];
        seen.retain(|s| (s.apart_m(end) - middle_m).abs() <= ASTRAY * s.sigma_m(end) + ASTRAY_M);
        if seen.len() < 3 {
            break;
        }
    }
    seen
}

/// One tie of many parts that are like the first; `None` where the trajectory does not reach. `clock_shift_s` leads from the strips' clock
/// to the smoother's. Gives the parts that it was made of as well.
#[must_use]
pub fn merged(
    lines: &[DriveLine],
    parts: &[Part],
    trajectory: &Trajectory,
    clock_shift_s: f64,
    id: u64,
    kind: TieKind,
) -> Option<(FilterTie, Vec<Part>)> {
    let at = |time_s: f64| trajectory.pose_at(time_s - clock_shift_s);
    let &(first, visit) = parts.first()?;
    let alone = || (lines[first].tie(id, kind, |e| visit.is_none_or(|v| e.visit == v)), vec![parts[0]]);
    if parts.len() == 1 {
        return Some(alone());
    }
    let seen: Option<Vec<Seen<'_>>> = parts.iter().map(|(l, v)| Seen::new(&lines[*l], *v, &at)).collect();
    let seen = without_strays(seen?);
    if seen.len() < 2 {
        return Some(alone());
    }
    let of = |s: &Seen<'_>| parts.iter().copied().find(|(l, _)| std::ptr::eq(&raw const lines[*l], s.line));
    let taken = seen.iter().filter_map(of).collect();
    let sum: f64 = seen.iter().map(|s| s.weight).sum();
    let mean = |value: &dyn Fn(&Seen<'_>) -> Vector3<f64>| -> Vector3<f64> {
        seen.iter().map(|s| value(s) * (s.weight / sum)).sum()
    };
    let direction = mean(&|s| s.line.direction).normalize();
    let normal = mean(&|s| s.line.normal_map).normalize();
    let origin_m = mean(&|s| s.ends[0].2);
    let mut sightings = Vec::new();
    for end in 0..seen[0].ends.len() {
        let share = |s: &Seen<'_>| s.weight / sum;
        let time_s: f64 = seen.iter().map(|s| share(s) * s.ends[end].0.sighting.time_s).sum();
        let apart_m: f64 = seen.iter().map(|s| share(s) * s.apart_m(end)).sum();
        let place_m = mean(&|s| s.ends[end].2);
        let place_m = place_m + normal * (apart_m - normal.dot(&(place_m - origin_m)));
        let pose = at(time_s)?;
        let variance_m2: f64 =
            seen.iter().map(|s| share(s).powi(2) * s.ends[end].0.sighting.covariance_m2[(0, 0)]).sum();
        let mut by_constant: BTreeMap<usize, f64> = BTreeMap::new();
        for s in &seen {
            let (of_end, pose, _) = &s.ends[end];
            let own = direction_body(pose, &s.line.normal_map);
            for (constant, by) in &of_end.sighting.by_constant {
                *by_constant.entry(*constant).or_default() += share(s) * own.dot(by);
            }
        }
        let own = direction_body(&pose, &normal);
        sightings.push(Sighting {
            time_s,
            body_vector_m: pose.body_vector_m(&place_m),
            covariance_m2: Matrix3::from_diagonal_element(variance_m2),
            by_constant: by_constant.into_iter().map(|(constant, by)| (constant, own * by)).collect(),
        });
    }
    Some((FilterTie { id, kind, directions: vec![direction], sightings, known_m: None }, taken))
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use tieline_filter::PositionFrame;

    use super::*;

    /// A drive that turns slowly; `error` of a smooth drift in position and attitude.
    fn drive(error: f64) -> Trajectory {
        let time_s: Vec<f64> = (0..4000).map(|k| 0.005 * f64::from(k)).collect();
        let place = |t: f64| {
            let drift = error * Vector3::new(0.05 * t, 0.002 * t * t, 0.03 * (0.4 * t).sin());
            Vector3::new(10.0 * t, 0.2 * t * t, 0.0) + drift
        };
        let turn = |t: f64| UnitQuaternion::from_euler_angles(error * 1e-4 * t, error * 1e-4, 1.5 - 0.04 * t);
        let (position, attitude) =
            (time_s.iter().map(|t| place(*t)).collect(), time_s.iter().map(|t| turn(*t)).collect());
        Trajectory::new(PositionFrame::Map, time_s, position, attitude, Vec::new()).expect("a trajectory")
    }

    fn line(row: usize, normal: Vector3<f64>, wrong_m: f64) -> DriveLine {
        let trajectory = drive(0.0);
        let k = row as f64;
        let ends = [(0_u16, 8.0 + 0.05 * k, 1e-6), (1, 10.4 + 0.06 * k, 2e-6 + 1e-7 * k)];
        let ends = ends.into_iter().enumerate().map(|(number, (scanner, time_s, variance_m2))| {
            let pose = trajectory.pose_at(time_s).expect("a pose");
            let off_m = if number == 0 { 0.0005 * k } else { wrong_m - 0.0003 * k };
            let feature_m = Vector3::new(95.0 + 0.3 * k, 12.0 - 0.2 * k, -2.0) + normal * off_m;
            let body_vector_m = pose.body_vector_m(&feature_m);
            let by_constant =
                vec![(usize::from(scanner), Vector3::new(0.1 * k, 1.0, -2.0)), (5, body_vector_m.normalize())];
            End {
                number,
                strip: 0,
                scanner,
                range_m: 5.0,
                visit: 0,
                position_sigma_m: 0.01,
                delivered_m: body_vector_m,
                normal_body: normal,
                measured_variance_m2: variance_m2,
                sighting: Sighting {
                    time_s,
                    body_vector_m,
                    covariance_m2: Matrix3::from_diagonal_element(variance_m2),
                    by_constant,
                },
            }
        });
        DriveLine {
            row,
            direction: normal,
            normal_map: normal,
            point_map_m: Vector3::zeros(),
            normal_up: normal.z,
            ends: ends.collect(),
            held_out: false,
        }
    }

    /// Level surfaces that lean by half a degree one way or the other.
    fn lines(wrong_m: f64) -> Vec<DriveLine> {
        (0..5)
            .map(|k| {
                let lean = if k % 2 == 0 { 0.009 } else { -0.006 };
                line(k, Vector3::new(lean, 0.5 * lean, 1.0).normalize(), if k == 3 { wrong_m } else { 0.0 })
            })
            .collect()
    }

    /// Last sighting less first along a direction, with constants.
    fn apart_m(trajectory: &Trajectory, normal: &Vector3<f64>, sightings: &[Sighting], constants: &[f64]) -> f64 {
        let place = |s: &Sighting| {
            let pose = trajectory.pose_at(s.time_s).expect("a pose");
            pose.position + pose.map_from_ned * (pose.ned_from_body * s.calibrated(constants).body_vector_m)
        };
        normal.dot(&(place(&sightings[1]) - place(&sightings[0])))
    }

    #[test]
    fn a_mean_says_what_its_lines_say_by_any_trajectory_and_calibration() {
        let lines = lines(0.0);
        let parts: Vec<Part> = (0..5).map(|k| (k, Some(0))).collect();
        assert!(parts.iter().all(|p| are_like(&lines, parts[0], *p)));
        let (tie, of) = merged(&lines, &parts, &drive(0.0), 0.0, 7, TieKind::Increment).expect("a tie");
        assert_eq!((of.len(), tie.sightings.len()), (5, 2));
        let weights: Vec<f64> =
            lines.iter().map(|l| 1.0 / l.ends.iter().map(|e| e.sighting.covariance_m2[(0, 0)]).sum::<f64>()).collect();
        let sum: f64 = weights.iter().sum();
        let variance: f64 = tie.sightings.iter().map(|s| s.covariance_m2[(0, 0)]).sum();
        assert!((variance * sum - 1.0).abs() < 1e-9, "the variance of a weighted mean");
        let none = [0.0; 6];
        for (error, constants, least_m) in
            [(0.0, none, 1e-9), (1.0, none, 2e-5), (0.0, [1e-3, -2e-3, 0.0, 0.0, 0.0, 4e-3], 1e-7)]
        {
            let trajectory = drive(error);
            let mean: f64 = lines
                .iter()
                .zip(&weights)
                .map(|(l, w)| {
                    let sightings: Vec<Sighting> = l.ends.iter().map(|e| e.sighting.clone()).collect();
                    w / sum * apart_m(&trajectory, &l.normal_map, &sightings, &constants)
                })
                .sum();
            let found = apart_m(&trajectory, &tie.directions[0], &tie.sightings, &constants);
            assert!((found - mean).abs() < least_m, "error {error}: {found} {mean}");
            assert!(error == 0.0 || mean.abs() > 0.01, "the drift is to be seen: {mean}");
        }
    }

    #[test]
    fn a_false_line_stays_out_of_the_mean() {
        let lines = lines(0.2);
        let parts: Vec<Part> = (0..5).map(|k| (k, Some(0))).collect();
        let (tie, of) = merged(&lines, &parts, &drive(0.0), 0.0, 0, TieKind::Increment).expect("a tie");
        assert_eq!(of.iter().map(|p| p.0).collect::<Vec<_>>(), [0, 1, 2, 4]);
        assert!(apart_m(&drive(0.0), &tie.directions[0], &tie.sightings, &[]).abs() < 0.005);
        // two that contradict each other: the first
        let (_, of) = merged(&lines, &[parts[1], parts[3]], &drive(0.0), 0.0, 0, TieKind::Increment).expect("a tie");
        assert_eq!(of, [(1, Some(0))]);
    }

    #[test]
    fn other_scanners_and_other_directions_are_not_like() {
        let mut lines = lines(0.0);
        lines[1].ends.reverse();
        lines[2].normal_map = Vector3::new(0.1, 0.0, 1.0).normalize();
        assert!(!are_like(&lines, (0, Some(0)), (1, Some(0))) && !are_like(&lines, (0, Some(0)), (2, Some(0))));
    }
}
