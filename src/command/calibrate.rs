//! `calibrate`: how the scanners of a vehicle are mounted.

mod drives;

use std::io::Write;

use anyhow::{Context, Result, bail};

use crate::cli::{CalibrateArgs, Common};
use crate::command::drive;
use crate::command::project::out_folder;
use crate::job::Clock;
use crate::memory::peak_bytes;
use crate::outputs::stations::write_stations;
use crate::progress::Progress;
use crate::project::Project;
use crate::report::stations::{StationsReport, three_lines, write_report};
use crate::settings::Setting;
use crate::stage::stations::read::stations;
use crate::stage::stations::{Mounts, StationOptions, calibrate};

/// Calibrates the scanners of one project or more.
///
/// # Errors
/// Whatever stops a stage.
pub fn run(args: &CalibrateArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let projects: Vec<Project> = args.projects.iter().map(|file| Project::load(file)).collect::<Result<_, _>>()?;
    for (file, project) in args.projects.iter().zip(&projects) {
        if !drive::is_drive(project) && project.stations.is_empty() {
            bail!(
                "{}: `calibrate` works on [[stations]], and on drives, which have [[strips]] and [imu]; scanners of other strips are \
                 calibrated within `tieline run`",
                file.display()
            );
        }
    }
    if projects.iter().all(drive::is_drive) {
        return drives::run(args, &projects, common, out);
    }
    let ([file], [project]) = (args.projects.as_slice(), projects.as_slice()) else {
        bail!(
            "several projects in one calibration are drives; stations of several folders go into one project with several [[stations]]"
        );
    };
    of_stations(project, &out_folder(file, args.out.as_ref()), args.csv, common, out)
}

/// The calibration of stations without a trajectory.
///
/// # Errors
/// Whatever is wrong with the files, the mounting or the geometry.
pub fn of_stations(
    project: &Project,
    folder: &std::path::Path,
    csv: bool,
    common: &Common,
    out: &mut impl Write,
) -> Result<()> {
    let mut clock = Clock::default();
    let mounts = Mounts::of(project)?;
    let (options, settings) = settings(project, &mounts);
    let progress = Progress::new(common.quiet || common.json);
    let bar = progress.spinner("calibrating scanners");
    let read = clock.time("read", || stations(project, &mounts))?;
    let solution = clock.time("calibrate", || calibrate(&read.stations, &mounts, &options))?;
    bar.finish_and_clear();
    std::fs::create_dir_all(folder)
        .with_context(|| format!("the output folder {} cannot be created", folder.display()))?;
    clock.time("write", || write_stations(project, &mounts, &read.stations, &solution, folder, csv))?;
    let report = StationsReport {
        name: project.name(),
        mounts: &mounts,
        read: &read,
        solution: &solution,
        settings: &settings,
        timing: clock.timing(read.inputs.iter().map(|i| i.1).sum()),
        peak_memory_bytes: peak_bytes(),
    };
    let summary = write_report(folder, &report)?;
    if common.json {
        serde_json::to_writer_pretty(&mut *out, &summary)?;
        writeln!(out)?;
    } else if !common.quiet {
        for note in summary.notes.iter().chain(&summary.calibration.not_seen) {
            tracing::info!("{note}");
        }
        for u in summary.calibration.unknowns.iter().filter(|_| common.verbose) {
            writeln!(out, "scanner {} {}: {:.4} ± {:.4} {}", u.scanner, u.name, u.value, u.sigma, u.unit)?;
        }
        writeln!(out, "{}", three_lines(&summary, &folder.join("report.html")))?;
    }
    Ok(())
}

/// Options with where they come from.
fn settings(project: &Project, mounts: &Mounts) -> (StationOptions, Vec<Setting>) {
    let mut options = StationOptions::default();
    let mut settings = Vec::new();
    let mut note = |key: &str, value: String, asked: bool, otherwise: &str| {
        let reason = if asked { "as asked" } else { otherwise };
        settings.push(Setting { key: key.to_string(), value, reason: reason.to_string() });
    };
    let m = &project.matching;
    options.planar.min_points = m.min_points.map_or(options.planar.min_points, |n| n.max(4) as usize);
    options.planar.max_roughness_m = m.max_roughness_m.unwrap_or(options.planar.max_roughness_m);
    options.search_m = m.search_m.unwrap_or(options.search_m);
    options.normal_angle_rad = m.normal_angle_deg.map_or(options.normal_angle_rad, f64::to_radians);
    options.hold_out = m.hold_out.unwrap_or(options.hold_out);
    options.seed = m.seed.unwrap_or(options.seed);
    note("match.min_points", options.planar.min_points.to_string(), m.min_points.is_some(), "default");
    note(
        "match.max_roughness_m",
        options.planar.max_roughness_m.to_string(),
        m.max_roughness_m.is_some(),
        "twice the range noise of spinning scanners",
    );
    note(
        "match.search_m",
        options.search_m.to_string(),
        m.search_m.is_some(),
        "beyond what the mounting explains: ten times what is left at the end",
    );
    note(
        "match.normal_angle_deg",
        format!("{:.1}", options.normal_angle_rad.to_degrees()),
        m.normal_angle_deg.is_some(),
        "beyond what the mounting and the sigmas of the normals explain",
    );
    note("match.hold_out", options.hold_out.to_string(), m.hold_out.is_some(), "a fifth, by place");
    note("match.seed", options.seed.to_string(), m.seed.is_some(), "default");
    let given = project.extrinsics.as_ref();
    note(
        "extrinsics.reference",
        mounts.heads[mounts.reference].scanner.to_string(),
        given.is_some_and(|e| e.reference != 0),
        "the first scanner",
    );
    note(
        "extrinsics.boresight_sigma_deg",
        format!("{:.2}", mounts.boresight_sigma_rad.to_degrees()),
        false,
        "rough extrinsics are up to two of them off",
    );
    note(
        "extrinsics.lever_arm_sigma_m",
        mounts.lever_arm_sigma_m.to_string(),
        false,
        "rough extrinsics are up to two of them off",
    );
    (options, settings)
}
