//! What can be wrong with a file of measurements, and the way out.

use std::io;
use std::path::{Path, PathBuf};

use tieline_filter::ImuError;

use crate::delimited::LineError;
use crate::trajectory::Place;

/// Why a file of measurements cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MeasurementFileError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// The compressed file ends early or does not unpack.
    #[error("{}: cannot be unpacked beyond {place} ({source}); the file is damaged, copy it again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The first line or record that could not be had.
        place: Place,
        /// What the decompressor said.
        source: io::Error,
    },
    /// Nothing in the file.
    #[error("{}: the file holds no measurements; export it again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Every epoch had to be dropped.
    #[error("{}: none of the {dropped} epochs has a position; export the file again", path.display())]
    NoPosition {
        /// The file.
        path: PathBuf,
        /// Epochs dropped.
        dropped: u64,
    },
    /// None of the formats.
    #[error("{}: not a file that can be used here ({found}); {remedy}", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What it looks like.
        found: &'static str,
        /// The way out.
        remedy: &'static str,
    },
    /// The file ends inside a record.
    #[error(
        "{}: record {record} is cut short: {found} bytes where {expected} were due; the file is truncated or of another format",
        path.display()
    )]
    TruncatedRecord {
        /// The file.
        path: PathBuf,
        /// 0-based record.
        record: u64,
        /// Bytes found.
        found: usize,
        /// Bytes due.
        expected: usize,
    },
    /// The numbers make sense only when their bytes are swapped.
    #[error("{}: the numbers are big-endian; convert the file to little-endian", path.display())]
    ByteOrder {
        /// The file.
        path: PathBuf,
    },
    /// Nothing but zeros.
    #[error("{}: every angle and velocity is zero; an IMU at rest shows gravity: check columns and export", path.display())]
    AllZero {
        /// The file.
        path: PathBuf,
    },
    /// A number outside of what can be.
    #[error("{}: {column} is {value:?} at {place}, {expected} was due; check format, columns and units", path.display())]
    Absurd {
        /// The file.
        path: PathBuf,
        /// Where.
        place: Place,
        /// Which column.
        column: &'static str,
        /// The number found.
        value: f64,
        /// The range that makes sense.
        expected: &'static str,
    },
    /// A number that is none.
    #[error("{}: {column} at {place} is not a finite number; remove the epoch or export again", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Where.
        place: Place,
        /// Which column.
        column: String,
    },
    /// Time runs backwards by more than a sample that came late, and by less than a week's end.
    #[error("{}: time runs backwards at {place}: {time_s:?} s after {previous_s:?} s; sort the file by time", path.display())]
    TimeBackwards {
        /// The file.
        path: PathBuf,
        /// Where.
        place: Place,
        /// Its time \[s\].
        time_s: f64,
        /// The latest time before it \[s\].
        previous_s: f64,
    },
    /// A time that is neither seconds of week nor adjusted standard time.
    #[error(
        "{}: time {time_s:?} s at {place} is neither seconds of week nor GPS seconds minus 1e9; for GPS seconds since \
         1980 name the column gps_s, Unix time must be converted",
        path.display()
    )]
    TimeUnknown {
        /// The file.
        path: PathBuf,
        /// Where.
        place: Place,
        /// The time \[s\].
        time_s: f64,
    },
    /// A date that the calendar does not have.
    #[error("{}: line {line}: \"{text}\" is no date and time, yyyy/mm/dd hh:mm:ss or week and seconds were due", path.display())]
    NoDate {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// What stands there.
        text: String,
    },
    /// A field that is no number.
    #[error("{}: line {line}, column {column} ({name}): \"{text}\" is not a number; mend or remove the line", path.display())]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// 1-based column.
        column: usize,
        /// Name of the column.
        name: String,
        /// What stands there.
        text: String,
    },
    /// Too few fields in a line.
    #[error(
        "{}: line {line} has {found} fields where {expected} were due; a cut line, or the wrong column pattern",
        path.display()
    )]
    FieldCount {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// Fields found.
        found: usize,
        /// Fields due.
        expected: usize,
    },
    /// A line without end.
    #[error("{}: line {line} is longer than {limit} bytes: this is not a text file of measurements", path.display())]
    LineTooLong {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// Longest line taken.
        limit: usize,
    },
    /// A column name that means nothing.
    #[error("{}: column \"{name}\" is unknown; known are {known}, and \"-\" for a column to be left out", path.display())]
    UnknownColumn {
        /// The file.
        path: PathBuf,
        /// The name.
        name: String,
        /// What there is to choose from.
        known: &'static str,
    },
    /// A column name without a unit, or with one that does not fit.
    #[error("{}: column \"{name}\" has no unit; say columns = {example}", path.display())]
    NoUnit {
        /// The file.
        path: PathBuf,
        /// The name.
        name: String,
        /// A pattern that works.
        example: &'static str,
    },
    /// Columns that do not make a measurement.
    #[error("{}: the columns [{found}] lack {missing}; say columns = {example}", path.display())]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// Columns found.
        found: String,
        /// What is missing.
        missing: &'static str,
        /// A pattern that works.
        example: &'static str,
    },
    /// A quantity named twice.
    #[error("{}: columns \"{first}\" and \"{second}\" hold the same quantity; mark one of them \"-\"", path.display())]
    TwiceGiven {
        /// The file.
        path: PathBuf,
        /// One column.
        first: String,
        /// The other.
        second: String,
    },
    /// Neither a pattern nor a header that says what the columns are.
    #[error("{}: nothing says what the columns are (line {line}: {found}); say columns = {example}", path.display())]
    NoColumns {
        /// The file.
        path: PathBuf,
        /// 1-based line shown.
        line: u64,
        /// What stands there.
        found: String,
        /// A pattern that works.
        example: &'static str,
    },
    /// Rates of one sensor and increments of the other, or both of one.
    #[error(
        "{}: the columns [{found}] mix rates and increments; give either dtheta_* and dvel_*, or gyro_* and accel_*",
        path.display()
    )]
    MixedKinds {
        /// The file.
        path: PathBuf,
        /// Columns found.
        found: String,
    },
    /// The kind that was asked for is not that of the columns.
    #[error("{}: the columns hold {found}, and kind says {asked}; leave kind out or mend the columns", path.display())]
    KindContradicted {
        /// The file.
        path: PathBuf,
        /// What the columns hold.
        found: &'static str,
        /// What was asked for.
        asked: &'static str,
    },
    /// Positions that are not on the ellipsoid of WGS 84.
    #[error(
        "{}: line {line} says that positions are {found}; export again with datum WGS84 and ellipsoidal heights",
        path.display()
    )]
    WrongDatum {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// Datum and kind of height.
        found: String,
    },
    /// A baseline without the place of the base.
    #[error(
        "{}: line {line}: east, north, up of a baseline need the base, and no header line \"% ref pos\" gives it; \
         export again with header, or as latitude, longitude, height",
        path.display()
    )]
    NoReference {
        /// The file.
        path: PathBuf,
        /// 1-based line of the first epoch.
        line: u64,
    },
    /// The samples do not make inertial measurements.
    #[error("{}: {source}", path.display())]
    Imu {
        /// The file.
        path: PathBuf,
        /// Why.
        source: ImuError,
    },
}

impl MeasurementFileError {
    /// An error of the operating system, with its file.
    pub(super) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        Self::io_at(path, Place::Line(1))
    }

    /// The same at a line or record that could not be had.
    pub(super) fn io_at(path: &Path, place: Place) -> impl FnOnce(io::Error) -> Self {
        use io::ErrorKind::{InvalidData, InvalidInput, UnexpectedEof};
        let path = path.to_path_buf();
        move |source| match source.kind() {
            InvalidData | InvalidInput | UnexpectedEof => Self::Damaged { path, place, source },
            _ => Self::Io { path, source },
        }
    }
}

impl From<LineError> for MeasurementFileError {
    fn from(error: LineError) -> Self {
        match error {
            LineError::Io { path, line, source } => Self::io_at(&path, Place::Line(line))(source),
            LineError::TooLong { path, line, limit } => Self::LineTooLong { path, line, limit },
        }
    }
}
