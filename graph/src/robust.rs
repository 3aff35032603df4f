//! Robust kernels: what a large residual of a tie counts.
//!
//! With the square `s` of the whitened residual of a tie, a kernel has a cost `ρ(s)` and the weight `ρ'(s)` of the
//! reweighted least squares. Odometry, control and other plain measurements are never weighted down.

use crate::nonlinear::Solved;
use crate::problem::Problem;

/// What a tie's residual counts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Kernel {
    /// Least squares.
    #[default]
    None,
    /// Huber, with its bend in sigmas.
    Huber(f64),
    /// Cauchy, with its scale in sigmas.
    Cauchy(f64),
    /// Dynamic covariance scaling with Φ (Agarwal et al. 2013): `s` up to Φ, then `4 Φ s / (Φ + s) - Φ`.
    Dcs(f64),
    /// Geman-McClure `c s / (c + s)` with the scale of graduated non-convexity inside `c`.
    GemanMcClure(f64),
}

impl Kernel {
    /// Cost of a tie by the square of its whitened residual.
    #[must_use]
    pub fn cost(&self, square: f64) -> f64 {
        match *self {
            Self::None => square,
            Self::Huber(k) if square <= k * k => square,
            Self::Huber(k) => 2.0 * k * square.sqrt() - k * k,
            Self::Cauchy(c) => c * c * (square / (c * c)).ln_1p(),
            Self::Dcs(phi) if square <= phi => square,
            Self::Dcs(phi) => 4.0 * phi * square / (phi + square) - phi,
            Self::GemanMcClure(c) => c * square / (c + square),
        }
    }
    /// Weight of a tie by the square of its whitened residual.
    #[must_use]
    pub fn weight(&self, square: f64) -> f64 {
        match *self {
            Self::None => 1.0,
            Self::Huber(k) if square <= k * k => 1.0,
            Self::Huber(k) => k / square.sqrt(),
            Self::Cauchy(c) => 1.0 / (1.0 + square / (c * c)),
            Self::Dcs(phi) if square <= phi => 1.0,
            Self::Dcs(phi) => (2.0 * phi / (phi + square)).powi(2),
            Self::GemanMcClure(c) => (c / (c + square)).powi(2),
        }
    }
}

/// Share of Φ at which DCS begins.
const DISTRUST: f64 = 0.3;

/// Solves with a kernel; DCS in two stages, the first with a smaller Φ: while the poses are still far off, false edges
/// that happen to fit bend the graph less, and true ones come in as it straightens.
///
/// # Errors
/// Those of `solve`.
pub fn in_stages<E>(
    problem: &mut Problem,
    kernel: Kernel,
    mut solve: impl FnMut(&mut Problem, Kernel) -> Result<Solved, E>,
) -> Result<Solved, E> {
    let Kernel::Dcs(phi) = kernel else { return solve(problem, kernel) };
    let first = solve(problem, Kernel::Dcs(DISTRUST * phi))?;
    let second = solve(problem, kernel)?;
    Ok(first.then(second))
}

/// Graduated non-convexity (Yang et al. 2020) with Geman-McClure's kernel: from a cost without local minima to the
/// kernel of scale `c` sigmas, each stage from the last one's solution.
///
/// # Errors
/// Those of `solve`.
pub fn graduated<E>(
    problem: &mut Problem,
    c: f64,
    mut solve: impl FnMut(&mut Problem, Kernel) -> Result<Solved, E>,
) -> Result<Solved, E> {
    let mut largest = 0.0_f64;
    for factor in problem.factors().filter(|f| f.is_tie()) {
        let mut residual = vec![0.0; factor.rows()];
        factor.evaluate(&problem.values, &mut residual, None);
        largest = largest.max(residual.iter().map(|r| r * r).sum());
    }
    let square = c * c;
    let mut mu = (2.0 * largest / square).max(1.0);
    let mut all = Solved::default();
    loop {
        let stage = solve(problem, Kernel::GemanMcClure(mu * square))?;
        all = if all.iterations == 0 { stage } else { all.then(stage) };
        if mu <= 1.0 {
            return Ok(all);
        }
        mu = (mu / 1.4).max(1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_is_the_derivative_of_the_cost() {
        for kernel in
            [Kernel::None, Kernel::Huber(1.3), Kernel::Cauchy(0.8), Kernel::Dcs(1.0), Kernel::GemanMcClure(2.0)]
        {
            for s in [0.01, 0.5, 0.99, 1.01, 1.7, 5.0, 300.0] {
                let numeric = (kernel.cost(s + 1e-6) - kernel.cost(s - 1e-6)) / 2e-6;
                assert!((numeric - kernel.weight(s)).abs() < 1e-6, "{kernel:?} at {s}");
            }
        }
    }
}
