//! One LAZ chunk in, raw records out, and back: the door to the `laz` crate.

use std::any::Any;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use laz::record::{
    LayeredPointRecordCompressor, LayeredPointRecordDecompressor, RecordCompressor, RecordDecompressor,
    SequentialPointRecordCompressor, SequentialPointRecordDecompressor,
};
use laz::{DecompressionSelection, LazItemRecordBuilder, LazItemType, LazVlr, LazVlrBuilder};

use super::bytes::{u16_at, u32_at};
use super::layout::RecordLayout;

/// Definer and number of the record that describes the compression.
pub(super) const LASZIP_USER_ID: &str = LazVlr::USER_ID;
pub(super) const LASZIP_RECORD_ID: u16 = LazVlr::RECORD_ID;

/// Compressor type of `LASzip` before 2.0: one stream of points, no chunk table.
const POINT_WISE: u16 = 1;
/// Compressor types that work in chunks.
const CHUNKED: u16 = 2;
const LAYERED_CHUNKED: u16 = 3;
/// Bytes of the arithmetic decoder's window: it may leave so many of a chunk unread, never more.
const DECODER_WINDOW: u64 = 4;

/// Which fields of a chunk are to be decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wanted {
    /// Every byte.
    Everything,
    /// What [`super::Columns`] holds: neither colours, waveform references nor extra bytes.
    Columns,
}

impl Wanted {
    fn selection(self) -> DecompressionSelection {
        let all = DecompressionSelection::all();
        match self {
            Self::Everything => all,
            Self::Columns => all.skip_rgb().skip_nir().skip_wavepacket().skip_extra_bytes(),
        }
    }
}

/// Compresses and decompresses the chunks of one file.
#[derive(Debug)]
pub(super) struct LazCodec {
    vlr: LazVlr,
    /// Fields lie in layers of their own (point formats 6 to 10).
    is_layered: bool,
    /// Number of layers of a layered chunk.
    layers: usize,
    record_length: usize,
    /// All points form one chunk, and there is no chunk table (`LASzip` before 2.0).
    is_one_stream: bool,
}

impl LazCodec {
    /// The codec that the contents of a file's `LASzip` record describe; `Err` with the reason why there is none.
    pub(super) fn from_record(contents: &[u8], layout: RecordLayout) -> Result<Self, String> {
        match u16_at(contents, 0) {
            0 => return Err("it says that the points are not compressed".to_owned()),
            POINT_WISE | CHUNKED | LAYERED_CHUNKED => {}
            other => return Err(format!("compressor type {other} is unknown")),
        }
        let vlr = LazVlr::from_buffer(contents).map_err(|error| error.to_string())?;
        if vlr.items().is_empty() {
            return Err("it describes no fields".to_owned());
        }
        Self::of_vlr(vlr, layout, u16_at(contents, 0) == POINT_WISE)
    }

    /// A codec for new files: the current compression of the format, chunks of `chunk_size` points.
    pub(super) fn new(layout: RecordLayout, chunk_size: u32) -> Result<Self, String> {
        let extra = u16::try_from(layout.extra_byte_count()).map_err(|error| error.to_string())?;
        let builder = LazVlrBuilder::default().with_point_format(layout.point_format, extra);
        let vlr = builder.map_err(|error| error.to_string())?.with_fixed_chunk_size(chunk_size).build();
        Self::of_vlr(readable_by_laszip(&vlr)?, layout, false)
    }

    fn of_vlr(vlr: LazVlr, layout: RecordLayout, is_one_stream: bool) -> Result<Self, String> {
        let extra = u16::try_from(layout.extra_byte_count()).map_err(|error| error.to_string())?;
        let expected = LazItemRecordBuilder::default_for_point_format_id(layout.point_format, extra)
            .map_err(|error| error.to_string())?;
        let kinds =
            |items: &[laz::LazItem]| items.iter().map(|item| (item.item_type(), item.size())).collect::<Vec<_>>();
        if kinds(vlr.items()) != kinds(&expected) {
            let (format, length) = (layout.point_format, layout.record_length);
            return Err(format!("its fields are not those of point format {format} with {length} bytes"));
        }
        let version = vlr.items()[0].version(); // not empty: equal to `expected`
        let is_layered = layout.extended;
        let known = if is_layered { 3..=4 } else { 1..=2 };
        if !vlr.items().iter().all(|item| known.contains(&item.version())) {
            return Err(format!("item version {version} is unknown"));
        }
        let layers = vlr.items().iter().map(|item| layers_of(item.item_type())).sum();
        Ok(Self { vlr, is_layered, layers, record_length: layout.record_length, is_one_stream })
    }

    /// The `LASzip` record.
    pub(super) fn vlr(&self) -> &LazVlr {
        &self.vlr
    }

    /// All points form one chunk, and there is no chunk table.
    pub(super) fn is_one_stream(&self) -> bool {
        self.is_one_stream
    }

    /// Least bytes of a compressed chunk: its first point is stored as it is.
    pub(super) fn least_chunk_bytes(&self) -> u64 {
        self.record_length as u64
    }

    /// Decompresses the first points of a chunk that holds `points` into `records`, as many as fit it.
    ///
    /// Formats 6 to 10 skip what is not wanted: such fields then repeat those of the first point.
    pub(super) fn decode(&self, chunk: &[u8], points: u64, wanted: Wanted, records: &mut [u8]) -> Result<(), String> {
        if self.is_layered {
            self.check_layers(chunk, points)?;
        }
        let read = catch_unwind(AssertUnwindSafe(|| {
            let mut source = Cursor::new(chunk);
            if self.is_layered {
                let mut decoder = LayeredPointRecordDecompressor::new(&mut source);
                decoder.set_fields_from(self.vlr.items())?;
                decoder.set_selection(wanted.selection());
                decoder.decompress_many(records)?;
            } else {
                let mut decoder = SequentialPointRecordDecompressor::new(&mut source);
                decoder.set_fields_from(self.vlr.items())?;
                decoder.decompress_many(records)?;
            }
            Ok::<u64, laz::LasZipError>(source.position())
        }));
        let read = read.map_err(|panic| panic_text(&*panic))?.map_err(|error| decode_text(&error))?;
        let is_whole = !self.is_one_stream && records.len() as u64 == points.saturating_mul(self.record_length as u64);
        if is_whole && points > 1 && read + DECODER_WINDOW < chunk.len() as u64 {
            return Err(format!("its points end at byte {read} of {}", chunk.len()));
        }
        Ok(())
    }

    /// Compresses whole records into one chunk, appended to `chunk`.
    pub(super) fn encode(&self, records: &[u8], chunk: &mut Vec<u8>) -> Result<(), String> {
        let done = catch_unwind(AssertUnwindSafe(|| {
            if self.is_layered {
                let mut encoder = LayeredPointRecordCompressor::new(chunk);
                encoder.set_fields_from(self.vlr.items())?;
                encoder.compress_many(records)?;
                encoder.done()?;
            } else {
                let mut encoder = SequentialPointRecordCompressor::new(chunk);
                encoder.set_fields_from(self.vlr.items())?;
                encoder.compress_many(records)?;
                encoder.done()?;
            }
            Ok::<(), laz::LasZipError>(())
        }));
        done.map_err(|panic| panic_text(&*panic))?.map_err(|error| error.to_string())
    }

    /// Compares the head of a layered chunk with its size, before the decoder reserves memory for the layers.
    ///
    /// First record, point count (`u32`), size of each layer (`u32`), then the layers.
    fn check_layers(&self, chunk: &[u8], points: u64) -> Result<(), String> {
        let head = self.record_length + 4 + 4 * self.layers;
        if chunk.len() < head {
            return Err(format!("{} bytes, its head alone has {head}", chunk.len()));
        }
        let count = u64::from(u32_at(chunk, self.record_length));
        if count != points {
            return Err(format!("it holds {count} points, the chunk table says {points}"));
        }
        let sizes = (0..self.layers).map(|layer| u64::from(u32_at(chunk, self.record_length + 4 + 4 * layer)));
        let expected = head as u64 + sizes.sum::<u64>();
        if expected != chunk.len() as u64 {
            return Err(format!("its layers end at byte {expected} of {}", chunk.len()));
        }
        Ok(())
    }
}

/// The same record with waveform references of formats 4 and 5 in item version 1: the `laz` crate would write
/// version 2, the same bytes, which `LASzip` 3.5 refuses.
fn readable_by_laszip(vlr: &LazVlr) -> Result<LazVlr, String> {
    /// Byte position of the first item, and of its version within it.
    const ITEMS: usize = 34;
    const VERSION: usize = 4;
    let mut contents = Vec::new();
    vlr.write_to(&mut contents).map_err(|error| error.to_string())?;
    for item in contents[ITEMS..].chunks_exact_mut(6) {
        if u16_at(item, 0) == u16::from(LazItemType::WavePacket13) {
            item[VERSION..].copy_from_slice(&1_u16.to_le_bytes());
        }
    }
    LazVlr::from_buffer(contents).map_err(|error| error.to_string())
}

/// Layers that a field of formats 6 to 10 is stored in.
fn layers_of(item: LazItemType) -> usize {
    match item {
        LazItemType::Point14 => 9,
        LazItemType::RGBNIR14 => 2,
        LazItemType::RGB14 | LazItemType::WavePacket14 => 1,
        LazItemType::Byte14(count) => usize::from(count),
        _ => 0,
    }
}

/// What an error of the decoder means.
fn decode_text(error: &laz::LasZipError) -> String {
    match error {
        laz::LasZipError::IoError(io) if io.kind() == std::io::ErrorKind::UnexpectedEof => {
            "its compressed bytes end before its points do".to_owned()
        }
        other => other.to_string(),
    }
}

/// What a panic of the decoder said.
fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    format!("the decoder gave up: {}", text.unwrap_or("no reason given"))
}
