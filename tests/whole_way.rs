//! The whole way on a small survey: same bytes whatever the threads and the stages, points kept, corrections reversible.
#![allow(clippy::expect_used)]

mod common;

use std::collections::BTreeMap;

use common::{Bench, coordinates_m, largest_difference_m, raw_records, read_points};
use tieline_io::las::LasFile;

/// Files whose bytes follow from the input alone: the others hold times of the clock on the wall.
fn of_the_result(files: BTreeMap<String, Vec<u8>>) -> BTreeMap<String, Vec<u8>> {
    let timed = ["report.html", "summary.json", "stages/solve.json"];
    files.into_iter().filter(|(name, _)| !timed.contains(&name.as_str())).collect()
}

fn assert_same(a: &BTreeMap<String, Vec<u8>>, b: &BTreeMap<String, Vec<u8>>) {
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in a {
        assert!(*bytes == b[name], "{name} differs");
    }
}

#[test]
fn the_number_of_threads_and_the_way_through_the_stages_change_no_byte() {
    threads_and_stages_change_no_byte(&Bench::new());
}

#[test]
fn the_same_holds_for_trajectories_that_are_rebuilt() {
    let bench = Bench::new();
    bench.edit_project(|text| {
        let (from, to) = (text.find("[trajectory]"), text.find("[[platform.scanner]]"));
        format!("{}{}", &text[..from.expect("there")], &text[to.expect("there")..])
    });
    threads_and_stages_change_no_byte(&bench);
}

fn threads_and_stages_change_no_byte(bench: &Bench) {
    let run = ["run", "survey/project.toml", "-q", "--csv", "--out"];
    bench.tieline(&[&run[..], &["one", "--threads", "1"]].concat()).assert_success();
    bench.tieline(&[&run[..], &["two", "--threads", "2"]].concat()).assert_success();
    let one = of_the_result(bench.files("one"));
    assert_same(&one, &of_the_result(bench.files("two")));
    for name in ["corrected/strip_01.laz", "ties.parquet", "ties.csv", "calibration.toml", "correction.csv"] {
        assert!(one.contains_key(name), "{name} is not there");
    }

    for stage in ["match", "solve", "correct", "report"] {
        let mut arguments = vec![stage, "survey/project.toml", "-q", "--out", "stages"];
        if stage != "correct" {
            arguments.push("--csv");
        }
        bench.tieline(&arguments).assert_success();
    }
    assert_same(&one, &of_the_result(bench.files("stages")));
}

#[test]
fn corrected_files_keep_their_points_and_the_inverse_leads_back() {
    let bench = Bench::new();
    bench.tieline(&["run", "survey/project.toml", "-q", "--out", "out"]).assert_success();
    let strips = ["strip_01.laz", "strip_02.laz", "strip_03.laz"];
    let corrected = strips.map(|name| format!("out/corrected/{name}"));
    let arguments =
        ["correct", "survey/project.toml", &corrected[0], &corrected[1], &corrected[2], "--inverse", "--out", "out"];
    bench.tieline(&arguments).assert_success();
    for (number, name) in strips.iter().enumerate() {
        let (input, output) = (bench.strip(number + 1), bench.path(&corrected[number]));
        let restored = bench.path(&format!("out/restored/{name}"));
        let moved_m = largest_difference_m(&input, &output);
        assert!((0.005..0.5).contains(&moved_m), "{name} moved by {moved_m} m");
        let scale_m = LasFile::open(&input).expect("opens").header().scale[0];
        let left_m = largest_difference_m(&input, &restored);
        assert!(left_m <= 1.000_001 * scale_m, "{name} comes back with {left_m} m");
        for file in [&output, &restored] {
            assert_same_but_for_coordinates(&input, file);
        }
    }
}

/// Every byte of every record after the coordinates, and of the header but scale, offset, bounds and software.
fn assert_same_but_for_coordinates(a: &std::path::Path, b: &std::path::Path) {
    let ((records, length), (others, other_length)) = (raw_records(a), raw_records(b));
    assert_eq!((records.len(), length), (others.len(), other_length));
    for (index, (x, y)) in records.chunks(length).zip(others.chunks(length)).enumerate() {
        assert!(x[12..] == y[12..], "point {index} of {}", b.display());
    }
    let (before, after) = (LasFile::open(a).expect("opens"), LasFile::open(b).expect("opens"));
    let mut expected = before.header().clone();
    let header = after.header();
    (expected.scale, expected.offset, expected.min, expected.max) =
        (header.scale, header.offset, header.min, header.max);
    expected.generating_software.clone_from(&header.generating_software);
    assert_eq!(format!("{expected:?}"), format!("{header:?}"));
}

/// Mean height of all points of a strip \[m\].
#[allow(clippy::cast_precision_loss)]
fn mean_height_m(bench: &Bench, path: &str) -> f64 {
    let points = coordinates_m(&bench.path(path));
    points.iter().map(|p| p[2]).sum::<f64>() / points.len() as f64
}

#[test]
fn control_points_pull_the_heights() {
    let bench = Bench::new();
    // every hundredth point of the smooth roads, 8 cm above where the strips have them
    let strip = bench.strip(1);
    let (coordinates, classes) = (coordinates_m(&strip), read_points(&strip).classification);
    let roads = coordinates.iter().zip(&classes).filter(|(_, class)| **class == 11).map(|(p, _)| p);
    let lines: String = roads.step_by(20).map(|p| format!("{:.3},{:.3},{:.3}\n", p[0], p[1], p[2] + 0.08)).collect();
    std::fs::write(bench.path("survey/control.csv"), format!("east_m,north_m,height_m\n{lines}")).expect("written");
    bench.tieline(&["run", "survey/project.toml", "-q", "--out", "free"]).assert_success();
    bench.edit_project(|text| {
        format!("{text}\n[[control]]\npath = \"control.csv\"\nkind = \"points\"\nsigma_m = 0.01\n[solve]\nposition_sigma_m = 0.2\n")
    });
    bench.tieline(&["run", "survey/project.toml", "-q", "--out", "held"]).assert_success();
    for strip in ["strip_01.laz", "strip_02.laz", "strip_03.laz"] {
        let input_m = mean_height_m(&bench, &format!("survey/strips/{strip}"));
        let held_m = mean_height_m(&bench, &format!("held/corrected/{strip}")) - input_m;
        let free_m = mean_height_m(&bench, &format!("free/corrected/{strip}")) - input_m;
        assert!(held_m > 0.04 && held_m > free_m + 0.03, "{strip}: {held_m:.3} m with control, {free_m:.3} m without");
    }
}

#[test]
fn a_fixed_strip_stays_and_the_others_come_to_it() {
    let bench = Bench::new();
    bench.edit_project(|text| format!("{text}\n[solve]\nfixed = [\"2\"]\n[calibrate]\nenabled = false\n"));
    bench.tieline(&["run", "survey/project.toml", "-q", "--out", "out"]).assert_success();
    let moved_m = |number: usize| {
        largest_difference_m(&bench.strip(number), &bench.path(&format!("out/corrected/strip_{number:02}.laz")))
    };
    assert!(moved_m(2) <= 1e-6, "the fixed strip moved by {} m", moved_m(2));
    assert!(moved_m(1) > 0.005 && moved_m(3) > 0.005);
}

#[test]
fn a_fixed_strip_that_is_not_there_is_named() {
    let bench = Bench::new();
    bench.edit_project(|text| format!("{text}\n[solve]\nfixed = [\"17\"]\n"));
    bench.refuses_to_run(&["solve.fixed", "17"]);
}

#[test]
fn limits_of_area_range_incidence_and_scanner_keep_ties_out() {
    let bench = Bench::new();
    let found = |name: &str, limits: &str| {
        if !limits.is_empty() {
            bench.edit_project(|text| format!("{text}\n[match]\n{limits}\n"));
        }
        let ran = bench.tieline(&["match", "survey/project.toml", "--json", "--out", name]);
        ran.assert_success();
        let json = ran.json();
        if !limits.is_empty() {
            bench.edit_project(|text| text.replace(&format!("\n[match]\n{limits}\n"), ""));
        }
        let refused = |why: &str| json["rejected"][why].as_u64().unwrap_or(0);
        (json["found"].as_u64().expect("a count"), refused("limits") + refused("grazing"))
    };
    let all = found("all", "");
    assert_eq!(all.1, 0);
    let nearer = found("nearer", "range_m = [0.0, 10.0]");
    assert!(nearer.0 == 0 && nearer.1 > 0, "nothing lies within ten metres of an aircraft");
    let far = found("far", "range_m = [0.0, 5000.0]");
    assert_eq!(far, all);
    assert_eq!(found("any angle", "max_incidence_deg = 90.0"), all);
    let from_above = found("from above", "max_incidence_deg = 5.0");
    assert!(from_above.0 < all.0 && from_above.1 > 0);
    assert_eq!(found("scanner", "scanners = [3]").0, 0);
    let elsewhere = found("area", "area_m = [-9e6, -9e6, -8e6, -8e6]");
    assert!(elsewhere.0 == 0 && elsewhere.1 > 0);
}
