//! A drive whose delivered trajectory was metres off: ties measured again on the corrected cloud bind what the first measurement missed.

mod common;

use std::path::Path;

use common::Bench;
use tieline_filter::Trajectory;
use tieline_io::trajectory::{ReadOptions, read};

fn load(path: &Path) -> Trajectory {
    read(path, &ReadOptions { format: None, columns: None, accuracy: None }).expect("a trajectory").trajectory
}

/// Root mean squares of the errors in the outage: plan, height \[m\].
fn errors_m(data: &Path, solution: &Path) -> (f64, f64) {
    let text = std::fs::read_to_string(data.join("truth/outages.csv")).expect("outages");
    let mut times = text.lines().nth(1).expect("one").split(',').map(|f| f.parse::<f64>().expect("a time"));
    let (from_s, to_s) = (times.next().expect("start"), times.next().expect("end"));
    let (truth, found) = (load(&data.join("truth/truth.sbet")), load(&solution.join("trajectory.sbet")));
    let (mut plan, mut height, mut count) = (0.0, 0.0, 0.0);
    for (time_s, p) in found.time_s().iter().zip(found.position()).filter(|(t, _)| **t > from_s && **t <= to_s) {
        let Some(right) = truth.pose_at(*time_s) else { continue };
        let d = p - right.position;
        plan += (d.x * 6.371e6).powi(2) + (d.y * 6.371e6 * p.x.cos()).powi(2);
        height += d.z * d.z;
        count += 1.0;
    }
    ((plan / count).sqrt(), (height / count).sqrt())
}

/// The drive of the sample with a consumer's IMU and no odometer: without GNSS for 46 s its trajectory drifts by metres, ten times as far as patches
/// are searched for.
#[test]
#[ignore = "two estimates of a drive: minutes in a debug build"]
#[allow(clippy::print_stdout)] // figures for docs/mobile.md
fn a_trajectory_that_was_metres_off_is_bound_by_ties_measured_again() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let scenario = std::fs::read_to_string(root.join("samples/scenarios/loop.toml")).expect("a scenario");
    let kept = |line: &&str| {
        !["angle_random", "velocity_random", "gyro_bias", "accelerometer_bias"].iter().any(|key| line.starts_with(key))
    };
    let text: String = scenario.lines().filter(kept).map(|line| format!("{line}\n")).collect();
    let text = text.replace("grade = \"ap60\"", "grade = \"consumer\"") + "\n[odometer]\nused = false\n";
    let bench = Bench::new();
    std::fs::write(bench.path("scenario.toml"), text).expect("written");
    bench.tieline(&["simulate", "scenario.toml", "--out", "data", "-q"]).assert_success();
    let project = std::fs::read_to_string(bench.path("data/project.toml")).expect("a project");
    std::fs::write(bench.path("data/once.toml"), project + "\n[match]\nmeasure_again = false\n").expect("written");
    bench.tieline(&["run", "data/once.toml", "--out", "once", "-q"]).assert_success();
    bench.tieline(&["run", "data/project.toml", "--out", "again", "-q"]).assert_success();
    let data = bench.path("data");
    let (delivered, once, again) =
        (errors_m(&data, &data), errors_m(&data, &bench.path("once")), errors_m(&data, &bench.path("again")));
    println!("errors in the outage, rms plan and height [m]: delivered {delivered:?}, once {once:?}, again {again:?}");
    assert!(delivered.0 > 0.5, "{delivered:?}");
    assert!(again.0 < 0.5 * once.0 && again.1 < once.1, "{once:?} {again:?}");
}
