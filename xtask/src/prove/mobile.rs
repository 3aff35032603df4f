//! Drives through the program: an independent simulator's, and our own scenarios over seeds.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use nalgebra::Vector3;
use serde_json::Value;
use tieline_filter::Trajectory;
use tieline_io::trajectory::{ReadOptions, read};

use super::Row;
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

/// Line 1: the drive of an independent simulator.
pub(crate) fn block() -> Result<Vec<Row>> {
    let out = tempfile::tempdir()?;
    let project = root().join("samples/real/mms-sim-block.toml");
    tieline(&["run", "--quiet", "--overwrite", "--out", text(out.path())?, text(&project)?])?;
    let data = "../data/mms-sim-block";
    let file = |name: &str| out.path().join(name).to_string_lossy().into_owned();
    let mut rows = Vec::new();
    let trajectory = judge(&["traj", data, &file("trajectory.sbet")])?;
    let outage = trajectory
        .as_object()
        .and_then(|o| o.iter().find(|(k, _)| k.starts_with("outage 1")))
        .map(|(_, v)| v["produced"].clone())
        .context("an outage")?;
    for (axis, bound) in [("N", 0.025), ("E", 0.025), ("D", 0.020)] {
        let value = number(&outage, &[&format!("{axis}_max")]);
        rows.push(Row::at_most(format!("mms-sim-block: largest error {axis} in the outage"), value, bound, "m"));
    }
    let heading = number(&outage, &["heading_rms"]);
    rows.push(Row::at_most("mms-sim-block: heading rms in the outage", heading, 0.009, "deg"));
    for (pass, median, most) in [("pass1.laz", 11.2, 20.6), ("pass2.laz", 15.0, 32.0)] {
        let points = judge(&["points", data, &file(&format!("corrected/{pass}")), "--strip", pass])?;
        let p = |k: usize| 1e3 * points["all"]["produced"]["p3d"][k].as_f64().unwrap_or(f64::NAN);
        rows.push(Row::at_most(format!("mms-sim-block: {pass}, 3-D error, median"), p(0), median, "mm"));
        rows.push(Row::at_most(format!("mms-sim-block: {pass}, 3-D error, 95 %"), p(3), most, "mm"));
    }
    let heights = judge(&["dz", data, "--strips", &file("corrected")])?;
    for pass in ["pass 1 s1-s2", "pass 2 s1-s2"] {
        let median = 1e3 * number(&heights, &["produced", pass, "median"]).abs();
        rows.push(Row::at_most(format!("mms-sim-block: ground, {pass}, |median|"), median, 1.0, "mm"));
    }
    let spread = 1e3 * number(&heights, &["produced", "pass 1-pass 2 outage", "nmad"]);
    rows.push(Row::at_most("mms-sim-block: ground, pass 2 - pass 1 in the outage, NMAD", spread, 6.0, "mm"));
    let bias = judge(&["bias", data, &file("range_bias.csv")])?;
    let curve = number(&bias, &["by point count/common constant", "produced"]);
    rows.push(Row::at_most("mms-sim-block: range bias, rms of the curves' errors", curve, 1.0, "mm"));
    Ok(rows)
}

/// A scenario with a seed, simulated into a folder; gives the project file.
fn simulate(scenario: &str, seed: u64, folder: &Path) -> Result<PathBuf> {
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
    let without_points = format!("{text_of}\n[output]\ntrue_points = false\n");
    let file = folder.join("scenario.toml");
    std::fs::write(&file, without_points)?;
    let data = folder.join("data");
    tieline(&["simulate", "--quiet", text(&file)?, "--out", text(&data)?])?;
    Ok(data.join("project.toml"))
}

/// Largest errors in a drive's outages and how its sigma holds, against the truth.
struct Errors {
    largest_ned_m: [f64; 3],
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
    let (mut largest, mut inside, mut all) = ([0.0_f64; 3], 0_u32, 0_u32);
    for (i, time_s) in new.time_s().iter().enumerate().step_by(20) {
        if !outages.iter().any(|(a, b)| time_s > a && time_s <= b) {
            continue;
        }
        let Some(true_pose) = truth.pose_at(*time_s) else { continue };
        let (p, q) = (new.position()[i], true_pose.position);
        let d = p - q;
        let error = Vector3::new(d.x * 6_371_000.0, d.y * 6_371_000.0 * q.x.cos(), -d.z);
        let sigma = new.sigma_at(*time_s).context("sigma")?.position_ned_m;
        for k in 0..3 {
            largest[k] = largest[k].max(error[k].abs());
            inside += u32::from(error[k].abs() <= 2.0 * sigma[k]);
            all += 1;
        }
    }
    Ok(Errors { largest_ned_m: largest, inside: 100.0 * f64::from(inside) / f64::from(all.max(1)) })
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n % 2 == 1 { values[n / 2] } else { 0.5 * (values[n / 2 - 1] + values[n / 2]) }
}

/// Line 2: a loop through an outage.
pub(crate) fn loop_closure() -> Result<Vec<Row>> {
    let (mut north, mut east, mut down, mut inside) = (vec![], vec![], vec![], vec![]);
    let mut before = Vec::new();
    for seed in 1..=SEEDS {
        let folder = tempfile::tempdir()?;
        let project = simulate("loop113", seed, folder.path())?;
        let out = folder.path().join("out");
        tieline(&["run", "--quiet", "--out", text(&out)?, text(&project)?])?;
        let data = folder.path().join("data");
        let after = errors(&data, &out)?;
        let handed_out = errors(&data, &data)?;
        println!(
            "seed {seed}: handed out N {:.3} E {:.3} D {:.3} m, now N {:.3} E {:.3} D {:.3} m, {:.0} % inside 2 sigma",
            handed_out.largest_ned_m[0],
            handed_out.largest_ned_m[1],
            handed_out.largest_ned_m[2],
            after.largest_ned_m[0],
            after.largest_ned_m[1],
            after.largest_ned_m[2],
            after.inside
        );
        before.push(handed_out.largest_ned_m[0].hypot(handed_out.largest_ned_m[1]));
        for (all, value) in [&mut north, &mut east, &mut down].into_iter().zip(after.largest_ned_m) {
            all.push(value);
        }
        inside.push(after.inside);
    }
    let mut rows = vec![Row::between(
        "loop113: handed out, largest plan error, median",
        median(&mut before),
        0.10,
        f64::INFINITY,
        "m",
    )];
    for (axis, values, middle, worst) in
        [("north", &mut north, 0.02, 0.03), ("east", &mut east, 0.02, 0.03), ("down", &mut down, 0.015, 0.025)]
    {
        rows.push(Row::at_most(format!("loop113: largest error {axis}, median of seeds"), median(values), middle, "m"));
        let most = values.iter().copied().fold(0.0, f64::max);
        rows.push(Row::at_most(format!("loop113: largest error {axis}, worst seed"), most, worst, "m"));
    }
    let mean = inside.iter().sum::<f64>() / inside.len() as f64;
    rows.push(Row::between("loop113: errors inside 2 sigma", mean, 90.0, 99.0, "%"));
    Ok(rows)
}

/// Line 3: two scanners through an outage without a loop, with and without the range bias.
pub(crate) fn odometer_of_two_scanners() -> Result<Vec<Row>> {
    let (mut with, mut without, mut handed_out) = (vec![], vec![], vec![]);
    for seed in 1..=SEEDS {
        let folder = tempfile::tempdir()?;
        let project = simulate("tunnel175", seed, folder.path())?;
        let data = folder.path().join("data");
        let plain = data.join("without.toml");
        let text_of = std::fs::read_to_string(&project)?;
        std::fs::write(&plain, text_of + "\n[calibrate]\nrange_offset = false\nrange_scale = false\n")?;
        let (a, b) = (folder.path().join("a"), folder.path().join("b"));
        tieline(&["run", "--quiet", "--out", text(&a)?, text(&project)?])?;
        tieline(&["run", "--quiet", "--out", text(&b)?, text(&plain)?])?;
        let height = |solution: &Path| -> Result<f64> { Ok(errors(&data, solution)?.largest_ned_m[2]) };
        let (x, y, z) = (height(&a)?, height(&b)?, height(&data)?);
        println!("seed {seed}: height, handed out {z:.3} m, with range bias removed {x:.3} m, left {y:.3} m");
        with.push(x);
        without.push(y);
        handed_out.push(z);
    }
    let (x, y) = (median(&mut with), median(&mut without));
    println!("handed out, median: {:.3} m", median(&mut handed_out));
    Ok(vec![
        Row::at_most("tunnel175: largest height error, median of seeds", x, 0.02, "m"),
        Row::between("tunnel175: range bias left in: the error grows by", y / x, 2.0, f64::INFINITY, ""),
    ])
}
