//! A small simulated survey in a folder of its own, the program run on it, and LAS files damaged on purpose.
#![allow(dead_code, clippy::expect_used)] // each test uses a part of it

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;
use tieline_filter::TimeEncoding;
use tieline_io::las::{Columns, LasFile, LasWriter, LasWriterOptions};
use tieline_simulate::scenario::{Area, Flight, LineGroup, OutputOptions, ScannerOptions, WorldOptions};
use tieline_simulate::{Scenario, simulate};

/// Three strips over 120 m × 120 m: two side by side and one across them, 100 000 points.
pub(crate) fn scenario() -> Scenario {
    let group =
        |direction_deg, lines| LineGroup { direction_deg, height_m: 350.0, lines, spacing_m: 60.0, offset_m: 0.0 };
    Scenario {
        name: "small".into(),
        seed: 3,
        crs: "EPSG:32632".into(),
        area: Area { east_m: 120.0, north_m: 120.0 },
        world: WorldOptions { relief_m: 4.0, buildings: 20, trees: 8, moving_objects: 2, ground_roughness_m: 0.005 },
        flight: Flight {
            speed_mps: 50.0,
            lead_m: 10.0,
            groups: vec![group(20.0, 2), group(110.0, 1)],
            ..Flight::default()
        },
        scanners: vec![ScannerOptions {
            field_of_view_deg: 34.0,
            pulse_rate_hz: 24_000.0,
            line_rate_hz: 75.0,
            boresight_error_deg: [0.008, -0.01, 0.02],
            ..ScannerOptions::default()
        }],
        output: OutputOptions { trajectory_rate_hz: 50.0, ..OutputOptions::default() },
        ..Scenario::default()
    }
}

/// A folder with a survey in `survey/`, gone when dropped.
pub(crate) struct Bench {
    folder: TempDir,
}

impl Bench {
    /// The survey of [`scenario`].
    pub(crate) fn new() -> Self {
        let bench = Self { folder: tempfile::tempdir().expect("a folder") };
        simulate(&scenario(), &bench.path("survey")).expect("simulated");
        bench
    }

    pub(crate) fn root(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn strip(&self, number: usize) -> PathBuf {
        self.path(&format!("survey/strips/strip_{number:02}.laz"))
    }

    /// Runs the program in the folder.
    pub(crate) fn tieline(&self, arguments: &[&str]) -> Ran {
        self.tieline_with(arguments, |_| {})
    }

    /// Runs the program in the folder, with the command changed before.
    pub(crate) fn tieline_with(&self, arguments: &[&str], change: impl FnOnce(&mut Command)) -> Ran {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tieline"));
        command.args(arguments).current_dir(self.root()).stdin(Stdio::null()).env("RUST_BACKTRACE", "1");
        change(&mut command);
        Ran::of(&command.output().expect("the program starts"))
    }

    /// Changes the text of the project file.
    pub(crate) fn edit_project(&self, change: impl FnOnce(String) -> String) {
        let path = self.path("survey/project.toml");
        let text = std::fs::read_to_string(&path).expect("a project");
        std::fs::write(&path, change(text)).expect("written");
    }

    /// The files below a folder with their contents, by their path in it.
    pub(crate) fn files(&self, folder: &str) -> BTreeMap<String, Vec<u8>> {
        let mut files = BTreeMap::new();
        collect(&self.path(folder), "", &mut files);
        files
    }

    /// Runs the survey into `out`, which must refuse: one message with these words, and nothing half-written.
    pub(crate) fn refuses_to_run(&self, words: &[&str]) {
        let ran = self.tieline(&["run", "survey/project.toml", "--out", "out"]);
        ran.assert_refused(words);
        let left: Vec<String> = self.files("out").into_keys().collect();
        assert!(left.is_empty(), "left behind: {left:?}");
    }
}

fn collect(folder: &Path, name: &str, files: &mut BTreeMap<String, Vec<u8>>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = format!("{name}{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            collect(&entry.path(), &format!("{name}/"), files);
        } else {
            files.insert(name, std::fs::read(entry.path()).expect("readable"));
        }
    }
}

/// What the program answered.
#[derive(Debug)]
pub(crate) struct Ran {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Ran {
    fn of(output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self { code: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) }
    }

    pub(crate) fn assert_success(&self) -> &Self {
        assert_eq!(self.code, Some(0), "{self:?}");
        self
    }

    /// Exit code 1, and one readable message on standard error that holds the words.
    pub(crate) fn assert_refused(&self, words: &[&str]) {
        assert_eq!(self.code, Some(1), "{self:?}");
        assert_eq!(self.out, "", "nothing on standard output");
        assert!(self.err.starts_with("tieline: "), "notes before the message: {}", self.err);
        assert_eq!(self.err.matches("tieline: ").count(), 1, "one message: {}", self.err);
        for noise in ["panicked", "backtrace", "stack", "Error {", "Some(", "0x"] {
            assert!(!self.err.contains(noise), "\"{noise}\" in: {}", self.err);
        }
        assert!(self.err.len() < 1200, "readable: {}", self.err);
        for word in words {
            assert!(self.err.contains(word), "\"{word}\" is not in: {}", self.err);
        }
    }

    /// Standard output as JSON.
    pub(crate) fn json(&self) -> serde_json::Value {
        self.assert_success();
        serde_json::from_str(&self.out).expect("valid JSON")
    }
}

/// Overwrites bytes of a file.
pub(crate) fn patch(path: &Path, at: usize, bytes: &[u8]) {
    let mut content = std::fs::read(path).expect("readable");
    content[at..at + bytes.len()].copy_from_slice(bytes);
    std::fs::write(path, content).expect("written");
}

/// All points of a file in columns.
pub(crate) fn read_points(path: &Path) -> Columns {
    let file = LasFile::open(path).expect("opens");
    let mut bytes = Vec::new();
    for chunk in 0..file.chunk_count() {
        let mut records = Vec::new();
        file.read_chunk(chunk, &mut records).expect("decodes");
        bytes.extend(records);
    }
    let mut columns = Columns::default();
    columns.fill(&bytes, file.layout());
    columns
}

/// Writes a file again with other points, and options changed.
pub(crate) fn write_points_again(path: &Path, points: &Columns, change: impl FnOnce(&mut LasWriterOptions)) {
    let header = LasFile::open(path).expect("opens").header().clone();
    let mut options = LasWriterOptions {
        scale: header.scale,
        offset: header.offset,
        time: TimeEncoding::AdjustedStandard,
        ..LasWriterOptions::default()
    };
    change(&mut options);
    let mut writer = LasWriter::create(path, options).expect("created");
    writer.write(points).expect("written");
    writer.finish().expect("finished");
}

/// Changes the GPS times of a file.
pub(crate) fn change_times(path: &Path, change: impl Fn(usize, f64) -> f64) {
    let mut points = read_points(path);
    for (index, time_s) in points.gps_time.iter_mut().enumerate() {
        *time_s = change(index, *time_s);
    }
    write_points_again(path, &points, |_| {});
}

/// Coordinates \[m\] of all points of a file.
pub(crate) fn coordinates_m(path: &Path) -> Vec<[f64; 3]> {
    let header = LasFile::open(path).expect("opens").header().clone();
    let points = read_points(path);
    let metre = |value: i32, axis: usize| f64::from(value) * header.scale[axis] + header.offset[axis];
    (0..points.len()).map(|i| [metre(points.x[i], 0), metre(points.y[i], 1), metre(points.z[i], 2)]).collect()
}

/// Largest difference of coordinates \[m\] of two files with the same points.
pub(crate) fn largest_difference_m(a: &Path, b: &Path) -> f64 {
    let (a, b) = (coordinates_m(a), coordinates_m(b));
    assert_eq!(a.len(), b.len());
    a.iter().zip(&b).flat_map(|(p, q)| (0..3).map(move |k| (p[k] - q[k]).abs())).fold(0.0, f64::max)
}

/// Raw records of all points of a file, with their length.
pub(crate) fn raw_records(path: &Path) -> (Vec<u8>, usize) {
    let file = LasFile::open(path).expect("opens");
    let (mut all, mut records) = (Vec::new(), Vec::new());
    for chunk in 0..file.chunk_count() {
        file.read_chunk(chunk, &mut records).expect("decodes");
        all.extend_from_slice(&records);
    }
    (all, file.layout().record_length)
}
