//! Places on earth, checked.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::path::Path;

use nalgebra::Vector3;

use super::error::MeasurementFileError;
use crate::trajectory::Place;

/// Latitude \[rad\], longitude \[rad\] within ±π, height \[m\] of a place on earth.
pub(super) fn checked_geodetic(
    path: &Path,
    place: Place,
    geodetic: &Vector3<f64>,
) -> Result<Vector3<f64>, MeasurementFileError> {
    let limit = |column, value: f64, limit: f64, expected, unit: f64| match value.abs() <= limit {
        true => Ok(()),
        false => {
            let (path, value) = (path.to_path_buf(), value * unit);
            Err(MeasurementFileError::Absurd { path, place, column, value, expected })
        }
    };
    let degrees = 180.0 / PI;
    limit("latitude [deg]", geodetic.x, FRAC_PI_2 + 1e-12, "at most 90", degrees)?;
    limit("longitude [deg]", geodetic.y, TAU + 1e-12, "at most 360", degrees)?;
    limit("height [m]", geodetic.z, 1e6, "at most 1e6", 1.0)?;
    let longitude = match geodetic.y {
        east if east > PI => east - TAU,
        west if west < -PI => west + TAU,
        longitude => longitude,
    };
    Ok(Vector3::new(geodetic.x.clamp(-FRAC_PI_2, FRAC_PI_2), longitude, geodetic.z))
}
