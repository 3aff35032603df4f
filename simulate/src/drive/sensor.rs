//! A profile scanner as its user believes it to be, and as it is.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};
use tieline_filter::frames::{ned_from_body, rotation_from_vector};

use super::sensor_options::DriveScannerOptions;

/// A profile scanner.
#[derive(Debug, Clone)]
pub struct ProfileScanner {
    /// What the scenario says.
    pub options: DriveScannerOptions,
    /// As believed.
    pub nominal_body_from_scanner: Matrix3<f64>,
    /// As believed \[m\].
    pub nominal_lever_arm_m: Vector3<f64>,
    /// As it is: the boresight on the left of the mounting.
    pub true_body_from_scanner: Matrix3<f64>,
    /// As it is \[m\].
    pub true_lever_arm_m: Vector3<f64>,
}

impl ProfileScanner {
    /// The scanner of its options.
    #[must_use]
    pub fn new(options: &DriveScannerOptions) -> Self {
        let [roll, pitch, yaw] = options.mounting_deg.map(f64::to_radians);
        let mounting = ned_from_body(roll, pitch, yaw).to_rotation_matrix().into_inner();
        let boresight_rad = Vector3::from(options.boresight_error_deg).map(f64::to_radians);
        let nominal_lever_arm_m = Vector3::from(options.lever_arm_m);
        Self {
            nominal_body_from_scanner: mounting,
            nominal_lever_arm_m,
            true_body_from_scanner: rotation_from_vector(&boresight_rad) * mounting,
            true_lever_arm_m: nominal_lever_arm_m + Vector3::from(options.lever_arm_error_m),
            options: options.clone(),
        }
    }

    /// Scan angle \[rad\], -π to π, of the pulse with a stamp counted from the begin of the data \[s\].
    #[must_use]
    pub fn scan_angle_rad(&self, stamp_s: f64) -> f64 {
        let turns = stamp_s * self.options.profile_rate_hz;
        TAU * (turns - turns.floor() - 0.5)
    }

    /// Unit vector of the beam in the scanner's frame: x is the rotation axis.
    #[must_use]
    pub fn beam(scan_angle_rad: f64) -> Vector3<f64> {
        let (sin, cos) = scan_angle_rad.sin_cos();
        Vector3::new(0.0, sin, cos)
    }

    /// What the scanner shows beyond a true range \[m\], without noise: measured minus true.
    #[must_use]
    pub fn bias_m(&self, range_m: f64) -> f64 {
        let options = &self.options;
        let bumps: f64 = options
            .bias_bumps
            .iter()
            .map(|b| b.height_m * (-0.5 * ((range_m - b.range_m) / b.width_m).powi(2)).exp())
            .sum();
        options.bias_offset_m + options.bias_ppm * 1e-6 * range_m + bumps + between(&options.bias_knots_m, range_m)
    }
}

/// Straight lines between knots, level beyond the ends, zero without any.
fn between(knots: &[[f64; 2]], range_m: f64) -> f64 {
    let next = knots.partition_point(|k| k[0] <= range_m);
    match (next.checked_sub(1).and_then(|k| knots.get(k)), knots.get(next)) {
        (Some([a, x]), Some([b, y])) => x + (y - x) * (range_m - a) / (b - a),
        (Some([_, x]), None) | (None, Some([_, x])) => *x,
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::sensor_options::BiasBump;

    #[test]
    fn the_bias_is_the_sum_of_its_parts() {
        let scanner = ProfileScanner::new(&DriveScannerOptions {
            bias_offset_m: 0.003,
            bias_ppm: 50.0,
            bias_bumps: vec![BiasBump { height_m: -0.009, range_m: 7.0, width_m: 1.3 }],
            bias_knots_m: vec![[2.0, 0.0], [10.0, 0.004]],
            ..DriveScannerOptions::default()
        });
        assert!((scanner.bias_m(7.0) - (0.003 + 0.000_35 - 0.009 + 0.0025)).abs() < 1e-12);
        assert!((scanner.bias_m(100.0) - (0.003 + 0.005 + 0.004)).abs() < 1e-12);
    }
}
