//! A look at a few chunks of every survey before the work: what tells sources apart, how dense and how rough it is.

use std::collections::BTreeMap;

use anyhow::Result;
use tieline_io::las::Columns;
use tieline_matching::{PointBlock, ScannerField, SourceRule, mix};

use crate::project::{Project, ScannerChoice, SplitWord};
use crate::survey::{Survey, SurveyFile};

/// Chunks that are looked at.
const CHUNKS: usize = 5;
/// Of these, chunks that density is taken from.
const DENSITY_CHUNKS: usize = 3;

/// A few chunks in columns.
#[derive(Debug)]
pub struct Sample {
    /// Number of the file and its columns.
    pub chunks: Vec<(usize, Columns, u64)>,
}

/// A block of points of a file for matching; `zeros` stands in for times that a control surface may lack.
#[must_use]
pub fn block<'a>(file: &SurveyFile, columns: &'a Columns, zeros: &'a [f64], first_point: u64) -> PointBlock<'a> {
    let header = file.las.header();
    PointBlock {
        x: &columns.x,
        y: &columns.y,
        z: &columns.z,
        scale_m: header.scale,
        offset_m: header.offset,
        gps_time_s: if columns.gps_time.is_empty() { zeros } else { &columns.gps_time },
        time_shift_s: file.time_shift_s,
        return_number: &columns.return_number,
        number_of_returns: &columns.number_of_returns,
        classification: &columns.classification,
        flags: &columns.flags,
        scan_angle_deg: &columns.scan_angle_deg,
        user_data: &columns.user_data,
        point_source_id: &columns.point_source_id,
        scanner_channel: &columns.scanner_channel,
        intensity: &columns.intensity,
        file: file.number,
        first_point,
    }
}

impl Sample {
    /// Reads chunks spread evenly over the survey.
    ///
    /// # Errors
    /// When a chunk cannot be read.
    pub fn read(survey: &Survey) -> Result<Self> {
        let all: Vec<(usize, usize)> = survey
            .strip_files()
            .enumerate()
            .flat_map(|(f, file)| (0..file.las.chunk_count()).map(move |c| (f, c)))
            .collect();
        // spread by the golden ratio, so that no period in the order of chunks is met
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
        let mut picked: Vec<usize> =
            (0..CHUNKS).map(|k| ((0.5 + k as f64 * 0.618_033_988_75).fract() * all.len() as f64) as usize).collect();
        picked.sort_unstable();
        picked.dedup();
        let mut chunks = Vec::new();
        let mut records = Vec::new();
        for (f, c) in picked.into_iter().filter_map(|k| all.get(k).copied()) {
            let las = &survey.files[f].las;
            las.read_chunk(c, &mut records)?;
            let mut columns = Columns::default();
            columns.fill(&records, las.layout());
            chunks.push((f, columns, las.chunk_points(c).start));
        }
        Ok(Self { chunks })
    }

    /// What tells sources apart, with the reason.
    #[must_use]
    pub fn source_rule(&self, project: &Project) -> (SourceRule, String) {
        let any = |word| project.strips.iter().any(|s| s.split.has(word));
        let auto = any(SplitWord::Auto);
        let has_ids = self.chunks.iter().any(|(_, c, _)| c.point_source_id.iter().any(|id| *id != 0));
        let by_point_source_id = any(SplitWord::PointSourceId) || (auto && has_ids);
        // strips of one section may be fixed while others move: then files must be told apart
        let some_fixed = project.strips.len() > 1 && project.strips.iter().any(|s| s.fixed);
        let by_file = any(SplitWord::File) || some_fixed;
        let (scanner, why) = self.scanner_field(project);
        let split = match (by_file, by_point_source_id, auto || any(SplitWord::TimeGap)) {
            (false, true, true) => "by point source id and gaps in time",
            (false, true, false) => "by point source id",
            (false, false, _) => "by gaps in time (point source ids are all 0)",
            (true, false, _) => "by file",
            (true, true, _) => "by file and point source id",
        };
        (SourceRule { by_file, by_point_source_id, scanner }, format!("strips {split}; {why}"))
    }

    fn scanner_field(&self, project: &Project) -> (ScannerField, String) {
        let choice = project.strips.iter().map(|s| s.scanner).find(|s| *s != ScannerChoice::Auto);
        match choice {
            Some(ScannerChoice::Single) => return (ScannerField::Single, String::from("one scanner, as asked")),
            Some(ScannerChoice::Channel) => {
                return (ScannerField::Channel, String::from("scanner by channel, as asked"));
            }
            Some(ScannerChoice::UserData) => {
                return (ScannerField::UserData, String::from("scanner by user data, as asked"));
            }
            Some(ScannerChoice::File) => return (ScannerField::File, String::from("one file a scanner, as asked")),
            _ => {}
        }
        if self.shares_a_strip(|c| &c.scanner_channel) {
            return (ScannerField::Channel, String::from("scanner by channel (several in one strip)"));
        }
        if self.shares_a_strip(|c| &c.user_data) {
            return (ScannerField::UserData, String::from("scanner by user data (several in one strip)"));
        }
        (
            ScannerField::Single,
            String::from("one scanner (neither channel nor user data take several values in one strip)"),
        )
    }

    /// Whether a byte takes two to four values within a strip (one point source id, no gap in time) and all returns of
    /// a pulse have the same: so do the heads of a scanner, which may fire at the same moments, and flags that somebody set
    /// point by point do not.
    fn shares_a_strip(&self, field: impl Fn(&Columns) -> &Vec<u8>) -> bool {
        const GAP_S: f64 = 30.0;
        let mut rows: Vec<(u16, f64, u8, u8)> = Vec::new();
        for (_, columns, _) in &self.chunks {
            let row = |i: usize| {
                (columns.point_source_id[i], columns.gps_time[i], field(columns)[i], columns.number_of_returns[i])
            };
            rows.extend((0..columns.gps_time.len()).map(row));
        }
        rows.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        rows.chunk_by(|a, b| a.0 == b.0 && b.1 - a.1 <= GAP_S).any(|strip| {
            let mut counts: BTreeMap<u8, usize> = BTreeMap::new();
            for row in strip {
                *counts.entry(row.2).or_default() += 1;
            }
            // a pulse of several returns is whole within one value
            let pulses = strip.chunk_by(|a, b| a.1.to_bits() == b.1.to_bits() && a.2 == b.2).filter(|p| p[0].3 > 1);
            let (whole, all) =
                pulses.fold((0, 0), |(whole, all), p| (whole + usize::from(p.len() == usize::from(p[0].3)), all + 1));
            (2..=4).contains(&counts.len()) && counts.values().all(|n| 20 * n >= strip.len()) && 100 * whole >= 95 * all
        })
    }

    /// Median number of last returns of one source in the cell that a point falls into, for each width of `widths_m` up
    /// to the first that holds `enough`.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn points_per_cell(&self, survey: &Survey, rule: &SourceRule, widths_m: &[f64], enough: f64) -> Vec<f64> {
        let mut keys: Vec<u64> = Vec::new();
        let mut result = Vec::new();
        for width_m in widths_m {
            keys.clear();
            for (chunk, (f, columns, first)) in self.chunks.iter().enumerate().take(DENSITY_CHUNKS) {
                let file = &survey.files[*f];
                let block = block(file, columns, &[], *first);
                let step = file.las.header().scale.map(|s| s / width_m);
                for i in 0..columns.len() {
                    if columns.return_number[i] >= columns.number_of_returns[i] {
                        let x = (f64::from(columns.x[i]) * step[0]).floor() as i64;
                        let y = (f64::from(columns.y[i]) * step[1]).floor() as i64;
                        keys.push(mix(mix(mix(x as u64) ^ y as u64)
                            ^ rule.source(&block, i).0
                            ^ ((chunk as u64) << 56)));
                    }
                }
            }
            keys.sort_unstable();
            let mut sizes: Vec<u32> = keys.chunk_by(|a, b| a == b).map(|cell| cell.len() as u32).collect();
            sizes.sort_unstable();
            let total: u64 = sizes.iter().map(|n| u64::from(*n)).sum();
            let mut so_far = 0;
            let median = sizes.iter().find(|n| {
                so_far += u64::from(**n);
                2 * so_far >= total
            });
            result.push(f64::from(median.copied().unwrap_or(0)));
            if result.last().is_some_and(|n| *n >= enough) {
                break;
            }
        }
        result
    }
}
