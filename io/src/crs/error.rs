//! What can be wrong with a coordinate reference system, and the way out.

use tieline_filter::TrajectoryError;

/// Why a coordinate reference system cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CrsError {
    /// Not a CRS in any of the forms.
    #[error("\"{text}\" is not a CRS: write \"EPSG:25832\", \"local\", WKT or a proj string")]
    NotUnderstood {
        /// What was given (its beginning).
        text: String,
    },
    /// An EPSG code that is not in the list.
    #[error("EPSG:{code} is not in the list of definitions; give the CRS as WKT or as a proj string (epsg.io/{code})")]
    UnknownCode {
        /// The code.
        code: u32,
    },
    /// A definition that the projection library does not take.
    #[error("\"{text}\" cannot be evaluated ({reason}); give an EPSG code or another definition of the same CRS")]
    Unsupported {
        /// The definition (its beginning).
        text: String,
        /// What the library said.
        reason: String,
    },
    /// Feet.
    #[error("{name} is in {units}, not metres; reproject the strips to a metric CRS")]
    NotMetric {
        /// The CRS.
        name: String,
        /// Its units.
        units: String,
    },
    /// Axes other than east and north.
    #[error("{name} has the axes \"{axes}\"; reproject the strips to a CRS of easting and northing")]
    Axes {
        /// The CRS.
        name: String,
        /// Its axes, as proj writes them.
        axes: String,
    },
    /// Degrees where metres are due.
    #[error(
        "{name} is geographic: coordinates in degrees cannot be adjusted in metres; reproject the strips to a projected CRS, for instance to {remedy}"
    )]
    Geographic {
        /// The CRS.
        name: String,
        /// A projected CRS that would do.
        remedy: String,
    },
    /// A local system that hangs in the air.
    #[error("the local CRS has no origin; add origin = [latitude_deg, longitude_deg, height_m] to [project]")]
    NoOrigin,
    /// An origin that is none.
    #[error(
        "the origin [{latitude_deg}, {longitude_deg}, {height_m}] is not a latitude, a longitude \\[deg\\] and a height \\[m\\]"
    )]
    BadOrigin {
        /// Latitude \[deg\].
        latitude_deg: f64,
        /// Longitude \[deg\].
        longitude_deg: f64,
        /// Height \[m\].
        height_m: f64,
    },
    /// A position that the projection cannot reach.
    #[error("{name} cannot hold the position {first}, {second}: the wrong CRS, or a wrong trajectory")]
    OutsideDomain {
        /// The CRS.
        name: String,
        /// Latitude \[deg\] or easting \[m\].
        first: f64,
        /// Longitude \[deg\] or northing \[m\].
        second: f64,
    },
    /// The converted epochs do not make a trajectory.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}
