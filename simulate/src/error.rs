//! What can be wrong with a simulation.

use std::io;
use std::path::PathBuf;

use tieline_filter::imu::ImuError;
use tieline_filter::{SmootherError, TrajectoryError};
use tieline_io::crs::CrsError;
use tieline_io::las::LasError;
use tieline_io::trajectory::TrajectoryFileError;

/// Why a survey cannot be simulated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulateError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// The scenario is not what a scenario is.
    #[error("{}: {source}", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// Line, caret and reason.
        source: Box<toml::de::Error>,
    },
    /// A number of the scenario makes no sense.
    #[error("{key} = {value}: {expected}")]
    Scenario {
        /// Key in the scenario.
        key: &'static str,
        /// What stands there.
        value: String,
        /// What would make sense.
        expected: &'static str,
    },
    /// The coordinate reference system.
    #[error(transparent)]
    Crs(#[from] CrsError),
    /// A trajectory that is none.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// A trajectory cannot be written.
    #[error(transparent)]
    TrajectoryFile(#[from] TrajectoryFileError),
    /// A strip cannot be written.
    #[error(transparent)]
    Las(#[from] LasError),
    /// Inertial measurements that are none.
    #[error(transparent)]
    Imu(#[from] ImuError),
    /// The smoother makes no trajectory of the simulated data.
    #[error("the simulated data give no trajectory: {0}")]
    Smoother(#[from] SmootherError),
}
