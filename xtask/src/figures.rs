//! Figures of the documentation, drawn by the code that they are about: `cargo run -p xtask -- figures`.

#![allow(clippy::cast_precision_loss)] // counts are small

mod vehicle;

use std::fmt::Write;

use anyhow::Result;
use tieline::net::simulated;
use tieline_graph::bowie::{BowieOptions, skeleton};
use tieline_graph::helmert::partition::{PartitionOptions, partition};
use tieline_graph::linear::nodes::NodeGraph;
use tieline_graph::{Problem, VariableId};
use tieline_simulate::net::{NetKind, simulate_net};

const COLOURS: [&str; 5] = ["#c0392b", "#e08e0b", "#2e86c1", "#1e8449", "#7d3c98"];

/// Draws `docs/images/graph-*.svg`.
pub(crate) fn draw() -> Result<()> {
    let (net, _) = simulate_net(49, NetKind::Baselines, 4);
    let problem = simulated::problem(&net);
    let images = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/images/");
    std::fs::write(format!("{images}graph-blocks.svg"), blocks(&problem))?;
    std::fs::write(format!("{images}graph-sections.svg"), sections(&problem))?;
    let [maps, rate] = vehicle::draw()?;
    std::fs::write(format!("{images}graph-vehicle-maps.svg"), maps)?;
    std::fs::write(format!("{images}graph-vehicle-rate.svg"), rate)?;
    Ok(())
}

fn at(problem: &Problem, id: VariableId) -> (f64, f64) {
    let p = problem.place(id).unwrap_or_default();
    (30.0 + p[0] / 160.0, 430.0 - p[1] / 160.0)
}

fn line(text: &mut String, a: (f64, f64), b: (f64, f64), style: &str) {
    let _ = writeln!(text, r#"<line x1="{:.1}" y1="{:.1}" x2="{:.1}" y2="{:.1}" {style}/>"#, a.0, a.1, b.0, b.1);
}

fn start() -> String {
    String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"460\" height=\"460\"><rect width=\"460\" height=\"460\" fill=\"white\"/>\n",
    )
}

/// Stations by the level of the block that eliminates them.
fn blocks(problem: &Problem) -> String {
    let graph = NodeGraph::new(problem);
    let places: Vec<[f64; 3]> =
        graph.first_variable.iter().map(|v| problem.place(VariableId(*v)).unwrap_or_default()).collect();
    let drafts = partition(&graph, &places, PartitionOptions { leaf_nodes: 4, ..PartitionOptions::default() });
    let mut text = start();
    for factor in problem.factors() {
        line(
            &mut text,
            at(problem, factor.variables()[0]),
            at(problem, factor.variables()[1]),
            r##"stroke="#cccccc""##,
        );
    }
    for draft in &drafts {
        let (mut level, mut parent) = (0, draft.parent);
        while let Some(p) = parent {
            level += 1;
            parent = drafts[p].parent;
        }
        for node in &draft.own {
            let (x, y) = at(problem, VariableId(graph.first_variable[*node as usize]));
            let colour = COLOURS[level.min(COLOURS.len() - 1)];
            let _ = writeln!(text, r#"<circle cx="{x:.1}" cy="{y:.1}" r="8" fill="{colour}"/>"#);
            let _ = writeln!(
                text,
                r#"<text x="{x:.1}" y="{:.1}" font-size="10" fill="white" text-anchor="middle">{level}</text>"#,
                y + 3.5
            );
        }
    }
    text + "</svg>\n"
}

/// The skeleton of Bowie's method; junctions as squares.
fn sections(problem: &Problem) -> String {
    let left_out = skeleton(problem, &BowieOptions { loop_share: 0.15, ..BowieOptions::default() });
    let mut degree = vec![0; problem.values.len()];
    let mut text = start();
    for (factor, out) in problem.factors().zip(&left_out) {
        let [a, b] = [factor.variables()[0], factor.variables()[1]];
        let style =
            if *out { r##"stroke="#dddddd" stroke-dasharray="3""## } else { r##"stroke="#2e86c1" stroke-width="3""## };
        line(&mut text, at(problem, a), at(problem, b), style);
        if !out {
            degree[a.index()] += 1;
            degree[b.index()] += 1;
        }
    }
    for id in problem.variables() {
        let (x, y) = at(problem, id);
        let _ = if degree[id.index()] > 2 {
            writeln!(text, r##"<rect x="{:.1}" y="{:.1}" width="12" height="12" fill="#c0392b"/>"##, x - 6.0, y - 6.0)
        } else {
            writeln!(text, r##"<circle cx="{x:.1}" cy="{y:.1}" r="4" fill="#333333"/>"##)
        };
    }
    text + "</svg>\n"
}
