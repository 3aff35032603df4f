//! Range correction of a scanner as a cubic B-spline over the logarithm of the range.
//!
//! A scanner's range error changes most where ranges are short, and there most of the points lie: knots are evenly spaced
//! in ln ρ. Corrections over something else ([`super::over`]) are splines with knots evenly spaced on a scale of their own.

/// A cubic B-spline over ranges; its coefficients are kept apart.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RangeSpline {
    first_ln: f64,
    spacing_ln: f64,
    intervals: usize,
}

/// Coefficients that act at one range: the number of the first, and four weights.
pub type Weights = (usize, [f64; 4]);

impl RangeSpline {
    /// A spline from `near_m` to `far_m` with knots about `spacing_ln` apart in ln ρ.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    pub fn new(near_m: f64, far_m: f64, spacing_ln: f64) -> Self {
        let length = (far_m / near_m).ln().max(spacing_ln);
        let intervals = (length / spacing_ln).ceil().max(1.0) as usize;
        Self { first_ln: near_m.ln(), spacing_ln: length / intervals as f64, intervals }
    }

    /// The spline from `first_m` to `last_m` that has so many coefficients; none where there is no such spline.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn of_coefficients(first_m: f64, last_m: f64, coefficients: usize) -> Option<Self> {
        let intervals = coefficients.checked_sub(3).filter(|n| *n > 0)?;
        let is_span = first_m > 0.0 && last_m > first_m && last_m.is_finite();
        let spacing_ln = (last_m / first_m).ln() / intervals as f64;
        is_span.then(|| Self { first_ln: first_m.ln(), spacing_ln, intervals })
    }

    /// Its ends \[m\].
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn span_m(&self) -> (f64, f64) {
        (self.first_ln.exp(), (self.first_ln + self.spacing_ln * self.intervals as f64).exp())
    }

    /// Number of coefficients.
    #[must_use]
    pub fn coefficients(&self) -> usize {
        self.intervals + 3
    }

    /// The logarithm of the range \[m\] that a coefficient stands for most.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn centre_ln(&self, coefficient: usize) -> f64 {
        self.first_ln + (coefficient as f64 - 1.0) * self.spacing_ln
    }

    /// Coefficients and weights at a range \[m\], held beyond the ends.
    #[must_use]
    pub fn weights(&self, range_m: f64) -> Weights {
        cubic((range_m.max(1e-3).ln() - self.first_ln) / self.spacing_ln, self.intervals)
    }

    /// Value at a range \[m\].
    #[must_use]
    #[inline]
    pub fn at(&self, coefficients: &[f64], range_m: f64) -> f64 {
        let (first, weights) = self.weights(range_m);
        weights.iter().zip(&coefficients[first..first + 4]).map(|(w, c)| w * c).sum()
    }
}

/// Coefficients and weights at a place counted in intervals from the first knot, held beyond the ends.
#[inline]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
fn cubic(x: f64, intervals: usize) -> Weights {
    let x = x.clamp(0.0, intervals as f64);
    let interval = (x as usize).min(intervals - 1);
    let t = x - interval as f64;
    let s = 1.0 - t;
    let weights = [
        s * s * s / 6.0,
        (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
        (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0,
        t * t * t / 6.0,
    ];
    (interval, weights)
}

/// A cubic B-spline with knots evenly spaced on a scale; its coefficients are kept apart.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Spline {
    first: f64,
    spacing: f64,
    intervals: usize,
}

impl Spline {
    /// A spline from `first` to `last` with knots about `spacing` apart.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    pub fn new(first: f64, last: f64, spacing: f64) -> Self {
        let length = (last - first).max(spacing);
        let intervals = (length / spacing).ceil().max(1.0) as usize;
        Self { first, spacing: length / intervals as f64, intervals }
    }

    /// The spline from `first` to `last` that has so many coefficients; none where there is no such spline.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn of_coefficients(first: f64, last: f64, coefficients: usize) -> Option<Self> {
        let intervals = coefficients.checked_sub(3).filter(|n| *n > 0)?;
        let spacing = (last - first) / intervals as f64;
        (first.is_finite() && spacing > 0.0 && spacing.is_finite()).then_some(Self { first, spacing, intervals })
    }

    /// Its ends.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn span(&self) -> (f64, f64) {
        (self.first, self.first + self.spacing * self.intervals as f64)
    }

    /// Number of coefficients.
    #[must_use]
    pub fn coefficients(&self) -> usize {
        self.intervals + 3
    }

    /// The place that a coefficient stands for most.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn centre(&self, coefficient: usize) -> f64 {
        self.first + (coefficient as f64 - 1.0) * self.spacing
    }

    /// Coefficients and weights at a place, held beyond the ends.
    #[must_use]
    #[inline]
    pub fn weights(&self, at: f64) -> Weights {
        cubic((at - self.first) / self.spacing, self.intervals)
    }

    /// Value at a place.
    #[must_use]
    #[inline]
    pub fn at(&self, coefficients: &[f64], at: f64) -> f64 {
        let (first, weights) = self.weights(at);
        weights.iter().zip(&coefficients[first..first + 4]).map(|(w, c)| w * c).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_follow_a_line_in_the_logarithm() {
        let spline = RangeSpline::new(1.5, 60.0, 0.25);
        let line: Vec<f64> = (0..spline.coefficients()).map(|k| spline.centre_ln(k)).collect();
        for range_m in [1.5_f64, 2.0, 7.3, 33.0, 60.0] {
            assert!((spline.weights(range_m).1.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            assert!((spline.at(&line, range_m) - range_m.ln()).abs() < 1e-12);
        }
        assert!((spline.at(&line, 200.0) - 60.0_f64.ln()).abs() < 1e-12, "held beyond the end");
        let (first_m, last_m) = spline.span_m();
        let again = RangeSpline::of_coefficients(first_m, last_m, line.len()).expect("a span");
        assert!((again.at(&line, 7.3) - spline.at(&line, 7.3)).abs() < 1e-12);
    }
}
