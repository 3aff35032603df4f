//! The files that others read: ties, calibration, correction over time.

pub mod drive;
mod places;
pub mod stations;
pub mod tie_text;

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use nalgebra::{Rotation3, UnitQuaternion, Vector3, Vector6};
use tieline_filter::{Correction, CorrectionRow, frames::roll_pitch_heading_rad};
use tieline_graph::ParameterBlock;
use tieline_io::correction::write_correction;
use tieline_io::output::write_whole;
use tieline_io::ties::{TieRow, TieTable, write_csv, write_parquet};
use tieline_matching::{Patch, Rejection, measure};

use crate::job::Matched;
use crate::project::Project;
use crate::stage::solve::{CLASSES, Solution};
use crate::stage::ties::CONTROL_STRIP;
use crate::summary::{sighting_name, unit_of};

/// What an estimator found about an end: residual before and after, sigma, class; without a solution only the first.
struct Found {
    before_m: f64,
    after_m: f64,
    sigma_m: f64,
    class: &'static str,
    held_out: bool,
    outlier: bool,
}

/// Writes `ties.parquet`, and `ties.csv` when asked. Without a solution residuals are those before any correction.
///
/// # Errors
/// When a file cannot be written.
pub fn write_ties(
    project: &Project,
    matched: &Matched,
    solution: Option<&Solution>,
    out: &Path,
    csv: bool,
) -> Result<()> {
    let mut table = TieTable::default();
    let mut found: Vec<Vec<Option<Found>>> =
        matched.ties.lines.iter().map(|line| line.ends.iter().map(|_| None).collect()).collect();
    if let Some(solution) = solution {
        for (k, (row, ends)) in solution.rows.iter().enumerate() {
            let (before, after) = (&solution.lines_before[k], &solution.lines[k]);
            for (i, end) in ends.iter().enumerate() {
                let Some(result) = solution.adjustment.ends[k].get(i) else { continue };
                let residual = |line: &tieline_graph::Line| {
                    let mean = line.ends.iter().map(|e| e.offset_m / e.sigma_m.powi(2)).sum::<f64>()
                        / line.ends.iter().map(|e| e.sigma_m.powi(-2)).sum::<f64>();
                    line.ends.get(i).map_or(f64::NAN, |e| e.offset_m - mean)
                };
                found[*row][*end] = Some(Found {
                    before_m: residual(before),
                    after_m: residual(after),
                    sigma_m: result.sigma_m,
                    class: CLASSES.get(after.class).copied().unwrap_or(""),
                    held_out: after.held_out,
                    outlier: result.outlier,
                });
            }
        }
    }
    let held: std::collections::BTreeMap<usize, bool> =
        matched.ties.selected.iter().copied().zip(matched.ties.held_out.iter().copied()).collect();
    for (id, line) in matched.ties.lines.iter().enumerate() {
        let used: Vec<(usize, &Patch)> = line.used().collect();
        let patches: Vec<&Patch> = used.iter().map(|(_, p)| *p).collect();
        let measured = measure(&patches, matched.sigma_floor_m);
        let known = line.ends.iter().any(|e| e.patch.sighting.strip == CONTROL_STRIP);
        for (number, end) in line.ends.iter().enumerate() {
            let of_solution = found[id][number].as_ref();
            let place = used.iter().position(|(i, _)| *i == number);
            let offset = measured.as_ref().zip(place).map(|(m, p)| m.offsets[p]);
            let why = end.rejection.or_else(|| of_solution.filter(|f| f.outlier).map(|_| Rejection::Outlier));
            let held_out = of_solution.map_or_else(|| held.get(&id).copied().unwrap_or(false), |f| f.held_out);
            push(
                &mut table,
                project,
                matched,
                &Row {
                    id,
                    number,
                    patch: &end.patch,
                    kind: if known { "control" } else { "surface_line" },
                    class: of_solution.map_or("", |f| f.class),
                    sigma_m: of_solution.map_or_else(|| offset.map_or(f64::NAN, |o| o.1), |f| f.sigma_m),
                    before_m: of_solution.map_or_else(|| offset.map_or(f64::NAN, |o| o.0), |f| f.before_m),
                    after_m: of_solution.map_or(f64::NAN, |f| f.after_m),
                    used: why.is_none() && !held_out && held.contains_key(&id),
                    held_out: why.is_none() && held_out,
                    why_not: why.map_or("", Rejection::as_str),
                },
            );
        }
    }
    places::push(&mut table, project, matched, solution);
    write_parquet(&out.join("ties.parquet"), &table)?;
    if csv {
        write_csv(&out.join("ties.csv"), &table)?;
    }
    Ok(())
}

struct Row<'a> {
    id: usize,
    number: usize,
    patch: &'a Patch,
    kind: &'a str,
    class: &'a str,
    sigma_m: f64,
    before_m: f64,
    after_m: f64,
    used: bool,
    held_out: bool,
    why_not: &'a str,
}

#[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap)] // counts of one survey
fn push(table: &mut TieTable, project: &Project, matched: &Matched, row: &Row<'_>) {
    let patch = row.patch;
    let sighting = patch.sighting;
    let map_m = patch.centroid_m + matched.survey.origin();
    let nan = Vector3::repeat(f64::NAN);
    let scanner = project.platform.scanner.iter().find(|s| s.id == sighting.scanner);
    let lever_arm_m = scanner.map_or_else(Vector3::zeros, |s| Vector3::from(s.lever_arm_m));
    let (mut body_m, mut beam, mut range_m, mut incidence_deg) = (nan, nan, f64::NAN, f64::NAN);
    if let Some(pose) = matched.poses.at(sighting.strip, patch.time_s) {
        body_m = pose.body_vector_m(&map_m);
        let ray = body_m - lever_arm_m;
        range_m = ray.norm();
        let mounting = scanner.map_or_else(UnitQuaternion::identity, |s| {
            let [roll, pitch, yaw] = s.mounting_deg.map(f64::to_radians);
            let boresight = Rotation3::new(Vector3::from(s.boresight_deg).map(f64::to_radians));
            UnitQuaternion::from(boresight) * UnitQuaternion::from_euler_angles(roll, pitch, yaw)
        });
        beam = mounting.inverse() * ray / range_m;
        let in_map = pose.map_from_ned * (pose.ned_from_body * (ray / range_m));
        incidence_deg = in_map.normalize().dot(&patch.normal).abs().clamp(0.0, 1.0).acos().to_degrees();
    }
    let shift_s = matched.survey.strip_files().next().map_or(0.0, |f| f.time_shift_s);
    let name = if sighting.strip == CONTROL_STRIP { String::new() } else { sighting_name(matched, sighting) };
    let strip = name.split('/').next().unwrap_or_default();
    table.push(&TieRow {
        tie_id: row.id as i64,
        kind: row.kind,
        class: row.class,
        end: row.number as i32,
        strip,
        pass: i32::from(sighting.pass),
        scanner: i32::from(sighting.scanner),
        gps_time_s: patch.time_s - shift_s,
        body_x_m: body_m.x,
        body_y_m: body_m.y,
        body_z_m: body_m.z,
        beam_x: beam.x,
        beam_y: beam.y,
        beam_z: beam.z,
        range_m,
        incidence_deg,
        intensity: f64::from(patch.intensity),
        map_e_m: map_m.x,
        map_n_m: map_m.y,
        map_h_m: map_m.z,
        normal_e: patch.normal.x,
        normal_n: patch.normal.y,
        normal_u: patch.normal.z,
        sigma_m: row.sigma_m,
        residual_before_m: row.before_m,
        residual_after_m: row.after_m,
        used: row.used,
        held_out: row.held_out,
        why_not: row.why_not,
        ..TieRow::default()
    });
}

/// Spacing of the rows of `correction.csv` \[s\].
const CORRECTION_SPACING_S: f64 = 0.5;

/// Writes `correction.csv`: new minus old pose of every strip over time, calibration apart.
///
/// # Errors
/// When it cannot be written.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
pub fn write_corrections(matched: &Matched, solution: &Solution, out: &Path) -> Result<()> {
    let mut rows: Vec<CorrectionRow> = Vec::new();
    for (i, strip) in matched.strips.strips().iter().enumerate() {
        let number = i as u32;
        let steps = ((strip.end_s - strip.start_s) / CORRECTION_SPACING_S).ceil().max(1.0) as usize;
        for k in 0..=steps {
            let time_s = strip.start_s + (strip.end_s - strip.start_s) * k as f64 / steps as f64;
            let Some(pose) = matched.poses.at(number, time_s) else { continue };
            let correction = solution.model.pose_correction(i, time_s);
            let old = roll_pitch_heading_rad(&pose.ned_from_body);
            let turned = UnitQuaternion::from_scaled_axis(correction.rotation_ned_rad) * pose.ned_from_body;
            let new = roll_pitch_heading_rad(&turned);
            let wrap = |d: f64| (d + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
            rows.push(CorrectionRow {
                time_s,
                position_enu_m: pose.map_from_ned * correction.position_ned_m,
                attitude_rph_rad: Vector3::new(wrap(new.0 - old.0), wrap(new.1 - old.1), wrap(new.2 - old.2)),
                sigma: sigma_at(solution, i, time_s),
            });
        }
    }
    rows.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    rows.dedup_by(|later, kept| later.time_s <= kept.time_s);
    let shift_s = matched.survey.strip_files().next().map_or(0.0, |f| f.time_shift_s);
    let correction = Correction::new(rows).context("correction.csv")?;
    Ok(write_correction(&out.join("correction.csv"), &correction, -shift_s)?)
}

/// Sigma of a strip's correction: east, north, up \[m\]; roll, pitch, heading taken as rotations about north, east,
/// down \[rad\] (to first order; they differ by the course only).
fn sigma_at(solution: &Solution, strip: usize, time_s: f64) -> Vector6<f64> {
    let Some((first, basis)) = solution.model.strip_basis(strip) else { return Vector6::zeros() };
    let (k0, weights, n) = basis.at(time_s);
    let sigma = |component: usize| {
        let mut variance = 0.0;
        for a in 0..n {
            for b in 0..n {
                let (i, j) = (first + (k0 + a) * 6 + component, first + (k0 + b) * 6 + component);
                variance += weights[a] * weights[b] * solution.adjustment.covariance[(i, j)];
            }
        }
        variance.max(0.0).sqrt()
    };
    Vector6::new(sigma(1), sigma(0), sigma(2), sigma(3), sigma(4), sigma(5))
}

/// Writes `calibration.toml`: nominal plus estimated values, loadable as `[platform]`, with sigmas, correlations and
/// observability as comments and in tables of their own.
///
/// # Errors
/// When it cannot be written.
pub fn write_calibration(project: &Project, matched: &Matched, solution: &Solution, out: &Path) -> Result<()> {
    let text = calibration_text(project, matched, solution);
    write_whole(&out.join("calibration.toml"), text.as_bytes())
        .with_context(|| String::from("writing calibration.toml"))
}

fn calibration_text(project: &Project, matched: &Matched, solution: &Solution) -> String {
    let mut text = String::from(
        "# Calibration estimated by tieline: copy [platform] into a project file to start from it.\n\
         # Range terms are not part of [platform]: they stand in [[estimate]].\n\n[platform]\n",
    );
    if let Some(arm) = project.platform.gnss_lever_arm_m {
        let _ = writeln!(text, "gnss_lever_arm_m = {arm:?}");
    }
    let last_mission = solution.setup.blocks.iter().map(|b| b.mission).max().unwrap_or(0);
    for (i, block) in solution.setup.blocks.iter().enumerate().filter(|(_, b)| b.mission == last_mission) {
        let nominal = project.platform.scanner.iter().find(|s| s.id == block.scanner).cloned().unwrap_or_default();
        let c = solution.model.calibration(i);
        let before = Rotation3::new(Vector3::from(nominal.boresight_deg).map(f64::to_radians));
        let boresight = (Rotation3::new(c.boresight_rad) * before).scaled_axis().map(f64::to_degrees);
        let arm = Vector3::from(nominal.lever_arm_m) + c.lever_arm_m;
        let _ = writeln!(
            text,
            "\n[[platform.scanner]]\nid = {}\nlever_arm_m = [{:.5}, {:.5}, {:.5}]\nmounting_deg = {:?}\n\
             boresight_deg = [{:.6}, {:.6}, {:.6}]",
            block.scanner, arm.x, arm.y, arm.z, nominal.mounting_deg, boresight.x, boresight.y, boresight.z
        );
    }
    let covariance = &solution.adjustment.covariance;
    let of_calibration: Vec<usize> = (0..solution.parameters().len())
        .filter(|i| matches!(solution.parameters()[*i].block, ParameterBlock::Calibration(_)))
        .collect();
    for i in &of_calibration {
        let p = &solution.parameters()[*i];
        let ParameterBlock::Calibration(block) = p.block else { continue };
        let (unit, factor) = unit_of(p);
        let sigma = covariance[(*i, *i)].max(0.0).sqrt();
        let correlations: Vec<String> = of_calibration
            .iter()
            .filter(|j| *j != i)
            .filter_map(|j| {
                let r = covariance[(*i, *j)] / (sigma * covariance[(*j, *j)].sqrt()).max(1e-300);
                let q = &solution.parameters()[*j];
                (r.abs() > 0.5 && q.block == p.block).then(|| format!("\"{}\" = {r:.2}", q.name))
            })
            .collect();
        let b = solution.setup.blocks[block];
        let _ = writeln!(
            text,
            "\n[[estimate]]\nscanner = {}\nmission = {}\nname = \"{}\"\nunit = \"{unit}\"\nvalue = {:.6}\nsigma = {:.6}\n\
             prior_sigma = {:.6}\nobserved = {:.3} # 0: held by its prior, 1: free of it\ncorrelation = {{ {} }}",
            b.scanner,
            b.mission,
            p.name,
            solution.model.state()[*i] * factor,
            sigma * factor,
            p.prior_sigma * factor,
            solution.adjustment.observability.share[*i],
            correlations.join(", ")
        );
    }
    let _ = matched;
    text
}
