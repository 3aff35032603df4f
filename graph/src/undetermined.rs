//! What the observations leave undetermined, named: combinations of unknowns that may move by more than a tolerance.
//!
//! A datum defect moves the whole net and costs nothing; the offset of a sensor that never turned hides in the map. Both
//! are directions of small eigenvalues of the normal equations, in units of what one would accept as error. With
//! `D` the tolerances and `D N D = Σ λ v vᵀ`, a direction is kept when it alone moves an unknown by more than its tolerance:
//! `max v²/λ > 1`. This holds in the presence of noise, where eigenvalues are small but never zero.
//! What is kept is brought to echelon form, global variables first, so that each combination has one unknown of its own.

use faer::{Mat, Side};

use crate::free_net::{MOST_UNKNOWNS, dense_normal};
use crate::helmert::partition::PartitionOptions;
use crate::problem::Problem;
use crate::system::{Method, Order, System, SystemError};
use crate::variable::{Kind, VariableId};

/// An unknown: a component of a variable's tangent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Member {
    /// The variable.
    pub variable: VariableId,
    /// Component of its tangent: of poses in the plane forward, left, heading.
    pub component: usize,
    /// How far it moves, in its tolerances, when the leading one moves by its own.
    pub share: f64,
}

/// A combination of unknowns that the observations do not determine.
#[derive(Debug, Clone, PartialEq)]
pub struct Undetermined {
    /// Standard deviation of the leading unknown, in its tolerances, in all that is undetermined; infinite when
    /// nothing at all holds it.
    pub sigma: f64,
    /// The leading unknown, then what moves with it, in the order of the variables.
    pub members: Vec<Member>,
}

impl Undetermined {
    /// The leading unknown.
    #[must_use]
    pub fn leading(&self) -> Member {
        self.members[0]
    }
    /// In words: the leading unknown and what moves with it.
    #[must_use]
    pub fn describe(&self, problem: &Problem) -> String {
        let word = |m: &Member| component_name(problem, m.variable, m.component);
        let with: Vec<String> = self.members[1..].iter().take(3).map(word).collect();
        let more = self.members.len().saturating_sub(4);
        let rest = match (with.is_empty(), more) {
            (true, _) => String::from(", alone"),
            (false, 0) => format!(", with {}", with.join(", ")),
            (false, _) => format!(", with {} and {more} more", with.join(", ")),
        };
        word(&self.leading()) + &rest
    }
}

/// Name of a variable and of one of its components.
#[must_use]
pub fn component_name(problem: &Problem, variable: VariableId, component: usize) -> String {
    let names: &[&str] = match problem.values.kind(variable) {
        Kind::Pose2 => &["forward", "left", "heading"],
        Kind::Pose3 => &["x", "y", "z", "rotation x", "rotation y", "rotation z"],
        Kind::Point2 | Kind::Point3 => &["x", "y", "z"],
        _ => &[],
    };
    let name = problem.name(variable);
    match (names.get(component), problem.values.kind(variable)) {
        (Some(of), _) => format!("{name} {of}"),
        (None, Kind::Vector(_)) => format!("{name} {component}"),
        (None, _) => name,
    }
}

/// Below this share of the largest an unknown does not belong to a combination.
const SHARE: f64 = 0.02;
/// An unknown may lead when it moves by this share of what moves most.
const MAY_LEAD: f64 = 0.1;

/// Combinations that the observations (priors among them) do not determine within tolerances, at the values of the
/// problem. `tolerance(variable, component)`: standard deviation that would just do, in the unit of the component.
///
/// Dense: up to [`MOST_UNKNOWNS`] unknowns.
///
/// # Errors
/// [`UndeterminedError`].
pub fn undetermined(
    problem: &Problem,
    tolerance: impl Fn(VariableId, usize) -> f64,
) -> Result<Vec<Undetermined>, UndeterminedError> {
    let system = System::new(problem, Order::MinimumDegree, PartitionOptions::default(), Method::Helmert)?;
    let n = system.scalars();
    if n > MOST_UNKNOWNS {
        return Err(UndeterminedError::TooLarge { unknowns: n });
    }
    let mut columns = Vec::with_capacity(n);
    for variable in problem.variables().filter(|v| !problem.is_fixed(*v)) {
        let first = system.pattern.scalar[variable.index()] as usize;
        let count = problem.values.kind(variable).dimension();
        columns.extend((0..count).map(|component| (first + component, variable, component)));
    }
    let (normal, _) = dense_normal(problem, &system);
    let scale: Vec<f64> = columns.iter().map(|(_, v, c)| tolerance(*v, *c)).collect();
    let scaled = Mat::from_fn(n, n, |r, c| normal[(columns[r].0, columns[c].0)] * scale[r] * scale[c]);
    let eigen = scaled.self_adjoint_eigen(Side::Lower).map_err(|_| UndeterminedError::NotFinite)?;
    let (values, vectors) = (eigen.S(), eigen.U());
    // what rounding leaves of zero
    let zero = values[n - 1].abs().max(values[0].abs()) * 1e-14 * (n as f64).sqrt();
    let mut variance = vec![0.0_f64; n];
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for k in (0..n).take_while(|k| values[*k] < 1.0) {
        let value = if values[k] <= zero { 0.0 } else { values[k] };
        let column: Vec<f64> = (0..n).map(|r| vectors[(r, k)]).collect();
        if column.iter().fold(0.0_f64, |m, v| m.max(v * v)) > value {
            variance.iter_mut().zip(&column).filter(|(_, v)| v.abs() > 1e-9).for_each(|(s, v)| *s += v * v / value);
            rows.push(column);
        }
    }
    let global: Vec<bool> = columns.iter().map(|(_, v, _)| problem.is_global(*v)).collect();
    let pivots = echelon(&mut rows, &global);
    let combinations = rows.iter().zip(&pivots).map(|(row, pivot)| {
        let largest = row.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let member = |c: usize| Member { variable: columns[c].1, component: columns[c].2, share: row[c] };
        let others = (0..n).filter(|c| c != pivot && row[*c].abs() > SHARE * largest);
        let members = std::iter::once(*pivot).chain(others).map(member).collect();
        Undetermined { sigma: variance[*pivot].sqrt(), members }
    });
    Ok(combinations.collect())
}

/// Brings rows to echelon form, the pivots 1; returns their columns. A pivot is the first column that may lead, among
/// those of global variables before the others.
fn echelon(rows: &mut [Vec<f64>], global: &[bool]) -> Vec<usize> {
    let mut pivots = Vec::with_capacity(rows.len());
    for k in 0..rows.len() {
        let size = |c: usize, rows: &[Vec<f64>]| rows[k..].iter().fold(0.0_f64, |m, row| m.max(row[c].abs()));
        let sizes: Vec<f64> = (0..global.len()).map(|c| size(c, rows)).collect();
        let least = MAY_LEAD * sizes.iter().fold(0.0_f64, |m, s| m.max(*s));
        let may = |c: &usize| sizes[*c] >= least;
        let lead = (0..global.len()).filter(may).find(|c| global[*c]);
        let Some(pivot) = lead.or_else(|| (0..global.len()).find(may)) else { break };
        let best = (k..rows.len()).max_by(|a, b| rows[*a][pivot].abs().total_cmp(&rows[*b][pivot].abs()));
        rows.swap(k, best.unwrap_or(k));
        let by = rows[k][pivot];
        rows[k].iter_mut().for_each(|v| *v /= by);
        let own = rows[k].clone();
        for (_, row) in rows.iter_mut().enumerate().filter(|(r, _)| *r != k) {
            let factor = row[pivot];
            row.iter_mut().zip(&own).for_each(|(v, o)| *v -= factor * o);
        }
        pivots.push(pivot);
    }
    pivots
}

/// Why a graph cannot be examined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UndeterminedError {
    /// As any system.
    #[error(transparent)]
    System(#[from] SystemError),
    /// Too large.
    #[error(
        "a graph of {unknowns} unknowns is too large to be examined for what it leaves undetermined, up to {MOST_UNKNOWNS}; \
         take a piece of it"
    )]
    TooLarge {
        /// Unknowns.
        unknowns: usize,
    },
    /// Values that are not numbers.
    #[error("the equations hold values that are not numbers; look at coordinates, observations and tolerances")]
    NotFinite,
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::factor::Convention;
    use crate::factor::pose2::Between2;
    use crate::factor::vector::{RandomWalk, ScalarPrior};

    #[test]
    fn a_chain_of_poses_without_control_is_free_by_its_datum() {
        let mut problem = Problem::new();
        let ids: Vec<VariableId> =
            (0..4).map(|k| problem.add_variable(Kind::Pose2, &[f64::from(k), 0.0, 0.3])).collect();
        for pair in ids.windows(2) {
            let link =
                Between2::new([pair[0], pair[1]], [0.9, -0.3, 0.0], &(1e4 * Matrix3::identity()), Convention::Plain);
            problem.add(link.expect("an information"));
        }
        let free = undetermined(&problem, |_, _| 0.1).expect("small");
        assert_eq!(free.len(), 3);
        assert!(free.iter().all(|f| f.sigma.is_infinite() && f.members.len() >= 4), "{free:?}");
        problem.fix(ids[0]);
        assert!(undetermined(&problem, |_, _| 0.1).expect("small").is_empty());
    }

    #[test]
    fn what_is_known_worse_than_its_tolerance_is_named_and_what_is_known_better_is_not() {
        let mut problem = Problem::new();
        let a = problem.add_variable(Kind::Scalar, &[0.0]);
        let b = problem.add_variable(Kind::Scalar, &[0.0]);
        problem.set_name(b, "drift");
        problem.add(RandomWalk::new([a, b], &[0.01]));
        problem.add(ScalarPrior::new(a, 0, 0.0, 0.5));
        assert!(undetermined(&problem, |_, _| 0.6).expect("small").is_empty());
        let free = undetermined(&problem, |_, _| 0.2).expect("small");
        assert_eq!(free.len(), 1);
        assert!((free[0].sigma - 2.5).abs() < 0.01, "{free:?}");
        assert_eq!(free[0].describe(&problem), "0, with drift");
    }
}
