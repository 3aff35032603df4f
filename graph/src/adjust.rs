//! One adjustment: robust weights, outlier test by redundancy, variance components, covariance.
//!
//! 1. Huber weights from the start, then Tukey's biweight (redescending), scale from the median.
//! 2. What fails `|v| > k σ √r` with the redundancy `r` of the end is taken out (Baarda's test, a-posteriori σ).
//! 3. Plain least squares of the rest; variance components per tie class (Förstner's estimate), until they settle.

mod judge;
mod system;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::model::Model;
use crate::observability::Observability;
use crate::observation::Line;
use crate::system::SystemError;
use judge::{Deviation, common_mode, is_used, keep, robust_scales, variance_components};
use system::StripSystem;

/// Settings of the adjustment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdjustOptions {
    /// Huber's k, in sigmas.
    pub huber_k: f64,
    /// Where the biweight vanishes, in sigmas.
    pub tukey_c: f64,
    /// Residuals beyond this many sigmas are outliers.
    pub outlier_k: f64,
    /// Iterations with Huber weights.
    pub huber_iterations: usize,
    /// Iterations with the biweight.
    pub tukey_iterations: usize,
    /// Most rounds of outlier test and variance components.
    pub variance_rounds: usize,
}

impl Default for AdjustOptions {
    fn default() -> Self {
        Self {
            huber_k: 2.0,
            tukey_c: 5.0,
            outlier_k: 3.5,
            huber_iterations: 3,
            tukey_iterations: 4,
            variance_rounds: 5,
        }
    }
}

/// What became of one end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndResult {
    /// Offset of the plane from the surface after the adjustment \[m\].
    pub residual_m: f64,
    /// A-posteriori sigma of the observation \[m\].
    pub sigma_m: f64,
    /// Redundancy: the share of an error in this observation that shows in its residual.
    pub redundancy: f64,
    /// Whether the outlier test took it out.
    pub outlier: bool,
}

/// The result of an adjustment; the state itself is in the [`Model`].
#[derive(Debug, Clone)]
pub struct Adjustment {
    /// Covariance of the unknowns in their own units, all correlations included.
    pub covariance: DMatrix<f64>,
    /// For each line and end.
    pub ends: Vec<Vec<EndResult>>,
    /// Sigma of each class over its a-priori sigma.
    pub class_scale: Vec<f64>,
    /// Sigma of unit weight over all classes after the variance components (1 when they have settled).
    pub sigma0: f64,
    /// Factor on all sigmas for errors that neighbours in time have in common (1: none found).
    pub common_mode_factor: f64,
    /// What is held by the prior.
    pub observability: Observability,
    /// Ends in the solution.
    pub used_ends: usize,
    /// Lines with two ends or more in the solution.
    pub used_lines: usize,
    /// Largest change of an unknown in prior sigmas in the last step.
    pub last_step: f64,
}

/// Why an adjustment fails.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AdjustmentError {
    /// Nothing to adjust with.
    #[error("no tie of two strips is left to adjust with; look at the rejections of `match`")]
    NoTies,
    /// The normal equations cannot be solved.
    #[error("the normal equations of the strips: {0}; prior sigmas and observations must be finite, positive numbers")]
    System(#[from] SystemError),
}

/// Adjusts: moves the state of `model` to the estimate and says how good it is.
///
/// Offsets in `lines` must have been measured at the present state. `class_scale` starts the variance components
/// (empty: all 1).
///
/// # Errors
/// [`AdjustmentError`].
pub fn adjust(
    model: &mut Model,
    lines: &[Line],
    class_scale: &[f64],
    options: &AdjustOptions,
) -> Result<Adjustment, AdjustmentError> {
    if !lines.iter().any(|line| !line.held_out && line.ends.len() >= 2) {
        return Err(AdjustmentError::NoTies);
    }
    let classes = lines.iter().map(|line| line.class + 1).max().unwrap_or(1);
    let mut scales: Vec<f64> = (0..classes).map(|c| class_scale.get(c).copied().unwrap_or(1.0)).collect();
    let mut strips = StripSystem::new(model, lines)?;
    let mut factors: Vec<Vec<f64>> = ones(lines);
    for iteration in 0..options.huber_iterations + options.tukey_iterations {
        strips.solve(&factors, &scales)?;
        let deviations = strips.deviations(&factors, &scales);
        scales = robust_scales(lines, &deviations, &scales);
        let huber = iteration < options.huber_iterations;
        for (line, (deviations, factors)) in lines.iter().zip(deviations.iter().zip(&mut factors)) {
            for ((end, factor), (v, red)) in line.ends.iter().zip(factors).zip(deviations) {
                let t = v.abs() / (end.sigma_m * scales[line.class] * red.max(0.05).sqrt());
                *factor = if huber {
                    (options.huber_k / t.max(1e-9)).min(1.0)
                } else {
                    (1.0 - (t / options.tukey_c).min(1.0).powi(2)).powi(2)
                };
            }
        }
    }
    finish(model, lines, strips, scales, options)
}

fn ones(lines: &[Line]) -> Vec<Vec<f64>> {
    lines.iter().map(|line| vec![1.0; line.ends.len()]).collect()
}

/// Plain least squares of what the biweight's deviations leave, outlier test and variances in turn.
fn finish(
    model: &mut Model,
    lines: &[Line],
    mut strips: StripSystem<'_>,
    mut scales: Vec<f64>,
    options: &AdjustOptions,
) -> Result<Adjustment, AdjustmentError> {
    let mut factors = keep(lines, &strips.deviations(&ones(lines), &scales), &scales, options.outlier_k);
    let mut round = 0;
    let (deviations, sigma0) = loop {
        strips.solve(&factors, &scales)?;
        let deviations = strips.exact_deviations(&factors, &scales)?;
        let (new_scales, sigma0) = variance_components(lines, &deviations, &factors, &scales);
        let kept = keep(lines, &deviations, &new_scales, options.outlier_k);
        let settled = (sigma0 - 1.0).abs() < 0.01 && kept == factors;
        round += 1;
        if settled || round >= options.variance_rounds {
            break (deviations, sigma0);
        }
        scales = new_scales;
        factors = kept;
    };
    let step = strips.step();
    let common_mode_factor = common_mode(lines, &deviations, &factors, &scales);
    // What neighbours have in common weakens all ties alike; the prior keeps its weight.
    if common_mode_factor > 1.0 {
        let weaker: Vec<f64> = scales.iter().map(|s| s * common_mode_factor).collect();
        strips.solve(&factors, &weaker)?;
    }
    let covariance = strips.covariance()?;
    let sigma = |i: usize| model.parameters()[i].prior_sigma;
    let in_priors = DMatrix::from_fn(step.len(), step.len(), |i, j| covariance[(i, j)] / (sigma(i) * sigma(j)));
    let observability = Observability::new(&in_priors, model.parameters());
    let last_step = step.iter().enumerate().map(|(i, s)| (s / sigma(i)).abs()).fold(0.0, f64::max);
    model.set_state(model.state() + step);
    let used = |i: &usize| is_used(&lines[*i], &factors[*i]);
    Ok(Adjustment {
        covariance,
        used_ends: (0..lines.len()).filter(used).map(|i| factors[i].iter().filter(|f| **f > 0.0).count()).sum(),
        used_lines: (0..lines.len()).filter(used).count(),
        ends: results(lines, &deviations, &factors, &scales),
        class_scale: scales,
        sigma0,
        common_mode_factor,
        observability,
        last_step,
    })
}

fn results(lines: &[Line], deviations: &[Vec<Deviation>], factors: &[Vec<f64>], scales: &[f64]) -> Vec<Vec<EndResult>> {
    let of_line = |(line, (deviations, factors)): (&Line, (&Vec<Deviation>, &Vec<f64>))| {
        let of_end = |((end, (v, r)), factor): ((&crate::LineEnd, &Deviation), &f64)| EndResult {
            residual_m: *v,
            sigma_m: end.sigma_m * scales[line.class],
            redundancy: *r,
            outlier: *factor <= 0.0,
        };
        line.ends.iter().zip(deviations).zip(factors).map(of_end).collect()
    };
    lines.iter().zip(deviations.iter().zip(factors)).map(of_line).collect()
}
