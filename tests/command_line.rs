//! The command line: exit codes, JSON, quiet, pipes, what `info` and `simulate` say.
#![allow(clippy::expect_used)]

mod common;

use common::Bench;

#[test]
fn wrong_usage_exits_with_2_and_failures_with_1() {
    let bench = Bench::new();
    assert_eq!(bench.tieline(&["march"]).code, Some(2));
    assert_eq!(bench.tieline(&["info"]).code, Some(2));
    assert_eq!(bench.tieline(&["correct", "--from", "a.sbet", "b.laz"]).code, Some(2));
    assert_eq!(bench.tieline(&["run", "survey/project.toml", "--threads", "many"]).code, Some(2));
    assert_eq!(bench.tieline(&["info", "nowhere.laz"]).code, Some(1));
    assert_eq!(bench.tieline(&["--version"]).code, Some(0));
    assert_eq!(bench.tieline(&["run", "--help"]).code, Some(0));
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let bench = Bench::new();
    for arguments in [
        &["completions", "bash"][..],
        &["man"],
        &["info", "survey/strips/strip_01.laz"],
        &["info", "--json", "survey/trajectory.sbet"],
        &["trajectory", "diff", "survey/trajectory.sbet", "survey/truth/trajectory_true.sbet"],
        &["run", "survey/project.toml", "--json", "--out", "out"],
    ] {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_tieline"));
        let output = command.args(arguments).current_dir(bench.root()).stdout(writer).output().expect("starts");
        let err = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {err}");
        assert!(!err.contains("panicked"), "{arguments:?}: {err}");
    }
}

#[test]
fn json_is_valid_and_alone_on_standard_output() {
    let bench = Bench::new();
    let summary = bench.tieline(&["run", "survey/project.toml", "--json", "--out", "out"]).json();
    assert_eq!(summary["strips"].as_array().map(Vec::len), Some(3));
    assert!(summary["ties"]["surface_line"]["used"].as_u64().is_some_and(|n| n > 100), "{}", summary["ties"]);
    for (command, key) in [("match", "found"), ("solve", "discrepancy"), ("report", "discrepancy")] {
        let value = bench.tieline(&[command, "survey/project.toml", "--json", "--out", "out"]).json();
        assert!(!value[key].is_null(), "{command} says nothing about {key}");
    }
    let files = bench.tieline(&["correct", "survey/project.toml", "--json", "--out", "out"]).json();
    assert_eq!(
        files[0]["points"],
        bench.tieline(&["info", "--json", "survey/strips/strip_01.laz"]).json()[0]["points"]
    );
}

#[test]
fn quiet_says_nothing() {
    let bench = Bench::new();
    let ran = bench.tieline(&["run", "survey/project.toml", "-q", "--out", "out"]);
    ran.assert_success();
    assert_eq!((ran.out.as_str(), ran.err.as_str()), ("", ""));
}

#[test]
fn info_tells_what_is_in_each_kind_of_file() {
    let bench = Bench::new();
    bench.tieline(&["run", "survey/project.toml", "-q", "--csv", "--out", "out"]).assert_success();
    let files = [
        "survey/strips/strip_02.laz",
        "survey/trajectory.sbet",
        "survey/trajectory_rms.out",
        "out/ties.parquet",
        "out/ties.csv",
        "out/correction.csv",
    ];
    let infos = bench.tieline(&[&["info", "--json"][..], &files].concat()).json();
    let kinds: Vec<&str> = (0..6).filter_map(|i| infos[i]["kind"].as_str()).collect();
    assert_eq!(kinds, ["strip", "trajectory", "accuracy", "ties", "ties", "correction"]);
    assert_eq!(infos[0]["sample"]["point_source_id"]["2"], infos[0]["points"]);
    assert_eq!(infos[0]["time"]["encoding"], "adjusted");
    assert!(
        infos[0]["time"]["utc"][0].as_str().is_some_and(|t| t.starts_with("2024-09-03T10:")),
        "{}",
        infos[0]["time"]
    );
    assert_eq!((&infos[1]["epochs"], infos[1]["gaps_s"].as_array().map(Vec::len)), (&827.into(), Some(2)));
    assert!(infos[2]["sigma"]["position_ned_m"][0].as_f64().is_some_and(|s| (0.02..0.05).contains(&s)));
    assert_eq!(infos[3]["ties"], infos[4]["ties"]);
    assert!(
        infos[3]["used"].as_u64().is_some_and(|n| n > 100) && infos[3]["held_out"].as_u64().is_some_and(|n| n > 20)
    );
    let text = bench.tieline(&[&["info"][..], &files].concat());
    text.assert_success();
    for words in ["LAZ 1.4, point format 6", "SBET", "surface_line", "827 at 50", "largest shift"] {
        assert!(text.out.contains(words), "\"{words}\" is not in: {}", text.out);
    }
}

#[test]
fn info_tells_what_measurements_are_in_a_file() {
    let bench = Bench::new();
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/samples/loop/");
    for (name, kind, word) in [
        ("imu.txt.gz", "inertial measurements", "specific force"),
        ("gnss.pos", "GNSS fixes", "sigma"),
        ("odometer.csv", "odometer", "speed"),
    ] {
        let path = format!("{sample}{name}");
        let ran = bench.tieline(&["info", &path]);
        ran.assert_success();
        assert!(ran.out.contains(kind) && ran.out.contains(word) && ran.out.contains("time "), "{}", ran.out);
        let ran = bench.tieline(&["info", "--json", &path]);
        let value: serde_json::Value = serde_json::from_str(&ran.out).expect("JSON");
        assert!(value[0]["time"]["first_s"].as_f64().expect("a time") > 2e5, "{value}");
    }
}

#[test]
fn a_file_of_no_known_kind_is_refused_with_what_is_known() {
    let bench = Bench::new();
    let strange: Vec<u8> = (0..1000_u32).flat_map(|i| i.wrapping_mul(2_654_435_761).to_le_bytes()).collect();
    std::fs::write(bench.path("strange.bin"), strange).expect("written");
    std::fs::write(bench.path("letter.txt"), "Dear reader,\nnothing to see here.\n").expect("written");
    std::fs::write(bench.path("empty.laz"), "").expect("written");
    bench.tieline(&["info", "strange.bin"]).assert_refused(&["strange.bin", "not a file that tieline reads", "SBET"]);
    bench.tieline(&["info", "letter.txt"]).assert_refused(&["letter.txt", "not a file that tieline reads"]);
    bench.tieline(&["info", "empty.laz"]).assert_refused(&["empty.laz", "empty"]);
}

#[test]
fn simulating_says_what_to_type_next_and_leaves_other_folders_alone() {
    let bench = Bench::new();
    let scenario = "seed = 5\n[area]\neast_m = 60.0\nnorth_m = 60.0\n[world]\nbuildings = 3\ntrees = 2\n\
                    [[flight.group]]\nlines = 2\nheight_m = 300.0\nspacing_m = 40.0\n[[scanner]]\npulse_rate_hz = 9000.0\nline_rate_hz = 40.0\n";
    std::fs::write(bench.path("scenario.toml"), scenario).expect("written");
    let ran = bench.tieline(&["simulate", "scenario.toml", "--out", "new"]);
    ran.assert_success();
    assert!(ran.out.ends_with("next: tieline run new/project.toml\n"), "{}", ran.out);
    assert!(bench.path("new/strips/strip_02.laz").is_file());
    bench.tieline(&["simulate", "scenario.toml", "--out", "new"]).assert_refused(&["new is not empty", "--out"]);
    std::fs::write(bench.path("scenario.toml"), "sead = 5\n").expect("written");
    bench.tieline(&["simulate", "scenario.toml", "--out", "newer"]).assert_refused(&["scenario.toml", "sead"]);
    assert!(!bench.path("newer").exists());
}
