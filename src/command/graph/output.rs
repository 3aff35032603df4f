//! Files of a solved graph: values, sigmas, plot before and after.

use std::path::Path;

use anyhow::{Context, Result};
use plotters::prelude::*;
use tieline_graph::covariance::Covariances;
use tieline_graph::{Kind, Problem, Values};
use tieline_io::output::write_whole;
use tieline_io::pose_graph::{Format, PoseGraph, format};

use crate::net::geodetic::GeodeticNet;
use crate::net::pose_graph::with_values;

fn write(folder: &Path, name: &str, text: &str) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("making the folder {}", folder.display()))?;
    let path = folder.join(name);
    write_whole(&path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
}

/// Writes `solved.g2o` (`solved.graph` in TORO's format where the graph came so), `sigmas.csv` and `graph.svg`.
///
/// # Errors
/// When the folder cannot be written.
pub(super) fn pose_graph(
    folder: &Path,
    graph: &PoseGraph,
    toro: bool,
    before: &Values,
    problem: &Problem,
    covariances: Option<&Covariances>,
) -> Result<()> {
    let solved = with_values(graph, problem);
    // what TORO cannot hold is written as g2o
    let as_toro = if toro { format(&solved, Format::Toro).ok() } else { None };
    let (name, text) = match as_toro {
        Some(text) => ("solved.graph", text),
        None => ("solved.g2o", format(&solved, Format::G2o).map_err(anyhow::Error::msg)?),
    };
    write(folder, name, &text)?;
    if let Some(covariances) = covariances {
        let mut text = String::from("vertex,sigma_1,sigma_2,sigma_3,sigma_4,sigma_5,sigma_6\n");
        for id in problem.variables().filter(|v| !problem.is_fixed(*v)) {
            let sigmas: Vec<String> = covariances.sigmas(id).iter().map(|s| format!("{s:e}")).collect();
            text += &format!("{},{}{}\n", problem.name(id), sigmas.join(","), ",".repeat(6 - sigmas.len().min(6)));
        }
        write(folder, "sigmas.csv", &text)?;
    }
    let links: Vec<[usize; 2]> = graph.edges.iter().map(|e| e.vertices).collect();
    let place = |values: &Values| -> Vec<(f64, f64)> {
        problem.variables().map(|id| (values.get(id)[0], values.get(id)[1])).collect()
    };
    write(folder, "graph.svg", &plot(&place(before), &place(&problem.values), &links)?)
}

/// Writes `adjusted.json` and `net.svg`, which draws how far stations moved from their approximate places, made larger where that is little.
///
/// # Errors
/// When the folder cannot be written.
pub(super) fn net(folder: &Path, net: &GeodeticNet, before: &Values, result: &serde_json::Value) -> Result<()> {
    write(folder, "adjusted.json", &serde_json::to_string_pretty(result)?)?;
    let places = |values: &Values| -> Vec<(f64, f64)> {
        let place = |id| match values.kind(id) {
            Kind::Point2 | Kind::Point3 => (values.get(id)[0], values.get(id)[1]),
            _ => (f64::NAN, f64::NAN),
        };
        net.problem.variables().map(place).collect()
    };
    let links: Vec<[usize; 2]> = net
        .problem
        .factors()
        .filter(|f| f.variables().len() >= 2)
        .map(|f| [f.variables()[0].index(), f.variables()[1].index()])
        .collect();
    let after = places(&net.problem.values);
    let (before, times) = made_larger(&places(before), &after);
    let text = plot(&before, &after, &links)?;
    let caption = format!(
        "<text x=\"30\" y=\"20\" font-family=\"sans-serif\" font-size=\"14\">blue: adjusted; grey: approximate{}</text>\n</svg>",
        if times > 1.0 { format!(", {times:.0} times as far off as it was") } else { String::new() }
    );
    write(folder, "net.svg", &text.replace("</svg>", &caption))
}

/// Places before, moved away from those after by a round number of times what they are off, so that it can be seen; and that number.
fn made_larger(before: &[(f64, f64)], after: &[(f64, f64)]) -> (Vec<(f64, f64)>, f64) {
    /// Of the plot's size.
    const SEEN: f64 = 0.05;
    let both = || before.iter().zip(after).filter(|(b, a)| finite_ref(b) && finite_ref(a));
    let off = both().map(|(b, a)| (b.0 - a.0).hypot(b.1 - a.1)).fold(0.0, f64::max);
    let span = |of: fn(&(f64, f64)) -> f64| {
        let (low, high) =
            both().map(|(_, a)| of(a)).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    };
    let size = span(|p| p.0).max(span(|p| p.1));
    let times = if off > 0.0 && size > 0.0 { 10_f64.powf((SEEN * size / off).log10().floor()).max(1.0) } else { 1.0 };
    let larger = |(b, a): (&(f64, f64), &(f64, f64))| (a.0 + times * (b.0 - a.0), a.1 + times * (b.1 - a.1));
    (before.iter().zip(after).map(larger).collect(), times)
}

/// Links before (grey) and after (blue), east to the right.
fn plot(before: &[(f64, f64)], after: &[(f64, f64)], links: &[[usize; 2]]) -> Result<String> {
    let finite = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
    let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
    for p in after.iter().chain(before).filter(finite) {
        low = (low.0.min(p.0), low.1.min(p.1));
        high = (high.0.max(p.0), high.1.max(p.1));
    }
    let size = (high.0 - low.0).max(high.1 - low.1).max(1e-9);
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, (900, 900)).into_drawing_area();
        area.fill(&WHITE)?;
        let at = |p: &(f64, f64)| {
            #[allow(clippy::cast_possible_truncation)] // pixels
            let pixel = |v: f64| v as i32;
            (pixel(30.0 + 840.0 * (p.0 - low.0) / size), pixel(870.0 - 840.0 * (p.1 - low.1) / size))
        };
        for (points, colour) in [(before, RGBColor(190, 190, 190)), (after, RGBColor(30, 90, 170))] {
            for [a, b] in links.iter().filter(|l| l[0] != l[1]) {
                if let (Some(a), Some(b)) = (points.get(*a).filter(finite_ref), points.get(*b).filter(finite_ref)) {
                    area.draw(&PathElement::new(vec![at(a), at(b)], colour))?;
                }
            }
        }
        area.present()?;
    }
    Ok(text)
}

fn finite_ref(p: &&(f64, f64)) -> bool {
    p.0.is_finite() && p.1.is_finite()
}
