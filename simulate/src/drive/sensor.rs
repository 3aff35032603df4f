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

    /// What it shows beyond that at an angle between beam and normal \[deg\] \[m\].
    #[must_use]
    pub fn bias_at_incidence_m(&self, incidence_deg: f64) -> f64 {
        smoothly_between(&self.options.bias_incidence, incidence_deg, |deg| deg)
    }

    /// What it shows beyond that at an intensity as the strips have it \[m\].
    #[must_use]
    pub fn bias_at_intensity_m(&self, intensity: f64) -> f64 {
        smoothly_between(&self.options.bias_intensity, intensity.max(1.0), f64::ln)
    }
}

/// Knots joined by cubics that are level at each, over a scale; level beyond the ends, zero without any.
fn smoothly_between(knots: &[[f64; 2]], at: f64, scale: impl Fn(f64) -> f64) -> f64 {
    let next = knots.partition_point(|k| k[0] <= at);
    match (next.checked_sub(1).and_then(|k| knots.get(k)), knots.get(next)) {
        (Some([a, x]), Some([b, y])) => {
            let t = (scale(at) - scale(*a)) / (scale(*b) - scale(*a));
            x + (y - x) * t * t * (3.0 - 2.0 * t)
        }
        (Some([_, x]), None) | (None, Some([_, x])) => *x,
        (None, None) => 0.0,
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
        assert!(scanner.bias_at_incidence_m(30.0) == 0.0 && scanner.bias_at_intensity_m(0.0) == 0.0, "none was given");
    }

    #[test]
    fn the_bias_over_incidence_and_intensity_goes_smoothly_through_its_knots() {
        let scanner = ProfileScanner::new(&DriveScannerOptions {
            bias_incidence: vec![[0.0, 0.001], [60.0, 0.005]],
            bias_intensity: vec![[100.0, -0.002], [10_000.0, 0.002]],
            ..DriveScannerOptions::default()
        });
        for (deg, bias_m) in [(0.0, 0.001), (30.0, 0.003), (60.0, 0.005), (80.0, 0.005)] {
            assert!((scanner.bias_at_incidence_m(deg) - bias_m).abs() < 1e-12, "{deg}");
        }
        // in the middle of the logarithm
        for (intensity, bias_m) in [(0.0, -0.002), (100.0, -0.002), (1000.0, 0.0), (60_000.0, 0.002)] {
            assert!((scanner.bias_at_intensity_m(intensity) - bias_m).abs() < 1e-12, "{intensity}");
        }
        let slope =
            |deg: f64| (scanner.bias_at_incidence_m(deg + 0.01) - scanner.bias_at_incidence_m(deg - 0.01)) / 0.02;
        assert!(slope(60.0).abs() < 1e-6 && slope(30.0) > 5e-5, "{} {}", slope(60.0), slope(30.0));
    }
}
