//! Loops on the rows of the backward pass.

#![allow(clippy::inline_always)] // the loop has to be compiled within what knows the processor

use pulp::{Arch, Simd, WithSimd};

use crate::kalman::SparseRow;
use crate::lanes::PADDED;
use crate::state::{CORE, NAV};

/// What is done to every row of a backward pass; the lengths of rows are multiples of [`LANES`] and at least [`PADDED`].
#[derive(Debug)]
pub(crate) enum Step {
    /// Back through a measurement.
    Pull(Pull),
    /// Back through the entry of the state at this index, a combination of others.
    TakeOut(usize, SplitRow),
    /// Back through a transition.
    Move(Box<Move>),
}

/// Takes rows of `length` numbers through a step.
pub(crate) fn pass(rows: &mut [f64], length: usize, step: &mut Step) {
    Arch::new().dispatch(Pass { rows, length, step });
}

struct Pass<'a> {
    rows: &'a mut [f64],
    length: usize,
    step: &'a mut Step,
}

impl WithSimd for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let rows = self.rows.chunks_exact_mut(self.length);
        match self.step {
            // loops of a fixed length for what most measurements have
            Step::Pull(pull) => match pull.rows.len() {
                1 => rows.for_each(|g| pull.subtract(simd, g, &mut [0.0; 1])),
                2 => rows.for_each(|g| pull.subtract(simd, g, &mut [0.0; 2])),
                3 => rows.for_each(|g| pull.subtract(simd, g, &mut [0.0; 3])),
                m => rows.for_each(|g| pull.subtract(simd, g, &mut vec![0.0; m])),
            },
            Step::TakeOut(at, row) => rows.for_each(|g| row.take_out(simd, g, *at)),
            Step::Move(transition) => rows.for_each(|g| transition.back(simd, g)),
        }
    }
}

/// Gain `K` and rows `H` of a measurement: `g ← g - (g K) H`.
#[derive(Debug, Clone)]
pub(crate) struct Pull {
    /// Columns of the gain, each filled up with zeros to `length`.
    gain: Vec<f64>,
    length: usize,
    rows: Vec<SplitRow>,
    /// Sum of `(g K)ᵀ (g K)` over the rows that went through, row-major.
    pub information: Vec<f64>,
}

impl Pull {
    /// For rows of up to `length` numbers.
    pub(crate) fn new(gain: &[Vec<f64>], rows: &[SparseRow], length: usize) -> Self {
        let m = rows.len();
        let mut padded = vec![0.0; m * length];
        for (to, from) in padded.chunks_exact_mut(length).zip(gain) {
            to[..from.len()].copy_from_slice(from);
        }
        let rows = rows.iter().map(|row| SplitRow::new(row)).collect();
        Self { gain: padded, length, rows, information: vec![0.0; m * m] }
    }

    #[inline(always)]
    fn subtract<S: Simd>(&mut self, simd: S, g: &mut [f64], pulled: &mut [f64]) {
        for (p, k) in pulled.iter_mut().zip(self.gain.chunks_exact(self.length)) {
            *p = inner_product(simd, &k[..g.len()], g);
        }
        for (p, row) in pulled.iter().zip(&self.rows) {
            row.add_to(simd, -p, g);
        }
        for (p, sums) in pulled.iter().zip(self.information.chunks_exact_mut(pulled.len())) {
            for (q, sum) in pulled.iter().zip(sums) {
                *sum += p * q;
            }
        }
    }
}

/// A sparse row: what it looks at first, where most stands, and behind.
#[derive(Debug, Clone)]
pub(crate) struct SplitRow {
    leading: [f64; PADDED],
    others: SparseRow,
}

impl SplitRow {
    pub(crate) fn new(row: &[(usize, f64)]) -> Self {
        let mut split = Self { leading: [0.0; PADDED], others: SparseRow::new() };
        for (k, factor) in row {
            match split.leading.get_mut(*k) {
                Some(lead) => *lead += factor,
                None => split.others.push((*k, *factor)),
            }
        }
        split
    }

    /// `g ← g + g[at] · row`, `g[at] ← 0`.
    #[inline(always)]
    fn take_out<S: Simd>(&self, simd: S, g: &mut [f64], at: usize) {
        let value = std::mem::take(&mut g[at]);
        if value != 0.0 {
            self.add_to(simd, value, g);
        }
    }

    /// `g ← g + factor · row`.
    #[inline(always)]
    fn add_to<S: Simd>(&self, simd: S, factor: f64, g: &mut [f64]) {
        let (first, _) = S::as_mut_simd_f64s(&mut g[..PADDED]);
        let times = simd.splat_f64s(factor);
        for (to, lead) in first.iter_mut().zip(S::as_simd_f64s(&self.leading).0) {
            *to = simd.mul_add_e_f64s(times, *lead, *to);
        }
        for (k, other) in &self.others {
            g[*k] += factor * other;
        }
    }
}

/// A transition `Φ`: `g ← Φᵀ g`.
#[derive(Debug)]
pub(crate) struct Move {
    /// Full rows of Φ.
    nav: [[f64; PADDED]; NAV],
    /// Its diagonal behind them: factors of what stays where it is.
    kept: [f64; PADDED],
    /// The same, further behind.
    others: Vec<f64>,
}

impl Move {
    /// Of `nav`, the full rows, and `decay`, the diagonal behind them.
    pub(crate) fn new(nav: &[[f64; CORE]; NAV], decay: &[f64]) -> Self {
        let mut padded = [[0.0; PADDED]; NAV];
        for (to, from) in padded.iter_mut().zip(nav) {
            to[..CORE].copy_from_slice(from);
        }
        let mut kept = [1.0; PADDED];
        kept[..NAV].fill(0.0);
        for (to, d) in kept[NAV..].iter_mut().zip(decay) {
            *to = *d;
        }
        Self { nav: padded, kept, others: decay.get(PADDED - NAV..).unwrap_or_default().to_vec() }
    }

    #[inline(always)]
    fn back<S: Simd>(&self, simd: S, g: &mut [f64]) {
        let (first, behind) = g.split_at_mut(PADDED);
        let factors: [f64; NAV] = std::array::from_fn(|k| first[k]);
        let kept = S::as_simd_f64s(&self.kept).0;
        for (at, (value, kept)) in S::as_mut_simd_f64s(first).0.iter_mut().zip(kept).enumerate() {
            let mut sum = simd.mul_f64s(*value, *kept);
            for (factor, row) in factors.iter().zip(&self.nav) {
                sum = simd.mul_add_e_f64s(simd.splat_f64s(*factor), S::as_simd_f64s(row).0[at], sum);
            }
            *value = sum;
        }
        for (value, d) in behind.iter_mut().zip(&self.others) {
            *value *= d;
        }
    }
}

/// Inner product over the shorter of two.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    Arch::new().dispatch(Dot(a, b))
}

struct Dot<'a>(&'a [f64], &'a [f64]);

impl WithSimd for Dot<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        inner_product(simd, self.0, self.1)
    }
}

#[inline(always)]
fn inner_product<S: Simd>(simd: S, a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, a_rest) = S::as_simd_f64s(&a[..n]);
    let (b, b_rest) = S::as_simd_f64s(&b[..n]);
    let mut sums = [simd.splat_f64s(0.0); 4];
    let (a_fours, a_last) = a.as_chunks::<4>();
    let (b_fours, b_last) = b.as_chunks::<4>();
    for (x, y) in a_fours.iter().zip(b_fours) {
        for k in 0..4 {
            sums[k] = simd.mul_add_e_f64s(x[k], y[k], sums[k]);
        }
    }
    for (x, y) in a_last.iter().zip(b_last) {
        sums[0] = simd.mul_add_e_f64s(*x, *y, sums[0]);
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    let sum = simd.add_f64s(simd.add_f64s(sums[0], sums[1]), simd.add_f64s(sums[2], sums[3]));
    simd.reduce_sum_f64s(sum) + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::numbers::{numbers, transition};

    #[test]
    fn rows_lose_what_a_measurement_knows() {
        let (length, count) = (32, 4);
        let sparse = [vec![(2, 0.5), (26, -1.5)], vec![(0, 2.0), (2, 1.0)]];
        for states in [45, 28] {
            let gain = [numbers(states), numbers(2 * states)[states..].to_vec()];
            let before = numbers(length * count);
            let mut after = before.clone();
            let mut step = Step::Pull(Pull::new(&gain, &sparse, 48));
            pass(&mut after, length, &mut step);
            let Step::Pull(Pull { information, .. }) = &step else { panic!("a pull") };
            let mut expected = [0.0; 4];
            for (g, a) in before.chunks(length).zip(after.chunks(length)) {
                let pulled = gain.each_ref().map(|k| g.iter().zip(k).map(|(x, y)| x * y).sum::<f64>());
                for k in 0..4 {
                    expected[k] += pulled[k / 2] * pulled[k % 2];
                }
                for k in 0..length {
                    let factor = |row: &SparseRow| row.iter().filter(|s| s.0 == k).map(|s| s.1).sum::<f64>();
                    let taken: f64 = sparse.iter().zip(pulled).map(|(row, p)| factor(row) * p).sum();
                    assert!((a[k] - (g[k] - taken)).abs() < 1e-13);
                }
            }
            assert!(information.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12));
        }
    }

    #[test]
    fn a_state_is_taken_out() {
        let (length, at, row) = (32, 29, [(2, 0.5), (26, -1.5), (30, 2.0)]);
        let before = numbers(3 * length);
        let mut after = before.clone();
        pass(&mut after, length, &mut Step::TakeOut(at, SplitRow::new(&row)));
        for (g, a) in before.chunks(length).zip(after.chunks(length)) {
            for k in 0..length {
                let factor: f64 = row.iter().filter(|e| e.0 == k).map(|e| e.1).sum();
                let expected = if k == at { 0.0 } else { g[k] + factor * g[at] };
                assert!((a[k] - expected).abs() < 1e-14, "{k}");
            }
        }
    }

    #[test]
    fn transitions_move_rows_back() {
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
        let mut back = before.clone();
        pass(&mut back, stride, &mut Step::Move(Box::new(Move::new(&nav, &decay))));
        for (g, moved) in before.chunks(stride).zip(back.chunks(stride)) {
            for j in 0..stride {
                let expected = if j < base { (0..base).map(|i| full(i, j) * g[i]).sum() } else { g[j] };
                assert!((moved[j] - expected).abs() < 1e-13);
            }
        }
    }
}
