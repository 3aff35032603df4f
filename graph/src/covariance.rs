//! Covariances of all variables and redundancies of all observations, by the selected inverse down the tree.

use nalgebra::{DMatrix, DVector};

use crate::factor::Factor;
use crate::helmert::inverse::{BlockInverse, visit_inverse, whole_inverse};
use crate::linear::blocks::Normal;
use crate::linear::nodes::NO_NODE;
use crate::problem::Problem;
use crate::robust::Kernel;
use crate::system::{System, SystemError};
use crate::variable::VariableId;

/// Covariance of every variable with itself, in its tangent.
#[derive(Debug, Clone, Default)]
pub struct Covariances {
    starts: Vec<usize>,
    numbers: Vec<f64>,
    /// For every factor, if asked for: how it is checked by the others.
    pub checks: Vec<Check>,
}

/// How one observation is checked by the others (Baarda 1968), by whitened residuals.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// Whitened residuals.
    pub residuals: Vec<f64>,
    /// Redundancy numbers: the share of an error in a row that shows in its residual.
    pub redundancies: Vec<f64>,
    /// Largest standard deviation by which an undetected error of a row moves an unknown, in sigmas of that unknown:
    /// external reliability with the non-centrality of 4.13 (power 80 %, level 0.1 %).
    pub external: Vec<f64>,
}

/// Non-centrality of Baarda's test at a power of 80 % and a level of 0.1 %.
pub const NON_CENTRALITY: f64 = 4.13;

impl Check {
    /// Test values `w = |v| / √r` of the rows; nothing for a row without redundancy.
    #[must_use]
    pub fn tests(&self) -> Vec<Option<f64>> {
        let pairs = self.residuals.iter().zip(&self.redundancies);
        pairs.map(|(v, r)| (*r > 1e-6).then(|| v.abs() / r.sqrt())).collect()
    }
}

impl Covariances {
    /// Covariance of a variable; zeros when it is held.
    #[must_use]
    pub fn of(&self, id: VariableId) -> DMatrix<f64> {
        let (start, end) = (self.starts[id.index()], self.starts[id.index() + 1]);
        let mut n = 0;
        while n * n < end - start {
            n += 1;
        }
        DMatrix::from_column_slice(n, n, &self.numbers[start..end])
    }
    /// Normalised square of an error of a variable, `eᵀ P⁻¹ e` (NEES): in the mean its number of unknowns, if the
    /// covariance is true. `None` when the variable is held.
    #[must_use]
    pub fn normalised_square(&self, id: VariableId, error: &[f64]) -> Option<f64> {
        let error = DVector::from_column_slice(error);
        self.of(id).cholesky().map(|c| error.dot(&c.solve(&error)))
    }
    /// Standard deviations of a variable.
    #[must_use]
    pub fn sigmas(&self, id: VariableId) -> Vec<f64> {
        self.of(id).diagonal().iter().map(|v| v.max(0.0).sqrt()).collect()
    }
}

/// Covariances at the values of a problem; with `checks`, redundancies too. Factorises anew.
///
/// # Errors
/// [`SystemError`].
pub fn covariances(
    problem: &Problem,
    system: &mut System,
    kernel: &Kernel,
    checks: bool,
) -> Result<Covariances, SystemError> {
    let mut normal = Normal::default();
    system.pattern.assemble(problem, &problem.values, kernel, &mut normal);
    let mut right = normal.right.clone();
    system.solve(problem, &normal.numbers, &mut right)?;
    drop(normal);
    drop(right);
    selected(problem, system, checks)
}

/// Covariances with the factorisation that the system has.
///
/// # Errors
/// [`SystemError`].
pub fn selected(problem: &Problem, system: &System, checks: bool) -> Result<Covariances, SystemError> {
    let mut result = Covariances::default();
    result.starts.push(0);
    for id in problem.variables() {
        let n = problem.values.kind(id).dimension();
        result.starts.push(result.starts[id.index()] + n * n);
    }
    result.numbers = vec![0.0; result.starts[problem.values.len()]];
    let mut of_scalar: Vec<(u32, VariableId)> =
        problem.variables().filter(|v| !problem.is_fixed(*v)).map(|v| (system.pattern.scalar[v.index()], v)).collect();
    of_scalar.sort_unstable_by_key(|(s, _)| *s);
    let list: Vec<&dyn Factor> = if checks { problem.factors().collect() } else { Vec::new() };
    result.checks = vec![Check { residuals: vec![], redundancies: vec![], external: vec![] }; list.len()];
    let tree = &system.tree;
    let (numbers, starts, found) = (&mut result.numbers, &result.starts, &mut result.checks);
    visit(
        problem,
        system,
        checks,
        |index, inverse| {
            let block = &tree.blocks[index];
            let first = tree.scalar_start[block.first as usize];
            let end = tree.scalar_start[block.end as usize];
            let from = of_scalar.partition_point(|(s, _)| *s < first);
            for (scalar, id) in of_scalar[from..].iter().take_while(|(s, _)| *s < end) {
                let n = problem.values.kind(*id).dimension();
                let local = (scalar - first) as usize;
                let target = &mut numbers[starts[id.index()]..starts[id.index()] + n * n];
                for c in 0..n {
                    for r in 0..n {
                        target[c * n + r] = inverse.at(local + r, local + c);
                    }
                }
            }
        },
        |number, joint| found[number] = check(problem, joint, list[number]),
    )?;
    for (number, factor) in list.iter().enumerate() {
        if result.checks[number].residuals.is_empty() {
            let mut residuals = vec![0.0; factor.rows()];
            factor.evaluate(&problem.values, &mut residuals, None);
            let redundancies = vec![1.0; residuals.len()];
            let external = vec![0.0; residuals.len()];
            result.checks[number] = Check { residuals, redundancies, external };
        }
    }
    Ok(result)
}

/// The covariance of all free variables of a problem, with the factorisation that the system has: row and column of a
/// variable's tangent start at `system.pattern.scalar[variable]`. For a few thousand unknowns.
///
/// # Errors
/// [`SystemError`].
pub fn whole(system: &System) -> Result<DMatrix<f64>, SystemError> {
    let z = whole_inverse(&system.tree, |block| system.panel(block))?;
    Ok(DMatrix::from_fn(z.nrows(), z.ncols(), |r, c| z[(r, c)]))
}

/// Covariance of the variables of one factor, their tangents side by side; held ones have none.
#[derive(Debug)]
pub struct Joint<'a> {
    inverse: &'a BlockInverse,
    local: Vec<Option<usize>>,
}

impl Joint<'_> {
    /// Columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.local.len()
    }
    /// Covariance of two columns.
    #[must_use]
    #[inline]
    pub fn at(&self, a: usize, b: usize) -> f64 {
        match (self.local[a], self.local[b]) {
            (Some(a), Some(b)) => self.inverse.at(a, b),
            _ => 0.0,
        }
    }
    /// Product with a vector.
    #[must_use]
    pub fn times(&self, vector: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; self.local.len()];
        for (b, v) in vector.iter().enumerate() {
            let Some(lb) = self.local[b].filter(|_| *v != 0.0) else { continue };
            for (p, la) in product.iter_mut().zip(&self.local) {
                if let Some(la) = la {
                    *p += v * self.inverse.at(*la, lb);
                }
            }
        }
        product
    }
}

/// Hands the joint covariance of every factor with a free variable to `visit_factor`, by the factor's number, with the
/// factorisation that the system has; in the order of the blocks.
///
/// # Errors
/// [`SystemError`].
pub fn visit_factors(
    problem: &Problem,
    system: &System,
    visit_factor: impl FnMut(usize, &Joint<'_>),
) -> Result<(), SystemError> {
    visit(problem, system, true, |_, _| {}, visit_factor)
}

fn visit(
    problem: &Problem,
    system: &System,
    with_factors: bool,
    mut visit_block: impl FnMut(usize, &BlockInverse),
    mut visit_factor: impl FnMut(usize, &Joint<'_>),
) -> Result<(), SystemError> {
    let tree = &system.tree;
    let factors = if with_factors { by_block(problem, system) } else { Vec::new() };
    let list: Vec<&dyn Factor> = if with_factors { problem.factors().collect() } else { Vec::new() };
    visit_inverse(
        tree,
        |block| system.panel(block),
        |index, inverse| {
            visit_block(index, inverse);
            let from = factors.partition_point(|(b, _)| *b < index);
            let offsets = if with_factors { tree.boundary_offsets(index) } else { Vec::new() };
            for (_, factor) in factors[from..].iter().take_while(|(b, _)| *b == index) {
                let local = local_columns(problem, system, index, &offsets, list[*factor]);
                visit_factor(*factor, &Joint { inverse, local });
            }
        },
    )?;
    Ok(())
}

/// Block of the first-eliminated variable of every factor with a free one, sorted by block.
fn by_block(problem: &Problem, system: &System) -> Vec<(usize, usize)> {
    let mut list: Vec<(usize, usize)> = problem
        .factors()
        .enumerate()
        .filter_map(|(number, factor)| {
            let position = factor.variables().iter().map(|v| system.pattern.position(*v)).min()?;
            (position != NO_NODE).then(|| (system.tree.block_of(position), number))
        })
        .collect();
    list.sort_unstable();
    list
}

/// Place of every column of a factor in a block's front; nothing for held variables.
fn local_columns(
    problem: &Problem,
    system: &System,
    index: usize,
    offsets: &[u32],
    factor: &dyn Factor,
) -> Vec<Option<usize>> {
    let tree = &system.tree;
    let block = &tree.blocks[index];
    let first = tree.scalar_start[block.first as usize];
    let mut local = Vec::new();
    for id in factor.variables() {
        let n = problem.values.kind(*id).dimension();
        let position = system.pattern.position(*id);
        let start = (position != NO_NODE).then(|| {
            let scalar = system.pattern.scalar[id.index()];
            if position < block.end {
                (scalar - first) as usize
            } else {
                let k = tree.boundary(index).partition_point(|q| *q < position);
                (offsets[k] + scalar - tree.scalar_start[position as usize]) as usize
            }
        });
        local.extend((0..n).map(|k| start.map(|s| s + k)));
    }
    local
}

fn check(problem: &Problem, joint: &Joint<'_>, factor: &dyn Factor) -> Check {
    let (rows, columns) = (factor.rows(), joint.columns());
    let (mut residuals, mut jacobian) = (vec![0.0; rows], vec![0.0; rows * columns]);
    factor.evaluate(&problem.values, &mut residuals, Some(&mut jacobian));
    let mut redundancies = Vec::with_capacity(rows);
    let mut external = Vec::with_capacity(rows);
    for row in jacobian.chunks_exact(columns.max(1)) {
        let moved = joint.times(row);
        let computed: f64 = moved.iter().zip(row).map(|(m, v)| m * v).sum();
        let redundancy = 1.0 - computed;
        redundancies.push(redundancy);
        // an undetected error of 4.13 / √r sigmas moves the unknowns by that times Σ aᵀ
        let free = (0..columns).filter(|c| joint.local[*c].is_some());
        let largest = free.map(|c| moved[c].abs() / joint.at(c, c).sqrt()).fold(0.0, f64::max);
        external.push(NON_CENTRALITY / redundancy.max(1e-12).sqrt() * largest);
    }
    Check { residuals, redundancies, external }
}
