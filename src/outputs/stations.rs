//! The files of a calibration of stations: ties and calibration.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use nalgebra::{Rotation3, Vector3};
use tieline_io::output::write_whole;
use tieline_io::ties::{TieRow, TieTable, write_csv, write_parquet};

use crate::project::Project;
use crate::stage::stations::pairs::Fate;
use crate::stage::stations::solve::calibrated_patch;
use crate::stage::stations::{Mounts, Station, StationsSolution};

/// Writes `ties.parquet`, `ties.csv` when asked, and `calibration.toml`.
///
/// # Errors
/// When one cannot be written.
pub fn write_stations(
    project: &Project,
    mounts: &Mounts,
    stations: &[Station],
    solution: &StationsSolution,
    out: &Path,
    csv: bool,
) -> Result<()> {
    let table = ties(mounts, stations, solution);
    write_parquet(&out.join("ties.parquet"), &table)?;
    if csv {
        write_csv(&out.join("ties.csv"), &table)?;
    }
    let path = out.join("calibration.toml");
    write_whole(&path, calibration(project, mounts, stations, solution).as_bytes())
        .with_context(|| format!("writing {}", path.display()))
}

/// Every end of every common plane. Body vectors and beams are those of the rough mounting; the place and the normal
/// (`map_*`, `normal_*`) are in the body frame of the station turned to right-handed axes forward, left, up.
#[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap)] // numbers of planes and scanners
fn ties(mounts: &Mounts, stations: &[Station], solution: &StationsSolution) -> TieTable {
    let mut table = TieTable::default();
    for (id, tie) in solution.planes.iter().enumerate() {
        let plane = &tie.plane;
        for k in 0..2 {
            let head = &mounts.heads[plane.heads[k]];
            let patch = &solution.patches[plane.station][plane.heads[k]][plane.patches[k]];
            let now = calibrated_patch(patch, plane.heads[k], mounts, &solution.corrections);
            let ray = patch.centroid_m - head.lever_arm_m;
            let beam = head.body_from_scanner.inverse() * ray.normalize();
            let incidence = ray.normalize().dot(&patch.normal).abs().min(1.0).acos().to_degrees();
            let sign = if k == 0 { 0.5 } else { -0.5 };
            table.push(&TieRow {
                tie_id: id as i64,
                kind: "surface_line",
                class: plane.slope.as_str(),
                end: k as i32,
                strip: &stations[plane.station].name,
                pass: 0,
                scanner: i32::from(head.scanner),
                gps_time_s: patch.time_s,
                body_x_m: patch.centroid_m.x,
                body_y_m: patch.centroid_m.y,
                body_z_m: patch.centroid_m.z,
                beam_x: beam.x,
                beam_y: beam.y,
                beam_z: beam.z,
                range_m: ray.norm(),
                incidence_deg: incidence,
                intensity: f64::from(patch.intensity),
                map_e_m: now.centroid_m.x,
                map_n_m: -now.centroid_m.y,
                map_h_m: -now.centroid_m.z,
                normal_e: tie.normal.x,
                normal_n: -tie.normal.y,
                normal_u: -tie.normal.z,
                sigma_m: tie.sigma_m[k],
                residual_before_m: sign * tie.before_m,
                residual_after_m: sign * tie.after_m,
                used: plane.fate == Fate::Used && !tie.outlier,
                held_out: plane.fate == Fate::HeldOut,
                why_not: match (plane.fate, tie.outlier) {
                    (Fate::Used, true) => "outlier",
                    (Fate::Mixed, _) => "border_of_held_out",
                    _ => "",
                },
                ..TieRow::default()
            });
        }
    }
    table
}

fn calibration(project: &Project, mounts: &Mounts, stations: &[Station], solution: &StationsSolution) -> String {
    let mut text = String::from(
        "# Calibration estimated by tieline: copy [platform] into a project file to start from it.\n\
         # Body frame: forward, right, down; mounting_deg is the rough mounting, boresight_deg its correction on the left.\n\n[platform]\n",
    );
    if let Some(arm) = project.platform.gnss_lever_arm_m {
        let _ = writeln!(text, "gnss_lever_arm_m = {arm:?}");
    }
    for (i, head) in mounts.heads.iter().enumerate() {
        let correction = solution.corrections[i];
        let (roll, pitch, yaw) = head.body_from_scanner.euler_angles();
        let boresight = Rotation3::new(correction.boresight_rad).scaled_axis();
        let arm: Vector3<f64> = head.lever_arm_m + correction.lever_arm_m;
        let reference = if i == mounts.reference { ": the reference, as given" } else { "" };
        let _ = writeln!(
            text,
            "\n[[platform.scanner]] # {}{reference}\nid = {}\nlever_arm_m = [{:.5}, {:.5}, {:.5}]\n\
             mounting_deg = [{:.6}, {:.6}, {:.6}]\nboresight_deg = [{:.6}, {:.6}, {:.6}]",
            one_line(&head.name),
            head.scanner,
            arm.x,
            arm.y,
            arm.z,
            roll.to_degrees(),
            pitch.to_degrees(),
            yaw.to_degrees(),
            boresight.x.to_degrees(),
            boresight.y.to_degrees(),
            boresight.z.to_degrees()
        );
    }
    let scanners: Vec<u16> = mounts.calibrated().map(|h| h.scanner).collect();
    for (i, p) in solution.parameters.iter().enumerate() {
        let (unit, factor) = if p.is_angle { ("deg", 1f64.to_degrees()) } else { ("m", 1.0) };
        let sigma = solution.covariance[(i, i)].max(0.0).sqrt();
        let own = 6 * (i / 6)..6 * (i / 6) + 6;
        let correlations: Vec<String> = own
            .filter(|j| *j != i)
            .filter_map(|j| {
                let r = solution.covariance[(i, j)] / (sigma * solution.covariance[(j, j)].sqrt()).max(1e-300);
                (r.abs() > 0.5).then(|| format!("\"{}\" = {r:.2}", solution.parameters[j].name))
            })
            .collect();
        let _ = writeln!(
            text,
            "\n[[estimate]]\nscanner = {}\nname = \"{}\"\nunit = \"{unit}\"\nvalue = {:.6}\nsigma = {:.6}\nprior_sigma = {:.6}\n\
             observed = {:.4} # 0: held by its prior, 1: free of it\ncorrelation = {{ {} }}",
            scanners[i / 6],
            p.name,
            solution.values[i] * factor,
            sigma * factor,
            p.prior_sigma * factor,
            solution.sight.share[i],
            correlations.join(", ")
        );
    }
    let words: Vec<String> = solution
        .sight
        .words(mounts, &solution.parameters)
        .iter()
        .map(|w| format!("    {:?},\n", one_line(w)))
        .collect();
    let _ = write!(text, "\n[sight]\nstations = {}\nwords = [\n{}]\n", stations.len(), words.concat());
    text
}

/// A name that cannot end the line it stands in.
fn one_line(text: &str) -> String {
    text.replace(|c: char| c.is_control(), " ")
}
