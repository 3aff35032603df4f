//! The linear algebra of the filter: a mean and a covariance that are moved, updated, enlarged and shrunk.
//! [`crate::adjoint`] runs back through the same operations.

use crate::state::{CORE, NAV};
use crate::transition::Transition;

/// A sparse row: indices and factors.
pub type SparseRow = Vec<(usize, f64)>;

/// Mean and covariance of the errors. States `0..base` are the filter's own; behind them stand slots for landmarks and
/// clones, of which `0..slots` have been in use.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussian {
    /// States before the slots.
    pub base: usize,
    capacity: usize,
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
    /// Zero mean and a diagonal of variances, with room for `slots` landmarks and clones.
    #[must_use]
    pub fn new(variances: &[f64], slots: usize) -> Self {
        let base = variances.len();
        let capacity = base + slots;
        let mut covariance = vec![0.0; capacity * capacity];
        for (i, v) in variances.iter().enumerate() {
            covariance[i * capacity + i] = *v;
        }
        Self {
            base,
            capacity,
            used: 0,
            free: vec![true; slots],
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

    /// Covariance of two errors.
    #[must_use]
    pub fn covariance(&self, i: usize, j: usize) -> f64 {
        self.covariance[i * self.capacity + j]
    }

    /// Sets the covariance of two errors.
    pub fn set_covariance(&mut self, i: usize, j: usize, value: f64) {
        self.covariance[i * self.capacity + j] = value;
        self.covariance[j * self.capacity + i] = value;
    }

    /// A row of the covariance.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        &self.covariance[i * self.capacity..i * self.capacity + self.len()]
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
        multiply_nav(product, &transition.nav, &self.covariance, capacity, 0..base);
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
        let slots = n - base;
        if slots == 0 {
            return;
        }
        let product = &mut self.scratch[..NAV * slots];
        multiply_nav(product, &transition.nav, &self.covariance, capacity, base..n);
        for (i, d) in (NAV..base).zip(&transition.decay) {
            for p in &mut self.covariance[i * capacity + base..i * capacity + n] {
                *p *= d;
            }
        }
        for i in 0..NAV {
            let row = &self.scratch[i * slots..(i + 1) * slots];
            self.covariance[i * capacity + base..i * capacity + n].copy_from_slice(row);
        }
        for i in base..n {
            for j in 0..base {
                self.covariance[i * capacity + j] = self.covariance[j * capacity + i];
            }
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
                let from = &self.covariance[k * self.capacity..k * self.capacity + n];
                for (c, p) in column.iter_mut().zip(from) {
                    *c += factor * p;
                }
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
    pub fn update(&mut self, measurement: &Measurement) -> Result<UpdateRecord, Singular> {
        let (innovation, spread, columns) = self.predict(measurement);
        let (n, m) = (self.len(), measurement.rows.len());
        let precision = invert(&spread, m)?;
        let combine = |weights: &[f64], a: usize| {
            let mut out = vec![0.0; n];
            for (b, column) in columns.iter().enumerate() {
                let w = weights[b * m + a];
                for (o, c) in out.iter_mut().zip(column) {
                    *o += w * c;
                }
            }
            out
        };
        let gain: Vec<Vec<f64>> = (0..m).map(|a| combine(&precision, a)).collect();
        for (k, v) in gain.iter().zip(&innovation) {
            for (x, g) in self.mean.iter_mut().zip(k) {
                *x += g * v;
            }
        }
        for a in 0..m {
            // K S of this column less two W: P += K (½ S Kᵀ - Wᵀ) + transpose
            let mut half = vec![0.0; n];
            for (b, k) in gain.iter().enumerate() {
                let s = 0.5 * spread[b * m + a];
                for (h, g) in half.iter_mut().zip(k) {
                    *h += s * g;
                }
            }
            for (h, w) in half.iter_mut().zip(&columns[a]) {
                *h -= w;
            }
            let k = &gain[a];
            for i in 0..n {
                let (ki, hi) = (k[i], half[i]);
                let row = &mut self.covariance[i * self.capacity..=i * self.capacity + i];
                for ((p, kj), hj) in row.iter_mut().zip(k).zip(&half) {
                    *p += ki * hj + hi * kj;
                }
            }
        }
        for i in 0..n {
            for j in 0..i {
                self.covariance[j * self.capacity + i] = self.covariance[i * self.capacity + j];
            }
        }
        Ok(UpdateRecord { innovation, precision, rows: measurement.rows.clone(), gain })
    }

    /// Brings in a state that is a combination of others plus noise: a landmark with the noise of its first sighting, a
    /// clone with none. Gives its index, or `None` when all slots are taken.
    pub fn enter(&mut self, row: &[(usize, f64)], variance: f64) -> Option<usize> {
        let slot = self.free.iter().position(|f| *f)?;
        self.free[slot] = false;
        self.used = self.used.max(slot + 1);
        let (n, at) = (self.len(), self.base + slot);
        let mut column = vec![0.0; n];
        let mut mean = 0.0;
        for (k, factor) in row {
            mean += factor * self.mean[*k];
            for (c, p) in column.iter_mut().zip(&self.covariance[k * self.capacity..]) {
                *c += factor * p;
            }
        }
        column[at] = row.iter().map(|(k, factor)| factor * column[*k]).sum::<f64>() + variance;
        self.mean[at] = mean;
        for (i, c) in column.iter().enumerate() {
            self.set_covariance(i, at, *c);
        }
        Some(at)
    }

    /// Lets a state of a slot go.
    pub fn leave(&mut self, at: usize) {
        for i in 0..self.len() {
            self.set_covariance(i, at, 0.0);
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

/// The nine rows of `Φ P` over columns of a covariance.
fn multiply_nav(
    product: &mut [f64],
    nav: &[[f64; CORE]; NAV],
    covariance: &[f64],
    capacity: usize,
    columns: std::ops::Range<usize>,
) {
    product.fill(0.0);
    for (out, row) in product.chunks_exact_mut(columns.len()).zip(nav) {
        for (k, factor) in row.iter().enumerate() {
            if *factor != 0.0 {
                let from = &covariance[k * capacity + columns.start..k * capacity + columns.end];
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
