//! Beams of a scanner over time.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};
use tieline_filter::frames::{ned_from_body, rotation_from_vector};

use crate::scenario::{ScannerKind, ScannerOptions};
use crate::truth::ScannerTruth;

/// A scanner as its user believes it to be, and as it is.
#[derive(Debug, Clone)]
pub struct Scanner {
    /// What the scenario says.
    pub options: ScannerOptions,
    /// As believed: `R(b) R0`.
    pub nominal_body_from_scanner: Matrix3<f64>,
    /// As believed \[m\].
    pub nominal_lever_arm_m: Vector3<f64>,
    /// As it is: `R(b) R0`.
    pub true_body_from_scanner: Matrix3<f64>,
    /// What is true.
    pub truth: ScannerTruth,
}

impl Scanner {
    /// The scanner of its options.
    #[must_use]
    pub fn new(options: &ScannerOptions) -> Self {
        let degrees = |v: [f64; 3]| Vector3::from(v).map(f64::to_radians);
        let [roll, pitch, yaw]: [f64; 3] = degrees(options.mounting_deg).into();
        let mounting = ned_from_body(roll, pitch, yaw).to_rotation_matrix().into_inner();
        let nominal_rad = degrees(options.boresight_deg);
        let truth = ScannerTruth {
            boresight_rad: nominal_rad + degrees(options.boresight_error_deg),
            boresight_error_rad: degrees(options.boresight_error_deg),
            lever_arm_m: Vector3::from(options.lever_arm_m) + Vector3::from(options.lever_arm_error_m),
            lever_arm_error_m: Vector3::from(options.lever_arm_error_m),
            range_offset_m: options.range_offset_m,
            range_scale: options.range_scale_ppm * 1e-6,
        };
        Self {
            options: options.clone(),
            nominal_body_from_scanner: rotation_from_vector(&nominal_rad) * mounting,
            nominal_lever_arm_m: Vector3::from(options.lever_arm_m),
            true_body_from_scanner: rotation_from_vector(&truth.boresight_rad) * mounting,
            truth,
        }
    }

    /// Scan angle \[rad\] at a time \[s since the begin of the line\], positive to the right.
    #[must_use]
    pub fn scan_angle_rad(&self, time_s: f64) -> f64 {
        let half = 0.5 * self.options.field_of_view_deg.to_radians();
        let turns = time_s * self.options.line_rate_hz;
        match self.options.kind {
            ScannerKind::Rotating => half * (2.0 * (turns - turns.floor()) - 1.0),
            ScannerKind::Oscillating => half * (TAU * turns).sin(),
        }
    }

    /// Unit vector of the beam in the scanner's frame: x is the rotation axis.
    #[must_use]
    pub fn beam(scan_angle_rad: f64) -> Vector3<f64> {
        let (sin, cos) = scan_angle_rad.sin_cos();
        Vector3::new(0.0, sin, cos)
    }

    /// The range \[m\] that the scanner shows for a true one, without noise: the inverse of true = rho + f(rho).
    #[must_use]
    pub fn measured_range_m(&self, true_range_m: f64) -> f64 {
        (true_range_m - self.truth.range_offset_m) / (1.0 + self.truth.range_scale)
    }
}
