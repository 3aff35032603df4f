//! Ties in text: what `run` writes, `solve` takes, and the two trajectories agree.

mod common;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use common::Bench;
use tieline_filter::Trajectory;
use tieline_io::ties::text::{TextTie, TieTextReader};
use tieline_io::trajectory::{ReadOptions, read};

/// The outage of the sample \[s\].
fn outage_s() -> (f64, f64) {
    let text = std::fs::read_to_string(sample().join("truth/outages.csv")).expect("outages");
    let mut times = text.lines().nth(1).expect("one").split(',').map(|f| f.parse().expect("a time"));
    (times.next().expect("start"), times.next().expect("end"))
}

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop")
}

/// The sample drive, run once for all tests.
fn ran() -> &'static Bench {
    static RAN: OnceLock<Bench> = OnceLock::new();
    RAN.get_or_init(|| {
        let bench = Bench::new();
        let project = sample().join("project.toml");
        bench.tieline(&["run", project.to_str().expect("UTF-8"), "--out", "out", "-q"]).assert_success();
        bench
    })
}

/// The sample without strips, with more in its project file.
fn without_strips(bench: &Bench, name: &str, more: &str) {
    let text = std::fs::read_to_string(sample().join("project.toml")).expect("a project");
    let strips = "[[strips]]\npath = \"strips/*.laz\"\n\n";
    assert!(text.contains(strips));
    let mut text = text.replace(strips, "");
    for file in ["trajectory.sbet", "trajectory_rms.out", "imu.txt.gz", "gnss.pos", "odometer.csv"] {
        let full = sample().join(file).display().to_string();
        text = text.replace(&format!("\"{file}\""), &format!("'{full}'"));
    }
    std::fs::write(bench.path(name), text + more).expect("written");
}

fn load(path: &Path) -> Trajectory {
    let accuracy = path.with_file_name("trajectory_rms.out");
    read(path, &ReadOptions { format: None, columns: None, accuracy: Some(accuracy) }).expect("a trajectory").trajectory
}

/// Largest difference of two trajectories over the sigma of the first, positions and angles, and largest difference of
/// positions in the outage \[m\].
fn difference(a: &Path, b: &Path) -> (f64, f64) {
    let (a, b) = (load(a), load(b));
    assert_eq!(a.time_s().len(), b.time_s().len());
    let (from_s, to_s) = outage_s();
    let (mut over_sigma, mut outage_m) = (0.0_f64, 0.0_f64);
    for (i, time_s) in a.time_s().iter().enumerate() {
        let d = b.position()[i] - a.position()[i];
        let metres = [d.x * 6.371e6, d.y * 6.371e6 * a.position()[i].x.cos(), d.z];
        let sigma = a.sigma_at(*time_s).expect("sigmas");
        let turned = (a.pose_at(*time_s).expect("a pose").ned_from_body.inverse()
            * b.pose_at(*time_s).expect("a pose").ned_from_body)
            .angle();
        for (metres, sigma_m) in metres.iter().zip(&sigma.position_ned_m) {
            over_sigma = over_sigma.max(metres.abs() / sigma_m);
            if *time_s > from_s && *time_s <= to_s {
                outage_m = outage_m.max(metres.abs());
            }
        }
        over_sigma = over_sigma.max(turned / sigma.attitude_rph_rad.min());
    }
    (over_sigma, outage_m)
}

fn ties(path: &Path) -> Vec<TextTie> {
    TieTextReader::open(path).expect("a file of ties").map(|t| t.expect("a tie")).collect()
}

#[test]
fn the_ties_of_a_run_lead_solve_to_the_same_trajectory() {
    let bench = ran();
    without_strips(bench, "with.toml", "\n[ties]\npath = \"out/ties.txt\"\n");
    let solved = bench.tieline(&["solve", "with.toml", "--out", "with", "--json"]);
    let summary = solved.json();
    without_strips(bench, "without.toml", "");
    bench.tieline(&["solve", "without.toml", "--out", "without", "-q"]).assert_success();
    let ran = bench.path("out/trajectory.sbet");
    let (over_sigma, outage_m) = difference(&ran, &bench.path("with/trajectory.sbet"));
    let (far_over_sigma, far_m) = difference(&ran, &bench.path("without/trajectory.sbet"));
    // each of both stops where a run changes nothing by a tenth of a sigma
    assert!(over_sigma < 0.05 && outage_m < 0.000_1, "{over_sigma} sigma, {outage_m} m");
    assert!(far_over_sigma > 2.0 && far_m > 0.03, "{far_over_sigma} sigma, {far_m} m");
    // what the run used is used, and what it did not is not
    let written = ties(&bench.path("out/ties.txt"));
    let in_use = written.iter().filter(|t| t.for_smoother(0.0).is_some()).count() as u64;
    assert_eq!(summary["inputs"]["ties"].as_u64(), Some(in_use));
    let used = summary["trajectory"]["ties_used"].as_u64().expect("a number");
    assert!(used * 100 >= in_use * 99, "{used} of {in_use}");
}

#[test]
fn every_class_and_kind_stands_in_the_file_with_a_unit_normal() {
    let text = std::fs::read_to_string(ran().path("out/ties.txt")).expect("ties");
    for line in [
        "# tieline ties 1",
        "# week: 2330",
        "# directions: ecef",
        "# body: frd",
        "# calibration: applied",
        "EPSG:32633",
    ] {
        assert!(text.contains(line), "{line}: {}", &text[..800]);
    }
    let ties = ties(&ran().path("out/ties.txt"));
    for class in tieline_filter::TieClass::ALL {
        assert!(ties.iter().any(|t| t.class == class), "{}", class.as_str());
    }
    let loops = ties.iter().filter(|t| t.kind == tieline_filter::TieKind::SurfaceLine);
    assert!(loops.clone().count() > 10);
    for tie in loops {
        let (first, last) = (&tie.sightings[0], &tie.sightings[tie.sightings.len() - 1]);
        assert!(last.time_s - first.time_s > 8.0, "{tie:?}");
    }
    let scanners: std::collections::BTreeSet<u16> = ties.iter().flat_map(|t| &t.sightings).map(|s| s.scanner).collect();
    assert_eq!(scanners.into_iter().collect::<Vec<_>>(), [0, 1]);
    let info = ran().tieline(&["info", "out/ties.txt", "--json"]).json();
    assert!(info.to_string().contains("\"gps_week\":2330"), "{info}");
}

/// `solve` with the ties as changed must refuse and leave nothing.
fn refused(name: &str, change: impl Fn(String) -> String, words: &[&str]) {
    let bench = ran();
    let text = std::fs::read_to_string(bench.path("out/ties.txt")).expect("ties");
    std::fs::write(bench.path(&format!("{name}.txt")), change(text)).expect("written");
    without_strips(bench, &format!("{name}.toml"), &format!("\n[ties]\npath = \"{name}.txt\"\n"));
    bench.tieline(&["solve", &format!("{name}.toml"), "--out", name]).assert_refused(words);
    assert!(!bench.path(name).exists(), "something was left behind");
}

#[test]
fn ties_that_cannot_be_right_are_refused_before_the_work() {
    refused(
        "week",
        |t| t.replace("# week: 2330", "# week: 2331"),
        &["week.txt", "week 2331", "week 2330", "project.week"],
    );
    refused("frame", |t| t.replace("directions: ecef", "directions: ned"), &["frame.txt", "ned", "ecef"]);
    refused("cut", |t| t[..t.len() - 30].to_string(), &["cut.txt", "line", "fields"]);
    refused("none", |t| t.lines().filter(|l| l.starts_with('#')).fold(String::new(), |a, l| a + l + "\n"), &["no tie"]);
    refused("other", |_| String::from("gps_time_s,lat_deg\n1,2\n"), &["other.txt", "# tieline ties"]);
    let bench = ran();
    without_strips(bench, "missing.toml", "\n[ties]\npath = \"nowhere.txt\"\n");
    bench.tieline(&["solve", "missing.toml", "--out", "missing"]).assert_refused(&["nowhere.txt"]);
    let project = format!("[[strips]]\npath = '{}/strips/*.laz'\n", sample().display());
    without_strips(bench, "both.toml", &format!("\n[ties]\npath = \"out/ties.txt\"\n{project}"));
    bench.tieline(&["run", "both.toml", "--out", "both"]).assert_refused(&["[ties]", "[[strips]]", "solve"]);
    std::fs::write(bench.path("lone.toml"), format!("{project}[ties]\npath = \"out/ties.txt\"\n")).expect("written");
    bench.tieline(&["run", "lone.toml", "--out", "lone"]).assert_refused(&["ties", "[imu]"]);
}
