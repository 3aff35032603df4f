//! Drives through the program: an independent simulator's, and our own scenarios over seeds.

mod ablation;
mod block;
mod calibration;
mod falsify;
mod loops;
mod time;
mod tunnel;

pub(crate) use ablation::ablations;
pub(crate) use block::block;
pub(crate) use loops::{calibration, false_ties, loop_closure};
pub(crate) use time::time;
pub(crate) use tunnel::odometer_of_two_scanners;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use anyhow::{Context, Result, ensure};
use nalgebra::Vector3;
use serde_json::Value;
use tieline_filter::Trajectory;
use tieline_io::trajectory::{ReadOptions, read};

use super::real::{program, root};

/// Seeds of the scenarios, as asked.
static SEEDS: OnceLock<u64> = OnceLock::new();

/// Sets the number of seeds; ten otherwise.
pub(crate) fn set_seeds(seeds: Option<u64>) {
    let _ = SEEDS.set(seeds.unwrap_or(10));
}

pub(crate) fn seeds() -> u64 {
    *SEEDS.get_or_init(|| 10)
}

/// Runs the program and shows what it says when it fails.
pub(crate) fn tieline(arguments: &[&str]) -> Result<()> {
    let output = Command::new(program()?).args(arguments).output()?;
    ensure!(output.status.success(), "tieline {arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    Ok(())
}

/// The judge's figures as JSON.
fn judge(arguments: &[&str]) -> Result<Value> {
    let file = tempfile::NamedTempFile::new()?;
    let output = Command::new("python3")
        .args(["-m", "mms_score.score"])
        .args(arguments)
        .arg("--json")
        .arg(file.path())
        .current_dir(root().join("../shared/check"))
        .output()
        .context("python3 with numpy, laspy and pyproj")?;
    ensure!(output.status.success(), "the judge: {}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&std::fs::read(file.path())?)?)
}

fn number(value: &Value, path: &[&str]) -> f64 {
    path.iter().fold(value, |v, key| &v[*key]).as_f64().unwrap_or(f64::NAN)
}

pub(crate) fn text(path: &Path) -> Result<&str> {
    path.to_str().context("a path in UTF-8")
}

/// A scenario with a seed, changed, simulated into a folder; gives the project file.
pub(crate) fn simulate(scenario: &str, seed: u64, folder: &Path, change: impl Fn(String) -> String) -> Result<PathBuf> {
    let source = std::fs::read_to_string(root().join(format!("samples/scenarios/{scenario}.toml")))?;
    let mut found = false;
    let lines = source.lines().map(|line| {
        if line.starts_with("seed = ") {
            found = true;
            format!("seed = {seed}\n")
        } else {
            format!("{line}\n")
        }
    });
    let text_of: String = lines.collect();
    ensure!(found, "{scenario}: no seed");
    let without_points = format!("{}\n[output]\ntrue_points = false\n", change(text_of));
    let file = folder.join("scenario.toml");
    std::fs::write(&file, without_points)?;
    let data = folder.join("data");
    tieline(&["simulate", "--quiet", text(&file)?, "--out", text(&data)?])?;
    Ok(data.join("project.toml"))
}

/// Largest errors in a drive's outages and how its sigma holds, against the truth.
struct Errors {
    largest_ned_m: [f64; 3],
    /// Of north and east together.
    largest_plan_m: f64,
    /// Share of epochs and components inside two sigma, in percent.
    inside: f64,
}

pub(crate) fn load(path: &Path, accuracy: Option<PathBuf>) -> Result<Trajectory> {
    Ok(read(path, &ReadOptions { format: None, columns: None, accuracy })?.trajectory)
}

fn solved(folder: &Path) -> Result<Trajectory> {
    load(&folder.join("trajectory.sbet"), Some(folder.join("trajectory_rms.out")))
}

/// The first two columns of a table below a header, from a column on.
pub(crate) fn windows(path: &Path, from: usize) -> Result<Vec<(f64, f64)>> {
    Ok(std::fs::read_to_string(path)?
        .lines()
        .skip(1)
        .filter_map(|l| {
            let mut fields = l.split(',').skip(from).map(|f| f.parse::<f64>().ok());
            Some((fields.next()??, fields.next()??))
        })
        .collect())
}

/// Of a solution in its folder, in the outages.
fn errors(data: &Path, solution: &Path) -> Result<Errors> {
    errors_within(data, &solved(solution)?, &windows(&data.join("truth/outages.csv"), 0)?)
}

/// North, east, down of one position from another \[m\].
pub(crate) fn apart_ned_m(p: &Vector3<f64>, from: &Vector3<f64>) -> Vector3<f64> {
    let d = p - from;
    Vector3::new(d.x * 6_371_000.0, d.y * 6_371_000.0 * from.x.cos(), -d.z)
}

/// Of a trajectory within stretches of time.
fn errors_within(data: &Path, new: &Trajectory, within: &[(f64, f64)]) -> Result<Errors> {
    let truth = load(&data.join("truth/truth.sbet"), None)?;
    let (mut largest, mut plan, mut inside, mut all) = ([0.0_f64; 3], 0.0_f64, 0_u32, 0_u32);
    for (i, time_s) in new.time_s().iter().enumerate().step_by(20) {
        if !within.iter().any(|(a, b)| time_s > a && time_s <= b) {
            continue;
        }
        let Some(true_pose) = truth.pose_at(*time_s) else { continue };
        let error = apart_ned_m(&new.position()[i], &true_pose.position);
        plan = plan.max(error.x.hypot(error.y));
        let sigma = new.sigma_at(*time_s).context("sigma")?.position_ned_m;
        for k in 0..3 {
            largest[k] = largest[k].max(error[k].abs());
            inside += u32::from(error[k].abs() <= 2.0 * sigma[k]);
            all += 1;
        }
    }
    ensure!(all > 0, "no epoch within {within:?}");
    Ok(Errors { largest_ned_m: largest, largest_plan_m: plan, inside: 100.0 * f64::from(inside) / f64::from(all) })
}

/// How far a solution moved from another of the same drive that knew less, over the sigma of the latter, within a stretch of time: root mean square, and the
/// largest of 95 % of epochs and components. A least-squares solution that learns more moves by `√(σ² - σ'²)`, one sigma, of which the root mean
/// square is therefore below 1 where sigmas hold; 95 % of normal deviates reach up to twice that.
#[allow(clippy::cast_precision_loss)]
fn moved_over_sigma(data: &Path, solution: &Path, (from_s, to_s): (f64, f64)) -> Result<(f64, f64)> {
    let (old, new) = (solved(data)?, solved(solution)?);
    let mut ratios = Vec::new();
    for (i, time_s) in new.time_s().iter().enumerate().step_by(20) {
        let (Some(before), true) = (old.pose_at(*time_s), *time_s > from_s && *time_s <= to_s) else { continue };
        let moved = apart_ned_m(&new.position()[i], &before.position);
        let sigma = old.sigma_at(*time_s).context("sigma")?.position_ned_m;
        ratios.extend((0..3).map(|k| moved[k].abs() / sigma[k]));
    }
    ratios.sort_by(f64::total_cmp);
    let rms = (ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len() as f64).sqrt();
    Ok((rms, ratios.get(ratios.len() * 95 / 100).copied().context("epochs")?))
}

pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n % 2 == 1 { values[n / 2] } else { 0.5 * (values[n / 2 - 1] + values[n / 2]) }
}
