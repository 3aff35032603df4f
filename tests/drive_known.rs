//! Drives with a calibration found before (`calibrate.known`), and with some surfaces only (`match.surfaces`).

mod common;

use std::path::Path;

use common::Bench;
use tieline_io::las::{Columns, LasFile};
use tieline_io::ties::text::TieTextReader;

/// The project of the sample drive with absolute paths and more in it.
fn project(bench: &Bench, name: &str, more: &str) -> String {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop");
    let text = std::fs::read_to_string(sample.join("project.toml")).expect("the sample");
    let absolute = text.replace("path = \"", &format!("path = \"{}/", sample.display()));
    let absolute = absolute.replace("accuracy = \"", &format!("accuracy = \"{}/", sample.display()));
    let file = bench.path(name);
    std::fs::write(&file, absolute + more).expect("written");
    file.display().to_string()
}

fn run(bench: &Bench, name: &str, more: &str) -> serde_json::Value {
    let file = project(bench, &format!("{name}.toml"), more);
    bench.tieline(&["run", &file, "--out", name, "--json"]).json()
}

/// Points of a corrected strip \[m\].
fn points(bench: &Bench, name: &str) -> Vec<[f64; 3]> {
    let las = LasFile::open(&bench.path(name)).expect("a strip");
    let scale_m = las.header().scale[0];
    let (mut records, mut columns, mut all) = (Vec::new(), Columns::default(), Vec::new());
    for chunk in 0..las.chunk_count() {
        las.read_columns(chunk, &mut records, &mut columns).expect("a chunk");
        all.extend(
            (0..columns.len()).map(|i| [columns.x[i], columns.y[i], columns.z[i]].map(|v| f64::from(v) * scale_m)),
        );
    }
    all
}

/// Largest and median distance of the points of two corrected strips \[m\].
fn distance_m(bench: &Bench, a: &str, b: &str) -> (f64, f64) {
    let (a, b) = (points(bench, a), points(bench, b));
    assert_eq!(a.len(), b.len());
    let of = |(p, q): (&[f64; 3], &[f64; 3])| p.iter().zip(q).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt();
    let mut all: Vec<f64> = a.iter().zip(&b).map(of).collect();
    all.sort_by(f64::total_cmp);
    (all[all.len() - 1], all[all.len() / 2])
}

fn test_of<'a>(summary: &'a serde_json::Value, scanner: u64, name: &str) -> Option<&'a serde_json::Value> {
    let terms = summary["calibration"]["terms"].as_array().expect("terms");
    terms.iter().find(|t| t["scanner"].as_u64() == Some(scanner) && t["name"] == name)
}

#[test]
fn a_known_calibration_stands_for_the_estimate() {
    let bench = Bench::new();
    let first = run(&bench, "first", "");
    assert_eq!(test_of(&first, 0, "range correction").expect("judged")["estimated"], true);
    let known = "\n[calibrate]\nknown = \"first/calibration.toml\"\n";
    // held: the same cloud, though nothing is estimated
    let held = run(&bench, "held", &format!("{known}enabled = false\n"));
    assert!(test_of(&held, 0, "boresight").is_none(), "nothing is estimated");
    let (most_m, middle_m) = distance_m(&bench, "first/corrected/pass2.laz", "held/corrected/pass2.laz");
    assert!(most_m < 0.005 && middle_m < 0.001, "{most_m} {middle_m}");
    let curve = |name: &str| std::fs::read_to_string(bench.path(name)).expect("a curve");
    let bias = |text: &str| -> Vec<f64> {
        text.lines().skip(1).map(|l| l.split(',').nth(2).expect("a bias").parse().expect("a number")).collect()
    };
    let pairs = [curve("first/range_bias.csv"), curve("held/range_bias.csv")].map(|t| bias(&t));
    assert!(pairs[0].iter().zip(&pairs[1]).all(|(a, b)| (a - b).abs() < 2e-6), "{pairs:?}");
    assert!(pairs[0].iter().any(|b| b.abs() > 0.003), "a bias was there");
    // estimated on top of it: nothing is left to be found
    let again = run(&bench, "again", known);
    for term in ["boresight", "range correction"] {
        assert_eq!(test_of(&again, 0, term).expect("judged")["estimated"], false, "{again}");
    }
    assert_eq!(curve("again/range_bias.csv"), curve("held/range_bias.csv"));
    // one term left out: it stays in the cloud
    run(
        &bench,
        "without",
        &format!("{known}known_terms = [\"boresight\", \"lever_arm\", \"latency\"]\nenabled = false\n"),
    );
    assert!(bias(&curve("without/range_bias.csv")).iter().all(|b| *b == 0.0));
    let (_, middle_m) = distance_m(&bench, "first/corrected/pass2.laz", "without/corrected/pass2.laz");
    assert!(middle_m > 0.002, "{middle_m}");
}

#[test]
fn a_known_calibration_that_cannot_be_taken_is_refused_before_the_work() {
    let bench = Bench::new();
    let refuse = |known: &str, words: &[&str]| {
        let file = project(&bench, "bad.toml", &format!("\n[calibrate]\nknown = \"{known}\"\n"));
        bench.tieline(&["run", &file, "--out", "bad"]).assert_refused(words);
        assert!(!bench.path("bad/corrected").exists());
    };
    refuse("nowhere.toml", &["calibrate.known", "nowhere.toml"]);
    std::fs::write(bench.path("one.toml"), "[platform]\n[[platform.scanner]]\nid = 0\n").expect("written");
    refuse("one.toml", &["one.toml", "scanner 1 is missing", "[0]"]);
    std::fs::write(bench.path("text.toml"), "no toml\n").expect("written");
    refuse("text.toml", &["text.toml", "calibration.toml of a drive"]);
    bench.edit_project(|text| text + "\n[calibrate]\nknown = \"one.toml\"\n");
    bench.refuses_to_run(&["calibrate.known", "[imu]"]);
}

#[test]
fn steep_surfaces_can_be_left_out() {
    let bench = Bench::new();
    run(&bench, "level", "\n[match]\nsurfaces = [\"level\"]\n");
    let of = |name: &str| -> Vec<f64> {
        TieTextReader::open(&bench.path(name))
            .expect("ties")
            .map(|tie| {
                let tie = tie.expect("a tie");
                // the sample lies about 48.21° N, 16.36° E
                let (lat, lon) = (48.21_f64.to_radians(), 16.36_f64.to_radians());
                let up = nalgebra::Vector3::new(lat.cos() * lon.cos(), lat.cos() * lon.sin(), lat.sin());
                tie.directions[0].dot(&up).abs()
            })
            .collect()
    };
    let level = of("level/ties.txt");
    assert!(level.len() > 100 && level.iter().all(|up| *up > 0.6), "{level:?}");
    let file = project(&bench, "none.toml", "\n[match]\nsurfaces = []\n");
    bench.tieline(&["run", &file, "--out", "none"]).assert_refused(&["match.surfaces", "steep"]);
}
