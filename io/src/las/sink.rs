//! The file being written: head, points in order, chunk table, tail; appears whole or not at all.

use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use laz::laszip::{ChunkTable, ChunkTableEntry};

use super::error::LasError;
use super::quantise::{Grid, StoredBounds};
use crate::output::WholeFile;

/// Writes the parts of a LAS or LAZ file one after the other.
#[derive(Debug)]
pub(super) struct Sink {
    file: WholeFile,
    path: PathBuf,
    position: u64,
    points_start: u64,
    table: ChunkTable,
}

impl Sink {
    /// Starts `path` with `head`: header, variable-length records, all up to the points.
    ///
    /// Where the file has a chunk table, the place for its position is kept.
    pub(super) fn create(path: &Path, head: &[u8], has_table: bool) -> Result<Self, LasError> {
        let file = WholeFile::create(path).map_err(|source| LasError::Io {
            path: path.into(),
            action: "create it",
            source,
        })?;
        let mut sink = Self {
            file,
            path: path.into(),
            position: 0,
            points_start: head.len() as u64,
            table: ChunkTable::default(),
        };
        sink.append(head)?;
        if has_table {
            sink.append(&(-1_i64).to_le_bytes())?;
        }
        Ok(sink)
    }

    /// Bytes written so far.
    pub(super) fn position(&self) -> u64 {
        self.position
    }

    pub(super) fn append(&mut self, bytes: &[u8]) -> Result<(), LasError> {
        let written = self.file.writer().write_all(bytes);
        written.map_err(|source| self.failed(source))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Appends the next chunk of points, compressed or not.
    pub(super) fn append_chunk(&mut self, bytes: &[u8], points: u64) -> Result<(), LasError> {
        self.table.push(ChunkTableEntry { point_count: points, byte_count: bytes.len() as u64 });
        self.append(bytes)
    }

    /// Writes the chunk table after the last chunk, and its position before the first.
    pub(super) fn append_table(&mut self, vlr: &laz::LazVlr) -> Result<(), LasError> {
        let start = self.position;
        let mut table = Vec::new();
        self.table.write_to(&mut table, vlr).map_err(|source| self.failed(source))?;
        self.append(&table)?;
        self.patch(self.points_start, &start.to_le_bytes())
    }

    /// Replaces bytes that have been written.
    pub(super) fn patch(&mut self, at: u64, bytes: &[u8]) -> Result<(), LasError> {
        let end = self.position;
        let writer = self.file.writer();
        let patched = writer
            .seek(SeekFrom::Start(at))
            .and_then(|_| writer.write_all(bytes))
            .and_then(|()| writer.seek(SeekFrom::Start(end)).map(|_| ()));
        patched.map_err(|source| self.failed(source))
    }

    /// Gives the file its final name.
    pub(super) fn finish(self) -> Result<(), LasError> {
        let Self { file, path, .. } = self;
        file.finish().map_err(|source| LasError::Io { path, action: "write it", source })
    }

    fn failed(&self, source: std::io::Error) -> LasError {
        LasError::Io { path: self.path.clone(), action: "write it", source }
    }
}

/// The six bounds \[m\] as they stand in a header: max x, min x, max y, min y, max z, min z.
pub(super) fn bounds_field(grid: &Grid, bounds: &StoredBounds) -> [u8; 48] {
    let (min, max) = (grid.metres(bounds.min), grid.metres(bounds.max));
    let mut field = [0; 48];
    for (slot, value) in field.chunks_exact_mut(8).zip([max[0], min[0], max[1], min[1], max[2], min[2]]) {
        slot.copy_from_slice(&value.to_le_bytes());
    }
    field
}

/// Three numbers as they stand in a header.
pub(super) fn vector_field(vector: [f64; 3]) -> [u8; 24] {
    let mut field = [0; 24];
    for (slot, value) in field.chunks_exact_mut(8).zip(vector) {
        slot.copy_from_slice(&value.to_le_bytes());
    }
    field
}

/// Text in a fixed field, cut to it and filled with NUL.
pub(super) fn text_field<const N: usize>(text: &str) -> [u8; N] {
    let mut field = [0; N];
    for (slot, byte) in field.iter_mut().zip(text.bytes()) {
        *slot = byte;
    }
    field
}

/// Replaces bytes of the head of a file, which holds its header whole.
pub(super) fn put(head: &mut [u8], at: usize, bytes: &[u8]) {
    head[at..at + bytes.len()].copy_from_slice(bytes);
}
