//! Delimited text: numbered lines of bounded length, plain or gzipped, their fields, and the names of columns.

use std::io::{self, BufRead, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use flate2::bufread::MultiGzDecoder;

/// First bytes of a gzipped file.
pub const GZIP_MAGIC: &[u8] = &[0x1f, 0x8b];
/// Longest line taken \[bytes\].
const LONGEST_LINE: usize = 1 << 16;

/// A source as it is, or what a gzipped one holds.
pub(crate) fn unpacked<'a>(mut source: impl BufRead + 'a) -> io::Result<Box<dyn BufRead + 'a>> {
    Ok(match source.fill_buf()?.starts_with(GZIP_MAGIC) {
        true => Box::new(BufReader::with_capacity(1 << 16, MultiGzDecoder::new(source))),
        false => Box::new(source),
    })
}

/// The first bytes of a source, at most `most`, and the source with those bytes still to come.
pub(crate) fn peeked<'a>(mut source: Box<dyn BufRead + 'a>, most: u64) -> io::Result<(Vec<u8>, Box<dyn BufRead + 'a>)> {
    let mut head = Vec::new();
    source.by_ref().take(most).read_to_end(&mut head)?;
    Ok((head.clone(), Box::new(Cursor::new(head).chain(source))))
}

/// UTF-8 without control characters; a character cut at the end is allowed.
pub(crate) fn is_text(head: &[u8]) -> bool {
    let valid = match std::str::from_utf8(head) {
        Ok(text) => text,
        Err(error) if error.error_len().is_none() => {
            std::str::from_utf8(&head[..error.valid_up_to()]).unwrap_or_default()
        }
        Err(_) => return false,
    };
    !valid.is_empty() && valid.chars().all(|c| matches!(c, '\t' | '\n' | '\r') || !c.is_control())
}

/// Whether bytes may be text in some encoding that holds ASCII: no control characters.
pub(crate) fn may_be_text(head: &[u8]) -> bool {
    head.iter().all(|byte| matches!(byte, b'\t' | b'\n' | b'\r' | 0x20..=0x7e | 0x80..))
}

/// What stands between two fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Delimiter {
    Comma,
    Semicolon,
    WhiteSpace,
}

impl Delimiter {
    /// The delimiter that a line shows.
    pub(crate) fn of(text: &str) -> Self {
        if text.contains(';') {
            Self::Semicolon
        } else if text.contains(',') {
            Self::Comma
        } else {
            Self::WhiteSpace
        }
    }

    /// The fields of a line, trimmed of white space.
    pub(crate) fn split(self, text: &str) -> Box<dyn Iterator<Item = &str> + '_> {
        match self {
            Self::Comma => Box::new(text.split(',').map(str::trim)),
            Self::Semicolon => Box::new(text.split(';').map(str::trim)),
            Self::WhiteSpace => Box::new(text.split_whitespace()),
        }
    }
}

/// A line that is not empty.
#[derive(Debug)]
pub(crate) struct Line<'a> {
    /// 1-based.
    pub(crate) number: u64,
    /// Without the line's end and white space around it.
    pub(crate) text: &'a str,
}

impl Line<'_> {
    /// Whether the line is a comment.
    pub(crate) fn is_comment(&self) -> bool {
        self.text.starts_with(['#', '%'])
    }
}

/// Why the next line cannot be had.
#[derive(Debug)]
pub(crate) enum LineError {
    /// The operating system, or the decompressor, refused.
    Io { path: PathBuf, line: u64, source: io::Error },
    /// A line without end.
    TooLong { path: PathBuf, line: u64, limit: usize },
}

/// The lines of a file, empty ones left out.
pub(crate) struct Lines<'a> {
    source: Box<dyn BufRead + 'a>,
    path: PathBuf,
    number: u64,
    bytes: Vec<u8>,
    /// The line with its wrong bytes replaced, where it is not UTF-8.
    mended: String,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(source: Box<dyn BufRead + 'a>, path: &Path) -> Self {
        Self { source, path: path.to_path_buf(), number: 0, bytes: Vec::new(), mended: String::new() }
    }

    /// The next line that is not empty; `None` at the end.
    pub(crate) fn next(&mut self) -> Result<Option<Line<'_>>, LineError> {
        loop {
            self.bytes.clear();
            let mut limited = self.source.by_ref().take(LONGEST_LINE as u64 + 1);
            let found = limited.read_until(b'\n', &mut self.bytes).map_err(|source| {
                let (path, line) = (self.path.clone(), self.number + 1);
                LineError::Io { path, line, source }
            })?;
            if found == 0 {
                return Ok(None);
            }
            self.number += 1;
            if found > LONGEST_LINE {
                return Err(LineError::TooLong { path: self.path.clone(), line: self.number, limit: LONGEST_LINE });
            }
            if self.bytes.iter().any(|b| !b.is_ascii_whitespace()) {
                break;
            }
        }
        let text = match std::str::from_utf8(&self.bytes) {
            Ok(text) => text,
            Err(_) => {
                self.mended.clear();
                self.mended.push_str(&String::from_utf8_lossy(&self.bytes));
                &self.mended
            }
        };
        Ok(Some(Line { number: self.number, text: text.trim_start_matches('\u{feff}').trim() }))
    }
}

/// The name of a column in lower case, without quotes, its unit set off by an underscore.
pub(crate) fn plain_name(name: &str) -> String {
    let mut plain = String::new();
    for c in name.trim().trim_matches(['"', '\'', '#', '%', ' ']).chars() {
        match c {
            '[' | '(' | '{' | ' ' | '_' | '-' | '.' => {
                if !plain.is_empty() && !plain.ends_with('_') {
                    plain.push('_');
                }
            }
            ']' | ')' | '}' => {}
            _ => plain.extend(c.to_lowercase()),
        }
    }
    plain.trim_end_matches('_').to_string()
}
