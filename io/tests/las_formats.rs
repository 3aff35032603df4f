//! Every version, point format and compression is written and read back, bit for bit.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

mod las_common;

use las_common::{attributes, options, read, real, records, write, write_copc};
use rayon::prelude::*;
use tieline_filter::TimeEncoding;
use tieline_io::las::{Columns, LasError, LasFile, LasWriter, LasWriterOptions, guess_time};

#[test]
fn every_format_comes_back_bit_for_bit_compressed_and_not() {
    let folder = tempfile::tempdir().unwrap();
    for format in 0..=10 {
        for extension in ["las", "laz"] {
            let path = folder.path().join(format!("{format}.{extension}"));
            let count = if format == 1 || format == 7 { 120_001 } else { 3_001 };
            let written = write(&path, options(format), count);
            let file = LasFile::open(&path).unwrap();
            assert_eq!(file.header().is_compressed, extension == "laz");
            assert_eq!(file.header().extra_bytes_per_point, 6);
            assert_eq!(file.chunk_count(), count.div_ceil(50_000));
            assert!(read(&file) == written, "format {format} as {extension}");
        }
    }
}

#[test]
fn columns_read_selectively_are_those_of_the_whole_records() {
    let folder = tempfile::tempdir().unwrap();
    for format in 0..=10 {
        let path = folder.path().join(format!("{format}.laz"));
        let written = write(&path, options(format), 2_000);
        let file = LasFile::open(&path).unwrap();
        let (mut working, mut columns, mut expected) = (Vec::new(), Columns::default(), Columns::default());
        file.read_columns(0, &mut working, &mut columns).unwrap();
        expected.fill(&written, file.layout());
        // random bits make no NaN here: the times are set, the angles come from integers
        assert_eq!(columns, expected, "format {format}");
    }
}

#[test]
fn the_header_says_what_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("strip.laz");
    let written = write(&path, options(6), 60_000);
    let file = LasFile::open(&path).unwrap();
    let header = file.header();
    assert_eq!((header.version, header.point_format, header.record_length), ((1, 4), 6, 36));
    assert_eq!((header.creation_day, header.creation_year, header.file_source_id), (152, 2021, 7));
    assert_eq!((header.system_identifier.as_str(), header.generating_software.as_str()), ("test scanner", "a test"));
    assert_eq!((header.epsg, header.is_copc, header.global_encoding), (Some(25_832), false, 0b1_0001));
    assert_eq!(file.record("tieline test", 1).unwrap(), b"before the points");
    assert_eq!(file.record("tieline test", 2).unwrap(), vec![9; 70_000]);
    assert!(file.record("tieline test", 3).unwrap().is_empty());
    let x = written.chunks_exact(36).map(|record| i32::from_le_bytes(record[..4].try_into().unwrap()));
    let greatest = f64::from(x.max().unwrap()) * 0.01 + 500_000.0;
    assert!((header.max[0] - greatest).abs() < 1e-9);
    let second = written.chunks_exact(36).filter(|record| record[14] & 15 == 2).count();
    assert_eq!(header.points_by_return[1], second as u64);
}

#[test]
fn columns_written_in_blocks_of_any_size_make_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = Vec::new();
    for (name, block) in [("a.laz", 1_000_000), ("b.laz", 33_333)] {
        let path = folder.path().join(name);
        let mut writer = LasWriter::create(&path, LasWriterOptions::default()).unwrap();
        let all = records(writer.layout(), 900_000);
        for part in all.chunks(block * writer.layout().record_length) {
            let mut columns = Columns::default();
            columns.fill(part, writer.layout());
            writer.write(&columns).unwrap();
        }
        writer.finish().unwrap();
        files.push(std::fs::read(&path).unwrap());
    }
    assert!(files[0] == files[1]);
}

#[test]
fn columns_of_different_lengths_are_refused_and_an_unfinished_file_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("strip.laz");
    let mut writer = LasWriter::create(&path, LasWriterOptions::default()).unwrap();
    let columns = Columns { x: vec![1, 2], y: vec![1, 2], z: vec![1], ..Columns::default() };
    assert!(matches!(writer.write(&columns), Err(LasError::Unwritable { what: "z", .. })));
    drop(writer);
    let empty = LasWriter::create(&path, LasWriterOptions::default()).unwrap().finish();
    assert!(matches!(empty, Err(LasError::Unwritable { .. })));
    let old = LasWriterOptions { version: (1, 2), ..LasWriterOptions::default() };
    assert!(matches!(LasWriter::create(&path, old), Err(LasError::Unwritable { what: "version", .. })));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn any_number_of_threads_may_read_one_file() {
    fn shared_by_threads<T: Send + Sync>() {}
    shared_by_threads::<LasFile>();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("strip.laz");
    let written = write(&path, options(8), 170_000);
    let file = LasFile::open(&path).unwrap();
    let read_one = |chunk| {
        let mut records = Vec::new();
        file.read_chunk(chunk, &mut records).map(|()| records)
    };
    let chunks: Result<Vec<_>, _> = (0..file.chunk_count()).into_par_iter().map(read_one).collect();
    assert!(chunks.unwrap().concat() == written);
}

#[test]
fn chunks_of_different_sizes_are_read_as_the_chunk_table_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("strip.copc.laz");
    let written = write_copc(&path, 10_000);
    let file = LasFile::open(&path).unwrap();
    assert!(file.header().is_copc);
    assert_eq!((file.chunk_points(0), file.chunk_points(1)), (0..1, 1..701));
    assert!(read(&file) == written);
}

#[test]
fn real_files_of_six_writers_are_read_whole() {
    for (name, points, encoding, is_contradicted) in [
        ("als-zurich-8strips/zurich.laz", 656_837, TimeEncoding::AdjustedStandard, false),
        ("als-bcts-3strips/bcts_1.laz", 531_662, TimeEncoding::SecondsOfWeek, false),
        ("als-alps-9strips/bat.laz", 137_379, TimeEncoding::AdjustedStandard, false),
        // LASzip before 2.0: one stream without a chunk table
        ("als-toronto-nopsid/TO_core_last_zoom.laz", 213_093, TimeEncoding::SecondsOfWeek, false),
        // its global-encoding bit is wrong
        ("als-ign-dual-scanner/test_data_77050_627755_LA93_IGN69.laz", 73_355, TimeEncoding::AdjustedStandard, true),
        ("uav-1strip-trajectory/H7_LS_F2_H20_200901-120129.laz", 14_912, TimeEncoding::SecondsOfWeek, false),
        ("nav-real/points.las", 1_325, TimeEncoding::SecondsOfWeek, false),
    ] {
        let Some(path) = real(name) else { return };
        let file = LasFile::open(&path).unwrap();
        let all = read(&file);
        assert_eq!(all.len() as u64, points * file.layout().record_length as u64, "{name}");
        assert!(!attributes(&all, file.layout()).is_empty());
        let guess = guess_time(&file).unwrap();
        assert_eq!((guess.encoding, guess.note.is_some()), (Some(encoding), is_contradicted), "{name}");
        let header = file.header();
        let mut columns = Columns::default();
        columns.fill(&all, file.layout());
        // not z: the header of zurich.laz is 41 m off there
        for (axis, column) in [&columns.x, &columns.y].into_iter().enumerate() {
            let least = f64::from(*column.iter().min().unwrap()) * header.scale[axis] + header.offset[axis];
            assert!((least - header.min[axis]).abs() < 0.51 * header.scale[axis], "{name}: {least}");
        }
    }
}
