//! GNSS fixes of the antenna.
//!
//! | format | content |
//! |---|---|
//! | RTKLIB `.pos` | every variant that RTKLIB writes, with and without its header; see [`rtklib`] |
//! | KF-GINS text | time \[s\], latitude, longitude \[deg\], height \[m\], sigmas north, east, down \[m\]; where there are more, velocity north, east, down and its sigmas \[m/s\] |
//! | CSV | any columns by their names: a header in the file or a pattern of the project file |
//!
//! Columns of CSV: `time_s` or `gps_time_s` (seconds of week, or adjusted standard time), `adjusted_s`, `gps_s` (since
//! 1980), `gps_week`; `lat_deg`, `lon_deg` (or `_rad`), `h_m`; `sigma_n_m`, `sigma_e_m`, `sigma_d_m`; `vn_mps`,
//! `ve_mps`, `vd_mps` (or `vu_mps`), `sigma_vn_mps`, `sigma_ve_mps`, `sigma_vd_mps`; `quality` in RTKLIB's numbers (1
//! fixed, 2 float, 3 SBAS, 4 differential, 5 single, 6 PPP); `-` for a column to be left out.
//!
//! An accuracy that is missing, zero, negative or below 0.1 mm is replaced by one that is usual for the quality of the
//! fix ([`usual_sigma_m`]), and a note says so; a fix without a position is dropped.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use tieline_filter::{GnssFix, TimeEncoding};

use super::error::MeasurementFileError;
use crate::delimited::{peeked, unpacked};

mod calendar;
mod columns;
mod fixes;
mod recognise;
pub mod rtklib;

pub use fixes::{USUAL_SIGMA_MPS, usual_sigma_m};

/// The formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GnssFormat {
    /// Solution file of RTKLIB.
    RtklibPos,
    /// Seven, ten or thirteen bare columns.
    KfGins,
    /// Delimited text with named columns.
    Csv,
}

/// How to read GNSS fixes.
#[derive(Debug, Clone, Default)]
pub struct GnssReadOptions {
    /// The format; recognised by the first lines when left out.
    pub format: Option<GnssFormat>,
    /// Column names of a CSV file (see [`self`]); taken from its header when left out.
    pub columns: Option<Vec<String>>,
}

/// GNSS fixes with what their file says about them.
#[derive(Debug, Clone)]
pub struct GnssFile {
    /// In order of time, one at a time. Times are **the file's own**: add [`tieline_filter::SurveyClock::shift_s`] of
    /// `time_encoding`; where `week` is known they count from its start and run on past its end.
    pub fixes: Vec<GnssFix>,
    /// Format found.
    pub format: GnssFormat,
    /// How the times are to be read.
    pub time_encoding: TimeEncoding,
    /// GPS week of time 0, where the file says it.
    pub week: Option<u32>,
    /// What a user should be told: epochs dropped or sorted, sigmas replaced, time systems.
    pub notes: Vec<String>,
}

/// Reads GNSS fixes of any format, plain or gzipped.
///
/// # Errors
/// [`MeasurementFileError`] names file, line, column, value and remedy.
pub fn read_gnss(path: &Path, options: &GnssReadOptions) -> Result<GnssFile, MeasurementFileError> {
    let file = File::open(path).map_err(MeasurementFileError::io(path))?;
    read_from(BufReader::with_capacity(1 << 16, file), path, options)
}

/// Reads GNSS fixes from any source; `path` is for messages only.
///
/// # Errors
/// As [`read_gnss`].
pub fn read_from(
    source: impl BufRead,
    path: &Path,
    options: &GnssReadOptions,
) -> Result<GnssFile, MeasurementFileError> {
    let source = unpacked(source).map_err(MeasurementFileError::io(path))?;
    let (head, source) = peeked(source, 1 << 16).map_err(MeasurementFileError::io(path))?;
    let format = match (options.format, &options.columns) {
        (Some(format), _) => format,
        (None, Some(_)) => GnssFormat::Csv,
        (None, None) => recognise::format(&head, path)?,
    };
    match format {
        GnssFormat::RtklibPos => rtklib::read(source, path, options),
        GnssFormat::KfGins | GnssFormat::Csv => columns::read(source, path, format, options),
    }
}
