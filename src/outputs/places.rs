//! Ties of places in the table of ties: both ends of each.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use tieline_io::ties::{TieRow, TieTable};

use crate::job::Matched;
use crate::project::Project;
use crate::stage::places::PlaceTie;
use crate::stage::solve::{CLASSES, Solution};
use crate::summary::places::{Found, found, key};

/// Adds both ends of all ties of places; numbers go on after those of lines. Residuals are half of the distance of the two places along
/// what is held, the covariance that of one end with the factor of its class.
pub(super) fn push(table: &mut TieTable, project: &Project, matched: &Matched, solution: Option<&Solution>) {
    let mut rows: BTreeMap<usize, Vec<Found<'_>>> = BTreeMap::new();
    for row in solution.into_iter().flat_map(found) {
        rows.entry(row.tie).or_default().push(row);
    }
    let first_id = i64::try_from(matched.ties.lines.len()).unwrap_or(i64::MAX / 2);
    let shift_s = matched.survey.strip_files().next().map_or(0.0, |f| f.time_shift_s);
    for (id, (row, tie)) in (first_id..).zip(matched.ties.places.ties.iter().enumerate()) {
        let of_tie = rows.get(&row).map_or(&[][..], Vec::as_slice);
        let outlier = of_tie.iter().any(|f| f.outlier);
        let why_not = match (&tie.why_not, solution) {
            (Some(why_not), _) => why_not.as_str(),
            (None, Some(_)) if of_tie.is_empty() => "no_pose",
            (None, _) if outlier => "outlier",
            (None, _) => "",
        };
        let length = |values: &mut dyn Iterator<Item = f64>| 0.5 * values.map(|v| v * v).sum::<f64>().sqrt();
        let before_m = length(&mut tie.directions.iter().map(|d| d.distance_m));
        let after_m = if of_tie.is_empty() { f64::NAN } else { length(&mut of_tie.iter().map(|f| f.after_m)) };
        let covariance = covariance_m2(tie, of_tie);
        for (k, (sighting, place_m)) in tie.sightings.iter().zip(&tie.points_m).enumerate() {
            let map_m = place_m + matched.survey.origin();
            let strip = matched.strips.strips().get(sighting.strip as usize).map_or("", |s| s.name.as_str());
            let lever_arm_m = project
                .platform
                .scanner
                .iter()
                .find(|s| s.id == sighting.scanner)
                .map_or_else(Vector3::zeros, |s| Vector3::from(s.lever_arm_m));
            let pose = matched.poses.at(sighting.strip, tie.time_s[k]);
            let body_m = pose.map_or_else(|| Vector3::repeat(f64::NAN), |pose| pose.body_vector_m(&map_m));
            table.push(&TieRow {
                tie_id: id,
                kind: key(tie.kind),
                class: of_tie.first().and_then(|f| CLASSES.get(f.line.class)).copied().unwrap_or(tie.kind.as_str()),
                end: i32::try_from(k).unwrap_or(0),
                strip,
                pass: i32::from(sighting.pass),
                scanner: i32::from(sighting.scanner),
                gps_time_s: tie.time_s[k] - shift_s,
                body_x_m: body_m.x,
                body_y_m: body_m.y,
                body_z_m: body_m.z,
                range_m: (body_m - lever_arm_m).norm(),
                map_e_m: map_m.x,
                map_n_m: map_m.y,
                map_h_m: map_m.z,
                cov_ee_m2: covariance[(0, 0)],
                cov_en_m2: covariance[(0, 1)],
                cov_eu_m2: covariance[(0, 2)],
                cov_nn_m2: covariance[(1, 1)],
                cov_nu_m2: covariance[(1, 2)],
                cov_uu_m2: covariance[(2, 2)],
                residual_before_m: before_m,
                residual_after_m: after_m,
                used: why_not.is_empty() && !tie.held_out,
                held_out: why_not.is_empty() && tie.held_out,
                why_not,
                ..TieRow::default()
            });
        }
    }
}

/// Covariance of one end: half of that of the distance, nothing along what is not held.
fn covariance_m2(tie: &PlaceTie, rows: &[Found<'_>]) -> Matrix3<f64> {
    let of = |(k, d): (usize, &crate::stage::places::Direction)| {
        let sigma_m = rows.get(k).map_or(d.sigma_m, |f| f.sigma_m);
        d.direction * d.direction.transpose() * (0.5 * sigma_m * sigma_m)
    };
    tie.directions.iter().enumerate().map(of).sum()
}
