//! Names of the columns of a text trajectory: quantity and unit.
//!
//! A name is a quantity and a unit: `roll_deg`, `Roll[deg]`, `roll (deg)`. Case, quotes and the kind of bracket do not
//! matter.

use std::path::Path;

use super::error::TrajectoryFileError;
use crate::delimited::plain_name;

/// The quantities a column can hold; the discriminant is the place of its value in a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub(super) enum Quantity {
    Time,
    Week,
    East,
    North,
    Up,
    Latitude,
    Longitude,
    Roll,
    Pitch,
    Heading,
    GridHeading,
    VelocityNorth,
    VelocityEast,
    VelocityDown,
    SigmaNorth,
    SigmaEast,
    SigmaDown,
    SigmaVelocityNorth,
    SigmaVelocityEast,
    SigmaVelocityDown,
    SigmaRoll,
    SigmaPitch,
    SigmaHeading,
}

/// Number of quantities.
pub(super) const QUANTITIES: usize = Quantity::SigmaHeading as usize + 1;

impl Quantity {
    /// The word for messages.
    pub(super) fn name(self) -> &'static str {
        NAMES.iter().find(|entry| entry.1 == self).map_or("", |entry| entry.0[0])
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Dimension {
    Time,
    Length,
    Angle,
    Speed,
    Count,
}

/// Accepted names without their unit, by quantity; the first is the one to recommend.
const NAMES: &[(&[&str], Quantity, Dimension)] = &[
    (
        &["time", "gps_time", "gpstime", "time_of_week", "tow", "sow", "seconds_of_week", "t"],
        Quantity::Time,
        Dimension::Time,
    ),
    (&["gps_week", "week"], Quantity::Week, Dimension::Count),
    (&["east", "easting", "x", "e"], Quantity::East, Dimension::Length),
    (&["north", "northing", "y", "n"], Quantity::North, Dimension::Length),
    (
        &["height", "h", "z", "up", "alt", "altitude", "elevation", "ellipsoidal_height"],
        Quantity::Up,
        Dimension::Length,
    ),
    (&["lat", "latitude"], Quantity::Latitude, Dimension::Angle),
    (&["lon", "longitude", "long", "lng"], Quantity::Longitude, Dimension::Angle),
    (&["roll"], Quantity::Roll, Dimension::Angle),
    (&["pitch"], Quantity::Pitch, Dimension::Angle),
    (&["heading", "yaw", "azimuth", "true_heading"], Quantity::Heading, Dimension::Angle),
    (&["grid_heading", "grid_yaw", "grid_azimuth"], Quantity::GridHeading, Dimension::Angle),
    (&["vn", "velocity_north", "v_north"], Quantity::VelocityNorth, Dimension::Speed),
    (&["ve", "velocity_east", "v_east"], Quantity::VelocityEast, Dimension::Speed),
    (&["vd", "velocity_down", "v_down"], Quantity::VelocityDown, Dimension::Speed),
    (&["sigma_n", "sigma_north", "sd_n"], Quantity::SigmaNorth, Dimension::Length),
    (&["sigma_e", "sigma_east", "sd_e"], Quantity::SigmaEast, Dimension::Length),
    (
        &["sigma_d", "sigma_u", "sigma_h", "sigma_down", "sigma_up", "sigma_height", "sd_d", "sd_u"],
        Quantity::SigmaDown,
        Dimension::Length,
    ),
    (&["sigma_vn"], Quantity::SigmaVelocityNorth, Dimension::Speed),
    (&["sigma_ve"], Quantity::SigmaVelocityEast, Dimension::Speed),
    (&["sigma_vd", "sigma_vu"], Quantity::SigmaVelocityDown, Dimension::Speed),
    (&["sigma_roll", "sd_roll"], Quantity::SigmaRoll, Dimension::Angle),
    (&["sigma_pitch", "sd_pitch"], Quantity::SigmaPitch, Dimension::Angle),
    (&["sigma_heading", "sigma_yaw", "sd_heading", "sd_yaw"], Quantity::SigmaHeading, Dimension::Angle),
];

/// Names for the error message.
pub(super) const KNOWN: &str = "time_s, time_of_week_s, adjusted_s, gps_s, gps_week, east_m, north_m, height_m, \
     lat_deg|rad, lon_deg|rad, h_m, roll_deg|rad, pitch_deg|rad, heading_deg|rad (from true north), \
     grid_heading_deg|rad (from grid north), vn_mps, ve_mps, vd_mps, vu_mps, sigma_n_m, sigma_e_m, sigma_d_m, \
     sigma_vn_mps, sigma_ve_mps, sigma_vd_mps, sigma_roll_deg, sigma_pitch_deg, sigma_heading_deg (or _rad, _arcmin), \
     and \"-\" for a column to be left out";

/// A pattern for the error message.
pub(super) const EXAMPLE: &str =
    r#"["time_s", "east_m", "north_m", "height_m", "roll_deg", "pitch_deg", "heading_deg", "-"]"#;

/// What a column is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    /// As it was written.
    pub(super) name: String,
    pub(super) quantity: Quantity,
    /// Turns the number into metres, radians, seconds; `None` when the name has no unit.
    pub(super) factor: Option<f64>,
    /// Is added after the factor: for GPS seconds since 1980.
    pub(super) offset: f64,
}

impl Column {
    /// The column of a name; `None` when it means nothing.
    pub(super) fn parse(name: &str) -> Option<Self> {
        let plain = plain_name(name);
        let column = |quantity, factor, offset| Self {
            name: name.trim().trim_matches('"').to_string(),
            quantity,
            factor,
            offset,
        };
        match plain.as_str() {
            "adjusted_s" | "adjusted_time_s" | "adjusted_standard_s" => {
                return Some(column(Quantity::Time, Some(1.0), 0.0));
            }
            "gps_s" => return Some(column(Quantity::Time, Some(1.0), -tieline_filter::time::ADJUSTED_OFFSET_S)),
            "vu_mps" | "velocity_up_mps" | "v_up_mps" => return Some(column(Quantity::VelocityDown, Some(-1.0), 0.0)),
            _ => {}
        }
        let find = |base: &str| NAMES.iter().find(|entry| entry.0.contains(&base));
        if let Some(&(_, quantity, dimension)) = find(&plain) {
            return Some(column(quantity, (dimension == Dimension::Count).then_some(1.0), 0.0));
        }
        let (base, unit) = plain.rsplit_once('_')?;
        let &(_, quantity, dimension) = find(base)?;
        Some(column(quantity, Some(factor(dimension, unit)?), 0.0))
    }

    /// The columns of a pattern in the project file: every name must be known and carry its unit; `None` for `-`.
    pub(super) fn pattern(path: &Path, names: &[String]) -> Result<Vec<Option<Self>>, TrajectoryFileError> {
        let one = |name: &String| match (name.trim(), Self::parse(name)) {
            ("-" | "", _) => Ok(None),
            (_, Some(column)) if column.factor.is_some() => Ok(Some(column)),
            _ => Err(TrajectoryFileError::UnknownColumn { path: path.to_path_buf(), name: name.clone(), known: KNOWN }),
        };
        names.iter().map(one).collect()
    }

    /// Whether the column is an angle.
    pub(super) fn is_angle(&self) -> bool {
        NAMES.iter().any(|entry| entry.1 == self.quantity && entry.2 == Dimension::Angle)
    }
}

/// Factor to metres, radians, seconds, metres per second.
fn factor(dimension: Dimension, unit: &str) -> Option<f64> {
    let degree = std::f64::consts::PI / 180.0;
    match (dimension, unit) {
        (Dimension::Time, "s" | "sec" | "seconds")
        | (Dimension::Length, "m" | "metre" | "meter")
        | (Dimension::Angle, "rad" | "radians")
        | (Dimension::Speed, "mps" | "m/s") => Some(1.0),
        (Dimension::Angle, "deg" | "degrees" | "degree" | "°") => Some(degree),
        (Dimension::Angle, "arcmin") => Some(degree / 60.0),
        (Dimension::Angle, "arcsec") => Some(degree / 3600.0),
        (Dimension::Length, "mm") => Some(1e-3),
        (Dimension::Time, "us") => Some(1e-6),
        (Dimension::Time, "ms") => Some(1e-3),
        _ => None,
    }
}
