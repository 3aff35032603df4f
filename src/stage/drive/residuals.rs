//! How far the sightings of each line are apart, before and after.

use nalgebra::Vector3;
use tieline_filter::Pose;

use super::DriveSolution;
use super::ties::{Class, DriveLine};
use crate::job::Matched;

/// A line judged: offsets of its ends along its normal from their weighted mean \[m\].
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    /// Row in [`DriveSolution::lines`].
    pub line: usize,
    /// What the line binds.
    pub class: Class,
    /// By the trajectory and mounting that the strips were made with.
    pub before_m: Vec<f64>,
    /// By the new trajectory and calibration.
    pub after_m: Vec<f64>,
    /// Whether it was held out of the solution.
    pub held_out: bool,
}

impl Residual {
    /// Last sighting less first \[m\], before and after.
    #[must_use]
    pub fn difference_m(&self) -> (f64, f64) {
        let of = |v: &[f64]| v.last().copied().unwrap_or(f64::NAN) - v.first().copied().unwrap_or(f64::NAN);
        (of(&self.before_m), of(&self.after_m))
    }
}

/// Residuals of all lines, used, left over and held out.
#[must_use]
pub fn residuals(drive: &DriveSolution, matched: &Matched) -> Vec<Residual> {
    let constants = &drive.solution.calibration.value;
    drive
        .lines
        .iter()
        .enumerate()
        .filter_map(|(row, line)| {
            let time_s = |k: usize| line.ends[k].sighting.time_s - drive.clock_shift_s;
            let delivered_m = |k: usize| line.ends[k].delivered_m;
            let moved_m = |k: usize| line.ends[k].sighting.calibrated(constants).body_vector_m;
            let before_m =
                offsets(line, |k| place(&matched.poses.at(line.ends[k].strip, time_s(k))?, &delivered_m(k)))?;
            // the calibrated body vector holds what a latency moves: the pose is that of the stamp
            let after_m = offsets(line, |k| place(&drive.pose_at(time_s(k))?, &moved_m(k)))?;
            Some(Residual { line: row, class: line.class(), before_m, after_m, held_out: line.held_out })
        })
        .collect()
}

/// A feature in the map \[m\].
pub(super) fn place(pose: &Pose, body_vector_m: &Vector3<f64>) -> Option<Vector3<f64>> {
    Some(pose.position + pose.map_from_ned * (pose.ned_from_body * body_vector_m))
}

/// Offsets along the normal from their weighted mean \[m\].
fn offsets(line: &DriveLine, place_of: impl Fn(usize) -> Option<Vector3<f64>>) -> Option<Vec<f64>> {
    let mut values = Vec::with_capacity(line.ends.len());
    let mut origin_m: Option<Vector3<f64>> = None;
    let (mut sum, mut weights) = (0.0, 0.0);
    for (k, end) in line.ends.iter().enumerate() {
        let place_m = place_of(k)?;
        let value = line.normal_map.dot(&(place_m - *origin_m.get_or_insert(place_m)));
        let weight = 1.0 / end.sighting.covariance_m2[(0, 0)];
        sum += weight * value;
        weights += weight;
        values.push(value);
    }
    values.iter_mut().for_each(|v| *v -= sum / weights);
    Some(values)
}
