//! First-order Gauss-Markov processes.

use nalgebra::Vector3;

use crate::random::Random;

/// Three independent standard normal numbers.
pub(crate) fn normal3(random: &mut Random) -> Vector3<f64> {
    Vector3::new(random.normal(), random.normal(), random.normal())
}

/// Three independent processes of standard deviation one, in their stationary state from the start.
#[derive(Debug, Clone)]
pub(crate) struct Correlated {
    pub(crate) value: Vector3<f64>,
    correlation_s: f64,
}

impl Correlated {
    pub(crate) fn new(random: &mut Random, correlation_s: f64) -> Self {
        Self { value: normal3(random), correlation_s }
    }

    /// Moves on by an interval \[s\].
    pub(crate) fn advance(&mut self, random: &mut Random, interval_s: f64) {
        let factor = (-interval_s / self.correlation_s).exp();
        self.value = self.value * factor + normal3(random) * (1.0 - factor * factor).sqrt();
    }
}
