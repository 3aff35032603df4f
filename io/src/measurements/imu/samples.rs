//! The samples of a file in the making: checked one by one, turned into the body frame, put in order.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use tieline_filter::{Imu, ImuSample};

use super::{Axes, ImuFile, ImuFormat, ImuKind};
use crate::measurements::MeasurementFileError;
use crate::measurements::timeline::Timeline;
use crate::trajectory::Place;

/// A sample may come this much late \[s\].
const DISORDER_S: f64 = 1.0;

/// The samples of a file in the making.
pub(super) struct Samples<'a> {
    path: &'a Path,
    kind: ImuKind,
    body_from_sensor: Matrix3<f64>,
    timeline: Timeline,
    samples: Vec<ImuSample>,
    only_zeros: bool,
}

impl<'a> Samples<'a> {
    pub(super) fn new(path: &'a Path, kind: ImuKind, axes: &Axes, adjusted: bool) -> Self {
        let timeline = Timeline::new(path, DISORDER_S, adjusted);
        let body_from_sensor = axes.body_from_sensor();
        Self { path, kind, body_from_sensor, timeline, samples: Vec::new(), only_zeros: true }
    }

    /// Adds a sample: time \[s\] and week, then angles and velocities, or their rates, along the axes of the sensor.
    pub(super) fn push(
        &mut self,
        place: Place,
        [time_s, week]: [f64; 2],
        angle: &Vector3<f64>,
        velocity: &Vector3<f64>,
    ) -> Result<(), MeasurementFileError> {
        let (angle_name, velocity_name) = match self.kind {
            ImuKind::Increments => ("increment of angle [rad]", "increment of velocity [m/s]"),
            ImuKind::Rates => ("angular rate [rad/s]", "specific force [m/s²]"),
        };
        self.limit(place, angle_name, angle, 1e3, "at most 1e3")?;
        self.limit(place, velocity_name, velocity, 1e5, "at most 1e5")?;
        let time_s = self.timeline.place(place, time_s, week)?;
        self.only_zeros &= angle.amax() <= 0.0 && velocity.amax() <= 0.0;
        let (angle_rad, velocity_mps) = (self.body_from_sensor * angle, self.body_from_sensor * velocity);
        self.samples.push(ImuSample { time_s, angle_rad, velocity_mps });
        Ok(())
    }

    fn limit(
        &self,
        place: Place,
        column: &'static str,
        value: &Vector3<f64>,
        limit: f64,
        expected: &'static str,
    ) -> Result<(), MeasurementFileError> {
        match value.iter().find(|v| v.is_nan() || v.abs() > limit) {
            None => Ok(()),
            Some(v) if v.is_finite() => {
                let path = self.path.to_path_buf();
                Err(MeasurementFileError::Absurd { path, place, column, value: *v, expected })
            }
            Some(_) => {
                let (path, column) = (self.path.to_path_buf(), column.to_string());
                Err(MeasurementFileError::NotFinite { path, place, column })
            }
        }
    }

    pub(super) fn finish(mut self, format: ImuFormat, mut notes: Vec<String>) -> Result<ImuFile, MeasurementFileError> {
        let path = self.path;
        if self.only_zeros && !self.samples.is_empty() {
            return Err(MeasurementFileError::AllZero { path: path.to_path_buf() });
        }
        let settled = self.timeline.settle(&mut self.samples, true);
        notes.extend(settled.notes);
        let imu = match self.kind {
            ImuKind::Increments => Imu::new(self.samples),
            ImuKind::Rates => Imu::from_rates(self.samples),
        };
        let imu = imu.map_err(|source| MeasurementFileError::Imu { path: path.to_path_buf(), source })?;
        let gaps: Vec<(f64, f64)> = imu.gaps().collect();
        if let Some((from_s, to_s)) = gaps.iter().copied().max_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0))) {
            notes.push(format!(
                "{}: {} gaps; the longest is {:.3} s, from {from_s} to {to_s} s",
                path.display(),
                gaps.len(),
                to_s - from_s
            ));
        }
        let file =
            ImuFile { imu, format, kind: self.kind, time_encoding: settled.time_encoding, week: settled.week, notes };
        Ok(file.with_note_if_slow(path))
    }
}

impl ImuFile {
    fn with_note_if_slow(mut self, path: &Path) -> Self {
        if self.is_slow() {
            self.notes.push(format!(
                "{}: slow: the usual interval between samples is {:.3} s; mechanisation needs 0.1 s or less",
                path.display(),
                self.imu.interval_s()
            ));
        }
        self
    }
}
