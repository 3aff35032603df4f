//! Inertial measurements.
//!
//! | format | content |
//! |---|---|
//! | KF-GINS text | seven columns: time \[s\], increments of angle x, y, z \[rad\], increments of velocity x, y, z \[m/s\] |
//! | text | any columns by their names: a header in the file or a pattern of the project file |
//! | binary | the seven numbers of KF-GINS as little-endian f64 |
//!
//! Columns of text: `time_s` (seconds of week, or adjusted standard time), `adjusted_s`, `gps_s` (since 1980),
//! `gps_week`; increments `dtheta_x_rad` or `_deg`, `dvel_x_mps`; rates `gyro_x_radps`, `_degps` or `_degph`,
//! `accel_x_mps2` or `_g` (9.80665 m/s²); `-` for a column to be left out. A file holds increments or rates, not both.
//! Increments are those of the interval that ends at their time; rates are taken as its mean.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use nalgebra::Vector3;
use tieline_filter::{Imu, TimeEncoding};

use super::column::{Dimension, Quantity, Spec, TIME, WEEK};
use super::error::MeasurementFileError;
use super::table::{Source, Table};
use crate::delimited::{may_be_text, peeked, unpacked};

mod axes;
mod binary;
mod samples;

pub use axes::{Axes, AxesError};
pub use binary::RECORD_BYTES;
use samples::Samples;

/// The formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImuFormat {
    /// Delimited text with named columns.
    Text,
    /// Seven bare columns.
    KfGins,
    /// Seven little-endian f64 a record.
    Binary,
}

/// What the numbers are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImuKind {
    /// Increments of angle and velocity.
    Increments,
    /// Angular rate and specific force.
    Rates,
}

impl ImuKind {
    fn name(self) -> &'static str {
        match self {
            Self::Increments => "increments",
            Self::Rates => "rates",
        }
    }
}

/// How to read inertial measurements.
#[derive(Debug, Clone, Default)]
pub struct ImuReadOptions {
    /// The format; recognised by the first bytes when left out.
    pub format: Option<ImuFormat>,
    /// Column names of a text file (see [`self`]); taken from its header when left out.
    pub columns: Option<Vec<String>>,
    /// What the numbers are; when left out, the names of the columns say it, and bare columns are increments.
    pub kind: Option<ImuKind>,
    /// Where the axes of the sensor point.
    pub axes: Axes,
}

/// Inertial measurements with what their file says about them.
#[derive(Debug, Clone)]
pub struct ImuFile {
    /// The samples, body axes. Times are **the file's own**: add [`tieline_filter::SurveyClock::shift_s`] of
    /// `time_encoding`.
    pub imu: Imu,
    /// Format found.
    pub format: ImuFormat,
    /// What the numbers of the file are.
    pub kind: ImuKind,
    /// How the times are to be read, judged by their size unless the name of the column says it.
    pub time_encoding: TimeEncoding,
    /// GPS week of time 0, where the file has a week column.
    pub week: Option<u32>,
    /// What a user should be told: samples dropped or sorted, gaps, a slow IMU.
    pub notes: Vec<String>,
}

impl ImuFile {
    /// Whether the samples are too far apart for mechanisation: slower than 10 Hz.
    #[must_use]
    pub fn is_slow(&self) -> bool {
        self.imu.interval_s() > SLOWEST_INTERVAL_S
    }
}

/// Longest usual interval for mechanisation \[s\]: 10 Hz, and a little for the rounding of times.
const SLOWEST_INTERVAL_S: f64 = 0.101;

const ANGLE: usize = 2;
const RATE: usize = 5;
const VELOCITY: usize = 8;
const FORCE: usize = 11;

/// Numbers in a row.
const COLUMNS: usize = FORCE + 3;
const SPEC: Spec<COLUMNS> = Spec {
    quantities: &[
        Quantity::new(&["dtheta_x"], Dimension::Angle, ANGLE),
        Quantity::new(&["dtheta_y"], Dimension::Angle, ANGLE + 1),
        Quantity::new(&["dtheta_z"], Dimension::Angle, ANGLE + 2),
        Quantity::new(&["gyro_x"], Dimension::AngularRate, RATE),
        Quantity::new(&["gyro_y"], Dimension::AngularRate, RATE + 1),
        Quantity::new(&["gyro_z"], Dimension::AngularRate, RATE + 2),
        Quantity::new(&["dvel_x"], Dimension::Speed, VELOCITY),
        Quantity::new(&["dvel_y"], Dimension::Speed, VELOCITY + 1),
        Quantity::new(&["dvel_z"], Dimension::Speed, VELOCITY + 2),
        Quantity::new(&["accel_x", "acc_x"], Dimension::Acceleration, FORCE),
        Quantity::new(&["accel_y", "acc_y"], Dimension::Acceleration, FORCE + 1),
        Quantity::new(&["accel_z", "acc_z"], Dimension::Acceleration, FORCE + 2),
    ],
    known: "time_s, adjusted_s, gps_s, gps_week, dtheta_x_rad|deg, dvel_x_mps, gyro_x_radps|degps|degph, \
            accel_x_mps2|g, the same for y and z",
    example: r#"["time_s", "gyro_x_radps", "gyro_y_radps", "gyro_z_radps", "accel_x_mps2", "accel_y_mps2", "accel_z_mps2"]"#,
    blanks: false,
};

const INCREMENTS: &[&str] =
    &["time_s", "dtheta_x_rad", "dtheta_y_rad", "dtheta_z_rad", "dvel_x_mps", "dvel_y_mps", "dvel_z_mps"];
const RATES: &[&str] =
    &["time_s", "gyro_x_radps", "gyro_y_radps", "gyro_z_radps", "accel_x_mps2", "accel_y_mps2", "accel_z_mps2"];

/// Reads inertial measurements of any format, plain or gzipped.
///
/// # Errors
/// [`MeasurementFileError`] names file, line or record, column, value and remedy.
pub fn read_imu(path: &Path, options: &ImuReadOptions) -> Result<ImuFile, MeasurementFileError> {
    let file = File::open(path).map_err(MeasurementFileError::io(path))?;
    read_from(BufReader::with_capacity(1 << 18, file), path, options)
}

/// Reads inertial measurements from any source; `path` is for messages only.
///
/// # Errors
/// As [`read_imu`].
pub fn read_from(source: impl BufRead, path: &Path, options: &ImuReadOptions) -> Result<ImuFile, MeasurementFileError> {
    let source = unpacked(source).map_err(MeasurementFileError::io(path))?;
    let (head, source) = peeked(source, 4096).map_err(MeasurementFileError::io(path))?;
    if head.is_empty() {
        return Err(MeasurementFileError::Empty { path: path.to_path_buf() });
    } else if head.starts_with(b"LASF") {
        let (path, found, remedy) = (path.to_path_buf(), "a LAS or LAZ point cloud", "name it among the strips");
        return Err(MeasurementFileError::UnknownFormat { path, found, remedy });
    }
    match options.format {
        Some(ImuFormat::Binary) => binary::read(source, path, options),
        None if options.columns.is_none() && !may_be_text(&head) => binary::read(source, path, options),
        _ => read_text(source, path, options),
    }
}

fn read_text(
    source: Box<dyn BufRead + '_>,
    path: &Path,
    options: &ImuReadOptions,
) -> Result<ImuFile, MeasurementFileError> {
    let bare = match options.kind {
        Some(ImuKind::Rates) => RATES,
        _ => INCREMENTS,
    };
    let bare_names: Vec<String> = bare.iter().map(ToString::to_string).collect();
    let (names, defaults): (_, &[&[&str]]) = match (&options.columns, options.format) {
        (Some(names), _) => (Some(names.as_slice()), &[]),
        (None, Some(ImuFormat::KfGins)) => (Some(bare_names.as_slice()), &[]),
        (None, Some(_)) => (None, &[]),
        (None, None) => (None, &[bare]),
    };
    let mut table = Table::open(source, path, &SPEC, names, defaults)?;
    let kind = kind_of(&table, path, options.kind)?;
    let format = match table.source {
        Source::Count => ImuFormat::KfGins,
        Source::Pattern if options.columns.is_none() => ImuFormat::KfGins,
        Source::Pattern | Source::Header => ImuFormat::Text,
    };
    let mut samples = Samples::new(path, kind, &options.axes, table.is_adjusted());
    let (angle, velocity) = match kind {
        ImuKind::Increments => (ANGLE, VELOCITY),
        ImuKind::Rates => (RATE, FORCE),
    };
    while let Some((place, row)) = table.next()? {
        let vector = |slot: usize| Vector3::new(row[slot], row[slot + 1], row[slot + 2]);
        samples.push(place, [row[TIME], row[WEEK]], &vector(angle), &vector(velocity))?;
    }
    samples.finish(format, table.notes)
}

/// Increments or rates: what the columns hold, which must be what was asked for.
fn kind_of(table: &Table<'_, COLUMNS>, path: &Path, asked: Option<ImuKind>) -> Result<ImuKind, MeasurementFileError> {
    let increments = table.has_any((ANGLE..RATE).chain(VELOCITY..FORCE));
    let rates = table.has_any((RATE..VELOCITY).chain(FORCE..FORCE + 3));
    let missing = |missing| table.missing(missing, &SPEC);
    if !table.has([TIME]) {
        return Err(missing("a time (time_s)"));
    }
    let kind = match (increments, rates) {
        (true, true) => {
            let (path, found) = (path.to_path_buf(), table.names());
            return Err(MeasurementFileError::MixedKinds { path, found });
        }
        (true, false) if !table.has(ANGLE..RATE) => return Err(missing("dtheta_x_rad, dtheta_y_rad, dtheta_z_rad")),
        (true, false) if !table.has(VELOCITY..FORCE) => return Err(missing("dvel_x_mps, dvel_y_mps, dvel_z_mps")),
        (true, false) => ImuKind::Increments,
        (false, _) if !table.has(RATE..VELOCITY) => return Err(missing("gyro_x_radps, gyro_y_radps, gyro_z_radps")),
        (false, _) if !table.has(FORCE..FORCE + 3) => return Err(missing("accel_x_mps2, accel_y_mps2, accel_z_mps2")),
        (false, _) => ImuKind::Rates,
    };
    match asked {
        Some(asked) if asked != kind => {
            let (path, found, asked) = (path.to_path_buf(), kind.name(), asked.name());
            Err(MeasurementFileError::KindContradicted { path, found, asked })
        }
        _ => Ok(kind),
    }
}
