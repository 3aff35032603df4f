//! What the forward pass leaves for the backward one: kept in memory up to a limit, then in an unnamed temporary file.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};

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
    /// Rows of the covariance of the states before the slots, row-major.
    pub covariance_rows: &'a [f64],
}

/// Records in the order they were made, read back from the end.
#[derive(Debug)]
pub struct Tape {
    base: usize,
    blocks: Vec<Vec<f64>>,
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

/// Numbers in a block of memory.
const BLOCK: usize = 1 << 17;

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

    /// Adds a record; with the moments where the node is to be smoothed.
    ///
    /// # Errors
    /// When the temporary file cannot be written.
    pub fn push(&mut self, record: &NodeRecord, moments: Option<&Gaussian>) -> io::Result<()> {
        let count = size(record) + moments.map_or(0, |g| (1 + g.base) * g.len());
        if self.spilled.is_none() && count <= self.room {
            self.room -= count;
            if self.blocks.last().is_none_or(|b| b.len() + count > b.capacity()) {
                self.blocks.push(Vec::with_capacity(BLOCK.max(count)));
            }
            let block = self.blocks.len() - 1;
            let start = self.blocks[block].len();
            encode(record, moments, &mut self.blocks[block]);
            self.places.push(Place::Memory { block, start, count });
            return Ok(());
        }
        self.buffer.clear();
        encode(record, moments, &mut self.buffer);
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
            Place::Memory { block, start, count } => Ok(decode(&self.blocks[block][start..start + count], self.base)),
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
    3 + transition + operations
}

#[allow(clippy::cast_precision_loss)] // counts are small
fn encode(record: &NodeRecord, moments: Option<&Gaussian>, out: &mut Vec<f64>) {
    let states = moments.map_or(0, Gaussian::len);
    let moves = f64::from(u8::from(record.transition.is_some()));
    out.extend([states as f64, record.operations.len() as f64, moves]);
    if let Some(transition) = &record.transition {
        for row in &transition.nav {
            out.extend_from_slice(row);
        }
        out.extend_from_slice(&transition.decay);
    }
    if let Some(gaussian) = moments {
        out.extend_from_slice(gaussian.mean());
        for i in 0..gaussian.base {
            out.extend_from_slice(gaussian.row(i));
        }
    }
    let put_row = |out: &mut Vec<f64>, row: &SparseRow| {
        out.push(row.len() as f64);
        out.extend(row.iter().flat_map(|(k, factor)| [*k as f64, *factor]));
    };
    for operation in &record.operations {
        match operation {
            Operation::Update(update) => {
                let gain = update.gain.first().map_or(0, Vec::len);
                out.extend([0.0, update.rows.len() as f64, gain as f64]);
                out.extend_from_slice(&update.innovation);
                out.extend_from_slice(&update.precision);
                for row in &update.rows {
                    put_row(out, row);
                }
                for gain in &update.gain {
                    out.extend_from_slice(gain);
                }
            }
            Operation::Enter { at, row } => {
                out.extend([1.0, *at as f64, 0.0]);
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
    let head = take(3);
    let (states, operations) = (head[0] as usize, head[1] as usize);
    let transition = (head[2] > 0.5).then(|| {
        let mut transition = Transition::identity(base);
        for row in &mut transition.nav {
            row.copy_from_slice(take(CORE));
        }
        transition.decay.copy_from_slice(take(base - NAV));
        transition
    });
    let moments =
        (states > 0).then_some(()).map(|()| Moments { mean: take(states), covariance_rows: take(base * states) });
    let operations = (0..operations)
        .map(|_| {
            let head = take(3);
            let row = |take: &mut dyn FnMut(usize) -> Vec<f64>| -> SparseRow {
                let entries = take(1)[0] as usize;
                take(2 * entries).chunks_exact(2).map(|e| (e[0] as usize, e[1])).collect()
            };
            let mut copy = |count: usize| take(count).to_vec();
            if head[0] > 0.5 {
                Operation::Enter { at: head[1] as usize, row: row(&mut copy) }
            } else {
                let (m, n) = (head[1] as usize, head[2] as usize);
                let innovation = copy(m);
                let precision = copy(m * m);
                let rows = (0..m).map(|_| row(&mut copy)).collect();
                let gain = (0..m).map(|_| copy(n)).collect();
                Operation::Update(UpdateRecord { innovation, precision, rows, gain })
            }
        })
        .collect();
    (NodeRecord { transition, operations }, moments)
}
