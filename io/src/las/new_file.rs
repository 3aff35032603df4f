//! What a new file says about itself: options, their check, and the bytes before the points.

use std::path::Path;

use tieline_filter::TimeEncoding;

use super::codec::{LASZIP_RECORD_ID, LASZIP_USER_ID, LazCodec};
use super::crs_records;
use super::error::LasError;
use super::header::{HEADER_SIZE, position};
use super::layout::RecordLayout;
use super::sink::{put, text_field, vector_field};

/// A variable-length record to be written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VariableRecord {
    /// Definer, at most 16 bytes.
    pub user_id: String,
    /// Number within the definer's range.
    pub record_id: u16,
    /// Free text, at most 32 bytes.
    pub description: String,
    /// Contents; at most 65 535 bytes before the points.
    pub contents: Vec<u8>,
}

/// An attribute beyond the point format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExtraBytes {
    /// Name, at most 32 bytes.
    pub name: String,
    /// Description, at most 32 bytes.
    pub description: String,
    /// Data type of LAS 1.4: 1 `u8`, 2 `i8`, 3 `u16`, 4 `i16`, 5 `u32`, 6 `i32`, 7 `u64`, 8 `i64`, 9 `f32`, 10 `f64`.
    pub data_type: u8,
}

impl ExtraBytes {
    /// Bytes per point; `None` for an unknown data type.
    fn size(&self) -> Option<u16> {
        [1, 1, 2, 2, 4, 4, 8, 8, 4, 8].get(usize::from(self.data_type).checked_sub(1)?).copied()
    }
}

/// What a new file says about itself.
#[derive(Debug, Clone, PartialEq)]
pub struct LasWriterOptions {
    /// Version: 1.0 to 1.4.
    pub version: (u8, u8),
    /// Point format: 0 and 1 in every version, 2 and 3 from 1.2, 4 and 5 from 1.3, 6 to 10 in 1.4.
    pub point_format: u8,
    /// Scale \[m\].
    pub scale: [f64; 3],
    /// Offset \[m\].
    pub offset: [f64; 3],
    /// What the GPS times are.
    pub time: TimeEncoding,
    /// Coordinate reference system as WKT.
    pub wkt: Option<String>,
    /// System identifier, at most 32 bytes.
    pub system_identifier: String,
    /// Generating software, at most 32 bytes.
    pub generating_software: String,
    /// File source id.
    pub file_source_id: u16,
    /// Day of the year and year of creation.
    pub creation: (u16, u16),
    /// Attributes beyond the point format; their values come with [`LasWriter::write_records`].
    pub extra_bytes: Vec<ExtraBytes>,
    /// Further records before the points.
    pub vlrs: Vec<VariableRecord>,
    /// Records after the points (LAS 1.4).
    pub evlrs: Vec<VariableRecord>,
}

impl Default for LasWriterOptions {
    fn default() -> Self {
        Self {
            version: (1, 4),
            point_format: 6,
            scale: [0.001; 3],
            offset: [0.0; 3],
            time: TimeEncoding::AdjustedStandard,
            wkt: None,
            system_identifier: String::new(),
            generating_software: concat!("tieline ", env!("CARGO_PKG_VERSION")).to_owned(),
            file_source_id: 0,
            creation: (0, 0),
            extra_bytes: Vec::new(),
            vlrs: Vec::new(),
            evlrs: Vec::new(),
        }
    }
}

/// Refuses versions, formats and extra bytes that do not go together.
pub(super) fn checked_layout(path: &Path, options: &LasWriterOptions) -> Result<RecordLayout, LasError> {
    let least_minor = match options.point_format {
        0 | 1 => 0,
        2 | 3 => 2,
        4 | 5 => 3,
        6..=10 => 4,
        format => return Err(LasError::UnknownPointFormat { path: path.into(), format }),
    };
    let (major, minor) = options.version;
    if major != 1 || !(least_minor..=4).contains(&minor) {
        let expected = format!("1.{least_minor} to 1.4 for point format {}", options.point_format);
        return Err(unwritable(path, "version", format!("{major}.{minor}"), expected));
    }
    if minor < 4 && !options.evlrs.is_empty() {
        return Err(unwritable(path, "version with EVLRs", format!("1.{minor}"), "1.4".to_owned()));
    }
    let grid_is_sound = options.scale.iter().all(|scale| scale.is_finite() && *scale > 0.0)
        && options.offset.iter().all(|offset| offset.is_finite());
    if !grid_is_sound {
        let found = format!("{:?} and {:?}", options.scale, options.offset);
        return Err(unwritable(path, "scale and offset", found, "positive and finite numbers".to_owned()));
    }
    let mut length = RecordLayout::standard_length(options.point_format);
    for extra in &options.extra_bytes {
        length = length.and_then(|length| length.checked_add(extra.size()?));
    }
    let layout = length.and_then(|length| RecordLayout::new(options.point_format, length));
    layout.ok_or_else(|| {
        let found = format!("{:?}", options.extra_bytes);
        unwritable(path, "extra bytes", found, "data types 1 to 10, at most 65 535 bytes".to_owned())
    })
}

/// Header, with the counts still zero, and variable-length records.
pub(super) fn new_head(
    path: &Path,
    options: &LasWriterOptions,
    layout: RecordLayout,
    codec: Option<&LazCodec>,
) -> Result<Vec<u8>, LasError> {
    let records = records_of(path, options, codec)?;
    let mut body = Vec::new();
    for record in &records {
        let length = u16::try_from(record.contents.len()).map_err(|_| {
            let found = format!("{} bytes", record.contents.len());
            unwritable(path, "variable-length record", found, "at most 65 535 bytes; take an EVLR".to_owned())
        })?;
        body.extend([0; 2]);
        body.extend(text_field::<16>(&record.user_id));
        body.extend(record.record_id.to_le_bytes());
        body.extend(length.to_le_bytes());
        body.extend(text_field::<32>(&record.description));
        body.extend(&record.contents);
    }
    let header_size = HEADER_SIZE[usize::from(options.version.1)];
    let mut head = vec![0; usize::from(header_size)];
    let (is_adjusted, has_wkt) = (options.time == TimeEncoding::AdjustedStandard, options.version.1 >= 4);
    let has_wkt = has_wkt && (options.wkt.is_some() || layout.extended);
    let too_many = |what| unwritable(path, what, "more than a u32 can count".to_owned(), "fewer".to_owned());
    let points_at = u32::try_from(head.len() + body.len()).map_err(|_| too_many("variable-length records"))?;
    let record_length = u16::try_from(layout.record_length).map_err(|_| too_many("extra bytes"))?;
    let vlr_count = u32::try_from(records.len()).map_err(|_| too_many("variable-length records"))?;
    put(&mut head, 0, b"LASF");
    put(&mut head, 4, &options.file_source_id.to_le_bytes());
    put(&mut head, 6, &(u16::from(is_adjusted) | (u16::from(has_wkt) << 4)).to_le_bytes());
    put(&mut head, 24, &[options.version.0, options.version.1]);
    put(&mut head, 26, &text_field::<32>(&options.system_identifier));
    put(&mut head, position::GENERATING_SOFTWARE, &text_field::<32>(&options.generating_software));
    put(&mut head, 90, &options.creation.0.to_le_bytes());
    put(&mut head, 92, &options.creation.1.to_le_bytes());
    put(&mut head, 94, &header_size.to_le_bytes());
    put(&mut head, position::POINT_DATA_OFFSET, &points_at.to_le_bytes());
    put(&mut head, position::VLR_COUNT, &vlr_count.to_le_bytes());
    put(&mut head, 104, &[layout.point_format | if codec.is_some() { 0x80 } else { 0 }]);
    put(&mut head, 105, &record_length.to_le_bytes());
    put(&mut head, position::SCALE, &vector_field(options.scale));
    put(&mut head, position::OFFSET, &vector_field(options.offset));
    if options.version.1 >= 4 {
        let evlr_count = u32::try_from(options.evlrs.len()).map_err(|_| too_many("EVLRs"))?;
        put(&mut head, position::EVLR_COUNT, &evlr_count.to_le_bytes());
    }
    head.extend(body);
    Ok(head)
}

/// The records before the points: CRS, extra bytes, the caller's own, compression.
fn records_of(
    path: &Path,
    options: &LasWriterOptions,
    codec: Option<&LazCodec>,
) -> Result<Vec<VariableRecord>, LasError> {
    let new = |user_id: &str, record_id, description: &str, contents| VariableRecord {
        user_id: user_id.to_owned(),
        record_id,
        description: description.to_owned(),
        contents,
    };
    let mut records = Vec::new();
    if let Some(wkt) = &options.wkt {
        let contents = wkt.bytes().chain([0]).collect();
        records.push(new(crs_records::USER_ID, crs_records::WKT, "OGC coordinate system WKT", contents));
    }
    if !options.extra_bytes.is_empty() {
        let mut contents = Vec::new();
        for extra in &options.extra_bytes {
            contents.extend([0, 0, extra.data_type, 0]);
            contents.extend(text_field::<32>(&extra.name));
            contents.extend([0; 124]);
            contents.extend(text_field::<32>(&extra.description));
        }
        records.push(new("LASF_Spec", 4, "Extra bytes", contents));
    }
    records.extend(options.vlrs.iter().cloned());
    if let Some(codec) = codec {
        let mut contents = Vec::new();
        let written = codec.vlr().write_to(&mut contents);
        written.map_err(|source| LasError::Io { path: path.into(), action: "describe its compression", source })?;
        records.push(new(LASZIP_USER_ID, LASZIP_RECORD_ID, laz::LazVlr::DESCRIPTION, contents));
    }
    Ok(records)
}

/// The error of options or columns that LAS cannot hold.
pub(super) fn unwritable(path: &Path, what: &'static str, found: String, expected: String) -> LasError {
    LasError::Unwritable { path: path.into(), what, found, expected }
}
