//! Known points, or coordinate updates: where a point of the platform was at a moment.
//!
//! Text with the columns `gps_time_s, lat_deg, lon_deg, h_m, sigma_n_m, sigma_e_m, sigma_d_m`, and where the point is
//! not the IMU itself `body_x_m, body_y_m, body_z_m` (forward, right, down from the IMU); by a header, a pattern, or,
//! with neither, seven or ten bare columns in that order.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use tieline_filter::{KnownPoint, TimeEncoding};

use super::column::{Dimension, Quantity, Spec, TIME, WEEK};
use super::error::MeasurementFileError;
use super::geodetic::checked_geodetic;
use super::table::Table;
use super::timeline::Timeline;
use crate::delimited::unpacked;

/// Known points with what their file says about them.
#[derive(Debug, Clone)]
pub struct PointsFile {
    /// In order of time. Times are **the file's own**, as in [`super::ImuFile`].
    pub points: Vec<KnownPoint>,
    /// How the times are to be read.
    pub time_encoding: TimeEncoding,
    /// GPS week of time 0, where the file has a week column.
    pub week: Option<u32>,
    /// What a user should be told.
    pub notes: Vec<String>,
}

/// Least sigma of a known point \[m\]: smaller ones, zero and less are raised to it.
pub const LEAST_SIGMA_M: f64 = 0.001;

const LATITUDE: usize = 2;
const SIGMA: usize = 5;
const BODY: usize = 8;

const SPEC: Spec<11> = Spec {
    quantities: &[
        Quantity::new(&["lat", "latitude"], Dimension::Angle, LATITUDE),
        Quantity::new(&["lon", "longitude", "long", "lng"], Dimension::Angle, LATITUDE + 1),
        Quantity::new(&["h", "height", "ellipsoidal_height", "alt", "altitude"], Dimension::Length, LATITUDE + 2),
        Quantity::new(&["sigma_n", "sigma_north", "sd_n"], Dimension::Length, SIGMA),
        Quantity::new(&["sigma_e", "sigma_east", "sd_e"], Dimension::Length, SIGMA + 1),
        Quantity::new(&["sigma_d", "sigma_u", "sigma_h", "sd_d", "sd_u"], Dimension::Length, SIGMA + 2),
        Quantity::new(&["body_x"], Dimension::Length, BODY),
        Quantity::new(&["body_y"], Dimension::Length, BODY + 1),
        Quantity::new(&["body_z"], Dimension::Length, BODY + 2),
    ],
    known: "gps_time_s, adjusted_s, gps_s, gps_week, lat_deg|rad, lon_deg|rad, h_m, sigma_n_m, sigma_e_m, sigma_d_m, \
            body_x_m, body_y_m, body_z_m",
    example: r#"["gps_time_s", "lat_deg", "lon_deg", "h_m", "sigma_n_m", "sigma_e_m", "sigma_d_m"]"#,
    blanks: false,
};

const BARE: &[&str] = &[
    "gps_time_s",
    "lat_deg",
    "lon_deg",
    "h_m",
    "sigma_n_m",
    "sigma_e_m",
    "sigma_d_m",
    "body_x_m",
    "body_y_m",
    "body_z_m",
];

/// Reads known points; `columns` from the project file, or `None` to go by the header or the order above.
///
/// # Errors
/// [`MeasurementFileError`] names file, line, column and remedy.
pub fn read_points(path: &Path, columns: Option<&[String]>) -> Result<PointsFile, MeasurementFileError> {
    let file = File::open(path).map_err(MeasurementFileError::io(path))?;
    read_from(BufReader::with_capacity(1 << 16, file), path, columns)
}

/// Reads known points from any source; `path` is for messages only.
///
/// # Errors
/// As [`read_points`].
pub fn read_from(
    source: impl BufRead,
    path: &Path,
    columns: Option<&[String]>,
) -> Result<PointsFile, MeasurementFileError> {
    let source = unpacked(source).map_err(MeasurementFileError::io(path))?;
    let mut table = Table::open(source, path, &SPEC, columns, &[&BARE[..7], BARE])?;
    let has_body = table.has(BODY..BODY + 3);
    if !table.has([TIME]) {
        return Err(table.missing("a time (gps_time_s)", &SPEC));
    } else if !table.has(LATITUDE..SIGMA) {
        return Err(table.missing("a position (lat_deg, lon_deg, h_m)", &SPEC));
    } else if !table.has(SIGMA..BODY) {
        return Err(table.missing("accuracies (sigma_n_m, sigma_e_m, sigma_d_m)", &SPEC));
    } else if !has_body && table.has_any(BODY..BODY + 3) {
        return Err(table.missing("all three of body_x_m, body_y_m, body_z_m", &SPEC));
    }
    let mut timeline = Timeline::new(path, f64::INFINITY, table.is_adjusted());
    let (mut points, mut raised) = (Vec::new(), 0_u64);
    while let Some((place, row)) = table.next()? {
        let time_s = timeline.place(place, row[TIME], row[WEEK])?;
        let vector = |slot: usize| Vector3::new(row[slot], row[slot + 1], row[slot + 2]);
        let sigma = vector(SIGMA);
        raised += u64::from(sigma.min() < LEAST_SIGMA_M);
        points.push(KnownPoint {
            time_s,
            geodetic: checked_geodetic(path, place, &vector(LATITUDE))?,
            covariance_ned_m2: Matrix3::from_diagonal(&sigma.map(|s| s.max(LEAST_SIGMA_M).powi(2))),
            body_vector_m: if has_body { vector(BODY) } else { Vector3::zeros() },
        });
    }
    let mut notes = table.notes;
    if raised > 0 {
        let name = path.display();
        notes.push(format!("{name}: {raised} points had a sigma below {LEAST_SIGMA_M} m, which was taken instead"));
    }
    let settled = timeline.settle(&mut points, false);
    notes.extend(settled.notes);
    Ok(PointsFile { points, time_encoding: settled.time_encoding, week: settled.week, notes })
}
