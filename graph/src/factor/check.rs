//! Derivatives of a factor against central differences.

use super::Factor;
use crate::variable::Values;

/// Largest difference between analytic and numeric derivatives over the largest derivative (or 1).
#[must_use]
pub fn derivative_error(factor: &dyn Factor, values: &Values) -> f64 {
    let rows = factor.rows();
    let columns: usize = factor.variables().iter().map(|v| values.kind(*v).dimension()).sum();
    let mut analytic = vec![0.0; rows * columns];
    factor.evaluate(values, &mut vec![0.0; rows], Some(&mut analytic));
    let scale = analytic.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
    let mut worst = 0.0_f64;
    let mut column = 0;
    for id in factor.variables() {
        let dimension = values.kind(*id).dimension();
        for k in 0..dimension {
            let h = 1e-5;
            let side = |sign: f64| {
                let mut moved = values.clone();
                let mut step = vec![0.0; dimension];
                step[k] = sign * h;
                moved.retract(*id, &step);
                let mut residual = vec![0.0; rows];
                factor.evaluate(&moved, &mut residual, None);
                residual
            };
            let (plus, minus) = (side(1.0), side(-1.0));
            for r in 0..rows {
                let numeric = (plus[r] - minus[r]) / (2.0 * h);
                worst = worst.max((numeric - analytic[r * columns + column]).abs() / scale);
            }
            column += 1;
        }
    }
    worst
}
