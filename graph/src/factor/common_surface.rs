//! A surface line of any number of ends, the offset of the surface itself eliminated.
//!
//! Every end sees the surface at `l_k + J_k x`, where `x` corrects the unknowns that were in force when the offsets
//! `l_k` were measured. The surface is unknown; what is left is how the ends lie to each other. With weights `w_k`
//! the sum of squares about the weighted mean is that of `K - 1` independent rows, each an end against the mean of
//! those before it (recursive weighted mean, West 1979; the contrasts of Helmert's transformation):
//!
//! `Σ w_k (c_k - c̄)² = Σ_{k ≥ 2} w_k W_{k-1} / W_k (c_k - c̄_{k-1})²`

use super::Factor;
use crate::covariance::Joint;
use crate::variable::{Values, VariableId};

/// A design row: place among the factor's columns and derivative.
pub type SparseRow = Vec<(u32, f64)>;

/// The ends of a surface line, against each other.
#[derive(Debug, Clone)]
pub struct CommonSurface {
    ids: Vec<VariableId>,
    columns: usize,
    rows: Vec<SparseRow>,
    offsets_m: Vec<f64>,
    weights: Vec<f64>,
}

impl CommonSurface {
    /// `rows`: how each end's offset depends on the variables, whose columns stand side by side (`columns` in all);
    /// `offsets_m`: each end's offset as measured; `weights`: of each end \[1/m²\], 0 for one that tells nothing.
    #[must_use]
    pub fn new(
        ids: Vec<VariableId>,
        columns: usize,
        rows: Vec<SparseRow>,
        offsets_m: Vec<f64>,
        weights: Vec<f64>,
    ) -> Self {
        Self { ids, columns, rows, offsets_m, weights }
    }

    /// Changes the weights of the ends \[1/m²\].
    pub fn set_weights(&mut self, weights: &[f64]) {
        self.weights.copy_from_slice(weights);
    }

    /// Offset of each end from the mean that the given weights make \[m\].
    #[must_use]
    pub fn deviations_m(&self, values: &Values, weights: &[f64]) -> Vec<f64> {
        let local = self.local(values);
        let computed: Vec<f64> = self.rows.iter().zip(&self.offsets_m).map(|(row, l)| l + dot(row, &local)).collect();
        let total: f64 = weights.iter().sum();
        let mean =
            if total > 0.0 { computed.iter().zip(weights).map(|(c, w)| c * w).sum::<f64>() / total } else { 0.0 };
        computed.iter().map(|c| c - mean).collect()
    }

    /// Variance of each of these deviations that comes of the variables alone \[m²\].
    #[must_use]
    pub fn variances_m2(&self, joint: &Joint<'_>, weights: &[f64]) -> Vec<f64> {
        let total: f64 = weights.iter().sum();
        let mut mean = vec![0.0; self.columns];
        if total > 0.0 {
            for (row, w) in self.rows.iter().zip(weights) {
                row.iter().for_each(|(c, v)| mean[*c as usize] += w / total * v);
            }
        }
        let of_mean = joint.times(&mean);
        let mean_variance: f64 = mean.iter().zip(&of_mean).map(|(a, b)| a * b).sum();
        let variance = |row: &SparseRow| {
            let own: f64 = row
                .iter()
                .map(|(a, x)| row.iter().map(|(b, y)| x * y * joint.at(*a as usize, *b as usize)).sum::<f64>())
                .sum();
            (own - 2.0 * dot(row, &of_mean) + mean_variance).max(0.0)
        };
        self.rows.iter().map(variance).collect()
    }

    fn local(&self, values: &Values) -> Vec<f64> {
        let mut local = Vec::with_capacity(self.columns);
        self.ids.iter().for_each(|id| local.extend_from_slice(values.get(*id)));
        local
    }
}

fn dot(row: &SparseRow, x: &[f64]) -> f64 {
    row.iter().map(|(column, value)| value * x[*column as usize]).sum()
}

impl Factor for CommonSurface {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        self.rows.len().saturating_sub(1)
    }
    fn is_tie(&self) -> bool {
        true
    }
    fn label(&self) -> &'static str {
        "surface line of many ends"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], mut jacobian: Option<&mut [f64]>) {
        let local = self.local(values);
        let mut mean_row = vec![0.0; if jacobian.is_some() { self.columns } else { 0 }];
        let (mut mean, mut total) = (0.0, 0.0);
        for (k, ((row, l), w)) in self.rows.iter().zip(&self.offsets_m).zip(&self.weights).enumerate() {
            if *w <= 0.0 {
                continue;
            }
            let computed = l + dot(row, &local);
            let sum = total + w;
            if total > 0.0 {
                let root = (w * total / sum).sqrt();
                residual[k - 1] = root * (computed - mean);
                if let Some(jacobian) = jacobian.as_deref_mut() {
                    let target = &mut jacobian[(k - 1) * self.columns..k * self.columns];
                    target.iter_mut().zip(&mean_row).for_each(|(t, m)| *t = -root * m);
                    row.iter().for_each(|(c, v)| target[*c as usize] += root * v);
                }
            }
            mean += w / sum * (computed - mean);
            if jacobian.is_some() {
                mean_row.iter_mut().for_each(|m| *m *= total / sum);
                row.iter().for_each(|(c, v)| mean_row[*c as usize] += w / sum * v);
            }
            total = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variable::Kind;

    #[test]
    fn rows_have_the_sum_of_squares_about_the_weighted_mean() {
        let mut values = Values::default();
        let a = values.push(Kind::Vector(2), &[0.3, -0.2]);
        let b = values.push(Kind::Scalar, &[0.7]);
        let rows = vec![vec![(0, 1.0), (2, 0.5)], vec![(1, -0.7), (2, 2.0)], vec![(0, 0.4)], vec![]];
        let (l, w) = (vec![0.3, -0.1, 0.2, 0.05], vec![1.0, 4.0, 0.0, 2.5]);
        let line = CommonSurface::new(vec![a, b], 3, rows, l, w.clone());
        let mut residual = vec![0.0; line.rows()];
        let mut jacobian = vec![0.0; 3 * line.rows()];
        line.evaluate(&values, &mut residual, Some(&mut jacobian));
        let expected: f64 = line.deviations_m(&values, &w).iter().zip(&w).map(|(v, w)| w * v * v).sum();
        let found: f64 = residual.iter().map(|r| r * r).sum();
        assert!((found - expected).abs() < 1e-14, "{found} {expected}");
        // linear: derivatives are differences
        for c in 0..3 {
            let mut moved = values.clone();
            let (id, k) = if c < 2 { (a, c) } else { (b, 0) };
            moved.get_mut(id)[k] += 1.0;
            let mut other = vec![0.0; line.rows()];
            line.evaluate(&moved, &mut other, None);
            for r in 0..line.rows() {
                assert!((other[r] - residual[r] - jacobian[3 * r + c]).abs() < 1e-14);
            }
        }
    }
}
