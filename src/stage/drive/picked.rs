//! Points picked by hand (`[ties] points`): looked at before the work, turned into points for the smoother, and judged by it.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use nalgebra::{Matrix3, Vector3};
use tieline_filter::Trajectory;
use tieline_io::ties::picked::{PickedPoint, PickedRow, PickedSighting, read_picked};
use tieline_matching::xyz::{XyzEnd, XyzKind, XyzPoint};

use super::DriveSolution;
use super::points::PointTie;
use crate::job::Matched;
use crate::project::Project;

/// Further from the vehicle nothing is picked \[m\].
const FARTHEST_M: f64 = 500.0;

/// The file of picked points, where the project names one.
fn file(project: &Project) -> Option<PathBuf> {
    project.ties.as_ref().and_then(|t| t.points.as_ref()).map(|path| project.resolve(path))
}

/// Reads the picked points of a project, none where it names no file.
///
/// # Errors
/// File, line, value and remedy of what cannot be used.
pub fn load(project: &Project) -> Result<Vec<PickedPoint>> {
    let Some(path) = file(project) else { return Ok(Vec::new()) };
    let points = read_picked(&path).context("[ties] points")?;
    for sighting in points.iter().flat_map(|p| &p.sightings) {
        scanner_of(project, sighting)?;
    }
    Ok(points)
}

/// The words with which a row is found again.
fn at(project: &Project, row: &PickedRow) -> String {
    format!("[ties] points: {}: line {}", file(project).unwrap_or_default().display(), row.line)
}

/// The scanner of a sighting: the one that it names, or the only one.
fn scanner_of(project: &Project, sighting: &PickedSighting) -> Result<u16> {
    let ids: Vec<u16> = project.platform.scanner.iter().map(|s| s.id).collect();
    match (sighting.scanner, &ids[..]) {
        (Some(scanner), _) if ids.contains(&scanner) => Ok(scanner),
        (Some(scanner), _) => bail!(
            "{}: scanner {scanner} is none of [[platform.scanner]], which has {ids:?}; mend the row",
            at(project, &sighting.row)
        ),
        (None, [only]) => Ok(*only),
        (None, _) => bail!(
            "{}: no scanner is named, and [[platform.scanner]] has {ids:?}; give the file a column \"scanner\" with the one that saw the point",
            at(project, &sighting.row)
        ),
    }
}

/// Whether every sighting lies within the time of the trajectory that the strips were made with, and near it; `shift_s` leads from the clock of the files to the survey's.
///
/// # Errors
/// File, line, value and remedy of the first that does not.
pub fn check(project: &Project, points: &[PickedPoint], delivered: &Trajectory, shift_s: f64) -> Result<()> {
    let (first_s, last_s) = delivered.span_s();
    for sighting in points.iter().flat_map(|p| &p.sightings) {
        let (time_s, place) = (sighting.gps_time_s, || at(project, &sighting.row));
        let Some(pose) = delivered.pose_at(time_s + shift_s) else {
            bail!(
                "{}: gps_time_s is {time_s} where {:.3} to {:.3}, the time of the trajectory, was due; take the GPS time of the point as the strips have it",
                place(),
                first_s - shift_s,
                last_s - shift_s
            );
        };
        let away_m = (pose.position - sighting.row.place_m).norm();
        if away_m > FARTHEST_M {
            bail!(
                "{}: the place lies {away_m:.0} m from the vehicle at that time, {FARTHEST_M} m at most were due; check the order of x_m, y_m, z_m, the map \
                 that they are of, and the time",
                place()
            );
        }
    }
    Ok(())
}

/// Picked points with their strips.
///
/// # Errors
/// File and line of a sighting while no strip was measured.
pub fn points_of(project: &Project, matched: &Matched) -> Result<Vec<XyzPoint>> {
    let picked = load(project)?;
    let shift_s = matched.survey.strip_files().next().map_or(0.0, |f| f.time_shift_s);
    if let Some(delivered) = matched.poses.shared() {
        check(project, &picked, delivered, shift_s)?;
    }
    let origin_m = matched.survey.origin();
    let end = |sighting: &PickedSighting| -> Result<XyzEnd> {
        let scanner = scanner_of(project, sighting)?;
        let time_s = sighting.gps_time_s + shift_s;
        let strips = matched.strips.strips();
        let held = |at: &usize| (strips[*at].start_s - 1e-6..=strips[*at].end_s + 1e-6).contains(&time_s);
        let during = || (0..strips.len()).filter(held);
        let strip = during().find(|at| strips[*at].scanners.contains(&scanner)).or_else(|| during().next());
        let Some(strip) = strip.and_then(|at| u32::try_from(at).ok()) else {
            bail!(
                "{}: no strip was measured at gps_time_s {}; take the GPS time of the point as the strips have it",
                at(project, &sighting.row),
                sighting.gps_time_s
            );
        };
        Ok(XyzEnd {
            strip,
            scanner,
            time_s,
            place_m: sighting.row.place_m - origin_m,
            covariance_m2: covariance_m2(&sighting.row),
            // nobody says what surface it is on: as good as any for what ranges err by over incidence
            normal: Vector3::z(),
            points: 1,
            intensity: 0.0,
        })
    };
    let point = |p: &PickedPoint| -> Result<XyzPoint> {
        Ok(XyzPoint {
            kind: XyzKind::Picked,
            name: Some(p.name.clone()),
            free: None,
            ends: p.sightings.iter().map(end).collect::<Result<_>>()?,
            known: p.known.as_ref().map(|row| (row.place_m - origin_m, covariance_m2(row))),
        })
    };
    picked.iter().map(point).collect()
}

fn covariance_m2(row: &PickedRow) -> Matrix3<f64> {
    let [plan_m, height_m] = row.sigma_m;
    Matrix3::from_diagonal(&Vector3::new(plan_m, plan_m, height_m).map(|s| s * s))
}

/// A picked point after the adjustment.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PickedFate {
    /// Its name.
    pub name: String,
    /// Whether it is known beforehand.
    pub known: bool,
    /// Of each sighting: GPS time as the strips have it \[s\], scanner, and how far from where the others have it, or from where it is known to be, by the trajectory that
    /// the strips were made with and by the new one \[m\].
    pub sightings: Vec<(f64, u16, f64, f64)>,
    /// Why the smoother did without it.
    pub why_not: Option<String>,
}

/// What became of the picked points; `shift_s` leads from the clock of the files to the survey's.
#[must_use]
pub fn fates(drive: &DriveSolution, shift_s: f64) -> Vec<PickedFate> {
    let first = drive.chosen.ties.len();
    let constants = &drive.solution.calibration.value;
    let of = |(row, point): (usize, &PointTie)| {
        let name = point.name.clone()?;
        let fate = drive.solution.ties.get(first + row)?;
        let before_m: Vec<Option<Vector3<f64>>> = point.ends.iter().map(|e| Some(e.map_m)).collect();
        let after = point.tie.sightings.iter().map(|s| {
            let pose = drive.pose_at(s.time_s - drive.clock_shift_s)?;
            Some(pose.position + pose.map_from_ned * (pose.ned_from_body * s.calibrated(constants).body_vector_m))
        });
        let after_m: Vec<Option<Vector3<f64>>> = after.collect();
        let known_m = point.known_map_m;
        let sightings = point.tie.sightings.iter().zip(&point.ends).enumerate().map(|(k, (s, end))| {
            let gps_time_s = s.time_s - drive.clock_shift_s - shift_s;
            (gps_time_s, end.scanner, off_m(&before_m, known_m, k), off_m(&after_m, known_m, k))
        });
        // one of several sightings may be left out as well
        let heard = |w: &[f64]| w.iter().skip(usize::from(point.tie.known_m.is_none())).all(|w| *w > 0.0);
        let why_not = fate.why_not.or_else(|| (!heard(&fate.weights)).then_some("innovation")).map(String::from);
        Some(PickedFate { name, known: known_m.is_some(), sightings: sightings.collect(), why_not })
    };
    drive.points.1.iter().enumerate().filter_map(of).collect()
}

/// How far sighting `k` lies from where it is known to be, or from the middle of the others \[m\]; not a number where a place is not known.
#[allow(clippy::cast_precision_loss)]
fn off_m(places_m: &[Option<Vector3<f64>>], known_m: Option<Vector3<f64>>, k: usize) -> f64 {
    let others: Vec<Vector3<f64>> =
        places_m.iter().enumerate().filter(|(i, _)| *i != k).filter_map(|(_, place)| *place).collect();
    let middle_m = || (!others.is_empty()).then(|| others.iter().sum::<Vector3<f64>>() / others.len() as f64);
    match (places_m[k], known_m.or_else(middle_m)) {
        (Some(own_m), Some(due_m)) => (own_m - due_m).norm(),
        _ => f64::NAN,
    }
}

/// What there is to say of picked points: how many there are, and each that does not fit, by name and residual.
#[must_use]
pub fn notes(fates: &[PickedFate]) -> Vec<String> {
    if fates.is_empty() {
        return Vec::new();
    }
    let known = fates.iter().filter(|f| f.known).count();
    let out = fates.iter().filter(|f| f.why_not.is_some()).count();
    let sightings: usize = fates.iter().map(|f| f.sightings.len()).sum();
    let mut notes = vec![format!(
        "{} points picked by hand with {sightings} sightings, {known} of them known beforehand; {out} do not fit",
        fates.len()
    )];
    for fate in fates.iter().filter(|f| f.why_not.is_some()) {
        let (due, whose) = if fate.known { ("it is known to be", "") } else { ("the others have it", "of both ") };
        let worst = fate.sightings.iter().max_by(|a, b| a.3.total_cmp(&b.3));
        let Some((time_s, scanner, before_m, after_m)) = worst else { continue };
        let whose = if fate.sightings.len() == 2 { whose } else { "" };
        notes.push(match fate.why_not.as_deref() {
            Some("innovation") => format!(
                "picked point \"{}\" does not fit all the rest and was left out: {whose}the sighting at {time_s:.3} s, scanner {scanner}, lies {after_m:.3} m from where {due} \
                 ({before_m:.3} m as delivered); pick it again, or remove it",
                fate.name
            ),
            why => format!("picked point \"{}\" was not used: {}", fate.name, why.unwrap_or_default()),
        });
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sighting_is_measured_from_the_others_or_from_what_is_known() {
        let places = [Some(Vector3::zeros()), Some(Vector3::new(0.0, 2.0, 0.0)), Some(Vector3::new(0.0, 4.0, 0.0))];
        assert!((off_m(&places, None, 0) - 3.0).abs() < 1e-12);
        assert!((off_m(&places, Some(Vector3::x()), 0) - 1.0).abs() < 1e-12);
        assert!(off_m(&[places[0], None], None, 0).is_nan() && off_m(&[None, places[0]], None, 0).is_nan());
    }

    #[test]
    fn what_does_not_fit_is_named_with_its_residual() {
        let fate = |name: &str, why_not: Option<&str>| PickedFate {
            name: String::from(name),
            known: false,
            sightings: vec![(100.0, 0, 0.4, 0.01), (160.5, 1, 1.9, 2.25), (200.0, 0, 0.4, 0.01)],
            why_not: why_not.map(String::from),
        };
        assert!(notes(&[]).is_empty());
        let notes =
            notes(&[fate("good", None), fate("bad", Some("innovation")), fate("late", Some("beyond_trajectory"))]);
        assert_eq!(notes.len(), 3);
        assert!(
            notes[0].starts_with("3 points") && notes[0].contains("9 sightings") && notes[0].ends_with("2 do not fit")
        );
        for word in ["\"bad\"", "160.500 s", "scanner 1", "2.250 m", "1.900 m"] {
            assert!(notes[1].contains(word), "{}", notes[1]);
        }
        assert!(notes[2].contains("\"late\"") && notes[2].contains("beyond_trajectory"));
    }
}
