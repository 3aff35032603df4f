//! The one pass over the points: every point is added to the cell of its place, source and time bin.
//!
//! One [`Accumulator`] a thread; [`Accumulator::finish`] gives sorted runs, merged by [`crate::runs`]. When an
//! accumulator outgrows its share of the memory, it sorts what it has and spills it into an unnamed temporary file.

use std::io;

use crate::block::{PointBlock, PointFilter, SourceKey, SourceRule};
use crate::cell::{Cell, CellKey, Place};
use crate::moments::{Moments, STEPS_PER_METRE, TICKS_PER_SECOND};
use crate::runs::Run;
use crate::sketch::{ReturnPair, SamplePoint, SightingRun, Sketches, mix};

/// What the pass needs to know before the first point.
#[derive(Debug, Clone, PartialEq)]
pub struct GridOptions {
    /// Map coordinates of the local origin \[m\].
    pub origin_m: [f64; 3],
    /// Edge of a cell is 2^`cell_bits` steps: 14 is one metre.
    pub cell_bits: u32,
    /// Length of a time bin, a power of two \[s\]: visits of one source to one cell further apart than two bins are two
    /// passes, and a patch holds the points of one.
    pub time_bin_s: f64,
    /// Cells that one accumulator holds before it spills.
    pub cells_in_memory: usize,
    /// Which points take part.
    pub filter: PointFilter,
    /// What tells sources apart.
    pub rule: SourceRule,
}

impl GridOptions {
    /// Edge of a cell \[m\].
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        f64::from(1_u32 << self.cell_bits) / STEPS_PER_METRE
    }
}

/// Counts of what the pass met.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PassCounts {
    /// Points read.
    pub read: u64,
    /// Points added to a cell.
    pub used: u64,
    /// Points whose time is not a number.
    pub without_time: u64,
    /// Points too far from the origin for the grid.
    pub out_of_reach: u64,
}

impl PassCounts {
    /// Adds the counts of another thread.
    pub fn merge(&mut self, other: &Self) {
        self.read += other.read;
        self.used += other.used;
        self.without_time += other.without_time;
        self.out_of_reach += other.out_of_reach;
    }
}

/// What one thread has summed so far.
#[derive(Debug)]
pub struct Accumulator {
    options: GridOptions,
    cells: Vec<Cell>,
    table: Vec<u32>,
    runs: Vec<Run>,
    sketches: Sketches,
    counts: PassCounts,
    pending: Vec<PendingPulse>,
}

#[derive(Debug, Clone, Copy)]
struct PendingPulse {
    time_bits: u64,
    source: SourceKey,
    first_m: [f64; 3],
}

const EMPTY: u32 = u32::MAX;
const PENDING_SLOTS: usize = 256;
const SAMPLE_STRIDE: u64 = 37;

/// The nearest whole number of a value below 2⁵¹: adding 1.5 × 2⁵² leaves no bits for the fraction. `round` is a call
/// into the mathematics library on processors of the base line.
#[inline]
#[allow(clippy::cast_possible_wrap)] // the bits of two positive numbers
fn nearest(value: f64) -> i64 {
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    (value + SHIFT).to_bits() as i64 - SHIFT.to_bits() as i64
}

/// The greatest whole number not above a value.
#[inline]
#[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss)]
fn floor(value: f64) -> i64 {
    let whole = value as i64;
    whole - i64::from(whole as f64 > value)
}

fn hash(key: &CellKey) -> u64 {
    #[allow(clippy::cast_sign_loss)]
    let rest = key.source.0 ^ (key.bin as u64).rotate_left(40);
    let place = bytemuck::cast::<Place, u64>(key.place);
    (place ^ rest.wrapping_mul(0x9e37_79b9_7f4a_7c15)).wrapping_mul(0xff51_afd7_ed55_8ccd)
}

impl Accumulator {
    /// An empty accumulator.
    #[must_use]
    pub fn new(options: GridOptions) -> Self {
        let none = PendingPulse { time_bits: u64::MAX, source: SourceKey(u64::MAX), first_m: [0.0; 3] };
        Self {
            options,
            cells: Vec::new(),
            table: vec![EMPTY; 1 << 12],
            runs: Vec::new(),
            sketches: Sketches::default(),
            counts: PassCounts::default(),
            pending: vec![none; PENDING_SLOTS],
        }
    }

    /// Adds the points of a block. Blocks may come in any order.
    ///
    /// # Errors
    /// When the temporary file of a spill cannot be written.
    #[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss)] // coordinates are checked by Place::new
    pub fn add(&mut self, block: &PointBlock<'_>) -> io::Result<()> {
        let GridOptions { origin_m, cell_bits, cells_in_memory, time_bin_s, .. } = self.options;
        let step = block.scale_m.map(|s| s * STEPS_PER_METRE);
        let start: [f64; 3] = std::array::from_fn(|k| (block.offset_m[k] - origin_m[k]) * STEPS_PER_METRE);
        let mask = (1_i64 << cell_bits) - 1;
        let (rule, filter) = (self.options.rule, self.options.filter.clone()); // out of reach of the sums: stay in registers
        let mut counts = PassCounts { read: block.len() as u64, ..PassCounts::default() };
        // Points that follow each other mostly share cell, source and time bin: what these lead to is kept.
        let mut run = SightingRun::default();
        let (mut last_cell, mut last_source) = ([0_i64; 3], SourceKey(0));
        let (mut bin_start_s, mut bin_end_s) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut row = usize::MAX;
        let mut until_sample = (SAMPLE_STRIDE - block.first_point % SAMPLE_STRIDE) % SAMPLE_STRIDE;
        for i in 0..block.len() {
            let sampled = until_sample == 0;
            until_sample = if sampled { SAMPLE_STRIDE - 1 } else { until_sample - 1 };
            let time_s = block.gps_time_s[i] + block.time_shift_s;
            if !time_s.is_finite() {
                counts.without_time += 1;
                continue;
            }
            let source = rule.source(block, i);
            let steps = [
                nearest(f64::from(block.x[i]) * step[0] + start[0]),
                nearest(f64::from(block.y[i]) * step[1] + start[1]),
                nearest(f64::from(block.z[i]) * step[2] + start[2]),
            ];
            if !run.take(source, time_s) {
                self.sketches.see(&std::mem::replace(&mut run, SightingRun::new(source, time_s)));
            }
            if sampled || block.number_of_returns[i] > 1 {
                self.sketch(block, i, source, time_s, steps, sampled);
            }
            if !filter.takes(block, i) {
                continue;
            }
            let cell = steps.map(|v| v >> cell_bits);
            if row == usize::MAX
                || cell != last_cell
                || source != last_source
                || !(bin_start_s <= time_s && time_s < bin_end_s)
            {
                let Some(place) = Place::new(cell[0], cell[1], cell[2]) else {
                    counts.out_of_reach += 1;
                    continue;
                };
                let bin = floor(time_s * (1.0 / time_bin_s));
                bin_start_s = bin as f64 * time_bin_s;
                bin_end_s = (bin + 1) as f64 * time_bin_s;
                row = self.row(CellKey { place, source, bin });
                (last_cell, last_source) = (cell, source);
            }
            let ticks = ((time_s - bin_start_s) * TICKS_PER_SECOND) as i64;
            self.cells[row].moments.add(steps.map(|v| v & mask), ticks, i64::from(block.intensity[i]));
            counts.used += 1;
            if self.cells.len() >= cells_in_memory {
                self.spill()?;
                row = usize::MAX;
            }
        }
        self.sketches.see(&run);
        self.counts.merge(&counts);
        Ok(())
    }

    /// Keeps a point in the sample, and a pulse's first and last return as a pair.
    #[allow(clippy::cast_precision_loss)]
    fn sketch(
        &mut self,
        block: &PointBlock<'_>,
        i: usize,
        source: SourceKey,
        time_s: f64,
        steps: [i64; 3],
        sampled: bool,
    ) {
        let point_m = steps.map(|v| v as f64 / STEPS_PER_METRE);
        let scan_angle_deg = block.scan_angle_deg[i];
        if sampled {
            self.sketches.offer_sample(source, SamplePoint { time_s, point_m, scan_angle_deg });
        }
        let returns = block.number_of_returns[i];
        if returns < 2 {
            return;
        }
        // Returns of one pulse stand close together in a file, but not always in order.
        let number = block.return_number[i];
        let time_bits = time_s.to_bits();
        #[allow(clippy::cast_possible_truncation)]
        let slot = mix(time_bits ^ source.0) as usize % PENDING_SLOTS;
        let pending = &mut self.pending[slot];
        if number == 1 {
            *pending = PendingPulse { time_bits, source, first_m: point_m };
        } else if number == returns && pending.time_bits == time_bits && pending.source == source {
            let pair = ReturnPair { time_s, first_m: pending.first_m, last_m: point_m, scan_angle_deg };
            pending.time_bits = u64::MAX;
            self.sketches.offer_pair(source, pair);
        }
    }

    /// Row of the cell with this key, made when it is not there.
    #[allow(clippy::cast_possible_truncation)]
    fn row(&mut self, key: CellKey) -> usize {
        if self.cells.len() * 2 >= self.table.len() {
            self.grow();
        }
        let mask = self.table.len() - 1;
        let mut slot = (hash(&key) >> 32) as usize & mask;
        loop {
            match self.table[slot] {
                EMPTY => {
                    self.table[slot] = self.cells.len() as u32;
                    self.cells.push(Cell { key, moments: Moments::default() });
                    return self.cells.len() - 1;
                }
                row if self.cells[row as usize].key == key => return row as usize,
                _ => slot = (slot + 1) & mask,
            }
        }
    }

    #[allow(clippy::cast_possible_truncation)]
    fn grow(&mut self) {
        let mask = self.table.len() * 4 - 1;
        let mut table = vec![EMPTY; mask + 1];
        for (row, cell) in self.cells.iter().enumerate() {
            let mut slot = (hash(&cell.key) >> 32) as usize & mask;
            while table[slot] != EMPTY {
                slot = (slot + 1) & mask;
            }
            table[slot] = row as u32;
        }
        self.table = table;
    }

    fn spill(&mut self) -> io::Result<()> {
        self.cells.sort_by_cached_key(|cell| cell.key); // cells are large: moved once
        self.runs.push(Run::spilled(&self.cells)?);
        self.cells.clear();
        self.table.fill(EMPTY);
        Ok(())
    }

    /// The sorted runs, the sketches and the counts of this thread.
    #[must_use]
    pub fn finish(mut self) -> (Vec<Run>, Sketches, PassCounts) {
        self.cells.sort_by_cached_key(|cell| cell.key); // cells are large: moved once
        self.runs.push(Run::in_memory(self.cells));
        (self.runs, self.sketches, self.counts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        #[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss)]
        fn the_quick_whole_numbers_are_those_of_the_library(value in -1e12_f64..1e12) {
            prop_assert!((nearest(value) as f64 - value).abs() <= 0.5);
            prop_assert_eq!(floor(value), value.floor() as i64);
        }
    }
}
