//! Sections of the project file on stations without a trajectory: `[[stations]]`, `[extrinsics]`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use tieline_io::measurements::Axes;

use super::ScannerChoice;

/// `[[stations]]`: points in the frames of their scanners, each station one pose of the vehicle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StationsSection {
    /// File or pattern; every file, and every point source id in it, is a station.
    pub path: String,
    /// Where the number of the scanner stands.
    #[serde(default)]
    pub scanner: ScannerChoice,
}

/// `[extrinsics]`: how the scanners are mounted, roughly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExtrinsicsSection {
    /// Table of `reference_from_scanner`; `[[platform.scanner]]` is taken when left out.
    pub path: Option<PathBuf>,
    /// Scanner that the others are calibrated against.
    #[serde(default)]
    pub reference: u16,
    /// Where the axes of the reference scanner point; not used when `[[platform.scanner]]` names it.
    #[serde(default = "ExtrinsicsSection::default_axes")]
    pub axes: Axes,
    /// How well the angles are known, each \[deg\].
    #[serde(default = "ExtrinsicsSection::default_boresight_sigma_deg")]
    pub boresight_sigma_deg: f64,
    /// How well the places are known, each axis \[m\].
    #[serde(default = "ExtrinsicsSection::default_lever_arm_sigma_m")]
    pub lever_arm_sigma_m: f64,
}

impl ExtrinsicsSection {
    fn default_axes() -> Axes {
        "FLU".parse().unwrap_or_default()
    }
    fn default_boresight_sigma_deg() -> f64 {
        2.0
    }
    fn default_lever_arm_sigma_m() -> f64 {
        0.25
    }
}

impl Default for ExtrinsicsSection {
    fn default() -> Self {
        Self {
            path: None,
            reference: 0,
            axes: Self::default_axes(),
            boresight_sigma_deg: Self::default_boresight_sigma_deg(),
            lever_arm_sigma_m: Self::default_lever_arm_sigma_m(),
        }
    }
}
