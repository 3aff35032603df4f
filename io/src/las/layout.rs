//! Where the fields of a point record lie: the eleven point formats of LAS 1.0 to 1.4.

/// Byte positions of the fields in one raw point record; `Copy`, so that it travels with the records.
///
/// Coordinates (`i32` at 0, 4, 8) and intensity (`u16` at 12) are at the same place in every format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordLayout {
    /// Point format, 0 to 10.
    pub point_format: u8,
    /// Bytes of a record, extra bytes included.
    pub record_length: usize,
    /// Formats 6 to 10: four-bit return numbers, scanner channel, 16-bit scan angle.
    pub extended: bool,
    /// Position of the GPS time (`f64`), where the format has it.
    pub gps_time: Option<usize>,
    /// Position of red, green, blue (three `u16`), where the format has them.
    pub colour: Option<usize>,
    /// Position of the near infrared (`u16`), where the format has it.
    pub near_infrared: Option<usize>,
    /// Position of the 29-byte waveform packet reference, where the format has it.
    pub waveform: Option<usize>,
    /// Position of the first extra byte; equal to `record_length` where there are none.
    pub extra_bytes: usize,
}

/// Bytes of a record of each point format without extra bytes.
const STANDARD_LENGTH: [u16; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

impl RecordLayout {
    /// Bytes of a record of `point_format` without extra bytes; `None` for a format above 10.
    #[must_use]
    pub fn standard_length(point_format: u8) -> Option<u16> {
        STANDARD_LENGTH.get(usize::from(point_format)).copied()
    }

    /// The layout of `point_format` with records of `record_length` bytes.
    ///
    /// `None` for a format above 10 and for records shorter than the format.
    #[must_use]
    pub fn new(point_format: u8, record_length: u16) -> Option<Self> {
        let standard = Self::standard_length(point_format)?;
        if record_length < standard {
            return None;
        }
        let (gps_time, colour, near_infrared, waveform) = match point_format {
            1 => (Some(20), None, None, None),
            2 => (None, Some(20), None, None),
            3 => (Some(20), Some(28), None, None),
            4 => (Some(20), None, None, Some(28)),
            5 => (Some(20), Some(28), None, Some(34)),
            6 => (Some(22), None, None, None),
            7 => (Some(22), Some(30), None, None),
            8 => (Some(22), Some(30), Some(36), None),
            9 => (Some(22), None, None, Some(30)),
            10 => (Some(22), Some(30), Some(36), Some(38)),
            _ => (None, None, None, None),
        };
        Some(Self {
            point_format,
            record_length: usize::from(record_length),
            extended: point_format >= 6,
            gps_time,
            colour,
            near_infrared,
            waveform,
            extra_bytes: usize::from(standard),
        })
    }

    /// Extra bytes per record.
    #[must_use]
    pub fn extra_byte_count(&self) -> usize {
        self.record_length - self.extra_bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fields_of_every_format_fill_its_record() {
        for format in 0..=10 {
            let length = RecordLayout::standard_length(format).expect("a known format");
            let layout = RecordLayout::new(format, length).expect("a known format");
            let base = if layout.extended { 22 } else { 20 };
            let sum = base
                + layout.gps_time.map_or(0, |_| 8)
                + layout.colour.map_or(0, |_| 6)
                + layout.near_infrared.map_or(0, |_| 2)
                + layout.waveform.map_or(0, |_| 29);
            assert_eq!(sum, layout.record_length, "format {format}");
            assert_eq!(layout.extra_byte_count(), 0);
        }
    }

    #[test]
    fn a_record_shorter_than_its_format_has_no_layout() {
        assert!(RecordLayout::new(6, 29).is_none());
        assert!(RecordLayout::new(11, 200).is_none());
    }
}
