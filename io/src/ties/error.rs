//! What can be wrong with a file of ties.

use std::io;
use std::path::PathBuf;

/// Why a file of ties cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TieFileError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// Damaged or foreign Parquet.
    #[error("{}: {reason}; the file is damaged or was not written by tieline", path.display())]
    Parquet {
        /// The file.
        path: PathBuf,
        /// What the library said.
        reason: String,
    },
    /// A column is not there.
    #[error("{}: there is no column {column}; run the matching again", path.display())]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// Its name.
        column: &'static str,
    },
    /// A column holds something else.
    #[error("{}: column {column} holds {found} where {expected} was due", path.display())]
    ColumnType {
        /// The file.
        path: PathBuf,
        /// Its name.
        column: &'static str,
        /// What it holds.
        found: String,
        /// What it should.
        expected: &'static str,
    },
    /// A line with the wrong number of fields.
    #[error("{}: line {line} has {found} fields where {expected} were due", path.display())]
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
    /// A field that is not what its column holds.
    #[error("{}: line {line}, column {column}: \"{text}\" is not {expected}", path.display())]
    BadField {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// Name of the column.
        column: &'static str,
        /// What stands there.
        text: String,
        /// What should.
        expected: &'static str,
    },
}
