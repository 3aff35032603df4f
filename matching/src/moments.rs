//! Moments of points in whole numbers: sums whose order does not matter.
//!
//! Coordinates are counted in steps of 2⁻¹⁴ m (0.06 mm) from the corner of a cell, so that all sums fit `i64`
//! and are exact. Any order, any number of threads and any number of partial sums give the same bits.

use bytemuck::{Pod, Zeroable};

/// Steps in a metre.
pub(crate) const STEPS_PER_METRE: f64 = 16_384.0;
/// Ticks of the time sum in a second.
pub(crate) const TICKS_PER_SECOND: f64 = 1_048_576.0;

/// Sums over the points of one cell: count, first and second moments, time and intensity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Moments {
    /// Σ x, y, z \[steps\].
    pub s: [i64; 3],
    /// Σ xx, xy, xz, yy, yz, zz \[steps²\].
    pub ss: [i64; 6],
    /// Σ time since the start of the time bin \[ticks\].
    pub time: i64,
    /// Σ intensity.
    pub intensity: i64,
    /// Number of points.
    pub n: i64,
}

impl Moments {
    /// Adds one point: coordinates in steps from the corner, time in ticks from the start of its bin.
    #[inline]
    pub fn add(&mut self, [x, y, z]: [i64; 3], time: i64, intensity: i64) {
        self.s[0] += x;
        self.s[1] += y;
        self.s[2] += z;
        self.ss[0] += x * x;
        self.ss[1] += x * y;
        self.ss[2] += x * z;
        self.ss[3] += y * y;
        self.ss[4] += y * z;
        self.ss[5] += z * z;
        self.time += time;
        self.intensity += intensity;
        self.n += 1;
    }

    /// Adds moments that are counted from the same corner and time bin.
    pub fn merge(&mut self, other: &Self) {
        for (a, b) in self.s.iter_mut().zip(other.s) {
            *a += b;
        }
        for (a, b) in self.ss.iter_mut().zip(other.ss) {
            *a += b;
        }
        self.time += other.time;
        self.intensity += other.intensity;
        self.n += other.n;
    }

    /// The same points counted from a corner that lies `d` steps *before* the present one, and from a time bin
    /// that starts `ticks` earlier.
    #[must_use]
    pub fn shifted(&self, d: [i64; 3], ticks: i64) -> Self {
        let n = self.n;
        let [x, y, z] = self.s;
        let [a, b, c] = d;
        Self {
            s: [x + n * a, y + n * b, z + n * c],
            ss: [
                self.ss[0] + 2 * a * x + n * a * a,
                self.ss[1] + a * y + b * x + n * a * b,
                self.ss[2] + a * z + c * x + n * a * c,
                self.ss[3] + 2 * b * y + n * b * b,
                self.ss[4] + b * z + c * y + n * b * c,
                self.ss[5] + 2 * c * z + n * c * c,
            ],
            time: self.time + n * ticks,
            intensity: self.intensity,
            n,
        }
    }

    /// Mean from the corner \[m\].
    #[must_use]
    #[allow(clippy::cast_precision_loss)] // sums stay far below 2⁵³
    pub fn mean_m(&self) -> [f64; 3] {
        let scale = 1.0 / (self.n.max(1) as f64 * STEPS_PER_METRE);
        self.s.map(|v| v as f64 * scale)
    }

    /// Covariance about the mean \[m²\], xx, xy, xz, yy, yz, zz, with divisor n.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn covariance_m2(&self) -> [f64; 6] {
        let n = i128::from(self.n.max(1));
        let scale = 1.0 / (self.n.max(1) as f64 * STEPS_PER_METRE).powi(2);
        let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        let mut covariance = [0.0; 6];
        for (k, (i, j)) in pairs.into_iter().enumerate() {
            // exact in whole numbers: n Σxy - Σx Σy
            let exact = n * i128::from(self.ss[k]) - i128::from(self.s[i]) * i128::from(self.s[j]);
            covariance[k] = exact as f64 * scale;
        }
        covariance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(points: &[[i64; 3]]) -> Moments {
        let mut m = Moments::default();
        for p in points {
            m.add(*p, p[0], p[1]);
        }
        m
    }

    proptest! {
        #[test]
        fn the_order_of_points_and_partial_sums_does_not_matter(
            points in prop::collection::vec(prop::array::uniform3(0_i64..40_000), 1..60), cut in 0_usize..60)
        {
            let cut = cut.min(points.len());
            let mut parts = of(&points[cut..]);
            parts.merge(&of(&points[..cut]));
            prop_assert_eq!(parts, of(&points));
        }

        #[test]
        fn a_shifted_corner_is_the_same_as_shifted_points(
            points in prop::collection::vec(prop::array::uniform3(0_i64..40_000), 1..40), d in prop::array::uniform3(-70_000_i64..70_000))
        {
            let moved: Vec<_> = points.iter().map(|p| [p[0] + d[0], p[1] + d[1], p[2] + d[2]]).collect();
            let shifted = of(&points).shifted(d, 0);
            prop_assert_eq!(shifted.s, of(&moved).s);
            prop_assert_eq!(shifted.ss, of(&moved).ss);
        }
    }

    #[test]
    fn mean_and_covariance_of_three_points_are_those_of_the_textbook() {
        let m = of(&[[0, 0, 0], [16_384, 0, 0], [0, 16_384, 16_384]]);
        assert!(m.mean_m().iter().all(|v| (v - 1.0 / 3.0).abs() < 1e-15));
        let c = m.covariance_m2();
        assert!(
            (c[0] - 2.0 / 9.0).abs() < 1e-15 && (c[1] + 1.0 / 9.0).abs() < 1e-15 && (c[4] - 2.0 / 9.0).abs() < 1e-15
        );
    }
}
