//! The public header block of LAS 1.0 to 1.4, checked before anything else is read.

use std::path::Path;

use super::bytes::{f64_at, text_at, u16_at, u32_at, u64_at};
use super::crs_records::{self, GeoKeys};
use super::error::LasError;
use super::layout::RecordLayout;
use super::vlr::VlrSummary;

/// Byte positions of header fields that are patched when a file is written.
pub(super) mod position {
    pub(in super::super) const GENERATING_SOFTWARE: usize = 58;
    pub(in super::super) const POINT_DATA_OFFSET: usize = 96;
    pub(in super::super) const VLR_COUNT: usize = 100;
    pub(in super::super) const SCALE: usize = 131;
    pub(in super::super) const OFFSET: usize = 155;
    pub(in super::super) const BOUNDS: usize = 179;
    pub(in super::super) const WAVEFORM_START: usize = 227;
    pub(in super::super) const EVLR_START: usize = 235;
    pub(in super::super) const EVLR_COUNT: usize = 243;
}

/// Bytes of the header of each minor version, 1.0 to 1.4.
pub(super) const HEADER_SIZE: [u16; 5] = [227, 227, 227, 235, 375];

/// Names of the axes, in the order of every `[f64; 3]` of this module.
pub(super) const AXES: [char; 3] = ['x', 'y', 'z'];

/// What a LAS file says about itself.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LasHeader {
    /// Major and minor version.
    pub version: (u8, u8),
    /// File source id; for an original flight line its number.
    pub file_source_id: u16,
    /// Global encoding bits: 0 adjusted standard GPS time, 1 internal waveforms, 2 external waveforms,
    /// 3 synthetic return numbers, 4 CRS as WKT.
    pub global_encoding: u16,
    /// System identifier.
    pub system_identifier: String,
    /// Generating software.
    pub generating_software: String,
    /// Day of the year of creation, 1-based; 0 where not given.
    pub creation_day: u16,
    /// Year of creation; 0 where not given.
    pub creation_year: u16,
    /// Point format, 0 to 10.
    pub point_format: u8,
    /// Bytes of an uncompressed point record.
    pub record_length: u16,
    /// Number of points.
    pub point_count: u64,
    /// Number of points by return, first return first; five entries before LAS 1.4, fifteen from then on.
    pub points_by_return: Vec<u64>,
    /// Scale factors of x, y, z: metres per unit of the stored integers.
    pub scale: [f64; 3],
    /// Offsets of x, y, z \[m\].
    pub offset: [f64; 3],
    /// Least x, y, z \[m\], as the header states them.
    pub min: [f64; 3],
    /// Greatest x, y, z \[m\], as the header states them.
    pub max: [f64; 3],
    /// The points are compressed (LAZ).
    pub is_compressed: bool,
    /// The file is a cloud-optimised point cloud (COPC).
    pub is_copc: bool,
    /// Extra bytes per point, after the fields of the format.
    pub extra_bytes_per_point: u16,
    /// Byte position of the point data.
    pub point_data_offset: u64,
    /// Byte position of the waveform packets in this file; 0 where there are none.
    pub waveform_start: u64,
    /// Byte position of the first extended variable-length record; 0 where there are none.
    pub evlr_start: u64,
    /// Variable-length records, extended ones last.
    pub vlrs: Vec<VlrSummary>,
    /// Coordinate reference system as WKT (record 2112).
    pub wkt: Option<String>,
    /// Coordinate reference system as `GeoTIFF` keys.
    pub geokeys: Option<GeoKeys>,
    /// EPSG code of the horizontal reference system, from WKT, else from the `GeoTIFF` keys.
    pub epsg: Option<u32>,
    /// Number of variable-length records before the points.
    pub(super) vlr_count: u32,
    /// Number of extended variable-length records after the points.
    pub(super) evlr_count: u32,
    /// Bytes of the header itself.
    pub(super) header_size: u16,
}

impl LasHeader {
    /// Parses the first bytes of a file and checks every field that later work relies on.
    ///
    /// The variable-length records are added by [`LasHeader::take_records`].
    pub(super) fn parse(path: &Path, bytes: &[u8], file_length: u64) -> Result<Self, LasError> {
        if !bytes.starts_with(b"LASF") {
            let found = String::from_utf8_lossy(&bytes[..bytes.len().min(4)]).into_owned();
            return Err(LasError::NotLas { path: path.into(), found });
        }
        let cut =
            |expected: u16| LasError::HeaderCut { path: path.into(), found: file_length, expected: expected.into() };
        if bytes.len() < 26 {
            return Err(cut(HEADER_SIZE[0]));
        }
        let version = (bytes[24], bytes[25]);
        let expected_size = match version {
            (1, minor @ 0..=4) => HEADER_SIZE[usize::from(minor)],
            (major, minor) => return Err(LasError::UnsupportedVersion { path: path.into(), major, minor }),
        };
        if bytes.len() < usize::from(expected_size) {
            return Err(cut(expected_size));
        }
        let (has_waveform, has_evlr) = (version.1 >= 3, version.1 >= 4);
        let legacy_count = u64::from(u32_at(bytes, 107));
        let long_count = if has_evlr { u64_at(bytes, 247) } else { 0 };
        let vector = |at: usize| [f64_at(bytes, at), f64_at(bytes, at + 8), f64_at(bytes, at + 16)];
        let bound = |at: usize| [f64_at(bytes, at), f64_at(bytes, at + 16), f64_at(bytes, at + 32)];
        let header = Self {
            version,
            file_source_id: u16_at(bytes, 4),
            global_encoding: u16_at(bytes, 6),
            system_identifier: text_at(bytes, 26, 32),
            generating_software: text_at(bytes, position::GENERATING_SOFTWARE, 32),
            creation_day: u16_at(bytes, 90),
            creation_year: u16_at(bytes, 92),
            point_format: bytes[104] & 0b0011_1111,
            record_length: u16_at(bytes, 105),
            point_count: if long_count == 0 { legacy_count } else { long_count },
            points_by_return: if has_evlr && long_count > 0 {
                (0..15).map(|index| u64_at(bytes, 255 + 8 * index)).collect()
            } else {
                (0..5).map(|index| u64::from(u32_at(bytes, 111 + 4 * index))).collect()
            },
            scale: vector(position::SCALE),
            offset: vector(position::OFFSET),
            max: bound(position::BOUNDS),
            min: bound(position::BOUNDS + 8),
            is_compressed: bytes[104] & 0b1100_0000 != 0,
            is_copc: false,
            extra_bytes_per_point: 0,
            point_data_offset: u64::from(u32_at(bytes, position::POINT_DATA_OFFSET)),
            waveform_start: if has_waveform { u64_at(bytes, position::WAVEFORM_START) } else { 0 },
            evlr_start: if has_evlr { u64_at(bytes, position::EVLR_START) } else { 0 },
            vlrs: Vec::new(),
            wkt: None,
            geokeys: None,
            epsg: None,
            vlr_count: u32_at(bytes, position::VLR_COUNT),
            evlr_count: if has_evlr { u32_at(bytes, position::EVLR_COUNT) } else { 0 },
            header_size: u16_at(bytes, 94),
        };
        header.check(path, expected_size, file_length)?;
        Ok(header)
    }

    /// Refuses values that no later step could work with.
    fn check(&self, path: &Path, expected_size: u16, file_length: u64) -> Result<(), LasError> {
        let field = |field, found: String, expected: String| {
            Err(LasError::HeaderField { path: path.into(), field, found, expected })
        };
        if self.header_size < expected_size {
            return field("header size", self.header_size.to_string(), format!("{expected_size} bytes or more"));
        }
        if self.point_data_offset < u64::from(self.header_size) {
            let expected = format!("a position after the header of {} bytes", self.header_size);
            return field("offset to point data", self.point_data_offset.to_string(), expected);
        }
        let Some(minimum) = RecordLayout::standard_length(self.point_format) else {
            return Err(LasError::UnknownPointFormat { path: path.into(), format: self.point_format });
        };
        if self.record_length < minimum {
            return Err(LasError::RecordLength {
                path: path.into(),
                format: self.point_format,
                found: self.record_length,
                expected: minimum,
            });
        }
        for (axis, &found) in AXES.iter().zip(&self.scale) {
            if !found.is_finite() || found <= 0.0 {
                return Err(LasError::Scale { path: path.into(), axis: *axis, found });
            }
        }
        for (field, values) in [("offset", &self.offset), ("min bound", &self.min), ("max bound", &self.max)] {
            if let Some(&found) = values.iter().find(|value| !value.is_finite()) {
                return Err(LasError::NotFinite { path: path.into(), field, found });
            }
        }
        if self.point_count == 0 {
            return Err(LasError::NoPoints { path: path.into() });
        }
        if self.point_data_offset >= file_length {
            let expected = format!("a position in the file of {file_length} bytes (a whole file is longer)");
            return field("offset to point data", self.point_data_offset.to_string(), expected);
        }
        if self.evlr_count > 0 && self.evlr_start < self.point_data_offset {
            let expected = format!("a position after the points, which start at byte {}", self.point_data_offset);
            return field("start of first EVLR", self.evlr_start.to_string(), expected);
        }
        Ok(())
    }

    /// Takes over the variable-length records, given with their contents, and what they say about the CRS.
    pub(super) fn take_records(&mut self, records: Vec<(VlrSummary, Vec<u8>)>) {
        self.is_copc = records.first().is_some_and(|(summary, _)| summary.is("copc", 1));
        let find = |record_id: u16| {
            let found = records.iter().find(|(summary, _)| summary.is(crs_records::USER_ID, record_id));
            found.map(|(_, contents)| contents.as_slice())
        };
        self.wkt = find(crs_records::WKT).map(crs_records::wkt_text).filter(|wkt| !wkt.is_empty());
        self.geokeys = find(crs_records::GEO_KEYS)
            .map(|directory| GeoKeys::parse(directory, find(crs_records::GEO_DOUBLES), find(crs_records::GEO_ASCII)));
        let from_wkt = self.wkt.as_deref().and_then(crs_records::epsg_of_wkt);
        self.epsg = from_wkt.or_else(|| self.geokeys.as_ref().and_then(GeoKeys::epsg));
        self.vlrs = records.into_iter().map(|(summary, _)| summary).collect();
    }

    /// Byte position of what follows the points of a file of `file_length` bytes: extended records, waveforms.
    pub(super) fn tail_start(&self, file_length: u64) -> u64 {
        let named = [self.waveform_start, if self.evlr_count > 0 { self.evlr_start } else { 0 }];
        let after_points = |&start: &u64| start > self.point_data_offset && start < file_length;
        named.into_iter().filter(after_points).min().unwrap_or(file_length)
    }

    /// True where the header says that GPS times are adjusted standard time.
    #[must_use]
    pub fn says_adjusted_time(&self) -> bool {
        self.global_encoding & 1 == 1
    }
}
