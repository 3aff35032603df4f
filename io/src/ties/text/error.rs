//! What can be wrong with `ties.txt`, and the way out.

use std::io;
use std::path::PathBuf;

/// Why ties in text cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TieTextError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// A line without end.
    #[error("{}: line {line} is longer than {limit} bytes; this is no file of ties", path.display())]
    LongLine {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// Bytes taken.
        limit: usize,
    },
    /// Something else.
    #[error("{}: begins with \"{found}\" where \"{}\" and a version were due; give the ties.txt of tieline run, or write that line first (docs/formats.md)", path.display(), super::MAGIC)]
    NotTies {
        /// The file.
        path: PathBuf,
        /// Its first line.
        found: String,
    },
    /// A format of the future.
    #[error("{}: line {line}: version \"{found}\" of the format, {} is known; take a newer tieline or export version {}", path.display(), super::VERSION, super::VERSION)]
    Version {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// What stands there.
        found: String,
    },
    /// A line of the header that is not there.
    #[error("{}: the header does not say {key}; add the line \"# {key}: {expected}\" above the first row, if so it is", path.display())]
    MissingKey {
        /// The file.
        path: PathBuf,
        /// Its key.
        key: &'static str,
        /// What it may say.
        expected: &'static str,
    },
    /// A line of the header that says what cannot be used.
    #[error("{}: line {line}: {key} is \"{found}\" where {expected} was due; convert the ties", path.display())]
    BadKey {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// Its key.
        key: &'static str,
        /// What it says.
        found: String,
        /// What was due.
        expected: &'static str,
    },
    /// A row that cannot be used.
    #[error("{}: line {line}: {fault}", path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// What is wrong with it.
        fault: RowFault,
    },
}

/// What is wrong with a row.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RowFault {
    /// Too few or too many fields.
    #[error(
        "{found} fields where {expected} were due for rank {rank} ({}); a cut line, or a column too many",
        super::COLUMNS
    )]
    FieldCount {
        /// Fields found.
        found: usize,
        /// Fields due.
        expected: usize,
        /// Rank of the tie, 1 where it cannot be had.
        rank: usize,
    },
    /// A field that is not what its column holds.
    #[error("{column} is \"{text}\" where {expected} was due; mend or remove the tie")]
    Field {
        /// Name of the column.
        column: &'static str,
        /// What stands there.
        text: String,
        /// What should.
        expected: &'static str,
    },
    /// A rank that the kind does not have.
    #[error("rank {rank} of a {kind} tie, which has {expected}; mend kind or rank")]
    Rank {
        /// The kind.
        kind: &'static str,
        /// Rank found.
        rank: usize,
        /// Rank due.
        expected: usize,
    },
    /// A direction that is no unit vector.
    #[error("direction {number} has the length {length:.7} where 1 was due; divide it by its length")]
    NotUnit {
        /// 1-based.
        number: usize,
        /// Its length.
        length: f64,
    },
    /// Directions that are not at right angles.
    #[error(
        "directions {first} and {second} are not at right angles (cosine {cosine:.2e}); give orthogonal ones, with the covariance along them"
    )]
    NotOrthogonal {
        /// 1-based.
        first: usize,
        /// 1-based.
        second: usize,
        /// Of the angle between them.
        cosine: f64,
    },
    /// A variance that cannot be.
    #[error(
        "variance along direction {number} is {value:e} m² where 1e-12 to 1e6 was due; give the square of the standard deviation in metres"
    )]
    Variance {
        /// 1-based direction.
        number: usize,
        /// What stands there \[m²\].
        value: f64,
    },
    /// A covariance with correlations beyond what can be.
    #[error("the covariance is not positive definite; check its order: upper triangle, row by row")]
    Covariance,
    /// Used, and without weight.
    #[error("weight {weight} of a sighting that is used, where 1e-6 to 1 was due; give such a weight, or used 0")]
    Weight {
        /// What stands there.
        weight: f64,
    },
    /// Sightings out of order.
    #[error("tie {tie} is seen at {time_s:?} s after {previous_s:?} s; sort the sightings of a tie by time")]
    Unsorted {
        /// The tie.
        tie: u64,
        /// Time \[s\].
        time_s: f64,
        /// That of the row before \[s\].
        previous_s: f64,
    },
    /// A tie that ties nothing.
    #[error("tie {tie} has one sighting where two or more were due; remove it, or put the rows of a tie together")]
    TooFew {
        /// The tie.
        tie: u64,
    },
    /// Rows of a tie at two places.
    #[error("tie {tie} had its rows further up; put the rows of a tie together, or give this one another number")]
    Apart {
        /// The tie.
        tie: u64,
    },
    /// Rows of a tie that contradict each other.
    #[error("{column} of tie {tie} is not that of the row before; it is one for all sightings of a tie")]
    Differs {
        /// The tie.
        tie: u64,
        /// Name of the column.
        column: &'static str,
    },
    /// A second header.
    #[error(
        "a second header among the rows; two files of ties cannot be put together, their numbers and weeks may differ"
    )]
    SecondHeader,
}
