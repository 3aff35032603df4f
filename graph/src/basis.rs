//! Corrections over time: constant, linear, or a cubic spline with a chosen spacing of knots.

use serde::{Deserialize, Serialize};

/// How a correction may change over a strip.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TimeModel {
    /// One number.
    Constant,
    /// Two: middle of the strip, and half the change from its start to its end.
    Linear,
    /// A uniform cubic B-spline.
    Spline {
        /// Spacing of knots \[s\].
        knot_spacing_s: f64,
    },
}

/// The functions of time that a correction is a sum of, over one strip.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Basis {
    model: TimeModel,
    start_s: f64,
    end_s: f64,
    intervals: usize,
}

impl Basis {
    /// The basis of a model over a strip from `start_s` to `end_s`. A spline has at least one interval.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // rounded, positive, bounded
    pub fn new(model: TimeModel, start_s: f64, end_s: f64) -> Self {
        let end_s = end_s.max(start_s + 1e-3);
        let intervals = match model {
            TimeModel::Spline { knot_spacing_s } => {
                ((end_s - start_s) / knot_spacing_s.max(1e-3)).round().clamp(1.0, 10_000.0) as usize
            }
            _ => 0,
        };
        Self { model, start_s, end_s, intervals }
    }

    /// Number of coefficients.
    #[must_use]
    pub fn count(&self) -> usize {
        match self.model {
            TimeModel::Constant => 1,
            TimeModel::Linear => 2,
            TimeModel::Spline { .. } => self.intervals + 3,
        }
    }

    /// The functions that do not vanish at a time: index of the first, and their values.
    ///
    /// Times outside the strip are taken to its ends.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    pub fn at(&self, time_s: f64) -> (usize, [f64; 4], usize) {
        let u = ((time_s - self.start_s) / (self.end_s - self.start_s)).clamp(0.0, 1.0);
        match self.model {
            TimeModel::Constant => (0, [1.0, 0.0, 0.0, 0.0], 1),
            TimeModel::Linear => (0, [1.0, 2.0 * u - 1.0, 0.0, 0.0], 2),
            TimeModel::Spline { .. } => {
                let x = u * self.intervals as f64;
                let first = (x.floor() as usize).min(self.intervals - 1);
                let t = x - first as f64;
                let (t2, t3) = (t * t, t * t * t);
                let w = [
                    (1.0 - t).powi(3) / 6.0,
                    (3.0 * t3 - 6.0 * t2 + 4.0) / 6.0,
                    (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0) / 6.0,
                    t3 / 6.0,
                ];
                (first, w, 4)
            }
        }
    }

    /// The model.
    #[must_use]
    pub fn model(&self) -> TimeModel {
        self.model
    }

    /// What a coefficient is called in a table.
    #[must_use]
    pub fn coefficient_name(&self, index: usize) -> String {
        match (self.model, index) {
            (TimeModel::Constant, _) | (TimeModel::Linear, 0) => String::from("constant"),
            (TimeModel::Linear, _) => String::from("drift"),
            (TimeModel::Spline { .. }, i) => format!("knot {i}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_functions_of_a_spline_sum_to_one_everywhere() {
        let basis = Basis::new(TimeModel::Spline { knot_spacing_s: 2.0 }, 10.0, 25.0);
        for k in 0..=150 {
            let (first, w, n) = basis.at(10.0 + 0.1 * f64::from(k));
            assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            assert!(first + n <= basis.count());
        }
    }

    #[test]
    fn a_linear_correction_runs_from_minus_one_to_one() {
        let basis = Basis::new(TimeModel::Linear, 0.0, 4.0);
        assert!((basis.at(0.0).1[1] + 1.0).abs() < 1e-15 && (basis.at(4.0).1[1] - 1.0).abs() < 1e-15);
        assert!((basis.at(9.0).1[1] - 1.0).abs() < 1e-15, "constant beyond the end");
    }

    #[test]
    fn a_strip_of_one_moment_has_a_basis() {
        for model in [TimeModel::Constant, TimeModel::Linear, TimeModel::Spline { knot_spacing_s: 1.0 }] {
            assert!(Basis::new(model, 5.0, 5.0).at(5.0).1.iter().all(|w| w.is_finite()));
        }
    }
}
