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

/// One line with its landmark eliminated: unknowns, design rows and misclosures about their weighted means.
#[derive(Debug, Clone)]
pub struct Reduced {
    /// Sorted indices of the unknowns in the line.
    pub columns: Vec<usize>,
    /// Design rows of the ends (ends × columns), in prior units, less their weighted mean.
    pub design: DMatrix<f64>,
    /// Misclosures \[m\], less their weighted mean.
    pub misclosure: DVector<f64>,
    /// Weights \[1/m²\].
    pub weights: Vec<f64>,
}

impl Reduced {
    /// Eliminates the landmark of a line. `rows` are those of [`crate::Model::row`], `scale` the prior sigmas.
    ///
    /// With weights w the offset of the surface is `D = Σ w (l + J x) / Σ w`; what remains are deviations from the
    /// weighted mean (the Schur complement of the landmark).
    #[must_use]
    pub fn new(rows: &[Vec<(usize, f64)>], misclosure: &[f64], weights: &[f64], scale: &[f64]) -> Self {
        let mut columns: Vec<usize> = rows.iter().flatten().map(|(index, _)| *index).collect();
        columns.sort_unstable();
        columns.dedup();
        let mut design = DMatrix::zeros(rows.len(), columns.len());
        for (i, row) in rows.iter().enumerate() {
            for (index, value) in row {
                let column = columns.partition_point(|c| c < index);
                design[(i, column)] += value * scale[*index];
            }
        }
        let total: f64 = weights.iter().sum();
        let mut misclosure = DVector::from_column_slice(misclosure);
        if total > 0.0 {
            for mut column in design.column_iter_mut() {
                let mean = column.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() / total;
                column.add_scalar_mut(-mean);
            }
            let mean = misclosure.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() / total;
            misclosure.add_scalar_mut(-mean);
        }
        Self { columns, design, misclosure, weights: weights.to_vec() }
    }

    fn normal(&self) -> (DMatrix<f64>, DVector<f64>) {
        let mut weighted = self.design.clone();
        for (mut row, w) in weighted.row_iter_mut().zip(&self.weights) {
            row *= *w;
        }
        (weighted.tr_mul(&self.design), weighted.tr_mul(&self.misclosure))
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
        lines: &[Reduced],
        prior_state: &DVector<f64>,
    ) -> Result<(Factor, DVector<f64>), NotPositiveDefinite> {
        let mut values = vec![0.0; self.row_index.len()];
        let mut right = -prior_state.clone();
        for column in 0..self.size {
            values[self.column_start[column]] = 1.0; // the diagonal comes first in a lower column
        }
        for batch in lines.chunks(BATCH) {
            let parts: Vec<_> = batch.par_iter().map(Reduced::normal).collect();
            for (line, (normal, b)) in batch.iter().zip(parts) {
                self.scatter(&line.columns, &normal, &mut values);
                for (k, column) in line.columns.iter().enumerate() {
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
        let line = Reduced::new(&rows, &l, &w, &[1.0; 4]);
        let pattern = Pattern::new(4, std::iter::once(line.columns.as_slice())).expect("small");
        let (factor, right) = pattern.factorise(&[line], &DVector::zeros(4)).expect("regular");
        let difference = factor.solve(&right) - dense(&rows, &l, &w, 4);
        assert!(difference.norm() < 1e-14, "{difference}");
        let product = factor.inverse() * &right - factor.solve(&right);
        assert!(product.norm() < 1e-14);
    }
}
