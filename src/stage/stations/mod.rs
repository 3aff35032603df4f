//! Stations without a trajectory: several scanners of one vehicle, points in the frames of the scanners, each station
//! one pose. Planes that two scanners have in common tell how the scanners are mounted against one of them.
//!
//! [`read`] → patches of every scanner and station → [`hold_out`] → [`pairs`] ↔ [`solve`] → [`sight`]: what is not seen.

pub mod check;
pub mod hold_out;
pub mod motion;
pub mod mounts;
pub mod normals;
pub mod pairs;
pub mod read;
pub mod sight;
pub mod solve;

use nalgebra::Vector3;

pub use mounts::{Head, Mounts};
pub use solve::{StationsSolution, calibrate};

/// Points of one scanner at one station, in the frame of the scanner.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Spin {
    /// Points \[m\].
    pub points_m: Vec<Vector3<f64>>,
    /// Intensity of each.
    pub intensity: Vec<u16>,
    /// Time of each \[s\], as in the file; equal ones where it has none.
    pub time_s: Vec<f64>,
}

/// A station: one pose of the vehicle.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Station {
    /// Name of its file, and point source id where one file holds several.
    pub name: String,
    /// One for each scanner of [`Mounts`], in that order; without points where the scanner saw nothing.
    pub spins: Vec<Spin>,
}

impl Station {
    /// First and last time of its points \[s\].
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        let times = self.spins.iter().flat_map(|s| s.time_s.iter());
        let (first, last) = times.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(*t), b.max(*t)));
        if first <= last { (first, last) } else { (0.0, 0.0) }
    }
}

/// Settings of the calibration of stations.
#[derive(Debug, Clone, PartialEq)]
pub struct StationOptions {
    /// What a patch is.
    pub planar: tieline_matching::PlanarOptions,
    /// Planes of one surface lie no further apart than this beyond what the mounting explains \[m\].
    pub search_m: f64,
    /// The same between their normals \[rad\].
    pub normal_angle_rad: f64,
    /// Share of the planes that are held out.
    pub hold_out: f64,
    /// Seed of their choice.
    pub seed: u64,
}

impl Default for StationOptions {
    fn default() -> Self {
        Self {
            planar: tieline_matching::PlanarOptions::default(),
            search_m: 0.3,
            normal_angle_rad: 3.0_f64.to_radians(),
            hold_out: 0.2,
            seed: 1,
        }
    }
}
