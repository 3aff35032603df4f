//! A scenario of either kind.

use std::path::Path;

use crate::drive::DriveScenario;
use crate::error::SimulateError;
use crate::scenario::Scenario;

/// A flight, or a drive: a file with a table `[drive]`.
#[derive(Debug, Clone, PartialEq)]
pub enum AnyScenario {
    /// An airborne survey.
    Flight(Box<Scenario>),
    /// A drive.
    Drive(Box<DriveScenario>),
}

impl AnyScenario {
    /// Reads a scenario and checks it.
    ///
    /// # Errors
    /// [`SimulateError`] names the key and what would make sense.
    pub fn read(path: &Path) -> Result<Self, SimulateError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| SimulateError::Io { path: path.to_path_buf(), source })?;
        let table: toml::Table = toml::from_str(&text)
            .map_err(|source| SimulateError::Toml { path: path.to_path_buf(), source: Box::new(source) })?;
        match table.contains_key("drive") {
            true => Ok(Self::Drive(Box::new(DriveScenario::read(path)?))),
            false => Ok(Self::Flight(Box::new(Scenario::read(path)?))),
        }
    }
}
