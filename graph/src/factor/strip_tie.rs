//! A surface line between two strips whose corrections are cubic splines, with the calibration they share.
//!
//! The end of a strip at time t lies at `p + δp(t) + exp(ψ(t)) C (exp(b) l + a)`; position and rotation corrections
//! are sums of four knots each, boresight `b` and lever arm `a` are common to all strips.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::Factor;
use crate::rotation::cross;
use crate::variable::{Values, VariableId};

/// One end of a tie.
#[derive(Debug, Clone, Copy)]
pub struct StripEnd {
    /// First of four knots in a row: position, rotation correction (6 numbers each).
    pub first_knot: VariableId,
    /// Values of the spline's four functions.
    pub weights: [f64; 4],
    /// Heading of the strip \[rad\]: `C` turns body to map about the vertical.
    pub heading_rad: f64,
    /// The surface from the sensor, in the body \[m\].
    pub body_m: Vector3<f64>,
}

/// A surface line of two strips.
#[derive(Debug, Clone)]
pub struct StripTie {
    ids: [VariableId; 9],
    ends: [StripEnd; 2],
    normal: Vector3<f64>,
    /// Offset along the normal as measured with uncorrected strips \[m\].
    offset_m: f64,
    weight: f64,
}

impl StripTie {
    /// `offset_m`: first end less second end along the normal before corrections.
    #[must_use]
    pub fn new(
        ends: [StripEnd; 2],
        calibration: VariableId,
        normal: Vector3<f64>,
        offset_m: f64,
        sigma_m: f64,
    ) -> Self {
        let mut ids = [calibration; 9];
        for (e, end) in ends.iter().enumerate() {
            for k in 0..4_u32 {
                ids[4 * e + k as usize] = VariableId(end.first_knot.0 + k);
            }
        }
        Self { ids, ends, normal, offset_m, weight: 1.0 / sigma_m }
    }
}

/// `exp(v)` and the left Jacobian of small rotations.
fn exponential(v: &Vector3<f64>) -> (Matrix3<f64>, Matrix3<f64>) {
    let k = cross(v);
    let square = k * k;
    // corrections are far below a tenth of a radian: the next term is v⁴ / 120
    let left = Matrix3::identity() + 0.5 * k + square / 6.0 + square * k / 24.0;
    (*Rotation3::from_scaled_axis(*v).matrix(), left)
}

impl Factor for StripTie {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        1
    }
    fn is_tie(&self) -> bool {
        true
    }
    fn label(&self) -> &'static str {
        "surface line of strips"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], mut jacobian: Option<&mut [f64]>) {
        let calibration = values.get(self.ids[8]);
        let boresight = Vector3::new(calibration[0], calibration[1], calibration[2]);
        let lever = Vector3::new(calibration[3], calibration[4], calibration[5]);
        let (turned, boresight_left) = exponential(&boresight);
        let n = self.normal.transpose() * self.weight;
        let mut sum = self.weight * self.offset_m;
        for (e, (end, sign)) in self.ends.iter().zip([1.0, -1.0]).enumerate() {
            let (mut position, mut rotation) = (Vector3::zeros(), Vector3::zeros());
            for (k, w) in end.weights.iter().enumerate() {
                let knot = values.get(self.ids[4 * e + k]);
                position += *w * Vector3::new(knot[0], knot[1], knot[2]);
                rotation += *w * Vector3::new(knot[3], knot[4], knot[5]);
            }
            let c = *Rotation3::from_axis_angle(&Vector3::z_axis(), end.heading_rad).matrix();
            let body = turned * end.body_m;
            let (psi, psi_left) = exponential(&rotation);
            let beam = psi * c * (body + lever);
            sum += sign * (n * (position + beam - c * end.body_m))[0];
            if let Some(jacobian) = jacobian.as_deref_mut() {
                let by_rotation = -(n * cross(&beam) * psi_left) * sign;
                for (k, w) in end.weights.iter().enumerate() {
                    let start = 24 * e + 6 * k;
                    for i in 0..3 {
                        jacobian[start + i] = sign * w * n[i];
                        jacobian[start + 3 + i] = w * by_rotation[i];
                    }
                }
                let to_map = n * (psi * c) * sign;
                let by_boresight = -(to_map * cross(&body) * boresight_left);
                for i in 0..3 {
                    jacobian[48 + i] += by_boresight[i];
                    jacobian[51 + i] += to_map[i];
                }
            }
        }
        residual[0] = sum;
    }
}
