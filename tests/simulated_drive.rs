//! A simulated drive is a project that `solve` understands, and gives the trajectory that its strips were made with.

mod common;

use common::Bench;

#[test]
fn solve_gives_the_trajectory_that_a_simulated_drive_was_made_with() {
    let bench = Bench::new();
    let scenario = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/samples/scenarios/loop.toml"))
        .expect("the scenario")
        .replace("pulse_rate_hz = 3000.0", "pulse_rate_hz = 200.0")
        .replace("trajectory_rate_hz = 25.0", "trajectory_rate_hz = 100.0");
    std::fs::write(bench.path("loop.toml"), scenario).expect("written");
    let ran = bench.tieline(&["simulate", "loop.toml", "--out", "drive"]);
    ran.assert_success();
    assert!(ran.out.contains("2 strips") && ran.out.contains("a drive of"), "{}", ran.out);
    assert!(ran.out.ends_with("next: tieline run drive/project.toml\n"), "{}", ran.out);
    bench.tieline(&["simulate", "loop.toml", "--out", "drive"]).assert_refused(&["drive is not empty", "--overwrite"]);
    // a lap of an earlier drive must not stay behind: the project would take it for its own
    std::fs::copy(bench.path("drive/strips/pass2.laz"), bench.path("drive/strips/pass3.laz")).expect("copied");
    bench.tieline(&["simulate", "loop.toml", "--out", "drive", "--overwrite", "-q"]).assert_success();
    assert!(!bench.path("drive/strips/pass3.laz").exists());

    bench.tieline(&["solve", "drive/project.toml", "--out", "solved", "-q"]).assert_success();
    let ran = bench.tieline(&["trajectory", "diff", "drive/trajectory.sbet", "solved/trajectory.sbet", "--json"]);
    ran.assert_success();
    let value: serde_json::Value = serde_json::from_str(&ran.out).expect("JSON");
    let difference = value["difference"].as_object().expect("a table");
    assert_eq!(difference.len(), 6);
    for (name, row) in difference {
        assert!(row["max"].as_f64().expect("a number").abs() < 1e-6, "{name}: {row}");
    }
}
