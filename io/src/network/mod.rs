//! Geodetic nets: GNU Gama's XML (`.gkf`) and `DynAdjust`'s station and measurement text (`.stn`, `.msr`).

pub mod dynadjust;
pub mod gama;

use std::path::PathBuf;

/// How a coordinate takes part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Role {
    /// Not part of the net.
    #[default]
    None,
    /// Held.
    Fixed,
    /// Unknown.
    Adjusted,
    /// Unknown, and part of the datum of a free net.
    Constrained,
}

/// A station.
#[derive(Debug, Clone, PartialEq)]
pub struct Station {
    /// Its name.
    pub name: String,
    /// Coordinates as in the file \[m\]; none where they must be computed.
    pub coordinates_m: [Option<f64>; 3],
    /// Roles of x, y, z.
    pub roles: [Role; 3],
}

/// What was measured; stations by index, angles \[rad\], lengths \[m\].
#[derive(Debug, Clone, PartialEq)]
pub enum Observation {
    /// Direction: set, station, target, reading, sigma.
    Direction(usize, usize, usize, f64, f64),
    /// Horizontal distance: from, to, length, sigma.
    Distance(usize, usize, f64, f64),
    /// Angle: station, backsight, foresight, value, sigma.
    Angle(usize, usize, usize, f64, f64),
    /// Azimuth: station, target, value, sigma.
    Azimuth(usize, usize, f64, f64),
    /// Levelled height difference: from, to, value, sigma.
    HeightDifference(usize, usize, f64, f64),
    /// Correlated baselines and points: start (none: the point itself), end, values; covariance \[m²\], row by row.
    Cluster(Vec<(Option<usize>, usize, [f64; 3])>, Vec<f64>),
}

/// A geodetic net.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Network {
    /// Stations.
    pub stations: Vec<Station>,
    /// Observations.
    pub observations: Vec<Observation>,
    /// Direction sets.
    pub sets: usize,
    /// A-priori sigma of unit weight.
    pub sigma_apriori: f64,
    /// Whether sigmas are scaled by the a-posteriori sigma of unit weight.
    pub a_posteriori: bool,
    /// Whether angles run from y to x in the plane of the file's coordinates.
    pub angles_from_y_to_x: bool,
    /// Azimuth of the x axis, in the sense of the angles \[rad\].
    pub azimuth_of_x_rad: f64,
}

/// Why a net cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// What it holds is not a net.
    #[error("{path}, line {line}: {message}")]
    Content {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong, and what to do.
        message: String,
    },
}

/// What is wrong in a text, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {message}")]
pub struct Fault {
    /// Line, from 1.
    pub line: usize,
    /// What is wrong, and what to do.
    pub message: String,
}

impl Fault {
    pub(crate) fn new(line: usize, message: impl Into<String>) -> Self {
        Self { line, message: message.into() }
    }
    pub(crate) fn of(self, path: &std::path::Path) -> NetworkError {
        NetworkError::Content { path: path.to_path_buf(), line: self.line, message: self.message }
    }
}

pub(crate) fn read_text(path: &std::path::Path) -> Result<String, NetworkError> {
    let bytes = std::fs::read(path).map_err(|source| NetworkError::Read { path: path.to_path_buf(), source })?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
