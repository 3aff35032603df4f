//! Range corrections of a drive over incidence and intensity (`calibrate.range_over`): found, applied, taken off, taken as known, and none invented.

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::{Bench, largest_difference_m};
use tieline_io::las::LasFile;

const ALL: &str = "\n[calibrate]\nrange_over = [\"range\", \"incidence\", \"intensity\"]\n";

/// Seeds of the drives whose curves are judged together.
const SEEDS: [u32; 3] = [11, 12, 13];

/// What is wrong with the two scanners.
const BIASES: [&str; 2] = [
    "bias_intensity = [[2000.0, 0.006], [12000.0, -0.001], [40000.0, -0.003]]\n\
     bias_incidence = [[0.0, 0.0], [40.0, 0.001], [80.0, 0.007]]\n",
    "bias_intensity = [[2000.0, -0.004], [10000.0, 0.002], [40000.0, 0.005]]\n\
     bias_incidence = [[0.0, 0.002], [50.0, 0.0], [80.0, -0.005]]\n",
];

/// The streets of the sample, with scanners that measure four times as much and err with incidence and intensity; the drive is in `drive/`.
fn simulated(seed: u32) -> Bench {
    let bench = Bench::new();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/scenarios/loop.toml");
    let text = std::fs::read_to_string(file).expect("a scenario");
    let text = text
        .replace("seed = 5\n", &format!("seed = {seed}\n"))
        .replace("pulse_rate_hz = 3000.0", "pulse_rate_hz = 12000.0");
    let mut parts = text.split("[[scanner]]\n");
    let mut scenario = String::from(parts.next().expect("a beginning"));
    for (part, bias) in parts.zip(BIASES) {
        scenario += &format!("[[scanner]]\n{bias}{part}");
    }
    std::fs::write(bench.path("scenario.toml"), scenario).expect("written");
    bench.tieline(&["simulate", "scenario.toml", "--out", "drive", "-q"]).assert_success();
    bench
}

/// The project of the simulated drive with more in it.
fn project(bench: &Bench, name: &str, more: &str) -> String {
    let text = std::fs::read_to_string(bench.path("drive/project.toml")).expect("a project");
    std::fs::write(bench.path(&format!("drive/{name}.toml")), text + more).expect("written");
    format!("drive/{name}.toml")
}

/// By scanner, counted from `first`, and what it is over: rows of numbers.
fn curves(path: &Path, first: usize) -> BTreeMap<(usize, String), Vec<Vec<f64>>> {
    let mut curves: BTreeMap<_, Vec<Vec<f64>>> = BTreeMap::new();
    for line in std::fs::read_to_string(path).expect("curves").lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let scanner = fields[0].parse::<usize>().expect("a scanner") - first;
        let row = fields[2..].iter().map(|f| f.parse().expect("a number")).collect();
        curves.entry((scanner, String::from(fields[1]))).or_default().push(row);
    }
    curves
}

/// A curve between its rows.
fn at(rows: &[Vec<f64>], place: f64) -> f64 {
    let next = rows.partition_point(|r| r[0] <= place).clamp(1, rows.len() - 1);
    let (a, b) = (&rows[next - 1], &rows[next]);
    a[1] + (b[1] - a[1]) * (place - a[0]) / (b[0] - a[0])
}

fn term<'a>(summary: &'a serde_json::Value, name: &str) -> &'a serde_json::Value {
    let terms = summary["calibration"]["terms"].as_array().expect("terms");
    terms.iter().find(|t| t["scanner"] == 0 && t["name"] == name).expect("judged")
}

/// The truth within the sigmas, but for a constant: rows of all curves that are inside their 95 % intervals, and how many there are.
fn inside(bench: &Bench) -> (usize, usize) {
    let truth = curves(&bench.path("drive/truth/bias_over.csv"), 1);
    let found = curves(&bench.path("out/range_bias_over.csv"), 0);
    assert_eq!(found.keys().collect::<Vec<_>>(), truth.keys().collect::<Vec<_>>());
    let (mut inside, mut count) = (0, 0);
    for (key, rows) in &found {
        let weights: Vec<f64> = rows.iter().map(|r| r[2].powi(-2)).collect();
        let errors_m: Vec<f64> = rows.iter().map(|r| r[1] - at(&truth[key], r[0])).collect();
        let middle_m = errors_m.iter().zip(&weights).map(|(e, w)| e * w).sum::<f64>() / weights.iter().sum::<f64>();
        inside += errors_m.iter().zip(rows).filter(|(e, r)| (*e - middle_m).abs() < 1.96 * r[2]).count();
        count += rows.len();
        // the curve is there: where it is known to 0.5 mm, it is right to a millimetre, and bends by more than that
        let known = || rows.iter().zip(&errors_m).filter(|(r, _)| r[2] < 0.0005);
        let span = |values: &mut dyn Iterator<Item = f64>| {
            let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
            high - low
        };
        let (bend_m, error_m) = (span(&mut known().map(|(r, _)| r[1])), span(&mut known().map(|(_, e)| *e)));
        assert!(known().count() >= 8 && error_m < 0.0015 && bend_m > 1.2 * error_m, "{key:?}: {bend_m} {error_m}");
    }
    (inside, count)
}

#[test]
fn curves_over_incidence_and_intensity_are_found_applied_taken_off_and_taken_as_known() {
    let bench = simulated(SEEDS[0]);
    let file = project(&bench, "all", ALL);
    let summary = bench.tieline(&["run", &file, "--out", "out", "--json"]).json();
    for name in ["range correction over incidence", "range correction over intensity"] {
        assert_eq!(term(&summary, name)["estimated"], true, "{name}");
    }
    let found = curves(&bench.path("out/range_bias_over.csv"), 0);
    // rows of a curve err together: the share inside is that of three drives
    let (mut within, mut rows) = inside(&bench);
    for seed in &SEEDS[1..] {
        let other = simulated(*seed);
        let file = project(&other, "all", ALL);
        other.tieline(&["run", &file, "--out", "out", "-q"]).assert_success();
        let (more_within, more) = inside(&other);
        (within, rows) = (within + more_within, rows + more);
    }
    assert!(within * 100 >= rows * 95, "{within} of {rows} inside");

    // told in the report and the calibration, and how many points have no surface
    let page = std::fs::read_to_string(bench.path("out/report.html")).expect("a page");
    assert!(page.contains("Scanner 1, over incidence") && page.contains("Scanner 0, over intensity"));
    let files = summary["files"].as_array().expect("files");
    for file in files {
        let note = file["notes"].as_array().expect("notes").iter().filter_map(|n| n.as_str());
        let note = note.clone().find(|n| n.contains("lie off the matched surfaces")).expect("said");
        let off: f64 = note.split(' ').next().expect("a number").parse().expect("a number");
        let points = file["points"].as_f64().expect("a number");
        assert!(off > 0.0 && off < 0.3 * points, "{note}");
    }
    let calibration = std::fs::read_to_string(bench.path("out/calibration.toml")).expect("a calibration");
    assert_eq!(calibration.matches("[[range_correction_over]]").count(), 4);

    // taken off again
    let corrected = ["pass1.laz", "pass2.laz"].map(|name| format!("out/corrected/{name}"));
    bench
        .tieline(&["correct", &file, &corrected[0], &corrected[1], "--inverse", "--out", "out", "-q"])
        .assert_success();
    for name in ["pass1.laz", "pass2.laz"] {
        let input = bench.path(&format!("drive/strips/{name}"));
        let scale_m = LasFile::open(&input).expect("opens").header().scale[0];
        let left_m = largest_difference_m(&input, &bench.path(&format!("out/restored/{name}")));
        assert!(left_m <= 1.500_001 * scale_m, "{name} comes back with {left_m} m");
    }

    // taken as known: the same cloud, though nothing is estimated
    let held = project(&bench, "held", "\n[calibrate]\nknown = \"../out/calibration.toml\"\nenabled = false\n");
    bench.tieline(&["run", &held, "--out", "held", "-q"]).assert_success();
    let again = curves(&bench.path("held/range_bias_over.csv"), 0);
    for (key, rows) in &found {
        let like = |(a, b): (&Vec<f64>, &Vec<f64>)| (a[1] - b[1]).abs() < 2e-6 && b[2] == 0.0;
        assert!(rows.len() == again[key].len() && rows.iter().zip(&again[key]).all(like), "{key:?}");
    }
    let apart_m = largest_difference_m(&bench.path(&corrected[1]), &bench.path("held/corrected/pass2.laz"));
    assert!(apart_m < 0.005, "{apart_m}");
}

#[test]
fn none_is_invented_where_there_is_none() {
    let bench = Bench::new();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop");
    let text = std::fs::read_to_string(sample.join("project.toml")).expect("the sample");
    let absolute = text.replace("path = \"", &format!("path = \"{}/", sample.display()));
    let absolute = absolute.replace("accuracy = \"", &format!("accuracy = \"{}/", sample.display()));
    std::fs::write(bench.path("all.toml"), absolute + ALL).expect("written");
    // one of an earlier run does not stay beside another calibration
    std::fs::create_dir(bench.path("out")).expect("created");
    std::fs::write(bench.path("out/range_bias_over.csv"), "old").expect("written");
    let summary = bench.tieline(&["calibrate", "all.toml", "--out", "out", "--json"]).json();
    for name in ["range correction over incidence", "range correction over intensity"] {
        assert_eq!(term(&summary, name)["estimated"], false, "{summary}");
    }
    assert_eq!(term(&summary, "range correction")["estimated"], true);
    assert!(!bench.path("out/range_bias_over.csv").exists());
    let calibration = std::fs::read_to_string(bench.path("out/calibration.toml")).expect("a calibration");
    assert!(!calibration.contains("[[range_correction_over]]"));
}
