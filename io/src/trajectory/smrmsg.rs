//! SMRMSG: the accuracies that `POSPac` writes beside an SBET, 10 little-endian f64 per epoch.
//!
//! | number | meaning |
//! |---|---|
//! | 0 | time \[s\], on the clock of the SBET |
//! | 1, 2, 3 | rms of position north, east, down \[m\] |
//! | 4, 5, 6 | rms of velocity north, east, down \[m/s\] |
//! | 7, 8, 9 | rms of roll, pitch, heading \[**arc minutes**\] |
//!
//! It has fewer epochs than its SBET (1 Hz against 200 Hz): it is joined **by time**, never by index.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{PoseSigma, PositionFrame, Trajectory};

use super::error::{Place, TrajectoryFileError};
use super::records::{Epoch, Records};
use super::sbet::next_record;
use super::writer::{PieceFormat, PieceWriter};

/// Bytes of a record.
pub const RECORD_BYTES: usize = 10 * 8;
/// Radians in an arc minute.
const ARC_MINUTE_RAD: f64 = std::f64::consts::PI / (180.0 * 60.0);

/// Accuracies over time.
#[derive(Debug, Clone)]
pub struct Accuracy {
    path: PathBuf,
    /// Times \[s\], strictly increasing, with at least two of them.
    time_s: Vec<f64>,
    sigma: Vec<PoseSigma>,
    notes: Vec<String>,
}

/// Reads an SMRMSG file.
///
/// # Errors
/// [`TrajectoryFileError`] names file, record, value and remedy.
pub fn read_smrmsg(path: &Path) -> Result<Accuracy, TrajectoryFileError> {
    let file = File::open(path).map_err(TrajectoryFileError::io(path))?;
    read_from(BufReader::with_capacity(1 << 18, file), path)
}

/// Reads an SMRMSG from any source of bytes; `path` is for messages only.
///
/// # Errors
/// As [`read_smrmsg`].
pub fn read_from(mut source: impl Read, path: &Path) -> Result<Accuracy, TrajectoryFileError> {
    // Order, duplicates, week's end and finiteness are those of a trajectory that stands still.
    let mut records = Records::new(path, PositionFrame::Map);
    let mut number = 0;
    while let Some(values) = next_record::<10>(&mut source, path, number)? {
        let place = Place::Record(number);
        if let Some(&value) = values[1..].iter().find(|v| v.abs() > 1e5) {
            let (path, column) = (path.to_path_buf(), "accuracy");
            return Err(TrajectoryFileError::Absurd { path, place, column, value, expected: "at most 1e5" });
        }
        let sigma = PoseSigma {
            position_ned_m: Vector3::new(values[1], values[2], values[3]),
            velocity_ned_mps: Vector3::new(values[4], values[5], values[6]),
            attitude_rph_rad: Vector3::new(values[7], values[8], values[9]) * ARC_MINUTE_RAD,
        };
        let zero = Vector3::zeros();
        let epoch = Epoch {
            time_s: values[0],
            position: zero,
            roll_pitch_heading_rad: zero,
            velocity_ned_mps: None,
            sigma: Some(sigma),
        };
        records.push(place, &epoch)?;
        number += 1;
    }
    if number == 0 {
        return Err(TrajectoryFileError::Empty { path: path.to_path_buf() });
    }
    let (trajectory, _, notes) = records.finish()?;
    let (time_s, sigma) = (trajectory.time_s().to_vec(), trajectory.sigma().to_vec());
    Ok(Accuracy { path: path.to_path_buf(), time_s, sigma, notes })
}

impl Accuracy {
    /// Times \[s\], strictly increasing.
    #[must_use]
    pub fn time_s(&self) -> &[f64] {
        &self.time_s
    }
    /// One sigma per time.
    #[must_use]
    pub fn sigma(&self) -> &[PoseSigma] {
        &self.sigma
    }
    /// What a user should be told.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The trajectory with the accuracies at its times: linear between records, constant beyond the ends.
    /// A difference of whole weeks between the two files is taken away. Also what a user should be told.
    ///
    /// # Errors
    /// [`TrajectoryFileError::AccuracyApart`] when the files share no moment.
    pub fn join(&self, trajectory: Trajectory) -> Result<(Trajectory, Vec<String>), TrajectoryFileError> {
        let (first, last) = trajectory.span_s();
        let (start, end) = (self.time_s[0], self.time_s[self.time_s.len() - 1]);
        let weeks_s = ((first - start) / SECONDS_PER_WEEK).round() * SECONDS_PER_WEEK;
        let Some(shift_s) = [0.0, weeks_s, weeks_s + SECONDS_PER_WEEK, weeks_s - SECONDS_PER_WEEK]
            .into_iter()
            .find(|shift| start + shift <= last && end + shift >= first)
        else {
            let (accuracy_s, trajectory_s) = ((start, end), (first, last));
            return Err(TrajectoryFileError::AccuracyApart { path: self.path.clone(), accuracy_s, trajectory_s });
        };
        let mut notes = Vec::new();
        let outside = trajectory.time_s().iter().filter(|&&t| t < start + shift_s || t > end + shift_s).count();
        // The accuracy file has one record a second: its ends may lie a second inside.
        if start + shift_s > first + 1.0 || end + shift_s < last - 1.0 {
            notes.push(format!(
                "{}: {outside} of {} epochs lie outside the accuracies and were given those of the nearest end",
                self.path.display(),
                trajectory.len()
            ));
        }
        let sigma = trajectory.time_s().iter().map(|t| self.at(t - shift_s)).collect();
        let path = self.path.clone();
        let joined = trajectory.with_sigma(sigma).map_err(|source| TrajectoryFileError::Trajectory { path, source })?;
        Ok((joined, notes))
    }

    /// The accuracy at a time \[s\] of this file.
    fn at(&self, time_s: f64) -> PoseSigma {
        let i = self.time_s.partition_point(|&t| t <= time_s).clamp(1, self.time_s.len() - 1) - 1;
        let u = ((time_s - self.time_s[i]) / (self.time_s[i + 1] - self.time_s[i])).clamp(0.0, 1.0);
        let (a, b) = (&self.sigma[i], &self.sigma[i + 1]);
        PoseSigma {
            position_ned_m: a.position_ned_m.lerp(&b.position_ned_m, u),
            velocity_ned_mps: a.velocity_ned_mps.lerp(&b.velocity_ned_mps, u),
            attitude_rph_rad: a.attitude_rph_rad.lerp(&b.attitude_rph_rad, u),
        }
    }
}

/// Writes the accuracies of a trajectory as SMRMSG, one record per epoch, whole or not at all.
///
/// # Errors
/// [`TrajectoryFileError::NoSigma`] when it has none; [`TrajectoryFileError::Io`] when the disk refuses.
pub fn write_smrmsg(path: &Path, trajectory: &Trajectory) -> Result<(), TrajectoryFileError> {
    if trajectory.sigma().is_empty() {
        return Err(TrajectoryFileError::NoSigma { path: path.to_path_buf() });
    }
    let mut writer = PieceWriter::create(path, PieceFormat::Smrmsg)?;
    writer.append(trajectory, 0..trajectory.len())?;
    writer.finish()
}

/// The ten numbers of an epoch.
pub(super) fn record(trajectory: &Trajectory, index: usize) -> [f64; 10] {
    let sigma = &trajectory.sigma()[index];
    let (p, v, a) = (sigma.position_ned_m, sigma.velocity_ned_mps, sigma.attitude_rph_rad / ARC_MINUTE_RAD);
    [trajectory.time_s()[index], p.x, p.y, p.z, v.x, v.y, v.z, a.x, a.y, a.z]
}
