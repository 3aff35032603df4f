//! Surface lines of a drive as the smoother takes them.
//!
//! Ends of one visit, a moment apart, are *increments*: they bind the trajectory to itself over that moment, and the scanners to each other.
//! Ends of several visits are *loop ties*: they bind visits to each other. A line with both gives one loop tie with all its ends,
//! or one increment a visit.

use anyhow::{Context, Result};
use nalgebra::{Matrix3, Vector3};
use tieline_filter::earth::ned_from_ecef;
use tieline_filter::{FilterTie, Pose, Sighting, TieKind, Trajectory};
use tieline_io::crs::Crs;
use tieline_matching::{Patch, measure};

use super::again::MeasuredAgain;
use super::constants::{Beam, Constants, Spread};
use super::motion::Motion;
use super::over::{Over, Target};
use super::seen::Seen;
use crate::job::Matched;
use crate::project::SurfaceWord;

pub use tieline_filter::TieClass as Class;

/// Sightings further apart than this are of different visits \[s\].
pub const VISIT_GAP_S: f64 = 8.0;

/// One end of a line, ready for the smoother.
#[derive(Debug, Clone)]
pub struct End {
    /// Row of the line's ends.
    pub number: usize,
    /// Strip.
    pub strip: u32,
    /// Scanner.
    pub scanner: u16,
    /// From the scanner to the feature \[m\].
    pub range_m: f64,
    /// Which visit, from 0.
    pub visit: usize,
    /// Standard deviation of the position by the trajectory that the strips were made with \[m\]; 0 when it is not stated.
    pub position_sigma_m: f64,
    /// Body vector as the strips have it \[m\].
    pub delivered_m: Vector3<f64>,
    /// Unit normal of the surface, body axes.
    pub normal_body: Vector3<f64>,
    /// Variance along the normal as measured \[m²\]; the sighting has it times the factor of its kind.
    pub measured_variance_m2: f64,
    /// For the smoother, what is known of the scanner in its body vector.
    pub sighting: Sighting,
}

/// A line whose ends have poses.
#[derive(Debug, Clone)]
pub struct DriveLine {
    /// Row of the line among those matched.
    pub row: usize,
    /// Unit normal, earth-centred axes.
    pub direction: Vector3<f64>,
    /// Unit normal, map axes: up, of steep surfaces towards the vehicle at the first end.
    pub normal_map: Vector3<f64>,
    /// A point of the surface, map \[m\].
    pub point_map_m: Vector3<f64>,
    /// Height of the normal: 1 for level ground.
    pub normal_up: f64,
    /// Ends, in order of time.
    pub ends: Vec<End>,
    /// Whether it judges the solution instead of making it.
    pub held_out: bool,
}

impl DriveLine {
    /// Visits that see it.
    #[must_use]
    pub fn visits(&self) -> usize {
        self.ends.last().map_or(0, |e| e.visit + 1)
    }

    /// What it binds.
    #[must_use]
    pub fn class(&self) -> Class {
        self.class_of(|_| true)
    }

    /// What the tie of some of its ends binds.
    #[must_use]
    pub fn class_of(&self, ends: impl Fn(&End) -> bool) -> Class {
        let mut ends = self.ends.iter().filter(|e| ends(e));
        let Some(first) = ends.next() else { return Class::ScannerToScanner };
        let (mut visits, mut strips) = (false, false);
        for end in ends {
            visits |= end.visit != first.visit;
            strips |= end.strip != first.strip;
        }
        match (strips, visits) {
            (true, _) => Class::StripToStrip,
            (false, true) => Class::PassToPass,
            (false, false) => Class::ScannerToScanner,
        }
    }

    /// The tie of some of its ends.
    #[must_use]
    pub fn tie(&self, id: u64, kind: TieKind, ends: impl Fn(&End) -> bool) -> FilterTie {
        let sightings = self.ends.iter().filter(|e| ends(e)).map(|e| e.sighting.clone()).collect();
        FilterTie { id, kind, directions: vec![self.direction], sightings, known_m: None }
    }
}

/// Lines as they were seen, whatever constants are estimated.
#[derive(Debug)]
pub struct Sighted {
    /// With body vectors as the strips have them, and no derivatives.
    lines: Vec<DriveLine>,
    /// Of each end of each line.
    beams: Vec<Vec<Beam>>,
}

impl Sighted {
    /// The lines for the smoother: what is known of the scanners in their body vectors, and what these change by with each constant.
    #[must_use]
    pub fn lines(&self, constants: &Constants) -> Vec<DriveLine> {
        let mut lines = self.lines.clone();
        for (line, beams) in lines.iter_mut().zip(&self.beams) {
            for (end, delivered) in line.ends.iter_mut().zip(beams) {
                let beam = constants.known_applied(delivered);
                end.sighting.body_vector_m = beam.body_vector_m;
                end.sighting.by_constant = constants.derivatives(&beam);
            }
        }
        lines
    }

    /// Where the ends of a scanner lie on the scale of what a correction is over.
    #[must_use]
    pub fn seen(&self, scanner: usize, over: Over, constants: &Constants) -> Seen {
        let of_scanner = self.beams.iter().flatten().filter(|b| b.scanner == scanner);
        let place = |b: &Beam| over.place(&b.target, &(b.body_vector_m - constants.lever_arm_m(scanner)));
        Seen::new(scanner, over, of_scanner.map(place).collect())
    }

    /// Without anything known.
    #[must_use]
    pub fn delivered(&self) -> &[DriveLine] {
        &self.lines
    }
}

/// Lines of the survey with their ends as seen from the trajectory that the strips were made with; `clock_shift_s` leads from
/// the strips' clock to the smoother's. Lines that were measured again have their features where the corrected cloud has them, taken back along
/// the motion of each patch: of either trajectory nothing is left in a body vector.
///
/// # Errors
/// When a place cannot be projected.
pub fn sighted(
    matched: &Matched,
    again: Option<&MeasuredAgain>,
    crs: &Crs,
    constants: &Constants,
    clock_shift_s: f64,
) -> Result<Sighted> {
    let trajectory = matched.poses.shared().context("a drive needs its trajectory: [trajectory]")?;
    let origin_m = matched.survey.origin();
    let ties = again.map_or(&matched.ties, |a| &a.ties);
    let (mut lines, mut beams) = (Vec::new(), Vec::new());
    for (row, held_out) in ties.selected.iter().zip(&ties.held_out) {
        let used: Vec<(usize, &Patch)> = ties.lines[*row].used().collect();
        let motions: Option<Vec<&Motion>> = again.map(|a| used.iter().map(|(n, _)| &a.motions[*row][*n]).collect());
        let patches: Vec<Patch> = match &motions {
            Some(motions) => used.iter().zip(motions).map(|((_, p), motion)| motion.patch(p)).collect(),
            None => used.iter().map(|(_, p)| (*p).clone()).collect(),
        };
        let Some(measured) = measure(&patches.iter().collect::<Vec<_>>(), matched.sigma_floor_m) else { continue };
        let seen = used.iter().enumerate().filter_map(|(k, (number, patch))| {
            let feature_m = measured.point_m + measured.normal * measured.offsets[k].0;
            let feature_m = origin_m + motions.as_ref().map_or(feature_m, |m| m[k].back(&feature_m));
            let (pose, beam) = beam_of(trajectory, constants, patch, &(patch.centroid_m + origin_m), &feature_m)?;
            Some((*number, *patch, measured.offsets[k].1, pose, beam))
        });
        let mut seen: Vec<_> = seen.collect();
        seen.sort_by(|a, b| a.3.time_s.total_cmp(&b.3.time_s));
        let Some(pose) = seen.first().map(|s| s.3).filter(|_| seen.len() >= 2) else { continue };
        // a wall's normal leads towards the vehicle: by its own height its sign would be chance, and like lines not be alike
        let away = SurfaceWord::of(measured.normal.z) == SurfaceWord::Steep
            && measured.normal.dot(&(measured.point_m + origin_m - pose.position)) > 0.0;
        let normal_map = if away { -measured.normal } else { measured.normal };
        let mut ends: Vec<End> = Vec::new();
        let mut of_line = Vec::new();
        for (number, patch, sigma_m, seen_from, delivered) in seen {
            let time_s = seen_from.time_s;
            let visit = ends
                .last()
                .map_or(0, |e| e.visit + usize::from(time_s + clock_shift_s - e.sighting.time_s > VISIT_GAP_S));
            ends.push(End {
                number,
                strip: patch.sighting.strip,
                scanner: patch.sighting.scanner,
                range_m: constants.range_m(delivered.scanner, &delivered.body_vector_m),
                visit,
                delivered_m: delivered.body_vector_m,
                normal_body: direction_body(&seen_from, &normal_map),
                position_sigma_m: trajectory.sigma_at(time_s).map_or(0.0, |s| s.position_ned_m.norm()),
                measured_variance_m2: sigma_m.powi(2),
                sighting: Sighting {
                    time_s: time_s + clock_shift_s,
                    body_vector_m: delivered.body_vector_m,
                    covariance_m2: Matrix3::from_diagonal_element(sigma_m.powi(2)),
                    by_constant: Vec::new(),
                },
            });
            of_line.push(delivered);
        }
        let geodetic = crs.geodetic_from_map(&pose.position)?;
        let normal_ned = pose.ned_vector_m(&(pose.position + normal_map)).normalize();
        beams.push(of_line);
        lines.push(DriveLine {
            row: *row,
            direction: ned_from_ecef(geodetic.x, geodetic.y).transpose() * normal_ned,
            normal_map,
            point_map_m: measured.point_m + origin_m,
            normal_up: normal_map.z,
            ends,
            held_out: *held_out,
        });
    }
    Ok(Sighted { lines, beams })
}

/// A unit vector of the map in body axes.
pub(super) fn direction_body(pose: &Pose, direction_map: &Vector3<f64>) -> Vector3<f64> {
    pose.body_vector_m(&(pose.position + direction_map)).normalize()
}

/// How an end was seen: pose and beam at the moment when its feature was measured, which is where its plane meets the common normal.
pub(super) fn beam_of(
    trajectory: &Trajectory,
    constants: &Constants,
    patch: &Patch,
    centroid_m: &Vector3<f64>,
    feature_m: &Vector3<f64>,
) -> Option<(Pose, Beam)> {
    let scanner = usize::from(patch.sighting.scanner);
    let at = |time_s: f64| -> Option<(Pose, Beam)> {
        const STEP_S: f64 = 0.02;
        let pose = trajectory.pose_at(time_s)?;
        let (first_s, last_s) = trajectory.span_s();
        let (from, to) =
            (trajectory.pose_at((time_s - STEP_S).max(first_s))?, trajectory.pose_at((time_s + STEP_S).min(last_s))?);
        let step_s = to.time_s - from.time_s;
        let velocity_ned_mps = (from.ned_vector_m(&to.position)) / step_s;
        let turned = from.ned_from_body.inverse() * to.ned_from_body;
        let beam = Beam {
            scanner,
            body_vector_m: pose.body_vector_m(feature_m),
            velocity_body_mps: pose.ned_from_body.inverse_transform_vector(&velocity_ned_mps),
            rate_body_radps: turned.scaled_axis() / step_s,
            patch: Spread::default(),
            target: Target { normal_body: direction_body(&pose, &patch.normal), intensity: f64::from(patch.intensity) },
        };
        Some((pose, beam))
    };
    let (axis, lever_arm_m) = (constants.axis(scanner), constants.lever_arm_m(scanner));
    let (pose, beam) = at(patch.time_s)?;
    let centroid_body_m = pose.body_vector_m(centroid_m);
    let speed_mps = passing_mps(&beam, &centroid_body_m, &axis, &lever_arm_m);
    let later_s = speed_mps.map_or(0.0, |speed| passing_s(&beam, &centroid_body_m, &axis, speed));
    let (pose, beam) = if later_s == 0.0 { (pose, beam) } else { at(patch.time_s + later_s).unwrap_or((pose, beam)) };
    // a ray of what is passed along the way does not become longer: it is measured later, from further on
    let step_m = |direction: &Vector3<f64>, spread_m: f64| {
        let step_m = pose.body_vector_m(&(pose.position + direction * spread_m));
        step_m - speed_mps.map_or_else(Vector3::zeros, |speed| motion_mps(&beam) * (axis.dot(&step_m) / speed))
    };
    let off_m = feature_m - centroid_m;
    let axes = [patch.long_axis, patch.cross_axis()];
    let patch = Spread {
        rays_m: std::array::from_fn(|k| step_m(&axes[k], patch.spread_m[k])),
        feature: std::array::from_fn(|k| {
            (off_m.dot(&axes[k]) / patch.spread_m[k].max(1e-3)).clamp(-FARTHEST, FARTHEST)
        }),
    };
    Some((pose, Beam { patch, ..beam }))
}

/// So many standard deviations of its points a feature may lie from a patch's centroid: planes are not extrapolated beyond their patches.
const FARTHEST: f64 = 2.0;

/// Speed of a profile scanner's plane over the surface, along its axis k: `k · (v + ω × l)` \[m/s\]; none where the scanner is no profile scanner about
/// this axis (the ray to the centroid leaves the plane across it), or the plane passes nothing.
fn passing_mps(
    beam: &Beam,
    centroid_body_m: &Vector3<f64>,
    axis: &Vector3<f64>,
    lever_arm_m: &Vector3<f64>,
) -> Option<f64> {
    /// Rays of a profile scanner leave the plane across its axis by less than this share.
    const IN_PLANE: f64 = 0.1;
    /// Slower than this the plane passes nothing \[m/s\].
    const SLOWEST_MPS: f64 = 0.5;
    let ray_m = centroid_body_m - lever_arm_m;
    let speed_mps = axis.dot(&motion_mps(beam));
    (axis.dot(&ray_m).abs() <= IN_PLANE * ray_m.norm() && speed_mps.abs() >= SLOWEST_MPS).then_some(speed_mps)
}

/// How fast a feature goes by in the body frame, with its sign changed: `v + ω × l` \[m/s\].
fn motion_mps(beam: &Beam) -> Vector3<f64> {
    beam.velocity_body_mps + beam.rate_body_radps.cross(&beam.body_vector_m)
}

/// How much later than a patch's centroid a profile scanner passed its feature \[s\]: the patch's mean time is that of the centroid, and a
/// beam of that time that leads to the feature is of another length than the one that measured it. With the axis k, the rays r of feature
/// and centroid and the feature's velocity in the body frame, `k · (r_f - r_c) = τ k · (v + ω × l)`.
fn passing_s(beam: &Beam, centroid_body_m: &Vector3<f64>, axis: &Vector3<f64>, speed_mps: f64) -> f64 {
    /// Patches are of a moment \[s\].
    const LONGEST_S: f64 = 0.25;
    let later_s = axis.dot(&(beam.body_vector_m - centroid_body_m)) / speed_mps;
    if later_s.abs() <= LONGEST_S { later_s } else { 0.0 }
}

/// Nearest and farthest range of a scanner's ends \[m\], a share at either end left out.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub fn range_span(lines: &[DriveLine], scanner: usize, left_out: f64) -> (f64, f64) {
    let mut ranges: Vec<f64> =
        lines.iter().flat_map(|l| &l.ends).filter(|e| usize::from(e.scanner) == scanner).map(|e| e.range_m).collect();
    ranges.sort_by(f64::total_cmp);
    let cut = (left_out * ranges.len() as f64) as usize;
    let ranges = &ranges[cut.min(ranges.len())..ranges.len() - cut.min(ranges.len())];
    match ranges {
        [] => (1.0, 100.0),
        [first, .., last] => (first.max(0.3), last.max(first + 1.0)),
        [one] => (*one, one + 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_feature_ahead_of_the_centroid_was_passed_later() {
        // 10 m/s ahead and turning, a scanner whose plane stands at 45° to the way
        let axis = Vector3::new(1.0, 1.0, 0.0).normalize();
        let lever_arm_m = Vector3::new(-0.5, 0.4, -0.3);
        let (velocity, rate) = (Vector3::new(10.0, 0.0, 0.0), Vector3::new(0.0, 0.0, 0.3));
        let centroid = lever_arm_m + axis.cross(&Vector3::z()) * 9.0 + Vector3::new(0.0, 0.0, 2.0);
        // the same beam a little later: what it meets then, seen from the pose of the centroid
        let later_s = 0.03;
        let turned = nalgebra::Rotation3::new(rate * later_s);
        let travelled = (velocity + rate.cross(&velocity) * (0.5 * later_s)) * later_s;
        let feature = travelled + turned * (centroid + Vector3::new(0.0, 0.0, 0.2));
        let beam = Beam {
            scanner: 0,
            body_vector_m: feature,
            velocity_body_mps: velocity,
            rate_body_radps: rate,
            patch: Spread::default(),
            target: Target::default(),
        };
        let speed_mps = passing_mps(&beam, &centroid, &axis, &lever_arm_m).expect("it passes");
        let found = passing_s(&beam, &centroid, &axis, speed_mps);
        assert!((found - later_s).abs() < 0.02 * later_s, "{found}");
        let at_rest = Beam { velocity_body_mps: Vector3::zeros(), rate_body_radps: Vector3::zeros(), ..beam };
        assert!(passing_mps(&at_rest, &centroid, &axis, &lever_arm_m).is_none());
        // no profile scanner about this axis
        assert!(passing_mps(&beam, &centroid, &Vector3::z(), &lever_arm_m).is_none());
    }
}
