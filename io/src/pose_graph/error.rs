//! What is wrong with a pose graph.

use std::path::PathBuf;

/// Why a pose graph cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PoseGraphError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// What it holds is not a pose graph.
    #[error("{path}, {problem}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: Problem,
    },
}

/// What is wrong, and where.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// Too few numbers.
    #[error("line {line}: {tag} has {found} numbers, {wanted} are needed; is the line cut off?")]
    Short {
        /// Line, from 1.
        line: usize,
        /// Tag of the line.
        tag: String,
        /// Numbers found.
        found: usize,
        /// Numbers needed.
        wanted: usize,
    },
    /// Not a number.
    #[error("line {line}: `{value}` is not a finite number")]
    NotANumber {
        /// Line, from 1.
        line: usize,
        /// The word.
        value: String,
    },
    /// A vertex number that is none.
    #[error("line {line}: `{value}` is not the number of a vertex")]
    NotAnId {
        /// Line, from 1.
        line: usize,
        /// The word.
        value: String,
    },
    /// A vertex twice.
    #[error("line {line}: vertex {id} was there before; numbers of vertices must differ")]
    Twice {
        /// Line, from 1.
        line: usize,
        /// The vertex.
        id: i64,
    },
    /// An edge to nowhere.
    #[error("line {line}: vertex {id} is nowhere in the file; add its VERTEX line or drop the edge")]
    Unknown {
        /// Line, from 1.
        line: usize,
        /// The vertex.
        id: i64,
    },
    /// An edge between vertices of the wrong kind.
    #[error("line {line}: {tag} does not fit the kind of vertex {id}")]
    Kind {
        /// Line, from 1.
        line: usize,
        /// Tag of the line.
        tag: String,
        /// The vertex.
        id: i64,
    },
    /// An edge from a vertex to itself.
    #[error("line {line}: {tag} ties vertex {id} to itself")]
    Loop {
        /// Line, from 1.
        line: usize,
        /// Tag of the line.
        tag: String,
        /// The vertex.
        id: i64,
    },
    /// An information matrix that is none.
    #[error(
        "line {line}: the information matrix of {tag} is not positive definite; is it a covariance, or in another order?"
    )]
    Information {
        /// Line, from 1.
        line: usize,
        /// Tag of the line.
        tag: String,
    },
    /// A quaternion of length zero.
    #[error("line {line}: the quaternion of {tag} has no length")]
    Quaternion {
        /// Line, from 1.
        line: usize,
        /// Tag of the line.
        tag: String,
    },
    /// A tag that is not known.
    #[error("line {line}: `{tag}` is not supported; supported are {known}")]
    Tag {
        /// Line, from 1.
        line: usize,
        /// The tag.
        tag: String,
        /// What is supported.
        known: &'static str,
    },
    /// Nothing in it.
    #[error("line 1: there is no vertex in the file")]
    Empty,
}
