//! The linear algebra of the filter: a mean and a covariance that are moved, updated, enlarged and shrunk.
//! [`crate::adjoint`] runs back through the same operations.

use crate::lanes::{LANES, add_symmetric, move_columns};
use crate::state::{CORE, NAV};
use crate::transition::Transition;

/// A sparse row: indices and factors.
pub type SparseRow = Vec<(usize, f64)>;

/// Room for landmarks and clones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slots {
    /// For states that leave soon: they stand first, so that few rows of the backward pass need be long.
    pub brief: usize,
    /// For those that stay.
    pub lasting: usize,
}

/// How long a state is to stay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stay {
    /// A moment.
    Brief,
    /// Longer.
    Lasting,
}

/// Mean and covariance of the errors. States `0..base` are the filter's own; behind them stand slots for landmarks and
/// clones, of which the first `used` have been in use.
///
/// Of the covariance the rows of the filter's own states are kept whole, and the lower triangle of the slots: no number
/// twice, where there are many landmarks.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussian {
    /// States before the slots.
    pub base: usize,
    capacity: usize,
    brief: usize,
    used: usize,
    free: Vec<bool>,
    mean: Vec<f64>,
    covariance: Vec<f64>,
    scratch: Vec<f64>,
}

/// A measurement: residuals, their rows and their covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Measured minus predicted by the nominal.
    pub residual: Vec<f64>,
    /// How the residuals depend on the errors.
    pub rows: Vec<SparseRow>,
    /// Covariance of the measurement, row-major.
    pub noise: Vec<f64>,
}

/// What the backward pass needs of an update.
#[derive(Debug, Clone, PartialEq)]
pub struct UpdateRecord {
    /// Innovation: residual less what the mean of the errors predicts.
    pub innovation: Vec<f64>,
    /// Its covariance's inverse, row-major.
    pub precision: Vec<f64>,
    /// Rows of the measurement.
    pub rows: Vec<SparseRow>,
    /// Gain, one column a row of the measurement.
    pub gain: Vec<Vec<f64>>,
}

/// The covariance of an innovation cannot be inverted: the measurement has no noise and nothing to learn from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("an innovation without variance: the measurement needs a standard deviation above zero")]
pub struct Singular;

/// Inverse of a small symmetric positive definite matrix, row-major, by Cholesky's decomposition.
///
/// # Errors
/// [`Singular`] when it is not positive definite.
pub fn invert(matrix: &[f64], m: usize) -> Result<Vec<f64>, Singular> {
    if m == 1 {
        return if matrix[0] > 0.0 { Ok(vec![1.0 / matrix[0]]) } else { Err(Singular) };
    }
    let full = nalgebra::DMatrix::from_row_slice(m, m, matrix);
    let inverse = full.cholesky().ok_or(Singular)?.inverse();
    Ok((0..m * m).map(|k| 0.5 * (inverse[(k / m, k % m)] + inverse[(k % m, k / m)])).collect())
}

impl Gaussian {
    /// Zero mean and a diagonal of variances, with room for landmarks and clones.
    #[must_use]
    pub fn new(variances: &[f64], slots: Slots) -> Self {
        let base = variances.len();
        let all = slots.brief + slots.lasting;
        let capacity = base + all.next_multiple_of(LANES); // columns of slots fill whole registers
        let mut covariance = vec![0.0; capacity * capacity];
        for (i, v) in variances.iter().enumerate() {
            covariance[i * capacity + i] = *v;
        }
        Self {
            base,
            capacity,
            brief: slots.brief,
            used: 0,
            free: vec![true; all],
            mean: vec![0.0; capacity],
            covariance,
            scratch: vec![0.0; CORE.max(8) * capacity],
        }
    }

    /// States in use: the base and the slots up to the last that was taken.
    #[must_use]
    pub fn len(&self) -> usize {
        self.base + self.used
    }

    /// Whether there is no state at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Mean of the errors.
    #[must_use]
    pub fn mean(&self) -> &[f64] {
        &self.mean[..self.len()]
    }

    /// Mean of the errors, to be changed.
    pub fn mean_mut(&mut self) -> &mut [f64] {
        let n = self.len();
        &mut self.mean[..n]
    }

    /// Where the covariance of two errors stands.
    fn place(&self, i: usize, j: usize) -> usize {
        let (i, j) = if i >= self.base && (j < self.base || j > i) { (j, i) } else { (i, j) };
        i * self.capacity + j
    }

    /// Covariance of two errors.
    #[must_use]
    pub fn covariance(&self, i: usize, j: usize) -> f64 {
        self.covariance[self.place(i, j)]
    }

    /// Sets the covariance of two errors.
    pub fn set_covariance(&mut self, i: usize, j: usize, value: f64) {
        let (ij, ji) = (self.place(i, j), self.place(j, i));
        self.covariance[ij] = value;
        self.covariance[ji] = value;
    }

    /// A row of the covariance, of a state before the slots.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        debug_assert!(i < self.base, "slots have no whole row");
        &self.covariance[i * self.capacity..i * self.capacity + self.len()]
    }

    /// Adds a multiple of a column of the covariance to `out`.
    fn add_column(&self, out: &mut [f64], k: usize, factor: f64) {
        let base = self.base;
        if k < base {
            for (o, p) in out.iter_mut().zip(self.row(k)) {
                *o += factor * p;
            }
            return;
        }
        for (o, row) in out[..base].iter_mut().zip(self.covariance.chunks_exact(self.capacity)) {
            *o += factor * row[k];
        }
        let own = &self.covariance[k * self.capacity + base..=k * self.capacity + k];
        for (o, p) in out[base..].iter_mut().zip(own) {
            *o += factor * p;
        }
        let below = self.covariance.chunks_exact(self.capacity).skip(k + 1);
        for (o, row) in out[k + 1..].iter_mut().zip(below) {
            *o += factor * row[k];
        }
    }

    /// Adds variances to the first states.
    pub fn add_variances(&mut self, variances: &[f64], factor: f64) {
        for (i, v) in variances.iter().enumerate() {
            self.covariance[i * self.capacity + i] += factor * v;
        }
    }

    /// Moves mean and covariance by a transition: `x ← Φ x`, `P ← Φ P Φᵀ`.
    pub fn advance(&mut self, transition: &Transition) {
        self.advance_base(transition);
        self.advance_slots(transition);
    }

    /// Moves the states before the slots only; [`Gaussian::advance_slots`] is due, with the product of all transitions,
    /// before the next measurement. Landmarks do not move, so their covariance with the others can wait.
    pub fn advance_base(&mut self, transition: &Transition) {
        let (base, capacity) = (self.base, self.capacity);
        move_mean(&mut self.mean[..base], transition);
        // the nine rows of Φ P over the base columns
        let product = &mut self.scratch[..NAV * base];
        multiply_nav(product, &transition.nav, &self.covariance, capacity, base);
        for i in NAV..base {
            let di = transition.decay[i - NAV];
            let row = &mut self.covariance[i * capacity + NAV..i * capacity + base];
            for (p, d) in row.iter_mut().zip(&transition.decay) {
                *p *= di * d;
            }
        }
        let product = &self.scratch[..NAV * base];
        for i in 0..NAV {
            let out = &product[i * base..(i + 1) * base];
            for (j, row) in transition.nav.iter().enumerate().skip(i) {
                let value: f64 = out[..CORE].iter().zip(row).map(|(a, b)| a * b).sum();
                self.covariance[i * capacity + j] = value;
                self.covariance[j * capacity + i] = value;
            }
            for (j, d) in (NAV..base).zip(&transition.decay) {
                let value = out[j] * d;
                self.covariance[i * capacity + j] = value;
                self.covariance[j * capacity + i] = value;
            }
        }
    }

    /// Moves the covariance of slots and base: `P_bs ← Φ P_bs`.
    pub fn advance_slots(&mut self, transition: &Transition) {
        let (n, base, capacity) = (self.len(), self.base, self.capacity);
        if n > base {
            // behind the last in use stand zeros
            let to = base + (n - base).next_multiple_of(LANES);
            move_columns(&mut self.covariance, (capacity, base, to), &transition.nav, &transition.decay);
        }
    }

    /// Innovation of a measurement, its covariance (row-major), and `P Hᵀ` (a column for each row of the measurement).
    #[must_use]
    pub fn predict(&self, measurement: &Measurement) -> (Vec<f64>, Vec<f64>, Vec<Vec<f64>>) {
        let (n, m) = (self.len(), measurement.rows.len());
        let mut columns = Vec::with_capacity(m);
        let mut innovation = measurement.residual.clone();
        for (row, v) in measurement.rows.iter().zip(&mut innovation) {
            let mut column = vec![0.0; n];
            for (k, factor) in row {
                *v -= factor * self.mean[*k];
                self.add_column(&mut column, *k, *factor);
            }
            columns.push(column);
        }
        let mut spread = measurement.noise.clone();
        for (a, row) in measurement.rows.iter().enumerate() {
            for (b, column) in columns.iter().enumerate() {
                spread[a * m + b] += row.iter().map(|(k, factor)| factor * column[*k]).sum::<f64>();
            }
        }
        (innovation, spread, columns)
    }

    /// Takes a measurement in. The covariance is updated in Joseph's form, `P - K Wᵀ - W Kᵀ + K S Kᵀ` with `W = P Hᵀ`.
    ///
    /// # Errors
    /// [`Singular`] when the innovation has no variance.
    pub fn update(&mut self, measurement: Measurement) -> Result<UpdateRecord, Singular> {
        let (innovation, spread, columns) = self.predict(&measurement);
        let precision = invert(&spread, innovation.len())?;
        Ok(self.update_with(measurement.rows, (innovation, spread, columns), precision))
    }

    /// Takes a measurement in whose rows, prediction ([`Gaussian::predict`]) and precision, the inverse of its innovation's
    /// covariance, are known.
    pub fn update_with(
        &mut self,
        rows: Vec<SparseRow>,
        (innovation, spread, mut columns): (Vec<f64>, Vec<f64>, Vec<Vec<f64>>),
        precision: Vec<f64>,
    ) -> UpdateRecord {
        let m = rows.len();
        let combine = |weights: &[f64], a: usize| {
            let mut out: Vec<f64> = columns[0].iter().map(|c| weights[a] * c).collect();
            for (b, column) in columns.iter().enumerate().skip(1) {
                let w = weights[b * m + a];
                out.iter_mut().zip(column).for_each(|(o, c)| *o += w * c);
            }
            out
        };
        let gain: Vec<Vec<f64>> = (0..m).map(|a| combine(&precision, a)).collect();
        for (k, v) in gain.iter().zip(&innovation) {
            for (x, g) in self.mean.iter_mut().zip(k) {
                *x += g * v;
            }
        }
        // K S less two W: P += K (½ S Kᵀ - Wᵀ) + transpose
        for (a, column) in columns.iter_mut().enumerate() {
            column.iter_mut().for_each(|w| *w = -*w);
            for (b, k) in gain.iter().enumerate() {
                let s = 0.5 * spread[b * m + a];
                column.iter_mut().zip(k).for_each(|(h, g)| *h += s * g);
            }
        }
        let pairs: Vec<(&[f64], &[f64])> = gain.iter().zip(&columns).map(|(k, h)| (&k[..], &h[..])).collect();
        add_symmetric(&mut self.covariance, self.capacity, self.base, &pairs);
        UpdateRecord { innovation, precision, rows, gain }
    }

    /// Brings in a state that is a combination of others plus noise: a landmark with the noise of its first sighting, a
    /// clone with none. Gives its index, or `None` when all slots are taken; when only those of its kind are, it gets
    /// another.
    pub fn enter(&mut self, row: &[(usize, f64)], variance: f64, stay: Stay) -> Option<usize> {
        let first = if stay == Stay::Brief { 0 } else { self.brief };
        let order = (first..self.free.len()).chain(0..first);
        let slot = order.into_iter().find(|s| self.free[*s])?;
        self.free[slot] = false;
        self.used = self.used.max(slot + 1);
        let (n, at) = (self.len(), self.base + slot);
        let mut column = vec![0.0; n];
        let mut mean = 0.0;
        for (k, factor) in row {
            mean += factor * self.mean[*k];
            self.add_column(&mut column, *k, *factor);
        }
        column[at] = row.iter().map(|(k, factor)| factor * column[*k]).sum::<f64>() + variance;
        self.mean[at] = mean;
        for (i, c) in column.iter().enumerate() {
            let place = self.place(i, at);
            self.covariance[place] = *c;
        }
        Some(at)
    }

    /// Lets a state of a slot go.
    pub fn leave(&mut self, at: usize) {
        for i in 0..self.len() {
            let place = self.place(i, at);
            self.covariance[place] = 0.0;
        }
        self.mean[at] = 0.0;
        self.free[at - self.base] = true;
        while self.used > 0 && self.free[self.used - 1] {
            self.used -= 1;
        }
    }

    /// Slots not taken.
    #[must_use]
    pub fn free_slots(&self) -> usize {
        self.free.iter().filter(|f| **f).count()
    }
}

/// The nine rows of `Φ P` over the first columns of a covariance.
fn multiply_nav(product: &mut [f64], nav: &[[f64; CORE]; NAV], covariance: &[f64], capacity: usize, columns: usize) {
    product.fill(0.0);
    for (out, row) in product.chunks_exact_mut(columns).zip(nav) {
        for (k, factor) in row.iter().enumerate() {
            if *factor != 0.0 {
                let from = &covariance[k * capacity..k * capacity + columns];
                for (o, p) in out.iter_mut().zip(from) {
                    *o += factor * p;
                }
            }
        }
    }
}

fn move_mean(mean: &mut [f64], transition: &Transition) {
    if mean.iter().all(|v| *v == 0.0) {
        return;
    }
    let mut nav = [0.0; NAV];
    for (out, row) in nav.iter_mut().zip(&transition.nav) {
        *out = row.iter().zip(mean.iter()).map(|(a, b)| a * b).sum();
    }
    mean[..NAV].copy_from_slice(&nav);
    for (x, d) in mean[NAV..].iter_mut().zip(&transition.decay) {
        *x *= d;
    }
}
