//! Epochs as they come from a file: checked one by one, put on one clock, made into a trajectory.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use nalgebra::{UnitQuaternion, Vector3};
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{PoseSigma, PositionFrame, TimeEncoding, Trajectory, ned_from_body};

use super::error::{Place, TrajectoryFileError};

/// Above this, a time \[s\] is adjusted standard time and no longer seconds of some week: 115 days.
pub(crate) const LONGEST_WEEK_TIME_S: f64 = 1.0e7;
/// GPS seconds minus 10⁹ stay below this until the year 2043.
pub(crate) const LATEST_ADJUSTED_S: f64 = 1.0e9;

/// One epoch of a file, angles in radians.
#[derive(Debug, Clone, Copy)]
pub(super) struct Epoch {
    pub(super) time_s: f64,
    pub(super) position: Vector3<f64>,
    pub(super) roll_pitch_heading_rad: Vector3<f64>,
    pub(super) velocity_ned_mps: Option<Vector3<f64>>,
    pub(super) sigma: Option<PoseSigma>,
}

/// The epochs of a file in the making.
#[derive(Debug)]
pub(super) struct Records {
    path: PathBuf,
    frame: PositionFrame,
    time_s: Vec<f64>,
    position: Vec<Vector3<f64>>,
    ned_from_body: Vec<UnitQuaternion<f64>>,
    velocity_ned_mps: Vec<Vector3<f64>>,
    sigma: Vec<PoseSigma>,
    rollover_s: f64,
    duplicates: u64,
    first_duplicate: Option<Place>,
}

impl Records {
    /// No epochs yet; the errors will name `path`.
    pub(super) fn new(path: &Path, frame: PositionFrame) -> Self {
        Self {
            path: path.to_path_buf(),
            frame,
            time_s: Vec::new(),
            position: Vec::new(),
            ned_from_body: Vec::new(),
            velocity_ned_mps: Vec::new(),
            sigma: Vec::new(),
            rollover_s: 0.0,
            duplicates: 0,
            first_duplicate: None,
        }
    }

    /// Adds an epoch: its values must make sense; an epoch at the time of the one before is dropped and counted;
    /// seconds of week that fall back by a week go on counting.
    pub(super) fn push(&mut self, place: Place, epoch: &Epoch) -> Result<(), TrajectoryFileError> {
        self.check_values(place, epoch)?;
        let mut time_s = epoch.time_s + self.rollover_s;
        if let Some(&previous_s) = self.time_s.last() {
            if time_s < previous_s - 0.5 * SECONDS_PER_WEEK && previous_s < LONGEST_WEEK_TIME_S && epoch.time_s >= 0.0 {
                let weeks = ((previous_s - time_s) / SECONDS_PER_WEEK).round();
                self.rollover_s += weeks * SECONDS_PER_WEEK;
                time_s += weeks * SECONDS_PER_WEEK;
            }
            if time_s < previous_s {
                return Err(TrajectoryFileError::TimeBackwards { path: self.path.clone(), place, time_s, previous_s });
            }
            if time_s <= previous_s {
                self.duplicates += 1;
                self.first_duplicate.get_or_insert(place);
                return Ok(());
            }
        }
        let angle = &epoch.roll_pitch_heading_rad;
        self.time_s.push(time_s);
        self.position.push(epoch.position);
        self.ned_from_body.push(ned_from_body(angle.x, angle.y, angle.z));
        self.velocity_ned_mps.extend(epoch.velocity_ned_mps);
        self.sigma.extend(epoch.sigma);
        Ok(())
    }

    fn check_values(&self, place: Place, epoch: &Epoch) -> Result<(), TrajectoryFileError> {
        let finite = |column: &'static str, values: &[f64]| match values.iter().all(|v| v.is_finite()) {
            true => Ok(()),
            false => Err(TrajectoryFileError::NotFinite { path: self.path.clone(), place, column }),
        };
        let limit = |column: &'static str, value: f64, limit: f64, expected: &'static str| match value.abs() <= limit {
            true => Ok(()),
            false => Err(TrajectoryFileError::Absurd { path: self.path.clone(), place, column, value, expected }),
        };
        let (position, angle) = (&epoch.position, &epoch.roll_pitch_heading_rad);
        finite("time", &[epoch.time_s])?;
        finite("position", position.as_slice())?;
        finite("attitude", angle.as_slice())?;
        if epoch.time_s.abs() >= LATEST_ADJUSTED_S {
            return Err(TrajectoryFileError::TimeUnknown { path: self.path.clone(), place, time_s: epoch.time_s });
        }
        match self.frame {
            PositionFrame::Geodetic => {
                limit("latitude", position.x, TAU / 4.0, "at most pi/2 rad (90 deg)")?;
                limit("longitude", position.y, TAU, "at most 2 pi rad (360 deg)")?;
            }
            PositionFrame::Map => {
                limit("easting", position.x, 1e8, "at most 1e8 m")?;
                limit("northing", position.y, 1e8, "at most 1e8 m")?;
            }
        }
        limit("height", position.z, 1e6, "at most 1e6 m")?;
        limit("roll", angle.x, TAU, "at most 2 pi rad (360 deg)")?;
        limit("pitch", angle.y, TAU, "at most 2 pi rad (360 deg)")?;
        limit("heading", angle.z, 2.0 * TAU, "at most 4 pi rad (720 deg)")?;
        if let Some(velocity) = &epoch.velocity_ned_mps {
            finite("velocity", velocity.as_slice())?;
            limit("velocity", velocity.amax(), 1e5, "at most 1e5 m/s")?;
        }
        if let Some(sigma) = &epoch.sigma {
            let all = [sigma.position_ned_m, sigma.velocity_ned_mps, sigma.attitude_rph_rad];
            for vector in &all {
                finite("sigma", vector.as_slice())?;
            }
            let least = all.iter().map(Vector3::min).fold(f64::INFINITY, f64::min);
            limit("sigma", least.min(0.0), 0.0, "a sigma of zero or more")?;
        }
        Ok(())
    }

    /// The trajectory, how its time is to be read, and what a user should be told.
    pub(super) fn finish(self) -> Result<(Trajectory, TimeEncoding, Vec<String>), TrajectoryFileError> {
        let mut notes = Vec::new();
        if let Some(place) = self.first_duplicate {
            notes.push(format!(
                "{}: {} epochs had the time of the one before them and were dropped, the first at {place}",
                self.path.display(),
                self.duplicates
            ));
        }
        if self.rollover_s > 0.0 {
            notes.push(format!(
                "{}: seconds of week fell back at the week's end and were counted on past 604800 s",
                self.path.display()
            ));
        }
        let encoding = encoding_by_values(&self.time_s);
        let wrap = |source| TrajectoryFileError::Trajectory { path: self.path.clone(), source };
        let n = self.time_s.len();
        let complete = |found: usize| found == n;
        let velocity = if complete(self.velocity_ned_mps.len()) { self.velocity_ned_mps } else { Vec::new() };
        let mut trajectory =
            Trajectory::new(self.frame, self.time_s, self.position, self.ned_from_body, velocity).map_err(&wrap)?;
        if n > 0 && self.sigma.len() == n {
            trajectory = trajectory.with_sigma(self.sigma).map_err(&wrap)?;
        }
        Ok((trajectory, encoding, notes))
    }
}

/// Seconds of week or adjusted standard time, by the size of the numbers.
fn encoding_by_values(time_s: &[f64]) -> TimeEncoding {
    let largest = time_s.iter().fold(0.0_f64, |a, t| a.max(t.abs()));
    let negative = time_s.first().is_some_and(|&t| t < 0.0);
    match negative || largest >= LONGEST_WEEK_TIME_S {
        true => TimeEncoding::AdjustedStandard,
        false => TimeEncoding::SecondsOfWeek,
    }
}
