//! Trajectories written piece by piece, so that a day of flight needs no more memory than a minute.

use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};

use tieline_filter::{PositionFrame, SurveyClock, Trajectory};

use super::csv;
use super::error::TrajectoryFileError;
use super::sbet::{self, need_frame};
use super::smrmsg;
use crate::output::WholeFile;

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PieceFormat {
    /// tieline's `trajectory.csv`, on a clock.
    Csv(SurveyClock),
    /// SBET.
    Sbet,
    /// SMRMSG: the accuracies.
    Smrmsg,
}

/// Writes a geodetic trajectory in pieces, whole or not at all: the file has its name when [`PieceWriter::finish`] returns.
#[derive(Debug)]
pub struct PieceWriter {
    path: PathBuf,
    format: PieceFormat,
    file: WholeFile,
    has_sigma: Option<bool>,
}

impl PieceWriter {
    /// Starts a file.
    ///
    /// # Errors
    /// [`TrajectoryFileError::Io`] when the folder refuses.
    pub fn create(path: &Path, format: PieceFormat) -> Result<Self, TrajectoryFileError> {
        let file = WholeFile::create(path).map_err(TrajectoryFileError::io(path))?;
        Ok(Self { path: path.to_path_buf(), format, file, has_sigma: None })
    }

    /// Writes some epochs of a piece; an SBET takes accelerations and rates from the epochs beside them.
    ///
    /// # Errors
    /// [`TrajectoryFileError::WrongFrame`] for map positions, [`TrajectoryFileError::NoSigma`] for accuracies that are
    /// missing, [`TrajectoryFileError::Io`] when the disk refuses.
    pub fn append(&mut self, piece: &Trajectory, epochs: Range<usize>) -> Result<(), TrajectoryFileError> {
        if self.format != PieceFormat::Smrmsg {
            need_frame(&self.path, piece, PositionFrame::Geodetic)?;
        }
        let has_sigma = !piece.sigma().is_empty();
        if self.format == PieceFormat::Smrmsg && !has_sigma {
            return Err(TrajectoryFileError::NoSigma { path: self.path.clone() });
        }
        let first = self.has_sigma.is_none();
        let with_sigma = *self.has_sigma.get_or_insert(has_sigma) && has_sigma;
        let out = self.file.writer();
        let written = match &self.format {
            PieceFormat::Csv(clock) => {
                let head = if first { csv::header(out, with_sigma) } else { Ok(()) };
                head.and_then(|()| csv::rows(out, piece, epochs, with_sigma, clock))
            }
            PieceFormat::Sbet => epochs.into_iter().try_for_each(|k| write_record(out, &sbet::record(piece, k))),
            PieceFormat::Smrmsg => epochs.into_iter().try_for_each(|k| write_record(out, &smrmsg::record(piece, k))),
        };
        written.map_err(TrajectoryFileError::io(&self.path))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// [`TrajectoryFileError::Io`] when the disk refuses.
    pub fn finish(self) -> Result<(), TrajectoryFileError> {
        self.file.finish().map_err(TrajectoryFileError::io(&self.path))
    }
}

/// Little-endian numbers of a record.
fn write_record(out: &mut impl Write, record: &[f64]) -> std::io::Result<()> {
    record.iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))
}

/// Writes a whole trajectory.
pub(super) fn write_all(path: &Path, trajectory: &Trajectory, format: PieceFormat) -> Result<(), TrajectoryFileError> {
    need_frame(path, trajectory, PositionFrame::Geodetic)?;
    let mut writer = PieceWriter::create(path, format)?;
    writer.append(trajectory, 0..trajectory.len())?;
    writer.finish()
}
