//! Which terms of a calibration the data ask for.
//!
//! A term is needed when its values, of all scanners together, differ from nothing by more than chance: `vᵀ Σ⁻¹ v` against χ². Terms that are not
//! needed are fixed at their nominal values, and what is known of the others gets better. What the data cannot see
//! at all keeps its standard deviation beforehand; such a term is never needed.

use std::collections::BTreeMap;

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

/// Judges the terms of an estimate, the least needed first: a term that is not needed is fixed before the others are judged, for terms that go
/// together (a boresight and a range bias, where ground is seen from one side) may each be done without, and not both.
#[must_use]
pub fn judge(constants: &Constants, estimate: &CalibrationEstimate) -> Vec<Verdict> {
    let n = estimate.value.len();
    let all = DMatrix::from_row_slice(n, n, &estimate.covariance);
    // of all scanners at once: to fix one and turn the other would turn the vehicle
    let rows = |term: Term| -> Vec<usize> {
        constants.groups.iter().filter(|g| g.term == term).flat_map(Group::constants).collect()
    };
    let mut left = Left { value: DVector::from_column_slice(&estimate.value), covariance: all.clone() };
    let mut open: Vec<Term> = Term::ALL.into_iter().filter(|term| !rows(*term).is_empty()).collect();
    let mut fixed: BTreeMap<Term, f64> = BTreeMap::new();
    let ratios: BTreeMap<Term, f64> = loop {
        let ratios: BTreeMap<Term, f64> = open.iter().map(|term| (*term, left.ratio(&rows(*term)))).collect();
        let least = ratios.iter().min_by(|a, b| a.1.total_cmp(b.1)).filter(|(_, ratio)| **ratio <= 1.0);
        let Some((&term, &ratio)) = least else { break ratios };
        fixed.insert(term, ratio);
        open.retain(|t| *t != term);
        left = left.fixed(&rows(term));
    };
    constants
        .groups
        .iter()
        .map(|group| {
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
            let of_fixed = fixed.get(&group.term).copied();
            let ratio = of_fixed.or_else(|| ratios.get(&group.term).copied()).unwrap_or(f64::INFINITY);
            Verdict { scanner: group.scanner, term: group.term, needed: of_fixed.is_none(), ratio, not_seen }
        })
        .collect()
}

/// An estimate whose terms are fixed one after the other.
struct Left {
    value: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Left {
    /// `vᵀ Σ⁻¹ v` of some constants over its limit.
    fn ratio(&self, rows: &[usize]) -> f64 {
        let value = self.value.select_rows(rows);
        let covariance = self.covariance.select_rows(rows).select_columns(rows);
        let squared = covariance.cholesky().map_or(f64::INFINITY, |c| value.dot(&c.solve(&value)));
        squared / chi_squared_limit(rows.len(), FALSE_ALARM)
    }

    /// The estimate with some constants D at nothing: `v - Σ_D Σ_DD⁻¹ v_D`, `Σ - Σ_D Σ_DD⁻¹ Σ_Dᵀ`.
    fn fixed(self, rows: &[usize]) -> Self {
        let across = self.covariance.select_columns(rows);
        let Some(own) = across.select_rows(rows).cholesky() else { return self };
        let value = &self.value - &across * own.solve(&self.value.select_rows(rows));
        let covariance = &self.covariance - &across * own.solve(&across.transpose());
        let covariance = (&covariance + covariance.transpose()) * 0.5;
        Self { value, covariance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::project::parse_str;

    /// Latency and lever arm of one scanner: four constants.
    fn constants() -> Constants {
        let project = parse_str(
            "[[strips]]\npath = \"*.laz\"\n[imu]\npath = \"imu.txt\"\ngrade = \"ap60\"\n[platform]\n[[platform.scanner]]\nid = 0\n",
        )
        .expect("a project");
        let constants =
            Constants::new(&project, &[], &[(2.0, 20.0)], &[], |_, t| matches!(t, Term::Latency | Term::LeverArm));
        assert_eq!(constants.count(), 4);
        constants
    }

    /// An estimate in which the latency and the first component of the lever arm go together by `correlation`.
    fn estimate(constants: &Constants, over_sigma: [f64; 4], correlation: f64) -> CalibrationEstimate {
        let (latency, arm) =
            (constants.first(0, Term::Latency).expect("there"), constants.first(0, Term::LeverArm).expect("there"));
        let sigma = [1e-5, 1e-3, 1e-3, 1e-3];
        let rows = [latency, arm, arm + 1, arm + 2];
        let (mut value, mut covariance) = (vec![0.0; 4], vec![0.0; 16]);
        for (k, row) in rows.into_iter().enumerate() {
            value[row] = over_sigma[k] * sigma[k];
            covariance[row * 5] = sigma[k].powi(2);
        }
        covariance[latency * 4 + arm] = correlation * sigma[0] * sigma[1];
        covariance[arm * 4 + latency] = correlation * sigma[0] * sigma[1];
        CalibrationEstimate { value, covariance }
    }

    fn needed(correlation: f64, over_sigma: [f64; 4]) -> (bool, bool) {
        let constants = constants();
        let verdicts = judge(&constants, &estimate(&constants, over_sigma, correlation));
        let of = |term: Term| verdicts.iter().find(|v| v.term == term).expect("judged");
        for v in &verdicts {
            assert_eq!(v.needed, v.ratio > 1.0, "{v:?}");
        }
        (of(Term::Latency).needed, of(Term::LeverArm).needed)
    }

    #[test]
    fn terms_are_needed_when_they_differ_from_nothing_by_more_than_chance() {
        assert_eq!(needed(0.0, [1.0, 1.0, 1.0, 1.0]), (false, false));
        assert_eq!(needed(0.0, [6.0, 1.0, 1.0, 1.0]), (true, false));
        assert_eq!(needed(0.0, [1.0, 1.0, 9.0, 1.0]), (false, true));
        assert_eq!(needed(0.0, [6.0, 9.0, 0.0, 0.0]), (true, true));
    }

    #[test]
    fn of_two_terms_that_go_together_one_stays() {
        // each differs from nothing by two sigmas, both together by far more: (2² + 2² + 2·0.98·4) / (1 - 0.98²) ≈ 400
        assert_eq!(needed(-0.98, [2.0, 2.0, 0.0, 0.0]), (true, false));
    }
}
