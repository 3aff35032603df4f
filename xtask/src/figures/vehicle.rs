//! The survey vehicle: its two maps, and the error of its heading rate over time.

use std::fmt::Write;

use anyhow::Result;
use nalgebra::{Matrix2, SymmetricEigen};
use tieline::net::survey_vehicle::{LinkUse, VehicleGraph, VehicleModel, explicit_map, implicit_map, submap_links};
use tieline_graph::VariableId;
use tieline_graph::covariance::{Covariances, covariances};
use tieline_graph::factor::mounted::MountedBetween2;
use tieline_graph::nonlinear::{SolveOptions, solve_system};
use tieline_graph::robust::Kernel;
use tieline_graph::rotation::turn;
use tieline_graph::system::System;
use tieline_simulate::survey_vehicle::{Route, STEP_S, VehicleTruth, simulate_vehicle};

const SEED: u64 = 1;
/// Ellipses are drawn this much larger than they are.
const ELLIPSES: f64 = 50.0;
/// Pixels of a metre, and of a panel.
const SCALE: f64 = 1.4;
const PANEL: [f64; 2] = [380.0, 300.0];

/// Both figures: maps, rate.
pub(super) fn draw() -> Result<[String; 2]> {
    let (drive, truth) = simulate_vehicle(Route::FigureOfEight(2), SEED);
    let model = VehicleModel::default();
    let explicit = explicit_map(&drive, model)?;
    let implicit = implicit_map(&drive, &submap_links(&drive, LinkUse::Once), model)?;
    let dead_reckoned: Vec<[f64; 2]> = explicit.poses.iter().map(|p| place(&explicit, *p)).collect();
    let (explicit, implicit) = (adjusted(explicit)?, adjusted(implicit)?);
    let mut maps = start(2.0 * PANEL[0], PANEL[1] + 30.0);
    for (k, (title, solution)) in
        [("explicit map: landmarks", &explicit), ("implicit map: links of submaps", &implicit)].iter().enumerate()
    {
        let _ = writeln!(maps, r#"<g transform="translate({:.0} 24)">"#, PANEL[0] * k as f64);
        let _ = writeln!(maps, r#"<text x="12" y="-6" font-family="sans-serif" font-size="13">{title}</text>"#);
        panel(&mut maps, solution, &truth, &dead_reckoned);
        maps += "</g>\n";
    }
    Ok([maps + "</svg>\n", rates(&explicit, &truth)])
}

type Solution = (VehicleGraph, Covariances);

fn adjusted(mut graph: VehicleGraph) -> Result<Solution> {
    let options = SolveOptions::default();
    let mut system = System::new(&graph.problem, options.order, options.partition, options.method.clone())?;
    solve_system(&mut graph.problem, &mut system, &options)?;
    let covariances = covariances(&graph.problem, &mut system, &Kernel::None, false)?;
    Ok((graph, covariances))
}

fn start(width: f64, height: f64) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\">\
         <rect width=\"{width:.0}\" height=\"{height:.0}\" fill=\"white\"/>\n"
    )
}

fn place(graph: &VehicleGraph, id: VariableId) -> [f64; 2] {
    let at = graph.problem.values.xy(id);
    [at.x, at.y]
}

/// A point of the map in its panel.
fn at(point: [f64; 2]) -> (f64, f64) {
    (0.5 * PANEL[0] + SCALE * point[0], 0.5 * PANEL[1] - SCALE * (point[1] - 56.0))
}

fn polyline(text: &mut String, points: impl Iterator<Item = (f64, f64)>, style: &str) {
    let points: Vec<String> = points.map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let _ = writeln!(text, r#"<polyline points="{}" fill="none" {style}/>"#, points.join(" "));
}

fn panel(text: &mut String, (graph, covariances): &Solution, truth: &VehicleTruth, dead_reckoned: &[[f64; 2]]) {
    let inside = |(x, y): &(f64, f64)| (4.0..PANEL[0] - 4.0).contains(x) && (0.0..PANEL[1]).contains(y);
    let reckoned = dead_reckoned.iter().map(|p| at(*p)).take_while(inside);
    polyline(text, truth.poses.iter().map(|p| at([p[0], p[1]])), r##"stroke="#d0d0d0" stroke-width="5""##);
    polyline(text, reckoned, r##"stroke="#c0392b" stroke-dasharray="4 3""##);
    for id in graph.landmarks.iter().flatten() {
        let (x, y) = at(place(graph, *id));
        let _ = writeln!(text, r##"<circle cx="{x:.1}" cy="{y:.1}" r="1.6" fill="#1e8449"/>"##);
    }
    polyline(text, graph.poses.iter().map(|p| at(place(graph, *p))), r##"stroke="#2e86c1" stroke-width="1.2""##);
    for link in graph.problem.factors_of::<MountedBetween2>() {
        let [a, b] = link.poses().map(|p| at(place(graph, p)));
        // loops join places that lie on each other: drawn as a dot at the middle
        let (x, y) = (0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1));
        let far = link.poses()[0].0.abs_diff(link.poses()[1].0) > 10;
        let colour = if far { "#e08e0b" } else { "#7d3c98" };
        let _ = writeln!(text, r#"<circle cx="{x:.1}" cy="{y:.1}" r="2" fill="{colour}"/>"#);
    }
    for pose in graph.poses.iter().skip(20).step_by(20) {
        ellipse(text, graph, *pose, &covariances.of(*pose).fixed_view::<2, 2>(0, 0).into_owned());
    }
}

/// The 95 % ellipse of a pose, enlarged.
fn ellipse(text: &mut String, graph: &VehicleGraph, pose: VariableId, covariance: &Matrix2<f64>) {
    let turned = turn(graph.problem.values.get(pose)[2]);
    let eigen = SymmetricEigen::new(turned * covariance * turned.transpose());
    let half = |k: usize| ELLIPSES * SCALE * (5.991 * eigen.eigenvalues[k].max(0.0)).sqrt();
    let axis = eigen.eigenvectors.column(0);
    let (x, y) = at(place(graph, pose));
    let _ = writeln!(
        text,
        r##"<ellipse rx="{:.1}" ry="{:.1}" fill="none" stroke="#2e86c1" stroke-width="0.7" transform="translate({x:.1} {y:.1}) rotate({:.1})"/>"##,
        half(0),
        half(1),
        -axis[1].atan2(axis[0]).to_degrees()
    );
}

/// Error of the heading rate over time: truth, estimate, two sigmas.
fn rates((graph, covariances): &Solution, truth: &VehicleTruth) -> String {
    let (width, height, left) = (760.0, 210.0, 60.0);
    let degrees = |radps: f64| 3600.0 * radps.to_degrees();
    let all: Vec<f64> = graph.rates.iter().map(|r| degrees(graph.problem.values.scalar(*r))).collect();
    let sigmas: Vec<f64> = graph.rates.iter().map(|r| degrees(covariances.sigmas(*r)[0])).collect();
    let true_rates: Vec<f64> = truth.rates_radps.iter().map(|r| degrees(*r)).collect();
    let band = |sign: f64| all.iter().zip(&sigmas).map(move |(a, s)| a + sign * s);
    let low = band(-2.0).chain(true_rates.iter().copied()).fold(f64::INFINITY, f64::min);
    let high = band(2.0).chain(true_rates.iter().copied()).fold(f64::NEG_INFINITY, f64::max);
    let step = 20.0;
    let (low, high) = ((low / step).floor() * step, (high / step).ceil() * step);
    let x = |k: usize| left + (width - left - 16.0) * k as f64 / all.len() as f64;
    let y = |v: f64| 14.0 + (height - 54.0) * (high - v) / (high - low);
    let mut text = start(width, height);
    let mut label = |x: f64, y: f64, anchor: &str, words: &str| {
        let _ = writeln!(
            text,
            r#"<text x="{x:.1}" y="{y:.1}" font-family="sans-serif" font-size="11" text-anchor="{anchor}">{words}</text>"#
        );
    };
    let mut value = low;
    while value <= high {
        label(left - 8.0, y(value) + 4.0, "end", &format!("{value:.0}"));
        value += step;
    }
    for k in (0..=all.len()).step_by(80) {
        label(x(k), height - 24.0, "middle", &format!("{:.0}", STEP_S * k as f64));
    }
    label(
        0.5 * (left + width),
        height - 8.0,
        "middle",
        "time, s; error of the heading rate, degrees per hour: truth, estimate, two sigmas",
    );
    let mut value = low;
    while value <= high {
        let ends = [(left, y(value)), (width - 16.0, y(value))];
        polyline(&mut text, ends.into_iter(), r##"stroke="#eeeeee""##);
        value += step;
    }
    let upper = (0..all.len()).map(|k| (x(k), y(all[k] + 2.0 * sigmas[k])));
    let lower = (0..all.len()).rev().map(|k| (x(k), y(all[k] - 2.0 * sigmas[k])));
    let band: Vec<String> = upper.chain(lower).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let _ = writeln!(text, r##"<polygon points="{}" fill="#d6e6f2"/>"##, band.join(" "));
    let grey = r##"stroke="#888888" stroke-width="1.2""##;
    polyline(&mut text, true_rates.iter().enumerate().map(|(k, v)| (x(k), y(*v))), grey);
    let blue = r##"stroke="#2e86c1" stroke-width="1.6""##;
    polyline(&mut text, all.iter().enumerate().map(|(k, v)| (x(k), y(*v))), blue);
    text + "</svg>\n"
}
