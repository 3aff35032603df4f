//! Mistakes with drives: each has a message that names what is wrong and what to do.

mod common;

use std::path::{Path, PathBuf};

use common::Bench;
use tieline::project::Project;
use tieline::sample::Sample;
use tieline::stage::drive::check;
use tieline::stage::{navigate, trajectory};
use tieline::survey::Survey;

/// The project of the sample drive with its paths made absolute, changed.
fn project(bench: &Bench, change: impl Fn(String) -> String) -> PathBuf {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop");
    let text = std::fs::read_to_string(sample.join("project.toml")).expect("the sample");
    let absolute = text.replace("path = \"", &format!("path = \"{}/", sample.display()));
    let absolute = absolute.replace("accuracy = \"", &format!("accuracy = \"{}/", sample.display()));
    let file = bench.path("drive.toml");
    std::fs::write(&file, change(absolute)).expect("written");
    file
}

/// What a look at a sample of the points finds, before all of them are read.
fn found_early(change: impl Fn(String) -> String) -> String {
    let bench = Bench::new();
    let project = Project::load(&project(&bench, change)).expect("a project");
    let measurements = navigate::load(&project, &[]).expect("measurements");
    let survey = Survey::open(&project).expect("a survey");
    let sample = Sample::read(&survey).expect("a sample");
    let read: usize = sample.chunks.iter().map(|c| c.1.len()).sum();
    assert!((read as u64) < survey.points(), "a sample is not everything");
    let delivered = trajectory::load(&project, &survey, &mut Vec::new()).expect("a trajectory");
    let rule = sample.source_rule(&project).0;
    match check::before_scan(&project, &survey, &sample, &rule, delivered.as_ref(), &measurements) {
        Ok(()) => String::new(),
        Err(error) => format!("{error:#}"),
    }
}

fn refused_early(change: impl Fn(String) -> String, words: &[&str]) {
    let message = found_early(&change);
    for word in words {
        assert!(message.contains(word), "\"{word}\" is not in: {message}");
    }
    refused(change, words);
}

fn refused(change: impl Fn(String) -> String, words: &[&str]) {
    let bench = Bench::new();
    let file = project(&bench, change);
    bench.tieline(&["run", file.to_str().expect("UTF-8"), "--out", "out"]).assert_refused(words);
    assert!(!bench.path("out/corrected").exists() && !bench.path("out/trajectory.csv").exists());
}

#[test]
fn a_drive_without_mistakes_passes_the_look() {
    assert_eq!(found_early(|t| t), "");
}

#[test]
fn scanner_ids_that_do_not_match_are_named() {
    refused_early(|t| t.replace("id = 1", "id = 5"), &["2 scanners", "[0, 5]", "scanner 1 is missing", "count from 0"]);
}

#[test]
fn a_platform_without_scanners_is_asked_for() {
    refused_early(
        |t| t.split("[[platform.scanner]]").next().expect("a head").to_string(),
        &["[platform] names no scanner", "lever_arm_m"],
    );
}

#[test]
fn a_wrong_week_is_said() {
    refused(|t| t.replace("week = 2330", "week = 2331"), &["week"]);
}

#[test]
fn mounting_angles_in_radians_are_recognised() {
    let radians = |text: String| -> String {
        text.lines()
            .map(|line| {
                let Some(list) = line.strip_prefix("mounting_deg = [").and_then(|l| l.strip_suffix(']')) else {
                    return format!("{line}\n");
                };
                let values: Vec<String> = list
                    .split(',')
                    .map(|v| v.trim().parse::<f64>().expect("degrees").to_radians().to_string())
                    .collect();
                format!("mounting_deg = [{}]\n", values.join(", "))
            })
            .collect()
    };
    refused_early(radians, &["platform.scanner 0", "mounting_deg", "radians", "give degrees"]);
}

#[test]
fn an_imu_of_another_time_is_refused() {
    // the strips reach beyond an IMU file that was cut
    let bench = Bench::new();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop/imu.txt.gz");
    let mut text = String::new();
    std::io::Read::read_to_string(
        &mut flate2::read::GzDecoder::new(std::fs::File::open(sample).expect("the IMU")),
        &mut text,
    )
    .expect("text");
    let half: Vec<&str> = text.lines().take(text.lines().count() / 2).collect();
    std::fs::write(bench.path("imu.txt"), half.join("\n")).expect("written");
    let imu = bench.path("imu.txt");
    let file =
        project(&bench, |t| {
            t.lines()
                .map(|l| {
                    if l.ends_with("imu.txt.gz\"") {
                        format!("path = \"{}\"\n", imu.display())
                    } else {
                        format!("{l}\n")
                    }
                })
                .collect()
        });
    bench
        .tieline(&["run", file.to_str().expect("UTF-8"), "--out", "out"])
        .assert_refused(&["reach beyond the inertial measurements", "IMU file of this drive"]);
}

#[test]
fn strips_of_another_time_or_place_are_refused_before_they_are_read() {
    // the trajectory ends before the strips do
    let bench = Bench::new();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop/trajectory.sbet");
    let bytes = std::fs::read(&sample).expect("the trajectory");
    let cut = bench.path("cut.sbet");
    std::fs::write(&cut, &bytes[..bytes.len() / 136 / 2 * 136]).expect("written");
    let shorter = |t: String| {
        let without = t.lines().filter(|l| !l.starts_with("accuracy")).map(|l| format!("{l}\n")).collect::<String>();
        without.replace(sample.to_str().expect("UTF-8"), cut.to_str().expect("UTF-8"))
    };
    refused_early(shorter, &["is not covered by the trajectory", "trajectory of this drive"]);
    let without = |t: String| {
        let from = t.find("[trajectory]").expect("there");
        let to = from + t[from..].find("[imu]").expect("there");
        format!("{}{}", &t[..from], &t[to..])
    };
    refused_early(without, &["a drive needs the trajectory"]);
}

#[test]
fn match_alone_finds_the_same_mistakes() {
    let bench = Bench::new();
    let file = project(&bench, |t| t.replace("id = 1", "id = 5"));
    bench
        .tieline(&["match", file.to_str().expect("UTF-8"), "--out", "out"])
        .assert_refused(&["2 scanners", "scanner 1 is missing"]);
    assert!(!bench.path("out").exists());
}

#[test]
fn swapped_axes_of_a_lever_arm_are_told_by_the_misfit() {
    let bench = Bench::new();
    let file = project(&bench, |t| t.replace("lever_arm_m = [-0.55, 0.42, -0.3]", "lever_arm_m = [0.42, -0.55, -0.3]"));
    let ran = bench.tieline(&["run", file.to_str().expect("UTF-8"), "--out", "out"]);
    ran.assert_success();
    assert!(ran.err.contains("platform.scanner 1: lever_arm_m") && ran.err.contains("x forward"), "{}", ran.err);
    assert!(!ran.err.contains("platform.scanner 0"), "{}", ran.err);
}
