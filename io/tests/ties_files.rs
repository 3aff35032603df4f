//! Ties in Parquet and CSV: there and back, and what is refused.

use std::path::PathBuf;

use proptest::prelude::*;
use tieline_io::ties::{TieFileError, TieRow, TieTable, read_ties, write_csv, write_parquet};

fn table(ties: i64) -> TieTable {
    let mut table = TieTable::default();
    for tie_id in 0..ties {
        for end in 0..2 {
            let x = f64::from(end) + f64::from(i32::try_from(tie_id).expect("few ties")) / 3.0;
            table.push(&TieRow {
                tie_id,
                kind: if tie_id % 5 == 0 { "xyz_point" } else { "surface_line" },
                class: "roof",
                end,
                strip: ["12", "north, \"of\" the river", ""][usize::try_from(tie_id % 3).expect("small")],
                gps_time_s: 306_235_306.125 + x,
                body_x_m: x,
                range_m: 900.0 + x,
                map_e_m: 500_000.0 + x,
                normal_u: 1.0,
                sigma_m: if tie_id % 5 == 0 { f64::NAN } else { 0.01 },
                cov_ee_m2: if tie_id % 5 == 0 { 1e-4 / 3.0 } else { f64::NAN },
                residual_before_m: -x,
                used: tie_id % 2 == 0,
                held_out: tie_id % 7 == 0,
                why_not: if tie_id % 2 == 0 { "" } else { "distance" },
                ..TieRow::default()
            });
        }
    }
    table
}

fn in_folder(name: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    (folder, path)
}

#[test]
fn ties_come_back_from_parquet_as_they_went_over_several_row_groups() {
    let (_folder, path) = in_folder("ties.parquet");
    let ties = table(70_000); // 140 000 rows, three groups
    write_parquet(&path, &ties).expect("written");
    assert_eq!(read_ties(&path).expect("read"), ties);
}

#[test]
fn ties_come_back_from_csv_as_they_went() {
    let (_folder, path) = in_folder("ties.csv");
    let ties = table(500);
    write_csv(&path, &ties).expect("written");
    assert_eq!(read_ties(&path).expect("read"), ties);
}

#[test]
fn no_ties_at_all_are_a_file_too() {
    for name in ["ties.parquet", "ties.csv"] {
        let (_folder, path) = in_folder(name);
        match name {
            "ties.csv" => write_csv(&path, &TieTable::default()),
            _ => write_parquet(&path, &TieTable::default()),
        }
        .expect("written");
        assert!(read_ties(&path).expect("read").is_empty());
    }
}

#[test]
fn the_same_table_gives_the_same_bytes() {
    let (_folder, path) = in_folder("ties.parquet");
    write_parquet(&path, &table(300)).expect("written");
    let first = std::fs::read(&path).expect("read");
    write_parquet(&path, &table(300)).expect("written");
    assert_eq!(std::fs::read(&path).expect("read"), first);
}

#[test]
fn mistakes_in_a_csv_are_named_with_line_and_column() {
    let (_folder, path) = in_folder("ties.csv");
    write_csv(&path, &table(2)).expect("written");
    let good = std::fs::read_to_string(&path).expect("read");
    for (bad, words) in [
        (good.replacen("roof,0,", "roof,zero,", 1), &["line 2", "end", "zero"][..]),
        (good.replacen(",true,", ",perhaps,", 1), &["line 2", "used", "perhaps"]),
        (good.replacen("residual_before_m", "residual", 1), &["residual_before_m", "no column"]),
        (good.trim_end().trim_end_matches("distance").trim_end_matches(',').to_string(), &["line 5", "fields"]),
        (String::new(), &["tie_id"]),
    ] {
        std::fs::write(&path, &bad).expect("written");
        let error = read_ties(&path).expect_err(&bad).to_string();
        for word in words {
            assert!(error.contains(word), "\"{word}\" is not in: {error}");
        }
    }
}

#[test]
fn a_cut_parquet_is_refused_and_a_missing_file_is_named() {
    let (_folder, path) = in_folder("ties.parquet");
    assert!(matches!(read_ties(&path), Err(TieFileError::Io { .. })));
    write_parquet(&path, &table(100)).expect("written");
    let good = std::fs::read(&path).expect("read");
    for length in [4, 5, good.len() / 2, good.len() - 1] {
        std::fs::write(&path, &good[..length]).expect("written");
        assert!(matches!(read_ties(&path), Err(TieFileError::Parquet { .. })), "{length} bytes");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_damaged_file_never_panics(
        is_csv in any::<bool>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let (_folder, path) = in_folder("ties");
        match is_csv {
            true => write_csv(&path, &table(5)),
            false => write_parquet(&path, &table(5)),
        }
        .expect("written");
        let mut bytes = std::fs::read(&path).expect("read");
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        std::fs::write(&path, &bytes).expect("written");
        let _ = read_ties(&path);
    }
}
