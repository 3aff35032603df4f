//! Small synthetic files and real ones, shared by the LAS tests.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, missing_docs)] // not every test uses every helper

use std::fs;
use std::path::{Path, PathBuf};

use tieline_io::las::{ExtraBytes, LasFile, LasWriter, LasWriterOptions, RecordLayout, VariableRecord};

/// Seed of every random number here.
const SEED: u64 = 0x05EE_D1A5;

/// `SplitMix64`: small, good, and the same everywhere.
#[derive(Debug)]
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(stream: u64) -> Self {
        Self(SEED ^ stream.wrapping_mul(0x9E37_79B9_7F4A_7C15))
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub(crate) fn below(&mut self, end: usize) -> usize {
        usize::try_from(self.next() % end as u64).unwrap()
    }
}

/// Options with every optional part of a file that the version and format allow.
pub(crate) fn options(point_format: u8) -> LasWriterOptions {
    let minor = match point_format {
        0..=3 => 2,
        4 | 5 => 3,
        _ => 4,
    };
    let record = |user: &str, id, contents: &[u8]| VariableRecord {
        user_id: user.to_owned(),
        record_id: id,
        description: "of a test".to_owned(),
        contents: contents.to_vec(),
    };
    LasWriterOptions {
        version: (1, minor),
        point_format,
        scale: [0.01, 0.01, 0.001],
        offset: [500_000.0, 5_200_000.0, 0.0],
        wkt: Some(r#"PROJCS["x",AUTHORITY["EPSG","25832"]]"#.to_owned()),
        system_identifier: "test scanner".to_owned(),
        generating_software: "a test".to_owned(),
        file_source_id: 7,
        creation: (152, 2021),
        extra_bytes: vec![
            ExtraBytes { name: "range".to_owned(), description: "in metres".to_owned(), data_type: 9 },
            ExtraBytes { name: "width".to_owned(), description: String::new(), data_type: 3 },
        ],
        vlrs: vec![record("tieline test", 1, b"before the points")],
        evlrs: if minor == 4 {
            vec![record("tieline test", 2, &[9; 70_000]), record("LASF_Spec", 65_535, b"waveform packets")]
        } else {
            Vec::new()
        },
        ..LasWriterOptions::default()
    }
}

/// Records whose coordinates lie in a block of 400 m and whose other bytes are random, every bit of them.
pub(crate) fn records(layout: RecordLayout, count: usize) -> Vec<u8> {
    let mut random = Random::new(u64::from(layout.point_format));
    let mut records = vec![0; layout.record_length * count];
    for record in records.chunks_exact_mut(layout.record_length) {
        for byte in record.iter_mut() {
            *byte = random.next().to_le_bytes()[0];
        }
        for at in [0, 4, 8] {
            let value = i32::try_from(random.below(40_000)).unwrap() - 20_000;
            record[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        if let Some(at) = layout.gps_time {
            let time_s = 306_235_306.0 + random.below(1_000_000) as f64 * 1e-6;
            record[at..at + 8].copy_from_slice(&time_s.to_le_bytes());
        }
    }
    records
}

/// Writes a file of such records, in blocks of odd sizes, and returns them.
pub(crate) fn write(path: &Path, options: LasWriterOptions, count: usize) -> Vec<u8> {
    let mut writer = LasWriter::create(path, options).unwrap();
    let records = records(writer.layout(), count);
    for block in records.chunks(writer.layout().record_length * 7_919) {
        writer.write_records(block).unwrap();
    }
    let header = writer.finish().unwrap();
    assert_eq!(header.point_count, count as u64);
    records
}

/// All records of a file.
pub(crate) fn read(file: &LasFile) -> Vec<u8> {
    let (mut all, mut records) = (Vec::new(), Vec::new());
    for chunk in 0..file.chunk_count() {
        file.read_chunk(chunk, &mut records).unwrap();
        let points = file.chunk_points(chunk);
        assert_eq!(records.len() as u64, (points.end - points.start) * file.layout().record_length as u64);
        all.extend(&records);
    }
    all
}

/// The records without their coordinates.
pub(crate) fn attributes(records: &[u8], layout: RecordLayout) -> Vec<u8> {
    records.chunks_exact(layout.record_length).flat_map(|record| record[12..].to_vec()).collect()
}

/// A file of a real data set; `None`, and so a skipped test, where the data are not there (never in CI).
pub(crate) fn real(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(name);
    assert!(path.exists() || std::env::var_os("CI").is_none(), "{} is missing", path.display());
    path.exists().then_some(path)
}

/// A COPC file in all but its octree: chunks of different sizes, its two records in their places.
pub(crate) fn write_copc(path: &Path, count: usize) -> Vec<u8> {
    let uncompressed = path.with_extension("las");
    let laszip = laz::LazVlrBuilder::default().with_point_format(7, 6).unwrap().with_variable_chunk_size().build();
    let mut laszip_contents = Vec::new();
    laszip.write_to(&mut laszip_contents).unwrap();
    let mut options = options(7);
    let record = |user: &str, id, contents: Vec<u8>| VariableRecord {
        user_id: user.to_owned(),
        record_id: id,
        description: String::new(),
        contents,
    };
    options.wkt = None;
    let extra_description = vec![0; 192];
    let extra_bytes = std::mem::take(&mut options.extra_bytes);
    options.vlrs = vec![
        record("copc", 1, vec![1; 160]),
        record("laszip encoded", 22_204, laszip_contents),
        record("LASF_Spec", 4, extra_description),
    ];
    options.evlrs.insert(0, record("copc", 1_000, vec![2; 32]));
    // The layout needs the extra bytes, the record that describes them has been put in its place by hand.
    let standard = RecordLayout::standard_length(7).unwrap();
    let size: u16 = extra_bytes.iter().map(|extra| if extra.data_type == 9 { 4 } else { 2 }).sum();
    let layout = RecordLayout::new(7, standard + size).unwrap();
    let records = records(layout, count);
    write(&uncompressed, options, 1);
    let bytes = fs::read(&uncompressed).unwrap();
    let head_length = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    let evlr_start = usize::try_from(u64::from_le_bytes(bytes[235..243].try_into().unwrap())).unwrap();

    let mut file = std::io::Cursor::new(bytes[..head_length].to_vec());
    file.set_position(head_length as u64);
    let mut compressor = laz::ParLasZipCompressor::new(&mut file, laszip).unwrap();
    let sizes = [1, 700, 33, 1, 2_000];
    let mut chunks = Vec::new();
    let mut rest = records.as_slice();
    for size in sizes.iter().cycle() {
        let (chunk, left) = rest.split_at(rest.len().min(size * layout.record_length));
        chunks.push(chunk);
        rest = left;
        if rest.is_empty() {
            break;
        }
    }
    compressor.compress_chunks(chunks).unwrap();
    compressor.done().unwrap();
    let mut out = file.into_inner();
    let new_evlr_start = out.len() as u64;
    out.extend(&bytes[evlr_start..]);
    out[104] |= 0x80;
    out[105..107].copy_from_slice(&(standard + size).to_le_bytes());
    out[235..243].copy_from_slice(&new_evlr_start.to_le_bytes());
    out[247..255].copy_from_slice(&(count as u64).to_le_bytes());
    fs::write(path, out).unwrap();
    fs::remove_file(uncompressed).unwrap();
    records
}
