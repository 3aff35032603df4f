//! Line 6: false loop edges, beside Ceres where its Python package is at hand.

use std::process::Command;

use anyhow::{Result, ensure};
use nalgebra::Vector2;
use tieline::net::pose_graph;
use tieline_graph::factor::Convention;
use tieline_graph::nonlinear::{SolveOptions, solve};
use tieline_graph::robust::{Kernel, in_stages};
use tieline_graph::{Problem, Values, VariableId};
use tieline_io::pose_graph::{Edge, Format, Measured, PoseGraph, format};
use tieline_simulate::net::false_loops;

use super::super::Row;
use super::super::real::root;
use super::{data, median};

/// Root mean square distance of the places of all vertices \[m\].
#[allow(clippy::cast_precision_loss)]
fn distance_m(a: &Values, b: &Values) -> f64 {
    let ids = (0..u32::try_from(a.len()).unwrap_or(u32::MAX)).map(VariableId);
    (ids.map(|id| (a.xy(id) - b.xy(id)).norm_squared()).sum::<f64>() / a.len() as f64).sqrt()
}

fn solved(graph: &PoseGraph, kernel: Kernel) -> Result<Problem> {
    let mut problem = pose_graph::problem(graph, Convention::Plain)?;
    in_stages(&mut problem, kernel, |problem, kernel| {
        solve(problem, &SolveOptions { kernel, ..SolveOptions::default() })
    })?;
    Ok(problem)
}

/// Ceres' distance from the optimum on the same graph \[m\], from the first values of the file as ours; none where its package is not at hand.
#[allow(clippy::cast_precision_loss)]
fn ceres_m(graph: &PoseGraph, optimum: &Values) -> Result<Option<f64>> {
    let is_there = Command::new("python3").args(["-c", "import pyceres, numpy"]).output();
    if !is_there.is_ok_and(|o| o.status.success()) {
        return Ok(None);
    }
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("false_loops.g2o");
    std::fs::write(&file, format(graph, Format::G2o).map_err(anyhow::Error::msg)?)?;
    let output = Command::new("python3").arg(root().join("xtask/peers/ceres_dcs.py")).arg(&file).output()?;
    ensure!(output.status.success(), "Ceres: {}", String::from_utf8_lossy(&output.stderr));
    let numbers =
        String::from_utf8(output.stdout)?.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>()?;
    ensure!(numbers.len() == 2 * optimum.len(), "Ceres: {} numbers for {} vertices", numbers.len(), optimum.len());
    let ids = (0..u32::try_from(optimum.len())?).map(VariableId);
    let places = numbers.chunks_exact(2).map(|p| Vector2::new(p[0], p[1]));
    let squared: f64 = ids.zip(places).map(|(id, place)| (optimum.xy(id) - place).norm_squared()).sum();
    Ok(Some((squared / optimum.len() as f64).sqrt()))
}

/// Line 6.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let clean = tieline_io::pose_graph::read(&data("M3500.g2o"))?;
    let optimum = solved(&clean, Kernel::None)?;
    let mut rows = Vec::new();
    let information = clean.edges.iter().find_map(|e| match e.measured {
        Measured::Between2(_, w) => Some(w),
        _ => None,
    });
    let information = information.unwrap_or_default();
    for (count, bound_mm) in [(100, 5.0), (500, 10.0)] {
        let mut distances = Vec::new();
        let mut ceres = "not on this machine".to_string();
        for seed in 1..=5 {
            let mut graph = clean.clone();
            for (a, b, m) in false_loops(clean.vertices.len(), count, seed) {
                graph.edges.push(Edge { vertices: [a, b], measured: Measured::Between2(m, information) });
            }
            if seed == 1
                && let Some(off_m) = ceres_m(&graph, &optimum.values)?
            {
                ceres = format!("{:.3} mm in this run", 1e3 * off_m);
            }
            let robust = solved(&graph, Kernel::Dcs(1.0))?;
            distances.push(1e3 * distance_m(&robust.values, &optimum.values));
        }
        let worst = distances.iter().copied().fold(0.0, f64::max);
        let label = format!("M3500 with {count} false loops, DCS, five draws");
        let first = distances[0];
        println!("{count} false loops, first draw: ours {first:.3} mm; Ceres with DCS: {ceres}");
        rows.push(Row::at_most(format!("{label}: median"), median(distances), bound_mm, "mm"));
        rows.push(Row::at_most(format!("{label}: worst"), worst, 100.0, "mm"));
    }
    // where every loop edge fits within Φ, DCS is least squares
    let robust = solved(&clean, Kernel::Dcs(1.0))?;
    rows.push(Row::at_most(
        "M3500 clean, DCS: position rms off the optimum",
        1e6 * distance_m(&robust.values, &optimum.values),
        1.0,
        "um",
    ));
    Ok(rows)
}
