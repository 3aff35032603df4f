//! Every damage has its own error with file, place and remedy; nothing panics, nothing claims absurd memory.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

mod las_common;

use std::fs;
use std::path::{Path, PathBuf};

use las_common::{Random, options, write, write_copc};
use tempfile::TempDir;
use tieline_io::las::{Columns, LasError, LasFile, LasWriter, LasWriterOptions, guess_time};

/// A sound file to damage.
struct Sound {
    folder: TempDir,
    bytes: Vec<u8>,
    extension: &'static str,
}

impl Sound {
    fn new(format: u8, extension: &'static str, count: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(format!("sound.{extension}"));
        write(&path, options(format), count);
        Self { bytes: fs::read(path).unwrap(), folder, extension }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join(format!("damaged.{}", self.extension))
    }

    /// The error of opening, else of reading, the file with `bytes`.
    fn error_of(&self, bytes: &[u8]) -> LasError {
        fs::write(self.path(), bytes).unwrap();
        let error = read_all(&self.path()).expect_err("the damage is found");
        let text = error.to_string();
        assert!(text.contains("damaged."), "names the file: {text}");
        error
    }

    /// The error after `value` has been put at byte `at`.
    fn error_with(&self, at: usize, value: &[u8]) -> LasError {
        let mut bytes = self.bytes.clone();
        bytes[at..at + value.len()].copy_from_slice(value);
        self.error_of(&bytes)
    }

    fn points_start(&self) -> usize {
        u32::from_le_bytes(self.bytes[96..100].try_into().unwrap()) as usize
    }

    fn table_start(&self) -> usize {
        let at = self.points_start();
        usize::try_from(u64::from_le_bytes(self.bytes[at..at + 8].try_into().unwrap())).unwrap()
    }
}

fn read_all(path: &Path) -> Result<usize, LasError> {
    let file = LasFile::open(path)?;
    let (mut records, mut columns, mut count) = (Vec::new(), Columns::default(), 0);
    for chunk in 0..file.chunk_count() {
        file.read_chunk(chunk, &mut records)?;
        columns.fill(&records, file.layout());
        count += columns.len();
    }
    guess_time(&file)?;
    Ok(count)
}

#[test]
fn a_header_that_cannot_be_right_is_refused_by_the_field() {
    let sound = Sound::new(6, "las", 100);
    assert!(matches!(sound.error_of(b"PK\x03\x04 a zip file"), LasError::NotLas { .. }));
    assert!(matches!(sound.error_of(b""), LasError::NotLas { .. }));
    assert!(matches!(sound.error_of(&sound.bytes[..300]), LasError::HeaderCut { found: 300, expected: 375, .. }));
    let version = sound.error_with(25, &[5]);
    assert!(matches!(version, LasError::UnsupportedVersion { minor: 5, .. }));
    assert!(version.to_string().contains("convert to 1.4 first"));
    assert!(matches!(sound.error_with(24, &[2]), LasError::UnsupportedVersion { major: 2, .. }));
    assert!(matches!(sound.error_with(104, &[11]), LasError::UnknownPointFormat { format: 11, .. }));
    assert!(matches!(sound.error_with(105, &29_u16.to_le_bytes()), LasError::RecordLength { expected: 30, .. }));
    assert!(matches!(sound.error_with(94, &227_u16.to_le_bytes()), LasError::HeaderField { field: "header size", .. }));
    for offset in [100, u32::MAX] {
        let error = sound.error_with(96, &offset.to_le_bytes());
        assert!(matches!(error, LasError::HeaderField { field: "offset to point data", .. }));
    }
    for scale in [0.0, -0.01, f64::NAN, f64::INFINITY] {
        assert!(matches!(sound.error_with(139, &scale.to_le_bytes()), LasError::Scale { axis: 'y', .. }));
    }
    assert!(matches!(sound.error_with(155, &f64::NAN.to_le_bytes()), LasError::NotFinite { field: "offset", .. }));
    assert!(matches!(sound.error_with(179, &f64::NAN.to_le_bytes()), LasError::NotFinite { field: "max bound", .. }));
    assert!(matches!(sound.error_with(247, &0_u64.to_le_bytes()), LasError::NoPoints { .. }));
    assert!(matches!(sound.error_with(100, &9_u32.to_le_bytes()), LasError::VariableRecord { kind: "VLR", .. }));
    assert!(matches!(sound.error_with(243, &9_u32.to_le_bytes()), LasError::VariableRecord { kind: "EVLR", .. }));
    assert!(matches!(sound.error_with(235, &[0; 8]), LasError::HeaderField { field: "start of first EVLR", .. }));
    assert!(matches!(sound.error_with(235, &[0xff; 8]), LasError::VariableRecord { kind: "EVLR", .. }));
}

#[test]
fn a_file_that_is_not_there_or_is_a_folder_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let missing = LasFile::open(&folder.path().join("strip_012.laz")).unwrap_err();
    assert!(matches!(missing, LasError::Io { .. }) && missing.to_string().contains("strip_012.laz"));
    assert!(matches!(LasFile::open(folder.path()), Err(LasError::Io { .. })));
}

#[test]
fn a_truncated_file_says_how_many_points_it_holds() {
    let sound = Sound::new(1, "las", 100);
    let cut = sound.points_start() + 34 * 60 + 5;
    assert!(matches!(sound.error_of(&sound.bytes[..cut]), LasError::Truncated { expected: 100, found: 60, .. }));
    let promised = sound.error_with(107, &u32::MAX.to_le_bytes());
    assert!(matches!(promised, LasError::Truncated { expected: 4_294_967_295, found: 100, .. }));
    let sound = Sound::new(6, "las", 100);
    assert!(matches!(sound.error_with(247, &[0xff; 8]), LasError::Truncated { expected: u64::MAX, .. }));
}

#[test]
fn a_truncated_laz_is_found_on_opening() {
    let sound = Sound::new(1, "laz", 60_000);
    for length in [sound.table_start() - 1, sound.bytes.len() / 2, sound.points_start() + 9] {
        fs::write(sound.path(), &sound.bytes[..length]).unwrap();
        let error = LasFile::open(&sound.path()).unwrap_err();
        assert!(matches!(error, LasError::TruncatedLaz { .. }), "{error}");
    }
}

#[test]
fn a_corrupt_chunk_table_is_found_on_opening() {
    let sound = Sound::new(1, "laz", 60_000);
    let table = sound.table_start();
    assert!(matches!(sound.error_with(table + 4, &u32::MAX.to_le_bytes()), LasError::ChunkTable { .. }));
    assert!(matches!(sound.error_with(table + 4, &0_u32.to_le_bytes()), LasError::ChunkTable { .. }));
    assert!(matches!(sound.error_with(table + 4, &1_u32.to_le_bytes()), LasError::ChunkTable { .. }));
    assert!(matches!(sound.error_with(table + 8, &[0xff; 8]), LasError::ChunkTable { .. }));
    // more points, or fewer, than the chunks can hold
    assert!(matches!(sound.error_with(107, &160_000_u32.to_le_bytes()), LasError::ChunkTable { .. }));
    assert!(matches!(sound.error_with(107, &40_000_u32.to_le_bytes()), LasError::ChunkTable { .. }));
    let start = sound.points_start();
    assert!(matches!(sound.error_with(start, &[0xff; 8]), LasError::ChunkTable { .. }));
    assert!(matches!(sound.error_with(start, &i64::MAX.to_le_bytes()), LasError::TruncatedLaz { .. }));
}

#[test]
fn a_chunk_table_named_at_the_end_of_the_file_is_found() {
    let sound = Sound::new(1, "laz", 60_000);
    let (start, table) = (sound.points_start(), sound.table_start());
    let mut bytes = sound.bytes.clone();
    bytes[start..start + 8].copy_from_slice(&(-1_i64).to_le_bytes());
    bytes.extend((table as u64).to_le_bytes());
    fs::write(sound.path(), bytes).unwrap();
    assert_eq!(read_all(&sound.path()).unwrap(), 60_000);
}

#[test]
fn a_laszip_record_that_contradicts_the_header_is_refused() {
    let sound = Sound::new(6, "laz", 100);
    let place = sound.bytes.windows(14).position(|window| window == b"laszip encoded").unwrap();
    assert!(matches!(sound.error_with(place, b"L"), LasError::LaszipRecord { .. }));
    let contents = place - 2 + 54;
    for compressor in [0_u16, 7] {
        assert!(matches!(sound.error_with(contents, &compressor.to_le_bytes()), LasError::LaszipRecord { .. }));
    }
    // first item: type, size, version
    for (at, value) in [(34, 6_u16), (36, 31), (38, 9), (32, 0), (32, 60_000)] {
        assert!(matches!(sound.error_with(contents + at, &value.to_le_bytes()), LasError::LaszipRecord { .. }));
    }
    assert!(matches!(sound.error_with(104, &[0x80]), LasError::LaszipRecord { .. }));
}

/// A scan line over rough ground: points as a scanner measures them, not random bytes.
fn scan_line(count: i32) -> Columns {
    let mut random = Random::new(3);
    let mut noise = || i32::try_from(random.below(40)).unwrap();
    Columns {
        x: (0..count).map(|index| 35 * index + noise()).collect(),
        y: (0..count).map(|index| 12 * (index % 900) + noise()).collect(),
        z: (0..count).map(|_| noise()).collect(),
        gps_time: (0..count).map(|index| 306_235_306.0 + f64::from(index) * 3.3e-6).collect(),
        ..Columns::default()
    }
}

#[test]
fn a_corrupt_chunk_is_named_with_its_points() {
    for point_format in [1, 6] {
        let mut sound = Sound::new(point_format, "laz", 1);
        let options = LasWriterOptions { point_format, ..LasWriterOptions::default() };
        let mut writer = LasWriter::create(&sound.path(), options).unwrap();
        writer.write(&scan_line(60_000)).unwrap();
        writer.finish().unwrap();
        sound.bytes = fs::read(sound.path()).unwrap();
        let place = sound.table_start() - (sound.table_start() - sound.points_start()) / 9;
        // The arithmetic coder has no checksum: what shows is that the bytes end before the points do.
        let error = sound.error_with(place, &[0xa5; 16]);
        assert!(
            matches!(error, LasError::CorruptChunk { chunk: 1, first_point: 50_000, last_point: 59_999, .. }),
            "{error}"
        );
    }
    let sound = Sound::new(6, "laz", 60_000);
    let head = sound.points_start() + 8 + 36;
    assert!(matches!(sound.error_with(head, &[0xff; 4]), LasError::CorruptChunk { chunk: 0, .. }));
    assert!(matches!(sound.error_with(head + 4, &[0xff; 4]), LasError::CorruptChunk { chunk: 0, .. }));
}

#[test]
fn a_chunk_that_the_file_does_not_have_is_an_error() {
    let sound = Sound::new(1, "laz", 100);
    fs::write(sound.path(), &sound.bytes).unwrap();
    let file = LasFile::open(&sound.path()).unwrap();
    assert!(matches!(file.read_chunk(1, &mut Vec::new()), Err(LasError::NoSuchChunk { chunk: 1, count: 1, .. })));
    assert_eq!(file.chunk_points(1), 0..0);
}

/// Panics inside the decoder are caught and become errors; their backtraces are kept out of the log.
fn quiet_decoder_panics() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !panic.location().is_some_and(|place| place.file().contains("laz-")) {
            usual(panic);
        }
    }));
}

#[test]
fn mutated_and_truncated_files_never_panic() {
    quiet_decoder_panics();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mutated.laz");
    let mut sources = Vec::new();
    for (format, extension) in [(1, "las"), (3, "laz"), (5, "laz"), (6, "laz"), (10, "laz")] {
        let sound = folder.path().join(format!("sound.{extension}"));
        write(&sound, LasWriterOptions { evlrs: Vec::new(), ..options(format) }, 300);
        sources.push(fs::read(sound).unwrap());
    }
    write_copc(&path, 800);
    sources.push(fs::read(&path).unwrap());
    let (mut random, mut refused, mut read) = (Random::new(99), 0, 0);
    for source in &sources {
        let points_start = u32::from_le_bytes(source[96..100].try_into().unwrap()) as usize;
        for round in 0..500 {
            let mut bytes = source.clone();
            // a third each in the header, in the records and the first points, anywhere
            let end = [375, points_start + 400, bytes.len()][round % 3];
            for _ in 0..=random.below(3) {
                let at = random.below(end);
                bytes[at] = match random.below(4) {
                    0 => 0,
                    1 => 0xff,
                    2 => bytes[at] ^ (1 << random.below(8)),
                    _ => random.next().to_le_bytes()[0],
                };
            }
            fs::write(&path, bytes).unwrap();
            match read_all(&path) {
                Ok(_) => read += 1,
                Err(_) => refused += 1,
            }
        }
        for length in (0..source.len()).step_by(source.len() / 120 + 1) {
            fs::write(&path, &source[..length]).unwrap();
            assert!(read_all(&path).is_err(), "cut at {length}");
        }
    }
    assert!(refused > 300 && read > 300, "{refused} refused, {read} read");
}
