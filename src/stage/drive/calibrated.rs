//! A calibration as it is told to others: what was estimated, of which constants, over which ranges.

use tieline_filter::CalibrationEstimate;

use super::constants::{Constants, Term};
use super::curve::Weights;
use super::need::Verdict;
use super::seen::OverSpline;

/// Constants with their estimate, of one drive or of several.
#[derive(Debug, Clone, Copy)]
pub struct Calibrated<'a> {
    /// The constants.
    pub constants: &'a Constants,
    /// Their values and covariance.
    pub estimate: &'a CalibrationEstimate,
    /// Nearest and farthest range of each scanner that curves are told for \[m\].
    pub ranges_m: &'a [(f64, f64)],
    /// Which terms the data ask for.
    pub verdicts: &'a [Verdict],
}

impl Calibrated<'_> {
    /// Range bias of a scanner at a range and its standard deviation \[m\]: measured less true, the correction with its sign changed. What
    /// is known has no standard deviation.
    #[must_use]
    pub fn bias_at(&self, scanner: usize, range_m: f64) -> Option<(f64, f64)> {
        let Self { constants, estimate, .. } = self;
        let curves = constants.range_curves(scanner, &estimate.value);
        if curves.is_empty() {
            return None;
        }
        let value: f64 = curves.iter().map(|(spline, coefficients)| spline.at(coefficients, range_m)).sum();
        let weights = || constants.splines[scanner].weights(range_m);
        let sigma_m = constants.first(scanner, Term::Range).map_or(0.0, |first| self.sigma_m(first, weights()));
        Some((-value, sigma_m))
    }

    /// The same of what a correction is over, at a place of its scale.
    #[must_use]
    pub fn bias_over(&self, own: &OverSpline, place: f64) -> Option<(f64, f64)> {
        let Self { constants, estimate, .. } = self;
        let curves = constants.over_curves(own.scanner, &estimate.value);
        let mut curves = curves.iter().filter(|c| c.over == own.over).peekable();
        curves.peek()?;
        let value: f64 = curves.map(|c| c.spline.at(&c.coefficients_m, place)).sum();
        let first = constants.first(own.scanner, own.over.term());
        Some((-value, first.map_or(0.0, |first| self.sigma_m(first, own.spline.weights(place)))))
    }

    /// Standard deviation of a curve whose coefficients begin at a constant \[m\].
    fn sigma_m(&self, first: usize, (knot, weights): Weights) -> f64 {
        let n = self.estimate.value.len();
        let mut variance = 0.0;
        for (a, wa) in weights.iter().enumerate() {
            for (b, wb) in weights.iter().enumerate() {
                variance += wa * wb * self.estimate.covariance[(first + knot + a) * n + first + knot + b];
            }
        }
        variance.max(0.0).sqrt()
    }
}
