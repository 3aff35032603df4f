//! GNSS baselines: differences of points in space with their covariance, alone or in correlated clusters.

use nalgebra::{DMatrix, Matrix3, Vector3};

use super::{Factor, NotPositiveDefinite, put, square_root};
use crate::variable::{Values, VariableId};

/// One baseline.
#[derive(Debug, Clone)]
pub struct Baseline {
    ids: [VariableId; 2],
    measured_m: Vector3<f64>,
    root: Matrix3<f64>,
}

impl Baseline {
    /// `ids`: from, to; `covariance` \[m²\].
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        ids: [VariableId; 2],
        measured_m: Vector3<f64>,
        covariance: &Matrix3<f64>,
    ) -> Result<Self, NotPositiveDefinite> {
        let inverse = nalgebra::Cholesky::new(*covariance).ok_or(NotPositiveDefinite)?.inverse();
        Ok(Self { ids, measured_m, root: square_root(&inverse)? })
    }
    /// What was measured, from the first to the second \[m\].
    #[must_use]
    pub fn measured_m(&self) -> Vector3<f64> {
        self.measured_m
    }
}

impl Factor for Baseline {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        3
    }
    fn label(&self) -> &'static str {
        "baseline"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let d = values.xyz(self.ids[1]) - values.xyz(self.ids[0]) - self.measured_m;
        residual.copy_from_slice((self.root * d).as_slice());
        if let Some(jacobian) = jacobian {
            put(jacobian, 6, 0, &-self.root);
            put(jacobian, 6, 3, &self.root);
        }
    }
}

/// Baselines or points that are correlated with each other: a cluster.
#[derive(Debug, Clone)]
pub struct Cluster {
    ids: Vec<VariableId>,
    /// Index in `ids` of start (none: a known point) and end.
    ends: Vec<(Option<usize>, usize)>,
    measured_m: Vec<f64>,
    /// Whitening matrix, lower triangle, row by row: `rows²`.
    root: Vec<f64>,
}

impl Cluster {
    /// Each member: start (none: the coordinates themselves were measured), end, measured values \[m\]; the covariance
    /// of all of them \[m²\].
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        members: &[(Option<VariableId>, VariableId, Vector3<f64>)],
        covariance: &DMatrix<f64>,
    ) -> Result<Self, NotPositiveDefinite> {
        let n = covariance.nrows();
        let lower = covariance.clone().cholesky().ok_or(NotPositiveDefinite)?.unpack();
        let root = lower.solve_lower_triangular(&DMatrix::identity(n, n)).ok_or(NotPositiveDefinite)?;
        let mut ids: Vec<VariableId> = Vec::new();
        let mut index = |id: VariableId| {
            ids.iter().position(|i| *i == id).unwrap_or_else(|| {
                ids.push(id);
                ids.len() - 1
            })
        };
        let ends = members.iter().map(|(a, b, _)| (a.map(&mut index), index(*b))).collect();
        let measured_m = members.iter().flat_map(|m| [m.2.x, m.2.y, m.2.z]).collect();
        Ok(Self { ids, ends, measured_m, root: root.transpose().as_slice().to_vec() })
    }
}

impl Factor for Cluster {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        self.measured_m.len()
    }
    fn label(&self) -> &'static str {
        "cluster"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let n = self.rows();
        let mut plain = vec![0.0; n];
        for (k, (start, end)) in self.ends.iter().enumerate() {
            let d = values.xyz(self.ids[*end]) - start.map_or_else(Vector3::zeros, |s| values.xyz(self.ids[s]));
            for c in 0..3 {
                plain[3 * k + c] = d[c] - self.measured_m[3 * k + c];
            }
        }
        for (r, out) in residual.iter_mut().enumerate() {
            *out = self.root[r * n..r * n + r + 1].iter().zip(&plain).map(|(a, b)| a * b).sum();
        }
        if let Some(jacobian) = jacobian {
            let columns = 3 * self.ids.len();
            for r in 0..n {
                for (k, (start, end)) in self.ends.iter().enumerate() {
                    for c in (0..3).filter(|c| 3 * k + c <= r) {
                        let weight = self.root[r * n + 3 * k + c];
                        jacobian[r * columns + 3 * end + c] += weight;
                        if let Some(start) = start {
                            jacobian[r * columns + 3 * start + c] -= weight;
                        }
                    }
                }
            }
        }
    }
}
