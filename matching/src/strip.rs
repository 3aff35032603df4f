//! Strips told apart: by file, by point source id, by a gap in GPS time, or any combination.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::block::SourceKey;
use crate::sketch::BinSketch;

/// One uninterrupted run of one scanner system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Strip {
    /// Name in reports: point source id, file or number, as they tell strips apart.
    pub name: String,
    /// File and point source id (those of them that tell strips apart).
    pub source: SourceKey,
    /// First survey time \[s\].
    pub start_s: f64,
    /// Last survey time \[s\].
    pub end_s: f64,
    /// Points.
    pub points: u64,
    /// Missions are flights far apart in time, between which a scanner may have been mounted anew; from 0.
    pub mission: u16,
    /// Bins of the sketches that belong to the strip, as a range of rows per scanner.
    pub scanners: Vec<u16>,
}

/// How strips are told apart in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StripOptions {
    /// A gap longer than this in the time of one source begins a new strip \[s\]; `None`: never.
    pub time_gap_s: Option<f64>,
    /// A gap longer than this between strips begins a new mission \[s\].
    pub mission_gap_s: f64,
}

impl Default for StripOptions {
    fn default() -> Self {
        Self { time_gap_s: Some(30.0), mission_gap_s: 6.0 * 3600.0 }
    }
}

/// The strips of a survey and the look-up from a point's source and time.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StripIndex {
    strips: Vec<Strip>,
    scanner_numbers: Vec<u16>,
}

impl StripIndex {
    /// Tells strips apart from sketches sorted by source and time; `name` makes a name of a source and a number.
    #[must_use]
    pub fn new(
        sketches: &[((SourceKey, i64), BinSketch)],
        options: StripOptions,
        name: impl Fn(SourceKey, usize, usize) -> String,
    ) -> Self {
        let scanner_numbers: Vec<u16> =
            sketches.iter().map(|((s, _), _)| s.scanner()).collect::<BTreeSet<_>>().into_iter().collect();
        let mut bins: Vec<(SourceKey, u16, &BinSketch)> =
            sketches.iter().map(|((s, _), bin)| (s.without_scanner(), s.scanner(), bin)).collect();
        bins.sort_by(|a, b| a.0.cmp(&b.0).then(a.2.first_s.total_cmp(&b.2.first_s)).then(a.1.cmp(&b.1)));
        let mut strips: Vec<Strip> = Vec::new();
        for (source, scanner, bin) in bins {
            let scanner = index_of(&scanner_numbers, scanner);
            match strips.last_mut() {
                Some(strip)
                    if strip.source == source
                        && options.time_gap_s.is_none_or(|gap| bin.first_s - strip.end_s <= gap) =>
                {
                    strip.end_s = strip.end_s.max(bin.last_s);
                    strip.points += bin.points;
                    if !strip.scanners.contains(&scanner) {
                        strip.scanners.push(scanner);
                        strip.scanners.sort_unstable();
                    }
                }
                _ => strips.push(Strip {
                    name: String::new(),
                    source,
                    start_s: bin.first_s,
                    end_s: bin.last_s,
                    points: bin.points,
                    mission: 0,
                    scanners: vec![scanner],
                }),
            }
        }
        let mut index = Self { strips, scanner_numbers };
        index.name_strips(name);
        index.number_missions(options.mission_gap_s);
        index
    }

    fn name_strips(&mut self, name: impl Fn(SourceKey, usize, usize) -> String) {
        for i in 0..self.strips.len() {
            let source = self.strips[i].source;
            let of_source = self.strips.iter().filter(|s| s.source == source).count();
            let number = self.strips[..i].iter().filter(|s| s.source == source).count();
            self.strips[i].name = name(source, number, of_source);
        }
    }

    fn number_missions(&mut self, gap_s: f64) {
        let mut order: Vec<usize> = (0..self.strips.len()).collect();
        order.sort_by(|&a, &b| self.strips[a].start_s.total_cmp(&self.strips[b].start_s));
        let (mut mission, mut end_s) = (0_u16, f64::NEG_INFINITY);
        for (k, &i) in order.iter().enumerate() {
            if k > 0 && self.strips[i].start_s - end_s > gap_s {
                mission += 1;
            }
            end_s = end_s.max(self.strips[i].end_s);
            self.strips[i].mission = mission;
        }
    }

    /// All strips, by file, point source id and time.
    #[must_use]
    pub fn strips(&self) -> &[Strip] {
        &self.strips
    }

    /// The scanner numbers as they stand in the files; a scanner's index is its place here.
    #[must_use]
    pub fn scanner_numbers(&self) -> &[u16] {
        &self.scanner_numbers
    }

    /// Strip and scanner index of a source at a time.
    #[must_use]
    #[allow(clippy::cast_possible_truncation)]
    pub fn find(&self, source: SourceKey, time_s: f64) -> Option<(u32, u16)> {
        let strip_source = source.without_scanner();
        let from = self.strips.partition_point(|s| s.source < strip_source);
        let row = self.strips[from..]
            .iter()
            .take_while(|s| s.source == strip_source)
            .position(|s| time_s >= s.start_s - 1e-6 && time_s <= s.end_s + 1e-6)?;
        let scanner = self.scanner_numbers.binary_search(&source.scanner()).ok()?;
        Some(((from + row) as u32, scanner as u16))
    }
}

#[allow(clippy::cast_possible_truncation)]
fn index_of(numbers: &[u16], number: u16) -> u16 {
    numbers.partition_point(|&n| n < number) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sketch::{SightingRun, Sketches};

    fn sketches(rows: &[(SourceKey, f64)]) -> Vec<((SourceKey, i64), BinSketch)> {
        let mut sketches = Sketches::default();
        for (source, time_s) in rows {
            sketches.see(&SightingRun::new(*source, *time_s));
        }
        sketches.into_sorted()
    }

    fn name(source: SourceKey, number: usize, of: usize) -> String {
        if of > 1 { format!("{}.{number}", source.point_source_id()) } else { source.point_source_id().to_string() }
    }

    #[test]
    fn a_gap_in_time_begins_a_new_strip_and_a_long_one_a_new_mission() {
        let s = SourceKey::new(0, 0, 0);
        let index = StripIndex::new(
            &sketches(&[(s, 1.0), (s, 20.0), (s, 100.0), (s, 90_000.0)]),
            StripOptions::default(),
            name,
        );
        let spans: Vec<_> = index.strips().iter().map(|s| (s.start_s, s.end_s, s.mission)).collect();
        assert_eq!(spans, vec![(1.0, 20.0, 0), (100.0, 100.0, 0), (90_000.0, 90_000.0, 1)]);
        assert_eq!(index.find(s, 100.0), Some((1, 0)));
        assert_eq!(index.find(s, 50.0), None);
    }

    #[test]
    fn two_scanners_of_one_strip_share_it_and_are_numbered_from_zero() {
        let (a, b) = (SourceKey::new(0, 706, 6), SourceKey::new(0, 706, 7));
        let index = StripIndex::new(&sketches(&[(a, 1.0), (b, 1.1)]), StripOptions::default(), name);
        assert_eq!(index.strips().len(), 1);
        assert_eq!(index.strips()[0].name, "706");
        assert_eq!((index.find(a, 1.0), index.find(b, 1.1)), (Some((0, 0)), Some((0, 1))));
        assert_eq!(index.scanner_numbers(), [6, 7]);
    }
}
