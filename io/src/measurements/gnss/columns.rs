//! GNSS fixes in columns: KF-GINS text and CSV.

use std::io::BufRead;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};

use super::fixes::{Fixes, Local, Raw, quality};
use super::{GnssFile, GnssFormat, GnssReadOptions};
use crate::delimited::Delimiter;
use crate::measurements::MeasurementFileError;
use crate::measurements::column::{Dimension, Named, Quantity, Spec, TIME, WEEK};
use crate::measurements::table::Table;

const LATITUDE: usize = 2;
const SIGMA: usize = 5;
const VELOCITY: usize = 8;
const SIGMA_VELOCITY: usize = 11;
const QUALITY: usize = 14;

const SPEC: Spec<15> = Spec {
    quantities: &[
        Quantity::new(&["lat", "latitude"], Dimension::Angle, LATITUDE),
        Quantity::new(&["lon", "longitude", "long", "lng"], Dimension::Angle, LATITUDE + 1),
        Quantity::new(&["h", "height", "ellipsoidal_height", "alt", "altitude"], Dimension::Length, LATITUDE + 2),
        Quantity::new(&["sigma_n", "sigma_north", "sd_n", "sdn"], Dimension::Length, SIGMA),
        Quantity::new(&["sigma_e", "sigma_east", "sd_e", "sde"], Dimension::Length, SIGMA + 1),
        Quantity::new(
            &["sigma_d", "sigma_u", "sigma_h", "sigma_down", "sigma_up", "sd_d", "sd_u", "sdu"],
            Dimension::Length,
            SIGMA + 2,
        ),
        Quantity::new(&["vn", "v_north", "velocity_north"], Dimension::Speed, VELOCITY),
        Quantity::new(&["ve", "v_east", "velocity_east"], Dimension::Speed, VELOCITY + 1),
        Quantity::new(&["vd", "v_down", "velocity_down"], Dimension::Speed, VELOCITY + 2),
        Quantity { names: &["vu", "v_up", "velocity_up"], dimension: Dimension::Speed, slot: VELOCITY + 2, sign: -1.0 },
        Quantity::new(&["sigma_vn"], Dimension::Speed, SIGMA_VELOCITY),
        Quantity::new(&["sigma_ve"], Dimension::Speed, SIGMA_VELOCITY + 1),
        Quantity::new(&["sigma_vd", "sigma_vu"], Dimension::Speed, SIGMA_VELOCITY + 2),
        Quantity::new(&["quality", "q", "fix"], Dimension::Count, QUALITY),
    ],
    known: "time_s, gps_time_s, adjusted_s, gps_s, gps_week, lat_deg|rad, lon_deg|rad, h_m, sigma_n_m, sigma_e_m, \
            sigma_d_m, vn_mps, ve_mps, vd_mps, vu_mps, sigma_vn_mps, sigma_ve_mps, sigma_vd_mps, quality",
    example: r#"["time_s", "lat_deg", "lon_deg", "h_m", "sigma_n_m", "sigma_e_m", "sigma_d_m"]"#,
    blanks: true,
};

/// The columns of KF-GINS: all of them, without the sigmas of the velocity, or without the velocity.
const BARE: &[&str] = &[
    "time_s",
    "lat_deg",
    "lon_deg",
    "h_m",
    "sigma_n_m",
    "sigma_e_m",
    "sigma_d_m",
    "vn_mps",
    "ve_mps",
    "vd_mps",
    "sigma_vn_mps",
    "sigma_ve_mps",
    "sigma_vd_mps",
];
/// Numbers of bare columns that are understood.
pub(super) const BARE_COUNTS: [usize; 3] = [7, 10, 13];

/// Whether a comment names a column: it is a header then.
pub(super) fn names_a_column(line: &str) -> bool {
    let line = line.trim_start_matches(['#', '%', ' ']);
    Delimiter::of(line).split(line).any(|name| !matches!(SPEC.parse(name), Named::Unknown))
}

pub(super) fn read(
    source: Box<dyn BufRead + '_>,
    path: &Path,
    format: GnssFormat,
    options: &GnssReadOptions,
) -> Result<GnssFile, MeasurementFileError> {
    let bare = BARE_COUNTS.map(|count| &BARE[..count]);
    let defaults: &[&[&str]] = match format {
        GnssFormat::KfGins => &bare,
        _ => &[],
    };
    let mut table = Table::open(source, path, &SPEC, options.columns.as_deref(), defaults)?;
    let has_sigma = table.has(SIGMA..VELOCITY);
    if !table.has([TIME]) {
        return Err(table.missing("a time (time_s)", &SPEC));
    } else if !table.has(LATITUDE..SIGMA) {
        return Err(table.missing("a position (lat_deg, lon_deg, h_m)", &SPEC));
    } else if !has_sigma && !table.has([QUALITY]) {
        return Err(table.missing("accuracies (sigma_n_m, sigma_e_m, sigma_d_m) or a quality", &SPEC));
    }
    let has_velocity = table.has(VELOCITY..SIGMA_VELOCITY) && table.has(SIGMA_VELOCITY..QUALITY);
    let mut notes = std::mem::take(&mut table.notes);
    if !has_velocity && table.has_any(VELOCITY..SIGMA_VELOCITY) {
        notes.push(format!(
            "{}: velocities are left out: all three and their three accuracies (sigma_vn_mps, …) are needed",
            path.display()
        ));
    }
    let mut fixes = Fixes::new(path, table.is_adjusted());
    while let Some((place, row)) = table.next()? {
        let vector = |slot: usize| Vector3::new(row[slot], row[slot + 1], row[slot + 2]);
        let velocity = Local { value: vector(VELOCITY), sigma: vector(SIGMA_VELOCITY), root: Vector3::zeros() };
        fixes.push(&Raw {
            place,
            time_s: row[TIME],
            week: row[WEEK],
            geodetic: vector(LATITUDE),
            quality: quality(row[QUALITY]),
            sigma: vector(SIGMA),
            root: Vector3::zeros(),
            velocity: has_velocity.then_some(velocity),
            ned_from_local: Matrix3::identity(),
        })?;
    }
    fixes.finish(format, notes)
}
