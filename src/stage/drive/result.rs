//! What becomes of a drive.

use tieline_filter::{Inputs, Pose, Solution, Trajectory};

use super::again::MeasuredAgain;
use super::calibrated::Calibrated;
use super::choose::Chosen;
use super::constants::Constants;
use super::correction::DriveCorrection;
use super::decided::Decisions;
use super::held_pose_at;
use super::picked::PickedFate;
use super::points::PointTie;
use super::ties::DriveLine;
use crate::job::Matched;
use crate::stage::ties::Ties;

/// What became of a drive.
#[derive(Debug)]
pub struct DriveSolution {
    /// The smoother's.
    pub solution: Solution,
    /// What it was given, ties included.
    pub inputs: Inputs,
    /// The constants of the calibration.
    pub constants: Constants,
    /// Lines with their ends.
    pub lines: Vec<DriveLine>,
    /// Which of them became ties.
    pub chosen: Chosen,
    /// Points that are ties, and of them those that went to the smoother, after those of lines.
    pub points: (Vec<PointTie>, Vec<PointTie>),
    /// The new trajectory in the map, on the clock of the strips.
    pub trajectory: Trajectory,
    /// Seconds from the strips' clock to that of the measurements.
    pub clock_shift_s: f64,
    /// Nearest and farthest range of each scanner in use, the half per cent at either end left out \[m\].
    pub ranges_m: Vec<(f64, f64)>,
    /// What a person should be told.
    pub notes: Vec<String>,
    /// What was decided on the way to it.
    pub decisions: Decisions,
    /// The ties as they were measured again, when they were.
    pub again: Option<MeasuredAgain>,
    /// What the patches were moved by to measure them again.
    pub moved_by: Option<DriveCorrection>,
    /// What became of points picked by hand.
    pub picked: Vec<PickedFate>,
}

impl DriveSolution {
    /// The ties that the lines are of: those measured last.
    #[must_use]
    pub fn ties<'a>(&'a self, matched: &'a Matched) -> &'a Ties {
        self.again.as_ref().map_or(&matched.ties, |again| &again.ties)
    }

    /// What there is to say of the calibration.
    #[must_use]
    pub fn calibrated(&self) -> Calibrated<'_> {
        Calibrated {
            constants: &self.constants,
            estimate: &self.solution.calibration,
            ranges_m: &self.ranges_m,
            verdicts: &self.decisions.verdicts,
        }
    }

    /// The new pose at a time of the strips' clock, in the map; held a moment beyond the ends, where GNSS and IMU end before
    /// the last profile.
    #[must_use]
    pub fn pose_at(&self, time_s: f64) -> Option<Pose> {
        held_pose_at(&self.trajectory, time_s)
    }
}
