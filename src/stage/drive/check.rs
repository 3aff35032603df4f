//! What can be wrong with the parts of a drive, found before the adjustment or by its misfit.

use std::collections::BTreeSet;

use anyhow::{Context, Result, bail};
use nalgebra::{UnitQuaternion, Vector3};
use tieline_filter::Trajectory;
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_matching::SourceRule;

use super::constants::Constants;
use super::ties::DriveLine;
use super::{NO_CRS, NO_TRAJECTORY, clock_shift_s, picked};
use crate::job::Matched;
use crate::project::Project;
use crate::sample::{Sample, block};
use crate::stage::navigate::Measurements;
use crate::survey::Survey;

/// A correction beyond this many standard deviations of what was known beforehand is no correction.
const FAR_OFF: f64 = 4.0;
/// Beams of a profile scanner leave the plane across its axis by less than this.
const IN_PLANE: f64 = 0.1;
/// And by less than this in the median where the lever arm is right: patches have some width.
const SKEWED: f64 = 0.03;
/// Of a sample's points, one of so many is looked at.
const SAMPLED_EVERY: usize = 17;

/// What is wrong with the parts of a drive and can be seen in a sample of its points, before all of them are read.
///
/// # Errors
/// What is missing or does not fit, with both sides and a remedy.
pub fn before_scan(
    project: &Project,
    survey: &Survey,
    sample: &Sample,
    rule: &SourceRule,
    delivered: Option<&Trajectory>,
    measurements: &Measurements,
) -> Result<()> {
    survey.crs.as_ref().context(NO_CRS)?;
    let delivered = delivered.context(NO_TRAJECTORY)?;
    let shift_s = clock_shift_s(&survey.clock, &measurements.clock);
    let strips_shift_s = survey.strip_files().next().map_or(0.0, |f| f.time_shift_s);
    picked::check(project, &picked::load(project)?, delivered, strips_shift_s)?;
    let (first_s, last_s) = delivered.span_s();
    for file in survey.strip_files() {
        let Some([start_s, end_s]) = file.sampled_range_s.map(|range| range.map(|t| t + file.time_shift_s)) else {
            continue;
        };
        of_one_time((start_s + shift_s, end_s + shift_s), measurements)?;
        if start_s < first_s - 1e-3 || end_s > last_s + 1e-3 {
            bail!(
                "{} ({start_s:.3} s to {end_s:.3} s) is not covered by the trajectory ({first_s:.3} s to {last_s:.3} s): give the \
                 trajectory of this drive, or check time systems (project.time, project.week, trajectory.time)",
                file.las.path().display()
            );
        }
    }
    let mut points: Vec<(u16, f64, Vector3<f64>)> = Vec::new();
    for (number, columns, first) in &sample.chunks {
        let file = &survey.files[*number];
        let (block, header) = (block(file, columns, &[], *first), file.las.header());
        points.extend((0..columns.len()).step_by(SAMPLED_EVERY).map(|i| {
            let raw = [columns.x[i], columns.y[i], columns.z[i]];
            let place_m = Vector3::from_fn(|k, _| f64::from(raw[k]) * header.scale[k] + header.offset[k]);
            (rule.source(&block, i).scanner(), columns.gps_time[i] + file.time_shift_s, place_m)
        }));
    }
    // a sample may miss a scanner, and has none that is not there
    let numbers: BTreeSet<u16> = points.iter().map(|p| p.0).collect();
    let numbers: Vec<u16> = numbers.into_iter().collect();
    scanners(project, &numbers)?;
    if numbers.len() == project.platform.scanner.len() {
        let beam = |(number, time_s, place_m): &(u16, f64, Vector3<f64>)| {
            let scanner = u16::try_from(numbers.binary_search(number).ok()?).ok()?;
            Some((scanner, delivered.pose_at(*time_s)?.body_vector_m(place_m)))
        };
        mounting(project, &points.iter().filter_map(beam).collect::<Vec<_>>())?;
    }
    Ok(())
}

/// Strips and measurements must be of one drive, and scanners those of the platform.
///
/// # Errors
/// What does not fit, with both sides and a remedy.
pub fn parts(project: &Project, matched: &Matched, measurements: &Measurements, shift_s: f64) -> Result<()> {
    let strips = matched.strips.strips();
    let start_s = strips.iter().map(|s| s.start_s).fold(f64::INFINITY, f64::min) + shift_s;
    let end_s = strips.iter().map(|s| s.end_s).fold(f64::NEG_INFINITY, f64::max) + shift_s;
    of_one_time((start_s, end_s), measurements)?;
    scanners(project, matched.strips.scanner_numbers())
}

/// Strips, by their first and last time on the clock of the measurements \[s\], lie within the inertial measurements.
fn of_one_time((start_s, end_s): (f64, f64), measurements: &Measurements) -> Result<()> {
    let (first_s, last_s) = measurements.inputs.imu.span_s();
    if start_s < first_s - 1.0 || end_s > last_s + 1.0 {
        let weeks = ((0.5 * (first_s + last_s) - 0.5 * (start_s + end_s)) / SECONDS_PER_WEEK).round();
        let fits =
            start_s + weeks * SECONDS_PER_WEEK >= first_s - 1.0 && end_s + weeks * SECONDS_PER_WEEK <= last_s + 1.0;
        if weeks != 0.0 && fits {
            bail!(
                "the strips are {weeks:+} weeks from the inertial measurements: one of both names a wrong GPS week; set project.week"
            );
        }
        bail!(
            "the strips ({start_s:.1} s to {end_s:.1} s) reach beyond the inertial measurements ({first_s:.1} s to {last_s:.1} s): \
             give the IMU file of this drive, or leave out strips, or check time systems (project.time, project.week)"
        );
    }
    Ok(())
}

/// Scanners of the strips, by their numbers in the files, are those of the platform.
fn scanners(project: &Project, numbers: &[u16]) -> Result<()> {
    let found = numbers.len();
    let known: Vec<u16> = project.platform.scanner.iter().map(|s| s.id).collect();
    if known.is_empty() {
        bail!(
            "[platform] names no scanner, while the strips hold {found}: give [[platform.scanner]] with id, lever_arm_m and mounting_deg \
             for each (ids count from 0)"
        );
    }
    let missing: Vec<String> =
        (0..found).filter(|i| !known.iter().any(|k| usize::from(*k) == *i)).map(|i| i.to_string()).collect();
    if !missing.is_empty() {
        bail!(
            "the strips hold {found} scanners, 0 to {}, and [[platform.scanner]] has ids {known:?}: scanner {} is missing; ids count from 0 in the \
             order of the numbers in the files ({numbers:?})",
            found.saturating_sub(1),
            missing.join(", ")
        );
    }
    Ok(())
}

/// Beams of lines, as [`mounting`] takes them.
#[must_use]
pub fn beams_of(lines: &[DriveLine]) -> Vec<(u16, Vector3<f64>)> {
    lines.iter().flat_map(|l| &l.ends).map(|e| (e.scanner, e.delivered_m)).collect()
}

/// Mounting angles in radians under a key in degrees, and axes of lever arms that are swapped or turned: the beams of a profile
/// scanner then leave the plane across its axis. A beam is a scanner and the vector from the IMU to what it hit, body axes \[m\]. Gives
/// what is to be said.
///
/// # Errors
/// Names the scanner when its beams lie in a plane by radians and do not by degrees.
pub fn mounting(project: &Project, beams: &[(u16, Vector3<f64>)]) -> Result<Vec<String>> {
    let mut notes = Vec::new();
    for scanner in &project.platform.scanner {
        let out_of_plane = |angles: [f64; 3], arm_m: [f64; 3]| {
            let [roll, pitch, yaw] = angles;
            let axis = UnitQuaternion::from_euler_angles(roll, pitch, yaw) * Vector3::x();
            let of_scanner = beams.iter().filter(|b| b.0 == scanner.id);
            let mut values: Vec<f64> =
                of_scanner.map(|b| axis.dot(&(b.1 - Vector3::from(arm_m)).normalize()).abs()).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        let (angles, arm_m) = (scanner.mounting_deg.map(f64::to_radians), scanner.lever_arm_m);
        let (Some(degrees), Some(radians)) = (out_of_plane(angles, arm_m), out_of_plane(scanner.mounting_deg, arm_m))
        else {
            continue;
        };
        if radians < IN_PLANE && degrees > 3.0 * IN_PLANE {
            bail!(
                "platform.scanner {}: mounting_deg = {:?} fits the beams when taken for radians; give degrees",
                scanner.id,
                scanner.mounting_deg
            );
        }
        let [x, y, z] = arm_m;
        let turned = [[y, x, z], [y, x, -z], [x, -y, z], [-x, y, z], [x, y, -z], [-y, x, z], [y, -x, z], [x, -y, -z]];
        let best = turned
            .into_iter()
            .filter_map(|arm_m| Some((out_of_plane(angles, arm_m)?, arm_m)))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((of_best, arm_m)) = best.filter(|(of_best, _)| degrees > SKEWED && *of_best < 0.4 * degrees) {
            notes.push(format!(
                "warning: platform.scanner {}: lever_arm_m = {:?} puts the beams {:.1}° out of the plane across the scanner's axis, {arm_m:?} only {:.1}°: \
                 check its axes (x forward, y right, z down) and signs",
                scanner.id,
                scanner.lever_arm_m,
                degrees.asin().to_degrees(),
                of_best.asin().to_degrees()
            ));
        }
    }
    Ok(notes)
}

/// Corrections far beyond what was known beforehand, and scanners that nothing binds.
#[must_use]
pub fn misfits(constants: &Constants, values: &[f64], lines: &[DriveLine]) -> Vec<String> {
    let mut notes = Vec::new();
    for group in &constants.groups {
        for (k, i) in group.constants().enumerate() {
            let ratio = values[i].abs() / group.prior[(k, k)].sqrt();
            if ratio > FAR_OFF && !group.term.is_curve() {
                let axis = if group.prior.nrows() == 3 { ["x", "y", "z"][k] } else { "" };
                notes.push(format!(
                    "warning: scanner {}, {} {axis}: {:.3} from its nominal value, {ratio:.0} times what was to be expected: check the platform's axes (x forward, \
                     y right, z down), signs and units",
                    group.scanner,
                    group.term.as_str(),
                    values[i]
                ));
            }
        }
    }
    let scanners = constants.splines.len();
    for scanner in 0..scanners {
        let increments = lines.iter().filter(|l| {
            l.ends.iter().any(|e| usize::from(e.scanner) == scanner)
                && l.ends.iter().any(|e| usize::from(e.scanner) != scanner)
        });
        if scanners > 1 && increments.count() == 0 {
            notes.push(format!(
                "warning: no surface binds scanner {scanner} to another: its calibration rests on ties between visits alone"
            ));
        }
    }
    notes
}
