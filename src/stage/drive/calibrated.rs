//! A calibration as it is told to others: what was estimated, of which constants, over which ranges.

use tieline_filter::CalibrationEstimate;

use super::constants::{Constants, Term};
use super::need::Verdict;

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
        let n = estimate.value.len();
        let mut variance = 0.0;
        if let Some(first) = constants.first(scanner, Term::Range) {
            let (knot, weights) = constants.splines[scanner].weights(range_m);
            for (a, wa) in weights.iter().enumerate() {
                for (b, wb) in weights.iter().enumerate() {
                    variance += wa * wb * estimate.covariance[(first + knot + a) * n + first + knot + b];
                }
            }
        }
        Some((-value, variance.max(0.0).sqrt()))
    }
}
