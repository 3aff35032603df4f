//! What tests of clouds share.

use tieline_matching::mix;

/// Numbers that look random, the same on every machine.
pub(crate) struct Draws(pub u64);

impl Draws {
    /// Uniform in 0 to 1.
    #[allow(clippy::cast_precision_loss)]
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(1);
        (mix(self.0.wrapping_mul(0x9e37_79b9_7f4a_7c15)) >> 11) as f64 / 9_007_199_254_740_992.0
    }
    /// Normal with sigma 1 (Box and Muller).
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}
