//! A file written again with other coordinates and everything else as it was.

use std::cell::RefCell;
use std::error::Error;
use std::ops::Range;
use std::path::Path;

use rayon::prelude::*;

use super::error::LasError;
use super::file::LasFile;
use super::header::position;
use super::layout::RecordLayout;
use super::quantise::{Grid, StoredBounds};
use super::sink::{Sink, bounds_field, put, text_field, vector_field};

/// Chunks in work at a time; bounds the memory. More only where there are more threads.
const BATCH: usize = 48;
/// Bytes of the tail copied at a time.
const COPY_BYTES: u64 = 1 << 20;

thread_local! {
    /// Records and coordinates of the chunk that a thread works on.
    static SCRATCH: RefCell<(Vec<u8>, Vec<[f64; 3]>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// What may change in a rewritten file beside the coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct RewriteOptions {
    /// Scale \[m\] of the output; see [`super::output_scale`].
    pub scale: [f64; 3],
    /// Offset \[m\] of the output; see [`super::output_offset`].
    pub offset: [f64; 3],
    /// Generating software, at most 32 bytes.
    pub generating_software: String,
}

/// What was written.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RewriteReport {
    /// Number of points.
    pub points: u64,
    /// Length \[bytes\] of the file.
    pub file_length: u64,
    /// Least x, y, z \[m\].
    pub min: [f64; 3],
    /// Greatest x, y, z \[m\].
    pub max: [f64; 3],
    /// What is no longer as in the input, beside the coordinates and the header fields that follow from them.
    pub notes: Vec<String>,
}

/// The error that an edit may return.
pub type EditError = Box<dyn Error + Send + Sync>;

/// Writes `input` again as `output`, with coordinates changed by `edit`.
///
/// Same points in the same order, every attribute, extra byte, waveform reference and time bit, every
/// variable-length record; LAS stays LAS, LAZ stays LAZ with the same chunks. In the header change: scale, offset,
/// bounds, generating software, and positions that follow from the compressed size. COPC becomes plain LAZ, for its
/// octree would no longer fit: its two records are left out.
///
/// `edit` is called once per chunk, by several threads in any order, with the index of the first point, the raw
/// records as they were, their layout, and the coordinates \[m\] to change in place. The bytes written do not
/// depend on the number of threads. Memory: about 50 chunks.
///
/// # Errors
/// When the input is corrupt, the edit fails, a coordinate does not fit 32 bits, or the disk is full; then nothing
/// stays under the name `output`.
pub fn rewrite<F>(input: &LasFile, output: &Path, options: &RewriteOptions, edit: F) -> Result<RewriteReport, LasError>
where
    F: Fn(u64, &[u8], RecordLayout, &mut [[f64; 3]]) -> Result<(), EditError> + Sync,
{
    let grid = Grid { scale: options.scale, offset_m: options.offset };
    let head = head_of(input, options)?;
    let table_codec = input.codec().filter(|codec| !codec.is_one_stream());
    let mut sink = Sink::create(output, &head, table_codec.is_some())?;

    let mut bounds = StoredBounds::default();
    let batch = BATCH.max(4 * rayon::current_num_threads());
    for first in (0..input.chunk_count()).step_by(batch) {
        let chunks = first..(first + batch).min(input.chunk_count());
        let written: Vec<_> =
            chunks.clone().into_par_iter().map(|chunk| rewrite_chunk(input, chunk, output, &grid, &edit)).collect();
        for (chunk, result) in chunks.zip(written) {
            let (bytes, chunk_bounds) = result?;
            let points = input.chunk_points(chunk);
            sink.append_chunk(&bytes, points.end - points.start)?;
            bounds.merge(&chunk_bounds);
        }
    }
    if let Some(codec) = table_codec {
        sink.append_table(codec.vlr())?;
    }
    copy_tail(input, &mut sink)?;
    sink.patch(position::BOUNDS as u64, &bounds_field(&grid, &bounds))?;
    let file_length = sink.position();
    sink.finish()?;
    let mut notes = Vec::new();
    if input.header().is_copc {
        notes.push("COPC input was written as plain LAZ: its octree no longer fits the points".to_owned());
    }
    let (min, max) = (grid.metres(bounds.min), grid.metres(bounds.max));
    Ok(RewriteReport { points: input.header().point_count, file_length, min, max, notes })
}

/// Decodes, edits, quantises and encodes one chunk, all while it is in the cache of one core.
fn rewrite_chunk<F>(
    input: &LasFile,
    chunk: usize,
    output: &Path,
    grid: &Grid,
    edit: &F,
) -> Result<(Vec<u8>, StoredBounds), LasError>
where
    F: Fn(u64, &[u8], RecordLayout, &mut [[f64; 3]]) -> Result<(), EditError> + Sync,
{
    // Taken out rather than borrowed: an edit that itself waits for other threads may be given another chunk meanwhile.
    let (mut records, mut coordinates_m) = SCRATCH.take();
    let layout = input.layout();
    let first_point = input.chunk_points(chunk).start;
    input.read_chunk(chunk, &mut records)?;
    let header = input.header();
    Grid { scale: header.scale, offset_m: header.offset }.load(&records, layout.record_length, &mut coordinates_m);
    edit(first_point, &records, layout, &mut coordinates_m).map_err(|source| LasError::Edit {
        path: input.path().into(),
        first_point,
        source,
    })?;
    let bounds = grid
        .store(&coordinates_m, &mut records, layout.record_length)
        .map_err(|(index, axis)| grid.overflow(output, first_point + index as u64, axis, coordinates_m[index][axis]))?;
    let bytes = match input.codec() {
        None => records.clone(),
        Some(codec) => {
            let mut bytes = Vec::with_capacity(records.len() / 4);
            codec.encode(&records, &mut bytes).map_err(|reason| LasError::Compress {
                path: output.into(),
                first_point,
                reason,
            })?;
            bytes
        }
    };
    SCRATCH.set((records, coordinates_m));
    Ok((bytes, bounds))
}

/// All that lies before the points, as it was but for the fields that change.
fn head_of(input: &LasFile, options: &RewriteOptions) -> Result<Vec<u8>, LasError> {
    let header = input.header();
    let mut head = input.input().read_vec(0, header.point_data_offset)?;
    if header.is_copc {
        let mut kept = 0_u32;
        let mut shorter = head[..usize::from(header.header_size)].to_vec();
        let mut end = shorter.len();
        for record in input.plain_records() {
            let range = in_memory(record.start..record.start + record.whole_length());
            end = range.end;
            if record.user_id != COPC {
                shorter.extend(&head[range]);
                kept += 1;
            }
        }
        shorter.extend(&head[end..]);
        head = shorter;
        put(&mut head, position::VLR_COUNT, &kept.to_le_bytes());
        // shorter than the head that was read, whose length was a `u32`
        let points_at = u32::try_from(head.len()).unwrap_or(u32::MAX);
        put(&mut head, position::POINT_DATA_OFFSET, &points_at.to_le_bytes());
    }
    put(&mut head, position::SCALE, &vector_field(options.scale));
    put(&mut head, position::OFFSET, &vector_field(options.offset));
    put(&mut head, position::GENERATING_SOFTWARE, &text_field::<32>(&options.generating_software));
    Ok(head)
}

/// Definer of the records of a cloud-optimised point cloud.
const COPC: &str = "copc";

/// Copies what follows the points, and corrects the positions in the header that name it.
fn copy_tail(input: &LasFile, sink: &mut Sink) -> Result<(), LasError> {
    let header = input.header();
    let mut moved = Vec::new();
    for part in tail_of(input) {
        moved.push((part.clone(), sink.position()));
        let mut at = part.start;
        while at < part.end {
            let length = COPY_BYTES.min(part.end - at);
            sink.append(&input.input().read_vec(at, length)?)?;
            at += length;
        }
    }
    let new_place = |old: u64| {
        let part = moved.iter().find(|(part, _)| part.contains(&old));
        part.map(|(part, new_start)| old - part.start + new_start)
    };
    if let Some(place) = new_place(header.waveform_start) {
        sink.patch(position::WAVEFORM_START as u64, &place.to_le_bytes())?;
    }
    if header.evlr_count > 0 {
        let kept: Vec<_> =
            header.vlrs.iter().filter(|record| record.is_extended && !is_left_out(input, record)).collect();
        let place = kept.first().and_then(|record| new_place(record.start)).unwrap_or(0);
        // not more than were counted in a `u32`
        let count = u32::try_from(kept.len()).unwrap_or(header.evlr_count);
        sink.patch(position::EVLR_START as u64, &place.to_le_bytes())?;
        sink.patch(position::EVLR_COUNT as u64, &count.to_le_bytes())?;
    }
    Ok(())
}

/// Byte ranges of the input that follow its points and are kept.
fn tail_of(input: &LasFile) -> Vec<Range<u64>> {
    let (header, end) = (input.header(), input.file_length());
    if header.is_copc {
        let kept = header.vlrs.iter().filter(|record| record.is_extended && !is_left_out(input, record));
        return kept.map(|record| record.start..record.start + record.whole_length()).collect();
    }
    if input.codec().is_none() {
        let points = header.point_count * u64::from(header.record_length); // checked against the file's length
        return std::iter::once(header.point_data_offset + points..end).collect();
    }
    let start = header.tail_start(end);
    let end = match input.table() {
        Some(table) if table.start >= start => table.start,
        Some(table) if table.is_named_at_end => end - 8,
        _ => end,
    };
    std::iter::once(start..end.max(start)).collect()
}

fn is_left_out(input: &LasFile, record: &super::vlr::VlrSummary) -> bool {
    input.header().is_copc && record.user_id == COPC
}

/// A range of the head of a file, which is in memory.
#[allow(clippy::cast_possible_truncation)] // below the `u32` of the point data's position
fn in_memory(range: Range<u64>) -> Range<usize> {
    range.start as usize..range.end as usize
}
