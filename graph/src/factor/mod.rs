//! Factors: what was measured between variables.
//!
//! A type becomes a factor by [`Factor`]: its variables, its whitened residual and the derivatives of it.
//!
//! | module | factors |
//! |---|---|
//! | [`pose2`], [`pose3`] | prior, between, sightings of landmarks, in the plane and in space |
//! | [`motion`] | motion of a vehicle by odometer and drifting gyro |
//! | [`mounted`] | sightings and submap links through the unknown place of the sensor on the vehicle |
//! | [`vector`] | prior, random walk, constant bias, linear row, on variables that are plain numbers |
//! | [`strip_tie`] | surface lines of two strips with spline corrections and calibration |
//! | [`common_surface`] | surface lines of any number of ends, the surface eliminated |
//! | [`terrestrial`] | distance, direction, angle, azimuth, levelled height difference, coordinates |
//! | [`baseline`] | GNSS baselines and clusters of correlated ones |
pub mod baseline;
pub mod check;
pub mod common_surface;
pub mod motion;
pub mod mounted;
pub mod pose2;
pub mod pose3;
pub mod strip_tie;
pub mod terrestrial;
pub mod vector;

use crate::variable::{Values, VariableId};

/// Error convention of relations between poses: how the rigid motion `Z⁻¹ Xᵢ⁻¹ Xⱼ` that is left becomes numbers. The
/// information matrix of a file belongs to one of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Convention {
    /// Its translation; wrapped angle (plane) or rotation vector (space).
    #[default]
    Plain,
    /// Its logarithm.
    Log,
    /// Its translation; angle (plane) or vector part of the unit quaternion (space), as g2o has it.
    G2o,
}

/// Something measured.
pub trait Factor: Send + Sync + std::fmt::Debug + 'static {
    /// The variables it depends on; none twice.
    fn variables(&self) -> &[VariableId];
    /// Number of residuals.
    fn rows(&self) -> usize;
    /// Residuals (computed less measured, times the square root of the information) and, when asked for, their
    /// derivatives by the tangents of the variables: row by row, the variables' columns side by side.
    ///
    /// Both slices come as zeros.
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>);
    /// Whether a robust kernel may weight it down: ties and loop edges, never odometry.
    fn is_tie(&self) -> bool {
        false
    }
    /// What it is, for messages.
    fn label(&self) -> &'static str {
        "factor"
    }
}

/// Upper triangular square root `R` of an information matrix `Ω = Rᵀ R`, row by row.
///
/// # Errors
/// [`NotPositiveDefinite`].
pub fn square_root<const N: usize>(
    information: &nalgebra::SMatrix<f64, N, N>,
) -> Result<nalgebra::SMatrix<f64, N, N>, NotPositiveDefinite>
where
    nalgebra::Const<N>: nalgebra::DimMin<nalgebra::Const<N>, Output = nalgebra::Const<N>>,
{
    let finite = information.iter().all(|v| v.is_finite());
    let root = if finite { nalgebra::Cholesky::new(*information) } else { None };
    root.map(|c| c.l().transpose()).ok_or(NotPositiveDefinite)
}

/// An information matrix that is not positive definite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the information matrix is not positive definite")]
pub struct NotPositiveDefinite;

/// Writes a block of a row-major matrix with `columns` columns.
#[inline]
pub(crate) fn put<const R: usize, const C: usize>(
    jacobian: &mut [f64],
    columns: usize,
    first_column: usize,
    block: &nalgebra::SMatrix<f64, R, C>,
) {
    for r in 0..R {
        for c in 0..C {
            jacobian[r * columns + first_column + c] = block[(r, c)];
        }
    }
}
