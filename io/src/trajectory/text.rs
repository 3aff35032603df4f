//! Text trajectories: any delimiter, any column order, plain or gzipped.
//!
//! What the columns are is said by the project file,
//! `columns = ["time_s", "east_m", "north_m", "height_m", "roll_deg", "pitch_deg", "heading_deg", "-"]`
//! (a quantity with its unit, `-` for a column to be left out), or by the header of the file itself. Fields are
//! separated by semicolons, commas, or white space, as the first line of numbers shows; lines that start with `#` or
//! `%` are comments; lines before the first numbers are a header.
//!
//! Positions are either `east, north, height` (map) or `lat, lon, h` (geodetic). `heading`, `yaw` and `azimuth` count
//! from true north, `grid_heading` from grid north. A header without units is taken when its values leave no choice,
//! and a note says so.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::Path;

use nalgebra::Vector3;
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{PoseSigma, PositionFrame};

use super::column::{Column, EXAMPLE, QUANTITIES, Quantity};
use super::error::{Place, TrajectoryFileError};
use super::file::{HeadingReference, TrajectoryFile, TrajectoryFormat};
use super::records::{Epoch, Records};
use crate::delimited::{Lines, unpacked};

mod header;

use header::Layout;

pub use crate::delimited::GZIP_MAGIC;

/// Reads a text trajectory; `columns` from the project file, or `None` to go by the header.
///
/// # Errors
/// [`TrajectoryFileError`] names file, line, column and remedy.
pub fn read_text(path: &Path, columns: Option<&[String]>) -> Result<TrajectoryFile, TrajectoryFileError> {
    read_from(|| File::open(path).map(BufReader::new), path, columns)
}

/// Reads a text trajectory from any source that can be opened twice; `path` is for messages only.
///
/// # Errors
/// As [`read_text`].
pub fn read_from<R: BufRead>(
    open: impl Fn() -> io::Result<R>,
    path: &Path,
    columns: Option<&[String]>,
) -> Result<TrajectoryFile, TrajectoryFileError> {
    let lines = || -> Result<Lines, TrajectoryFileError> {
        let source = open().and_then(unpacked).map_err(TrajectoryFileError::io(path))?;
        Ok(Lines::new(source, path))
    };
    let mut layout = header::find(&mut lines()?, path, columns)?;
    layout.settle_units(&mut lines()?, path)?;
    read_rows(&mut lines()?, path, layout)
}

/// One row: a number per quantity.
type Row = [f64; QUANTITIES];

fn read_rows(lines: &mut Lines<'_>, path: &Path, layout: Layout) -> Result<TrajectoryFile, TrajectoryFileError> {
    let mut records = Records::new(path, layout.frame);
    let mut first_week = None;
    while let Some(line) = lines.next()? {
        if line.number < layout.first_line || line.is_comment() {
            continue;
        }
        let row = layout.row(&line, path)?;
        let place = Place::Line(line.number);
        let mut epoch = layout.epoch(&row);
        if layout.has(Quantity::Week) {
            let week = row[Quantity::Week as usize];
            // week 0 stands for a week that is not known
            if week.is_finite() && week != 0.0 {
                if !(0.0..=10_000.0).contains(&week) || week.fract() != 0.0 {
                    let (path, column, expected) = (path.to_path_buf(), "gps_week", "a whole number up to 10000");
                    return Err(TrajectoryFileError::Absurd { path, place, column, value: week, expected });
                }
                epoch.time_s += (week - *first_week.get_or_insert(week)) * SECONDS_PER_WEEK;
            }
        }
        records.push(place, &epoch)?;
    }
    let (trajectory, time_encoding, mut notes) = records.finish()?;
    notes.extend(layout.notes);
    Ok(TrajectoryFile {
        trajectory,
        format: TrajectoryFormat::Text,
        heading: layout.heading,
        time_encoding,
        week: first_week.map(whole_week),
        notes,
    })
}

/// A week, checked before to be a whole number of up to 10 000.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn whole_week(week: f64) -> u32 {
    week as u32
}

impl Layout {
    /// The epoch of a row.
    fn epoch(&self, row: &Row) -> Epoch {
        let get = |quantity: Quantity| row[quantity as usize];
        let vector = |a, b, c| Vector3::new(get(a), get(b), get(c));
        let position = match self.frame {
            PositionFrame::Map => vector(Quantity::East, Quantity::North, Quantity::Up),
            PositionFrame::Geodetic => vector(Quantity::Latitude, Quantity::Longitude, Quantity::Up),
        };
        let heading = match self.heading {
            HeadingReference::TrueNorth => Quantity::Heading,
            HeadingReference::GridNorth => Quantity::GridHeading,
        };
        let sigma = self.has_sigma.then(|| PoseSigma {
            position_ned_m: vector(Quantity::SigmaNorth, Quantity::SigmaEast, Quantity::SigmaDown),
            velocity_ned_mps: match self.has(Quantity::SigmaVelocityNorth)
                && self.has(Quantity::SigmaVelocityEast)
                && self.has(Quantity::SigmaVelocityDown)
            {
                true => vector(Quantity::SigmaVelocityNorth, Quantity::SigmaVelocityEast, Quantity::SigmaVelocityDown),
                false => Vector3::zeros(),
            },
            attitude_rph_rad: vector(Quantity::SigmaRoll, Quantity::SigmaPitch, Quantity::SigmaHeading),
        });
        Epoch {
            time_s: get(Quantity::Time),
            position,
            roll_pitch_heading_rad: vector(Quantity::Roll, Quantity::Pitch, heading),
            velocity_ned_mps: self
                .has_velocity
                .then(|| vector(Quantity::VelocityNorth, Quantity::VelocityEast, Quantity::VelocityDown)),
            sigma,
        }
    }
}
