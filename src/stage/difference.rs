//! Points moved by the difference of two trajectories of any origin: the step after a trajectory was re-estimated.
//!
//! A point that was measured from the old pose is put where the same measurement leads from the new one. The IMU takes
//! the place of the scanner: the lever arm turns with the body, so that its effect is in the rotation of the vector
//! from the IMU to the point.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Result, anyhow, bail};
use nalgebra::{UnitQuaternion, Vector3};
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{Correction, Pose, Trajectory, ned_from_body};
use tieline_graph::{Calibration, PointMap, PoseCorrection};
use tieline_io::las::{Columns, EditError};

use crate::navigation::{common_pieces_s, median_interval_s, pieces_s};
use crate::report::data::FileSummary;
use crate::stage::correct::{Knots, rewrite_moved};
use crate::survey::SurveyFile;

/// Knots of the correction are made in blocks of this length \[s\].
const BLOCK_S: f64 = 0.5;
/// Widest and narrowest spacing of knots \[s\]; between them the epochs of the denser trajectory decide.
const KNOT_SPACING_S: (f64, f64) = (0.005, 0.05);
/// A correction is held beyond its first and last row for this long \[s\].
const HELD_S: f64 = 1.0;
/// Chunks of a file whose times are checked before anything is written.
const CHECKED_CHUNKS: usize = 9;
/// Stamps are rounded: this much \[s\] beyond the end of a trajectory is not beyond it.
const ROUNDING_S: f64 = 1e-3;

/// What the points are corrected to.
#[derive(Debug)]
pub enum Target {
    /// Another trajectory, on the same clock and in the same frame.
    Trajectory(Trajectory),
    /// New minus old, on the same clock, map axes.
    Correction(Correction),
}

/// The difference of two trajectories.
#[derive(Debug)]
pub struct Difference {
    old: Trajectory,
    target: Target,
    /// Times that both cover without a gap \[s\], in order.
    pieces_s: Vec<(f64, f64)>,
    spacing_s: f64,
}

impl Difference {
    /// The difference `target` - `old`, both in map coordinates and on the clock of the strips.
    ///
    /// # Errors
    /// When they have no time in common.
    pub fn new(old: Trajectory, target: Target) -> Result<Self> {
        let (of_target, interval_s) = match &target {
            Target::Trajectory(new) => (pieces_s(new), median_interval_s(new).min(median_interval_s(&old))),
            Target::Correction(correction) => (vec![span_of(correction)], median_interval_s(&old)),
        };
        let common = common_pieces_s(&pieces_s(&old), &of_target);
        if common.is_empty() {
            let (a, b) = (old.span_s(), (of_target[0].0, of_target[of_target.len() - 1].1));
            bail!(
                "--from ({:.3} s to {:.3} s) and --to ({:.3} s to {:.3} s) have no time in common; \
                 give two trajectories of one flight, or name the week of seconds of week with --week",
                a.0,
                a.1,
                b.0,
                b.1
            );
        }
        Ok(Self { old, target, pieces_s: common, spacing_s: interval_s.clamp(KNOT_SPACING_S.0, KNOT_SPACING_S.1) })
    }

    /// The piece that holds a time \[s\].
    fn piece(&self, time_s: f64) -> Option<usize> {
        let after = self.pieces_s.partition_point(|p| p.0 - ROUNDING_S <= time_s);
        let piece = after.checked_sub(1)?;
        (time_s <= self.pieces_s[piece].1 + ROUNDING_S).then_some(piece)
    }

    /// Why a time \[s\] has no correction.
    fn not_covered(&self, time_s: f64) -> String {
        let (first, last) = (self.pieces_s[0].0, self.pieces_s[self.pieces_s.len() - 1].1);
        if time_s < first || time_s > last {
            format!(
                "time {time_s:.3} s is not covered: --from and --to together reach from {first:.3} s to {last:.3} s; \
                 give the trajectories of this flight, or name the week of seconds of week with --week"
            )
        } else {
            let after = self.pieces_s.partition_point(|p| p.0 <= time_s).min(self.pieces_s.len() - 1);
            format!(
                "time {time_s:.3} s falls into a gap of --from or --to, from {:.3} s to {:.3} s; \
                 give trajectories without it, or leave these points out",
                self.pieces_s[after.saturating_sub(1)].1,
                self.pieces_s[after].0
            )
        }
    }

    /// Checks that a file is covered, by the times of up to nine of its chunks, first and last among them.
    ///
    /// # Errors
    /// When it is not, or cannot be read.
    pub fn check(&self, file: &SurveyFile) -> Result<()> {
        let (mut records, mut columns) = (Vec::new(), Columns::default());
        let last = file.las.chunk_count().saturating_sub(1);
        let taken = CHECKED_CHUNKS.min(last + 1);
        for k in 0..taken {
            file.las.read_columns(last * k / (taken - 1).max(1), &mut records, &mut columns)?;
            for time_s in columns.gps_time.iter().map(|t| t + file.time_shift_s) {
                if self.piece(time_s).is_none() {
                    bail!("{}: {}", file.las.path().display(), self.not_covered(time_s));
                }
            }
        }
        Ok(())
    }

    /// How points that were measured at a time \[s\] move.
    fn map_at(&self, time_s: f64) -> Result<PointMap> {
        let no_pose = || anyhow!("no pose at {time_s:.6} s");
        let old = self.old.pose_at(time_s).ok_or_else(no_pose)?;
        let correction = match &self.target {
            Target::Trajectory(new) => pose_correction(&old, &new.pose_at(time_s).ok_or_else(no_pose)?),
            Target::Correction(correction) => {
                let (enu_m, rph_rad) = correction.at(time_s);
                let (roll, pitch, heading) = roll_pitch_heading_rad(&old.ned_from_body);
                let attitude = ned_from_body(roll + rph_rad.x, pitch + rph_rad.y, heading + rph_rad.z);
                pose_correction(&old, &Pose { position: old.position + enu_m, ned_from_body: attitude, ..old })
            }
        };
        Ok(PointMap::new(&old, &Vector3::zeros(), &correction, &Calibration::default()))
    }

    /// Knots of block `number` of a piece.
    #[allow(clippy::cast_precision_loss)] // a clock of weeks has few blocks
    fn knots(&self, piece: usize, number: i64) -> Result<Knots> {
        let (first_s, last_s) = self.pieces_s[piece];
        let start_s = (number as f64 * BLOCK_S).clamp(first_s, last_s);
        let end_s = ((number + 1) as f64 * BLOCK_S).clamp(first_s, last_s);
        Knots::spaced(start_s, end_s, self.spacing_s, |time_s| self.map_at(time_s.clamp(first_s, last_s)))
    }
}

/// First and last time of a correction with what is held beyond; a single row holds for ever.
fn span_of(correction: &Correction) -> (f64, f64) {
    let rows = correction.rows();
    match rows {
        [first, .., last] => (first.time_s - HELD_S, last.time_s + HELD_S),
        _ => (f64::NEG_INFINITY, f64::INFINITY),
    }
}

/// What leads from one pose to the other.
fn pose_correction(old: &Pose, new: &Pose) -> PoseCorrection {
    let turned: UnitQuaternion<f64> = new.ned_from_body * old.ned_from_body.inverse();
    PoseCorrection { position_ned_m: old.ned_vector_m(&new.position), rotation_ned_rad: turned.scaled_axis() }
}

/// Writes one file with its points moved by a difference of trajectories.
///
/// # Errors
/// When a point is not covered, a chunk cannot be read, or the output cannot be written.
pub fn correct_file_by(
    file: &SurveyFile,
    output: &Path,
    difference: &Difference,
    advance: &(dyn Fn(u64) + Sync),
) -> Result<FileSummary> {
    let time_at = file.las.layout().gps_time.ok_or_else(|| anyhow!("{}: no GPS time", file.las.path().display()))?;
    rewrite_moved(&file.las, output, None, advance, |first, records, record_length, points| {
        let mut blocks = Blocks { difference, made: HashMap::new() };
        let mut largest_square = 0.0_f64;
        for (i, (record, xyz)) in records.chunks_exact(record_length).zip(points.iter_mut()).enumerate() {
            let mut bytes = [0_u8; 8];
            bytes.copy_from_slice(&record[time_at..time_at + 8]);
            let time_s = f64::from_le_bytes(bytes) + file.time_shift_s;
            let map = blocks.at(time_s).map_err(|reason| format!("point {}: {reason}", first + i as u64))?;
            let shift_m = map.delta_m(&Vector3::from(*xyz));
            largest_square = largest_square.max(shift_m.norm_squared());
            for (coordinate, shift) in xyz.iter_mut().zip(shift_m.iter()) {
                *coordinate += shift;
            }
        }
        Ok(largest_square.sqrt())
    })
}

/// The knots that a block of points has needed so far.
struct Blocks<'a> {
    difference: &'a Difference,
    made: HashMap<(usize, i64), Knots>,
}

impl Blocks<'_> {
    #[allow(clippy::cast_possible_truncation)] // a number of half seconds
    fn at(&mut self, time_s: f64) -> Result<PointMap, EditError> {
        let piece = self.difference.piece(time_s).ok_or_else(|| self.difference.not_covered(time_s))?;
        let (first_s, last_s) = self.difference.pieces_s[piece];
        let time_s = time_s.clamp(first_s, last_s);
        let key = (piece, (time_s / BLOCK_S).floor() as i64);
        let knots = match self.made.entry(key) {
            std::collections::hash_map::Entry::Occupied(made) => made.into_mut(),
            std::collections::hash_map::Entry::Vacant(empty) => {
                empty.insert(self.difference.knots(key.0, key.1).map_err(|e| e.to_string())?)
            }
        };
        Ok(knots.at(time_s))
    }
}
