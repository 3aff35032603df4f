//! What is kept of every source over time beside the cells: when it measured, its widest return pairs, and a
//! sparse sample of points. Strips, passes and rebuilt trajectories come from it.
//!
//! Everything here is a union of sets or a "best K" by a total order, so that the result does not depend on the
//! order of blocks or the number of threads.

use std::collections::HashMap;

use crate::block::SourceKey;

/// Length of a sketch bin \[s\].
pub(crate) const SKETCH_BIN_S: f64 = 0.5;
/// Bins up to which the full number of rows is kept in each; beyond, fewer, so that a long survey takes no more memory.
const BINS_IN_FULL: usize = 512;

/// Rows kept in a bin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Limits {
    /// Return pairs: those furthest apart.
    pairs: usize,
    /// Sample points: those of largest hash.
    samples: usize,
}

impl Limits {
    /// Falls with the number of bins, at powers of two. A thread sees no more bins than all together, so it never
    /// drops a row that the union would keep.
    fn of(bins: usize) -> Self {
        let fold = ((bins.max(1) + 1).next_power_of_two() / 2 / BINS_IN_FULL).max(1);
        Self { pairs: (128 / fold).max(8), samples: (48 / fold).max(4) }
    }
}

/// First and last return of one pulse, in the local frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReturnPair {
    /// Survey time \[s\].
    pub time_s: f64,
    /// First return \[m\].
    pub first_m: [f64; 3],
    /// Last return \[m\].
    pub last_m: [f64; 3],
    /// Scan angle \[deg\], sign as in the file.
    pub scan_angle_deg: f32,
}

impl ReturnPair {
    fn separation_m(&self) -> f64 {
        let d = |k: usize| self.first_m[k] - self.last_m[k];
        (d(0) * d(0) + d(1) * d(1) + d(2) * d(2)).sqrt()
    }
}

/// A point of the sparse sample, in the local frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SamplePoint {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Position \[m\].
    pub point_m: [f64; 3],
    /// Scan angle \[deg\], sign as in the file.
    pub scan_angle_deg: f32,
}

/// Points of one source in one bin that follow each other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SightingRun {
    source: SourceKey,
    bin_start_s: f64,
    bin_end_s: f64,
    first_s: f64,
    last_s: f64,
    points: u64,
}

impl Default for SightingRun {
    fn default() -> Self {
        let (least, most) = (f64::NEG_INFINITY, f64::INFINITY);
        Self { source: SourceKey(0), bin_start_s: most, bin_end_s: least, first_s: most, last_s: least, points: 0 }
    }
}

impl SightingRun {
    /// A run of one point.
    #[allow(clippy::cast_precision_loss)]
    pub(crate) fn new(source: SourceKey, time_s: f64) -> Self {
        let bin_start_s = bin_of(time_s) as f64 * SKETCH_BIN_S;
        Self { source, bin_start_s, bin_end_s: bin_start_s + SKETCH_BIN_S, first_s: time_s, last_s: time_s, points: 1 }
    }

    /// Adds a point when it belongs to the run.
    #[inline]
    pub(crate) fn take(&mut self, source: SourceKey, time_s: f64) -> bool {
        let belongs = source == self.source && self.bin_start_s <= time_s && time_s < self.bin_end_s;
        if belongs {
            self.first_s = self.first_s.min(time_s);
            self.last_s = self.last_s.max(time_s);
            self.points += 1;
        }
        belongs
    }
}

#[allow(clippy::cast_possible_truncation)] // times are small
fn bin_of(time_s: f64) -> i64 {
    (time_s / SKETCH_BIN_S).floor() as i64
}

/// What is kept of one source in one bin.
#[derive(Debug, Clone, Default)]
pub struct BinSketch {
    /// First survey time \[s\].
    pub first_s: f64,
    /// Last survey time \[s\].
    pub last_s: f64,
    /// Points.
    pub points: u64,
    pairs: Vec<(u64, ReturnPair)>,
    samples: Vec<(u64, SamplePoint)>,
}

/// Keeps the `limit` rows of largest key; amortised by pruning at twice the limit.
fn keep_best<T: Copy>(rows: &mut Vec<(u64, T)>, limit: usize) {
    if rows.len() > limit {
        rows.select_nth_unstable_by_key(limit, |row| std::cmp::Reverse(row.0));
        rows.truncate(limit);
    }
}

/// A well mixed 64-bit hash (the finaliser of splitmix64).
#[must_use]
pub fn mix(mut v: u64) -> u64 {
    v = (v ^ (v >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    v ^ (v >> 31)
}

impl BinSketch {
    fn see(&mut self, first_s: f64, last_s: f64, points: u64) {
        if self.points == 0 {
            (self.first_s, self.last_s) = (first_s, last_s);
        }
        self.first_s = self.first_s.min(first_s);
        self.last_s = self.last_s.max(last_s);
        self.points += points;
    }

    fn offer_pair(&mut self, pair: ReturnPair, limits: Limits) {
        // separation in 0.1 mm, ties broken by the bits of the time: a total order
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let key = (((pair.separation_m() * 1e4) as u64) << 24) | (mix(pair.time_s.to_bits()) & 0xff_ffff);
        self.pairs.push((key, pair));
        if self.pairs.len() >= 2 * limits.pairs {
            keep_best(&mut self.pairs, limits.pairs);
        }
    }

    fn offer_sample(&mut self, sample: SamplePoint, limits: Limits) {
        let key = mix(sample.time_s.to_bits() ^ sample.point_m[0].to_bits().rotate_left(17));
        self.samples.push((key, sample));
        if self.samples.len() >= 2 * limits.samples {
            keep_best(&mut self.samples, limits.samples);
        }
    }

    fn merge(&mut self, other: Self, limits: Limits) {
        if self.points == 0 {
            *self = other;
            return;
        }
        if other.points > 0 {
            self.see(other.first_s, other.last_s, other.points);
        }
        self.pairs.extend(other.pairs);
        self.samples.extend(other.samples);
        self.prune(limits);
    }

    fn prune(&mut self, limits: Limits) {
        keep_best(&mut self.pairs, limits.pairs);
        keep_best(&mut self.samples, limits.samples);
    }

    fn settle(&mut self, limits: Limits) {
        self.prune(limits);
        self.pairs.sort_unstable_by_key(|row| std::cmp::Reverse(row.0));
        self.samples.sort_unstable_by_key(|row| std::cmp::Reverse(row.0));
        self.pairs.shrink_to_fit();
        self.samples.shrink_to_fit();
    }

    /// The kept return pairs, widest first.
    pub fn pairs(&self) -> impl Iterator<Item = &ReturnPair> {
        self.pairs.iter().map(|(_, pair)| pair)
    }
    /// The kept sample points.
    pub fn samples(&self) -> impl Iterator<Item = &SamplePoint> {
        self.samples.iter().map(|(_, sample)| sample)
    }
}

/// The sketches of all sources, by source and bin.
#[derive(Debug, Clone)]
pub struct Sketches {
    index: HashMap<(SourceKey, i64), u32>,
    rows: Vec<((SourceKey, i64), BinSketch)>,
    last: Option<((SourceKey, i64), u32)>,
    limits: Limits,
}

impl Default for Sketches {
    fn default() -> Self {
        Self { index: HashMap::new(), rows: Vec::new(), last: None, limits: Limits::of(0) }
    }
}

impl Sketches {
    /// Counts the points of a run.
    pub(crate) fn see(&mut self, run: &SightingRun) {
        if run.points > 0 {
            let row = self.row(run.source, run.first_s);
            self.rows[row].1.see(run.first_s, run.last_s, run.points);
        }
    }

    /// Offers a return pair; the widest of a bin are kept.
    pub fn offer_pair(&mut self, source: SourceKey, pair: ReturnPair) {
        let row = self.row(source, pair.time_s);
        self.rows[row].1.offer_pair(pair, self.limits);
    }

    /// Offers a sample point; those of largest hash are kept.
    pub fn offer_sample(&mut self, source: SourceKey, sample: SamplePoint) {
        let row = self.row(source, sample.time_s);
        self.rows[row].1.offer_sample(sample, self.limits);
    }

    /// The row of a source at a time, made when it is not there.
    #[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss)] // fewer than 2³² bins; times are small
    fn row(&mut self, source: SourceKey, time_s: f64) -> usize {
        if let Some((last, row)) = self.last
            && last.0 == source
            && (time_s * (1.0 / SKETCH_BIN_S) - last.1 as f64 - 0.5).abs() < 0.499_999
        {
            return row as usize;
        }
        let key = (source, bin_of(time_s));
        let next = self.rows.len() as u32;
        let row = *self.index.entry(key).or_insert(next);
        if row == next {
            self.rows.push((key, BinSketch::default()));
            let limits = Limits::of(self.rows.len());
            if limits != self.limits {
                self.limits = limits;
                for (_, sketch) in &mut self.rows {
                    sketch.prune(limits);
                    sketch.pairs.shrink_to_fit();
                    sketch.samples.shrink_to_fit();
                }
            }
        }
        self.last = Some((key, row));
        row as usize
    }

    /// Takes in the sketches of another thread.
    pub fn merge(&mut self, other: Self) {
        for ((source, bin), sketch) in other.rows {
            #[allow(clippy::cast_precision_loss)]
            let row = self.row(source, (bin as f64 + 0.5) * SKETCH_BIN_S);
            self.rows[row].1.merge(sketch, self.limits);
        }
    }

    /// All bins, by source and time.
    #[must_use]
    pub fn into_sorted(self) -> Vec<((SourceKey, i64), BinSketch)> {
        let (mut rows, limits) = (self.rows, self.limits);
        for (_, sketch) in &mut rows {
            sketch.settle(limits);
        }
        rows.sort_unstable_by_key(|(key, _)| *key);
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_halves_merged_in_any_order_are_the_same_sketch() {
        halves_agree(3_000, 0.001);
        // so many bins that fewer rows are kept in each
        halves_agree(60_000, 0.05);
    }

    #[test]
    fn rows_of_a_bin_fall_with_the_number_of_bins() {
        assert_eq!(Limits::of(0), Limits { pairs: 128, samples: 48 });
        assert_eq!(Limits::of(2 * BINS_IN_FULL - 1), Limits { pairs: 128, samples: 48 });
        assert_eq!(Limits::of(2 * BINS_IN_FULL), Limits { pairs: 64, samples: 24 });
        assert_eq!(Limits::of(1_000_000), Limits { pairs: 8, samples: 4 });
    }

    fn halves_agree(count: u32, step_s: f64) {
        let offer = |sketches: &mut Sketches, i: u32| {
            let time_s = f64::from(i) * step_s;
            let source = SourceKey::new(0, 1, 0);
            sketches.see(&SightingRun::new(source, time_s));
            sketches
                .offer_sample(source, SamplePoint { time_s, point_m: [f64::from(i), 0.0, 0.0], scan_angle_deg: 0.0 });
            let first_m = [0.0, 0.0, f64::from(i % 97)];
            sketches.offer_pair(source, ReturnPair { time_s, first_m, last_m: [0.0; 3], scan_angle_deg: 0.0 });
        };
        let (mut a, mut b, mut whole) = (Sketches::default(), Sketches::default(), Sketches::default());
        for i in 0..count {
            offer(if i % 3 == 0 { &mut a } else { &mut b }, i);
            offer(&mut whole, count - 1 - i);
        }
        let (mut ab, mut ba) = (a.clone(), b.clone());
        ab.merge(b);
        ba.merge(a);
        let text = |s: Sketches| format!("{:?}", s.into_sorted());
        let expected = text(whole);
        assert_eq!(text(ab), expected);
        assert_eq!(text(ba), expected);
    }
}
