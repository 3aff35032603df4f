//! The whole way of drives: our own sample, and an independent simulator's, judged against truth that the program never sees.

mod common;

use std::path::Path;

use common::Bench;
use tieline_filter::Trajectory;
use tieline_io::trajectory::{ReadOptions, read};

fn load(path: &Path) -> Trajectory {
    read(path, &ReadOptions { format: None, columns: None, accuracy: None }).expect("a trajectory").trajectory
}

/// Largest error north, east, down \[m\] between two times of a trajectory.
fn largest_error_m(path: &Path, truth: &Path, from_s: f64, to_s: f64) -> [f64; 3] {
    let (new, truth) = (load(path), load(truth));
    let mut largest = [0.0_f64; 3];
    for (i, time_s) in new.time_s().iter().enumerate() {
        if *time_s <= from_s || *time_s > to_s {
            continue;
        }
        let Some(pose) = truth.pose_at(*time_s) else { continue };
        let d = new.position()[i] - pose.position;
        let error = [d.x * 6.371e6, d.y * 6.371e6 * pose.position.x.cos(), d.z];
        for k in 0..3 {
            largest[k] = largest[k].max(error[k].abs());
        }
    }
    largest
}

#[test]
fn the_sample_drive_gets_better_in_its_outage() {
    let bench = Bench::new();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop");
    let project = sample.join("project.toml");
    let ran = bench.tieline(&["run", project.to_str().expect("UTF-8"), "--out", "out"]);
    ran.assert_success();
    assert!(ran.out.contains("report.html"), "{}", ran.out);
    let outage = std::fs::read_to_string(sample.join("truth/outages.csv")).expect("outages");
    let times: Vec<f64> =
        outage.lines().nth(1).expect("one").split(',').take(2).map(|f| f.parse().expect("a time")).collect();
    let truth = sample.join("truth/truth.sbet");
    let before = largest_error_m(&sample.join("trajectory.sbet"), &truth, times[0], times[1]);
    let after = largest_error_m(&bench.path("out/trajectory.sbet"), &truth, times[0], times[1]);
    let plan = |e: [f64; 3]| e[0].hypot(e[1]);
    assert!(plan(before) > 0.04 && plan(after) < 0.025 && after[2] < 0.025, "{before:?} {after:?}");
    for name in [
        "report.html",
        "summary.json",
        "ties.parquet",
        "calibration.toml",
        "range_bias.csv",
        "correction.csv",
        "trajectory.csv",
        "trajectory_rms.out",
        "forward.csv",
        "corrected/pass1.laz",
        "corrected/pass2.laz",
    ] {
        assert!(bench.path("out").join(name).is_file(), "{name}");
    }
    // three lines for a person, and the same for machines
    assert_eq!(ran.out.lines().count(), 3, "{}", ran.out);
    let text = std::fs::read_to_string(bench.path("out/summary.json")).expect("a summary");
    let summary: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let d = &summary["discrepancy"];
    let rms = |stage: &str| d[stage]["sigma_mad_m"].as_f64().expect("a number");
    assert!(rms("after") < rms("before") && rms("held_out_after") < rms("held_out_before"), "{d}");
    let ties = &summary["ties"];
    for kind in ["surface_line", "increment"] {
        let n = |key: &str| ties[kind][key].as_u64().expect("a number");
        assert!(n("found") >= n("used") + n("held_out") && n("used") > 0, "{kind}: {ties}");
    }
    assert!(summary["ties_by_class"]["scanner to scanner"]["found"].is_u64(), "{text}");
    let gaps = summary["trajectory"]["outages"].as_array().expect("outages");
    assert!(gaps.iter().any(|g| (g["start_s"].as_f64().expect("a time") - times[0]).abs() < 1.5), "{gaps:?}");
    let page = std::fs::read_to_string(bench.path("out/report.html")).expect("a page");
    assert!(!page.contains("NaN") && !page.contains("//") && page.contains("<section id=\"trajectory\">"));
    // the calibration is loadable as a platform
    let calibration = std::fs::read_to_string(bench.path("out/calibration.toml")).expect("calibration");
    assert!(calibration.contains("[[platform.scanner]]") && calibration.contains("boresight_deg"), "{calibration}");
}

#[test]
fn a_drive_of_an_independent_simulator_gets_better_in_its_outage() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/mms-sim-block");
    if !data.is_dir() {
        assert!(std::env::var_os("CI").is_none(), "{} is not there", data.display());
        return;
    }
    let bench = Bench::new();
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/real/mms-sim-block.toml");
    bench.tieline(&["run", project.to_str().expect("UTF-8"), "--out", "out", "-q"]).assert_success();
    let after =
        largest_error_m(&bench.path("out/trajectory.sbet"), &data.join("truth/truth.sbet"), 209_087.0, 209_147.0);
    assert!(after[0] <= 0.025 && after[1] <= 0.025 && after[2] <= 0.020, "{after:?}");
    // range bias against the true curves, less what is common to both scanners
    let truth = std::fs::read_to_string(data.join("truth/bias_functions.csv")).expect("true curves");
    let found = std::fs::read_to_string(bench.path("out/range_bias.csv")).expect("curves");
    let table = |text: &str, offset: u16| -> std::collections::BTreeMap<(u16, u32), f64> {
        text.lines()
            .skip(1)
            .map(|l| {
                let f: Vec<&str> = l.split(',').collect();
                let scanner = f[0].parse::<u16>().expect("a scanner") - offset;
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of quarter metres
                let range = (f[1].parse::<f64>().expect("a range") * 4.0).round() as u32;
                ((scanner, range), f[2].parse().expect("a bias"))
            })
            .collect()
    };
    let (truth, found) = (table(&truth, 1), table(&found, 0));
    let difference: Vec<f64> =
        found.iter().filter(|((_, r), _)| (10..=80).contains(r)).filter_map(|(k, v)| Some(v - truth.get(k)?)).collect();
    #[allow(clippy::cast_precision_loss)] // hundreds
    let n = difference.len() as f64;
    let mean = difference.iter().sum::<f64>() / n;
    let rms = (difference.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n).sqrt();
    assert!(n > 120.0 && rms < 0.0015, "{rms} over {n}");
}
