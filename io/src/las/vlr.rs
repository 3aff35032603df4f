//! Variable-length records: the lists before (VLR) and after (EVLR) the points.

use std::path::Path;

use super::bytes::{text_at, u16_at, u64_at};
use super::error::LasError;
use super::input::Input;

/// Bytes of the header of a variable-length record.
pub(super) const VLR_HEADER: u64 = 54;
/// Bytes of the header of an extended variable-length record.
pub(super) const EVLR_HEADER: u64 = 60;
/// Longest record whose contents are read when a file is opened, bytes; longer ones are listed only.
const LONGEST_READ: u64 = 16 << 20;

/// What a variable-length record is; its contents stay in the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VlrSummary {
    /// Who defined it, such as `LASF_Projection`.
    pub user_id: String,
    /// Number of the record within its definer's range.
    pub record_id: u16,
    /// Free text.
    pub description: String,
    /// Bytes of its contents.
    pub length: u64,
    /// It lies after the points.
    pub is_extended: bool,
    /// Byte position of its header in the file.
    pub(super) start: u64,
}

impl VlrSummary {
    /// True where definer and number are these.
    #[must_use]
    pub fn is(&self, user_id: &str, record_id: u16) -> bool {
        self.user_id == user_id && self.record_id == record_id
    }

    /// Byte position of its contents in the file.
    pub(super) fn contents_start(&self) -> u64 {
        self.start + self.whole_length() - self.length
    }

    /// Bytes of the record with its header.
    pub(super) fn whole_length(&self) -> u64 {
        self.length + if self.is_extended { EVLR_HEADER } else { VLR_HEADER }
    }
}

/// Reads a list of `count` records that starts at byte `start` and ends at byte `end` at the latest.
pub(super) fn read_list(
    input: &Input,
    count: u32,
    start: u64,
    end: u64,
    is_extended: bool,
) -> Result<Vec<(VlrSummary, Vec<u8>)>, LasError> {
    let header_length = if is_extended { EVLR_HEADER } else { VLR_HEADER };
    let mut records = Vec::new();
    let mut at = start;
    for index in 0..count {
        let cut = |expected| cut_short(input.path(), is_extended, index, expected, end);
        let contents_at = at.checked_add(header_length).ok_or_else(|| cut(u64::MAX))?;
        if contents_at > end {
            return Err(cut(contents_at));
        }
        let head = input.read_vec(at, header_length)?;
        let length = if is_extended { u64_at(&head, 20) } else { u64::from(u16_at(&head, 20)) };
        let next = contents_at.checked_add(length).ok_or_else(|| cut(u64::MAX))?;
        if next > end {
            return Err(cut(next));
        }
        let summary = VlrSummary {
            user_id: text_at(&head, 2, 16),
            record_id: u16_at(&head, 18),
            description: text_at(&head, if is_extended { 28 } else { 22 }, 32),
            length,
            is_extended,
            start: at,
        };
        let contents = if length <= LONGEST_READ { input.read_vec(contents_at, length)? } else { Vec::new() };
        records.push((summary, contents));
        at = next;
    }
    Ok(records)
}

fn cut_short(path: &Path, is_extended: bool, index: u32, expected: u64, found: u64) -> LasError {
    let kind = if is_extended { "EVLR" } else { "VLR" };
    LasError::VariableRecord { path: path.into(), kind, index, expected, found }
}
