//! The adjoint that runs back through the operations of the filter.
//!
//! The backward pass is the modified Bryson-Frazier smoother (Bierman, *Fixed interval smoothing with discrete measurements*,
//! Int. J. Control 18 (1973) 65–75): it inverts innovation covariances only, so that a covariance made singular by a
//! fresh clone, or states that enter and leave, need no special care. With λ and Λ after an operation,
//!
//! ```text
//! smoothed mean = x - P λ        smoothed covariance = P - P Λ P
//! update:       λ ← (I - K H)ᵀ λ - Hᵀ S⁻¹ v        Λ ← (I - K H)ᵀ Λ (I - K H) + Hᵀ S⁻¹ H      (kept as a root)
//! transition:   λ ← Φᵀ λ                            Λ ← Φᵀ Λ Φ
//! ```
//!
//! A landmark enters as a transition whose new row is its first sighting, a clone the same without noise; a state leaves
//! by a transition without its row.

use crate::kalman::UpdateRecord;
use crate::state::{CORE, NAV};
use crate::transition::Transition;

/// The adjoint of the backward pass: λ, and Λ as a root `Λ = Gᵀ G` with as many rows as it takes.
///
/// The root is what makes it hold through outages: there `P` grows to many times the smoothed covariance, and `P Λ P` must
/// agree with `P` to as many digits. Updates of Λ itself lose them by cancellation.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjoint {
    capacity: usize,
    vector: Vec<f64>,
    root: Vec<f64>,
    rows: usize,
}

impl Adjoint {
    /// Zero: nothing is known of the future.
    #[must_use]
    pub fn new(base: usize, slots: usize) -> Self {
        let capacity = base + slots;
        Self { capacity, vector: vec![0.0; capacity], root: Vec::new(), rows: 0 }
    }

    /// λ.
    #[must_use]
    pub fn vector(&self) -> &[f64] {
        &self.vector
    }

    /// The rows of the root over the first `n` states.
    pub fn root_rows(&self, n: usize) -> impl Iterator<Item = &[f64]> {
        self.root.chunks_exact(self.capacity).map(move |row| &row[..n])
    }

    /// Back through an update: `G ← [G (I - K H); S^-½ H]`.
    pub fn back_through_update(&mut self, record: &UpdateRecord) {
        let m = record.rows.len();
        let mut pulls = vec![0.0; m]; // Kᵀ λ + S⁻¹ v
        for (a, (pull, gain)) in pulls.iter_mut().zip(&record.gain).enumerate() {
            *pull = gain.iter().zip(&self.vector).map(|(k, l)| k * l).sum();
            *pull += (0..m).map(|b| record.precision[a * m + b] * record.innovation[b]).sum::<f64>();
        }
        for (row, pull) in record.rows.iter().zip(&pulls) {
            for (k, factor) in row {
                self.vector[*k] -= factor * pull;
            }
        }
        for g in self.root.chunks_exact_mut(self.capacity) {
            for (row, gain) in record.rows.iter().zip(&pulled(g, &record.gain)) {
                for (k, factor) in row {
                    g[*k] -= factor * gain;
                }
            }
        }
        for weights in upper_root(&record.precision, m) {
            let start = self.root.len();
            self.root.resize(start + self.capacity, 0.0);
            for (w, row) in weights.iter().zip(&record.rows) {
                for (k, factor) in row {
                    self.root[start + k] += w * factor;
                }
            }
            self.rows += 1;
        }
        let n = record.gain.first().map_or(0, Vec::len);
        if self.rows >= 2 * n + 8 {
            self.compress();
        }
    }

    /// As few rows as there are states that the root looks at: the triangle of its QR decomposition.
    fn compress(&mut self) {
        let n = self.capacity;
        let used: Vec<usize> = (0..n).filter(|k| self.root.chunks_exact(n).any(|row| row[*k] != 0.0)).collect();
        let dense = nalgebra::DMatrix::from_fn(self.rows, used.len(), |i, j| self.root[i * n + used[j]]);
        let triangle = dense.qr().unpack_r();
        self.rows = triangle.nrows();
        self.root = vec![0.0; self.rows * n];
        for i in 0..self.rows {
            for (j, k) in used.iter().enumerate() {
                self.root[i * n + k] = triangle[(i, j)];
            }
        }
    }

    /// Back through the entry of a state at index `at`.
    pub fn back_through_entry(&mut self, at: usize, row: &[(usize, f64)]) {
        for v in std::iter::once(&mut self.vector[..]).chain(self.root.chunks_exact_mut(self.capacity)) {
            let value = std::mem::take(&mut v[at]);
            for (k, factor) in row {
                v[*k] += factor * value;
            }
        }
    }

    /// Back through a transition of the first `base` states.
    pub fn back_through_transition(&mut self, transition: &Transition, base: usize) {
        for v in std::iter::once(&mut self.vector[..]).chain(self.root.chunks_exact_mut(self.capacity)) {
            if v[..base].iter().all(|x| *x == 0.0) {
                continue; // a row that looks at landmarks only
            }
            let mut moved = [0.0; CORE];
            for (value, row) in v.iter().zip(&transition.nav) {
                if *value != 0.0 {
                    for (o, factor) in moved.iter_mut().zip(row) {
                        *o += value * factor;
                    }
                }
            }
            for (value, d) in v[NAV..base].iter_mut().zip(&transition.decay) {
                *value *= d;
            }
            v[..NAV].copy_from_slice(&moved[..NAV]);
            for (value, o) in v[NAV..CORE].iter_mut().zip(&moved[NAV..]) {
                *value += o;
            }
        }
    }
}

/// `gᵀ K` of a row.
fn pulled(g: &[f64], gain: &[Vec<f64>]) -> Vec<f64> {
    gain.iter().map(|k| dot(k, &g[..k.len()])).collect()
}

/// Rows `W` with `Wᵀ W` a small positive definite matrix.
fn upper_root(matrix: &[f64], m: usize) -> Vec<Vec<f64>> {
    if m == 1 {
        return vec![vec![matrix[0].max(0.0).sqrt()]];
    }
    let full = nalgebra::DMatrix::from_row_slice(m, m, matrix);
    let Some(cholesky) = full.cholesky() else { return Vec::new() };
    let l = cholesky.l();
    (0..m).map(|i| (0..m).map(|j| l[(j, i)]).collect()).collect()
}

/// Smoothed errors of the first `means` states and covariance of the first `wanted`, `x - P λ` and `P - P Λ P`; `rows` are
/// those of the covariance over `n` states, row-major.
#[must_use]
pub fn smoothed(
    rows: &[f64],
    mean: &[f64],
    (n, means, wanted): (usize, usize, usize),
    adjoint: &Adjoint,
) -> (Vec<f64>, Vec<f64>) {
    let row = |i: usize| &rows[i * n..(i + 1) * n];
    let error = (0..means).map(|i| mean[i] - dot(row(i), &adjoint.vector()[..n])).collect();
    let mut covariance = vec![0.0; wanted * wanted];
    for i in 0..wanted {
        covariance[i * wanted..(i + 1) * wanted].copy_from_slice(&row(i)[..wanted]);
    }
    let mut seen = vec![0.0; wanted];
    for g in adjoint.root_rows(n) {
        for (i, s) in seen.iter_mut().enumerate() {
            *s = dot(row(i), g);
        }
        for i in 0..wanted {
            for j in i..wanted {
                covariance[i * wanted + j] -= seen[i] * seen[j];
            }
        }
    }
    for i in 0..wanted {
        for j in 0..i {
            covariance[i * wanted + j] = covariance[j * wanted + i];
        }
    }
    (error, covariance)
}

/// Inner product in four sums, which the processor adds side by side.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (fours_a, fours_b) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = fours_a.remainder().iter().zip(fours_b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in fours_a.zip(fours_b) {
        for k in 0..4 {
            sums[k] += x[k] * y[k];
        }
    }
    sums.iter().sum::<f64>() + rest
}
