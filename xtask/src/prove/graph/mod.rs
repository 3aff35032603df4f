//! Graphs: pose graphs, nets, Helmert blocking, Bowie, robust kernels.

mod blocking;
mod junctions;
mod nets;
mod outliers;
mod pose_graphs;
mod scale;
mod strips;
mod vehicle;

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result, ensure};

pub(crate) use blocking::rows as blocking;
pub(crate) use junctions::rows as junctions;
pub(crate) use nets::rows as nets;
pub(crate) use outliers::rows as outliers;
pub(crate) use pose_graphs::{chi2, marginals, sigmas, speed};
pub(crate) use scale::rows as scale;
pub(crate) use strips::rows as strips;
pub(crate) use vehicle::rows as vehicle;

use super::real::{program, root};

/// Where the graphs are.
fn data(name: &str) -> PathBuf {
    root().join("../shared/data/graphs").join(name)
}

/// Runs `tieline graph` with arguments; its JSON.
fn graph(arguments: &[&str]) -> Result<serde_json::Value> {
    let output = Command::new(program()?).args(["--json", "graph"]).args(arguments).output()?;
    ensure!(output.status.success(), "graph {arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// Adjusts a pose graph of the data on one thread.
fn solve(name: &str, more: &[&str]) -> Result<serde_json::Value> {
    let path = data(name);
    let path = path.to_str().context("a path in UTF-8")?;
    graph(&[&["solve", path, "--threads", "1"], more].concat())
}

fn number(value: &serde_json::Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or(f64::NAN)
}

/// Median of a few figures.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
