//! Lines of a text file: numbered, of bounded length, split into fields.

use std::io::{BufRead, Read};
use std::path::{Path, PathBuf};

use super::super::error::TrajectoryFileError;

/// Longest line taken \[bytes\].
const LONGEST_LINE: usize = 1 << 16;

/// What stands between two fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Delimiter {
    Comma,
    Semicolon,
    WhiteSpace,
}

impl Delimiter {
    /// The delimiter that a line shows.
    pub(super) fn of(text: &str) -> Self {
        if text.contains(';') {
            Self::Semicolon
        } else if text.contains(',') {
            Self::Comma
        } else {
            Self::WhiteSpace
        }
    }

    /// The fields of a line, trimmed of white space.
    pub(super) fn split(self, text: &str) -> Box<dyn Iterator<Item = &str> + '_> {
        match self {
            Self::Comma => Box::new(text.split(',').map(str::trim)),
            Self::Semicolon => Box::new(text.split(';').map(str::trim)),
            Self::WhiteSpace => Box::new(text.split_whitespace()),
        }
    }
}

/// A line that is not empty.
#[derive(Debug)]
pub(super) struct Line<'a> {
    /// 1-based.
    pub(super) number: u64,
    /// Without the line's end and white space around it.
    pub(super) text: &'a str,
}

impl Line<'_> {
    /// Whether the line is a comment.
    pub(super) fn is_comment(&self) -> bool {
        self.text.starts_with(['#', '%'])
    }
}

/// The lines of a file, empty ones left out.
pub(super) struct Lines<'a> {
    source: Box<dyn BufRead + 'a>,
    path: PathBuf,
    number: u64,
    bytes: Vec<u8>,
    text: String,
}

impl<'a> Lines<'a> {
    pub(super) fn new(source: Box<dyn BufRead + 'a>, path: &Path) -> Self {
        Self { source, path: path.to_path_buf(), number: 0, bytes: Vec::new(), text: String::new() }
    }

    /// The next line that is not empty; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Line<'_>>, TrajectoryFileError> {
        loop {
            self.bytes.clear();
            let mut limited = self.source.by_ref().take(LONGEST_LINE as u64 + 1);
            let found = limited.read_until(b'\n', &mut self.bytes).map_err(TrajectoryFileError::io(&self.path))?;
            if found == 0 {
                return Ok(None);
            }
            self.number += 1;
            if found > LONGEST_LINE {
                let (line, limit) = (self.number, LONGEST_LINE);
                return Err(TrajectoryFileError::LineTooLong { path: self.path.clone(), line, limit });
            }
            if self.bytes.iter().any(|b| !b.is_ascii_whitespace()) {
                break;
            }
        }
        self.text.clear();
        self.text.push_str(&String::from_utf8_lossy(&self.bytes));
        Ok(Some(Line { number: self.number, text: self.text.trim_start_matches('\u{feff}').trim() }))
    }
}
