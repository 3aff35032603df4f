//! Small nets whose datum may be free: the defect found, inner constraints, all covariances.
//!
//! The null space `E` of the normal equations (scaled to a unit diagonal) is the datum defect. With the coordinates
//! that carry the datum (`S`), the bordered equations `[N B; Bᵀ 0]`, `B = S E`, have the solution whose corrections of
//! these coordinates are orthogonal to the defect, and its cofactors (Meissl 1969; Caspary 2000, ch. 4).

use nalgebra::{DMatrix, DVector};

use crate::linear::blocks::Normal;
use crate::problem::Problem;
use crate::robust::Kernel;
use crate::system::{Method, Order, System, SystemError};
use crate::variable::VariableId;

/// Most unknowns of a net that is solved densely.
pub const MOST_UNKNOWNS: usize = 4000;
/// Eigenvalues of the scaled normal equations below this are the defect.
const DEFECT: f64 = 1e-10;

/// A solved small net.
#[derive(Debug, Clone)]
pub struct FreeNet {
    /// Datum defect.
    pub defect: usize,
    /// Iterations.
    pub iterations: usize,
    /// Sum of squares of whitened residuals.
    pub cost: f64,
    /// Observations less unknowns, plus the defect.
    pub degrees_of_freedom: i64,
    /// First scalar of each variable in the cofactors; none for held ones.
    pub scalar: Vec<Option<usize>>,
    /// Cofactors of all unknowns.
    pub cofactors: DMatrix<f64>,
}

/// Why a small net cannot be solved.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FreeNetError {
    /// As any system.
    #[error(transparent)]
    System(#[from] SystemError),
    /// Too large.
    #[error(
        "the datum of a net of {unknowns} unknowns is free; hold stations: free nets are solved up to {MOST_UNKNOWNS}"
    )]
    TooLarge {
        /// Unknowns.
        unknowns: usize,
    },
    /// The datum coordinates do not take up the defect.
    #[error(
        "the net is not determined by {defect} parameters, the first at `{name}`, and the coordinates that carry the datum do \
         not take them up: constrain more coordinates, or add observations"
    )]
    Datum {
        /// Defect.
        defect: usize,
        /// A variable that moves.
        name: String,
    },
    /// Not converged.
    #[error(
        "the net does not converge in {iterations} iterations; look for mistakes in its observations and coordinates"
    )]
    NotConverged {
        /// Iterations.
        iterations: usize,
    },
}

/// Solves a net in place. `datum`: the variables (and component) that carry the datum when it is free.
///
/// # Errors
/// [`FreeNetError`].
#[allow(clippy::cast_possible_wrap)]
pub fn solve(problem: &mut Problem, datum: &[(VariableId, usize)]) -> Result<FreeNet, FreeNetError> {
    let system = System::new(
        problem,
        Order::MinimumDegree,
        crate::helmert::partition::PartitionOptions::default(),
        Method::Helmert,
    )?;
    let n = system.scalars();
    if n > MOST_UNKNOWNS {
        return Err(FreeNetError::TooLarge { unknowns: n });
    }
    let start = problem.values.clone();
    let scalar: Vec<Option<usize>> = problem
        .variables()
        .map(|v| (!problem.is_fixed(v)).then(|| system.pattern.scalar[v.index()] as usize))
        .collect();
    let carries: Vec<(usize, VariableId, usize)> =
        datum.iter().filter_map(|(v, c)| scalar[v.index()].map(|s| (s + c, *v, *c))).collect();
    let mut last = f64::INFINITY;
    for iteration in 1..=50 {
        let (matrix, right, scale) = scaled(problem, &system);
        let null = null_space(&matrix);
        let defect = null.ncols();
        let border = border(&null, &scale, &carries);
        let cofactors = invert(&matrix, &border).ok_or_else(|| {
            let worst = (0..n).max_by(|a, b| null.row(*a).norm().total_cmp(&null.row(*b).norm())).unwrap_or(0);
            let id = system.variable_at(worst);
            FreeNetError::Datum { defect, name: problem.name(problem.host(id)) }
        })?;
        // the datum coordinates keep the sum of their corrections from the start on
        let mut offset = DVector::zeros(n);
        for (s, v, c) in &carries {
            offset[*s] = (problem.values.get(*v)[*c] - start.get(*v)[*c]) / scale[*s];
        }
        let inner = cofactors.view((0, 0), (n, n)).into_owned();
        let mut step = &inner * &right;
        if defect > 0 {
            step -= cofactors.view((0, n), (n, defect)) * (border.transpose() * offset);
        }
        for k in 0..n {
            step[k] *= scale[k];
        }
        let largest = step.amax();
        let mut moved = problem.values.clone();
        system.retract(problem, &mut moved, step.as_slice(), 1.0);
        problem.values = moved;
        // steps no longer shrink when rounding is all that is left of them
        if largest < 1e-9 || (largest < 1e-6 && largest > 0.5 * last) {
            let cofactors = DMatrix::from_fn(n, n, |r, c| inner[(r, c)] * scale[r] * scale[c]);
            let cost = problem.cost(&problem.values, &Kernel::None);
            let freedom = problem.residual_count() as i64 - n as i64 + defect as i64;
            return Ok(FreeNet { defect, iterations: iteration, cost, degrees_of_freedom: freedom, scalar, cofactors });
        }
        last = largest;
    }
    Err(FreeNetError::NotConverged { iterations: 50 })
}

/// Normal equations as a dense matrix, in the order of elimination, and their right-hand side.
pub(crate) fn dense_normal(problem: &Problem, system: &System) -> (DMatrix<f64>, Vec<f64>) {
    let n = system.scalars();
    let mut normal = Normal::default();
    system.pattern.assemble(problem, &problem.values, &Kernel::None, &mut normal);
    let mut matrix = DMatrix::zeros(n, n);
    system.pattern.each(&normal.numbers, |row, column, value| matrix[(row, column)] = value);
    (matrix, normal.right)
}

/// Normal equations scaled to a unit diagonal, right-hand side, and the scale.
fn scaled(problem: &Problem, system: &System) -> (DMatrix<f64>, DVector<f64>, Vec<f64>) {
    let (matrix, right) = dense_normal(problem, system);
    let scale: Vec<f64> = matrix.diagonal().iter().map(|d| if *d > 0.0 { 1.0 / d.sqrt() } else { 1.0 }).collect();
    let n = scale.len();
    let matrix = DMatrix::from_fn(n, n, |r, c| matrix[(r, c)] * scale[c] * scale[r]);
    let right = DVector::from_fn(n, |r, _| right[r] * scale[r]);
    (matrix, right, scale)
}

/// Eigenvectors of eigenvalues that are zero.
fn null_space(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let n = matrix.nrows();
    // a Cholesky factor tells at once that there is no defect
    if let Some(factor) = matrix.clone().cholesky()
        && factor.l().diagonal().iter().all(|d| *d > 1e-4)
    {
        return DMatrix::zeros(n, 0);
    }
    let eigen = matrix.clone().symmetric_eigen();
    let largest = eigen.eigenvalues.amax();
    let zero: Vec<usize> = (0..n).filter(|k| eigen.eigenvalues[*k] < DEFECT * largest).collect();
    DMatrix::from_fn(n, zero.len(), |r, c| eigen.eigenvectors[(r, zero[c])])
}

/// The defect's vectors on the datum coordinates, in scaled unknowns.
fn border(null: &DMatrix<f64>, scale: &[f64], carries: &[(usize, VariableId, usize)]) -> DMatrix<f64> {
    // constraints are on metres: x = scale · y, and E_x = scale · E_y
    let mut border = DMatrix::zeros(null.nrows(), null.ncols());
    for (s, _, _) in carries {
        for c in 0..null.ncols() {
            border[(*s, c)] = null[(*s, c)] * scale[*s] * scale[*s];
        }
    }
    // columns of one size keep the equations well conditioned
    for mut column in border.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    border
}

/// Inverse of the bordered equations; none when they are singular.
fn invert(matrix: &DMatrix<f64>, border: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let (n, d) = (matrix.nrows(), border.ncols());
    if d == 0 {
        return matrix.clone().cholesky().map(|c| c.inverse());
    }
    let mut bordered = DMatrix::zeros(n + d, n + d);
    bordered.view_mut((0, 0), (n, n)).copy_from(matrix);
    bordered.view_mut((0, n), (n, d)).copy_from(border);
    bordered.view_mut((n, 0), (d, n)).copy_from(&border.transpose());
    let inverse = bordered.clone().lu().try_inverse()?;
    // a border that leaves part of the defect gives an inverse of rounding errors
    let check = (&bordered * &inverse - DMatrix::identity(n + d, n + d)).amax();
    (check < 1e-5 && inverse.iter().all(|v| v.is_finite())).then_some(inverse)
}
