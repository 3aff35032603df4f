//! Line 6: false loop edges.

use anyhow::Result;
use tieline::net::pose_graph;
use tieline_graph::factor::Convention;
use tieline_graph::nonlinear::{SolveOptions, solve};
use tieline_graph::robust::{Kernel, in_stages};
use tieline_graph::{Problem, Values, VariableId};
use tieline_io::pose_graph::{Edge, Measured, PoseGraph};
use tieline_simulate::net::false_loops;

use super::super::Row;
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
    for (count, bound_mm, ceres_mm) in [(100, 5.0, 2.0), (500, 10.0, 4.5)] {
        let mut distances = Vec::new();
        for seed in 1..=5 {
            let mut graph = clean.clone();
            for (a, b, m) in false_loops(clean.vertices.len(), count, seed) {
                graph.edges.push(Edge { vertices: [a, b], measured: Measured::Between2(m, information) });
            }
            let robust = solved(&graph, Kernel::Dcs(1.0))?;
            distances.push(1e3 * distance_m(&robust.values, &optimum.values));
        }
        let worst = distances.iter().copied().fold(0.0, f64::max);
        let label = format!("M3500 with {count} false loops, DCS, five draws");
        rows.push(Row::at_most(format!("{label}: median (Ceres {ceres_mm} mm)"), median(distances), bound_mm, "mm"));
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
