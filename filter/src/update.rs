//! Measurements: what each predicts, and how that depends on the errors.
//!
//! Every function gives residuals (measured minus predicted), sparse rows over the error state and the covariance.

pub mod gnss;
pub mod standstill;
pub mod tie;
pub mod vehicle;

use nalgebra::{Matrix3, Vector3};

use crate::kalman::SparseRow;

/// What the platform does at the moment of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Rotation of the body against north-east-down, body axes \[rad/s\].
    pub rate_body_radps: Vector3<f64>,
    /// Acceleration, north-east-down \[m/s²\].
    pub acceleration_ned_mps2: Vector3<f64>,
}

/// Adds the entries of a row of a 3 × 3 block.
fn put(row: &mut SparseRow, at: usize, block: &Matrix3<f64>, i: usize) {
    for j in 0..3 {
        if block[(i, j)] != 0.0 {
            row.push((at + j, block[(i, j)]));
        }
    }
}

/// Row-major values of a 3 × 3 matrix.
fn row_major(m: &Matrix3<f64>) -> Vec<f64> {
    (0..9).map(|k| m[(k / 3, k % 3)]).collect()
}
