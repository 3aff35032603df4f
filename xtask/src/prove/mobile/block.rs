//! The drive of an independent simulator.

use anyhow::{Context, Result};

use super::super::Row;
use super::super::real::root;
use super::{judge, number, text, tieline};

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
