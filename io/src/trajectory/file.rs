//! Any trajectory file, recognised by its first bytes.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use tieline_filter::{TimeEncoding, Trajectory};

use super::error::TrajectoryFileError;
use super::{sbet, smrmsg, text, trj};
use crate::crs::{Crs, CrsError};
use crate::delimited::is_text;

/// The formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrajectoryFormat {
    /// Applanix SBET: 17 × f64.
    Sbet,
    /// `TerraScan` trajectory.
    Trj,
    /// Delimited text, plain or gzipped.
    Text,
}

/// What the headings of a file count from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeadingReference {
    /// True north: the meridian.
    TrueNorth,
    /// Grid north: the northing axis of the file's CRS.
    GridNorth,
}

/// How to read a trajectory.
#[derive(Debug, Clone, Default)]
pub struct ReadOptions {
    /// The format; recognised by the first bytes when left out.
    pub format: Option<TrajectoryFormat>,
    /// Column names of a text trajectory (see [`text`]); taken from its header when left out.
    pub columns: Option<Vec<String>>,
    /// The SMRMSG file that belongs to it.
    pub accuracy: Option<PathBuf>,
}

/// A trajectory with what its file says about it, and what it does not.
#[derive(Debug, Clone)]
pub struct TrajectoryFile {
    /// The poses. Times are **the file's own**: add [`tieline_filter::SurveyClock::shift_s`] of `time_encoding`.
    pub trajectory: Trajectory,
    /// Format found.
    pub format: TrajectoryFormat,
    /// What the headings in `trajectory` count from.
    pub heading: HeadingReference,
    /// How the times are to be read, judged by their size (no format says it).
    pub time_encoding: TimeEncoding,
    /// GPS week of time 0, where the file has a week column.
    pub week: Option<u32>,
    /// What a user should be told: epochs dropped, units guessed, accuracies missing.
    pub notes: Vec<String>,
}

impl TrajectoryFile {
    /// The trajectory in map coordinates with convergence and scale, headings from true north.
    ///
    /// # Errors
    /// As [`Crs::to_map`].
    pub fn to_map(&self, crs: &Crs) -> Result<Trajectory, CrsError> {
        match self.heading {
            HeadingReference::TrueNorth => crs.to_map(&self.trajectory),
            HeadingReference::GridNorth => crs.to_map_from_grid_heading(&self.trajectory),
        }
    }
}

/// Reads a trajectory of any format.
///
/// # Errors
/// [`TrajectoryFileError`] names file, place, value and remedy.
pub fn read(path: &Path, options: &ReadOptions) -> Result<TrajectoryFile, TrajectoryFileError> {
    let format = match options.format {
        Some(format) => format,
        None => recognise(path)?,
    };
    let mut file = match format {
        TrajectoryFormat::Sbet => sbet::read_sbet(path)?,
        TrajectoryFormat::Trj => trj::read_trj(path)?.into_trajectory(path)?,
        TrajectoryFormat::Text => text::read_text(path, options.columns.as_deref())?,
    };
    if let Some(accuracy_path) = &options.accuracy {
        let accuracy = smrmsg::read_smrmsg(accuracy_path)?;
        let (joined, notes) = accuracy.join(file.trajectory)?;
        file.trajectory = joined;
        file.notes.extend(accuracy.notes().iter().cloned().chain(notes));
    }
    Ok(file)
}

/// The format by the first bytes of the file, its length where they do not tell.
fn recognise(path: &Path) -> Result<TrajectoryFormat, TrajectoryFileError> {
    let mut file = File::open(path).map_err(TrajectoryFileError::io(path))?;
    let length = file.metadata().map_err(TrajectoryFileError::io(path))?.len();
    let mut head = Vec::new();
    file.by_ref().take(4096).read_to_end(&mut head).map_err(TrajectoryFileError::io(path))?;
    if head.is_empty() {
        Err(TrajectoryFileError::Empty { path: path.to_path_buf() })
    } else if head.starts_with(b"LASF") {
        let found = "a LAS or LAZ point cloud".to_string();
        Err(TrajectoryFileError::UnknownFormat { path: path.to_path_buf(), found })
    } else if head.starts_with(trj::MAGIC) {
        Ok(TrajectoryFormat::Trj)
    } else if head.starts_with(text::GZIP_MAGIC) || is_text(&head) {
        Ok(TrajectoryFormat::Text)
    } else if length % sbet::RECORD_BYTES as u64 == 0 || length > 4 * sbet::RECORD_BYTES as u64 {
        Ok(TrajectoryFormat::Sbet) // a cut SBET is told from no SBET by its reader
    } else {
        let found = format!("{length} bytes, not a multiple of {}", sbet::RECORD_BYTES);
        Err(TrajectoryFileError::UnknownFormat { path: path.to_path_buf(), found })
    }
}
