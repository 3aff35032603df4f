//! Innovations: how well each measurement fits what the filter expected, and how much it was trusted.

use crate::kalman::{Gaussian, Measurement, Singular, UpdateRecord, invert};

/// What a measurement was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MeasurementKind {
    /// GNSS position.
    Position,
    /// GNSS velocity.
    Velocity,
    /// Odometer.
    Odometer,
    /// Non-holonomic constraint.
    Constraint,
    /// Zero velocity at rest.
    ZeroVelocity,
    /// Zero rotation at rest.
    ZeroRotation,
    /// A known point.
    KnownPoint,
    /// A tie.
    Tie,
}

impl MeasurementKind {
    /// The word used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Odometer => "odometer",
            Self::Constraint => "constraint",
            Self::ZeroVelocity => "zero_velocity",
            Self::ZeroRotation => "zero_rotation",
            Self::KnownPoint => "known_point",
            Self::Tie => "tie",
        }
    }
}

/// An innovation of the forward pass.
#[derive(Debug, Clone, PartialEq)]
pub struct Innovation {
    /// Survey time \[s\].
    pub time_s: f64,
    /// What was measured.
    pub kind: MeasurementKind,
    /// Measured minus expected, in the measurement's own unit.
    pub value: Vec<f64>,
    /// The same over its expected standard deviation: standard normal when the filter is right.
    pub normalised: Vec<f64>,
    /// Square of the whole innovation in the metric of its covariance: chi-squared with as many degrees of freedom as
    /// it has components.
    pub squared: f64,
    /// Factor on the weight: 1 trusted, below 1 down-weighted, 0 left out.
    pub weight: f64,
    /// Of a tie: its row among those given, and that of the sighting.
    pub sighting: Option<(usize, usize)>,
}

/// Beyond this many times its limit a measurement is left out.
const LEFT_OUT: f64 = 25.0;
/// So many measurements of a kind left out in a row are taken for the truth: the filter has lost its way.
pub(crate) const LOST_AFTER: usize = 30;

/// Chi-squared that is exceeded with a probability, by Wilson and Hilferty (1931). `probability` is small.
#[must_use]
#[allow(clippy::cast_precision_loss)]
pub fn chi_squared_limit(degrees: usize, probability: f64) -> f64 {
    let n = degrees.max(1) as f64;
    let z = normal_quantile(probability);
    let c = 2.0 / (9.0 * n);
    n * (1.0 - c + z * c.sqrt()).powi(3)
}

/// What a standard normal variable exceeds with a (small) probability, by Abramowitz and Stegun 26.2.23.
fn normal_quantile(probability: f64) -> f64 {
    let t = (-2.0 * probability.clamp(1e-300, 0.5).ln()).sqrt();
    t - (2.515_517 + 0.802_853 * t + 0.010_328 * t * t)
        / (1.0 + 1.432_788 * t + 0.189_269 * t * t + 0.001_308 * t.powi(3))
}

/// Tests a measurement and takes it in, down-weighted where it does not fit: its noise grows until the innovation sits on
/// the limit. `forced` takes it in as it is.
///
/// # Errors
/// [`Singular`] when an innovation has no variance.
pub(crate) fn take_in(
    gaussian: &mut Gaussian,
    measurement: Measurement,
    (time_s, kind): (f64, MeasurementKind),
    false_alarm: f64,
    forced: bool,
) -> Result<(Innovation, Option<UpdateRecord>), Singular> {
    let m = measurement.rows.len();
    let (value, mut spread, columns) = gaussian.predict(&measurement);
    let squared_with = |precision: &[f64]| (0..m * m).map(|k| value[k / m] * precision[k] * value[k % m]).sum::<f64>();
    let mut precision = invert(&spread, m)?;
    let squared = squared_with(&precision);
    let normalised = (0..m).map(|k| value[k] / spread[k * m + k].sqrt()).collect();
    let limit = chi_squared_limit(m, false_alarm);
    let mut weight = 1.0;
    if !forced && squared > limit {
        // that the platform rests is right or wrong, not more or less accurate
        let all_or_nothing = matches!(kind, MeasurementKind::ZeroVelocity | MeasurementKind::ZeroRotation);
        if !squared.is_finite() || squared > LEFT_OUT * limit || all_or_nothing {
            weight = 0.0;
        } else {
            // noise · factor puts the innovation onto the limit
            let mut factor = 1.0;
            let mut wider = spread.clone();
            for _ in 0..60 {
                factor *= 1.3;
                for ((w, s), r) in wider.iter_mut().zip(&spread).zip(&measurement.noise) {
                    *w = s + (factor - 1.0) * r;
                }
                precision = invert(&wider, m)?;
                if squared_with(&precision) <= limit {
                    break;
                }
            }
            spread = wider;
            weight = 1.0 / factor;
        }
    }
    let predicted = (value.clone(), spread, columns);
    let record = (weight > 0.0).then(|| gaussian.update_with(measurement.rows, predicted, precision));
    Ok((Innovation { time_s, kind, value, normalised, squared, weight, sighting: None }, record))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_those_of_the_tables() {
        for (degrees, probability, table) in
            [(1, 0.05, 3.841), (3, 0.01, 11.345), (3, 0.001, 16.266), (6, 0.05, 12.592)]
        {
            let limit = chi_squared_limit(degrees, probability);
            assert!((limit / table - 1.0).abs() < 0.03, "{degrees} {probability}: {limit} and {table}");
        }
    }
}
