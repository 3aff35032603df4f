//! Points picked by hand in the strips of a drive (`[ties] points`), made of the truth of the sample by this test alone.

mod common;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use common::Bench;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use tieline_filter::{Pose, Trajectory};
use tieline_io::crs::Crs;
use tieline_io::trajectory::{ReadOptions, read};

/// Seconds of the week of the sample to adjusted GPS time, which its strips have.
const ADJUSTED_S: f64 = 2330.0 * 604_800.0 - 1e9;

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop")
}

fn map_trajectory(path: &Path) -> Trajectory {
    let crs = Crs::parse("EPSG:32633").expect("a reference system");
    let file = read(path, &ReadOptions { format: None, columns: None, accuracy: None }).expect("a trajectory");
    crs.to_map(&file.trajectory).expect("in the map")
}

/// A scanner as it was taken to be, and as it is.
struct Scanner {
    arm_m: Vector3<f64>,
    nominal: UnitQuaternion<f64>,
    real: UnitQuaternion<f64>,
    /// Range and what it is measured too long by \[m\].
    bias: Vec<(f64, f64)>,
}

/// What is true of the sample.
struct Truth {
    real: Trajectory,
    delivered: Trajectory,
    scanners: Vec<Scanner>,
}

fn vector(table: &toml::Table, scanner: &str, key: &str) -> Vector3<f64> {
    let values = table[scanner][key].as_array().expect("three numbers");
    Vector3::from_iterator(values.iter().map(|v| v.as_float().expect("a number")))
}

impl Truth {
    fn load() -> Self {
        let table = |name: &str| -> toml::Table {
            std::fs::read_to_string(sample().join(name)).expect("a file").parse().expect("TOML")
        };
        let (nominal, real) = (table("calibration.toml"), table("truth/calibration_true.toml"));
        let curves = std::fs::read_to_string(sample().join("truth/bias_functions.csv")).expect("curves");
        let scanners = [("scanner1", "1"), ("scanner2", "2")].map(|(name, number)| {
            let a = vector(&nominal, name, "rpy_deg").map(f64::to_radians);
            let mounting = UnitQuaternion::from_euler_angles(a.x, a.y, a.z);
            let off = Rotation3::new(vector(&real, name, "misalignment_body_deg").map(f64::to_radians));
            let row = |line: &str| {
                let f: Vec<&str> = line.split(',').collect();
                (f[0] == number).then(|| (f[1].parse().expect("a range"), f[2].parse().expect("a bias")))
            };
            Scanner {
                arm_m: vector(&nominal, name, "lever_arm_m"),
                nominal: mounting,
                real: UnitQuaternion::from(off) * mounting,
                bias: curves.lines().filter_map(row).collect(),
            }
        });
        Self {
            real: map_trajectory(&sample().join("truth/truth.sbet")),
            delivered: map_trajectory(&sample().join("trajectory.sbet")),
            scanners: scanners.into(),
        }
    }

    /// The ray of a scanner to a place, in its own axes.
    fn ray_m(&self, scanner: &Scanner, time_s: f64, place_m: &Vector3<f64>) -> Option<Vector3<f64>> {
        let body_m = self.real.pose_at(time_s)?.body_vector_m(place_m);
        Some(scanner.real.inverse_transform_vector(&(body_m - scanner.arm_m)))
    }

    /// When a scanner's plane passes a place within a span, near enough to see it; where the strips as delivered have it then.
    fn seen(&self, scanner: usize, place_m: &Vector3<f64>, (from_s, to_s): (f64, f64)) -> Option<(f64, Vector3<f64>)> {
        let scanner = &self.scanners[scanner];
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let steps = ((to_s - from_s) / 0.05) as u32;
        let off = |time_s: f64| self.ray_m(scanner, time_s, place_m).filter(|r| r.norm() < 20.0).map(|r| r.x);
        let (mut low_s, mut high_s) = (0..steps).map(|k| from_s + 0.05 * f64::from(k)).find_map(|time_s| {
            let (a, b) = (off(time_s)?, off(time_s + 0.05)?);
            (a * b < 0.0).then_some((time_s, time_s + 0.05))
        })?;
        for _ in 0..40 {
            let middle_s = 0.5 * (low_s + high_s);
            if off(low_s)? * off(middle_s)? <= 0.0 { high_s = middle_s } else { low_s = middle_s }
        }
        let ray_m = self.ray_m(scanner, low_s, place_m)?;
        let next = scanner.bias.partition_point(|b| b.0 < ray_m.norm());
        let (a, b) = (scanner.bias[next - 1], scanner.bias[next]);
        let bias_m = a.1 + (b.1 - a.1) * (ray_m.norm() - a.0) / (b.0 - a.0);
        let body_m = scanner.arm_m + scanner.nominal * (ray_m * (1.0 + bias_m / ray_m.norm()));
        Some((low_s, place(&self.delivered.pose_at(low_s)?, &body_m)))
    }
}

fn place(pose: &Pose, body_m: &Vector3<f64>) -> Vector3<f64> {
    pose.position + pose.map_from_ned * (pose.ned_from_body * body_m)
}

/// A picker's hand: even over three standard deviations of about `sigma_m` each, by the number of the row.
fn slip(row: u32, sigma_m: [f64; 3]) -> Vector3<f64> {
    let even = |k: u32| f64::from((row * 3 + k).wrapping_mul(2_654_435_769) >> 8) / f64::from(1 << 24) - 0.5;
    Vector3::new(even(0) * sigma_m[0], even(1) * sigma_m[1], even(2) * sigma_m[2]) * 12.0_f64.sqrt()
}

const PASSES_S: [(f64, f64); 2] = [(209_014.1, 209_068.4), (209_068.4, 209_112.7)];

/// Covers of manholes as seen from both laps: rows of the file, and how many covers.
fn rows() -> (String, usize) {
    let truth = Truth::load();
    let features = std::fs::read_to_string(sample().join("truth/features.csv")).expect("features");
    let (mut text, mut row, mut points) = (String::new(), 0, 0);
    for line in features.lines().filter(|l| l.starts_with("manhole")) {
        let f: Vec<&str> = line.split(',').collect();
        let cover_m = Vector3::from_iterator((2..5).map(|k| f[k].parse().expect("a coordinate")));
        let seen: Vec<(usize, f64, Vector3<f64>)> = [0, 1]
            .into_iter()
            .zip(PASSES_S)
            .filter_map(|(scanner, pass)| truth.seen(scanner, &cover_m, pass).map(|(t, p)| (scanner, t, p)))
            .collect();
        if seen.len() < 2 {
            continue;
        }
        for (scanner, time_s, picked_m) in seen {
            row += 1;
            let at = picked_m + slip(row, [0.02, 0.02, 0.01]);
            let time_s = time_s + ADJUSTED_S;
            writeln!(text, "cover {},{time_s:.6},{:.4},{:.4},{:.4},,,{scanner}", f[1], at.x, at.y, at.z).expect("text");
        }
        // surveyed on the ground, every other one
        if points % 2 == 0 {
            let at = cover_m + slip(1000 + row, [0.003; 3]);
            writeln!(text, "cover {},,{:.4},{:.4},{:.4},0.003,0.003,", f[1], at.x, at.y, at.z).expect("text");
        }
        points += 1;
    }
    (text, points)
}

const HEADER: &str = "point,gps_time_s,x_m,y_m,z_m,sigma_plan_m,sigma_height_m,scanner\n";

/// The sample with a file of picked points.
fn project(bench: &Bench, name: &str, rows: &str) -> String {
    std::fs::write(bench.path(&format!("{name}.csv")), format!("{HEADER}{rows}")).expect("written");
    let text = std::fs::read_to_string(sample().join("project.toml")).expect("the sample");
    let absolute = text.replace("path = \"", &format!("path = \"{}/", sample().display()));
    let absolute = absolute.replace("accuracy = \"", &format!("accuracy = \"{}/", sample().display()));
    let file = format!("{name}.toml");
    std::fs::write(bench.path(&file), format!("{absolute}\n[ties]\npoints = \"{name}.csv\"\n")).expect("written");
    file
}

/// Rows of `picked.csv`: name, whether known, before and after \[m\], whether used.
fn picked(bench: &Bench, out: &str) -> Vec<(String, bool, f64, f64, bool)> {
    let text = std::fs::read_to_string(bench.path(&format!("{out}/picked.csv"))).expect("picked points");
    let row = |line: &str| {
        let f: Vec<&str> = line.split(',').collect();
        let number = |k: usize| f[k].parse().expect("a number");
        (f[0].to_string(), f[3] == "1", number(4), number(5), f[6] == "1")
    };
    text.lines().skip(1).map(row).collect()
}

fn outage_error_m(path: &Path) -> f64 {
    let (real, found) = (map_trajectory(&sample().join("truth/truth.sbet")), map_trajectory(path));
    let times = (0..400).map(|k| 209_069.0 + 0.1 * f64::from(k));
    let off = times.filter_map(|t| Some((real.pose_at(t)?.position - found.pose_at(t)?.position).norm()));
    off.fold(0.0, f64::max)
}

#[test]
fn picked_points_are_ties_and_a_slip_of_metres_is_named() {
    let bench = Bench::new();
    let (good, points) = rows();
    assert!(points >= 4, "{good}");
    let file = project(&bench, "good", &good);
    bench.tieline(&["run", &file, "--out", "good", "--csv", "-q"]).assert_success();
    let fates = picked(&bench, "good");
    assert!(fates.len() == 2 * points && fates.iter().any(|f| f.1) && fates.iter().any(|f| !f.1));
    let used = fates.iter().filter(|f| f.4).count();
    assert!(used + 2 >= fates.len(), "{fates:?}");
    // as well as they were picked, and far better than the strips were delivered
    for known in [true, false] {
        let of = fates.iter().filter(|f| f.1 == known && f.4);
        let sums = of.fold((0.0, 0.0, 0.0), |s, f| (s.0 + f.2 * f.2, s.1 + f.3 * f.3, s.2 + 1.0));
        let (before_m, after_m) = (f64::sqrt(sums.0 / sums.2), f64::sqrt(sums.1 / sums.2));
        assert!(after_m < if known { 0.04 } else { 0.06 } && before_m > after_m, "{known}: {before_m} {after_m}");
    }
    let text = std::fs::read_to_string(bench.path("good/ties.csv")).expect("ties");
    for kind in ["xyz_point", "control"] {
        let ends = text.lines().filter(|l| l.contains(kind)).count();
        assert!(ends >= 4, "{kind}: {ends}");
    }
    let error_m = outage_error_m(&bench.path("good/trajectory.sbet"));
    assert!(error_m < 0.03, "{error_m}");

    // one row two metres off: it is found by all the rest, named, and does no harm
    let bad = good.lines().filter(|l| l.contains("cover")).map(String::from).collect::<Vec<_>>();
    let sighted = |l: &&String| l.split(',').nth(1).is_some_and(|t| !t.is_empty());
    let spoilt = bad.iter().filter(sighted).nth(2).expect("a row");
    let mut fields: Vec<String> = spoilt.split(',').map(String::from).collect();
    fields[2] = format!("{:.4}", fields[2].parse::<f64>().expect("x") + 2.0);
    let file = project(&bench, "bad", &good.replace(spoilt.as_str(), &fields.join(",")));
    let ran = bench.tieline(&["run", &file, "--out", "bad", "--json"]);
    let notes = ran.json()["notes"].to_string();
    let name = &fields[0];
    assert!(notes.contains(&format!("picked point \\\"{name}\\\" does not fit")), "{notes}");
    let of_name: Vec<_> = picked(&bench, "bad").into_iter().filter(|f| &f.0 == name).collect();
    assert!(of_name.iter().all(|f| !f.4) && of_name.iter().any(|f| f.3 > 1.0), "{of_name:?}");
    let error_m = outage_error_m(&bench.path("bad/trajectory.sbet"));
    assert!(error_m < 0.03, "{error_m}");
}

#[test]
fn picked_points_that_cannot_be_right_are_refused_before_the_work() {
    let bench = Bench::new();
    let (good, _) = rows();
    let first = good.lines().next().expect("a row");
    let refused = |name: &str, rows: &str, words: &[&str]| {
        let file = project(&bench, name, rows);
        bench.tieline(&["run", &file, "--out", name]).assert_refused(words);
        assert!(!bench.path(name).exists(), "something was left behind");
    };
    let changed = |field: usize, value: &str| {
        let mut fields: Vec<&str> = first.split(',').collect();
        fields[field] = value;
        good.replacen(first, &fields.join(","), 1)
    };
    refused("number", &changed(3, "north"), &["number.csv", "line 2", "y_m", "north"]);
    refused("scanner", &changed(7, "5"), &["scanner.csv", "line 2", "scanner 5", "[0, 1]"]);
    refused("none", &changed(7, ""), &["none.csv", "line 2", "no scanner"]);
    refused("time", &changed(1, "209043.5"), &["time.csv", "line 2", "209043.5", "GPS time"]);
    refused("away", &changed(2, "603000"), &["away.csv", "line 2", "m from the vehicle"]);
    refused("alone", first, &["alone.csv", "line 2", "one row"]);
    let file = project(&bench, "both", &good);
    let text = std::fs::read_to_string(bench.path(&file)).expect("a project");
    std::fs::write(bench.path(&file), format!("{text}path = \"ties.txt\"\n")).expect("written");
    bench.tieline(&["run", &file, "--out", "both"]).assert_refused(&["ties.points", "take one of both out"]);
    let strips = "[[strips]]\npath = \"*.laz\"\n[ties]\npoints = \"p.csv\"\n";
    std::fs::write(bench.path("strips.toml"), strips).expect("written");
    bench.tieline(&["run", "strips.toml", "--out", "strips"]).assert_refused(&["ties.points", "for drives", "[imu]"]);
}
