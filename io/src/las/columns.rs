//! Raw point records turned into columns.

use super::bytes::{f64_at, i16_at, i32_at, u16_at};
use super::layout::RecordLayout;

/// Records converted at a time, so that all columns are taken from them while they are in the first-level cache.
const STRIDE: usize = 512;
/// One step \[°\] of the 16-bit scan angle of point formats 6 to 10.
const SCAN_ANGLE_STEP_DEG: f32 = 0.006;

/// The point was made, not measured (bit of [`Columns::flags`]).
pub const FLAG_SYNTHETIC: u8 = 1;
/// The point is a model key point (bit of [`Columns::flags`]).
pub const FLAG_KEY_POINT: u8 = 2;
/// The point is withheld: to be left out of any work (bit of [`Columns::flags`]).
pub const FLAG_WITHHELD: u8 = 4;
/// The point lies in the overlap of two strips (bit of [`Columns::flags`], formats 6 to 10).
pub const FLAG_OVERLAP: u8 = 8;

/// The attributes of a block of points, one vector each, all of the same length.
///
/// Coordinates stay integers: x \[m\] is `x · scale + offset` of the file's header.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Columns {
    /// Integer x.
    pub x: Vec<i32>,
    /// Integer y.
    pub y: Vec<i32>,
    /// Integer z.
    pub z: Vec<i32>,
    /// GPS time \[s\] as the file holds it (see [`super::guess_time`]); empty where the format has none.
    pub gps_time: Vec<f64>,
    /// Intensity.
    pub intensity: Vec<u16>,
    /// Return number, 1-based.
    pub return_number: Vec<u8>,
    /// Number of returns of the pulse.
    pub number_of_returns: Vec<u8>,
    /// Class (0 to 31 in formats 0 to 5).
    pub classification: Vec<u8>,
    /// Classification flags: [`FLAG_SYNTHETIC`], [`FLAG_KEY_POINT`], [`FLAG_WITHHELD`], [`FLAG_OVERLAP`].
    pub flags: Vec<u8>,
    /// Scanner channel, 0 to 3; 0 in formats 0 to 5.
    pub scanner_channel: Vec<u8>,
    /// Scan angle \[°\]: whole degrees in formats 0 to 5, steps of 0.006° in 6 to 10.
    pub scan_angle_deg: Vec<f32>,
    /// User data.
    pub user_data: Vec<u8>,
    /// Point source id.
    pub point_source_id: Vec<u16>,
}

impl Columns {
    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// True where there are no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Removes all points and keeps the memory.
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
        self.gps_time.clear();
        self.intensity.clear();
        self.return_number.clear();
        self.number_of_returns.clear();
        self.classification.clear();
        self.flags.clear();
        self.scanner_channel.clear();
        self.scan_angle_deg.clear();
        self.user_data.clear();
        self.point_source_id.clear();
    }

    /// Replaces the columns by those of `records`, a whole number of records of `layout`; memory is reused.
    pub fn fill(&mut self, records: &[u8], layout: RecordLayout) {
        self.clear();
        if layout.record_length == 0 {
            return;
        }
        for block in records.chunks(layout.record_length * STRIDE) {
            self.append_common(block, layout);
            if layout.extended {
                self.append_extended(block, layout);
            } else {
                self.append_legacy(block, layout);
            }
        }
    }

    /// Appends the fields that lie at the same place in every format.
    fn append_common(&mut self, block: &[u8], layout: RecordLayout) {
        let records = || block.chunks_exact(layout.record_length);
        self.x.extend(records().map(|record| i32_at(record, 0)));
        self.y.extend(records().map(|record| i32_at(record, 4)));
        self.z.extend(records().map(|record| i32_at(record, 8)));
        self.intensity.extend(records().map(|record| u16_at(record, 12)));
        self.user_data.extend(records().map(|record| record[17]));
        if let Some(at) = layout.gps_time {
            self.gps_time.extend(records().map(|record| f64_at(record, at)));
        }
    }

    /// Appends the fields of formats 0 to 5.
    fn append_legacy(&mut self, block: &[u8], layout: RecordLayout) {
        let records = || block.chunks_exact(layout.record_length);
        self.return_number.extend(records().map(|record| record[14] & 0b111));
        self.number_of_returns.extend(records().map(|record| (record[14] >> 3) & 0b111));
        self.classification.extend(records().map(|record| record[15] & 0b1_1111));
        self.flags.extend(records().map(|record| record[15] >> 5));
        self.scanner_channel.resize(self.x.len(), 0);
        self.scan_angle_deg.extend(records().map(|record| f32::from(i8::from_le_bytes([record[16]]))));
        self.point_source_id.extend(records().map(|record| u16_at(record, 18)));
    }

    /// Appends the fields of formats 6 to 10.
    fn append_extended(&mut self, block: &[u8], layout: RecordLayout) {
        let records = || block.chunks_exact(layout.record_length);
        self.return_number.extend(records().map(|record| record[14] & 0b1111));
        self.number_of_returns.extend(records().map(|record| record[14] >> 4));
        self.flags.extend(records().map(|record| record[15] & 0b1111));
        self.scanner_channel.extend(records().map(|record| (record[15] >> 4) & 0b11));
        self.classification.extend(records().map(|record| record[16]));
        self.scan_angle_deg.extend(records().map(|record| f32::from(i16_at(record, 18)) * SCAN_ANGLE_STEP_DEG));
        self.point_source_id.extend(records().map(|record| u16_at(record, 20)));
    }

    /// Writes the columns into `records`, zeroed records of `layout`; fields without a column stay zero.
    ///
    /// Values that do not fit their field are cut to it: a return number above 7 in format 1 becomes 7.
    pub(super) fn store(&self, records: &mut [u8], layout: RecordLayout) {
        for (index, record) in records.chunks_exact_mut(layout.record_length).enumerate() {
            record[0..4].copy_from_slice(&self.x[index].to_le_bytes());
            record[4..8].copy_from_slice(&self.y[index].to_le_bytes());
            record[8..12].copy_from_slice(&self.z[index].to_le_bytes());
            record[12..14].copy_from_slice(&at(&self.intensity, index).to_le_bytes());
            record[17] = at(&self.user_data, index);
            if let Some(position) = layout.gps_time {
                record[position..position + 8].copy_from_slice(&at(&self.gps_time, index).to_le_bytes());
            }
            if layout.extended {
                self.store_extended(record, index);
            } else {
                self.store_legacy(record, index);
            }
        }
    }

    #[allow(clippy::cast_possible_truncation)] // a float is saturated by `as`
    fn store_legacy(&self, record: &mut [u8], index: usize) {
        let returns = at(&self.return_number, index).min(7) | (at(&self.number_of_returns, index).min(7) << 3);
        record[14] = returns;
        record[15] = (at(&self.classification, index) & 0b1_1111) | (at(&self.flags, index) << 5);
        record[16] = (at(&self.scan_angle_deg, index).round() as i8).to_le_bytes()[0];
        record[18..20].copy_from_slice(&at(&self.point_source_id, index).to_le_bytes());
    }

    #[allow(clippy::cast_possible_truncation)] // a float is saturated by `as`
    fn store_extended(&self, record: &mut [u8], index: usize) {
        record[14] = at(&self.return_number, index).min(15) | (at(&self.number_of_returns, index).min(15) << 4);
        record[15] = (at(&self.flags, index) & 0b1111) | ((at(&self.scanner_channel, index) & 0b11) << 4);
        record[16] = at(&self.classification, index);
        let steps = (at(&self.scan_angle_deg, index) / SCAN_ANGLE_STEP_DEG).round() as i16;
        record[18..20].copy_from_slice(&steps.to_le_bytes());
        record[20..22].copy_from_slice(&at(&self.point_source_id, index).to_le_bytes());
    }

    /// Lengths of the columns, by name, for a check before writing.
    pub(super) fn lengths(&self) -> [(&'static str, usize); 13] {
        [
            ("x", self.x.len()),
            ("y", self.y.len()),
            ("z", self.z.len()),
            ("gps_time", self.gps_time.len()),
            ("intensity", self.intensity.len()),
            ("return_number", self.return_number.len()),
            ("number_of_returns", self.number_of_returns.len()),
            ("classification", self.classification.len()),
            ("flags", self.flags.len()),
            ("scanner_channel", self.scanner_channel.len()),
            ("scan_angle_deg", self.scan_angle_deg.len()),
            ("user_data", self.user_data.len()),
            ("point_source_id", self.point_source_id.len()),
        ]
    }
}

/// Value at `index`; zero where the column was left empty.
fn at<T: Copy + Default>(column: &[T], index: usize) -> T {
    column.get(index).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stored_and_filled_again_are_the_same_in_every_format() {
        let count: u16 = 1_300; // more than two strides
        let mut columns = Columns::default();
        for index in 0..count {
            let number = i32::from(index);
            let small = index.to_le_bytes()[0];
            columns.x.push(number * 1_000_003);
            columns.y.push(-number * 999_983);
            columns.z.push(number - 600);
            columns.gps_time.push(306_235_306.125 + f64::from(index) * 1e-5);
            columns.intensity.push(index);
            columns.return_number.push(small % 5 + 1);
            columns.number_of_returns.push(small % 3 + 4);
            columns.classification.push(small % 20);
            columns.flags.push(small % 8);
            columns.scanner_channel.push(0);
            columns.scan_angle_deg.push(f32::from(index % 60) - 30.0);
            columns.user_data.push(small);
            columns.point_source_id.push(index);
        }
        for format in 0..=10 {
            let length = RecordLayout::standard_length(format).expect("a known format") + 3;
            let layout = RecordLayout::new(format, length).expect("a known format");
            let mut records = vec![0; usize::from(length) * columns.len()];
            columns.store(&mut records, layout);
            let mut again = Columns::default();
            again.fill(&records, layout);
            let mut expected = columns.clone();
            if layout.gps_time.is_none() {
                expected.gps_time.clear();
            }
            assert!(
                again
                    .scan_angle_deg
                    .iter()
                    .zip(&expected.scan_angle_deg)
                    .all(|(a, b)| (a - b).abs() <= 0.5 * SCAN_ANGLE_STEP_DEG + 1e-6)
            );
            expected.scan_angle_deg.clone_from(&again.scan_angle_deg);
            assert_eq!(again, expected, "format {format}");
        }
    }
}
