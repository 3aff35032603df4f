//! A rewritten file has other coordinates and everything else as it was.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

mod las_common;

use std::fs;
use std::path::Path;

use las_common::{attributes, options, read, real, write, write_copc};
use tieline_io::las::{
    LasError, LasFile, RewriteOptions, RewriteReport, VlrSummary, output_offset, output_scale, rewrite,
};

/// The grid that a corrected file is written on.
fn grid_of(file: &LasFile) -> RewriteOptions {
    let header = file.header();
    let scale = output_scale(header.scale);
    let offset = output_offset(header.min, header.max, scale);
    RewriteOptions { scale, offset, generating_software: "tieline".to_owned() }
}

fn shift(input: &Path, output: &Path, by_m: [f64; 3]) -> RewriteReport {
    let file = LasFile::open(input).unwrap();
    rewrite(&file, output, &grid_of(&file), |_, _, _, coordinates_m| {
        for point in coordinates_m {
            for (value, by) in point.iter_mut().zip(by_m) {
                *value += by;
            }
        }
        Ok(())
    })
    .unwrap()
}

/// Coordinates \[m\] of all points.
fn coordinates(file: &LasFile) -> Vec<[f64; 3]> {
    let header = file.header();
    let metres = |record: &[u8]| {
        [0, 1, 2].map(|axis| {
            let stored = i32::from_le_bytes(record[4 * axis..4 * axis + 4].try_into().unwrap());
            f64::from(stored) * header.scale[axis] + header.offset[axis]
        })
    };
    read(file).chunks_exact(file.layout().record_length).map(metres).collect()
}

fn contents(file: &LasFile, skip: &str) -> Vec<(VlrSummary, Vec<u8>)> {
    let kept = file.header().vlrs.iter().filter(|record| record.user_id != skip);
    kept.map(|record| (record.clone(), file.record(&record.user_id, record.record_id).unwrap())).collect()
}

/// Compares what must be the same; returns the greatest distance \[m\] on an axis from `old` moved by `by_m`.
fn compare(old: &Path, new: &Path, by_m: [f64; 3]) -> f64 {
    let (old, new) = (LasFile::open(old).unwrap(), LasFile::open(new).unwrap());
    assert!(attributes(&read(&old), old.layout()) == attributes(&read(&new), new.layout()));
    assert_eq!(old.chunk_count(), new.chunk_count());
    assert!((0..old.chunk_count()).all(|chunk| old.chunk_points(chunk) == new.chunk_points(chunk)));
    let (before, after) = (contents(&old, "copc"), contents(&new, "copc"));
    assert_eq!(before.len(), after.len());
    for ((summary, contents), (new_summary, new_contents)) in before.iter().zip(&after) {
        assert!(summary.is(&new_summary.user_id, new_summary.record_id) && contents == new_contents);
        assert_eq!((summary.is_extended, &summary.description), (new_summary.is_extended, &new_summary.description));
    }
    assert_eq!(old.header().points_by_return, new.header().points_by_return);
    assert_eq!(old.header().global_encoding, new.header().global_encoding);
    let pairs = coordinates(&old).into_iter().zip(coordinates(&new));
    let distances = pairs.flat_map(|(old, new)| [0, 1, 2].map(|axis| (new[axis] - old[axis] - by_m[axis]).abs()));
    distances.fold(0.0, f64::max)
}

#[test]
fn only_coordinates_change_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let by_m = [0.012, -0.034, 0.056];
    for format in 0..=10 {
        for extension in ["las", "laz"] {
            let old = folder.path().join(format!("{format}.{extension}"));
            let new = folder.path().join(format!("{format}.new.{extension}"));
            write(&old, options(format), 2_500);
            let report = shift(&old, &new, by_m);
            assert!(compare(&old, &new, by_m) < 0.000_501, "format {format}");
            let header_bytes = |path: &Path| fs::read(path).unwrap()[..227].to_vec();
            let (before, after) = (header_bytes(&old), header_bytes(&new));
            let changed = (0..227).filter(|&at| before[at] != after[at]);
            assert!({ changed }.all(|at| (58..90).contains(&at) || at >= 131), "format {format}");
            assert_eq!(report.file_length, fs::metadata(&new).unwrap().len());
            assert_eq!(LasFile::open(&new).unwrap().header().min.map(f64::to_bits), report.min.map(f64::to_bits));
        }
    }
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let old = folder.path().join("old.laz");
    write(&old, options(1), 230_000);
    let written = [1, 2, 5].map(|threads| {
        let new = folder.path().join(format!("{threads}.laz"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| shift(&old, &new, [0.1, 0.2, 0.3]));
        fs::read(new).unwrap()
    });
    assert!(written[0] == written[1] && written[1] == written[2]);
}

#[test]
fn the_inverse_returns_the_input_within_one_scale_unit() {
    let folder = tempfile::tempdir().unwrap();
    let (old, moved, back) = (folder.path().join("a.laz"), folder.path().join("b.laz"), folder.path().join("c.laz"));
    write(&old, options(6), 5_000);
    shift(&old, &moved, [0.012_345, -3.210_987, 0.000_6]);
    shift(&moved, &back, [-0.012_345, 3.210_987, -0.000_6]);
    assert!(compare(&old, &back, [0.0; 3]) <= 0.001);
}

#[test]
fn an_edit_sees_the_records_as_they_were_and_the_index_of_their_first_point() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.laz");
    let written = write(&path, options(3), 110_000);
    let file = LasFile::open(&path).unwrap();
    let edit = |first: u64, records: &[u8], layout: tieline_io::las::RecordLayout, coordinates_m: &mut [[f64; 3]]| {
        let start = usize::try_from(first)? * layout.record_length;
        assert!(records == &written[start..start + records.len()]);
        assert_eq!(records.len(), coordinates_m.len() * layout.record_length);
        Ok(())
    };
    let new = folder.path().join("new.laz");
    rewrite(&file, &new, &grid_of(&file), edit).unwrap();
    assert!(compare(&path, &new, [0.0; 3]) < 1e-6);
}

#[test]
fn positions_of_waveform_packets_follow_the_compressed_size() {
    let folder = tempfile::tempdir().unwrap();
    for format in [4, 5, 9, 10] {
        let old = folder.path().join(format!("{format}.laz"));
        write(&old, options(format), 3_000);
        let mut bytes = fs::read(&old).unwrap();
        let start = match LasFile::open(&old).unwrap().header().vlrs.iter().any(|record| record.is_extended) {
            // the second extended record holds the packets
            true => u64::from_le_bytes(bytes[235..243].try_into().unwrap()) + 60 + 70_000,
            // LAS 1.3: they follow the points, and no list names them
            false => {
                bytes.extend(b"waveform packets");
                bytes.len() as u64 - 16
            }
        };
        bytes[227..235].copy_from_slice(&start.to_le_bytes());
        fs::write(&old, &bytes).unwrap();
        let new = folder.path().join(format!("{format}.new.laz"));
        shift(&old, &new, [1.234_567, 2.345_678, 0.001]);
        let written = fs::read(&new).unwrap();
        let place = |bytes: &[u8]| usize::try_from(u64::from_le_bytes(bytes[227..235].try_into().unwrap())).unwrap();
        assert!(bytes[place(&bytes)..] == written[place(&written)..], "format {format}");
        assert_ne!(place(&bytes), place(&written));
    }
}

#[test]
fn copc_becomes_plain_laz_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old.copc.laz"), folder.path().join("new.laz"));
    write_copc(&old, 6_000);
    let report = shift(&old, &new, [0.5, 0.5, 0.5]);
    assert!(compare(&old, &new, [0.5; 3]) < 0.000_501);
    assert_eq!(report.notes.len(), 1);
    let file = LasFile::open(&new).unwrap();
    assert!(!file.header().is_copc && file.header().vlrs.iter().all(|record| record.user_id != "copc"));
}

#[test]
fn a_coordinate_that_does_not_fit_names_its_point_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old.laz"), folder.path().join("new.laz"));
    write(&old, options(6), 120_000);
    let file = LasFile::open(&old).unwrap();
    for bad_m in [9e9, f64::NAN] {
        let result = rewrite(&file, &new, &grid_of(&file), |first, _, _, coordinates_m| {
            if first == 50_000 {
                coordinates_m[17][1] = bad_m;
            }
            Ok(())
        });
        assert!(matches!(result, Err(LasError::Overflow { point: 50_017, axis: 'y', .. })), "{result:?}");
    }
    let result =
        rewrite(
            &file,
            &new,
            &grid_of(&file),
            |first, _, _, _| {
                if first >= 50_000 { Err("no trajectory here".into()) } else { Ok(()) }
            },
        );
    let text = result.unwrap_err().to_string();
    assert!(text.contains("points from 50000 on: no trajectory here"), "{text}");
    let result = rewrite(&file, &folder.path().join("missing/new.laz"), &grid_of(&file), |_, _, _, _| Ok(()));
    assert!(matches!(result, Err(LasError::Io { .. })));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn real_files_keep_every_attribute() {
    let folder = tempfile::tempdir().unwrap();
    for name in [
        "als-zurich-8strips/zurich.laz",
        "als-toronto-nopsid/TO_core_last_zoom.laz",
        "als-ign-dual-scanner/test_data_77050_627755_LA93_IGN69.laz",
        "uav-1strip-trajectory/H7_LS_F2_H20_200901-120129.laz",
        "nav-real/points.las",
    ] {
        let Some(old) = real(name) else { return };
        let new = folder.path().join(old.file_name().unwrap());
        shift(&old, &new, [0.004, -0.005, 0.006]);
        assert!(compare(&old, &new, [0.004, -0.005, 0.006]) < 0.000_501, "{name}");
    }
}
