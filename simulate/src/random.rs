//! Random numbers that depend on a seed and a place only: the same for any number of threads, on any machine.

/// A stream of random numbers: splitmix64 (Steele, Lea, Flood, *Fast splittable pseudorandom number generators*, 2014).
#[derive(Debug, Clone)]
pub(crate) struct Random {
    state: u64,
    spare: Option<f64>,
}

/// Scrambles a number.
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Random {
    /// The stream of a seed and a place, for instance `[STRIP, strip, scanner, block]`.
    pub(crate) fn new(seed: u64, place: &[u64]) -> Self {
        let state = place.iter().fold(mix(seed ^ 0x9e37_79b9_7f4a_7c15), |state, p| {
            mix(state.wrapping_add(p.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15)))
        });
        Self { state, spare: None }
    }

    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.state)
    }

    /// Uniform in `0..1`.
    #[allow(clippy::cast_precision_loss)] // 53 bits fit
    pub(crate) fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// Uniform between two bounds.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// A whole number in `0..count`.
    pub(crate) fn below(&mut self, count: u64) -> u64 {
        self.next() % count.max(1)
    }

    /// Normal with mean 0 and standard deviation 1: Marsaglia's polar method.
    pub(crate) fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        loop {
            let (u, v) = (self.between(-1.0, 1.0), self.between(-1.0, 1.0));
            let s = u * u + v * v;
            if s > 0.0 && s < 1.0 {
                let factor = (-2.0 * s.ln() / s).sqrt();
                self.spare = Some(v * factor);
                return u * factor;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_mean_zero_and_variance_one() {
        let mut random = Random::new(1, &[2, 3]);
        let n = 200_000;
        let numbers: Vec<f64> = (0..n).map(|_| random.normal()).collect();
        let mean = numbers.iter().sum::<f64>() / f64::from(n);
        let variance = numbers.iter().map(|x| x * x).sum::<f64>() / f64::from(n);
        let beyond = numbers.iter().filter(|x| x.abs() > 1.959_964).count();
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
        assert!((9_500..10_500).contains(&beyond), "5 % beyond 1.96: {beyond}");
    }

    #[test]
    fn neighbouring_places_have_unrelated_streams_and_the_same_place_the_same() {
        let first = |place: &[u64]| Random::new(7, place).uniform();
        assert!((first(&[1, 2]) - first(&[1, 2])).abs() < f64::MIN_POSITIVE);
        let n = 20_000_u32;
        let product: f64 =
            (0..n).map(|i| (first(&[0, u64::from(i)]) - 0.5) * (first(&[0, u64::from(i) + 1]) - 0.5)).sum();
        assert!((product / f64::from(n)).abs() < 0.002, "correlation of neighbours");
    }
}
