//! What the forward pass leaves for the backward one: kept in memory up to a limit, then in an unnamed temporary file.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};

use memmap2::MmapMut;

use crate::kalman::{Gaussian, SparseRow, UpdateRecord};
use crate::state::{CORE, NAV};
use crate::transition::Transition;

/// What happened to the error state at a node, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum Operation {
    /// A measurement was taken in.
    Update(UpdateRecord),
    /// A state entered at index `at` as a combination of others.
    Enter {
        /// Its index.
        at: usize,
        /// The combination.
        row: SparseRow,
    },
}

/// A node of the forward pass.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeRecord {
    /// Transition from the node before; none where the covariance stood still.
    pub transition: Option<Transition>,
    /// Operations.
    pub operations: Vec<Operation>,
}

/// Mean and covariance after a node that is to be smoothed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments<'a> {
    /// Mean of the errors.
    pub mean: &'a [f64],
    /// Rows of the covariance, row-major: of all states before the slots, or of those that are smoothed at every node.
    pub covariance_rows: &'a [f64],
}

impl Moments<'_> {
    /// Whether it has the rows of all `base` states before the slots.
    #[must_use]
    pub fn is_whole(&self, base: usize) -> bool {
        self.covariance_rows.len() == base * self.mean.len()
    }
}

/// Records in the order they were made, read back from the end.
#[derive(Debug)]
pub struct Tape {
    base: usize,
    blocks: Vec<Block>,
    /// Numbers that memory may still take.
    room: usize,
    spilled: Option<(File, u64)>,
    places: Vec<Place>,
    buffer: Vec<f64>,
}

/// Where a record lies.
#[derive(Debug, Clone, Copy)]
enum Place {
    Memory { block: usize, start: usize, count: usize },
    Disk { start: u64, count: usize },
}

/// Numbers in a block of memory: eight huge pages.
const BLOCK: usize = 1 << 21;

/// Memory from the system, in huge pages where it has them: touching a hundred megabytes page by page would cost as much
/// as a backward pass.
#[derive(Debug)]
struct Block {
    memory: MmapMut,
    used: usize,
}

impl Block {
    fn new(numbers: usize) -> io::Result<Self> {
        let memory = MmapMut::map_anon(numbers * 8)?;
        #[cfg(target_os = "linux")]
        let _ = memory.advise(memmap2::Advice::HugePage); // a wish: systems without them refuse
        Ok(Self { memory, used: 0 })
    }

    fn numbers(&self) -> &[f64] {
        bytemuck::cast_slice(&self.memory)
    }

    /// Takes room for numbers behind those there are.
    fn take(&mut self, count: usize) -> Option<&mut [f64]> {
        let start = self.used;
        let room = bytemuck::cast_slice_mut(&mut self.memory).get_mut(start..start + count)?;
        self.used += count;
        Some(room)
    }
}

/// Writes numbers one behind the other.
struct Writer<'a>(&'a mut [f64]);

impl Writer<'_> {
    fn put(&mut self, values: &[f64]) {
        let (now, later) = std::mem::take(&mut self.0).split_at_mut(values.len());
        now.copy_from_slice(values);
        self.0 = later;
    }
}

impl Tape {
    /// An empty tape for filters of `base` states, that keeps `limit_bytes` in memory.
    #[must_use]
    pub fn new(base: usize, limit_bytes: usize) -> Self {
        Self { base, blocks: Vec::new(), room: limit_bytes / 8, spilled: None, places: Vec::new(), buffer: Vec::new() }
    }

    /// Records on it.
    #[must_use]
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Whether records went to disk.
    #[must_use]
    pub fn is_spilled(&self) -> bool {
        self.spilled.is_some()
    }

    /// Adds a record; where the node is to be smoothed with its moments and these rows of the covariance.
    ///
    /// # Errors
    /// When the temporary file cannot be written.
    pub fn push(&mut self, record: &NodeRecord, moments: Option<(&Gaussian, &[usize])>) -> io::Result<()> {
        let count = size(record) + moments.map_or(0, |(g, rows)| (1 + rows.len()) * g.len());
        if self.spilled.is_none() && count <= self.room {
            self.room -= count;
            if self.blocks.last().is_none_or(|b| b.used + count > b.numbers().len()) {
                self.blocks.push(Block::new(BLOCK.max(count))?);
            }
            let block = self.blocks.len() - 1;
            let start = self.blocks[block].used;
            if let Some(room) = self.blocks[block].take(count) {
                encode(record, moments, &mut Writer(room));
            }
            self.places.push(Place::Memory { block, start, count });
            return Ok(());
        }
        self.buffer.resize(count, 0.0);
        encode(record, moments, &mut Writer(&mut self.buffer));
        let (file, end) = match &mut self.spilled {
            Some(spilled) => spilled,
            none => none.insert((tempfile::tempfile()?, 0)),
        };
        let bytes: Vec<u8> = self.buffer.iter().flat_map(|v| v.to_le_bytes()).collect();
        file.write_all(&bytes)?;
        self.places.push(Place::Disk { start: *end, count });
        *end += bytes.len() as u64;
        Ok(())
    }

    /// Reads a record back.
    ///
    /// # Errors
    /// When the temporary file cannot be read.
    pub fn read(&mut self, index: usize) -> io::Result<(NodeRecord, Option<Moments<'_>>)> {
        match self.places[index] {
            Place::Memory { block, start, count } => {
                Ok(decode(&self.blocks[block].numbers()[start..start + count], self.base))
            }
            Place::Disk { start, count } => {
                let mut bytes = vec![0; count * 8];
                let (file, _) = self.spilled.as_mut().ok_or(io::ErrorKind::NotFound)?;
                file.seek(SeekFrom::Start(start))?;
                file.read_exact(&mut bytes)?;
                self.buffer.clear();
                let numbers = bytes.chunks_exact(8);
                self.buffer
                    .extend(numbers.map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]])));
                Ok(decode(&self.buffer, self.base))
            }
        }
    }
}

/// Numbers that a record takes.
fn size(record: &NodeRecord) -> usize {
    let row = |row: &SparseRow| 1 + 2 * row.len();
    let operation = |operation: &Operation| match operation {
        Operation::Update(u) => {
            let gain: usize = u.gain.iter().map(Vec::len).sum();
            3 + u.innovation.len() + u.precision.len() + u.rows.iter().map(row).sum::<usize>() + gain
        }
        Operation::Enter { row: of, .. } => 3 + row(of),
    };
    let transition = record.transition.as_ref().map_or(0, |t| NAV * CORE + t.decay.len());
    let operations: usize = record.operations.iter().map(operation).sum();
    4 + transition + operations
}

#[allow(clippy::cast_precision_loss)] // counts are small
fn encode(record: &NodeRecord, moments: Option<(&Gaussian, &[usize])>, out: &mut Writer<'_>) {
    let (states, rows) = moments.map_or((0, 0), |(g, rows)| (g.len(), rows.len()));
    let moves = f64::from(u8::from(record.transition.is_some()));
    out.put(&[states as f64, rows as f64, record.operations.len() as f64, moves]);
    if let Some(transition) = &record.transition {
        out.put(transition.nav.as_flattened());
        out.put(&transition.decay);
    }
    if let Some((gaussian, rows)) = moments {
        out.put(gaussian.mean());
        for i in rows {
            out.put(gaussian.row(*i));
        }
    }
    let put_row = |out: &mut Writer<'_>, row: &SparseRow| {
        out.put(&[row.len() as f64]);
        for (k, factor) in row {
            out.put(&[*k as f64, *factor]);
        }
    };
    for operation in &record.operations {
        match operation {
            Operation::Update(update) => {
                let gain = update.gain.first().map_or(0, Vec::len);
                out.put(&[0.0, update.rows.len() as f64, gain as f64]);
                out.put(&update.innovation);
                out.put(&update.precision);
                for row in &update.rows {
                    put_row(out, row);
                }
                for gain in &update.gain {
                    out.put(gain);
                }
            }
            Operation::Enter { at, row } => {
                out.put(&[1.0, *at as f64, 0.0]);
                put_row(out, row);
            }
        }
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // written by `encode`
fn decode(numbers: &[f64], base: usize) -> (NodeRecord, Option<Moments<'_>>) {
    let mut at = 0;
    let mut take = |count: usize| {
        at += count;
        &numbers[at - count..at]
    };
    let head = take(4);
    let (states, rows, operations) = (head[0] as usize, head[1] as usize, head[2] as usize);
    let transition = (head[3] > 0.5).then(|| {
        let mut transition = Transition::identity(base);
        for row in &mut transition.nav {
            row.copy_from_slice(take(CORE));
        }
        transition.decay.copy_from_slice(take(base - NAV));
        transition
    });
    let moments =
        (states > 0).then_some(()).map(|()| Moments { mean: take(states), covariance_rows: take(rows * states) });
    let operations = (0..operations)
        .map(|_| {
            let head = take(3);
            if head[0] > 0.5 {
                return Operation::Enter { at: head[1] as usize, row: take_row(&mut take) };
            }
            let (m, n) = (head[1] as usize, head[2] as usize);
            let innovation = take(m).to_vec();
            let precision = take(m * m).to_vec();
            let rows = (0..m).map(|_| take_row(&mut take)).collect();
            let gain = (0..m).map(|_| take(n).to_vec()).collect();
            Operation::Update(UpdateRecord { innovation, precision, rows, gain })
        })
        .collect();
    (NodeRecord { transition, operations }, moments)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // written by `encode`
fn take_row<'a>(take: &mut impl FnMut(usize) -> &'a [f64]) -> SparseRow {
    let entries = take(1)[0] as usize;
    take(2 * entries).chunks_exact(2).map(|e| (e[0] as usize, e[1])).collect()
}
