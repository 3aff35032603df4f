//! Points in the table of ties, every end of each, and those picked by hand in a table of their own.

use std::fmt::Write as _;

use nalgebra::Vector3;
use tieline_io::ties::{TieRow, TieTable};

use crate::job::Matched;
use crate::project::Project;
use crate::stage::drive::DriveSolution;
use crate::stage::drive::picked::PickedFate;
use crate::stage::drive::points::PointTie;

/// Adds the ends of all points that are ties; numbers go on after those of lines. Residuals are distances from the mean of the ends, or from where a point is known to be.
pub(super) fn push_points(table: &mut TieTable, project: &Project, matched: &Matched, drive: &DriveSolution) {
    let shift_s = matched.survey.strip_files().next().map_or(0.0, |f| f.time_shift_s);
    let constants = &drive.solution.calibration.value;
    let first_id = i64::try_from(matched.ties.lines.len()).unwrap_or(i64::MAX / 2);
    for (id, point) in (first_id..).zip(&drive.points.0) {
        let (used, why_not) = fate(drive, point);
        let after_m: Vec<Option<Vector3<f64>>> = point
            .tie
            .sightings
            .iter()
            .map(|s| {
                let pose = drive.pose_at(s.time_s - drive.clock_shift_s)?;
                let body_m = s.calibrated(constants).body_vector_m;
                Some(pose.position + pose.map_from_ned * (pose.ned_from_body * body_m))
            })
            .collect();
        let before_m: Vec<Option<Vector3<f64>>> = point.ends.iter().map(|e| Some(e.map_m)).collect();
        let off_m = |places_m: &[Option<Vector3<f64>>]| from_due_m(places_m, point.known_map_m, &point.held_map);
        let (before_m, after_m) = (off_m(&before_m), off_m(&after_m));
        for (k, (end, sighting)) in (0_i32..).zip(point.ends.iter().zip(&point.tie.sightings)) {
            let at = usize::try_from(k).unwrap_or(0);
            let c = point.covariance_map_m2(sighting);
            let scanner = project.platform.scanner.iter().find(|s| s.id == end.scanner);
            let ray_m = end.delivered_m - scanner.map_or_else(Vector3::zeros, |s| Vector3::from(s.lever_arm_m));
            let strip = matched.strips.strips().get(end.strip as usize).map_or("", |s| s.name.as_str());
            table.push(&TieRow {
                tie_id: id,
                kind: point.tie.kind.as_str(),
                class: point.class.as_str(),
                end: k,
                strip,
                scanner: i32::from(end.scanner),
                gps_time_s: sighting.time_s - drive.clock_shift_s - shift_s,
                body_x_m: end.delivered_m.x,
                body_y_m: end.delivered_m.y,
                body_z_m: end.delivered_m.z,
                range_m: ray_m.norm(),
                map_e_m: end.map_m.x,
                map_n_m: end.map_m.y,
                map_h_m: end.map_m.z,
                cov_ee_m2: c[(0, 0)],
                cov_en_m2: c[(0, 1)],
                cov_eu_m2: c[(0, 2)],
                cov_nn_m2: c[(1, 1)],
                cov_nu_m2: c[(1, 2)],
                cov_uu_m2: c[(2, 2)],
                residual_before_m: before_m[at],
                residual_after_m: after_m[at],
                used,
                why_not,
                ..TieRow::default()
            });
        }
    }
}

/// Whether the smoother used a point, and why not.
pub(crate) fn fate(drive: &DriveSolution, point: &PointTie) -> (bool, &'static str) {
    let first = drive.chosen.ties.len();
    // numbers of all points count from none, of those that went to the smoother after those of lines: their first sightings tell them
    let same = |p: &PointTie| p.tie.sightings == point.tie.sightings;
    match drive.points.1.iter().position(same).map(|k| drive.solution.ties[first + k].why_not) {
        None => (false, "budget"),
        Some(None) => (true, ""),
        Some(Some(why)) => (false, why),
    }
}

/// Distances along what is held from where a point is known to be, or from the mean \[m\]; not a number where a place is not known.
#[allow(clippy::cast_precision_loss)]
fn from_due_m(places_m: &[Option<Vector3<f64>>], known_m: Option<Vector3<f64>>, held: &[Vector3<f64>]) -> Vec<f64> {
    let places: Vec<Vector3<f64>> = places_m.iter().flatten().copied().collect();
    let mean = known_m.unwrap_or_else(|| places.iter().sum::<Vector3<f64>>() / places.len().max(1) as f64);
    let off_m = |p: Vector3<f64>| held.iter().map(|d| d.dot(&(p - mean)).powi(2)).sum::<f64>().sqrt();
    places_m.iter().map(|p| p.map_or(f64::NAN, off_m)).collect()
}

/// What `picked.csv` holds: every sighting of every picked point; none where nobody picked any.
pub(super) fn picked_text(fates: &[PickedFate]) -> Option<String> {
    let mut text = String::from("point,gps_time_s,scanner,known,before_m,after_m,used,why_not\n");
    for fate in fates {
        let name = match fate.name.contains([',', '"']) {
            true => format!("\"{}\"", fate.name.replace('"', "\"\"")),
            false => fate.name.clone(),
        };
        let (used, why) = (u8::from(fate.why_not.is_none()), fate.why_not.as_deref().unwrap_or_default());
        for (time_s, scanner, before_m, after_m) in &fate.sightings {
            let known = u8::from(fate.known);
            let _ = writeln!(text, "{name},{time_s:.6},{scanner},{known},{before_m:.4},{after_m:.4},{used},{why}");
        }
    }
    (!fates.is_empty()).then_some(text)
}
