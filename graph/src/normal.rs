//! Normal equations of surface lines: assembled in parallel in a fixed order, solved by sparse Cholesky (faer).
//!
//! Unknowns are counted in units of their prior sigmas, so that the prior is the identity and metres, radians and
//! scale factors are of one size: the condition of the matrix is that of the geometry.

use std::sync::Once;

use faer::prelude::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, SymbolicSparseColMat};
use faer::{Mat, Par, Side};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Design rows of a line: which unknowns its ends depend on, and how. Does not change with the weights.
#[derive(Debug, Clone)]
pub struct Shape {
    /// Sorted indices of the unknowns in the line.
    pub columns: Vec<usize>,
    /// Design rows of the ends in prior units: place in `columns` and value, sorted by place.
    rows: Vec<Vec<(usize, f64)>>,
}

impl Shape {
    /// The shape of rows as [`crate::Model::row`] gives them; `scale` are the prior sigmas.
    #[must_use]
    pub fn new(rows: &[Vec<(usize, f64)>], scale: &[f64]) -> Self {
        let mut columns: Vec<usize> = rows.iter().flatten().map(|(index, _)| *index).collect();
        columns.sort_unstable();
        columns.dedup();
        let rows = rows
            .iter()
            .map(|row| {
                let mut local: Vec<(usize, f64)> = row
                    .iter()
                    .map(|(index, value)| (columns.partition_point(|c| c < index), value * scale[*index]))
                    .collect();
                local.sort_unstable_by_key(|(column, _)| *column);
                local
            })
            .collect();
        Self { columns, rows }
    }
}

/// One line with its landmark eliminated: the weighted mean of its ends is taken off.
#[derive(Debug, Clone)]
pub struct Reduced<'a> {
    shape: &'a Shape,
    /// Weighted mean of the design rows.
    mean_row: Vec<f64>,
    /// Misclosures \[m\], less their weighted mean.
    misclosure: Vec<f64>,
    /// Weights \[1/m²\].
    pub weights: Vec<f64>,
}

impl<'a> Reduced<'a> {
    /// Eliminates the landmark of a line.
    ///
    /// With weights w the offset of the surface is `D = Σ w (l + J x) / Σ w`; what remains are deviations from the
    /// weighted mean (the Schur complement of the landmark).
    #[must_use]
    pub fn new(shape: &'a Shape, misclosure: &[f64], weights: &[f64]) -> Self {
        let total: f64 = weights.iter().sum();
        let mut mean_row = vec![0.0; shape.columns.len()];
        let mut mean = 0.0;
        if total > 0.0 {
            for ((row, l), w) in shape.rows.iter().zip(misclosure).zip(weights) {
                for (column, value) in row {
                    mean_row[*column] += value * w / total;
                }
                mean += l * w / total;
            }
        }
        let misclosure = misclosure.iter().map(|l| l - mean).collect();
        Self { shape, mean_row, misclosure, weights: weights.to_vec() }
    }

    /// Sorted indices of the unknowns in the line.
    #[must_use]
    pub fn columns(&self) -> &'a [usize] {
        &self.shape.columns
    }

    /// Number of ends.
    #[must_use]
    pub fn ends(&self) -> usize {
        self.shape.rows.len()
    }

    /// Offsets from the weighted mean \[m\] after a step of all unknowns, in prior units.
    #[must_use]
    pub fn residuals(&self, step: &DVector<f64>) -> Vec<f64> {
        let local: Vec<f64> = self.shape.columns.iter().map(|c| step[*c]).collect();
        let mean: f64 = self.mean_row.iter().zip(&local).map(|(a, b)| a * b).sum();
        self.shape
            .rows
            .iter()
            .zip(&self.misclosure)
            .map(|(row, l)| l + row.iter().map(|(column, value)| value * local[*column]).sum::<f64>() - mean)
            .collect()
    }

    /// Variance of each end's computed value (less the mean) by the cofactors of the unknowns \[m²\].
    #[must_use]
    pub fn projected(&self, inverse: &DMatrix<f64>) -> Vec<f64> {
        let cofactor = |a: usize, b: usize| inverse[(self.shape.columns[a], self.shape.columns[b])];
        let n = self.shape.columns.len();
        let of_mean: Vec<f64> =
            (0..n).map(|a| (0..n).map(|b| cofactor(a, b) * self.mean_row[b]).sum::<f64>()).collect();
        let mean: f64 = self.mean_row.iter().zip(&of_mean).map(|(a, b)| a * b).sum();
        self.shape
            .rows
            .iter()
            .map(|row| {
                let own: f64 =
                    row.iter().map(|(a, x)| row.iter().map(|(b, y)| x * y * cofactor(*a, *b)).sum::<f64>()).sum();
                let cross: f64 = row.iter().map(|(a, x)| x * of_mean[*a]).sum();
                (own - 2.0 * cross + mean).max(0.0)
            })
            .collect()
    }

    /// Lower triangle of the small normal matrix and its right-hand side.
    ///
    /// `Σ w (J - m)ᵀ (J - m) = Σ w Jᵀ J - W mᵀ m`: the rows stay sparse.
    fn normal(&self) -> (DMatrix<f64>, Vec<f64>) {
        let n = self.shape.columns.len();
        let mut normal = DMatrix::zeros(n, n);
        let mut right = vec![0.0; n];
        let total: f64 = self.weights.iter().sum();
        for ((row, l), w) in self.shape.rows.iter().zip(&self.misclosure).zip(&self.weights) {
            for (k, (a, x)) in row.iter().enumerate() {
                right[*a] += x * w * l; // Σ w l = 0, so that the mean row adds nothing
                for (b, y) in &row[k..] {
                    normal[(*b, *a)] += x * y * w;
                }
            }
        }
        for a in 0..n {
            let x = self.mean_row[a] * total;
            for b in a..n {
                normal[(b, a)] -= x * self.mean_row[b];
            }
        }
        (normal, right)
    }
}

/// The pattern of the normal matrix and its symbolic factorisation, for lines that stay the same.
#[derive(Debug, Clone)]
pub struct Pattern {
    size: usize,
    column_start: Vec<usize>,
    row_index: Vec<usize>,
    symbolic: SymbolicLlt<usize>,
}

/// The normal matrix could not be factorised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the normal equations of {unknowns} unknowns cannot be factorised; a prior sigma or an observation is not a finite, positive number"
)]
pub struct NotPositiveDefinite {
    /// Number of unknowns.
    pub unknowns: usize,
}

/// A factorised normal matrix, in prior units.
#[derive(Debug, Clone)]
pub struct Factor {
    llt: Llt<usize, f64>,
    size: usize,
}

/// Lines whose small normal matrices are held at a time.
const BATCH: usize = 128;

fn one_thread_in_faer() {
    static ONCE: Once = Once::new();
    // Bits must not depend on the number of threads; our systems are small and the assembly is parallel.
    ONCE.call_once(|| faer::set_global_parallelism(Par::Seq));
}

impl Pattern {
    /// The pattern of `size` unknowns coupled as in the given lines.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] when the symbolic factorisation fails (out of memory).
    pub fn new<'a>(size: usize, lines: impl Iterator<Item = &'a [usize]>) -> Result<Self, NotPositiveDefinite> {
        one_thread_in_faer();
        let mut below: Vec<Vec<usize>> = (0..size).map(|i| vec![i]).collect();
        let mut last: Vec<usize> = Vec::new();
        for columns in lines {
            if columns == last {
                continue;
            }
            last = columns.to_vec();
            for (k, column) in columns.iter().enumerate() {
                let rows = &mut below[*column];
                rows.extend_from_slice(&columns[k..]);
                if rows.len() > 4 * size + 64 {
                    rows.sort_unstable();
                    rows.dedup();
                }
            }
        }
        let mut column_start = vec![0];
        let mut row_index = Vec::new();
        for mut rows in below {
            rows.sort_unstable();
            rows.dedup();
            row_index.extend(rows);
            column_start.push(row_index.len());
        }
        let failed = NotPositiveDefinite { unknowns: size };
        let matrix = SymbolicSparseColMat::new_checked(size, size, column_start.clone(), None, row_index.clone());
        let symbolic = SymbolicLlt::try_new(matrix.as_ref(), Side::Lower).map_err(|_| failed)?;
        Ok(Self { size, column_start, row_index, symbolic })
    }

    /// Sums the lines and the prior (identity), in the order of the lines; `b` is the right-hand side
    /// `-(Jᵀ W l) - prior`.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn factorise(
        &self,
        lines: &[Reduced<'_>],
        prior_state: &DVector<f64>,
    ) -> Result<(Factor, DVector<f64>), NotPositiveDefinite> {
        let mut values = vec![0.0; self.row_index.len()];
        let mut right = -prior_state.clone();
        for column in 0..self.size {
            values[self.column_start[column]] = 1.0; // the diagonal comes first in a lower column
        }
        for batch in lines.chunks(BATCH) {
            let parts: Vec<_> = batch.par_iter().map(|line| line.normal()).collect();
            for (line, (normal, b)) in batch.iter().zip(parts) {
                self.scatter(line.columns(), &normal, &mut values);
                for (k, column) in line.columns().iter().enumerate() {
                    right[*column] -= b[k];
                }
            }
        }
        let failed = NotPositiveDefinite { unknowns: self.size };
        if values.iter().any(|v| !v.is_finite()) {
            return Err(failed);
        }
        let pattern = SymbolicSparseColMat::new_checked(
            self.size,
            self.size,
            self.column_start.clone(),
            None,
            self.row_index.clone(),
        );
        let matrix = SparseColMat::new(pattern, values);
        let llt =
            Llt::try_new_with_symbolic(self.symbolic.clone(), matrix.as_ref(), Side::Lower).map_err(|_| failed)?;
        Ok((Factor { llt, size: self.size }, right))
    }

    fn scatter(&self, columns: &[usize], normal: &DMatrix<f64>, values: &mut [f64]) {
        for (k, column) in columns.iter().enumerate() {
            let (start, end) = (self.column_start[*column], self.column_start[*column + 1]);
            let rows = &self.row_index[start..end];
            let walk = rows.len() < 8 * (columns.len() - k);
            let mut position = 0;
            for (m, row) in columns.iter().enumerate().skip(k) {
                if walk {
                    while rows[position] < *row {
                        position += 1;
                    }
                } else {
                    position += rows[position..].partition_point(|r| r < row);
                }
                values[start + position] += normal[(m, k)];
            }
        }
    }
}

impl Factor {
    /// Solves for one right-hand side.
    #[must_use]
    pub fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let b = Mat::from_fn(self.size, 1, |i, _| right[i]);
        let x = self.llt.solve(&b);
        DVector::from_fn(self.size, |i, _| x[(i, 0)])
    }

    /// The inverse of the normal matrix (dense; `size²` numbers).
    #[must_use]
    pub fn inverse(&self) -> DMatrix<f64> {
        let identity = Mat::<f64>::identity(self.size, self.size);
        let x = self.llt.solve(&identity);
        DMatrix::from_fn(self.size, self.size, |i, j| 0.5 * (x[(i, j)] + x[(j, i)]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dense oracle with the landmark kept as an unknown.
    fn dense(rows: &[Vec<(usize, f64)>], l: &[f64], w: &[f64], n: usize) -> DVector<f64> {
        let mut normal = DMatrix::identity(n + 1, n + 1);
        normal[(n, n)] = 0.0;
        let mut right = DVector::zeros(n + 1);
        for ((row, l), w) in rows.iter().zip(l).zip(w) {
            let mut full = DVector::zeros(n + 1);
            for (i, v) in row {
                full[*i] = *v;
            }
            full[n] = -1.0;
            normal += &full * full.transpose() * *w;
            right -= &full * (l * w);
        }
        normal.lu().solve(&right).expect("regular").rows(0, n).into_owned()
    }

    #[test]
    fn eliminating_the_landmark_changes_nothing() {
        let rows = vec![vec![(0, 1.0), (2, 0.5)], vec![(1, -0.7), (2, 2.0)], vec![(3, 1.0)]];
        let (l, w) = ([0.3, -0.1, 0.2], [1.0, 4.0, 2.5]);
        let shape = Shape::new(&rows, &[1.0; 4]);
        let line = Reduced::new(&shape, &l, &w);
        let pattern = Pattern::new(4, std::iter::once(line.columns())).expect("small");
        let (factor, right) = pattern.factorise(&[line], &DVector::zeros(4)).expect("regular");
        let difference = factor.solve(&right) - dense(&rows, &l, &w, 4);
        assert!(difference.norm() < 1e-14, "{difference}");
        let product = factor.inverse() * &right - factor.solve(&right);
        assert!(product.norm() < 1e-14);
    }
}
