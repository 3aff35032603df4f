//! Names of columns: a quantity and its unit, such as `gyro_x_radps`, `Gyro X [deg/s]`, `lat_deg`.

use std::f64::consts::PI;
use std::path::Path;

use tieline_filter::time::ADJUSTED_OFFSET_S;

use super::error::MeasurementFileError;
use crate::delimited::plain_name;

/// Place of the time in every row.
pub(super) const TIME: usize = 0;
/// Place of the GPS week in every row.
pub(super) const WEEK: usize = 1;

/// Standard gravity \[m/s²\]: the unit `g`.
const STANDARD_GRAVITY_MPS2: f64 = 9.806_65;

/// What a number measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dimension {
    Count,
    Length,
    Angle,
    Speed,
    AngularRate,
    Acceleration,
}

impl Dimension {
    /// Factor to metres, radians, seconds.
    fn factor(self, unit: &str) -> Option<f64> {
        let degree = PI / 180.0;
        let factor = match (self, unit) {
            (Self::Length, "m" | "metre" | "meter")
            | (Self::Angle, "rad" | "radians")
            | (Self::Speed, "mps" | "m/s")
            | (Self::AngularRate, "radps" | "rad/s")
            | (Self::Acceleration, "mps2" | "m/s2" | "m/s^2" | "m/s²") => 1.0,
            (Self::Length, "mm") => 1e-3,
            (Self::Angle, "deg" | "degrees" | "degree" | "°") | (Self::AngularRate, "degps" | "deg/s" | "°/s") => {
                degree
            }
            (Self::AngularRate, "degph" | "deg/h" | "°/h") => degree / 3600.0,
            (Self::Angle, "arcsec") => degree / 3600.0,
            (Self::Speed, "kmph" | "km/h" | "kph") => 1.0 / 3.6,
            (Self::Speed, "mmps" | "mm/s") => 1e-3,
            (Self::Acceleration, "g") => STANDARD_GRAVITY_MPS2,
            (Self::Acceleration, "mg") => 1e-3 * STANDARD_GRAVITY_MPS2,
            _ => return None,
        };
        Some(factor)
    }
}

/// Factor of a unit of time to seconds.
fn seconds(unit: &str) -> Option<f64> {
    match unit {
        "s" | "sec" | "seconds" => Some(1.0),
        "ms" => Some(1e-3),
        "us" => Some(1e-6),
        _ => None,
    }
}

/// A quantity that a column of some file can hold.
#[derive(Debug)]
pub(super) struct Quantity {
    /// Names without their unit.
    pub(super) names: &'static [&'static str],
    pub(super) dimension: Dimension,
    /// Place of the value in a row.
    pub(super) slot: usize,
    /// -1 where the axis of the name points against that of the row.
    pub(super) sign: f64,
}

impl Quantity {
    /// A quantity whose axis is that of the row.
    pub(super) const fn new(names: &'static [&'static str], dimension: Dimension, slot: usize) -> Self {
        Self { names, dimension, slot, sign: 1.0 }
    }
}

/// The columns of a kind of file whose rows have `N` numbers.
#[derive(Debug)]
pub(super) struct Spec<const N: usize> {
    /// All but time and week.
    pub(super) quantities: &'static [Quantity],
    /// Names for the error message.
    pub(super) known: &'static str,
    /// A pattern for the error message.
    pub(super) example: &'static str,
    /// Whether a field may be empty or "nan".
    pub(super) blanks: bool,
}

/// What a column is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    /// As it was written.
    pub(super) name: String,
    pub(super) slot: usize,
    pub(super) factor: f64,
    /// Is added after the factor: for GPS seconds since 1980.
    pub(super) offset: f64,
    /// Whether the name says that the time is adjusted standard time.
    pub(super) adjusted: bool,
}

/// What a name says.
#[derive(Debug)]
pub(super) enum Named {
    Column(Column),
    /// The quantity is known, the unit is missing or of another quantity.
    NoUnit,
    Unknown,
}

const TIME_NAMES: &[&str] = &["time", "gps_time", "gpstime", "time_of_week", "tow", "sow", "seconds_of_week", "t"];

impl<const N: usize> Spec<N> {
    /// What a name says.
    pub(super) fn parse(&self, name: &str) -> Named {
        let plain = plain_name(name);
        let column = |slot, factor, offset, adjusted| {
            let name = name.trim().trim_matches('"').to_string();
            Named::Column(Column { name, slot, factor, offset, adjusted })
        };
        match plain.as_str() {
            "adjusted_s" | "adjusted_time_s" | "adjusted_standard_s" => return column(TIME, 1.0, 0.0, true),
            "gps_s" => return column(TIME, 1.0, -ADJUSTED_OFFSET_S, true),
            "gps_week" | "week" => return column(WEEK, 1.0, 0.0, false),
            base if TIME_NAMES.contains(&base) => return column(TIME, 1.0, 0.0, false),
            _ => {}
        }
        let find = |base: &str| self.quantities.iter().find(|q| q.names.contains(&base));
        if let Some(quantity) = find(&plain) {
            return match quantity.dimension {
                Dimension::Count => column(quantity.slot, 1.0, 0.0, false),
                _ => Named::NoUnit,
            };
        }
        let Some((base, unit)) = plain.rsplit_once('_') else { return Named::Unknown };
        if TIME_NAMES.contains(&base) {
            return seconds(unit).map_or(Named::NoUnit, |factor| column(TIME, factor, 0.0, false));
        }
        let Some(quantity) = find(base) else { return Named::Unknown };
        match quantity.dimension.factor(unit) {
            Some(factor) => column(quantity.slot, quantity.sign * factor, 0.0, false),
            None => Named::NoUnit,
        }
    }

    /// The columns of a pattern: every name must be known and carry its unit; `None` for `-`.
    pub(super) fn pattern(&self, path: &Path, names: &[String]) -> Result<Vec<Option<Column>>, MeasurementFileError> {
        let one = |name: &String| match (name.trim(), self.parse(name)) {
            ("-" | "", _) => Ok(None),
            (_, Named::Column(column)) => Ok(Some(column)),
            (_, Named::NoUnit) => Err(self.no_unit(path, name)),
            (_, Named::Unknown) => {
                let (path, name) = (path.to_path_buf(), name.clone());
                Err(MeasurementFileError::UnknownColumn { path, name, known: self.known })
            }
        };
        names.iter().map(one).collect()
    }

    /// The columns of a pattern of the program's own.
    pub(super) fn own_pattern(&self, names: &[&str]) -> Vec<Option<Column>> {
        let one = |name: &&str| match self.parse(name) {
            Named::Column(column) => Some(column),
            _ => None,
        };
        names.iter().map(one).collect()
    }

    /// The error of a name without a unit.
    pub(super) fn no_unit(&self, path: &Path, name: &str) -> MeasurementFileError {
        let (path, name) = (path.to_path_buf(), name.chars().take(60).collect());
        MeasurementFileError::NoUnit { path, name, example: self.example }
    }
}
