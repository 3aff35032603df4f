//! Fixes as they come from a file: checked one by one, with usable covariances, put in order.

use std::path::Path;

use nalgebra::{Cholesky, Matrix3, Vector3};
use tieline_filter::{FixQuality, GnssFix, GnssVelocity};

use super::{GnssFile, GnssFormat};
use crate::measurements::MeasurementFileError;
use crate::measurements::geodetic::checked_geodetic;
use crate::measurements::timeline::Timeline;
use crate::trajectory::Place;

/// A sigma below this says nothing \[m\], \[m/s\].
const LEAST_SIGMA: f64 = 1e-4;
/// Sigma of a velocity whose file gives none that can be used \[m/s\], along each axis.
pub const USUAL_SIGMA_MPS: f64 = 0.1;

/// Horizontal and vertical sigma \[m\] of a fix whose file gives none that can be used.
#[must_use]
pub fn usual_sigma_m(quality: FixQuality) -> (f64, f64) {
    match quality {
        FixQuality::Fixed => (0.02, 0.04),
        FixQuality::Unknown => (0.05, 0.10),
        FixQuality::Ppp => (0.1, 0.2),
        FixQuality::Float => (0.3, 0.6),
        FixQuality::Sbas | FixQuality::Differential => (1.0, 2.0),
        FixQuality::Single => (3.0, 6.0),
    }
}

/// The quality of RTKLIB's number.
pub(super) fn quality(number: f64) -> FixQuality {
    const QUALITIES: [FixQuality; 6] = [
        FixQuality::Fixed,
        FixQuality::Float,
        FixQuality::Sbas,
        FixQuality::Differential,
        FixQuality::Single,
        FixQuality::Ppp,
    ];
    let found = (1..=6_u8).position(|q| (f64::from(q) - number).abs() < 0.5);
    found.map_or(FixQuality::Unknown, |index| QUALITIES[index])
}

/// A vector with its spread, along the axes of its file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Local {
    pub(super) value: Vector3<f64>,
    pub(super) sigma: Vector3<f64>,
    /// Signed square roots of the covariances of axes 0 and 1, 1 and 2, 2 and 0.
    pub(super) root: Vector3<f64>,
}

/// An epoch of a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Raw {
    pub(super) place: Place,
    pub(super) time_s: f64,
    /// NaN where there is none.
    pub(super) week: f64,
    pub(super) geodetic: Vector3<f64>,
    pub(super) quality: FixQuality,
    pub(super) sigma: Vector3<f64>,
    /// As in [`Local`].
    pub(super) root: Vector3<f64>,
    pub(super) velocity: Option<Local>,
    /// Turns the axes of sigmas and velocities into north, east, down.
    pub(super) ned_from_local: Matrix3<f64>,
}

/// The fixes of a file in the making.
#[derive(Debug)]
pub(super) struct Fixes<'a> {
    path: &'a Path,
    timeline: Timeline,
    fixes: Vec<GnssFix>,
    without_position: u64,
    without_velocity: u64,
    /// Epochs whose sigma was replaced, and what by.
    replaced: Vec<(FixQuality, u64)>,
    velocity_replaced: u64,
    not_definite: u64,
}

impl<'a> Fixes<'a> {
    pub(super) fn new(path: &'a Path, adjusted: bool) -> Self {
        Self {
            path,
            timeline: Timeline::new(path, f64::INFINITY, adjusted),
            fixes: Vec::new(),
            without_position: 0,
            without_velocity: 0,
            replaced: Vec::new(),
            velocity_replaced: 0,
            not_definite: 0,
        }
    }

    /// Adds an epoch; one without a position is dropped and counted.
    pub(super) fn push(&mut self, raw: &Raw) -> Result<(), MeasurementFileError> {
        let nowhere = raw.geodetic.amax() <= 0.0;
        if nowhere || !raw.geodetic.iter().all(|v| v.is_finite()) || !raw.time_s.is_finite() {
            self.without_position += 1;
            return Ok(());
        }
        let geodetic = checked_geodetic(self.path, raw.place, &raw.geodetic)?;
        let time_s = self.timeline.place(raw.place, raw.time_s, raw.week)?;
        let (horizontal, vertical) = usual_sigma_m(raw.quality);
        // the variance of an axis that is neither horizontal nor vertical is a mean of both: weights are squares
        let share = raw.ned_from_local.row(2).map(|v| v * v);
        let usual = share.map(|s| ((1.0 - s) * horizontal * horizontal + s * vertical * vertical).max(0.0).sqrt());
        let (sigma, replaced) = usable(&raw.sigma, &usual.transpose());
        if replaced {
            match self.replaced.iter_mut().find(|(quality, _)| *quality == raw.quality) {
                Some((_, count)) => *count += 1,
                None => self.replaced.push((raw.quality, 1)),
            }
        }
        let covariance_ned_m2 = self.covariance(&sigma, &raw.root, &raw.ned_from_local);
        let velocity = raw.velocity.and_then(|velocity| self.velocity(&velocity, &raw.ned_from_local));
        self.fixes.push(GnssFix { time_s, geodetic, covariance_ned_m2, velocity, quality: raw.quality });
        Ok(())
    }

    fn velocity(&mut self, local: &Local, ned_from_local: &Matrix3<f64>) -> Option<GnssVelocity> {
        if !local.value.iter().all(|v| v.abs() < 1e5) {
            self.without_velocity += 1;
            return None;
        }
        let (sigma, replaced) = usable(&local.sigma, &Vector3::repeat(USUAL_SIGMA_MPS));
        self.velocity_replaced += u64::from(replaced);
        let covariance_m2ps2 = self.covariance(&sigma, &local.root, ned_from_local);
        Some(GnssVelocity { ned_mps: ned_from_local * local.value, covariance_m2ps2 })
    }

    /// The covariance north, east, down; correlations that cannot be are left out and counted.
    fn covariance(&mut self, sigma: &Vector3<f64>, root: &Vector3<f64>, ned_from_local: &Matrix3<f64>) -> Matrix3<f64> {
        let variance = Matrix3::from_diagonal(&sigma.map(|s| s * s));
        let c = root.map(|r| if r.is_finite() { r * r.abs() } else { 0.0 });
        let mixed = Matrix3::new(0.0, c[0], c[2], c[0], 0.0, c[1], c[2], c[1], 0.0);
        let full = variance + mixed;
        let local = match mixed.amax() > 0.0 && Cholesky::new(full).is_none() {
            true => {
                self.not_definite += 1;
                variance
            }
            false => full,
        };
        let ned = ned_from_local * local * ned_from_local.transpose();
        (ned + ned.transpose()) * 0.5
    }

    pub(super) fn finish(
        mut self,
        format: GnssFormat,
        mut notes: Vec<String>,
    ) -> Result<GnssFile, MeasurementFileError> {
        let path = self.path.display();
        if self.fixes.is_empty() {
            let path = self.path.to_path_buf();
            return Err(match self.without_position {
                0 => MeasurementFileError::Empty { path },
                dropped => MeasurementFileError::NoPosition { path, dropped },
            });
        }
        if self.without_position > 0 {
            notes.push(format!("{path}: {} epochs without a time or a position were dropped", self.without_position));
        }
        if self.without_velocity > 0 {
            notes.push(format!("{path}: {} epochs have no usable velocity", self.without_velocity));
        }
        for (quality, count) in &self.replaced {
            let (horizontal, vertical) = usual_sigma_m(*quality);
            notes.push(format!(
                "{path}: {count} epochs of quality {} have accuracies that are missing, zero or negative; {horizontal} m \
                 horizontally and {vertical} m vertically were taken",
                name(*quality)
            ));
        }
        if self.velocity_replaced > 0 {
            notes.push(format!(
                "{path}: {} velocities have accuracies that are missing, zero or negative; {USUAL_SIGMA_MPS} m/s was taken",
                self.velocity_replaced
            ));
        }
        if self.not_definite > 0 {
            notes
                .push(format!("{path}: {} covariances cannot be; their correlations were left out", self.not_definite));
        }
        let settled = self.timeline.settle(&mut self.fixes, true);
        notes.extend(settled.notes);
        let (time_encoding, week) = (settled.time_encoding, settled.week);
        Ok(GnssFile { fixes: self.fixes, format, time_encoding, week, notes })
    }
}

/// Sigmas of which those that say nothing are replaced, and whether any was.
fn usable(sigma: &Vector3<f64>, usual: &Vector3<f64>) -> (Vector3<f64>, bool) {
    let good = |s: f64| (LEAST_SIGMA..1e9).contains(&s);
    (sigma.zip_map(usual, |s, u| if good(s) { s } else { u }), !sigma.iter().all(|&s| good(s)))
}

/// The word for a quality.
fn name(quality: FixQuality) -> &'static str {
    match quality {
        FixQuality::Fixed => "fixed",
        FixQuality::Float => "float",
        FixQuality::Sbas => "SBAS",
        FixQuality::Differential => "differential",
        FixQuality::Single => "single",
        FixQuality::Ppp => "PPP",
        FixQuality::Unknown => "unknown",
    }
}
