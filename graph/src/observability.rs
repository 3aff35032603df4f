//! What the geometry cannot separate: found before anything is estimated, named, and held by its prior.

use nalgebra::{DMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};

use crate::model::{Parameter, ParameterBlock};

/// A combination of unknowns that the ties do not determine better than the prior does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unobservable {
    /// Information of the ties over that of the prior (below 1).
    pub information: f64,
    /// The unknowns that dominate it, with their share (signed; squares sum to 1 over all unknowns).
    pub members: Vec<(usize, f64)>,
}

/// How well each unknown is observed, and what is not.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Observability {
    /// For each unknown: 1 - (sigma after / sigma before)²: 0 is held by its prior, 1 is free of it.
    pub share: Vec<f64>,
    /// Combinations held by the prior, least observed first.
    pub unobservable: Vec<Unobservable>,
    /// Ratio of the largest to the smallest eigenvalue of ties and prior together.
    pub condition: f64,
}

/// Below this share an unknown counts as held by its prior.
pub const OBSERVABLE_SHARE: f64 = 0.5;
/// Above this many unknowns only the calibration is analysed for combinations.
const MOST_FOR_EIGENVECTORS: usize = 420;

impl Observability {
    /// Analyses the inverse normal matrix (ties and prior) in prior units.
    #[must_use]
    pub fn new(inverse: &DMatrix<f64>, parameters: &[Parameter]) -> Self {
        let n = parameters.len();
        let share = (0..n).map(|i| (1.0 - inverse[(i, i)]).clamp(0.0, 1.0)).collect();
        let subset: Vec<usize> = if n <= MOST_FOR_EIGENVECTORS {
            (0..n).collect()
        } else {
            (0..n).filter(|i| matches!(parameters[*i].block, ParameterBlock::Calibration(_))).collect()
        };
        let m = subset.len();
        if m == 0 {
            return Self { share, unobservable: Vec::new(), condition: 1.0 };
        }
        let part = DMatrix::from_fn(m, m, |i, j| inverse[(subset[i], subset[j])]);
        let eigen = SymmetricEigen::new(part);
        let mut unobservable = Vec::new();
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for k in 0..m {
            let variance = eigen.eigenvalues[k].max(1e-300);
            least = least.min(variance);
            most = most.max(variance);
            let information = (1.0 / variance - 1.0).max(0.0);
            if information < 1.0 {
                let vector = eigen.eigenvectors.column(k);
                let mut members: Vec<(usize, f64)> = subset
                    .iter()
                    .enumerate()
                    .map(|(i, index)| (*index, vector[i]))
                    .filter(|(_, v)| v.abs() > 0.2)
                    .collect();
                members.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
                members.truncate(8);
                if members.first().is_some_and(|(_, v)| *v < 0.0) {
                    members.iter_mut().for_each(|(_, v)| *v = -*v);
                }
                unobservable.push(Unobservable { information, members });
            }
        }
        unobservable.sort_by(|a, b| a.information.total_cmp(&b.information));
        Self { share, unobservable, condition: most / least }
    }

    /// Whether unknown `index` is determined by the ties rather than by its prior.
    #[must_use]
    pub fn is_observable(&self, index: usize) -> bool {
        self.share[index] >= OBSERVABLE_SHARE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_that_is_seen_and_a_difference_that_is_not_are_told_apart() {
        let parameter = |name: &str| Parameter {
            block: ParameterBlock::Calibration(0),
            name: name.to_string(),
            is_angle: false,
            prior_sigma: 1.0,
        };
        // information of 100 on (x0 + x1)/√2, none on the difference
        let normal = DMatrix::from_row_slice(2, 2, &[51.0, 50.0, 50.0, 51.0]);
        let inverse = normal.try_inverse().expect("regular");
        let found = Observability::new(&inverse, &[parameter("lever arm down"), parameter("range offset")]);
        assert_eq!(found.unobservable.len(), 1);
        let members = &found.unobservable[0].members;
        assert!(members[0].1 * members[1].1 < 0.0, "the difference");
        assert!(!found.is_observable(0));
    }
}
