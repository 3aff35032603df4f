//! New LAS and LAZ files, for simulated surveys and for tests.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::bytes::i32_at;
use super::codec::LazCodec;
use super::columns::Columns;
use super::error::LasError;
use super::file::LasFile;
use super::header::{LasHeader, position};
use super::layout::RecordLayout;
use super::new_file::{LasWriterOptions, checked_layout, new_head, unwritable};
use super::quantise::{Grid, StoredBounds};
use super::sink::{Sink, bounds_field, put, text_field};

/// Points per LAZ chunk.
const CHUNK_POINTS: u32 = 50_000;
/// Chunks that are collected before they are compressed together.
const BATCH: usize = 16;

/// Writes points block by block; compressed where the path ends in `.laz`.
///
/// Chunks are compressed in parallel; memory is bounded; the file gets its name in [`LasWriter::finish`] and
/// leaves nothing behind when dropped before.
#[derive(Debug)]
pub struct LasWriter {
    sink: Sink,
    path: PathBuf,
    options: LasWriterOptions,
    layout: RecordLayout,
    codec: Option<LazCodec>,
    head: Vec<u8>,
    /// Records that are not yet written.
    pending: Vec<u8>,
    written: u64,
    by_return: [u64; 15],
    bounds: StoredBounds,
}

impl LasWriter {
    /// Starts a file.
    ///
    /// # Errors
    /// When the options contradict each other or the file cannot be created.
    pub fn create(path: &Path, options: LasWriterOptions) -> Result<Self, LasError> {
        let layout = checked_layout(path, &options)?;
        let is_laz = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("laz"));
        let codec = match is_laz {
            true => Some(LazCodec::new(layout, CHUNK_POINTS).map_err(|reason| LasError::Compress {
                path: path.into(),
                first_point: 0,
                reason,
            })?),
            false => None,
        };
        let head = new_head(path, &options, layout, codec.as_ref())?;
        let sink = Sink::create(path, &head, is_laz)?;
        Ok(Self {
            sink,
            path: path.into(),
            options,
            layout,
            codec,
            head,
            pending: Vec::new(),
            written: 0,
            by_return: [0; 15],
            bounds: StoredBounds::default(),
        })
    }

    /// Where the fields of a record lie, for [`LasWriter::write_records`].
    #[must_use]
    pub fn layout(&self) -> RecordLayout {
        self.layout
    }

    /// Appends a block of any size; columns may be empty (zeros), x, y and z may not. Extra bytes become zero.
    ///
    /// # Errors
    /// When the columns have different lengths, or the disk is full.
    pub fn write(&mut self, columns: &Columns) -> Result<(), LasError> {
        let count = columns.len();
        for (name, length) in columns.lengths() {
            let may_be_empty = !matches!(name, "x" | "y" | "z");
            if length != count && !(may_be_empty && length == 0) {
                let (found, expected) = (length.to_string(), format!("{count} as in x"));
                return Err(unwritable(&self.path, name, found, expected));
            }
        }
        let start = self.pending.len();
        self.pending.resize(start + count * self.layout.record_length, 0);
        columns.store(&mut self.pending[start..], self.layout);
        self.take_pending(start)
    }

    /// Appends raw records of [`LasWriter::layout`].
    ///
    /// # Errors
    /// When they are not whole records, or the disk is full.
    pub fn write_records(&mut self, records: &[u8]) -> Result<(), LasError> {
        if !records.len().is_multiple_of(self.layout.record_length) {
            let expected = format!("a multiple of {}", self.layout.record_length);
            return Err(unwritable(&self.path, "bytes of records", records.len().to_string(), expected));
        }
        let start = self.pending.len();
        self.pending.extend_from_slice(records);
        self.take_pending(start)
    }

    /// Counts the new records from byte `start` on, and writes as many whole chunks as have come together.
    fn take_pending(&mut self, start: usize) -> Result<(), LasError> {
        let return_bits = if self.layout.extended { 0b1111 } else { 0b111 };
        for record in self.pending[start..].chunks_exact(self.layout.record_length) {
            self.bounds.include([0, 4, 8].map(|at| i32_at(record, at)));
            let number = usize::from(record[14] & return_bits);
            if let Some(slot) = number.checked_sub(1) {
                self.by_return[slot] += 1;
            }
        }
        let chunk_bytes = CHUNK_POINTS as usize * self.layout.record_length;
        if self.pending.len() < BATCH * chunk_bytes {
            return Ok(());
        }
        let whole = self.pending.len() / chunk_bytes * chunk_bytes;
        self.flush(whole)
    }

    /// Writes the first `length` bytes of the pending records.
    fn flush(&mut self, length: usize) -> Result<(), LasError> {
        let chunk_bytes = CHUNK_POINTS as usize * self.layout.record_length;
        for batch in self.pending[..length].chunks(BATCH * chunk_bytes) {
            let compress = |chunk: &[u8]| match &self.codec {
                None => Ok(Vec::new()),
                Some(codec) => {
                    let mut bytes = Vec::with_capacity(chunk.len() / 4);
                    codec.encode(chunk, &mut bytes).map(|()| bytes)
                }
            };
            let compressed: Vec<_> = batch.par_chunks(chunk_bytes).map(compress).collect();
            for (chunk, compressed) in batch.chunks(chunk_bytes).zip(compressed) {
                let points = (chunk.len() / self.layout.record_length) as u64;
                let bytes = compressed.map_err(|reason| LasError::Compress {
                    path: self.path.clone(),
                    first_point: self.written,
                    reason,
                })?;
                self.sink.append_chunk(if self.codec.is_some() { &bytes } else { chunk }, points)?;
                self.written += points;
            }
        }
        self.pending.drain(..length);
        Ok(())
    }

    /// Writes the last points, the chunk table, the extended records and the counts of the header; names the file.
    ///
    /// # Errors
    /// When there are no points, more than the version can count, or the disk is full.
    pub fn finish(mut self) -> Result<LasHeader, LasError> {
        self.flush(self.pending.len())?;
        if self.written == 0 {
            return Err(unwritable(&self.path, "number of points", "0".to_owned(), "one or more".to_owned()));
        }
        if let Some(codec) = &self.codec {
            self.sink.append_table(codec.vlr())?;
        }
        let evlr_start = self.sink.position();
        for record in &self.options.evlrs {
            let mut bytes = vec![0; 2];
            bytes.extend(text_field::<16>(&record.user_id));
            bytes.extend(record.record_id.to_le_bytes());
            bytes.extend((record.contents.len() as u64).to_le_bytes());
            bytes.extend(text_field::<32>(&record.description));
            bytes.extend(&record.contents);
            self.sink.append(&bytes)?;
        }
        self.count(evlr_start)?;
        self.sink.patch(0, &self.head)?;
        self.sink.finish()?;
        Ok(LasFile::open(&self.path)?.header().clone())
    }

    /// Fills counts, bounds and positions into the header.
    fn count(&mut self, evlr_start: u64) -> Result<(), LasError> {
        let grid = Grid { scale: self.options.scale, offset_m: self.options.offset };
        put(&mut self.head, position::BOUNDS, &bounds_field(&grid, &self.bounds));
        let has_long_counts = self.options.version.1 >= 4;
        let legacy = u32::try_from(self.written);
        if legacy.is_err() && !has_long_counts {
            let expected = "at most 4 294 967 295 before LAS 1.4".to_owned();
            return Err(unwritable(&self.path, "number of points", self.written.to_string(), expected));
        }
        if let (Ok(count), false) = (legacy, self.layout.extended) {
            put(&mut self.head, 107, &count.to_le_bytes());
            for (slot, &points) in self.by_return[..5].iter().enumerate() {
                // not more than all points, which fit
                put(&mut self.head, 111 + 4 * slot, &u32::try_from(points).unwrap_or(count).to_le_bytes());
            }
        }
        if has_long_counts {
            put(&mut self.head, 247, &self.written.to_le_bytes());
            for (slot, points) in self.by_return.iter().enumerate() {
                put(&mut self.head, 255 + 8 * slot, &points.to_le_bytes());
            }
            if !self.options.evlrs.is_empty() {
                put(&mut self.head, position::EVLR_START, &evlr_start.to_le_bytes());
            }
        }
        Ok(())
    }
}
