//! Lines 1, 3 and 5: known optima, sigmas, time.

use std::process::Command;

use anyhow::Result;

use super::super::Row;
use super::{data, median, number, solve};
use crate::prove::real::root;

/// Expected chi2: file, arguments, value. The table is that of the data's README.
const OPTIMA: [(&str, &[&str], f64); 13] = [
    ("M3500", &[], 137.912_950_9),
    ("M3500", &["--convention", "log"], 137.914_878_2),
    ("intel", &[], 45.004_695_81),
    ("intel", &["--convention", "log"], 45.004_233_09),
    ("city10000", &[], 511.985_163_6),
    ("sphere2500", &[], 1_351.362_327),
    ("sphere2500", &["--convention", "log"], 1_351.401_926),
    ("sphere2500", &["--convention", "g2o"], 727.149_667_5),
    ("parking-garage", &[], 1.268_384_402),
    ("parking-garage", &["--convention", "log"], 1.268_384_799),
    ("parking-garage", &["--convention", "g2o"], 1.238_690_580),
    ("smallGrid3D", &[], 1_033.894_404),
    ("smallGrid3D", &["--convention", "g2o"], 458.153_784_3),
];

/// Line 1: chi2.
pub(crate) fn chi2() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (name, arguments, expected) in OPTIMA {
        let value = solve(&format!("{name}.g2o"), arguments)?;
        let convention = value["convention"].as_str().unwrap_or("").to_string();
        let error = (number(&value, "chi2") / expected - 1.0).abs();
        let initial = value["initial"].as_str().unwrap_or("").to_string();
        rows.push(Row::at_most(
            format!("{name}, {convention}, from {initial}: chi2 {expected} off by, relative",),
            error * 1e6,
            1.0,
            "ppm",
        ));
    }
    let start = data("victoria_park_init.g2o");
    let from_file = ["--start", start.to_str().unwrap_or_default(), "--initial", "file"];
    for (label, arguments) in [("start file", &from_file[..]), ("odometry, incremental", &["--initial", "incremental"])]
    {
        let value = solve("victoria_park.g2o", arguments)?;
        let error = (number(&value, "chi2") / 6_184.120_251 - 1.0).abs();
        rows.push(Row::at_most(format!("victoria_park from {label}: chi2 off by, relative"), error * 1e6, 1.0, "ppm"));
    }
    Ok(rows)
}

/// Sigmas by GTSAM's marginals: file, node, x y theta or t and rotation.
const SIGMAS: [(&str, &str, &[f64]); 6] = [
    ("M3500", "1750", &[4.9518, 3.000_09, 0.172_931]),
    ("M3500", "3499", &[8.9322, 13.6979, 0.654_837]),
    ("intel", "800", &[7.739_24, 3.6289, 0.414_149]),
    ("intel", "1727", &[1.886_07, 1.8338, 0.625_339]),
    ("sphere2500", "1250", &[5.104_98, 2.426_06, 2.708_32, 0.064_096_2, 0.094_940_5, 0.070_707_1]),
    ("sphere2500", "2499", &[5.613, 5.384_02, 0.973_984, 0.077_992_6, 0.079_729_9, 0.134_389]),
];

/// Line 1: sigmas.
pub(crate) fn sigmas() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (name, node, expected) in SIGMAS {
        let value = solve(&format!("{name}.g2o"), &["--convention", "log", "--sigmas"])?;
        let found = value["sigmas"][node].as_array().cloned().unwrap_or_default();
        let error = expected
            .iter()
            .enumerate()
            .map(|(k, e)| (found.get(k).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN) / e - 1.0).abs());
        // the largest, and not a number when there is one
        let worst = error.fold(0.0, |m: f64, e| if e.is_nan() || m.is_nan() { f64::NAN } else { m.max(e) });
        rows.push(Row::at_most(format!("{name}, node {node}: sigmas off by, relative"), worst * 1e4, 1.0, "1e-4"));
    }
    Ok(rows)
}

/// CPU seconds to convergence of the best peer on this kind of machine (factrs, factrs, GTSAM, GTSAM with METIS).
const PEERS_S: [(&str, f64); 4] =
    [("M3500", 0.165), ("city10000", 0.82), ("sphere2500", 0.58), ("parking-garage", 0.19)];

/// Line 3: time to convergence.
pub(crate) fn speed() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (name, bound) in PEERS_S {
        let mut seconds = Vec::new();
        for _ in 0..5 {
            seconds.push(number(&solve(&format!("{name}.g2o"), &[])?, "solve_cpu_s"));
        }
        let peer = gtsam(name).map_or_else(|| "not on this machine".to_string(), |s| format!("{s:.3} s in this run"));
        let label = format!("{name}: CPU to convergence (GTSAM: {peer})");
        rows.push(Row::at_most(label, median(seconds), bound, "s"));
    }
    Ok(rows)
}

/// GTSAM's CPU seconds, where its Python package is at hand.
fn gtsam(name: &str) -> Option<f64> {
    let script = root().join("xtask/peers/gtsam_pose_graph.py");
    let output = Command::new("python3").arg(script).arg(data(&format!("{name}.g2o"))).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    text.split_whitespace().next()?.parse().ok().filter(|_| output.status.success())
}

/// Line 5: all marginals.
pub(crate) fn marginals() -> Result<Vec<Row>> {
    let mut seconds = Vec::new();
    for _ in 0..3 {
        seconds.push(number(&solve("sphere2500.g2o", &["--sigmas"])?, "covariance_cpu_s"));
    }
    Ok(vec![Row::at_most("sphere2500: all marginals, CPU (GTSAM one by one: 22 s)", median(seconds), 0.5, "s")])
}
