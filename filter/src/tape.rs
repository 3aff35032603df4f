//! What the forward pass leaves for the backward one: kept in memory up to a limit, then in an unnamed temporary file.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};

use crate::kalman::{SparseRow, UpdateRecord};
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
    /// Transition from the node before.
    pub transition: Transition,
    /// Operations.
    pub operations: Vec<Operation>,
    /// Mean of the errors afterwards, at nodes that are to be smoothed; else empty.
    pub mean: Vec<f64>,
    /// Rows of the covariance of the states before the slots, afterwards: row-major; empty where the mean is.
    pub covariance_rows: Vec<f64>,
}

/// Records in the order they were made, read back from the end.
#[derive(Debug)]
pub struct Tape {
    base: usize,
    memory: Vec<Box<[f64]>>,
    held: usize,
    limit: usize,
    spilled: Option<File>,
    places: Vec<(u64, usize)>,
    end: u64,
}

impl Tape {
    /// An empty tape for filters of `base` states, that keeps `limit_bytes` in memory.
    #[must_use]
    pub fn new(base: usize, limit_bytes: usize) -> Self {
        Self { base, memory: Vec::new(), held: 0, limit: limit_bytes / 8, spilled: None, places: Vec::new(), end: 0 }
    }

    /// Records on it.
    #[must_use]
    pub fn len(&self) -> usize {
        self.memory.len() + self.places.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether records went to disk.
    #[must_use]
    pub fn is_spilled(&self) -> bool {
        self.spilled.is_some()
    }

    /// Adds a record.
    ///
    /// # Errors
    /// When the temporary file cannot be written.
    pub fn push(&mut self, record: &NodeRecord) -> io::Result<()> {
        let numbers = encode(record);
        if self.spilled.is_none() && self.held + numbers.len() <= self.limit {
            self.held += numbers.len();
            self.memory.push(numbers.into_boxed_slice());
            return Ok(());
        }
        let file = match &mut self.spilled {
            Some(file) => file,
            none => none.insert(tempfile::tempfile()?),
        };
        let bytes: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
        file.write_all(&bytes)?;
        self.places.push((self.end, numbers.len()));
        self.end += bytes.len() as u64;
        Ok(())
    }

    /// Reads a record back.
    ///
    /// # Errors
    /// When the temporary file cannot be read.
    pub fn read(&mut self, index: usize) -> io::Result<NodeRecord> {
        let numbers = match index.checked_sub(self.memory.len()) {
            None => self.memory[index].to_vec(),
            Some(row) => {
                let (start, count) = self.places[row];
                let mut bytes = vec![0; count * 8];
                let file = self.spilled.as_mut().ok_or(io::ErrorKind::NotFound)?;
                file.seek(SeekFrom::Start(start))?;
                file.read_exact(&mut bytes)?;
                bytes
                    .chunks_exact(8)
                    .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
                    .collect()
            }
        };
        Ok(decode(&numbers, self.base))
    }
}

#[allow(clippy::cast_precision_loss)] // counts are small
fn encode(record: &NodeRecord) -> Vec<f64> {
    let states = record.mean.len();
    let mut out = Vec::with_capacity(NAV * CORE + record.covariance_rows.len() + 64);
    out.extend([states as f64, record.operations.len() as f64]);
    out.extend(record.transition.nav.iter().flatten());
    out.extend(&record.transition.decay);
    out.extend(&record.mean);
    out.extend(&record.covariance_rows);
    let put_row = |out: &mut Vec<f64>, row: &SparseRow| {
        out.push(row.len() as f64);
        out.extend(row.iter().flat_map(|(k, factor)| [*k as f64, *factor]));
    };
    for operation in &record.operations {
        match operation {
            Operation::Update(update) => {
                let gain = update.gain.first().map_or(0, Vec::len);
                out.extend([0.0, update.rows.len() as f64, gain as f64]);
                out.extend(&update.innovation);
                out.extend(&update.precision);
                for row in &update.rows {
                    put_row(&mut out, row);
                }
                out.extend(update.gain.iter().flatten());
            }
            Operation::Enter { at, row } => {
                out.extend([1.0, *at as f64, 0.0]);
                put_row(&mut out, row);
            }
        }
    }
    out
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // written by `encode`
fn decode(numbers: &[f64], base: usize) -> NodeRecord {
    let mut at = 0;
    let mut take = |count: usize| {
        at += count;
        &numbers[at - count..at]
    };
    let head = take(2).to_vec();
    let (states, operations) = (head[0] as usize, head[1] as usize);
    let mut transition = Transition::identity(base);
    for row in &mut transition.nav {
        row.copy_from_slice(take(CORE));
    }
    transition.decay.copy_from_slice(take(base - NAV));
    let mean = take(states).to_vec();
    let covariance_rows = take(base * states).to_vec();
    let operations = (0..operations)
        .map(|_| {
            let head = take(3).to_vec();
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
    NodeRecord { transition, operations, mean, covariance_rows }
}
