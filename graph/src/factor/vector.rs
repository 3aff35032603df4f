//! Factors on variables that are plain numbers.

use super::Factor;
use crate::variable::{Values, VariableId};

/// A number known beforehand: a prior, a control height, a constant bias.
#[derive(Debug, Clone)]
pub struct ScalarPrior {
    id: [VariableId; 1],
    component: usize,
    measured: f64,
    weight: f64,
}

impl ScalarPrior {
    /// `component` of the variable's value is `measured` within `sigma`.
    #[must_use]
    pub fn new(id: VariableId, component: usize, measured: f64, sigma: f64) -> Self {
        Self { id: [id], component, measured, weight: 1.0 / sigma }
    }
}

impl Factor for ScalarPrior {
    fn variables(&self) -> &[VariableId] {
        &self.id
    }
    fn rows(&self) -> usize {
        1
    }
    fn label(&self) -> &'static str {
        "known value"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        residual[0] = self.weight * (values.get(self.id[0])[self.component] - self.measured);
        if let Some(jacobian) = jacobian {
            jacobian[self.component] = self.weight;
        }
    }
}

/// A step of a random walk, or with a small sigma a constant: the second value is the first within `sigma`.
#[derive(Debug, Clone)]
pub struct RandomWalk {
    ids: [VariableId; 2],
    weights: Vec<f64>,
}

impl RandomWalk {
    /// One sigma for each component.
    #[must_use]
    pub fn new(ids: [VariableId; 2], sigmas: &[f64]) -> Self {
        Self { ids, weights: sigmas.iter().map(|s| 1.0 / s).collect() }
    }
}

impl Factor for RandomWalk {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        self.weights.len()
    }
    fn label(&self) -> &'static str {
        "random walk"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let (a, b) = (values.get(self.ids[0]), values.get(self.ids[1]));
        let n = self.weights.len();
        for k in 0..n {
            residual[k] = self.weights[k] * (b[k] - a[k]);
        }
        if let Some(jacobian) = jacobian {
            for k in 0..n {
                jacobian[k * 2 * n + k] = -self.weights[k];
                jacobian[k * 2 * n + n + k] = self.weights[k];
            }
        }
    }
}

/// Values known beforehand, one sigma for each.
#[derive(Debug, Clone)]
pub struct VectorPrior {
    id: [VariableId; 1],
    measured: Vec<f64>,
    weights: Vec<f64>,
}

impl VectorPrior {
    /// One value and sigma for each component of a variable that is plain numbers.
    #[must_use]
    pub fn new(id: VariableId, measured: &[f64], sigmas: &[f64]) -> Self {
        Self { id: [id], measured: measured.to_vec(), weights: sigmas.iter().map(|s| 1.0 / s).collect() }
    }
}

impl Factor for VectorPrior {
    fn variables(&self) -> &[VariableId] {
        &self.id
    }
    fn rows(&self) -> usize {
        self.measured.len()
    }
    fn label(&self) -> &'static str {
        "known values"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let v = values.get(self.id[0]);
        let n = self.measured.len();
        for k in 0..n {
            residual[k] = self.weights[k] * (v[k] - self.measured[k]);
        }
        if let Some(jacobian) = jacobian {
            for k in 0..n {
                jacobian[k * n + k] = self.weights[k];
            }
        }
    }
}

/// Linear equations of a few variables that are plain numbers: `root (Σ A x - b)`.
#[derive(Debug, Clone)]
pub struct Linear {
    ids: Vec<VariableId>,
    rows: usize,
    /// Whitened coefficients, row by row.
    coefficients: Vec<f64>,
    /// Whitened right-hand sides.
    right: Vec<f64>,
    tie: bool,
}

impl Linear {
    /// Whitened coefficients row by row, the variables' columns side by side, and whitened right-hand sides.
    #[must_use]
    pub fn new(ids: Vec<VariableId>, coefficients: Vec<f64>, right: Vec<f64>) -> Self {
        Self { ids, rows: right.len(), coefficients, right, tie: false }
    }
    /// The same as a tie, which robust kernels may weight down.
    #[must_use]
    pub fn as_tie(mut self, tie: bool) -> Self {
        self.tie = tie;
        self
    }
    /// Changes the whitened right-hand sides.
    pub fn set_right(&mut self, right: &[f64]) {
        self.right.copy_from_slice(right);
    }
}

impl Factor for Linear {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        self.rows
    }
    fn is_tie(&self) -> bool {
        self.tie
    }
    fn label(&self) -> &'static str {
        "linear equation"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let columns = self.coefficients.len() / self.rows;
        for (r, row) in self.coefficients.chunks_exact(columns).enumerate() {
            let mut next = row.iter();
            let mut sum = -self.right[r];
            for id in &self.ids {
                sum += values.get(*id).iter().zip(next.by_ref()).map(|(x, a)| x * a).sum::<f64>();
            }
            residual[r] = sum;
        }
        if let Some(jacobian) = jacobian {
            jacobian.copy_from_slice(&self.coefficients);
        }
    }
}
