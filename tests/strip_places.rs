//! Strips tied by submaps, corners and ridges: recovery of a simulated truth, the words of the project, the files, the stages.
#![allow(clippy::expect_used)]

mod common;

use std::collections::BTreeSet;

use common::Bench;
use nalgebra::{DVector, Vector3};
use tieline::job::{Clock, DEFAULT_MEMORY_BYTES, JobOptions, match_strips, setup_of, solve_strips};
use tieline::progress::Progress;
use tieline::project::{Project, StripModelChoice, XyzChoice, XyzWord};
use tieline::stage::places::PlaceKind;
use tieline::stage::places::row::{PlaceRow, measured, rows};
use tieline_graph::{ParameterBlock, TimeModel};
use tieline_simulate::{Scenario, SimulationReport, simulate};

/// Errors over sigmas of all observable corrections and calibration terms, and the number of ties of each kind.
struct Recovered {
    ratios: Vec<f64>,
    ties: [usize; 3],
    lines_in_use: usize,
}

/// A village of gables, hips and flat roofs under five strips, tied by the kinds given and by nothing else.
fn recovered(seed: u64, kinds: &[XyzWord]) -> Recovered {
    let folder = tempfile::tempdir().expect("a folder");
    let mut scenario = Scenario { seed, ..Scenario::airborne_sample() };
    scenario.world.buildings = 50;
    scenario.scanners[0].pulse_rate_hz = 90_000.0;
    scenario.scanners[0].line_rate_hz = 150.0;
    let report = simulate(&scenario, folder.path()).expect("simulated");
    let mut project = Project::load(&report.project).expect("a project");
    project.matching.xyz = XyzChoice::Kinds(kinds.to_vec());
    project.matching.surface_lines = Some(false);
    project.solve.strips = StripModelChoice::Linear; // as the errors are simulated
    let out = folder.path().join("out");
    let options = JobOptions { out, memory_bytes: DEFAULT_MEMORY_BYTES, progress: Progress::silent() };
    let mut clock = Clock::default();
    let matched = match_strips(&project, &options, &mut clock).expect("matched");
    let solution = solve_strips(&project, &matched, &mut clock).expect("solved");
    let shift_s = matched.survey.clock.shift_s(tieline_filter::TimeEncoding::SecondsOfWeek).unwrap_or(0.0);
    let mut ratios = Vec::new();
    for (i, parameter) in solution.parameters().iter().enumerate() {
        let truth = match parameter.block {
            ParameterBlock::Calibration(_) => calibration_truth(&report, &parameter.name),
            ParameterBlock::Strip(s) => {
                let strip = &matched.strips.strips()[s];
                let error = &report.truth.strips[usize::from(strip.source.point_source_id()) - 1];
                let at = |t: f64| (-error.position_ned_m(t - shift_s), -error.rotation_ned_rad(t - shift_s));
                strip_truth(&parameter.name, at(strip.start_s), at(strip.end_s))
            }
        };
        let sigma = solution.adjustment.covariance[(i, i)].sqrt();
        let ratio = (solution.model.state()[i] - truth) / sigma;
        if solution.adjustment.observability.is_observable(i) {
            ratios.push(ratio);
        }
    }
    let count = |kind: PlaceKind| matched.ties.places.in_use().filter(|(_, t)| t.kind == kind).count();
    Recovered {
        ratios,
        ties: PlaceKind::ALL.map(count),
        lines_in_use: solution.lines.iter().filter(|l| l.tie.is_none() && !l.held_out).count(),
    }
}

fn calibration_truth(report: &SimulationReport, name: &str) -> f64 {
    let s = &report.truth.scanners[0];
    let (b, a) = (s.boresight_error_rad, s.lever_arm_error_m);
    match name {
        "boresight roll" => b.x,
        "boresight pitch" => b.y,
        "boresight yaw" => b.z,
        "lever arm forward" => a.x,
        "lever arm right" => a.y,
        "lever arm down" => a.z,
        "range offset" => s.range_offset_m,
        _ => s.range_scale,
    }
}

/// Constant and drift of a correction that is linear from start to end.
fn strip_truth(name: &str, start: (Vector3<f64>, Vector3<f64>), end: (Vector3<f64>, Vector3<f64>)) -> f64 {
    let (name, kind) = name.rsplit_once(' ').expect("two words");
    let axis = ["north", "east", "down"].iter().position(|a| name.ends_with(a)).expect("an axis");
    let pick = |v: &(Vector3<f64>, Vector3<f64>)| if name.starts_with("rotation") { v.1[axis] } else { v.0[axis] };
    let sign = if kind == "constant" { 1.0 } else { -1.0 };
    0.5 * (pick(&end) + sign * pick(&start))
}

#[allow(clippy::cast_precision_loss)]
fn assert_honest(seeds: &[u64], kinds: &[XyzWord], least_ties: usize) {
    let mut all = Vec::new();
    for seed in seeds {
        let found = recovered(*seed, kinds);
        assert_eq!(found.lines_in_use, 0, "surface lines take no part");
        assert!(found.ties.iter().sum::<usize>() >= least_ties, "{:?} ties", found.ties);
        let asked = |kind: XyzWord| kinds.contains(&kind);
        assert!((found.ties[0] > 0) == asked(XyzWord::Submap), "{:?}", found.ties);
        assert!((found.ties[1] > 0) == asked(XyzWord::Corner), "{:?}", found.ties);
        all.extend(found.ratios);
    }
    let rms = (all.iter().map(|r| r * r).sum::<f64>() / all.len() as f64).sqrt();
    let inside = all.iter().filter(|r| r.abs() < 1.96).count() as f64 / all.len() as f64;
    assert!(all.len() >= 12 * seeds.len(), "{} parameters are observable", all.len());
    assert!(rms < 1.3 && inside > 0.88, "rms {rms} sigma, {inside} within 95 %");
    assert!(all.iter().all(|r| r.abs() < 4.5), "{all:?}");
}

#[test]
fn submaps_alone_recover_the_truth_within_sigma() {
    assert_honest(&[7, 8], &[XyzWord::Submap], 12);
}

#[test]
fn corners_and_ridges_alone_recover_the_truth_within_sigma() {
    assert_honest(&[7, 8, 9, 10, 11, 12, 13, 14], &[XyzWord::Corner], 30);
}

#[test]
fn rows_are_the_derivatives_of_what_they_measure() {
    let bench = Bench::new();
    let mut project = Project::load(&bench.path("survey/project.toml")).expect("a project");
    project.matching.xyz = XyzChoice::Kinds(vec![XyzWord::Corner, XyzWord::Submap]);
    let options =
        JobOptions { out: bench.path("out"), memory_bytes: DEFAULT_MEMORY_BYTES, progress: Progress::silent() };
    let matched = match_strips(&project, &options, &mut Clock::default()).expect("matched");
    let setup = setup_of(&project, &matched);
    let mut model = setup.model(&[Some(TimeModel::Linear); 3]);
    // at zero, where rotation vectors that are added and turns that are multiplied are the same
    let start: DVector<f64> = DVector::zeros(model.count());
    model.set_state(start.clone());
    let rows = rows(&matched.ties.places, &setup, &matched.poses);
    assert!(rows.len() >= 10, "{} rows", rows.len());
    let kind = |r: &PlaceRow| matched.ties.places.ties[r.tie].kind;
    let submaps = rows.iter().filter(|r| kind(r) == PlaceKind::Submap).take(6);
    let ridges = rows.iter().filter(|r| kind(r) == PlaceKind::Ridge).take(6);
    for row in submaps.chain(ridges) {
        let line = measured(row, &model);
        assert!(line.tie == Some(row.tie) && (line.normal.norm() - 1.0).abs() < 1e-9);
        for (number, end) in line.ends.iter().enumerate() {
            let along: Vector3<f64> = end.parts.iter().map(|p| p.along).sum();
            assert!((along - line.normal).norm() < 1e-9, "a shift of the whole strip is that shift");
            let derivatives = model.row(end, &line.normal);
            for i in 0..model.count() {
                let step = 0.05 * model.parameters()[i].prior_sigma;
                let offset_m = |sign: f64| {
                    let (mut moved, mut state) = (model.clone(), start.clone());
                    state[i] += sign * step;
                    moved.set_state(state);
                    measured(row, &moved).ends[number].offset_m
                };
                let numeric = (offset_m(1.0) - offset_m(-1.0)) / (2.0 * step);
                let analytic: f64 = derivatives.iter().filter(|(c, _)| *c == i).map(|(_, v)| *v).sum();
                // map metres are not quite metres
                let tolerance = 3e-3 * numeric.abs().max(analytic.abs()) + 1e-4;
                let name = &model.parameters()[i].name;
                assert!((numeric - analytic).abs() < tolerance, "{name}: {numeric} {analytic}");
            }
        }
    }
}

fn with_match(bench: &Bench, lines: &str) {
    bench.edit_project(|text| format!("{text}\n[match]\n{lines}\n"));
}

#[test]
fn words_that_are_not_there_for_strips_are_refused() {
    for (lines, words) in [
        ("xyz = [\"texture\"]", ["match.xyz", "\"texture\"", "for strips there are \"corner\" and \"submap\""]),
        ("xyz = [\"pole\", \"submap\"]", ["match.xyz", "\"pole\"", "\"auto\" or \"off\""]),
        ("xyz = [\"submaps\"]", ["match.xyz", "\"submaps\" is not known", "\"submap\""]),
        ("surface_lines = false", ["match.surface_lines", "nothing is left", "match.xyz"]),
    ] {
        let bench = Bench::new();
        with_match(&bench, lines);
        bench.refuses_to_run(&words);
    }
}

#[test]
fn ties_of_places_are_in_the_files_and_change_no_byte_with_the_threads() {
    let bench = Bench::new();
    with_match(&bench, "xyz = [\"submap\", \"corner\"]");
    let run = ["run", "survey/project.toml", "-q", "--csv", "--out"];
    bench.tieline(&[&run[..], &["one", "--threads", "1"]].concat()).assert_success();
    bench.tieline(&[&run[..], &["two", "--threads", "2", "--memory", "16"]].concat()).assert_success();
    for stage in ["match", "solve"] {
        bench.tieline(&[stage, "survey/project.toml", "-q", "--csv", "--out", "three"]).assert_success();
    }
    let [one, two, three] = ["one", "two", "three"].map(|name| bench.files(name));
    for name in ["ties.csv", "calibration.toml", "correction.csv"] {
        assert!(one[name] == two[name], "{name} differs with the threads");
        assert!(one[name] == three[name], "{name} differs with the stages");
    }
    let text = String::from_utf8(one["ties.csv"].clone()).expect("text");
    let (header, rows) = text.split_once('\n').expect("rows");
    let columns: Vec<&str> = header.split(',').collect();
    let at = |name: &str| columns.iter().position(|c| *c == name).expect("a column");
    let rows: Vec<Vec<&str>> = rows.lines().map(|l| l.split(',').collect()).collect();
    let ends = |kind: &str| rows.iter().filter(|r| r[at("kind")] == kind).cloned().collect::<Vec<_>>();
    assert!(ends("submap").len() >= 8 && ends("submap").len() % 2 == 0, "{} ends of submaps", ends("submap").len());
    assert!(!ends("line").is_empty() && !ends("surface_line").is_empty());
    assert!(ends("submap").iter().all(|r| r[at("cov_uu_m2")].parse::<f64>().expect("a number") > 0.0));
    // these hold heights alone, which surface lines have from the same points already
    let reasons: BTreeSet<&str> = ends("submap").iter().map(|r| r[at("why_not")]).collect();
    assert!(reasons.contains("height_only"), "{reasons:?}");
    let summary: serde_json::Value = serde_json::from_slice(&one["summary.json"]).expect("a summary");
    let place = |kind: &str, key: &str| summary["places"][kind]["counts"][key].as_u64().expect("a count");
    assert_eq!(place("submap", "used"), 0);
    assert_eq!(summary["ties"]["line"]["used"].as_u64(), Some(place("ridge", "used")));
    let html = String::from_utf8(one["report.html"].clone()).expect("text");
    assert!(html.contains("Ties of places") && html.contains("ridge"));
}

#[test]
fn without_surface_lines_they_judge() {
    let bench = Bench::new();
    with_match(&bench, "xyz = \"auto\"\nsurface_lines = false");
    bench.tieline(&["run", "survey/project.toml", "-q", "--csv", "--out", "out"]).assert_success();
    let files = bench.files("out");
    let summary: serde_json::Value = serde_json::from_slice(&files["summary.json"]).expect("a summary");
    let lines = &summary["ties"]["surface_line"];
    assert_eq!(lines["used"].as_u64(), Some(0));
    assert!(lines["held_out"].as_u64().is_some_and(|n| n > 300), "{lines}");
    let d = &summary["discrepancy"];
    let rms = |key: &str| d[key]["rms_m"].as_f64().expect("a number");
    assert!(rms("held_out_after") < 0.5 * rms("held_out_before"), "surface lines see it: {d}");
}
