//! Which terms of a calibration the data ask for.
//!
//! A term is needed when its values, of all scanners together, differ from nothing by more than chance: `vᵀ Σ⁻¹ v` against χ². Terms that are not
//! needed are fixed at their nominal values, and what is known of the others gets better. What the data cannot see
//! at all keeps its standard deviation beforehand; such a term is never needed.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use tieline_filter::CalibrationEstimate;
use tieline_filter::innovation::chi_squared_limit;

use super::constants::{Constants, Group, Term};

/// Probability that a term is taken in though there is nothing.
const FALSE_ALARM: f64 = 0.001;
/// A direction is not seen when its standard deviation is still this share of the one beforehand.
const NOT_SEEN: f64 = 0.7;

/// What is to be said of a term.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// Term.
    pub term: Term,
    /// Whether it is estimated.
    pub needed: bool,
    /// `vᵀ Σ⁻¹ v` of the term over its limit.
    #[serde(deserialize_with = "crate::report::nullable::number")]
    pub ratio: f64,
    /// Directions of it that the data do not see.
    pub not_seen: usize,
}

/// Judges the terms of an estimate.
#[must_use]
pub fn judge(constants: &Constants, estimate: &CalibrationEstimate) -> Vec<Verdict> {
    let n = estimate.value.len();
    let all = DMatrix::from_row_slice(n, n, &estimate.covariance);
    let ratio_of = |rows: &[usize]| {
        let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| all[(rows[i], rows[j])]);
        let value = DVector::from_iterator(rows.len(), rows.iter().map(|k| estimate.value[*k]));
        let squared = covariance.cholesky().map_or(f64::INFINITY, |c| value.dot(&c.solve(&value)));
        squared / chi_squared_limit(rows.len(), FALSE_ALARM)
    };
    constants
        .groups
        .iter()
        .map(|group| {
            // of all scanners at once: to fix one and turn the other would turn the vehicle
            let rows: Vec<usize> =
                constants.groups.iter().filter(|g| g.term == group.term).flat_map(Group::constants).collect();
            let ratio = ratio_of(&rows);
            let own: Vec<usize> = group.constants().collect();
            let covariance = DMatrix::from_fn(own.len(), own.len(), |i, j| all[(own[i], own[j])]);
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
