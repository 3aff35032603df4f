//! What of a drive's solution corrects its points: the new trajectory, and the calibration of each scanner.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tieline_filter::{Pose, Trajectory};
use tieline_graph::Calibration;

use super::curve::RangeSpline;
use super::{DriveSolution, held_pose_at};

/// The calibration of one scanner, known and estimated, as corrections.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScannerCorrection {
    /// Lever arm that the strips were made with, body frame \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// Boresight and lever arm.
    pub calibration: Calibration,
    /// True time less stamp \[s\].
    pub latency_s: f64,
    /// Range corrections, to be added: splines and coefficients \[m\].
    pub ranges: Vec<(RangeSpline, Vec<f64>)>,
}

/// All that moves the points of a drive.
#[derive(Debug, Clone)]
pub struct DriveCorrection {
    /// The new trajectory in the map, on the clock of the strips; positions and attitudes count.
    pub trajectory: Trajectory,
    /// By scanner.
    pub scanners: Vec<ScannerCorrection>,
}

impl DriveCorrection {
    /// The correction of a solution.
    #[must_use]
    pub fn of(drive: &DriveSolution) -> Self {
        let (constants, values) = (&drive.constants, &drive.solution.calibration.value);
        let scanners = (0..constants.splines.len()).map(|scanner| ScannerCorrection {
            lever_arm_m: constants.lever_arm_m(scanner),
            calibration: constants.calibration(scanner, values),
            latency_s: constants.latency_s(scanner, values),
            ranges: constants.range_curves(scanner, values),
        });
        Self { trajectory: drive.trajectory.clone(), scanners: scanners.collect() }
    }

    /// The new pose at a time of the strips' clock, held a moment beyond the ends.
    #[must_use]
    pub fn pose_at(&self, time_s: f64) -> Option<Pose> {
        held_pose_at(&self.trajectory, time_s)
    }
}
