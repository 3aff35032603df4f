//! Corners of walls and ground in a drive: matched between sightings, and when the scan passed them.

use std::collections::BTreeSet;

use nalgebra::{UnitQuaternion, Vector3};
use tieline_filter::Trajectory;
use tieline_matching::xyz::{
    AgreeOptions, FeatureTie, StreetCorner, StreetCornerOptions, XyzEnd, agree, match_street_corners,
};
use tieline_matching::{Patch, Sighting};

use super::search::Search;
use super::ties::Ties;
use crate::project::Project;

/// A scanner as the beams of corners need it.
struct Mount {
    arm_m: Vector3<f64>,
    axis: Vector3<f64>,
}

/// Matches the corners of a drive and lets those about them judge them; lines that say the same with the same patches go. Gives what there is to say as well.
#[must_use]
pub fn corners(
    mut found: Vec<StreetCorner>,
    ties: &mut Ties,
    project: &Project,
    trajectory: &Trajectory,
    origin_m: &Vector3<f64>,
) -> (Vec<FeatureTie>, String) {
    let (count, search) = (found.len(), Search::of(trajectory));
    let radius_m = |a_s: f64, b_s: f64| search.radius_m(a_s, b_s);
    let options = StreetCornerOptions::default();
    let (mut matched, rows) = match_street_corners(&mut found, &radius_m, search.most_m(), &options);
    let mut kept_rows = Vec::new();
    let mut row = 0;
    matched.retain_mut(|tie| {
        row += 1;
        let passed = tie.ends.iter_mut().all(|end| is_passed(end, project, trajectory, origin_m));
        kept_rows.extend(passed.then(|| rows[row - 1]));
        passed
    });
    agree(&mut matched, &AgreeOptions::default());
    let accepted = || matched.iter().zip(&kept_rows).filter(|(tie, _)| tie.rejection.is_none());
    let of_corners: BTreeSet<(Sighting, [u64; 3])> = accepted()
        .flat_map(|(_, rows)| rows)
        .flat_map(|row| found[*row].members_m.iter().map(|m| (found[*row].sighting, bits(m))))
        .collect();
    let is_of = |patch: &Patch| of_corners.contains(&(patch.sighting, bits(&patch.centroid_m)));
    // with one patch of a corner a line still says something of another sighting
    let left_out = ties.leave_out(|line| line.used().filter(|(_, patch)| is_of(patch)).count() >= 2);
    let note = format!(
        "corners of walls and ground: {} of {} matches of {count} corners are ties; {left_out} surface lines of the same patches were left out",
        accepted().count(),
        matched.len()
    );
    (matched, note)
}

fn bits(place_m: &Vector3<f64>) -> [u64; 3] {
    [place_m.x, place_m.y, place_m.z].map(f64::to_bits)
}

/// Sets the time at which the plane of a profile scanner passed an end; that of its planes stays for other scanners. Whether it has one.
pub(super) fn is_passed(end: &mut XyzEnd, project: &Project, trajectory: &Trajectory, origin_m: &Vector3<f64>) -> bool {
    /// Rays of a profile scanner leave the plane across its axis by less than this share where its planes were measured.
    const IN_PLANE: f64 = 0.35;
    /// Planes of a corner were measured within this of it \[s\].
    const LONGEST_S: f64 = 1.5;
    /// Slower than this the plane passes nothing \[m/s\].
    const SLOWEST_MPS: f64 = 0.5;
    const STEP_S: f64 = 0.01;
    let Some(scanner) = project.platform.scanner.iter().find(|s| s.id == end.scanner) else { return false };
    let [roll, pitch, yaw] = scanner.mounting_deg.map(f64::to_radians);
    let mount = Mount {
        arm_m: Vector3::from(scanner.lever_arm_m),
        axis: UnitQuaternion::from_euler_angles(roll, pitch, yaw) * Vector3::x(),
    };
    let map_m = end.place_m + origin_m;
    // how far out of the scanner's plane it lies \[m\], and the ray's length \[m\]
    let off = |time_s: f64| {
        let ray_m = trajectory.pose_at(time_s)?.body_vector_m(&map_m) - mount.arm_m;
        Some((mount.axis.dot(&ray_m), ray_m.norm()))
    };
    let Some((first_m, range_m)) = off(end.time_s) else { return false };
    if first_m.abs() > IN_PLANE * range_m {
        return true;
    }
    let mut time_s = end.time_s;
    for _ in 0..6 {
        let (Some((here_m, _)), Some((before_m, _)), Some((after_m, _))) =
            (off(time_s), off(time_s - STEP_S), off(time_s + STEP_S))
        else {
            return false;
        };
        let speed_mps = (after_m - before_m) / (2.0 * STEP_S);
        if speed_mps.abs() < SLOWEST_MPS {
            return false;
        }
        time_s -= here_m / speed_mps;
        if (time_s - end.time_s).abs() > LONGEST_S {
            return false;
        }
    }
    end.time_s = time_s;
    true
}
