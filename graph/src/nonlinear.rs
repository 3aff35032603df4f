//! Gauss-Newton with step control, Levenberg-Marquardt where it does not lower the cost.

use std::time::Instant;

use crate::helmert::partition::PartitionOptions;
use crate::linear::blocks::Normal;
use crate::problem::Problem;
use crate::robust::Kernel;
use crate::system::{Method, Order, System, SystemError};
use crate::variable::Values;

/// Settings of the adjustment.
#[derive(Debug, Clone)]
pub struct SolveOptions {
    /// How the normal equations are solved.
    pub method: Method,
    /// Where the order of elimination comes from.
    pub order: Order,
    /// How the graph is cut.
    pub partition: PartitionOptions,
    /// Kernel of ties.
    pub kernel: Kernel,
    /// Most iterations.
    pub iterations: usize,
    /// Relative change of the cost that a step is expected to bring, below which it is the last.
    pub cost_tolerance: f64,
    /// Damping at the start, as a share of the diagonal; 0: Gauss-Newton.
    pub damping: f64,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self {
            method: Method::Helmert,
            order: Order::Automatic,
            partition: PartitionOptions::default(),
            kernel: Kernel::None,
            iterations: 100,
            cost_tolerance: 1e-8,
            damping: 0.0,
        }
    }
}

impl SolveOptions {
    /// Whether the method is the reference, which keeps no blocks.
    #[must_use]
    pub fn method_is_reference(&self) -> bool {
        matches!(self.method, Method::Cholesky)
    }
}

/// What an adjustment did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solved {
    /// Sum of squares of whitened residuals at the end, ties through the kernel.
    pub cost: f64,
    /// The same at the start.
    pub first_cost: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Whether a tolerance was reached.
    pub converged: bool,
    /// Observations less unknowns.
    pub degrees_of_freedom: i64,
    /// Seconds for orders and patterns.
    pub order_s: f64,
    /// Seconds for factorisations.
    pub factor_s: f64,
    /// Seconds for forming normal equations.
    pub assemble_s: f64,
    /// Seconds for substitutions.
    pub substitute_s: f64,
    /// Seconds in all.
    pub total_s: f64,
}

impl Solved {
    /// This run and one after it as one.
    #[must_use]
    #[allow(clippy::needless_pass_by_value)] // what follows takes its place
    pub fn then(self, next: Self) -> Self {
        Self {
            first_cost: self.first_cost,
            iterations: self.iterations + next.iterations,
            factor_s: self.factor_s + next.factor_s,
            assemble_s: self.assemble_s + next.assemble_s,
            substitute_s: self.substitute_s + next.substitute_s,
            total_s: self.total_s + next.total_s,
            ..next
        }
    }
}

/// Adjusts a problem in place.
///
/// # Errors
/// [`SystemError`].
pub fn solve(problem: &mut Problem, options: &SolveOptions) -> Result<Solved, SystemError> {
    let mut system = System::new(problem, options.order, options.partition, options.method.clone())?;
    let mut solved = solve_system(problem, &mut system, options)?;
    solved.total_s += system.order_s;
    Ok(solved)
}

/// Adjusts a problem that has been made ready.
///
/// # Errors
/// [`SystemError`].
pub fn solve_system(problem: &mut Problem, system: &mut System, options: &SolveOptions) -> Result<Solved, SystemError> {
    // taken out, not copied: large nets are many numbers
    let mut values = std::mem::take(&mut problem.values);
    let solved = iterate(problem, &mut values, system, options);
    problem.values = values;
    solved
}

#[allow(clippy::cast_possible_wrap)]
fn iterate(
    problem: &Problem,
    values: &mut Values,
    system: &mut System,
    options: &SolveOptions,
) -> Result<Solved, SystemError> {
    let begin = Instant::now();
    let mut cost = problem.cost(values, &options.kernel);
    let mut solved = Solved {
        first_cost: cost,
        degrees_of_freedom: problem.residual_count() as i64 - system.scalars() as i64,
        order_s: system.order_s,
        ..Solved::default()
    };
    let mut damping = options.damping;
    let mut normal = Normal::default();
    let mut step = Vec::new();
    while solved.iterations < options.iterations {
        let formed = Instant::now();
        system.pattern.assemble(problem, values, &options.kernel, &mut normal);
        solved.assemble_s += formed.elapsed().as_secs_f64();
        let accepted = loop {
            step.clone_from(&normal.right);
            let damped = damped(system, &mut normal, damping);
            let result = system.solve(problem, &normal.numbers, &mut step);
            undo(system, &mut normal, damped.as_deref());
            match result {
                Ok((factor_s, substitute_s)) => {
                    solved.factor_s += factor_s;
                    solved.substitute_s += substitute_s;
                }
                // away from the optimum the equations of a good net may be near singular: damping is a step control
                Err(SystemError::NotDetermined { .. }) if solved.iterations > 0 && damping < 1e-3 => {
                    damping = (10.0 * damping).max(1e-6);
                    continue;
                }
                Err(error) => return Err(error),
            }
            let expected: f64 = step.iter().zip(&normal.right).map(|(s, r)| s * r).sum();
            let mut moved = values.clone();
            system.retract(problem, &mut moved, &step, 1.0);
            let new_cost = problem.cost(&moved, &options.kernel);
            let last = expected.abs() <= options.cost_tolerance * cost || expected.abs() < 1e-18;
            if new_cost <= cost || (last && new_cost <= cost * (1.0 + 1e-9) + 1e-18) {
                let small = cost - new_cost <= 1e-2 * options.cost_tolerance * cost;
                (*values, cost) = (moved, new_cost);
                damping = if damping < 1e-7 { 0.0 } else { 0.1 * damping };
                solved.converged = last || small && damping == 0.0;
                break true;
            }
            if last || damping > 1e12 {
                solved.converged = last;
                break false;
            }
            damping = if damping == 0.0 { 1e-5 } else { 10.0 * damping };
        };
        solved.iterations += 1;
        if solved.converged || !accepted {
            break;
        }
    }
    solved.cost = cost;
    solved.total_s = begin.elapsed().as_secs_f64();
    Ok(solved)
}

/// Adds a share of the diagonal; returns the diagonal as it was.
fn damped(system: &System, normal: &mut Normal, damping: f64) -> Option<Vec<f64>> {
    if damping == 0.0 {
        return None;
    }
    let diagonal = system.pattern.diagonal(&normal.numbers);
    let addition: Vec<f64> = diagonal.iter().map(|d| d * damping).collect();
    system.pattern.add_to_diagonal(&mut normal.numbers, &addition);
    Some(diagonal)
}

fn undo(system: &System, normal: &mut Normal, diagonal: Option<&[f64]>) {
    if let Some(diagonal) = diagonal {
        system.pattern.set_diagonal(&mut normal.numbers, diagonal);
    }
}
