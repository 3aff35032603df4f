//! What is wrong with the delivered survey: what an estimator is to find.

use nalgebra::{UnitQuaternion, Vector3};

use crate::flight::{FlightLine, LinePose};
use crate::random::Random;
use crate::scenario::TrajectoryErrors;

/// The truth about a scanner. True = nominal + error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScannerTruth {
    /// True boresight, body rotation vector on the left of the mounting \[rad\].
    pub boresight_rad: Vector3<f64>,
    /// True minus nominal boresight \[rad\].
    pub boresight_error_rad: Vector3<f64>,
    /// True lever arm, body frame \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// True minus nominal lever arm \[m\].
    pub lever_arm_error_m: Vector3<f64>,
    /// True range = measured + offset + scale · measured \[m\].
    pub range_offset_m: f64,
    /// See above.
    pub range_scale: f64,
}

/// The error of a strip's delivered trajectory: **delivered minus true**. With `u` running from -1 at the begin of
/// the line to 1 at its end, every component is `constant + linear · u`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StripError {
    /// Strip, from 0.
    pub strip: u32,
    /// Middle of the line \[s of week\].
    pub middle_s: f64,
    /// Half its duration \[s\].
    pub half_s: f64,
    /// North, east, down \[m\].
    pub position_constant_ned_m: Vector3<f64>,
    /// North, east, down \[m\].
    pub position_linear_ned_m: Vector3<f64>,
    /// Rotation vector ψ about north, east, down \[rad\]: `C_delivered = exp([ψ]×) C_true`.
    pub rotation_constant_ned_rad: Vector3<f64>,
    /// See above.
    pub rotation_linear_ned_rad: Vector3<f64>,
}

impl StripError {
    /// The error of a line.
    pub(crate) fn new(seed: u64, line: &FlightLine, errors: &TrajectoryErrors) -> Self {
        let mut random = Random::new(seed, &[5, u64::from(line.number)]);
        let mut vector = |sd: f64| Vector3::new(random.normal(), random.normal(), random.normal()) * sd;
        Self {
            strip: line.number,
            middle_s: 0.5 * (line.span_s.0 + line.span_s.1),
            half_s: 0.5 * (line.span_s.1 - line.span_s.0),
            position_constant_ned_m: vector(errors.position_constant_sd_m),
            position_linear_ned_m: vector(errors.position_linear_sd_m),
            rotation_constant_ned_rad: vector(errors.attitude_constant_sd_deg.to_radians()),
            rotation_linear_ned_rad: vector(errors.attitude_linear_sd_deg.to_radians()),
        }
    }

    fn u(&self, time_s: f64) -> f64 {
        (time_s - self.middle_s) / self.half_s
    }

    /// Delivered minus true position, north, east, down \[m\], at a time \[s of week\].
    #[must_use]
    pub fn position_ned_m(&self, time_s: f64) -> Vector3<f64> {
        self.position_constant_ned_m + self.position_linear_ned_m * self.u(time_s)
    }

    /// Rotation vector ψ about north, east, down \[rad\] at a time \[s of week\]: `C_delivered = exp([ψ]×) C_true`.
    #[must_use]
    pub fn rotation_ned_rad(&self, time_s: f64) -> Vector3<f64> {
        self.rotation_constant_ned_rad + self.rotation_linear_ned_rad * self.u(time_s)
    }

    /// The delivered pose of a true one.
    pub(crate) fn apply(&self, time_s: f64, pose: &LinePose) -> LinePose {
        let ned = self.position_ned_m(time_s);
        LinePose {
            position_m: pose.position_m + Vector3::new(ned.y, ned.x, -ned.z),
            ned_from_body: UnitQuaternion::from_scaled_axis(self.rotation_ned_rad(time_s)) * pose.ned_from_body,
        }
    }
}

/// The truth about a survey.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// One per scanner, by channel.
    pub scanners: Vec<ScannerTruth>,
    /// One per strip, by number.
    pub strips: Vec<StripError>,
}
