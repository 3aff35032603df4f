//! Sorted runs of cells, in memory or spilled to disk, merged tile by tile.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};

use bytemuck::Zeroable;

use crate::cell::Cell;

const BUFFER_BYTES: usize = 1 << 18;

/// A sorted run of cells.
#[derive(Debug)]
pub struct Run {
    source: RunSource,
    head: Option<Cell>,
}

#[derive(Debug)]
enum RunSource {
    Memory(std::vec::IntoIter<Cell>),
    File { reader: BufReader<File>, left: usize },
}

impl Run {
    /// A run of sorted cells that stays in memory.
    #[must_use]
    pub fn in_memory(cells: Vec<Cell>) -> Self {
        Self { source: RunSource::Memory(cells.into_iter()), head: None }
    }

    /// A run of sorted cells written into an unnamed temporary file, which vanishes with the run.
    ///
    /// # Errors
    /// When the temporary folder is full or cannot be written to.
    pub fn spilled(cells: &[Cell]) -> io::Result<Self> {
        let mut writer = BufWriter::with_capacity(BUFFER_BYTES, tempfile::tempfile()?);
        writer.write_all(bytemuck::cast_slice(cells))?;
        let mut file = writer.into_inner().map_err(io::IntoInnerError::into_error)?;
        file.seek(SeekFrom::Start(0))?;
        let reader = BufReader::with_capacity(BUFFER_BYTES, file);
        Ok(Self { source: RunSource::File { reader, left: cells.len() }, head: None })
    }

    fn advance(&mut self) -> io::Result<()> {
        self.head = match &mut self.source {
            RunSource::Memory(cells) => cells.next(),
            RunSource::File { left: 0, .. } => None,
            RunSource::File { reader, left } => {
                let mut cell = Cell::zeroed();
                reader.read_exact(bytemuck::bytes_of_mut(&mut cell))?;
                *left -= 1;
                Some(cell)
            }
        };
        Ok(())
    }
}

/// Merges runs: gives the cells of one tile after the other, each key once.
#[derive(Debug)]
pub struct TileMerge {
    runs: Vec<Run>,
}

impl TileMerge {
    /// Starts the merge.
    ///
    /// # Errors
    /// When a spilled run cannot be read back.
    pub fn new(mut runs: Vec<Run>) -> io::Result<Self> {
        for run in &mut runs {
            run.advance()?;
        }
        Ok(Self { runs })
    }

    /// The cells of the next tile, sorted by key; `None` after the last.
    ///
    /// # Errors
    /// When a spilled run cannot be read back.
    pub fn next_tile(&mut self) -> io::Result<Option<Vec<Cell>>> {
        let Some(tile) = self.runs.iter().filter_map(|run| run.head.map(|c| c.key.place.tile())).min() else {
            return Ok(None);
        };
        let mut cells: Vec<Cell> = Vec::new();
        for run in &mut self.runs {
            while let Some(cell) = run.head {
                if cell.key.place.tile() != tile {
                    break;
                }
                cells.push(cell);
                run.advance()?;
            }
        }
        cells.sort_unstable_by_key(|cell| cell.key);
        cells.dedup_by(|later, kept| {
            let same = later.key == kept.key;
            if same {
                kept.moments.merge(&later.moments);
            }
            same
        });
        Ok(Some(cells))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::SourceKey;
    use crate::cell::{CellKey, Place};
    use crate::moments::Moments;

    fn cell(ix: i64, n: i64) -> Cell {
        let place = Place::new(ix, 0, 0).expect("inside");
        Cell { key: CellKey { place, source: SourceKey(1), bin: 0 }, moments: Moments { n, ..Moments::default() } }
    }

    #[test]
    fn spilled_and_kept_runs_merge_to_the_same_tiles() {
        let runs = || -> io::Result<Vec<Run>> {
            Ok(vec![Run::spilled(&[cell(0, 1), cell(40, 2)])?, Run::in_memory(vec![cell(0, 5), cell(3, 1)])])
        };
        let mut merge = TileMerge::new(runs().expect("a temporary file")).expect("readable");
        let first = merge.next_tile().expect("readable").expect("two tiles");
        assert_eq!(first, vec![cell(0, 6), cell(3, 1)]);
        assert_eq!(merge.next_tile().expect("readable").expect("two tiles"), vec![cell(40, 2)]);
        assert!(merge.next_tile().expect("readable").is_none());
    }
}
