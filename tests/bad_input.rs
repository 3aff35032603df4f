//! Bad input: each mistake has one readable message with a remedy, exit code 1, and leaves nothing half-written.
#![allow(clippy::expect_used)]

mod common;

use std::process::Command;

use common::{Bench, change_times, patch, read_points, write_points_again};

#[test]
fn a_truncated_laz_file_is_to_be_copied_again() {
    let bench = Bench::new();
    let content = std::fs::read(bench.strip(2)).expect("readable");
    std::fs::write(bench.strip(2), &content[..content.len() * 6 / 10]).expect("written");
    bench.refuses_to_run(&["strip_02.laz", "truncated", "copy the file again"]);
}

#[test]
fn a_header_without_its_points_is_truncated() {
    let bench = Bench::new();
    let content = std::fs::read(bench.strip(1)).expect("readable");
    std::fs::write(bench.strip(1), &content[..200]).expect("written");
    bench.refuses_to_run(&["strip_01.laz", "cut short", "copy the file again"]);
}

#[test]
fn a_corrupt_chunk_table_is_named() {
    let bench = Bench::new();
    let content = std::fs::read(bench.strip(1)).expect("readable");
    let u32_at = |at: usize| u32::from_le_bytes(content[at..at + 4].try_into().expect("four bytes")) as usize;
    let points_at = u32_at(96);
    let table_at = u32_at(points_at); // the lower half of 8 bytes: small files
    patch(&bench.strip(1), table_at + 4, &u32::MAX.to_le_bytes());
    bench.refuses_to_run(&["strip_01.laz", "chunk table is corrupt", "copy the file again"]);
}

#[test]
fn points_that_cannot_be_decoded_are_named_or_pass_as_points() {
    // LAZ has no checksums: damage inside of a chunk either shows in decoding or gives other points.
    let bench = Bench::new();
    let length = std::fs::metadata(bench.strip(1)).expect("there").len();
    let middle = usize::try_from(length / 2).expect("small");
    patch(&bench.strip(1), middle, &[0xff; 64]);
    let ran = bench.tieline(&["run", "survey/project.toml", "--out", "out"]);
    if ran.code != Some(0) {
        ran.assert_refused(&[]);
        assert!(bench.files("out").is_empty());
    }
}

#[test]
fn a_file_without_points_is_to_be_left_out() {
    let bench = Bench::new();
    patch(&bench.strip(3), 247, &[0; 8]);
    patch(&bench.strip(3), 107, &[0; 4]);
    bench.refuses_to_run(&["strip_03.laz", "no points", "leave it out"]);
}

#[test]
fn a_scale_that_is_not_a_number_is_refused() {
    let bench = Bench::new();
    patch(&bench.strip(1), 139, &f64::NAN.to_le_bytes());
    bench.refuses_to_run(&["strip_01.laz", "y scale factor is NaN", "write the file anew"]);
}

#[test]
fn bounds_that_are_not_numbers_are_refused() {
    let bench = Bench::new();
    patch(&bench.strip(1), 179, &f64::NAN.to_le_bytes());
    bench.refuses_to_run(&["strip_01.laz", "is NaN", "lasinfo -repair_bb"]);
}

#[test]
fn a_wrong_record_length_is_refused() {
    let bench = Bench::new();
    patch(&bench.strip(1), 105, &10_u16.to_le_bytes());
    bench.refuses_to_run(&["strip_01.laz", "point records have 10 bytes", "at least 30"]);
}

#[test]
fn las_1_5_is_refused_with_the_way_to_convert_it() {
    let bench = Bench::new();
    patch(&bench.strip(1), 25, &[5]);
    bench.refuses_to_run(&["strip_01.laz", "LAS 1.5 is not supported", "pdal translate"]);
}

#[test]
fn a_text_file_is_no_strip() {
    let bench = Bench::new();
    std::fs::write(bench.strip(1), "x y z\n1 2 3\n".repeat(100)).expect("written");
    bench.refuses_to_run(&["strip_01.laz", "not a LAS or LAZ file"]);
}

#[test]
fn times_that_never_change_are_refused() {
    let bench = Bench::new();
    change_times(&bench.strip(2), |_, _| 409_393_000.0);
    bench.refuses_to_run(&["strip_02.laz", "GPS time never changes", "export the strips with it"]);
}

#[test]
fn times_that_are_all_zero_are_refused() {
    let bench = Bench::new();
    change_times(&bench.strip(2), |_, _| 0.0);
    bench.refuses_to_run(&["strip_02.laz", "GPS time never changes: 0 s", "export the strips with it"]);
}

#[test]
fn points_without_gps_time_are_refused() {
    let bench = Bench::new();
    let points = read_points(&bench.strip(1));
    write_points_again(&bench.strip(1), &points, |options| options.point_format = 0);
    bench.refuses_to_run(&["strip_01.laz", "point format 0 has no GPS time", "export the strips with it"]);
}

#[test]
fn a_time_that_is_not_a_number_is_found_before_the_long_work() {
    let bench = Bench::new();
    change_times(&bench.strip(2), |index, time_s| if index == 7000 { f64::NAN } else { time_s });
    bench.refuses_to_run(&["strip_02.laz", "point 7000", "not a number", "export the strips again"]);
}

#[test]
fn points_in_any_order_of_time_are_legitimate() {
    let bench = Bench::new();
    let mut points = read_points(&bench.strip(1));
    points.x.reverse();
    points.y.reverse();
    points.z.reverse();
    points.gps_time.reverse();
    points.return_number.reverse();
    points.number_of_returns.reverse();
    points.classification.reverse();
    write_points_again(&bench.strip(1), &points, |_| {});
    bench.tieline(&["run", "survey/project.toml", "--out", "out"]).assert_success();
}

#[test]
fn strips_that_do_not_overlap_have_no_ties() {
    let bench = Bench::new();
    bench.edit_project(|text| text.replace("strips/*.laz", "strips/strip_0[12].laz"));
    let points = read_points(&bench.strip(2));
    write_points_again(&bench.strip(2), &points, |options| options.offset[0] += 5_000.0);
    bench.refuses_to_run(&["no two strips overlap", "give strips that overlap"]);
}

#[test]
fn a_strip_outside_of_the_trajectory_is_named_with_both_spans() {
    let bench = Bench::new();
    change_times(&bench.strip(3), |_, time_s| time_s + 1000.0);
    bench.refuses_to_run(&["is not covered by", "trajectory.sbet", "check time systems"]);
}

#[test]
fn two_reference_systems_are_not_mixed() {
    let bench = Bench::new();
    bench.edit_project(|text| text.replace("crs = \"EPSG:32632\"\n", ""));
    for (number, zone, meridian) in [(1, 32, 9), (2, 33, 15)] {
        let points = read_points(&bench.strip(number));
        let wkt = utm(zone, meridian);
        write_points_again(&bench.strip(number), &points, |options| options.wkt = Some(wkt));
    }
    bench.refuses_to_run(&["two reference systems", "strip_01.laz", "strip_02.laz", "bring them into one"]);
}

#[test]
fn a_reference_system_that_contradicts_the_strips_is_refused() {
    let bench = Bench::new();
    let points = read_points(&bench.strip(1));
    write_points_again(&bench.strip(1), &points, |options| options.wkt = Some(utm(33, 15)));
    bench.refuses_to_run(&["project.crs", "EPSG:32632", "zone 33N", "correct one"]);
}

/// WKT of a zone of UTM.
fn utm(zone: u32, meridian_deg: u32) -> String {
    format!(
        "PROJCS[\"WGS 84 / UTM zone {zone}N\",GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",SPHEROID[\"WGS 84\",6378137,298.257223563]],\
         PRIMEM[\"Greenwich\",0],UNIT[\"degree\",0.0174532925199433]],PROJECTION[\"Transverse_Mercator\"],\
         PARAMETER[\"latitude_of_origin\",0],PARAMETER[\"central_meridian\",{meridian_deg}],PARAMETER[\"scale_factor\",0.9996],\
         PARAMETER[\"false_easting\",500000],PARAMETER[\"false_northing\",0],UNIT[\"metre\",1],AUTHORITY[\"EPSG\",\"326{zone}\"]]"
    )
}

#[test]
fn degrees_instead_of_metres_are_to_be_projected() {
    let bench = Bench::new();
    bench.edit_project(|text| text.replace("crs = \"EPSG:32632\"\n", ""));
    for number in 1..=3 {
        let mut points = read_points(&bench.strip(number));
        points.x.iter_mut().for_each(|x| *x = 96_000_000 + *x / 100);
        points.y.iter_mut().for_each(|y| *y = 468_000_000 + *y / 100);
        write_points_again(&bench.strip(number), &points, |options| {
            options.scale = [1e-7, 1e-7, 1e-3];
            options.offset = [0.0; 3];
        });
    }
    bench.refuses_to_run(&["strip_01.laz", "degrees", "project them to metres"]);
}

#[test]
fn a_misspelt_key_is_named_with_its_line_and_the_keys_there_are() {
    let bench = Bench::new();
    bench.edit_project(|text| format!("{text}\n[match]\npatchm = 1.0\n"));
    bench.refuses_to_run(&["project.toml", "patchm", "patch_m"]);
}

#[test]
fn a_project_without_strips_or_with_strips_that_are_not_there_is_refused() {
    let bench = Bench::new();
    bench.edit_project(|text| text.replace("strips/*.laz", "strip/*.laz"));
    bench.refuses_to_run(&["strip/*.laz", "no file is found", "relative to the project file"]);
    bench.tieline(&["run", "nowhere.toml", "--out", "out"]).assert_refused(&["nowhere.toml", "cannot be read"]);
}

#[test]
fn a_trajectory_that_is_not_there_is_named() {
    let bench = Bench::new();
    std::fs::remove_file(bench.path("survey/trajectory.sbet")).expect("removed");
    bench.refuses_to_run(&["trajectory.sbet", "No such file"]);
}

#[test]
fn a_truncated_trajectory_is_named_with_its_record() {
    let bench = Bench::new();
    let path = bench.path("survey/trajectory.sbet");
    let content = std::fs::read(&path).expect("readable");
    std::fs::write(&path, &content[..content.len() - 40]).expect("written");
    bench.refuses_to_run(&["trajectory.sbet", "record 826", "96 bytes"]);
    bench.tieline(&["info", "survey/trajectory.sbet"]).assert_refused(&["trajectory.sbet", "record 826"]);
}

#[test]
fn a_trajectory_that_runs_backwards_is_to_be_sorted() {
    let bench = Bench::new();
    let path = bench.path("survey/trajectory.sbet");
    let mut content = std::fs::read(&path).expect("readable");
    let (a, b) = (100 * 136, 130 * 136);
    for byte in 0..136 {
        content.swap(a + byte, b + byte);
    }
    std::fs::write(&path, content).expect("written");
    bench.refuses_to_run(&["trajectory.sbet", "time runs backwards", "record 101", "sort the file"]);
}

#[test]
fn an_output_folder_in_use_is_left_alone() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("out")).expect("created");
    std::fs::write(bench.path("out/thesis.txt"), "mine").expect("written");
    let ran = bench.tieline(&["run", "survey/project.toml", "--out", "out"]);
    ran.assert_refused(&["out is not empty", "--out", "--overwrite"]);
    assert_eq!(bench.files("out").into_keys().collect::<Vec<_>>(), ["thesis.txt"]);
    bench.tieline(&["run", "survey/project.toml", "--out", "out", "--overwrite", "-q"]).assert_success();
    assert_eq!(bench.files("out")["thesis.txt"], b"mine");
}

#[test]
fn an_output_folder_that_is_a_file_is_refused() {
    let bench = Bench::new();
    std::fs::write(bench.path("out"), "a file").expect("written");
    let ran = bench.tieline(&["run", "survey/project.toml", "--out", "out"]);
    ran.assert_refused(&["the output folder out cannot be created"]);
}

#[test]
fn a_stage_before_the_one_it_needs_says_which() {
    let bench = Bench::new();
    bench.tieline(&["solve", "survey/project.toml", "--out", "out"]).assert_refused(&["run `tieline match`"]);
    bench.tieline(&["match", "survey/project.toml", "--out", "out", "-q"]).assert_success();
    bench.tieline(&["correct", "survey/project.toml", "--out", "out"]).assert_refused(&["run `tieline solve`"]);
}

/// Runs a script where a file system of its own, of some KiB, can be mounted on `out`; `None` where that is forbidden.
fn with_a_small_disk(bench: &Bench, kib: u32, arguments: &str) -> Option<(Option<i32>, String, String)> {
    std::fs::create_dir_all(bench.path("out")).expect("created");
    let script = format!(
        "mount -t tmpfs -o size={kib}k tmpfs out || exit 77; {} {arguments}; code=$?; find out -type f; exit $code",
        env!("CARGO_BIN_EXE_tieline")
    );
    let output = Command::new("unshare").args(["-rm", "sh", "-c", &script]).current_dir(bench.root()).output().ok()?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (code, out, err) = (output.status.code(), text(&output.stdout), text(&output.stderr));
    (code != Some(77) && !err.contains("unshare")).then_some((code, out, err))
}

#[test]
fn a_full_disk_leaves_whole_files_only() {
    let bench = Bench::new();
    bench.tieline(&["run", "survey/project.toml", "--out", "whole", "-q"]).assert_success();
    let whole = bench.files("whole");
    for kib in [100, 1500, 2000, 2300, 2400] {
        let Some((code, out, err)) = with_a_small_disk(&bench, kib, "run survey/project.toml --out out") else {
            return; // no small disk can be had here
        };
        if code == Some(0) {
            continue;
        }
        assert_eq!(code, Some(1), "{kib} KiB: {err}");
        let message = err.lines().last().unwrap_or_default();
        assert!(message.starts_with("tieline: ") && message.contains("free some space"), "{kib} KiB: {err}");
        assert_eq!(message.matches("No space left").count(), 1, "{kib} KiB: {err}");
        for file in out.lines().filter(|line| line.starts_with("out/")) {
            assert!(!file.ends_with(".partial"), "{kib} KiB left {file}");
            assert!(whole.contains_key(file.trim_start_matches("out/")), "{kib} KiB left {file}");
        }
    }
}

#[test]
fn a_full_disk_stops_the_correction_by_two_trajectories() {
    let bench = Bench::new();
    let arguments = "correct --from survey/trajectory.sbet --to survey/truth/trajectory_true.sbet --crs EPSG:32632 \
                     survey/strips/strip_01.laz --out out";
    let Some((code, out, err)) = with_a_small_disk(&bench, 60, arguments) else { return };
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("No space left") && err.contains("strip_01.laz"), "{err}");
    assert_eq!(out, "");
}
