//! What goes wrong with navigation data: each mistake ends in a clear message or in a right answer, never in half a file.
#![allow(clippy::expect_used)]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use nalgebra::Vector3;
use tempfile::TempDir;
use tieline_filter::earth::{ecef_from_geodetic, ned_from_ecef};
use tieline_filter::{ImuGrade, Inputs};
use tieline_simulate::navigation::{NavigationScenario, NavigationTruth};

/// A drive of five minutes as text files.
struct Drive {
    folder: TempDir,
    inputs: Inputs,
    truth: NavigationTruth,
    lever_arm_m: Vector3<f64>,
}

struct Ran {
    success: bool,
    stderr: String,
    stdout: String,
}

impl Drive {
    fn new() -> Self {
        let scenario = NavigationScenario::car(ImuGrade::LeadorA15.noise(), 300.0, 7);
        let lever_arm_m = scenario.gnss.lever_arm_m;
        let simulated = scenario.simulate().expect("a drive");
        let folder = tempfile::tempdir().expect("a folder");
        let drive = Self { folder, inputs: simulated.inputs, truth: simulated.truth, lever_arm_m };
        drive.write_imu(|_, row| Some(row));
        drive.write_gnss(|_, row| Some(row));
        drive.write_project("");
        drive
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes the samples, each as changed; `None` leaves one out.
    fn write_imu(&self, change: impl Fn(usize, [f64; 7]) -> Option<[f64; 7]>) {
        let mut text = String::new();
        for (i, s) in self.inputs.imu.samples().iter().enumerate() {
            let (a, v) = (s.angle_rad, s.velocity_mps);
            if let Some(r) = change(i, [s.time_s, a.x, a.y, a.z, v.x, v.y, v.z]) {
                writeln!(text, "{:.5} {:e} {:e} {:e} {:e} {:e} {:e}", r[0], r[1], r[2], r[3], r[4], r[5], r[6])
                    .expect("text");
            }
        }
        std::fs::write(self.path("imu.txt"), text).expect("written");
    }

    /// Writes the fixes: time, latitude, longitude, height, sigmas.
    fn write_gnss(&self, change: impl Fn(usize, [f64; 7]) -> Option<[f64; 7]>) {
        let mut text = String::new();
        for (i, f) in self.inputs.gnss.iter().enumerate() {
            let sigma = f.covariance_ned_m2.diagonal().map(f64::sqrt);
            let (lat, lon) = (f.geodetic.x.to_degrees(), f.geodetic.y.to_degrees());
            if let Some(r) = change(i, [f.time_s, lat, lon, f.geodetic.z, sigma.x, sigma.y, sigma.z]) {
                writeln!(text, "{:.4} {:.12} {:.12} {:.4} {} {} {}", r[0], r[1], r[2], r[3], r[4], r[5], r[6])
                    .expect("text");
            }
        }
        std::fs::write(self.path("gnss.txt"), text).expect("written");
    }

    fn write_project(&self, more: &str) {
        let arm = self.lever_arm_m;
        let text = format!(
            "[imu]\npath = \"imu.txt\"\ngrade = \"leador-a15\"\n[gnss]\npath = \"gnss.txt\"\n[platform]\n\
             gnss_lever_arm_m = [{}, {}, {}]\n{more}",
            arm.x, arm.y, arm.z
        );
        std::fs::write(self.path("project.toml"), text).expect("written");
    }

    fn solve(&self) -> Ran {
        self.run(&["solve", "project.toml", "--out", "out"])
    }

    fn run(&self, arguments: &[&str]) -> Ran {
        let output = Command::new(env!("CARGO_BIN_EXE_tieline"))
            .args(arguments)
            .current_dir(self.folder.path())
            .stdin(Stdio::null())
            .output()
            .expect("the program starts");
        Ran {
            success: output.status.success(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        }
    }

    /// It fails with one readable message that holds the words, and leaves nothing behind.
    fn refuses(&self, words: &[&str]) {
        let ran = self.solve();
        assert!(!ran.success, "it went through: {}", ran.stdout);
        let errors = ran.stderr.lines().filter(|l| l.starts_with("tieline: ")).count();
        assert_eq!(errors, 1, "one message: {}", ran.stderr);
        for word in words {
            assert!(ran.stderr.contains(word), "\"{word}\" is missing: {}", ran.stderr);
        }
        assert!(!ran.stderr.contains("panicked"), "{}", ran.stderr);
        assert!(!self.path("out").exists(), "something was left behind");
    }

    /// It goes through, says the words, and the smoothed positions are right: mean horizontal error after half a minute.
    fn succeeds(&self, words: &[&str], worst_m: f64) {
        let ran = self.solve();
        assert!(ran.success, "{}", ran.stderr);
        for word in words {
            assert!(ran.stderr.contains(word), "\"{word}\" is missing: {}", ran.stderr);
        }
        let error = self.worst_error_m(&self.path("out/trajectory.csv"), 0.0);
        assert!(error < worst_m, "{error} m: {}", ran.stderr);
    }

    /// Largest horizontal error of a trajectory, thirty seconds after its beginning \[m\].
    fn worst_error_m(&self, path: &Path, shift_s: f64) -> f64 {
        let text = std::fs::read_to_string(path).expect("a trajectory");
        let mut worst: f64 = 0.0;
        for line in text.lines().skip(3001).step_by(50) {
            let v: Vec<f64> = line.split(',').filter_map(|f| f.parse().ok()).collect();
            let truth = self.truth.nav_at(v[1] - shift_s).geodetic;
            let here = Vector3::new(v[2].to_radians(), v[3].to_radians(), v[4]);
            let d = ned_from_ecef(truth.x, truth.y) * (ecef_from_geodetic(&here) - ecef_from_geodetic(&truth));
            worst = worst.max(d.x.hypot(d.y));
        }
        worst
    }
}

#[test]
fn a_clean_drive_is_right() {
    Drive::new().succeeds(&["aligned"], 0.06);
}

#[test]
fn rates_taken_for_increments_are_not_gravity() {
    let drive = Drive::new();
    drive.write_imu(|_, mut r| {
        r[1..].iter_mut().for_each(|v| *v *= 100.0);
        Some(r)
    });
    drive.refuses(&["specific force", "rates or increments"]);
}

#[test]
fn a_sensor_that_points_up_is_told_its_axes() {
    let drive = Drive::new();
    drive.write_imu(|_, r| Some([r[0], r[1], -r[2], -r[3], r[4], -r[5], -r[6]]));
    drive.refuses(&["gravity points up", "axes ="]);
    drive.write_project("");
    let text = std::fs::read_to_string(drive.path("project.toml")).expect("text");
    let text = text.replace("grade =", "axes = \"FLU\"\ngrade =");
    std::fs::write(drive.path("project.toml"), text).expect("written");
    drive.succeeds(&[], 0.06);
}

#[test]
fn gyros_that_turn_the_other_way_are_found() {
    let drive = Drive::new();
    drive.write_imu(|_, r| Some([r[0], r[1], r[2], -r[3], r[4], r[5], r[6]]));
    drive.refuses(&["gyros turn the other way"]);
}

#[test]
fn leap_seconds_between_the_clocks_are_found() {
    let drive = Drive::new();
    drive.write_imu(|_, mut r| {
        r[0] -= 18.0;
        Some(r)
    });
    drive.refuses(&["18 s", "leap seconds"]);
}

#[test]
fn clocks_that_do_not_overlap_are_refused() {
    let drive = Drive::new();
    drive.write_imu(|_, mut r| {
        r[0] += 5000.0;
        Some(r)
    });
    drive.refuses(&["do not overlap"]);
}

#[test]
fn a_gap_of_five_seconds_is_bridged_and_said() {
    let drive = Drive::new();
    drive.write_imu(|i, r| (!(15_000..15_500).contains(&i)).then_some(r));
    drive.succeeds(&["IMU gap", "bridged"], 3.0);
}

#[test]
fn a_blunder_of_a_hundred_metres_changes_nothing() {
    let drive = Drive::new();
    drive.write_gnss(|i, mut r| {
        if i == 150 {
            r[1] += 0.001;
        }
        Some(r)
    });
    drive.succeeds(&[], 0.06);
    let summary = std::fs::read_to_string(drive.path("out/summary.json")).expect("a summary");
    assert!(summary.contains("\"gnss_left_out\": 1"), "{summary}");
}

#[test]
fn a_value_that_is_not_a_number_is_named() {
    let drive = Drive::new();
    drive.write_imu(|i, mut r| {
        if i == 1234 {
            r[4] = f64::NAN;
        }
        Some(r)
    });
    drive.refuses(&["imu.txt", "1235"]);
}

#[test]
fn a_week_that_ends_on_the_way_is_carried_on() {
    let drive = Drive::new();
    let wrap = |t: f64| (t + 604_800.0 - 1150.0).rem_euclid(604_800.0);
    drive.write_imu(|_, mut r| {
        r[0] = wrap(r[0]);
        Some(r)
    });
    drive.write_gnss(|_, mut r| {
        r[0] = wrap(r[0]);
        Some(r)
    });
    let ran = drive.solve();
    assert!(ran.success, "{}", ran.stderr);
    assert!(ran.stderr.contains("week"), "{}", ran.stderr);
    let error = drive.worst_error_m(&drive.path("out/trajectory.csv"), 604_800.0 - 1150.0);
    assert!(error < 0.06, "{error} m");
}

#[test]
fn an_imu_of_one_hertz_is_refused() {
    let drive = Drive::new();
    drive.write_imu(|i, r| (i % 100 == 0).then_some(r));
    drive.refuses(&["too slow", "100 Hz"]);
}

#[test]
fn without_gnss_the_beginning_must_be_given() {
    let drive = Drive::new();
    let text = std::fs::read_to_string(drive.path("project.toml")).expect("text");
    let bare = text.replace("[gnss]\npath = \"gnss.txt\"\n", "");
    std::fs::write(drive.path("project.toml"), &bare).expect("written");
    drive.refuses(&["without GNSS", "[initial]"]);
    // with a beginning it is pure inertial navigation
    let start = drive.truth.nav_at(1001.0);
    let (roll, pitch, heading) = tieline_filter::frames::roll_pitch_heading_rad(&start.ned_from_body);
    let initial = format!(
        "[initial]\ngps_time_s = 1001.0\nlat_deg = {}\nlon_deg = {}\nh_m = {}\nvelocity_ned_mps = [{}, {}, {}]\n\
         roll_pitch_heading_deg = [{}, {}, {}]\nposition_sigma_m = [0.01, 0.01, 0.01]\nvelocity_sigma_mps = [0.001, 0.001, 0.001]\n\
         attitude_sigma_deg = [0.001, 0.001, 0.001]\n",
        start.geodetic.x.to_degrees(),
        start.geodetic.y.to_degrees(),
        start.geodetic.z,
        start.velocity_ned_mps.x,
        start.velocity_ned_mps.y,
        start.velocity_ned_mps.z,
        roll.to_degrees(),
        pitch.to_degrees(),
        heading.to_degrees()
    );
    std::fs::write(drive.path("project.toml"), bare + &initial).expect("written");
    drive.succeeds(&[], 60.0);
}

#[test]
fn sigmas_of_zero_duplicates_and_disorder_are_said_and_mended() {
    let drive = Drive::new();
    drive.write_gnss(|i, mut r| {
        if i == 40 {
            r[4..].fill(0.0);
        }
        Some(r)
    });
    let text = std::fs::read_to_string(drive.path("gnss.txt")).expect("text");
    let mut lines: Vec<&str> = text.lines().collect();
    lines.swap(60, 61);
    let again = lines[70];
    lines.insert(70, again);
    std::fs::write(drive.path("gnss.txt"), lines.join("\n")).expect("written");
    drive.succeeds(&["gnss.txt"], 0.06);
}

#[test]
fn mistakes_of_the_project_file_are_named() {
    let drive = Drive::new();
    let text = std::fs::read_to_string(drive.path("project.toml")).expect("text");
    std::fs::write(drive.path("project.toml"), text.replace("leador-a15", "tactical-ish")).expect("written");
    drive.refuses(&["imu.grade", "leador-a15"]);
    std::fs::write(drive.path("project.toml"), text.replace("imu.txt", "imo.txt")).expect("written");
    drive.refuses(&["imo.txt"]);
    std::fs::write(drive.path("project.toml"), text.replace("[imu]\npath = \"imu.txt\"\ngrade = \"leador-a15\"\n", ""))
        .expect("written");
    drive.refuses(&["gnss", "[imu]"]);
    std::fs::write(drive.path("project.toml"), text).expect("written");
    let ran = drive.run(&["solve", "project.toml", "--out", "out", "--mask-gnss", "1100"]);
    assert!(!ran.success && ran.stderr.contains("start:length"), "{}", ran.stderr);
}
