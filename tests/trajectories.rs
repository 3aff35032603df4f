//! Trajectories of any origin: strips corrected by their difference, compared, interpolated, converted.
#![allow(clippy::expect_used)]

mod common;

use common::{Bench, change_times, largest_difference_m, raw_records};

const STRIPS: [&str; 3] = ["survey/strips/strip_01.laz", "survey/strips/strip_02.laz", "survey/strips/strip_03.laz"];
const OLD: &str = "survey/trajectory.sbet";
const NEW: &str = "survey/truth/trajectory_true.sbet";
const CRS: [&str; 2] = ["--crs", "EPSG:32632"];

/// Arguments of `correct` for the three strips of a folder.
fn correct<'a>(from: &'a str, to: &'a str, strips: &[&'a str], out: &'a str) -> Vec<&'a str> {
    [&["correct", "--from", from, "--to", to, "--out", out], &CRS[..], strips].concat()
}

#[test]
fn there_and_back_leads_to_the_input_within_one_scale_unit() {
    let bench = Bench::new();
    bench.tieline(&correct(OLD, NEW, &STRIPS, "there")).assert_success();
    let there = ["there/strip_01.laz", "there/strip_02.laz", "there/strip_03.laz"];
    bench.tieline(&correct(NEW, OLD, &there, "back")).assert_success();
    for number in 1..=3 {
        let [input, there, back] =
            ["survey/strips", "there", "back"].map(|f| bench.path(&format!("{f}/strip_{number:02}.laz")));
        assert!(largest_difference_m(&input, &there) > 0.02);
        assert!(largest_difference_m(&input, &back) <= 0.001_000_1);
        let ((a, length), (b, _)) = (raw_records(&input), raw_records(&back));
        assert!(a.chunks(length).zip(b.chunks(length)).all(|(a, b)| a[12..] == b[12..]), "attributes stay");
    }
}

#[test]
fn the_true_trajectory_brings_strips_onto_each_other() {
    // boresight is wrong as well: what is left is that, and it is the same whichever way the truth is written
    let bench = Bench::new();
    bench.tieline(&correct(OLD, NEW, &STRIPS, "sbet")).assert_success();
    bench.tieline(&["convert", NEW, "true.trj", CRS[0], CRS[1]]).assert_success();
    bench.tieline(&["convert", NEW, "true.csv", "--week", "2330"]).assert_success();
    bench.tieline(&correct(OLD, "true.trj", &STRIPS, "trj")).assert_success();
    bench.tieline(&correct(OLD, "true.csv", &STRIPS, "csv")).assert_success();
    for number in 1..=3 {
        let [sbet, trj, csv] = ["sbet", "trj", "csv"].map(|f| bench.path(&format!("{f}/strip_{number:02}.laz")));
        assert!(largest_difference_m(&sbet, &trj) <= 0.001_000_1);
        assert!(largest_difference_m(&sbet, &csv) <= 0.001_000_1);
    }
}

#[test]
fn a_correction_of_the_pose_moves_the_points_with_it() {
    let bench = Bench::new();
    let header = "gps_time_s,dE_m,dN_m,dU_m,droll_deg,dpitch_deg,dheading_deg\n";
    std::fs::write(bench.path("up.csv"), format!("{header}409393000,0.25,-0.5,0.125,0,0,0\n")).expect("written");
    bench.tieline(&correct(OLD, "up.csv", &STRIPS, "up")).assert_success();
    for (a, b) in
        common::coordinates_m(&bench.strip(1)).iter().zip(common::coordinates_m(&bench.path("up/strip_01.laz")))
    {
        for (axis, shift_m) in [0.25, -0.5, 0.125].iter().enumerate() {
            assert!((b[axis] - a[axis] - shift_m).abs() < 0.000_51, "{a:?} to {b:?}");
        }
    }
}

#[test]
fn nothing_is_written_before_every_strip_is_known_to_be_covered() {
    let bench = Bench::new();
    change_times(&bench.strip(3), |_, time_s| time_s + 1.5);
    bench.tieline(&correct(OLD, NEW, &STRIPS, "out")).assert_refused(&["strip_03.laz", "is not covered", "--week"]);
    change_times(&bench.strip(3), |_, time_s| time_s - 1.5);
    change_times(&bench.strip(2), |_, time_s| time_s + 20.0);
    bench.tieline(&correct(OLD, NEW, &STRIPS, "out")).assert_refused(&["strip_02.laz", "falls into a gap"]);
    assert!(bench.files("out").is_empty());
}

#[test]
fn inputs_are_never_overwritten_and_outputs_only_when_asked() {
    let bench = Bench::new();
    let before = bench.files("survey");
    bench.tieline(&[&correct(OLD, NEW, &STRIPS, "survey/strips")[..], &["--overwrite"]].concat()).assert_refused(&[
        "strip_01.laz",
        "never overwritten",
        "--out",
    ]);
    bench.tieline(&correct(OLD, NEW, &STRIPS[..1], "out")).assert_success();
    bench.tieline(&correct(OLD, NEW, &STRIPS[..1], "out")).assert_refused(&["exists already", "--overwrite"]);
    bench.tieline(&[&correct(OLD, NEW, &STRIPS[..1], "out")[..], &["--overwrite"]].concat()).assert_success();
    assert!(before == bench.files("survey"), "the survey is as it was");
}

#[test]
fn trajectories_that_do_not_fit_the_strips_are_refused() {
    let bench = Bench::new();
    let without_crs = ["correct", "--from", OLD, "--to", NEW, STRIPS[0], "--out", "out"];
    bench.tieline(&without_crs).assert_refused(&["latitude and longitude", "--crs"]);
    bench.tieline(&correct("nowhere.sbet", NEW, &STRIPS, "out")).assert_refused(&["nowhere.sbet", "No such file"]);
    bench.tieline(&correct(OLD, NEW, &["nowhere.laz"], "out")).assert_refused(&["nowhere.laz", "no file is found"]);
    bench.tieline(&correct(STRIPS[0], NEW, &STRIPS, "out")).assert_refused(&["strip_01.laz", "point cloud"]);
    bench.tieline(&["convert", NEW, "late.csv", "--week", "2331"]).assert_success();
    bench.tieline(&correct(OLD, "late.csv", &STRIPS, "out")).assert_refused(&["no time in common"]);
    assert!(bench.files("out").is_empty());
}

#[test]
fn converting_leads_back_to_the_same_trajectory() {
    let bench = Bench::new();
    let accuracy = ["--accuracy", "survey/trajectory_rms.out"];
    bench.tieline(&[&["convert", OLD, "a.csv", "--week", "2330"][..], &accuracy].concat()).assert_success();
    bench.tieline(&["convert", "a.csv", "b.sbet"]).assert_success();
    bench.tieline(&["convert", "b.sbet", "c.trj", CRS[0], CRS[1]]).assert_success();
    bench.tieline(&["convert", "c.trj", "d.sbet", CRS[0], CRS[1]]).assert_success();
    assert!(bench.path("b_rms.out").is_file(), "sigmas stand beside an SBET");
    for other in ["a.csv", "b.sbet", "c.trj", "d.sbet"] {
        let report = bench.tieline(&["trajectory", "diff", OLD, other, CRS[0], CRS[1], "--json"]).json();
        assert_eq!(report["epochs"], 827);
        for name in ["dE_m", "dN_m", "dU_m", "droll_deg", "dpitch_deg", "dheading_deg"] {
            let max = report["difference"][name]["max"].as_f64().expect("a number");
            assert!(max.abs() < 1e-6, "{other}: {name} {max}");
        }
    }
    bench.tieline(&["convert", OLD, "e.trj"]).assert_refused(&["--crs"]);
    bench.tieline(&["convert", OLD, "e.las"]).assert_refused(&["e.las", "--to"]);
    bench.tieline(&["convert", OLD, "e.parquet"]).assert_refused(&["is a trajectory"]);
    bench.tieline(&["convert", OLD, OLD]).assert_refused(&["is the input"]);
    bench.tieline(&["convert", STRIPS[0], "e.csv"]).assert_refused(&["only trajectories and ties"]);
}

#[test]
fn ties_go_to_csv_and_back() {
    let bench = Bench::new();
    bench.tieline(&["match", "survey/project.toml", "-q", "--out", "out"]).assert_success();
    bench.tieline(&["convert", "out/ties.parquet", "ties.csv"]).assert_success();
    bench.tieline(&["convert", "ties.csv", "ties.parquet"]).assert_success();
    assert!(std::fs::read(bench.path("ties.parquet")).expect("there") == bench.files("out")["ties.parquet"]);
}

#[test]
fn a_difference_has_statistics_a_table_and_a_picture() {
    let bench = Bench::new();
    let ran = bench.tieline(&["trajectory", "diff", OLD, NEW, "--out", "diff"]);
    ran.assert_success();
    assert!(ran.out.contains("dheading_deg") && ran.out.contains("rms"), "{}", ran.out);
    let files = bench.files("diff");
    let table = String::from_utf8(files["difference.csv"].clone()).expect("text");
    assert_eq!(table.lines().count(), 828);
    let svg = String::from_utf8(files["difference.svg"].clone()).expect("text");
    assert!(svg.starts_with("<svg") && svg.contains("dN_m") && !svg.contains("NaN"));
    bench.tieline(&["trajectory", "diff", OLD, "survey/trajectory_rms.out"]).assert_refused(&["trajectory_rms.out"]);
}

#[test]
fn poses_at_events_have_their_sigma_and_none_outside() {
    let bench = Bench::new();
    std::fs::write(bench.path("events.csv"), "time_s,name\n209001.25,a\n209010,gap\n209067.5,b\n").expect("written");
    let at = ["trajectory", "at", OLD, "events.csv", "--accuracy", "survey/trajectory_rms.out"];
    let ran = bench.tieline(&at);
    ran.assert_success();
    let lines: Vec<&str> = ran.out.lines().collect();
    assert_eq!(lines.len(), 4);
    assert!(lines[0].starts_with("gps_time_s,lat_deg,lon_deg,h_m,roll_deg,pitch_deg,heading_deg,sigma_n_m"));
    assert!(lines[1].starts_with("209001.25,46.79") && lines[2].starts_with("209010,,"), "{}", ran.out);
    let rows = bench.tieline(&[&at[..], &["--json"]].concat()).json();
    assert!(rows[2]["sigma_heading_deg"].as_f64().is_some_and(|s| s > 0.001) && rows[1]["h_m"].is_null());
    std::fs::write(bench.path("events.csv"), "1\n2\n").expect("written");
    bench.tieline(&at).assert_refused(&["none of the 2 times", "own time system"]);
    std::fs::write(bench.path("events.csv"), "209001\nnoon\n").expect("written");
    bench.tieline(&at).assert_refused(&["line 2", "noon"]);
}
