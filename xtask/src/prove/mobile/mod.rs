//! Drives through the program: an independent simulator's, and our own scenarios over seeds.

mod block;
mod loops;
mod tunnel;

pub(crate) use block::block;
pub(crate) use loops::loop_closure;
pub(crate) use tunnel::odometer_of_two_scanners;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use nalgebra::Vector3;
use serde_json::Value;
use tieline_filter::Trajectory;
use tieline_io::trajectory::{ReadOptions, read};

use super::real::{program, root};

const SEEDS: u64 = 10;

/// Runs the program and shows what it says when it fails.
fn tieline(arguments: &[&str]) -> Result<()> {
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

fn text(path: &Path) -> Result<&str> {
    path.to_str().context("a path in UTF-8")
}

/// A scenario with a seed, changed, simulated into a folder; gives the project file.
fn simulate(scenario: &str, seed: u64, folder: &Path, change: impl Fn(String) -> String) -> Result<PathBuf> {
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

fn errors(data: &Path, solution: &Path) -> Result<Errors> {
    let load = |path: &Path, accuracy: Option<PathBuf>| -> Result<Trajectory> {
        Ok(read(path, &ReadOptions { format: None, columns: None, accuracy })?.trajectory)
    };
    let truth = load(&data.join("truth/truth.sbet"), None)?;
    let new = load(&solution.join("trajectory.sbet"), Some(solution.join("trajectory_rms.out")))?;
    let outages: Vec<(f64, f64)> = std::fs::read_to_string(data.join("truth/outages.csv"))?
        .lines()
        .skip(1)
        .filter_map(|l| {
            let mut fields = l.split(',').map(|f| f.parse::<f64>().ok());
            Some((fields.next()??, fields.next()??))
        })
        .collect();
    let (mut largest, mut plan, mut inside, mut all) = ([0.0_f64; 3], 0.0_f64, 0_u32, 0_u32);
    for (i, time_s) in new.time_s().iter().enumerate().step_by(20) {
        if !outages.iter().any(|(a, b)| time_s > a && time_s <= b) {
            continue;
        }
        let Some(true_pose) = truth.pose_at(*time_s) else { continue };
        let (p, q) = (new.position()[i], true_pose.position);
        let d = p - q;
        let error = Vector3::new(d.x * 6_371_000.0, d.y * 6_371_000.0 * q.x.cos(), -d.z);
        plan = plan.max(error.x.hypot(error.y));
        let sigma = new.sigma_at(*time_s).context("sigma")?.position_ned_m;
        for k in 0..3 {
            largest[k] = largest[k].max(error[k].abs());
            inside += u32::from(error[k].abs() <= 2.0 * sigma[k]);
            all += 1;
        }
    }
    Ok(Errors {
        largest_ned_m: largest,
        largest_plan_m: plan,
        inside: 100.0 * f64::from(inside) / f64::from(all.max(1)),
    })
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n % 2 == 1 { values[n / 2] } else { 0.5 * (values[n / 2 - 1] + values[n / 2]) }
}
