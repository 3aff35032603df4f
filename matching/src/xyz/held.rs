//! Directions that the geometry holds.

use nalgebra::{DMatrix, DVector};

/// The directions in which two clouds are tied, and how well.
#[derive(Debug, Clone, PartialEq)]
pub struct Held {
    /// Orthonormal directions of the held subspace, best held first: columns over the unknowns.
    pub directions: DMatrix<f64>,
    /// Sigma along each \[m\].
    pub sigma_m: DVector<f64>,
}

impl Held {
    /// Number of directions held.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.sigma_m.len()
    }

    /// Covariance on the held subspace \[m²\], over all unknowns: zero across the directions that are not held, which
    /// are not known to be right but not told at all.
    #[must_use]
    pub fn covariance_m2(&self) -> DMatrix<f64> {
        let squares = DMatrix::from_diagonal(&self.sigma_m.map(|s| s * s));
        &self.directions * squares * self.directions.transpose()
    }

    /// eᵀΣ⁻¹e of an error \[m\] on the held subspace: averages the rank when the sigmas are right.
    #[must_use]
    pub fn normalised_square(&self, error_m: &DVector<f64>) -> f64 {
        (self.directions.transpose() * error_m).component_div(&self.sigma_m).norm_squared()
    }
}
