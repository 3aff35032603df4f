//! Which terms of a calibration the data ask for.
//!
//! A term is needed when its values together differ from nothing by more than chance: `vᵀ Σ⁻¹ v` against χ². Terms that are not
//! needed are fixed at their nominal values, and what is known of the others gets better. What the data cannot see
//! at all keeps its standard deviation beforehand; such a term is never needed.

use nalgebra::{DMatrix, DVector};
use tieline_filter::CalibrationEstimate;
use tieline_filter::innovation::chi_squared_limit;

use super::constants::{Constants, Term};

/// Probability that a term is taken in though there is nothing.
const FALSE_ALARM: f64 = 0.001;
/// A direction is not seen when its standard deviation is still this share of the one beforehand.
const NOT_SEEN: f64 = 0.7;

/// What is to be said of a term.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// Term.
    pub term: Term,
    /// Whether it is estimated.
    pub needed: bool,
    /// `vᵀ Σ⁻¹ v` over its limit.
    pub ratio: f64,
    /// Directions of it that the data do not see.
    pub not_seen: usize,
}

/// Judges the terms of an estimate.
#[must_use]
pub fn judge(constants: &Constants, estimate: &CalibrationEstimate) -> Vec<Verdict> {
    let n = estimate.value.len();
    let all = DMatrix::from_row_slice(n, n, &estimate.covariance);
    constants
        .groups
        .iter()
        .map(|group| {
            let count = group.prior.nrows();
            let covariance = all.view((group.first, group.first), (count, count)).into_owned();
            let value = DVector::from_column_slice(&estimate.value[group.first..group.first + count]);
            let squared = covariance.clone().cholesky().map_or(f64::INFINITY, |c| value.dot(&c.solve(&value)));
            let ratio = squared / chi_squared_limit(count, FALSE_ALARM);
            // variances relative to those beforehand, along the directions that belong together
            let not_seen = group.prior.clone().cholesky().map_or(0, |prior| {
                let root = prior.l();
                let half = root.solve_lower_triangular(&covariance).unwrap_or_else(|| covariance.clone());
                let whole = root.solve_lower_triangular(&half.transpose()).unwrap_or_else(|| half.clone());
                let values = (&whole + whole.transpose()).scale(0.5).symmetric_eigenvalues();
                values.iter().filter(|v| v.max(0.0).sqrt() > NOT_SEEN).count()
            });
            Verdict { scanner: group.scanner, term: group.term, needed: ratio > 1.0, ratio, not_seen }
        })
        .collect()
}
