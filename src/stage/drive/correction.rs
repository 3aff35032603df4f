//! What of a drive's solution corrects its points: the new trajectory, and the calibration of each scanner.

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};
use tieline_filter::{Pose, Trajectory};
use tieline_graph::Calibration;

use super::constants::{Beam, Constants};
use super::curve::RangeSpline;
use super::over::{self, OverCurve};
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
    /// Those over incidence and intensity.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub over: Vec<OverCurve>,
}

/// Where a beam belongs, its range left as it was measured.
#[derive(Debug, Clone, Copy)]
pub struct Moved {
    /// Its end, map \[m\].
    pub point_m: Vector3<f64>,
    /// Turns what lies about its end, map axes.
    pub turned: Matrix3<f64>,
    /// From the nominal body axes that rays are given in to the map.
    pub map_from_body: Matrix3<f64>,
    /// Ray from the scanner, nominal body axes \[m\].
    pub ray_m: Vector3<f64>,
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
        Self::new(&drive.constants, &drive.solution.calibration.value, drive.trajectory.clone())
    }

    /// The correction by constants with their values, and a trajectory in the map on the clock of the strips.
    #[must_use]
    pub fn new(constants: &Constants, values: &[f64], trajectory: Trajectory) -> Self {
        let scanners = (0..constants.splines.len()).map(|scanner| ScannerCorrection {
            lever_arm_m: constants.lever_arm_m(scanner),
            calibration: constants.calibration(scanner, values),
            latency_s: constants.latency_s(scanner, values),
            ranges: constants.range_curves(scanner, values),
            over: constants.over_curves(scanner, values),
        });
        Self { trajectory, scanners: scanners.collect() }
    }

    /// Where a beam belongs that a scanner measured from an old pose, as it would be without a range correction; none beyond the ends of the
    /// new trajectory, and for a scanner that is not there. North at the old place is north at the new one: of the new trajectory positions and attitudes are known.
    #[must_use]
    pub fn moved(&self, old: &Pose, beam: &Beam) -> Option<Moved> {
        let corrected = self.scanners.get(beam.scanner)?;
        let new = self.pose_at(old.time_s + corrected.latency_s)?;
        let calibration = &corrected.calibration;
        let boresight = Rotation3::new(calibration.boresight_rad);
        let ned_from_body = |pose: &Pose| Rotation3::from(pose.ned_from_body);
        let ray_m = beam.body_vector_m - corrected.lever_arm_m;
        let body_m = corrected.lever_arm_m + calibration.lever_arm_m + boresight * ray_m;
        let turned = ned_from_body(&new) * boresight * ned_from_body(old).inverse();
        Some(Moved {
            point_m: new.position + old.map_from_ned * (new.ned_from_body * body_m),
            turned: old.map_from_ned * turned.matrix() * old.map_from_ned.try_inverse()?,
            map_from_body: old.map_from_ned * (ned_from_body(&new) * boresight).matrix(),
            ray_m,
        })
    }

    /// What the range corrections of a beam's scanner add to a ray of the patch that it met, nominal body axes, of a range \[m\].
    #[must_use]
    pub fn longer_m(&self, beam: &Beam, ray_m: &Vector3<f64>, range_m: f64) -> f64 {
        self.scanners.get(beam.scanner).map_or(0.0, |s| {
            let of_range: f64 = s.ranges.iter().map(|(spline, c)| spline.at(c, range_m)).sum();
            of_range + over::longer_m(&s.over, &beam.target, ray_m)
        })
    }

    /// The new pose at a time of the strips' clock, held a moment beyond the ends.
    #[must_use]
    pub fn pose_at(&self, time_s: f64) -> Option<Pose> {
        held_pose_at(&self.trajectory, time_s)
    }
}
