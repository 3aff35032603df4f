//! The chunks of a file: which points each holds and where its bytes lie, checked against header and file size.

use std::io::Cursor;
use std::ops::Range;

use laz::laszip::ChunkTable;

use super::bytes::{u32_at, u64_at};
use super::codec::LazCodec;
use super::error::LasError;
use super::header::LasHeader;
use super::input::Input;
use super::layout::RecordLayout;

/// Points per block of an uncompressed file.
pub(super) const BLOCK_POINTS: u64 = 50_000;
/// A chunk may grow to this many bytes whatever its compressed size.
const PLAUSIBLE_BYTES: u64 = 256 << 20;
/// Beyond that, uncompressed bytes per compressed byte that are still believed.
const PLAUSIBLE_RATIO: u64 = 2_000;

/// One chunk: its points and its bytes in the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Chunk {
    /// Indices of its points in the file.
    pub(super) points: Range<u64>,
    /// Byte positions in the file.
    pub(super) bytes: Range<u64>,
}

/// Where the chunk table of a compressed file lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TablePlace {
    /// Byte position of the chunk table.
    pub(super) start: u64,
    /// Its position stands in the last eight bytes of the file instead of before the points.
    pub(super) is_named_at_end: bool,
}

/// Blocks of an uncompressed file.
pub(super) fn of_las(input: &Input, header: &LasHeader, layout: RecordLayout) -> Result<Vec<Chunk>, LasError> {
    let length = layout.record_length as u64;
    let room = input.length().saturating_sub(header.point_data_offset) / length;
    if header.point_count > room {
        return Err(LasError::Truncated { path: input.path().into(), expected: header.point_count, found: room });
    }
    let position = |point: u64| header.point_data_offset + point * length;
    let blocks = (0..header.point_count.div_ceil(BLOCK_POINTS)).map(|block| {
        let points = block * BLOCK_POINTS..((block + 1) * BLOCK_POINTS).min(header.point_count);
        Chunk { bytes: position(points.start)..position(points.end), points }
    });
    Ok(blocks.collect())
}

/// Chunks of a compressed file, and where its chunk table lies; files of `LASzip` before 2.0 are one chunk without table.
pub(super) fn of_laz(
    input: &Input,
    header: &LasHeader,
    codec: &LazCodec,
) -> Result<(Vec<Chunk>, Option<TablePlace>), LasError> {
    let corrupt = |found: String, expected: String| LasError::ChunkTable { path: input.path().into(), found, expected };
    if codec.is_one_stream() {
        let end = header.tail_start(input.length());
        check_size(header.point_count, end - header.point_data_offset, codec.least_chunk_bytes())
            .map_err(|(found, expected)| corrupt(format!("its only chunk holds {found}"), expected))?;
        return Ok((vec![Chunk { points: 0..header.point_count, bytes: header.point_data_offset..end }], None));
    }
    let data_start = header.point_data_offset + 8;
    let place = table_place(input, header)?;
    let head = input.read_vec(place.start, 8)?;
    let count = u64::from(u32_at(&head, 4));
    let data_bytes = place.start - data_start;
    let most = data_bytes / codec.least_chunk_bytes() + 1;
    if count == 0 || count > most {
        let expected = format!("1 to {most} in {data_bytes} bytes of points");
        return Err(corrupt(format!("it names {count} chunks"), expected));
    }
    // An entry takes less than 16 bytes: two numbers of 32 bits, each with a byte or two of prefix.
    let table = input.read_vec(place.start, (8 + 16 * count + 64).min(input.length() - place.start))?;
    let is_variable = codec.vlr().uses_variable_size_chunks();
    let table = std::panic::catch_unwind(|| ChunkTable::read(&mut Cursor::new(table.as_slice()), is_variable))
        .map_err(|_| corrupt("it cannot be decoded".to_owned(), "a chunk table".to_owned()))?
        .map_err(|error| corrupt(format!("it cannot be decoded ({error})"), "a chunk table".to_owned()))?;

    let mut chunks = Vec::with_capacity(table.len());
    let (mut point, mut byte) = (0_u64, data_start);
    for (index, entry) in table.into_iter().enumerate() {
        let left = header.point_count - point;
        let points = if is_variable { entry.point_count } else { left.min(u64::from(codec.vlr().chunk_size())) };
        if points > left {
            let expected = format!("{} points as in the header", header.point_count);
            return Err(corrupt(
                format!("its chunks up to {index} hold {} points", u128::from(point) + u128::from(points)),
                expected,
            ));
        }
        let end = byte.checked_add(entry.byte_count).filter(|&end| end <= place.start);
        let Some(end) = end else {
            let expected = format!("an end before the table at byte {}", place.start);
            return Err(corrupt(format!("chunk {index} at byte {byte} has {} bytes", entry.byte_count), expected));
        };
        if points > 0 {
            check_size(points, end - byte, codec.least_chunk_bytes())
                .map_err(|(found, expected)| corrupt(format!("chunk {index} holds {found}"), expected))?;
            chunks.push(Chunk { points: point..point + points, bytes: byte..end });
        } else if !is_variable && end > byte {
            let expected = format!("{index} chunks for {} points", header.point_count);
            return Err(corrupt(format!("it names {count} chunks"), expected));
        }
        (point, byte) = (point + points, end);
    }
    if point != header.point_count {
        return Err(corrupt(
            format!("its chunks hold {point} points"),
            format!("{} as in the header", header.point_count),
        ));
    }
    Ok((chunks, Some(place)))
}

/// Refuses chunks without bytes for a point, and chunks that would claim absurd amounts of memory.
fn check_size(points: u64, bytes: u64, record_length: u64) -> Result<(), (String, String)> {
    if bytes < record_length {
        return Err((format!("{points} points in {bytes} bytes"), format!("{record_length} bytes or more")));
    }
    let uncompressed = points.saturating_mul(record_length);
    if uncompressed > PLAUSIBLE_BYTES.max(bytes.saturating_mul(PLAUSIBLE_RATIO)) {
        let expected = "a ratio below two thousand".to_owned();
        return Err((format!("{uncompressed} bytes of points in {bytes} compressed ones"), expected));
    }
    Ok(())
}

/// Finds the chunk table: its position stands before the points, or at the end of a file that was streamed out.
fn table_place(input: &Input, header: &LasHeader) -> Result<TablePlace, LasError> {
    let (data_start, length) = (header.point_data_offset + 8, input.length());
    if length < data_start + 8 {
        return Err(LasError::TruncatedLaz { path: input.path().into(), expected: data_start, found: length });
    }
    let mut start = u64_at(&input.read_vec(header.point_data_offset, 8)?, 0);
    let is_named_at_end = start < data_start || start > i64::MAX as u64;
    if is_named_at_end {
        start = u64_at(&input.read_vec(length - 8, 8)?, 0);
        if start < data_start || start > length - 8 {
            let found = "its position is named neither before the points nor at the end of the file".to_owned();
            let expected = format!("a position between {data_start} and {length}");
            return Err(LasError::ChunkTable { path: input.path().into(), found, expected });
        }
    }
    if start.checked_add(8).is_none_or(|end| end > length) {
        return Err(LasError::TruncatedLaz { path: input.path().into(), expected: start, found: length });
    }
    Ok(TablePlace { start, is_named_at_end })
}
