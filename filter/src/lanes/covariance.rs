//! Loops on a covariance.

#![allow(clippy::inline_always)] // the loop has to be compiled within what knows the processor

use pulp::{Arch, Simd, WithSimd};

use crate::state::{CORE, NAV};

/// `P += Σ (k hᵀ + h kᵀ)` on the rows that a covariance keeps: those before `base` whole, of the others the columns from
/// `base` to the diagonal. Rows stand `stride` apart.
pub(crate) fn add_symmetric(covariance: &mut [f64], stride: usize, base: usize, pairs: &[(&[f64], &[f64])]) {
    // three at one time: the covariance goes through the processor once for the three components of a position
    for pairs in pairs.chunks(3) {
        match *pairs {
            [a, b, c] => Arch::new().dispatch(AddSymmetric { covariance, stride, base, pairs: [a, b, c] }),
            [a, b] => Arch::new().dispatch(AddSymmetric { covariance, stride, base, pairs: [a, b] }),
            [a] => Arch::new().dispatch(AddSymmetric { covariance, stride, base, pairs: [a] }),
            _ => {}
        }
    }
}

struct AddSymmetric<'a, const M: usize> {
    covariance: &'a mut [f64],
    stride: usize,
    base: usize,
    pairs: [(&'a [f64], &'a [f64]); M],
}

impl<const M: usize> WithSimd for AddSymmetric<'_, M> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let n = self.pairs[0].0.len();
        for (i, row) in self.covariance.chunks_exact_mut(self.stride).take(n).enumerate() {
            let (from, to) = if i < self.base { (0, n) } else { (self.base, i + 1) };
            let factors = self.pairs.map(|(k, h)| (simd.splat_f64s(k[i]), simd.splat_f64s(h[i])));
            let columns = self.pairs.map(|(k, h)| (S::as_simd_f64s(&k[from..to]), S::as_simd_f64s(&h[from..to])));
            let (p, p_rest) = S::as_mut_simd_f64s(&mut row[from..to]);
            for (at, p) in p.iter_mut().enumerate() {
                for ((ki, hi), ((k, _), (h, _))) in factors.iter().zip(&columns) {
                    *p = simd.mul_add_e_f64s(*ki, h[at], simd.mul_add_e_f64s(*hi, k[at], *p));
                }
            }
            for (at, p) in p_rest.iter_mut().enumerate() {
                for ((k, h), ((_, k_rest), (_, h_rest))) in self.pairs.iter().zip(&columns) {
                    *p += k[i] * h_rest[at] + h[i] * k_rest[at];
                }
            }
        }
    }
}

/// `P ← Φ P` on columns `from..to` of the rows before `base`, which stand `stride` apart.
pub(crate) fn move_columns(
    covariance: &mut [f64],
    (stride, from, to): (usize, usize, usize),
    nav: &[[f64; CORE]; NAV],
    decay: &[f64],
) {
    Arch::new().dispatch(MoveColumns { covariance, stride, from, to, nav, decay });
}

struct MoveColumns<'a> {
    covariance: &'a mut [f64],
    stride: usize,
    from: usize,
    to: usize,
    nav: &'a [[f64; CORE]; NAV],
    decay: &'a [f64],
}

impl WithSimd for MoveColumns<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { covariance, stride, from, to, nav, decay } = self;
        let (core, behind) = covariance.split_at_mut(CORE * stride);
        let mut rows = core.chunks_exact_mut(stride);
        let mut rows: [(&mut [S::f64s], &mut [f64]); CORE] =
            std::array::from_fn(|_| S::as_mut_simd_f64s(&mut rows.next().unwrap_or_default()[from..to]));
        for at in 0..rows[0].0.len() {
            let mut moved = [simd.splat_f64s(0.0); NAV];
            for (k, (row, _)) in rows.iter_mut().enumerate() {
                for (sum, of) in moved.iter_mut().zip(nav) {
                    *sum = simd.mul_add_e_f64s(simd.splat_f64s(of[k]), row[at], *sum);
                }
                if k >= NAV {
                    row[at] = simd.mul_f64s(row[at], simd.splat_f64s(decay[k - NAV]));
                }
            }
            for ((row, _), sum) in rows.iter_mut().zip(moved) {
                row[at] = sum;
            }
        }
        for at in 0..rows[0].1.len() {
            let before: [f64; CORE] = std::array::from_fn(|k| rows[k].1[at]);
            for (k, (_, row)) in rows.iter_mut().enumerate() {
                row[at] = match nav.get(k) {
                    Some(of) => of.iter().zip(&before).map(|(a, b)| a * b).sum(),
                    None => before[k] * decay[k - NAV],
                };
            }
        }
        for (row, d) in behind.chunks_exact_mut(stride).zip(&decay[CORE - NAV..]) {
            for p in &mut row[from..to] {
                *p *= d;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::numbers::{numbers, transition};

    #[test]
    fn a_covariance_is_changed_where_it_is_kept() {
        let (n, stride, base) = (13, 17, 5);
        let all = numbers(10 * n);
        let pairs: Vec<(&[f64], &[f64])> = all.chunks(2 * n).map(|both| both.split_at(n)).collect();
        let before = numbers(stride * stride);
        for m in 1..=pairs.len() {
            let mut after = before.clone();
            add_symmetric(&mut after, stride, base, &pairs[..m]);
            for i in 0..stride {
                for j in 0..stride {
                    let kept = i < n && if i < base { j < n } else { j >= base && j <= i };
                    let change = || pairs[..m].iter().map(|(k, h)| k[i] * h[j] + h[i] * k[j]).sum::<f64>();
                    let expected = before[i * stride + j] + if kept { change() } else { 0.0 };
                    assert!((after[i * stride + j] - expected).abs() < 1e-13, "{m} {i} {j}");
                }
            }
        }
    }

    #[test]
    fn transitions_move_columns() {
        let (base, stride) = (CORE + 4, 40);
        let (nav, decay) = (transition(), numbers(base - NAV));
        let full = |i: usize, j: usize| -> f64 {
            if i < NAV {
                if j < CORE { nav[i][j] } else { 0.0 }
            } else if i == j {
                decay[i - NAV]
            } else {
                0.0
            }
        };
        let before = numbers(stride * base);
        let mut forth = before.clone();
        move_columns(&mut forth, (stride, base, stride - 2), &nav, &decay);
        for j in 0..stride {
            for i in 0..base {
                let moves = j >= base && j < stride - 2;
                let expected: f64 = if moves {
                    (0..base).map(|k| full(i, k) * before[k * stride + j]).sum()
                } else {
                    before[i * stride + j]
                };
                assert!((forth[i * stride + j] - expected).abs() < 1e-13, "{i} {j}");
            }
        }
    }
}
