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

use nalgebra::{DMatrix, DMatrixView};

use crate::kalman::{Slots, UpdateRecord};
use crate::lanes::{LANES, Move, PADDED, Pull, SplitRow, Step, dot, pass};
use crate::state::NAV;
use crate::tape::{NodeRecord, Operation};

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
    /// States of a short row: the filter's own, the brief slots, and what fills it up to whole registers.
    short: usize,
    vector: Vec<f64>,
    narrow: Rows,
    wide: Rows,
    /// Long rows from which on they are shortened.
    most_wide: usize,
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

    /// Takes all rows through a step.
    fn pass(&mut self, step: &mut Step) {
        pass(&mut self.values, self.length, step);
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
        let short = (base + slots.brief).next_multiple_of(LANES).max(PADDED);
        let length = (base + slots.brief + slots.lasting).next_multiple_of(LANES).max(short);
        Self {
            short,
            vector: vec![0.0; length],
            narrow: Rows { length: short, values: Vec::new() },
            wide: Rows { length, values: Vec::new() },
            most_wide: 16,
        }
    }

    /// λ.
    #[must_use]
    pub fn vector(&self) -> &[f64] {
        &self.vector
    }

    /// Back through a record: its operations from the last to the first, then its transition of the first `base` states.
    /// Gives what all other measurements say of each, with its place among the operations.
    pub fn back_through(&mut self, record: &NodeRecord, base: usize) -> Vec<(usize, Deletion)> {
        let mut deletions = Vec::new();
        for (number, operation) in record.operations.iter().enumerate().rev() {
            match operation {
                Operation::Enter { at, row } => self.take(&mut Step::TakeOut(*at, SplitRow::new(row)), *at),
                Operation::Update(update) => deletions.push((number, self.back_through_update(update))),
            }
        }
        if let Some(transition) = &record.transition {
            let moving = Move::new(&transition.nav, &transition.decay[..base - NAV]);
            self.take(&mut Step::Move(Box::new(moving)), 0);
        }
        deletions
    }

    /// Takes λ and all rows, the short ones if they look at state `at`, through a step.
    fn take(&mut self, step: &mut Step, at: usize) {
        pass(&mut self.vector, self.wide.length, step);
        self.wide.pass(step);
        if at < self.short {
            self.narrow.pass(step);
        }
    }

    /// Back through an update: `G ← [G (I - K H); S^-½ H]`.
    fn back_through_update(&mut self, record: &UpdateRecord) -> Deletion {
        let mut deletion = self.pull_vector(record);
        let mut step = Step::Pull(Pull::new(&record.gain, &record.rows, self.wide.length));
        self.wide.pass(&mut step);
        let lasting = self.lasting(record);
        if lasting.is_empty() {
            self.back_through_brief(record, &mut step);
        } else {
            self.back_through_landmarks(record, &mut step, &lasting);
        }
        if let Step::Pull(pull) = step {
            deletion.information.iter_mut().zip(pull.information).for_each(|(sum, i)| *sum += i);
        }
        deletion
    }

    /// λ back through an update; gives the pull on it and its precision.
    fn pull_vector(&mut self, record: &UpdateRecord) -> Deletion {
        let m = record.rows.len();
        let mut pull = vec![0.0; m]; // Kᵀ λ + S⁻¹ v
        for (a, (pull, gain)) in pull.iter_mut().zip(&record.gain).enumerate() {
            *pull = dot(gain, &self.vector);
            *pull += (0..m).map(|b| record.precision[a * m + b] * record.innovation[b]).sum::<f64>();
        }
        for (row, pull) in record.rows.iter().zip(&pull) {
            for (k, factor) in row {
                self.vector[*k] -= factor * pull;
            }
        }
        Deletion { pull, information: record.precision.clone() }
    }

    /// Landmarks kept for long that an update looks at.
    fn lasting(&self, record: &UpdateRecord) -> Vec<usize> {
        let mut lasting: Vec<usize> = record.rows.iter().flatten().map(|e| e.0).filter(|k| *k >= self.short).collect();
        lasting.sort_unstable();
        lasting.dedup();
        lasting
    }

    /// The short rows back through an update that looks at no lasting landmark.
    fn back_through_brief(&mut self, record: &UpdateRecord, step: &mut Step) {
        self.narrow.pass(step);
        for weights in upper_root(&record.precision, record.rows.len()) {
            let start = self.narrow.values.len();
            self.narrow.values.resize(start + self.short, 0.0);
            add_weighted(&mut self.narrow.values[start..], &weights, record);
        }
        if self.narrow.count() >= 2 * self.short + 8 {
            self.shorten_narrow();
        }
    }

    /// Measurements of lasting landmarks give every short row a place in their columns: all are turned so that as few rows
    /// as there are landmarks keep it.
    fn back_through_landmarks(&mut self, record: &UpdateRecord, step: &mut Step, lasting: &[usize]) {
        let length = self.wide.length;
        let mut rows = Rows { length, values: Vec::new() };
        for g in self.narrow.values.chunks_exact(self.short) {
            rows.values.extend_from_slice(g);
            rows.values.resize(rows.values.len() + length - self.short, 0.0);
        }
        rows.pass(step);
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

/// Smoothed errors of some states and covariance of the first `wanted` of them, `x - P λ` and `P - P Λ P`; `mean` and `rows`
/// are theirs, the rows of the covariance over all `n` states, row-major.
#[must_use]
pub fn smoothed(rows: &[f64], mean: &[f64], (n, wanted): (usize, usize), adjoint: &Adjoint) -> (Vec<f64>, Vec<f64>) {
    let row = |i: usize| &rows[i * n..(i + 1) * n];
    let error = mean.iter().enumerate().map(|(i, x)| x - dot(row(i), adjoint.vector())).collect();
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
