//! `summary.json` of `calibrate` on drives; its keys are public.

use serde::Serialize;

use crate::report::data::Timing;
use crate::report::drive::data::DriveCalibration;

/// A drive of a calibration run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct DriveOfRun {
    /// Name.
    pub name: String,
    /// Ties that the smoother took.
    pub ties: usize,
    /// What the sigmas of ties turned out to be, over what was measured: increments, loops, each of level and of steep surfaces.
    pub sigma_factors: Vec<f64>,
    /// What it says against what the others say: squared difference over its variance. 0 for a drive alone.
    pub chi_squared: f64,
    /// Directions compared.
    pub degrees_of_freedom: usize,
    /// What 1 in 1000 exceed by chance.
    pub chi_squared_limit: f64,
    /// Whether it is below.
    pub agrees: bool,
}

/// A calibration of one drive or more.
#[derive(Debug, Clone, Default, Serialize)]
pub struct CalibrationRun {
    /// Version of tieline.
    pub version: String,
    /// Drives.
    pub drives: Vec<DriveOfRun>,
    /// What the sigmas of all drives were multiplied by because they differ by more than they say.
    pub sigma_factor: f64,
    /// Terms, values, range bias.
    pub calibration: DriveCalibration,
    /// Remarks.
    pub notes: Vec<String>,
    /// Times.
    pub timing: Timing,
    /// Peak memory \[bytes\].
    pub peak_memory_bytes: u64,
}

impl CalibrationRun {
    /// A calibration of drives; times and memory are filled in later.
    #[must_use]
    pub fn new(calibration: DriveCalibration, drives: Vec<DriveOfRun>) -> Self {
        let version = String::from(env!("CARGO_PKG_VERSION"));
        Self { version, drives, sigma_factor: 1.0, calibration, ..Self::default() }
    }
}
