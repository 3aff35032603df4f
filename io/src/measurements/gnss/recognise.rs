//! The format of a file of GNSS fixes, by its first lines.

use std::path::Path;

use super::columns::{BARE_COUNTS, names_a_column};
use super::rtklib::{is_header, tokens};
use super::{GnssFormat, MeasurementFileError};
use crate::delimited::may_be_text;

/// The format of a file that begins with these bytes.
pub(super) fn format(head: &[u8], path: &Path) -> Result<GnssFormat, MeasurementFileError> {
    let unknown = |found, remedy| {
        let path = path.to_path_buf();
        Err(MeasurementFileError::UnknownFormat { path, found, remedy })
    };
    if head.is_empty() {
        return Err(MeasurementFileError::Empty { path: path.to_path_buf() });
    } else if head.starts_with(b"LASF") {
        return unknown("a LAS or LAZ point cloud", "name it among the strips");
    } else if !may_be_text(head) {
        return unknown("no text", "a .pos file of RTKLIB, KF-GINS text or CSV can be read");
    }
    let text = String::from_utf8_lossy(head);
    let mut named = false;
    for line in text.trim_start_matches('\u{feff}').lines().map(str::trim).filter(|line| !line.is_empty()) {
        if line.starts_with(['#', '%']) {
            if is_header(line) {
                return Ok(GnssFormat::RtklibPos);
            }
            named |= names_a_column(line);
            continue;
        }
        if line.starts_with('$') {
            return unknown("NMEA sentences", "they hold no accuracies: export a .pos file or CSV");
        } else if line.starts_with(">") || line.contains("RINEX") {
            return unknown("RINEX observations", "process them first, with RTKLIB for example");
        }
        let mut fields = tokens(line);
        let (first, second) = (fields.next().unwrap_or_default(), fields.next().unwrap_or_default());
        let count = tokens(line).count();
        let is_number = |text: &str| text.parse::<f64>().is_ok();
        return Ok(if first.contains('/') && second.contains(':') {
            GnssFormat::RtklibPos
        } else if named || !is_number(first) {
            GnssFormat::Csv
        } else if BARE_COUNTS.contains(&count) {
            GnssFormat::KfGins
        } else if count >= 15 && first.parse::<u32>().is_ok() && is_number(second) {
            GnssFormat::RtklibPos
        } else {
            GnssFormat::Csv
        });
    }
    Ok(GnssFormat::Csv)
}
