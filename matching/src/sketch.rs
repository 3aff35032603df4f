//! What is kept of every source over time beside the cells: when it measured, its widest return pairs, and a
//! sparse sample of points. Strips, passes and rebuilt trajectories come from it.
//!
//! Everything here is a union of sets or a "best K" by a total order, so that the result does not depend on the
//! order of blocks or the number of threads.

use std::collections::HashMap;

use crate::block::SourceKey;

/// Length of a sketch bin \[s\].
pub(crate) const SKETCH_BIN_S: f64 = 0.5;
/// Return pairs kept in a bin: those furthest apart.
const PAIRS_PER_BIN: usize = 128;
/// Sample points kept in a bin: those of smallest hash.
const SAMPLES_PER_BIN: usize = 48;

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
        rows.sort_by_key(|row| std::cmp::Reverse(row.0));
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
    /// Counts a point.
    #[inline]
    pub fn see(&mut self, time_s: f64) {
        if self.points == 0 {
            self.first_s = time_s;
            self.last_s = time_s;
        }
        self.first_s = self.first_s.min(time_s);
        self.last_s = self.last_s.max(time_s);
        self.points += 1;
    }

    /// Offers a return pair; the widest are kept.
    pub fn offer_pair(&mut self, pair: ReturnPair) {
        // separation in 0.1 mm, ties broken by the bits of the time: a total order
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let key = (((pair.separation_m() * 1e4) as u64) << 24) | (mix(pair.time_s.to_bits()) & 0xff_ffff);
        self.pairs.push((key, pair));
        if self.pairs.len() >= 2 * PAIRS_PER_BIN {
            keep_best(&mut self.pairs, PAIRS_PER_BIN);
        }
    }

    /// Offers a sample point; those of largest hash are kept.
    pub fn offer_sample(&mut self, sample: SamplePoint) {
        let key = mix(sample.time_s.to_bits() ^ sample.point_m[0].to_bits().rotate_left(17));
        self.samples.push((key, sample));
        if self.samples.len() >= 2 * SAMPLES_PER_BIN {
            keep_best(&mut self.samples, SAMPLES_PER_BIN);
        }
    }

    fn merge(&mut self, other: Self) {
        if self.points == 0 {
            *self = other;
            return;
        }
        if other.points > 0 {
            self.first_s = self.first_s.min(other.first_s);
            self.last_s = self.last_s.max(other.last_s);
            self.points += other.points;
        }
        self.pairs.extend(other.pairs);
        self.samples.extend(other.samples);
        keep_best(&mut self.pairs, PAIRS_PER_BIN);
        keep_best(&mut self.samples, SAMPLES_PER_BIN);
    }

    fn settle(&mut self) {
        keep_best(&mut self.pairs, PAIRS_PER_BIN);
        keep_best(&mut self.samples, SAMPLES_PER_BIN);
        self.pairs.sort_by_key(|row| std::cmp::Reverse(row.0));
        self.samples.sort_by_key(|row| std::cmp::Reverse(row.0));
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
#[derive(Debug, Clone, Default)]
pub struct Sketches {
    index: HashMap<(SourceKey, i64), u32>,
    rows: Vec<((SourceKey, i64), BinSketch)>,
    last: Option<((SourceKey, i64), u32)>,
}

impl Sketches {
    /// The sketch of a source at a time, made when it is not there.
    #[inline]
    #[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss)] // fewer than 2³² bins; times are small
    pub fn at(&mut self, source: SourceKey, time_s: f64) -> &mut BinSketch {
        if let Some((last, row)) = self.last
            && last.0 == source
            && (time_s * (1.0 / SKETCH_BIN_S) - last.1 as f64 - 0.5).abs() < 0.499_999
        {
            return &mut self.rows[row as usize].1;
        }
        let key = (source, (time_s / SKETCH_BIN_S).floor() as i64);
        let row = match self.last {
            Some((last, row)) if last == key => row,
            _ => {
                let next = self.rows.len() as u32;
                let row = *self.index.entry(key).or_insert(next);
                if row == next {
                    self.rows.push((key, BinSketch::default()));
                }
                self.last = Some((key, row));
                row
            }
        };
        &mut self.rows[row as usize].1
    }

    /// Takes in the sketches of another thread.
    pub fn merge(&mut self, other: Self) {
        for ((source, bin), sketch) in other.rows {
            #[allow(clippy::cast_precision_loss)]
            self.at(source, (bin as f64 + 0.5) * SKETCH_BIN_S).merge(sketch);
        }
    }

    /// All bins, by source and time.
    #[must_use]
    pub fn into_sorted(self) -> Vec<((SourceKey, i64), BinSketch)> {
        let mut rows = self.rows;
        for (_, sketch) in &mut rows {
            sketch.settle();
        }
        rows.sort_by_key(|(key, _)| *key);
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_halves_merged_in_any_order_are_the_same_sketch() {
        let offer = |sketches: &mut Sketches, i: u32| {
            let time_s = f64::from(i) * 0.001;
            let bin = sketches.at(SourceKey::new(0, 1, 0), time_s);
            bin.see(time_s);
            bin.offer_sample(SamplePoint { time_s, point_m: [f64::from(i), 0.0, 0.0], scan_angle_deg: 0.0 });
            bin.offer_pair(ReturnPair {
                time_s,
                first_m: [0.0, 0.0, f64::from(i % 97)],
                last_m: [0.0; 3],
                scan_angle_deg: 0.0,
            });
        };
        let (mut a, mut b, mut whole) = (Sketches::default(), Sketches::default(), Sketches::default());
        for i in 0..3_000 {
            offer(if i % 3 == 0 { &mut a } else { &mut b }, i);
            offer(&mut whole, 2_999 - i);
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
