//! Odometer: speed over time, as text.
//!
//! Two columns, `time_s` and `speed_mps`, or any that a header or a pattern names: times as in every reader (`time_s`,
//! `gps_week`, `adjusted_s`, `gps_s`), `speed_mps` or `speed_kmph`, `-` for a column to be left out. The speed is
//! forward; it may be negative.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use tieline_filter::{OdometerSample, TimeEncoding};

use super::column::{Dimension, Quantity, Spec, TIME, WEEK};
use super::error::MeasurementFileError;
use super::table::Table;
use super::timeline::Timeline;
use crate::delimited::unpacked;

/// Readings of an odometer with what their file says about them.
#[derive(Debug, Clone)]
pub struct OdometerFile {
    /// In order of time. Times are **the file's own**, as in [`super::ImuFile`].
    pub samples: Vec<OdometerSample>,
    /// How the times are to be read.
    pub time_encoding: TimeEncoding,
    /// GPS week of time 0, where the file has a week column.
    pub week: Option<u32>,
    /// What a user should be told.
    pub notes: Vec<String>,
}

const SPEED: usize = 2;
const SPEC: Spec<3> = Spec {
    quantities: &[Quantity::new(&["speed", "velocity", "v", "odo", "odometer"], Dimension::Speed, SPEED)],
    known: "time_s, adjusted_s, gps_s, gps_week, speed_mps, speed_kmph",
    example: r#"["time_s", "speed_mps"]"#,
    blanks: false,
};
/// Fastest speed that makes sense \[m/s\].
const FASTEST_MPS: f64 = 1e3;

/// Reads an odometer file; `columns` from the project file, or `None` to go by the header, or by two bare columns.
///
/// # Errors
/// [`MeasurementFileError`] names file, line, column and remedy.
pub fn read_odometer(path: &Path, columns: Option<&[String]>) -> Result<OdometerFile, MeasurementFileError> {
    let file = File::open(path).map_err(MeasurementFileError::io(path))?;
    read_from(BufReader::with_capacity(1 << 16, file), path, columns)
}

/// Reads an odometer file from any source; `path` is for messages only.
///
/// # Errors
/// As [`read_odometer`].
pub fn read_from(
    source: impl BufRead,
    path: &Path,
    columns: Option<&[String]>,
) -> Result<OdometerFile, MeasurementFileError> {
    let source = unpacked(source).map_err(MeasurementFileError::io(path))?;
    let mut table = Table::open(source, path, &SPEC, columns, &[&["time_s", "speed_mps"]])?;
    if !table.has([TIME]) {
        return Err(table.missing("a time (time_s)", &SPEC));
    }
    if !table.has([SPEED]) {
        return Err(table.missing("a speed (speed_mps)", &SPEC));
    }
    let mut timeline = Timeline::new(path, f64::INFINITY, table.is_adjusted());
    let mut samples = Vec::new();
    while let Some((place, row)) = table.next()? {
        let speed_mps = row[SPEED];
        if speed_mps.abs() > FASTEST_MPS {
            let (path, column, expected) = (path.to_path_buf(), "speed", "at most 1000 m/s");
            return Err(MeasurementFileError::Absurd { path, place, column, value: speed_mps, expected });
        }
        samples.push(OdometerSample { time_s: timeline.place(place, row[TIME], row[WEEK])?, speed_mps });
    }
    let settled = timeline.settle(&mut samples, true);
    let notes = table.notes.into_iter().chain(settled.notes).collect();
    Ok(OdometerFile { samples, time_encoding: settled.time_encoding, week: settled.week, notes })
}
