//! What matching is fed with: blocks of points in columns, and the rule that tells their sources apart.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// A block of points in columns, as they lie in a file: integers, their scale and offset, raw times.
///
/// All slices have one length. Matching takes blocks in any order and from any number of threads.
#[derive(Debug, Clone, Copy)]
pub struct PointBlock<'a> {
    /// Raw integer coordinates.
    pub x: &'a [i32],
    /// Raw integer coordinates.
    pub y: &'a [i32],
    /// Raw integer coordinates.
    pub z: &'a [i32],
    /// Metres per integer step.
    pub scale_m: [f64; 3],
    /// Metres added after scaling.
    pub offset_m: [f64; 3],
    /// GPS time as in the file \[s\].
    pub gps_time_s: &'a [f64],
    /// Added to the file's time to have survey time \[s\].
    pub time_shift_s: f64,
    /// Return number, from 1.
    pub return_number: &'a [u8],
    /// Returns of the pulse.
    pub number_of_returns: &'a [u8],
    /// ASPRS class.
    pub classification: &'a [u8],
    /// Bit 2: withheld.
    pub flags: &'a [u8],
    /// Scan angle \[deg\], sign as in the file.
    pub scan_angle_deg: &'a [f32],
    /// User data.
    pub user_data: &'a [u8],
    /// Point source id.
    pub point_source_id: &'a [u16],
    /// Scanner channel of LAS 1.4.
    pub scanner_channel: &'a [u8],
    /// Intensity.
    pub intensity: &'a [u16],
    /// Number of the file in the survey.
    pub file: u16,
    /// Index of the block's first point in its file.
    pub first_point: u64,
}

impl PointBlock<'_> {
    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.x.len()
    }
    /// Whether the block is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }
}

/// Files with this number or a higher one are control surfaces: each is a source of its own.
pub const CONTROL_FILE: u16 = 0x8000;

/// Which fields tell strips apart (a time gap does so as well, see [`crate::strip`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SourceRule {
    /// Points of different files belong to different strips.
    pub by_file: bool,
    /// Points of different point source ids belong to different strips.
    pub by_point_source_id: bool,
    /// Where the number of the scanner stands.
    pub scanner: ScannerField,
}

/// Where the number of the scanner stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScannerField {
    /// One scanner.
    Single,
    /// The scanner channel of LAS 1.4.
    Channel,
    /// The user data byte.
    UserData,
    /// One file a scanner.
    File,
}

/// What tells the origin of a point before strips are known: file, point source id and scanner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Pod, Zeroable, Serialize, Deserialize)]
#[repr(transparent)]
pub struct SourceKey(pub u64);

impl SourceKey {
    /// Packs the three numbers; those that the rule ignores are 0.
    #[must_use]
    pub fn new(file: u16, point_source_id: u16, scanner: u16) -> Self {
        Self((u64::from(file) << 32) | (u64::from(point_source_id) << 16) | u64::from(scanner))
    }
    /// Number of the file, 0 when files do not tell strips apart.
    #[must_use]
    pub fn file(self) -> u16 {
        ((self.0 >> 32) & 0xffff) as u16
    }
    /// Point source id, 0 when it does not tell strips apart.
    #[must_use]
    pub fn point_source_id(self) -> u16 {
        ((self.0 >> 16) & 0xffff) as u16
    }
    /// Raw number of the scanner as it stands in the field.
    #[must_use]
    pub fn scanner(self) -> u16 {
        (self.0 & 0xffff) as u16
    }
    /// The same source without its scanner: what a strip is told by.
    #[must_use]
    pub fn without_scanner(self) -> Self {
        Self(self.0 & !0xffff)
    }
}

impl SourceRule {
    /// The source of point `i` of a block.
    #[must_use]
    #[inline]
    pub fn source(&self, block: &PointBlock<'_>, i: usize) -> SourceKey {
        self.source_of(block.file, block.point_source_id[i], block.scanner_channel[i], block.user_data[i])
    }

    /// The source of a point with these fields.
    #[must_use]
    #[inline]
    pub fn source_of(&self, file: u16, point_source_id: u16, scanner_channel: u8, user_data: u8) -> SourceKey {
        if file >= CONTROL_FILE {
            return SourceKey::new(file, 0, 0);
        }
        let scanner = match self.scanner {
            ScannerField::Single => 0,
            ScannerField::Channel => u16::from(scanner_channel),
            ScannerField::UserData => u16::from(user_data),
            ScannerField::File => file,
        };
        SourceKey::new(
            if self.by_file { file } else { 0 },
            if self.by_point_source_id { point_source_id } else { 0 },
            scanner,
        )
    }
}

/// Which points may take part in a patch.
#[derive(Debug, Clone, PartialEq)]
pub struct PointFilter {
    /// Which returns.
    pub returns: Returns,
    /// One bit per ASPRS class that is left out.
    pub excluded_classes: [bool; 256],
    /// One bit per ASPRS class that is taken; all when none was named.
    pub included_classes: Option<Box<[bool; 256]>>,
    /// Largest |scan angle| \[deg\].
    pub max_scan_angle_deg: f32,
}

/// Which returns may take part in a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Returns {
    /// Single and last returns: what reaches the ground or a roof.
    Last,
    /// Single returns only: what met one surface.
    Single,
    /// All.
    All,
}

impl Default for PointFilter {
    fn default() -> Self {
        let mut excluded_classes = [false; 256];
        for class in [7, 18] {
            excluded_classes[class] = true; // low and high noise
        }
        excluded_classes[9] = true; // water
        Self { returns: Returns::Last, excluded_classes, included_classes: None, max_scan_angle_deg: 180.0 }
    }
}

impl PointFilter {
    /// Whether point `i` of the block may take part.
    #[must_use]
    pub fn takes(&self, block: &PointBlock<'_>, i: usize) -> bool {
        let (r, n) = (block.return_number[i], block.number_of_returns[i]);
        let right_return = match self.returns {
            Returns::Last => r >= n,
            Returns::Single => n <= 1,
            Returns::All => true,
        };
        let class = usize::from(block.classification[i]);
        right_return
            && !self.excluded_classes[class]
            && self.included_classes.as_ref().is_none_or(|set| set[class])
            && block.flags[i] & 0b100 == 0
            && block.scan_angle_deg[i].abs() <= self.max_scan_angle_deg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_key_gives_back_what_it_was_made_of() {
        let key = SourceKey::new(12, 10_102, 7);
        assert_eq!((key.file(), key.point_source_id(), key.scanner()), (12, 10_102, 7));
        assert_eq!(key.without_scanner(), SourceKey::new(12, 10_102, 0));
    }
}
