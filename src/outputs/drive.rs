//! The files of a drive that others read: ties, range bias, calibration, correction over time.

mod calibration;
pub(crate) mod points;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use nalgebra::{Vector3, Vector6};
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{Correction, CorrectionRow};
use tieline_io::correction::write_correction;
use tieline_io::output::write_whole;
use tieline_io::ties::{TieTable, write_csv, write_parquet};

use super::{Row, push};
use crate::job::Matched;
use crate::project::Project;
use crate::stage::drive::DriveSolution;
use crate::stage::drive::calibrated::Calibrated;
use crate::stage::drive::residuals::Residual;

/// Spacing of the rows of `range_bias.csv` \[m\].
const RANGE_STEP_M: f64 = 0.25;
/// Spacing of the rows of `correction.csv` \[s\].
const CORRECTION_SPACING_S: f64 = 0.05;

/// Writes all of them.
///
/// # Errors
/// When one cannot be written.
pub fn write_drive(
    project: &Project,
    matched: &Matched,
    drive: &DriveSolution,
    residuals: &[Residual],
    out: &Path,
    csv: bool,
) -> Result<()> {
    write_ties(project, matched, drive, residuals, out, csv)?;
    whole_or_none(out, "picked.csv", points::picked_text(&drive.picked).as_deref())?;
    write_calibration(project, &drive.calibrated(), out)?;
    write_correction_of(matched, drive, out)
}

/// Writes a file, or takes away that of an earlier run, which does not belong to this one.
fn whole_or_none(out: &Path, name: &str, text: Option<&str>) -> Result<()> {
    let path = out.join(name);
    let Some(text) = text else {
        return match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("{} is of an earlier run", path.display()))
            }
            _ => Ok(()),
        };
    };
    write_whole(&path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
}

/// Writes `calibration.toml` and `range_bias.csv`, and `range_bias_over.csv` where there are curves over incidence or intensity.
///
/// # Errors
/// When one cannot be written.
pub fn write_calibration(project: &Project, calibrated: &Calibrated<'_>, out: &Path) -> Result<()> {
    whole_or_none(out, "range_bias.csv", Some(&range_bias(calibrated)))?;
    whole_or_none(out, "range_bias_over.csv", range_bias_over(calibrated).as_deref())?;
    whole_or_none(out, "calibration.toml", Some(&calibration::text(project, calibrated)))
}

/// `ties.parquet`, and `ties.csv` when asked: every end of every line.
fn write_ties(
    project: &Project,
    matched: &Matched,
    drive: &DriveSolution,
    residuals: &[Residual],
    out: &Path,
    csv: bool,
) -> Result<()> {
    // what became of each line: used, or why not
    let mut fate: BTreeMap<usize, (bool, &str)> = BTreeMap::new();
    for (parts, used) in drive.chosen.of.iter().zip(&drive.solution.ties) {
        for (line, _) in parts {
            let entry = fate.entry(*line).or_insert((false, ""));
            match used.why_not {
                None => *entry = (true, ""),
                Some(why) if !entry.0 => entry.1 = why,
                Some(_) => {}
            }
        }
    }
    let by_line: BTreeMap<usize, &Residual> = residuals.iter().map(|r| (r.line, r)).collect();
    let mut table = TieTable::default();
    for (i, line) in drive.lines.iter().enumerate() {
        let (used, why_not) = fate.get(&i).copied().unwrap_or((false, if line.held_out { "" } else { "budget" }));
        let residual = by_line.get(&i);
        for (k, end) in line.ends.iter().enumerate() {
            let increment = line.visits() == 1;
            push(
                &mut table,
                project,
                matched,
                &Row {
                    id: line.row,
                    number: end.number,
                    patch: &drive.ties(matched).lines[line.row].ends[end.number].patch,
                    kind: if increment { "increment" } else { "surface_line" },
                    class: line.class().as_str(),
                    sigma_m: end.sighting.covariance_m2[(0, 0)].sqrt(),
                    before_m: residual.map_or(f64::NAN, |r| r.before_m[k]),
                    after_m: residual.map_or(f64::NAN, |r| r.after_m[k]),
                    used,
                    held_out: line.held_out,
                    why_not,
                },
            );
        }
    }
    points::push_points(&mut table, project, matched, drive);
    write_parquet(&out.join("ties.parquet"), &table)?;
    if csv {
        write_csv(&out.join("ties.csv"), &table)?;
    }
    Ok(())
}

/// Ranges of a scanner's curve, a quarter of a metre apart.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
pub fn ranges_of_curve(calibrated: &Calibrated<'_>, scanner: usize) -> impl Iterator<Item = f64> + use<> {
    let (near_m, far_m) = calibrated.ranges_m.get(scanner).copied().unwrap_or((0.0, -1.0));
    let first = (near_m / RANGE_STEP_M).ceil() as i64;
    let last = (far_m / RANGE_STEP_M).floor() as i64;
    (first..=last).map(|k| k as f64 * RANGE_STEP_M)
}

fn range_bias(calibrated: &Calibrated<'_>) -> String {
    let mut text = String::from("scanner,range_m,bias_m,sigma_m\n");
    for scanner in 0..calibrated.ranges_m.len() {
        for range_m in ranges_of_curve(calibrated, scanner) {
            let (bias_m, sigma_m) = calibrated.bias_at(scanner, range_m).unwrap_or((0.0, 0.0));
            let _ = writeln!(text, "{scanner},{range_m:.2},{bias_m:.6},{sigma_m:.6}");
        }
    }
    text
}

fn range_bias_over(calibrated: &Calibrated<'_>) -> Option<String> {
    let mut text = String::from("scanner,over,at,bias_m,sigma_m\n");
    let header = text.len();
    for own in &calibrated.constants.over {
        for place in own.rows() {
            let Some((bias_m, sigma_m)) = calibrated.bias_over(own, place) else { continue };
            let (over, at) = (own.over.as_str(), own.over.value(place));
            let _ = writeln!(text, "{},{over},{at:.2},{bias_m:.6},{sigma_m:.6}", own.scanner);
        }
    }
    (text.len() > header).then_some(text)
}

/// New minus old pose over the time of the strips, calibration apart.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
pub fn corrections(matched: &Matched, drive: &DriveSolution, spacing_s: f64) -> Vec<CorrectionRow> {
    let strips = matched.strips.strips();
    let start_s = strips.iter().map(|s| s.start_s).fold(f64::INFINITY, f64::min);
    let end_s = strips.iter().map(|s| s.end_s).fold(f64::NEG_INFINITY, f64::max);
    let steps = ((end_s - start_s) / spacing_s).ceil().max(1.0) as usize;
    let wrap = |d: f64| (d + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
    (0..=steps)
        .filter_map(|k| {
            let time_s = start_s + (end_s - start_s) * k as f64 / steps as f64;
            let old = matched.poses.shared()?.pose_at(time_s)?;
            let new = drive.pose_at(time_s)?;
            let angles = |p: &tieline_filter::Pose| roll_pitch_heading_rad(&p.ned_from_body);
            let (a, b) = (angles(&old), angles(&new));
            let sigma = drive.trajectory.sigma_at(time_s)?;
            let (p, r) = (sigma.position_ned_m, sigma.attitude_rph_rad);
            Some(CorrectionRow {
                time_s,
                position_enu_m: new.position - old.position,
                attitude_rph_rad: Vector3::new(wrap(b.0 - a.0), wrap(b.1 - a.1), wrap(b.2 - a.2)),
                sigma: Vector6::new(p.y, p.x, p.z, r.x, r.y, r.z),
            })
        })
        .collect()
}

fn write_correction_of(matched: &Matched, drive: &DriveSolution, out: &Path) -> Result<()> {
    let correction = Correction::new(corrections(matched, drive, CORRECTION_SPACING_S)).context("correction.csv")?;
    let shift_s = matched.survey.strip_files().next().map_or(0.0, |f| f.time_shift_s);
    Ok(write_correction(&out.join("correction.csv"), &correction, -shift_s)?)
}
