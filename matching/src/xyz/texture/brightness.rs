//! What a scanner makes of range and incidence, taken off: brightness against the median at like ranges.

/// Width of a bin of range \[m\].
const RANGE_BIN_M: f64 = 0.25;
/// Bins of range; what is further counts in the last.
const RANGE_BINS: usize = 128;
/// Width of a bin of ln intensity.
const LEVEL_BIN: f64 = 1.0 / 12.0;
const LEVEL_BINS: usize = 134; // ln 65 535 = 11.09
/// Fewer points of a scanner at a range tell no median of their own.
const FEWEST: u64 = 200;

/// Counts of ln intensity by scanner and range. On level ground the incidence follows from the range and the height of the scanner: one
/// median takes off both, and what the receiver does beside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Brightness {
    counts: Vec<Vec<u32>>,
}

impl Brightness {
    /// Counts a point.
    pub fn count(&mut self, scanner: u16, range_m: f64, intensity: u16) {
        let scanner = usize::from(scanner);
        if self.counts.len() <= scanner {
            self.counts.resize(scanner + 1, Vec::new());
        }
        let of_scanner = &mut self.counts[scanner];
        if of_scanner.is_empty() {
            of_scanner.resize(RANGE_BINS * LEVEL_BINS, 0);
        }
        let bin = &mut of_scanner[range_bin(range_m) * LEVEL_BINS + level_bin(intensity)];
        *bin = bin.saturating_add(1);
    }

    /// Adds the counts of another thread.
    pub fn merge(&mut self, other: &Self) {
        if self.counts.len() < other.counts.len() {
            self.counts.resize(other.counts.len(), Vec::new());
        }
        for (mine, theirs) in self.counts.iter_mut().zip(&other.counts) {
            if mine.is_empty() {
                mine.clone_from(theirs);
            } else {
                mine.iter_mut().zip(theirs).for_each(|(a, b)| *a = a.saturating_add(*b));
            }
        }
    }

    /// The medians.
    pub(super) fn normal_levels(&self) -> NormalLevels {
        NormalLevels { by_scanner: self.counts.iter().map(|c| medians(c)).collect() }
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative, bounded
fn range_bin(range_m: f64) -> usize {
    ((range_m.max(0.0) / RANGE_BIN_M) as usize).min(RANGE_BINS - 1)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // ln of 1 and more, bounded
fn level_bin(intensity: u16) -> usize {
    ((f64::from(intensity.max(1)).ln() / LEVEL_BIN) as usize).min(LEVEL_BINS - 1)
}

/// Median ln intensity by range; ranges with few points take that of the nearest with enough.
#[allow(clippy::cast_precision_loss)]
fn medians(counts: &[u32]) -> Vec<f64> {
    let found: Vec<Option<f64>> = counts
        .chunks(LEVEL_BINS)
        .map(|levels| {
            let all: u64 = levels.iter().map(|n| u64::from(*n)).sum();
            if all < FEWEST {
                return None;
            }
            let (half, mut below) = (all as f64 / 2.0, 0.0);
            levels.iter().enumerate().find_map(|(k, n)| {
                let n = f64::from(*n);
                below += n;
                (below >= half).then(|| (k as f64 + 1.0 - (below - half) / n) * LEVEL_BIN)
            })
        })
        .collect();
    let nearest = |bin: usize| (0..RANGE_BINS).filter(|k| found[*k].is_some()).min_by_key(|k| k.abs_diff(bin));
    (0..found.len()).map(|bin| nearest(bin).and_then(|k| found[k]).unwrap_or(0.0)).collect()
}

/// What is normal for each scanner at each range.
#[derive(Debug, Clone)]
pub(super) struct NormalLevels {
    by_scanner: Vec<Vec<f64>>,
}

impl NormalLevels {
    /// ln of the intensity over what is normal, linear between the bins' middles.
    #[allow(clippy::cast_precision_loss)]
    pub(super) fn relative(&self, scanner: u16, range_m: f64, intensity: u16) -> f64 {
        let level = f64::from(intensity.max(1)).ln();
        let Some(medians) = self.by_scanner.get(usize::from(scanner)).filter(|m| !m.is_empty()) else { return level };
        let at = (range_m / RANGE_BIN_M - 0.5).clamp(0.0, (RANGE_BINS - 1) as f64);
        let low = range_bin(at * RANGE_BIN_M).min(RANGE_BINS - 2);
        let share = at - low as f64;
        level - (medians[low] * (1.0 - share) + medians[low + 1] * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn what_a_scanner_makes_of_range_is_taken_off() {
        let mut counts = Brightness::default();
        let seen = |range_m: f64, reflectance: f64, k: u32| {
            (reflectance * (1.0 + 0.05 * (f64::from(k) * 0.7).sin()) * 60_000.0 / range_m.powi(2)) as u16
        };
        for k in 0..60_000_u32 {
            let range_m = 2.0 + f64::from(k % 600) / 100.0;
            let reflectance = if k % 9 == 0 { 0.5 } else { 0.14 }; // paint is rarer than asphalt
            counts.count(1, range_m, seen(range_m, reflectance, k));
        }
        let mut twice = Brightness::default();
        twice.merge(&counts);
        assert_eq!(twice, counts);
        let levels = counts.normal_levels();
        for range_m in [2.4, 4.05, 7.3] {
            let asphalt = levels.relative(1, range_m, seen(range_m, 0.14, 0));
            let paint = levels.relative(1, range_m, seen(range_m, 0.5, 0));
            assert!(asphalt.abs() < 0.06, "{range_m} {asphalt}");
            assert!((paint - asphalt - (0.5_f64 / 0.14).ln()).abs() < 0.02, "{range_m} {paint}");
        }
    }
}
