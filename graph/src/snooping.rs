//! Data snooping (Baarda 1968): what fails its test, judged by its redundancy, is taken out, the worst first.
//!
//! The test value of a whitened residual v with redundancy r is `w = |v| / √r`, normal with sigma 1 where nothing is
//! wrong. A blunder spoils the tests of its neighbours too, so that in each round only those are taken out that are worse
//! than all others they share a variable with. It finds single blunders in well-checked nets, and says so of each; for
//! many false loops at a time kernels are the better way.

use crate::covariance::selected;
use crate::nonlinear::{SolveOptions, Solved, solve_system};
use crate::problem::Problem;
use crate::system::{System, SystemError};

/// Limit of the test at a significance of 0.1 %.
pub const LIMIT: f64 = 3.29;
/// Most rounds.
const ROUNDS: usize = 200;

/// A tie that was taken out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Snooped {
    /// Number of the factor.
    pub factor: usize,
    /// Its largest test value when it was.
    pub test: f64,
}

/// Adjusts, takes ties out until all that are left pass, and leaves the others out of the problem.
///
/// # Errors
/// [`SystemError`].
pub fn solve_snooping(
    problem: &mut Problem,
    options: &SolveOptions,
    limit: f64,
) -> Result<(Solved, System, Vec<Snooped>), SystemError> {
    let mut out: Vec<Snooped> = Vec::new();
    let mut left_out = vec![false; problem.factor_count()];
    let mut total: Option<Solved> = None;
    loop {
        let mut system = System::new(problem, options.order, options.partition, options.method.clone())?;
        let solved = solve_system(problem, &mut system, options)?;
        total = Some(total.map_or(solved.clone(), |before| before.then(solved)));
        let failed = failed(problem, &system, &left_out, limit)?;
        if failed.is_empty() || out.len() >= ROUNDS {
            let solved = total.unwrap_or_default();
            return Ok((solved, system, out));
        }
        failed.iter().for_each(|f| left_out[f.factor] = true);
        out.extend(failed);
        problem.leave_out(&left_out);
    }
}

/// Ties beyond the limit that are worse than all others at their variables.
fn failed(problem: &Problem, system: &System, left_out: &[bool], limit: f64) -> Result<Vec<Snooped>, SystemError> {
    let covariances = selected(problem, system, true)?;
    let mut worst = vec![0.0_f64; problem.values.len()];
    let mut tests = Vec::new();
    for (number, (factor, check)) in problem.factors().zip(&covariances.checks).enumerate() {
        if !factor.is_tie() || left_out[number] {
            continue;
        }
        let test = check.tests().into_iter().flatten().fold(0.0, f64::max);
        factor.variables().iter().for_each(|v| worst[v.index()] = worst[v.index()].max(test));
        tests.push((number, test, factor));
    }
    let is_worst = |(number, test, factor): (usize, f64, &dyn crate::factor::Factor)| {
        let local = factor.variables().iter().all(|v| test >= worst[v.index()]);
        (test > limit && local).then_some(Snooped { factor: number, test })
    };
    Ok(tests.into_iter().filter_map(is_worst).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::factor::Convention;
    use crate::factor::pose2::{Between2, Prior2};
    use crate::variable::Kind;
    use nalgebra::Matrix3;

    /// Two rounds of a square, tied to each other everywhere, with two false ties.
    #[test]
    fn false_ties_go_and_good_ones_stay() {
        let mut problem = Problem::new();
        let information = Matrix3::from_diagonal_element(100.0);
        let corner = |k: usize| {
            [10.0 * f64::from(u8::from(k % 4 == 1 || k % 4 == 2)), 10.0 * f64::from(u8::from(k % 4 >= 2)), 0.0]
        };
        let ids: Vec<_> = (0..16).map(|k| problem.add_variable(Kind::Pose2, &corner(k))).collect();
        problem.add(Prior2::new(ids[0], corner(0), &information).expect("regular"));
        let mut add = |a: usize, b: usize, tie: bool, wrong: f64| {
            let (p, q) = (corner(a), corner(b));
            // a twentieth of a sigma of pattern, so that residuals are not nothing
            let pattern = 0.005 * f64::from(u8::from((a + b).is_multiple_of(3)));
            let measured = [q[0] - p[0] + wrong + pattern, q[1] - p[1] - pattern, 0.0];
            let between = Between2::new([ids[a], ids[b]], measured, &information, Convention::Plain).expect("regular");
            problem.add(between.as_tie(tie));
        };
        for k in 1..16 {
            add(k - 1, k, false, 0.0);
        }
        let mut number = 0;
        let mut wrong = Vec::new();
        for k in 0..12 {
            for other in (k + 4..16).step_by(4) {
                let is_false = number == 3 || number == 17;
                if is_false {
                    wrong.push(16 + number);
                }
                add(k, other, true, if is_false { 2.0 } else { 0.0 });
                number += 1;
            }
        }
        let (solved, _, out) = solve_snooping(&mut problem, &SolveOptions::default(), LIMIT).expect("determined");
        let mut found: Vec<usize> = out.iter().map(|s| s.factor).collect();
        found.sort_unstable();
        assert_eq!(found, wrong, "{out:?}");
        assert!(solved.cost < 10.0, "{solved:?}");
    }
}
