//! Variance components: how accurate ties really are, from how they fit.
//!
//! The sigma of a patch counts its points as independent above a floor; what points of a scanner have in common, and what a
//! surface is not, differ from drive to drive. With the smoothed residual e of a sighting, its variance of measurement R and
//! redundancy r, `Σ eᵀ R⁻¹ e / Σ r` estimates the factor of the variance (Förstner, *Ein Verfahren zur Schätzung von Varianz- und
//! Kovarianzkomponenten*, AVN 86 (1979) 446–453), for level, steep, and far steep surfaces, increments and loops apart.

use nalgebra::Matrix3;
use tieline_filter::TieFit;

use super::choose::Chosen;
use super::ties::{DriveLine, End};
use crate::project::SurfaceWord;

/// Kinds of ties that have a factor of their own: increments and loops, of level surfaces, of steep ones, and of steep ones far away, where few
/// points stand for much wall.
pub const KINDS: [&str; 6] = [
    "increments, level",
    "increments, steep",
    "increments, steep and far",
    "loops, level",
    "loops, steep",
    "loops, steep and far",
];
/// From here on a wall is far \[m\].
const FAR_M: f64 = 20.0;
/// Least sum of redundancies that a factor is estimated from.
const LEAST_REDUNDANCY: f64 = 30.0;
/// Factors of the variance that are believed.
const BELIEVED: std::ops::RangeInclusive<f64> = 0.04..=25.0;
/// A change of the sigmas below this share is none.
const SETTLED: f64 = 0.1;

/// Factors of the variances, by kind.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Factors(pub [f64; KINDS.len()]);

impl Default for Factors {
    fn default() -> Self {
        Self([1.0; KINDS.len()])
    }
}

/// Kind of a line.
fn kind(line: &DriveLine) -> usize {
    let is_far = line.ends.iter().any(|e| e.range_m > FAR_M);
    let surface = match SurfaceWord::of(line.normal_up) {
        SurfaceWord::Level => 0,
        SurfaceWord::Steep => 1 + usize::from(is_far),
    };
    3 * usize::from(line.visits() > 1) + surface
}

impl Factors {
    /// Gives the ends of lines their variances: those measured times the factors, whatever they had before.
    pub fn apply(&self, lines: &mut [DriveLine]) {
        for line in lines {
            let factor = self.0[kind(line)];
            let covariance = |e: &End| Matrix3::from_diagonal_element(e.measured_variance_m2 * factor);
            line.ends.iter_mut().for_each(|e| e.sighting.covariance_m2 = covariance(e));
        }
    }

    /// The factors after a solution that was made with these.
    #[must_use]
    pub fn after(&self, fits: &[TieFit], lines: &[DriveLine], chosen: &Chosen) -> Self {
        let mut sums = [(0.0, 0.0); KINDS.len()];
        for fit in fits {
            let (squared, redundancy) = &mut sums[kind(&lines[chosen.of[fit.tie][0].0])];
            *squared += fit.squared;
            *redundancy += fit.redundancy;
        }
        Self(std::array::from_fn(|k| {
            let (squared, redundancy) = sums[k];
            if redundancy < LEAST_REDUNDANCY {
                return self.0[k];
            }
            (self.0[k] * squared / redundancy).clamp(*BELIEVED.start(), *BELIEVED.end())
        }))
    }

    /// Whether others are so near that another solution would be the same.
    #[must_use]
    pub fn is_near(&self, other: &Self) -> bool {
        self.0.iter().zip(&other.0).all(|(a, b)| ((a / b).sqrt() - 1.0).abs() < SETTLED)
    }

    /// What there is to say.
    #[must_use]
    pub fn note(&self) -> Option<String> {
        let changed = KINDS.iter().zip(self.0).filter(|(_, f)| (f - 1.0).abs() > 1e-9);
        let words: Vec<String> = changed.map(|(kind, f)| format!("{kind} {:.2}", f.sqrt())).collect();
        (!words.is_empty())
            .then(|| format!("sigmas of ties, as they turned out over as measured: {}", words.join("; ")))
    }
}
