//! Solution files of RTKLIB (`.pos`).
//!
//! | part | variants |
//! |---|---|
//! | time | `yyyy/mm/dd hh:mm:ss.sss`, or week and seconds of week |
//! | time system | GPST; UTC, JST and BJT are turned into GPS time, and a note says so |
//! | position | latitude, longitude in degrees or in degrees, minutes, seconds, ellipsoidal height; x, y, z of the earth-centred frame; east, north, up of a baseline (with `% ref pos` in the header) |
//! | separator | blanks, tab, comma, semicolon, bar |
//! | accuracies | sd of three axes, with or without the signed roots of the covariances; none (usual ones are taken) |
//! | velocity | with its sd, or none |
//! | header | all of it, the line of column names only, or none: the number of columns tells then |
//!
//! A header in the midst of a file, where two were joined, holds from there on. Tokyo datum and geodetic (sea-level)
//! heights are refused.

use std::io::BufRead;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use tieline_filter::earth::{ecef_from_geodetic, geodetic_from_ecef, ned_from_ecef};

use super::calendar::{LeapSeconds, Moment, TimeSystem};
use super::fixes::{Fixes, Local, Raw, quality};
use super::{GnssFile, GnssFormat, GnssReadOptions};
use crate::delimited::{Line, Lines};
use crate::measurements::MeasurementFileError;
use crate::measurements::table::is_nan;
use crate::trajectory::Place;

mod header;

pub(super) use header::is_header;
use header::{Header, Layout, Position, SLOTS};

/// Places of the values in a row.
mod slot {
    pub(super) const POSITION: usize = 0;
    pub(super) const QUALITY: usize = 3;
    pub(super) const SIGMA: usize = 4;
    pub(super) const ROOT: usize = 7;
    pub(super) const VELOCITY: usize = 10;
    pub(super) const SIGMA_VELOCITY: usize = 13;
    pub(super) const ROOT_VELOCITY: usize = 16;
}

/// What stands between two fields, whatever the separator: it never occurs within one.
pub(super) fn tokens(text: &str) -> impl Iterator<Item = &str> {
    text.split([' ', '\t', ',', ';', '|']).filter(|token| !token.is_empty())
}

pub(super) fn read(
    source: Box<dyn BufRead + '_>,
    path: &Path,
    options: &GnssReadOptions,
) -> Result<GnssFile, MeasurementFileError> {
    let mut lines = Lines::new(source, path);
    let mut header = Header::default();
    let (mut fixes, mut leap, mut added_s) = (Fixes::new(path, false), LeapSeconds::default(), None);
    while let Some(line) = lines.next()? {
        if line.text.starts_with('%') {
            header.update(&line, path)?;
            continue;
        } else if line.text.starts_with('#') {
            continue;
        }
        let (moment, rest) = moment(&line, path)?;
        if header.layout.is_none() {
            header.layout = Some(Layout::by_count(tokens(rest).count(), &line, path)?);
        }
        let Some(layout) = &header.layout else { continue };
        let row = layout.row(rest, &line, path)?;
        let (week, time_s, leap_s) = moment.gps(header.system, &mut leap);
        if header.system != TimeSystem::Gps {
            added_s.get_or_insert(leap_s);
        }
        fixes.push(&epoch(layout, &header, &row, [week, time_s], &line, path)?)?;
    }
    let mut notes = header.notes(path, added_s);
    if options.columns.is_some() {
        notes.push(format!("{}: RTKLIB names its columns itself; the names given are not used", path.display()));
    }
    fixes.finish(GnssFormat::RtklibPos, notes)
}

/// The time of a line and what follows it.
fn moment<'t>(line: &Line<'t>, path: &Path) -> Result<(Moment, &'t str), MeasurementFileError> {
    let ends = |c: char| matches!(c, ' ' | '\t' | ',' | ';' | '|');
    let (first, rest) = line.text.split_once(ends).unwrap_or((line.text, ""));
    let rest = rest.trim_start_matches(ends);
    let (second, rest) = rest.split_once(ends).unwrap_or((rest, ""));
    let found = match first.contains(['/', '-']) {
        true => Moment::of_date(first, second),
        false => Moment::of_week(first, second),
    };
    found.map(|moment| (moment, rest)).ok_or_else(|| {
        let text = format!("{first} {second}").chars().take(40).collect();
        MeasurementFileError::NoDate { path: path.to_path_buf(), line: line.number, text }
    })
}

/// The epoch of a row.
fn epoch(
    layout: &Layout,
    header: &Header,
    row: &[f64; SLOTS],
    [week, time_s]: [f64; 2],
    line: &Line<'_>,
    path: &Path,
) -> Result<Raw, MeasurementFileError> {
    let place = Place::Line(line.number);
    let vector = |at: usize| Vector3::new(row[at], row[at + 1], row[at + 2]);
    let position = vector(slot::POSITION);
    let ned_from_enu = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
    let known = position.iter().all(|v| v.is_finite());
    let (geodetic, ned_from_local) = match layout.position {
        _ if !known => (Vector3::repeat(f64::NAN), ned_from_enu),
        Position::Degrees | Position::Sexagesimal => {
            (Vector3::new(position.x.to_radians(), position.y.to_radians(), position.z), ned_from_enu)
        }
        Position::Cartesian => {
            let geodetic = geodetic_of(&position, place, path)?;
            (geodetic, ned_from_ecef(geodetic.x, geodetic.y))
        }
        Position::Baseline => {
            let base = header
                .reference
                .ok_or_else(|| MeasurementFileError::NoReference { path: path.to_path_buf(), line: line.number })?;
            let ecef_from_enu = (ned_from_enu * ned_from_ecef(base.x, base.y)).transpose();
            let geodetic = geodetic_of(&(ecef_from_geodetic(&base) + ecef_from_enu * position), place, path)?;
            (geodetic, ned_from_ecef(geodetic.x, geodetic.y) * ecef_from_enu)
        }
    };
    let velocity =
        Local { value: vector(slot::VELOCITY), sigma: vector(slot::SIGMA_VELOCITY), root: vector(slot::ROOT_VELOCITY) };
    Ok(Raw {
        place,
        time_s,
        week,
        geodetic,
        quality: quality(row[slot::QUALITY]),
        sigma: vector(slot::SIGMA),
        root: vector(slot::ROOT),
        velocity: layout.has_velocity().then_some(velocity),
        ned_from_local,
    })
}

/// Latitude, longitude \[rad\], height \[m\] of a place near the surface of the earth.
fn geodetic_of(ecef_m: &Vector3<f64>, place: Place, path: &Path) -> Result<Vector3<f64>, MeasurementFileError> {
    let value = ecef_m.norm();
    match (5.4e6..7.4e6).contains(&value) {
        true => Ok(geodetic_from_ecef(ecef_m)),
        false => {
            let (path, column, expected) = (path.to_path_buf(), "distance from the earth's centre [m]", "about 6.4e6");
            Err(MeasurementFileError::Absurd { path, place, column, value, expected })
        }
    }
}

impl Layout {
    /// The numbers of a line, after its time, at their places; NaN where there are none.
    fn row(&self, rest: &str, line: &Line<'_>, path: &Path) -> Result<[f64; SLOTS], MeasurementFileError> {
        let mut row = [f64::NAN; SLOTS];
        let mut fields = tokens(rest);
        let mut found = 2;
        for (index, column) in self.columns.iter().enumerate() {
            let mut next = || match fields.next() {
                Some(text) => {
                    found += 1;
                    number(text).ok_or_else(|| MeasurementFileError::NotANumber {
                        path: path.to_path_buf(),
                        line: line.number,
                        column: found,
                        name: self.names.get(index).cloned().unwrap_or_default(),
                        text: text.chars().take(40).collect(),
                    })
                }
                None => {
                    let (path, line, expected) = (path.to_path_buf(), line.number, self.fields());
                    Err(MeasurementFileError::FieldCount { path, line, found, expected })
                }
            };
            let value = match self.position {
                Position::Sexagesimal if index < 2 => sexagesimal([next()?, next()?, next()?]),
                _ => next()?,
            };
            if let Some(slot) = column {
                row[*slot] = value;
            }
        }
        Ok(row)
    }
}

/// Degrees, minutes, seconds; the sign stands at the degrees, `-0` included.
fn sexagesimal([degrees, minutes, seconds]: [f64; 3]) -> f64 {
    let size = degrees.abs() + minutes / 60.0 + seconds / 3600.0;
    if degrees.is_sign_negative() { -size } else { size }
}

/// A number, or NaN as C programs print it.
fn number(text: &str) -> Option<f64> {
    text.parse().ok().or_else(|| is_nan(text).then_some(f64::NAN))
}
