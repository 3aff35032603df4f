//! What can be wrong with a trajectory file, and the way out.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use tieline_filter::{PositionFrame, TrajectoryError};

use crate::delimited::LineError;

/// Where in a file something was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// 0-based record of a binary file.
    Record(u64),
    /// 1-based line of a text file.
    Line(u64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Record(record) => write!(f, "record {record}"),
            Self::Line(line) => write!(f, "line {line}"),
        }
    }
}

/// Why a trajectory file cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrajectoryFileError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// Nothing in the file.
    #[error("{}: the file is empty; export the trajectory again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Neither SBET, TRJ nor text.
    #[error(
        "{}: not a trajectory that can be recognised ({found}); say format = \"sbet\", \"trj\" or \"text\"",
        path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What it looks like.
        found: String,
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
    #[error("{}: the numbers are big-endian; convert the file to little-endian, as POSPac writes it", path.display())]
    ByteOrder {
        /// The file.
        path: PathBuf,
    },
    /// A latitude beyond the poles.
    #[error(
        "{}: latitude {latitude:?} at record {record} is beyond ±pi/2: degrees taken for radians, or not an SBET",
        path.display()
    )]
    NotRadians {
        /// The file.
        path: PathBuf,
        /// 0-based record.
        record: u64,
        /// The number found.
        latitude: f64,
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
        column: &'static str,
    },
    /// Time runs backwards by less than a week's end.
    #[error("{}: time runs backwards at {place}: {time_s:?} s after {previous_s:?} s; sort the file by time", path.display())]
    TimeBackwards {
        /// The file.
        path: PathBuf,
        /// Where.
        place: Place,
        /// Its time \[s\].
        time_s: f64,
        /// The time before it \[s\].
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
    /// A head that is not what it should be.
    #[error("{}: {what} is {found}, {expected} was due; the file is damaged or of another format", path.display())]
    BadHeader {
        /// The file.
        path: PathBuf,
        /// Which entry.
        what: &'static str,
        /// What stands there.
        found: String,
        /// What should.
        expected: String,
    },
    /// A field that is no number.
    #[error("{}: line {line}, column {column} ({name}): \"{text}\" is not a number", path.display())]
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
    #[error("{}: line {line} is longer than {limit} bytes: this is not a text trajectory", path.display())]
    LineTooLong {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// Longest line taken.
        limit: usize,
    },
    /// A column name that means nothing.
    #[error("{}: column \"{name}\" is unknown; known are {known}", path.display())]
    UnknownColumn {
        /// The file.
        path: PathBuf,
        /// The name.
        name: String,
        /// What there is to choose from.
        known: &'static str,
    },
    /// Columns that do not make a trajectory.
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
    #[error("{}: {quantity} is given by two columns; mark one of them \"-\"", path.display())]
    TwiceGiven {
        /// The file.
        path: PathBuf,
        /// Which quantity.
        quantity: &'static str,
    },
    /// Neither a pattern nor a header that says what the columns are.
    #[error("{}: nothing says what the columns are (first line: {found}); say columns = {example}", path.display())]
    NoColumns {
        /// The file.
        path: PathBuf,
        /// First line of the file.
        found: String,
        /// A pattern that works.
        example: &'static str,
    },
    /// The header names a quantity without its unit, and the values do not tell.
    #[error(
        "{}: the header gives no unit for {quantity} and its values fit both radians and degrees; say columns = {example}",
        path.display()
    )]
    NoUnit {
        /// The file.
        path: PathBuf,
        /// Which quantity.
        quantity: &'static str,
        /// A pattern that works.
        example: &'static str,
    },
    /// The accuracy file belongs to another time.
    #[error(
        "{}: the accuracies of {} to {} s do not overlap the trajectory of {} to {} s; the files do not belong together",
        path.display(), accuracy_s.0, accuracy_s.1, trajectory_s.0, trajectory_s.1
    )]
    AccuracyApart {
        /// The accuracy file.
        path: PathBuf,
        /// Its first and last time \[s\].
        accuracy_s: (f64, f64),
        /// First and last time of the trajectory \[s\].
        trajectory_s: (f64, f64),
    },
    /// A trajectory in the wrong frame for this format.
    #[error("{}: this format holds {needed:?} positions, the trajectory has {found:?}; convert with its CRS", path.display())]
    WrongFrame {
        /// The file.
        path: PathBuf,
        /// Frame of the format.
        needed: PositionFrame,
        /// Frame of the trajectory.
        found: PositionFrame,
    },
    /// A trajectory without sigmas.
    #[error("{}: the trajectory has no accuracies to be written", path.display())]
    NoSigma {
        /// The file.
        path: PathBuf,
    },
    /// The epochs do not make a trajectory.
    #[error("{}: {source}", path.display())]
    Trajectory {
        /// The file.
        path: PathBuf,
        /// Why.
        source: TrajectoryError,
    },
}

impl TrajectoryFileError {
    /// An error of the operating system, with its file.
    pub(super) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, source }
    }
}

impl From<LineError> for TrajectoryFileError {
    fn from(error: LineError) -> Self {
        match error {
            LineError::Io { path, source, .. } => Self::Io { path, source },
            LineError::TooLong { path, line, limit } => Self::LineTooLong { path, line, limit },
        }
    }
}
