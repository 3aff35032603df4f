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
const BORESIGHT: &str = "boresight_error_deg = [0.014, -0.028, 0.019]";

/// One lap round a block by two scanners; half of the drives go the other way.
fn simulate(bench: &Bench, name: &str, seed: u32) -> String {
    simulate_with(bench, name, seed, |text| text)
}

/// The same of a scenario that is changed.
fn simulate_with(bench: &Bench, name: &str, seed: u32, change: impl Fn(String) -> String) -> String {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/scenarios/loop.toml"))
        .expect("the scenario");
    let lap = "[[drive.lap]]\nnodes = [\"begin\", \"a\", \"b\", \"c\", \"d\", \"begin\"]\n\n";
    let outage = "[[gnss.outage]]\nstart_s = 68.0\nlength_s = 46.0\n\n";
    assert!(text.matches(lap).count() == 2 && text.contains(outage), "the scenario has changed");
    let way = if seed.is_multiple_of(2) { "\"d\", \"c\", \"b\", \"a\"" } else { "\"a\", \"b\", \"c\", \"d\"" };
    let text = text
        .replace(lap, "")
        .replace("[[drive.stop]]", &format!("[[drive.lap]]\nnodes = [\"begin\", {way}, \"begin\"]\n\n[[drive.stop]]"))
        .replace(outage, "")
        .replace("\nseed = 5", &format!("\nseed = {seed}"))
        .replace("scene_seed = 3", &format!("scene_seed = {}", 100 + seed));
    assert!(text.contains(BORESIGHT), "the scenario has changed");
    std::fs::write(bench.path(&format!("{name}_scenario.toml")), change(text)).expect("written");
    bench.tieline(&["simulate", &format!("{name}_scenario.toml"), "--out", name, "-q"]).assert_success();
    let project = format!("{name}/{name}.toml");
    std::fs::rename(bench.path(&format!("{name}/project.toml")), bench.path(&project)).expect("renamed");
    project
}

fn calibrate(bench: &Bench, projects: &[&str], out: &str) -> serde_json::Value {
    bench.tieline(&[&["calibrate"], projects, &["--out", out, "--json"]].concat()).json()
}

/// Whether a term is estimated.
fn term<'a>(summary: &'a serde_json::Value, name: &str) -> &'a serde_json::Value {
    let terms = summary["calibration"]["terms"].as_array().expect("terms");
    &terms.iter().find(|t| t["name"] == name).expect("judged")["estimated"]
}

/// True mounting, and true range biases, of a simulated drive.
fn truth_of(bench: &Bench, name: &str) -> (toml::Table, String) {
    let read = |file: &str| std::fs::read_to_string(bench.path(name).join("truth").join(file)).expect("truth");
    (read("calibration_true.toml").parse().expect("TOML"), read("bias_functions.csv"))
}

#[test]
fn two_drives_tell_more_of_their_scanners_than_each_alone() {
    let bench = Bench::new();
    let (monday, friday) = (simulate(&bench, "monday", 11), simulate(&bench, "friday", 12));
    // two boresights are there, and one lap alone does not tell them from nothing
    let alone = calibrate(&bench, &[&monday], "of_monday");
    assert_eq!(term(&alone, "boresight"), false, "{alone}");
    let summary = calibrate(&bench, &[&monday, &friday], "of_both");
    assert_eq!(term(&summary, "boresight"), true, "{summary}");
    let drives = summary["drives"].as_array().expect("drives");
    assert_eq!(drives.iter().map(|d| d["name"].as_str().expect("a name")).collect::<Vec<_>>(), ["monday", "friday"]);
    assert!(drives.iter().all(|d| d["agrees"] == true && d["degrees_of_freedom"].as_u64() > Some(3)), "{summary}");
    assert!(bench.path("of_both/monday/stages/match.json").is_file());
    // with all terms: every sigma is below that of each drive, and the truth lies within four of them
    let ranges_m = [(2.0, 45.0), (2.0, 45.0)];
    let each = [&monday, &friday].map(|project| estimate(&bench, project, &ranges_m));
    let constants = &each[0].0;
    let n = constants.count();
    let prior = nalgebra::DMatrix::from_row_slice(n, n, &constants.covariance());
    let both = combine(&prior, &[&each[0].1, &each[1].1]).expect("combined").estimate;
    for k in 0..n {
        let [a, b] = [&each[0].1, &each[1].1].map(|e| e.sigma(k));
        assert!(both.sigma(k) <= a.min(b) * (1.0 + 1e-9), "constant {k}: {} {a} {b}", both.sigma(k));
    }
    let boresight = |e: &CalibrationEstimate| -> f64 {
        let first = [0, 1].map(|s| constants.first(s, Term::Boresight).expect("estimated"));
        first.iter().flat_map(|f| (0..3).map(move |k| f + k)).map(|k| e.sigma(k).powi(2)).sum::<f64>().sqrt()
    };
    // how much less depends on how alike the drives are; that it is the sum of what they say, combine's own tests show
    let (together, alone) = (boresight(&both), each.each_ref().map(|e| boresight(&e.1)));
    assert!(together < 0.99 * alone[0].min(alone[1]), "{together} {alone:?}");
    let (truth, curves) = truth_of(&bench, "monday");
    let ratios = ratios(constants, &both, &truth, &curves);
    assert!(ratios.len() > 10 && ratios.iter().all(|r| r.abs() < 4.0), "{ratios:?}");
    // it can be taken as known, for a drive alone
    let text = std::fs::read_to_string(bench.path(&friday)).expect("a project");
    let known = text + "\n[calibrate]\nknown = \"../of_both/calibration.toml\"\n";
    std::fs::write(bench.path("friday/known.toml"), known).expect("written");
    let again = calibrate(&bench, &["friday/known.toml"], "again");
    assert_eq!(term(&again, "boresight"), false, "nothing is left to be found: {again}");

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
        .replace(BORESIGHT, "boresight_error_deg = [-0.014, 0.028, -0.019]")
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
    let adjusted = drive.adjust(ranges_m, &[], &mut Decisions::default(), &mut 0, &mut clock).expect("adjusted");
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

/// Statistics of drives put together: errors over sigmas, and agreement. The scanners have no bumps in their range bias: at 3000 points a second
/// errors that all drives have alike are larger with them, which no number of drives makes less (docs/mobile.md). Some minutes:
/// `cargo test --release --test drives_together -- --ignored --nocapture`.
#[test]
#[ignore = "minutes"]
#[allow(clippy::print_stdout)] // figures for docs/mobile.md
fn errors_of_a_common_calibration_are_as_large_as_its_sigmas() {
    let bench = Bench::new();
    let ranges_m = [(2.0, 45.0), (2.0, 45.0)];
    let mut drives = Vec::new();
    let (mut truth, mut curves) = (toml::Table::new(), String::new());
    for seed in 21..37 {
        let name = format!("drive{seed}");
        let project = simulate_with(&bench, &name, seed, |text| {
            let without = text.lines().filter(|l| !l.starts_with("bias_bump")).map(|l| format!("{l}\n"));
            without.collect()
        });
        (truth, curves) = truth_of(&bench, &name);
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
            let found = ratios(constants, &combined.estimate, &truth, &curves);
            for ratio in found {
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
    statistics("all sixteen", &drives.chunks(16).collect::<Vec<_>>());
    #[allow(clippy::cast_precision_loss)] // hundreds
    let of_freedom = freedom as f64;
    assert!(squared < 1.5 && inside > 0.9, "{squared} {inside}");
    assert!(chi < chi_squared_limit(freedom, 0.001) && chi > 0.5 * of_freedom, "{chi} of {freedom}");
}
