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

use nalgebra::{DMatrix, DMatrixView, DMatrixViewMut, SMatrix};

use crate::kalman::{Slots, UpdateRecord};
use crate::state::{CORE, NAV};
use crate::transition::Transition;

/// The adjoint of the backward pass: λ, and Λ as a root `Λ = Gᵀ G` with as many rows as it takes.
///
/// The root is what makes it hold through outages: there `P` grows to many times the smoothed covariance, and `P Λ P` must
/// agree with `P` to as many digits. Updates of Λ itself lose them by cancellation.
///
/// Most of what is measured looks at the filter's own states and at clones that live for a moment. Its rows are short and
/// stay so; only the rows that look at landmarks kept for long have them all as columns. An orthogonal turn of all rows
/// leaves Λ as it is: it is how a measurement of a landmark is kept from lengthening every row.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjoint {
    /// States of a short row: the filter's own and the brief slots.
    short: usize,
    vector: Vec<f64>,
    narrow: Rows,
    wide: Rows,
    /// Long rows from which on they are shortened.
    most_wide: usize,
    scratch: Vec<f64>,
}

/// Rows of equal length, one after the other.
#[derive(Debug, Clone, PartialEq)]
struct Rows {
    length: usize,
    values: Vec<f64>,
}

impl Rows {
    fn count(&self) -> usize {
        self.values.len() / self.length
    }

    fn iter_mut(&mut self) -> impl Iterator<Item = &mut [f64]> {
        self.values.chunks_exact_mut(self.length)
    }

    /// Columns in use among some.
    fn used(&self, columns: std::ops::Range<usize>) -> Vec<usize> {
        let mut largest = vec![0.0_f64; self.length];
        for row in self.values.chunks_exact(self.length) {
            for (l, v) in largest.iter_mut().zip(row) {
                *l = l.max(v.abs());
            }
        }
        columns.filter(|k| largest[*k] > 0.0).collect()
    }

    /// `g ← g - (g K) H` of every row `g`, whose `(g K)ᵀ (g K)` is added to `information`.
    fn subtract(&mut self, record: &UpdateRecord, information: &mut [f64]) {
        if let ([row], [gain]) = (&record.rows[..], &record.gain[..]) {
            for g in self.iter_mut() {
                let pulled = dot(gain, g);
                information[0] += pulled * pulled;
                for (k, factor) in row {
                    g[*k] -= factor * pulled;
                }
            }
            return;
        }
        let m = record.gain.len();
        let states = record.gain.first().map_or(0, Vec::len).min(self.length);
        let (count, length) = (self.count(), self.length);
        // rows of zeros: products of fewer than six rows are not done by blocks
        let gain = DMatrix::from_fn(m.max(6), states, |a, k| if a < m { record.gain[a][k] } else { 0.0 });
        let pulled = gain * DMatrixView::from_slice(&self.values, length, count).rows(0, states);
        for (g, pulled) in self.iter_mut().zip(pulled.column_iter()) {
            for (a, row) in record.rows.iter().enumerate() {
                for (k, factor) in row {
                    g[*k] -= factor * pulled[a];
                }
                for b in 0..m {
                    information[a * m + b] += pulled[a] * pulled[b];
                }
            }
        }
    }

    /// Adds a row of which only some columns are not zero.
    fn push(&mut self, columns: &[usize], values: impl Iterator<Item = f64>) {
        let start = self.values.len();
        self.values.resize(start + self.length, 0.0);
        for (k, v) in columns.iter().zip(values) {
            self.values[start + k] = v;
        }
    }
}

/// What the other measurements say of one: `u = S⁻¹ v + Kᵀ λ` and `D = S⁻¹ + Kᵀ Λ K`, with the adjoint after it.
#[derive(Debug, Clone, PartialEq)]
pub struct Deletion {
    /// u.
    pub pull: Vec<f64>,
    /// D, row-major.
    pub information: Vec<f64>,
}

impl Adjoint {
    /// Zero: nothing is known of the future.
    #[must_use]
    pub fn new(base: usize, slots: Slots) -> Self {
        let (short, length) = (base + slots.brief, base + slots.brief + slots.lasting);
        Self {
            short,
            vector: vec![0.0; length],
            narrow: Rows { length: short, values: Vec::new() },
            wide: Rows { length, values: Vec::new() },
            most_wide: 16,
            scratch: Vec::new(),
        }
    }

    /// λ.
    #[must_use]
    pub fn vector(&self) -> &[f64] {
        &self.vector
    }

    /// Back through an update: `G ← [G (I - K H); S^-½ H]`. Gives what all other measurements say of this one.
    pub fn back_through_update(&mut self, record: &UpdateRecord) -> Deletion {
        let m = record.rows.len();
        let mut pulls = vec![0.0; m]; // Kᵀ λ + S⁻¹ v
        for (a, (pull, gain)) in pulls.iter_mut().zip(&record.gain).enumerate() {
            *pull = dot(gain, &self.vector);
            *pull += (0..m).map(|b| record.precision[a * m + b] * record.innovation[b]).sum::<f64>();
        }
        for (row, pull) in record.rows.iter().zip(&pulls) {
            for (k, factor) in row {
                self.vector[*k] -= factor * pull;
            }
        }
        let mut information = record.precision.clone();
        self.wide.subtract(record, &mut information);
        let mut lasting: Vec<usize> = record.rows.iter().flatten().map(|e| e.0).filter(|k| *k >= self.short).collect();
        lasting.sort_unstable();
        lasting.dedup();
        if lasting.is_empty() {
            self.narrow.subtract(record, &mut information);
            for weights in upper_root(&record.precision, m) {
                let start = self.narrow.values.len();
                self.narrow.values.resize(start + self.short, 0.0);
                add_weighted(&mut self.narrow.values[start..], &weights, record);
            }
            if self.narrow.count() >= 2 * self.short + 8 {
                self.shorten_narrow();
            }
        } else {
            self.back_through_landmarks(record, &lasting, &mut information);
        }
        Deletion { pull: pulls, information }
    }

    /// Measurements of lasting landmarks give every short row a place in their columns: all are turned so that as few rows
    /// as there are landmarks keep it.
    fn back_through_landmarks(&mut self, record: &UpdateRecord, lasting: &[usize], information: &mut [f64]) {
        let length = self.wide.length;
        let mut rows = Rows { length, values: Vec::new() };
        for g in self.narrow.values.chunks_exact(self.short) {
            rows.values.extend_from_slice(g);
            rows.values.resize(rows.values.len() + length - self.short, 0.0);
        }
        rows.subtract(record, information);
        for weights in upper_root(&record.precision, record.rows.len()) {
            let start = rows.values.len();
            rows.values.resize(start + length, 0.0);
            add_weighted(&mut rows.values[start..], &weights, record);
        }
        let columns: Vec<usize> = lasting.iter().copied().chain(0..self.short).collect();
        let values = &rows.values;
        let triangle = turned(DMatrix::from_fn(rows.count(), columns.len(), |i, j| values[i * length + columns[j]]));
        self.narrow.values.clear();
        self.take_triangle(&triangle, &columns, lasting.len());
        if self.wide.count() >= self.most_wide {
            self.shorten_wide();
        }
    }

    /// The first rows of a triangle look at landmarks, the others at none.
    fn take_triangle(&mut self, triangle: &DMatrix<f64>, columns: &[usize], landmarks: usize) {
        for i in 0..triangle.nrows() {
            let values = columns.iter().enumerate().map(|(j, _)| triangle[(i, j)]);
            if i < landmarks {
                self.wide.push(columns, values);
            } else {
                self.narrow.push(&columns[landmarks..], values.skip(landmarks));
            }
        }
    }

    /// As few short rows as there are states that they look at.
    fn shorten_narrow(&mut self) {
        let used = self.narrow.used(0..self.short);
        let (values, length) = (std::mem::take(&mut self.narrow.values), self.short);
        let dense = DMatrix::from_fn(values.len() / length, used.len(), |i, j| values[i * length + used[j]]);
        self.take_triangle(&turned(dense), &used, 0);
    }

    /// As few long rows as there are landmarks; what they know of the other states alone becomes short rows.
    fn shorten_wide(&mut self) {
        let live = self.wide.used(self.short..self.wide.length);
        let columns: Vec<usize> = live.iter().copied().chain(self.wide.used(0..self.short)).collect();
        let (values, length) = (std::mem::take(&mut self.wide.values), self.wide.length);
        let dense = DMatrix::from_fn(values.len() / length, columns.len(), |i, j| values[i * length + columns[j]]);
        self.take_triangle(&turned(dense), &columns, live.len());
        self.most_wide = live.len() + live.len() / 4 + 8;
    }

    /// Back through the entry of a state at index `at`.
    pub fn back_through_entry(&mut self, at: usize, row: &[(usize, f64)]) {
        let narrow = self.narrow.iter_mut().filter(|v| at < v.len());
        for v in std::iter::once(&mut self.vector[..]).chain(narrow).chain(self.wide.iter_mut()) {
            let value = std::mem::take(&mut v[at]);
            for (k, factor) in row {
                v[*k] += factor * value;
            }
        }
    }

    /// Back through a transition of the first `base` states.
    pub fn back_through_transition(&mut self, transition: &Transition, base: usize) {
        let core_from_nav = SMatrix::<f64, CORE, NAV>::from_fn(|k, i| transition.nav[i][k]);
        for (values, length) in [
            (&mut self.vector, self.wide.length),
            (&mut self.narrow.values, self.narrow.length),
            (&mut self.wide.values, self.wide.length),
        ] {
            if values.is_empty() {
                continue;
            }
            let count = values.len() / length;
            self.scratch.resize(self.scratch.len().max(CORE * count), 0.0);
            let nav = DMatrixView::from_slice(values, length, count);
            let mut moved = DMatrixViewMut::from_slice(&mut self.scratch, CORE, count);
            moved.gemm(1.0, &core_from_nav, &nav.rows(0, NAV), 0.0);
            for (v, moved) in values.chunks_exact_mut(length).zip(moved.column_iter()) {
                back_through_transition(v, moved.as_slice(), transition, base);
            }
        }
    }
}

/// A row back through a transition; `moved` is its part of position, velocity and attitude, moved.
fn back_through_transition(v: &mut [f64], moved: &[f64], transition: &Transition, base: usize) {
    for (value, d) in v[NAV..base].iter_mut().zip(&transition.decay) {
        *value *= d;
    }
    v[..NAV].copy_from_slice(&moved[..NAV]);
    for (value, o) in v[NAV..CORE].iter_mut().zip(&moved[NAV..]) {
        *value += o;
    }
}

/// Adds the rows of a measurement, weighted.
fn add_weighted(g: &mut [f64], weights: &[f64], record: &UpdateRecord) {
    for (w, row) in weights.iter().zip(&record.rows) {
        for (k, factor) in row {
            g[*k] += w * factor;
        }
    }
}

/// The triangle of a QR decomposition.
fn turned(rows: DMatrix<f64>) -> DMatrix<f64> {
    rows.qr().unpack_r()
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
    let error = (0..means).map(|i| mean[i] - dot(row(i), adjoint.vector())).collect();
    let mut covariance = DMatrix::from_fn(wanted, wanted, |i, j| row(i)[j]);
    for g in [&adjoint.narrow, &adjoint.wide] {
        if g.values.is_empty() {
            continue;
        }
        let width = n.min(g.length);
        let p = DMatrix::from_fn(wanted, width, |i, k| row(i)[k]);
        let columns = DMatrixView::from_slice(&g.values, g.length, g.count());
        let seen = p * columns.rows(0, width);
        covariance.gemm(-1.0, &seen, &seen.transpose(), 1.0);
    }
    let covariance = (0..wanted * wanted).map(|k| covariance[(k / wanted, k % wanted)]);
    let mut covariance: Vec<f64> = covariance.collect();
    for i in 0..wanted {
        for j in 0..i {
            covariance[i * wanted + j] = covariance[j * wanted + i];
        }
    }
    (error, covariance)
}

/// Inner product over the shorter of two, in four sums, which the processor adds side by side.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
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
