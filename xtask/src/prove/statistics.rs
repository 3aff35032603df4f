//! Simulated blocks: are the errors found as large as the sigmas say?

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use nalgebra::Vector3;
use tieline::job::{Clock, DEFAULT_MEMORY_BYTES, JobOptions, match_strips, solve_strips};
use tieline::progress::Progress;
use tieline::project::Project;
use tieline_graph::{ParameterBlock, model::Parameter};
use tieline_simulate::{Scenario, SimulationReport, simulate};

use super::Row;

const SEEDS: u64 = 20;

/// One estimated parameter against the truth.
struct Check {
    name: String,
    error: f64,
    sigma: f64,
    observable: bool,
}

/// The lines of the proof.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let mut checks = Vec::new();
    let mut unobservable: BTreeMap<String, usize> = BTreeMap::new();
    for seed in 1..=SEEDS {
        let folder = tempfile::tempdir()?;
        let report = simulate(&Scenario::airborne_block(seed), folder.path())?;
        let of_seed = solve_one(&report, folder.path())?;
        for check in of_seed.iter().filter(|c| !c.observable) {
            *unobservable.entry(check.name.clone()).or_default() += 1;
        }
        let shown: Vec<String> = of_seed
            .iter()
            .filter(|c| c.name.starts_with("boresight") || c.name.starts_with("lever") || c.name.starts_with("range"))
            .map(|c| {
                format!(
                    "{} {:+.2}σ (σ {:.5})",
                    c.name,
                    c.error / c.sigma,
                    if c.name.starts_with("boresight") { c.sigma.to_degrees() } else { c.sigma }
                )
            })
            .collect();
        println!("seed {seed}: {}", shown.join(", "));
        checks.extend(of_seed);
    }
    for (name, count) in &unobservable {
        println!("held by the prior: {name} in {count} of {SEEDS} seeds");
    }
    Ok(judge(&checks))
}

#[allow(clippy::cast_precision_loss)]
fn judge(checks: &[Check]) -> Vec<Row> {
    let observable: Vec<&Check> = checks.iter().filter(|c| c.observable).collect();
    let n = observable.len() as f64;
    let inside = observable.iter().filter(|c| c.error.abs() <= 1.96 * c.sigma).count() as f64 / n;
    let ratio = (observable.iter().map(|c| (c.error / c.sigma).powi(2)).sum::<f64>() / n).sqrt();
    let rms = |name: &str| {
        let rows: Vec<f64> = checks.iter().filter(|c| c.name == name).map(|c| c.error).collect();
        (rows.iter().map(|e| e * e).sum::<f64>() / rows.len().max(1) as f64).sqrt().to_degrees()
    };
    let mut rows = vec![
        Row::between(format!("inside the 95 % interval, {n} observable parameters"), 100.0 * inside, 90.0, 99.0, "%"),
        Row::between("rms error over predicted sigma", ratio, 0.8, 1.25, ""),
        Row::at_most("boresight roll, rms error", rms("boresight roll"), 0.001, "deg"),
        Row::at_most("boresight pitch, rms error", rms("boresight pitch"), 0.001, "deg"),
        Row::at_most("boresight yaw, rms error", rms("boresight yaw"), 0.003, "deg"),
    ];
    let held = checks.iter().filter(|c| !c.observable).count();
    rows.push(Row::between("parameters held by the prior and named", held as f64, 0.0, checks.len() as f64, ""));
    rows
}

fn solve_one(report: &SimulationReport, folder: &Path) -> Result<Vec<Check>> {
    let project = Project::load(&report.project)?;
    let options =
        JobOptions { out: folder.join("out"), memory_bytes: DEFAULT_MEMORY_BYTES, progress: Progress::silent() };
    let mut clock = Clock::default();
    let matched = match_strips(&project, &options, &mut clock)?;
    let solution = solve_strips(&project, &matched, &mut clock)?;
    if std::env::var_os("TIELINE_PROVE_VERBOSE").is_some() {
        for trial in &solution.trials {
            println!("{trial:?}");
        }
        println!(
            "ties {} selected {} class {:?} common {} timing {:?}",
            matched.ties.found,
            matched.ties.selected.len(),
            solution.adjustment.class_scale,
            solution.adjustment.common_mode_factor,
            clock.timing(matched.points)
        );
    }
    let shift_s = matched.survey.clock.shift_s(tieline_filter::TimeEncoding::SecondsOfWeek).unwrap_or(0.0);
    let mut checks = Vec::new();
    for (i, parameter) in solution.parameters().iter().enumerate() {
        let truth = match parameter.block {
            ParameterBlock::Calibration(_) => calibration_truth(report, &parameter.name),
            ParameterBlock::Strip(s) => {
                let strip = &matched.strips.strips()[s];
                let number =
                    usize::from(strip.source.point_source_id()).checked_sub(1).context("a strip without a number")?;
                let error = report.truth.strips.get(number).context("a strip that was not simulated")?;
                let at = |t: f64| (-error.position_ned_m(t - shift_s), -error.rotation_ned_rad(t - shift_s));
                strip_truth(parameter, at(strip.start_s), at(strip.end_s))
            }
        };
        let Some(truth) = truth else { continue };
        checks.push(Check {
            name: match parameter.block {
                ParameterBlock::Calibration(_) => parameter.name.clone(),
                ParameterBlock::Strip(_) => format!("strip {}", parameter.name),
            },
            error: solution.model.state()[i] - truth,
            sigma: solution.adjustment.covariance[(i, i)].sqrt(),
            observable: solution.adjustment.observability.is_observable(i),
        });
    }
    Ok(checks)
}

fn calibration_truth(report: &SimulationReport, name: &str) -> Option<f64> {
    let s = report.truth.scanners.first()?;
    let (b, a) = (s.boresight_error_rad, s.lever_arm_error_m);
    Some(match name {
        "boresight roll" => b.x,
        "boresight pitch" => b.y,
        "boresight yaw" => b.z,
        "lever arm forward" => a.x,
        "lever arm right" => a.y,
        "lever arm down" => a.z,
        "range offset" => s.range_offset_m,
        "range scale" => s.range_scale,
        _ => return None,
    })
}

/// Constant and drift of a correction that is linear from start to end.
fn strip_truth(
    parameter: &Parameter,
    start: (Vector3<f64>, Vector3<f64>),
    end: (Vector3<f64>, Vector3<f64>),
) -> Option<f64> {
    let (name, kind) = parameter.name.rsplit_once(' ')?;
    let axis = ["north", "east", "down"].iter().position(|a| name.ends_with(a))?;
    let pick = |v: &(Vector3<f64>, Vector3<f64>)| if name.starts_with("rotation") { v.1[axis] } else { v.0[axis] };
    match kind {
        "constant" => Some(0.5 * (pick(&start) + pick(&end))),
        "drift" => Some(0.5 * (pick(&end) - pick(&start))),
        _ => None,
    }
}
