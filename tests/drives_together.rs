//! Several drives of one platform in one calibration.

mod common;

use std::path::Path;

use common::Bench;
use tieline::job::{Clock, JobOptions, match_drive};
use tieline::progress::Progress;
use tieline::project::Project;
use tieline::stage::drive::combine::{Agreement, combine};
use tieline::stage::drive::constants::{Constants, Term};
use tieline::stage::drive::{Decisions, Prepared};
use tieline::stage::navigate::load;
use tieline_filter::CalibrationEstimate;
use tieline_filter::innovation::chi_squared_limit;

/// Of scanner 0.
const BORESIGHT: &str = "boresight_error_deg = [0.05, -0.08, 0.06]";

/// One lap round a block by two scanners with boresights that a lap tells from nothing; half of the drives go the other way.
fn simulate(bench: &Bench, name: &str, seed: u32) -> String {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/scenarios/loop.toml"))
        .expect("the scenario");
    let lap = "[[drive.lap]]\nnodes = [\"begin\", \"a\", \"b\", \"c\", \"d\", \"begin\"]\n\n";
    let outage = "[[gnss.outage]]\nstart_s = 68.0\nlength_s = 46.0\n\n";
    assert!(text.matches(lap).count() == 2 && text.contains(outage), "the scenario has changed");
    let way = if seed % 2 == 0 { "\"d\", \"c\", \"b\", \"a\"" } else { "\"a\", \"b\", \"c\", \"d\"" };
    let text = text
        .replace(lap, "")
        .replace("[[drive.stop]]", &format!("[[drive.lap]]\nnodes = [\"begin\", {way}, \"begin\"]\n\n[[drive.stop]]"))
        .replace(outage, "")
        .replace("pulse_rate_hz = 3000.0\nprofile_rate_hz = 25.0", "pulse_rate_hz = 6000.0\nprofile_rate_hz = 50.0")
        .replace("boresight_error_deg = [0.014, -0.028, 0.019]", BORESIGHT)
        .replace("boresight_error_deg = [-0.030, -0.024, -0.026]", "boresight_error_deg = [-0.09, -0.07, -0.08]")
        .replace("\nseed = 5", &format!("\nseed = {seed}"))
        .replace("scene_seed = 3", &format!("scene_seed = {}", 100 + seed));
    assert!(text.contains("6000.0") && text.contains(BORESIGHT) && text.contains("-0.08]"), "the scenario has changed");
    std::fs::write(bench.path(&format!("{name}_scenario.toml")), text).expect("written");
    bench.tieline(&["simulate", &format!("{name}_scenario.toml"), "--out", name, "-q"]).assert_success();
    let project = format!("{name}/{name}.toml");
    std::fs::rename(bench.path(&format!("{name}/project.toml")), bench.path(&project)).expect("renamed");
    project
}

/// A value of a calibration with its sigma and its truth.
#[derive(Debug)]
struct Found {
    name: String,
    value: f64,
    sigma: f64,
    truth: f64,
}

/// Boresight of scanner 1 less that of scanner 0 \[deg\], and range biases of both \[m\].
fn found(bench: &Bench, folder: &str, drive: &str) -> Vec<Found> {
    let read = |path: String| std::fs::read_to_string(bench.path(&path)).expect("there");
    let table: toml::Table = read(format!("{folder}/calibration.toml")).parse().expect("TOML");
    let truth: toml::Table = read(format!("{drive}/truth/calibration_true.toml")).parse().expect("TOML");
    let number = |v: &toml::Value| v.as_float().expect("a number");
    let of = |scanner: &str, axis: usize| number(&truth[scanner]["misalignment_body_deg"][axis]);
    let relative = table["relative"].as_array().expect("relative values").iter();
    let mut all = Vec::new();
    for row in relative {
        let name = row["name"].as_str().expect("a name").to_string();
        let Some(axis) = ["boresight x", "boresight y", "boresight z"].iter().position(|n| *n == name) else {
            continue;
        };
        let truth = of("scanner2", axis) - of("scanner1", axis);
        all.push(Found { name, value: number(&row["value"]), sigma: number(&row["sigma"]), truth });
    }
    let curve = |text: &str, first: u32| -> std::collections::BTreeMap<(u32, String), (f64, f64)> {
        let rows = text.lines().skip(1).map(|l| {
            let f: Vec<&str> = l.split(',').collect();
            let sigma = f.get(3).map_or(0.0, |s| s.parse().expect("a sigma"));
            (
                (f[0].parse::<u32>().expect("a scanner") - first, f[1].to_string()),
                (f[2].parse().expect("a bias"), sigma),
            )
        });
        rows.collect()
    };
    let biases = curve(&read(format!("{folder}/range_bias.csv")), 0);
    let truth = curve(&read(format!("{drive}/truth/bias_functions.csv")), 1);
    for range in ["3.00", "4.00", "5.00", "6.00"] {
        let two = |table: &std::collections::BTreeMap<(u32, String), (f64, f64)>| {
            [0, 1].map(|s| table[&(s, range.to_string())])
        };
        let (b, t) = (two(&biases), two(&truth));
        for s in 0..2 {
            let name = format!("bias of scanner {s} at {range} m");
            all.push(Found { name, value: b[s].0, sigma: b[s].1, truth: t[s].0 });
        }
    }
    all
}

fn calibrate(bench: &Bench, projects: &[&str], out: &str) -> serde_json::Value {
    bench.tieline(&[&["calibrate"], projects, &["--out", out, "--json"]].concat()).json()
}

#[test]
fn two_drives_tell_more_of_their_scanners_than_each_alone() {
    let bench = Bench::new();
    let (monday, friday) = (simulate(&bench, "monday", 11), simulate(&bench, "friday", 12));
    calibrate(&bench, &[&monday], "of_monday");
    calibrate(&bench, &[&friday], "of_friday");
    let summary = calibrate(&bench, &[&monday, &friday], "of_both");
    let drives = summary["drives"].as_array().expect("drives");
    assert_eq!(drives.iter().map(|d| d["name"].as_str().expect("a name")).collect::<Vec<_>>(), ["monday", "friday"]);
    assert!(drives.iter().all(|d| d["agrees"] == true && d["degrees_of_freedom"].as_u64() > Some(3)), "{summary}");
    assert!(bench.path("of_both/monday/stages/match.json").is_file());
    let [a, b, both] = ["of_monday", "of_friday", "of_both"].map(|folder| found(&bench, folder, "monday"));
    assert!(both.iter().filter(|f| f.name.starts_with("boresight")).count() == 3, "{both:?}");
    for ((a, b), both) in a.iter().zip(&b).zip(&both) {
        assert!(both.sigma < a.sigma && both.sigma < b.sigma, "{a:?} {b:?} {both:?}");
        assert!((both.value - both.truth).abs() < 4.0 * both.sigma, "{both:?}");
    }
    // it can be taken as known, for a drive alone
    let text = std::fs::read_to_string(bench.path(&friday)).expect("a project");
    let known = text + "\n[calibrate]\nknown = \"../of_both/calibration.toml\"\n";
    std::fs::write(bench.path("friday/known.toml"), known).expect("written");
    let again = calibrate(&bench, &["friday/known.toml"], "again");
    let terms = again["calibration"]["terms"].as_array().expect("terms");
    let boresight = terms.iter().find(|t| t["name"] == "boresight").expect("judged");
    assert_eq!(boresight["estimated"], false, "nothing is left to be found: {again}");

    // a scanner that was turned between the drives: its strips are as before, its drive is not
    let turned = std::fs::read_to_string(bench.path(&friday)).expect("a project");
    std::fs::write(bench.path("friday/turned.toml"), turned.replace("20.1, -134.8]", "20.3, -134.8]"))
        .expect("written");
    bench.tieline(&["calibrate", &monday, "friday/turned.toml", "--out", "turned"]).assert_refused(&[
        "platform.scanner 0",
        "mounting_deg",
        "monday",
        "turned",
        "20.3",
    ]);
    let one = std::fs::read_to_string(bench.path(&friday)).expect("a project").replace("id = 1", "id = 3");
    std::fs::write(bench.path("friday/other.toml"), one).expect("written");
    bench
        .tieline(&["calibrate", &monday, "friday/other.toml", "--out", "turned"])
        .assert_refused(&["[0, 1]", "[0, 3]", "monday", "other"]);
    assert!(!bench.path("turned").exists());
}

#[test]
fn drives_that_contradict_each_other_are_named() {
    let bench = Bench::new();
    let monday = simulate(&bench, "monday", 11);
    simulate(&bench, "friday", 12);
    // another vehicle: the signs of all its errors are the other way
    let scenario = std::fs::read_to_string(bench.path("friday_scenario.toml")).expect("a scenario");
    let other = scenario
        .replace(BORESIGHT, "boresight_error_deg = [-0.05, 0.08, -0.06]")
        .replace("height_m = -0.009", "height_m = 0.006");
    assert_ne!(other, scenario);
    std::fs::write(bench.path("friday_scenario.toml"), other).expect("written");
    bench.tieline(&["simulate", "friday_scenario.toml", "--out", "friday", "--overwrite", "-q"]).assert_success();
    let ran = bench.tieline(&["calibrate", &monday, "friday/project.toml", "--out", "both"]);
    ran.assert_success();
    assert!(ran.err.contains("monday and project contradict each other"), "{}", ran.err);
    assert!(ran.err.contains("times what their sigmas say"), "{}", ran.err);
}

/// What a drive says of the constants, with all terms, range splines over `ranges_m`.
fn estimate(bench: &Bench, project: &str, ranges_m: &[(f64, f64)]) -> (Constants, CalibrationEstimate) {
    let project = Project::load(&bench.path(project)).expect("a project");
    let mut clock = Clock::default();
    let options = JobOptions { out: bench.path("none"), memory_bytes: 256 << 20, progress: Progress::silent() };
    let measurements = load(&project, &[]).expect("measurements");
    let matched = match_drive(&project, &measurements, &options, &mut clock).expect("ties");
    let drive = Prepared::new(&project, &matched, &measurements, &[], 256 << 20, &mut clock).expect("a drive");
    let adjusted = drive.adjust(ranges_m, &mut Decisions::default(), &mut 0, &mut clock).expect("adjusted");
    (adjusted.constants, adjusted.solution.calibration)
}

/// Boresight of scanner 1 less scanner 0 \[rad\], and what each range bias bends by against 5 m \[m\]: errors over their sigmas.
fn ratios(constants: &Constants, estimate: &CalibrationEstimate, truth: &toml::Table, curves: &str) -> Vec<f64> {
    let n = estimate.value.len();
    let ratio = |row: &[(usize, f64)], truth: f64| {
        let value: f64 = row.iter().map(|(k, w)| w * estimate.value[*k]).sum();
        let variance: f64 = row
            .iter()
            .flat_map(|(i, wi)| row.iter().map(move |(j, wj)| (i * n + j, wi * wj)))
            .map(|(at, w)| w * estimate.covariance[at])
            .sum();
        (value - truth) / variance.sqrt()
    };
    let first = |scanner, term| constants.first(scanner, term).expect("estimated");
    let mut all = Vec::new();
    for axis in 0..3 {
        let of = |s: &str| truth[s]["misalignment_body_deg"][axis].as_float().expect("degrees").to_radians();
        let row = [(first(1, Term::Boresight) + axis, 1.0), (first(0, Term::Boresight) + axis, -1.0)];
        all.push(ratio(&row, of("scanner2") - of("scanner1")));
    }
    let bias = |scanner: usize, range_m: f64| -> f64 {
        let key = format!("{},{range_m:.2},", scanner + 1);
        curves.lines().find_map(|l| l.strip_prefix(&key)).expect("a range").parse().expect("a bias")
    };
    for scanner in 0..2 {
        for range_m in [3.0, 4.0, 6.0, 7.0, 8.0] {
            let mut row = Vec::new();
            for (at_m, sign) in [(range_m, 1.0), (5.0, -1.0)] {
                let (knot, weights) = constants.splines[scanner].weights(at_m);
                row.extend(weights.iter().enumerate().map(|(k, w)| (first(scanner, Term::Range) + knot + k, sign * w)));
            }
            // a correction is the bias with its sign changed
            all.push(ratio(&row, bias(scanner, 5.0) - bias(scanner, range_m)));
        }
    }
    all
}

/// Statistics of drives put together: errors over sigmas, and agreement. Some minutes:
/// `cargo test --release --test drives_together -- --ignored --nocapture`.
#[test]
#[ignore = "minutes"]
fn errors_of_a_common_calibration_are_as_large_as_its_sigmas() {
    let bench = Bench::new();
    let ranges_m = [(2.0, 45.0), (2.0, 45.0)];
    let mut drives = Vec::new();
    let (mut truth, mut curves) = (toml::Table::new(), String::new());
    for seed in 21..37 {
        let name = format!("drive{seed}");
        let project = simulate(&bench, &name, seed);
        let read = |file: &str| std::fs::read_to_string(bench.path(&name).join("truth").join(file)).expect("truth");
        (truth, curves) = (read("calibration_true.toml").parse().expect("TOML"), read("bias_functions.csv"));
        drives.push(estimate(&bench, &project, &ranges_m));
        std::fs::remove_dir_all(bench.path(&name)).expect("removed");
    }
    let constants = &drives[0].0;
    let n = constants.count();
    let prior = nalgebra::DMatrix::from_row_slice(n, n, &constants.covariance());
    let statistics = |title: &str, groups: &[&[(Constants, CalibrationEstimate)]]| {
        let (mut squared, mut count, mut inside) = (0.0, 0.0, 0.0);
        let (mut chi, mut freedom, mut held) = (0.0, 0, 0);
        for group in groups {
            let estimates: Vec<&CalibrationEstimate> = group.iter().map(|d| &d.1).collect();
            let combined = combine(&prior, &estimates).expect("combined");
            let last = combined.agreements[combined.agreements.len() - 1];
            chi += last.squared;
            freedom += last.freedom;
            held += usize::from(combined.agreements.iter().all(Agreement::holds));
            for ratio in ratios(constants, &combined.estimate, &truth, &curves) {
                squared += ratio * ratio;
                count += 1.0;
                inside += f64::from(u8::from(ratio.abs() < 1.96));
            }
        }
        println!(
            "{title}: mean square {:.2}, inside 95 % intervals {:.1} %, chi-squared {chi:.0} of {freedom}, {held} of {} agree",
            squared / count,
            inside / count * 100.0,
            groups.len()
        );
        (squared / count, inside / count, chi, freedom)
    };
    statistics("alone", &drives.chunks(1).collect::<Vec<_>>());
    let (squared, inside, chi, freedom) = statistics("in pairs", &drives.chunks(2).collect::<Vec<_>>());
    statistics("in fours", &drives.chunks(4).collect::<Vec<_>>());
    #[allow(clippy::cast_precision_loss)] // hundreds
    let of_freedom = freedom as f64;
    assert!(squared < 1.5 && inside > 0.9, "{squared} {inside}");
    assert!(chi < chi_squared_limit(freedom, 0.001) && chi > 0.5 * of_freedom, "{chi} of {freedom}");
}
