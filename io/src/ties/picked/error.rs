//! What can be wrong with picked points, and the way out.

use std::io;
use std::path::PathBuf;

/// Why picked points cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PickedError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// A line without end.
    #[error("{}: line {line} is longer than {limit} bytes; this is no file of picked points", path.display())]
    LongLine {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// Bytes taken.
        limit: usize,
    },
    /// Not even a header.
    #[error("{}: there is nothing in it; a header is due, point,gps_time_s,x_m,y_m,z_m, and a row for each sighting of a point", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A column that is not known, or twice there.
    #[error("{}: the header has the column \"{found}\", which is not known or stands there twice; known are point, gps_time_s, x_m, y_m, z_m, sigma_plan_m, sigma_height_m, scanner", path.display())]
    Column {
        /// The file.
        path: PathBuf,
        /// Its name.
        found: String,
    },
    /// A column that is not there.
    #[error("{}: the header has no column {column}; point, gps_time_s, x_m, y_m, z_m are due", path.display())]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// Its name.
        column: &'static str,
    },
    /// A row that cannot be used.
    #[error("{}: line {line}: {fault}", path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// What is wrong with it.
        fault: PickedFault,
    },
}

/// What is wrong with a row.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PickedFault {
    /// Too few or too many fields.
    #[error("{found} fields where {expected} were due, as many as the header has; leave a field empty, but not out")]
    FieldCount {
        /// Fields found.
        found: usize,
        /// Fields due.
        expected: usize,
    },
    /// A field that is not what its column holds.
    #[error("{column} is \"{text}\" where {expected} was due; mend or remove the row")]
    Field {
        /// Name of the column.
        column: &'static str,
        /// What stands there.
        text: String,
        /// What should.
        expected: &'static str,
    },
    /// A point that ties nothing.
    #[error(
        "point \"{point}\" has one row; two sightings are due, or one and a row without time where it is known to be: pick it once more, or remove it"
    )]
    TooFew {
        /// Its name.
        point: String,
    },
    /// A point that is known twice.
    #[error("point \"{point}\" is known from line {line} already; leave one of both rows without time")]
    KnownTwice {
        /// Its name.
        point: String,
        /// That of the other row, 1-based.
        line: u64,
    },
    /// The same sighting twice.
    #[error("point \"{point}\" is seen at this time in line {line} already; remove one of both")]
    SeenTwice {
        /// Its name.
        point: String,
        /// That of the other row, 1-based.
        line: u64,
    },
}
