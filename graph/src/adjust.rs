//! One adjustment: robust weights, outlier test by redundancy, variance components, covariance.
//!
//! 1. Huber weights from the start, then Tukey's biweight (redescending), scale from the median.
//! 2. What fails `|v| > k σ √r` with the redundancy `r` of the end is taken out (Baarda's test, a-posteriori σ).
//! 3. Plain least squares of the rest; variance components per tie class (Förstner's estimate), until they settle.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::model::Model;
use crate::normal::{Factor, NotPositiveDefinite, Pattern, Reduced, Shape};
use crate::observability::Observability;
use crate::observation::Line;

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
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AdjustmentError {
    /// Nothing to adjust with.
    #[error("no surface line with two ends or more is left to adjust with; look at the rejections of `match`")]
    NoTies,
    /// The normal equations cannot be factorised.
    #[error(transparent)]
    NotPositiveDefinite(#[from] NotPositiveDefinite),
}

struct Work<'a> {
    lines: &'a [Line],
    shapes: Vec<Shape>,
    scale: Vec<f64>,
    classes: usize,
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
    let scale: Vec<f64> = model.parameters().iter().map(|p| p.prior_sigma).collect();
    let shapes = lines
        .par_iter()
        .map(|line| Shape::new(&line.ends.iter().map(|e| model.row(e, &line.normal)).collect::<Vec<_>>(), &scale))
        .collect();
    let work = Work { lines, shapes, scale, classes };
    let start = DVector::from_fn(model.count(), |i, _| model.state()[i] / work.scale[i]);
    let mut factors: Vec<Vec<f64>> = lines.iter().map(|line| vec![1.0; line.ends.len()]).collect();
    let pattern = {
        let reduced = work.reduced(&factors, &scales);
        Pattern::new(model.count(), reduced.iter().map(|line| line.columns()))?
    };
    let mut step = DVector::zeros(model.count());
    for iteration in 0..options.huber_iterations + options.tukey_iterations {
        let (factor, right) = pattern.factorise(&work.reduced(&factors, &scales), &start)?;
        step = factor.solve(&right);
        let residuals = work.residuals(&step, &factors, &scales);
        scales = work.robust_scales(&residuals, &scales);
        let huber = iteration < options.huber_iterations;
        for (line, (residual, factor)) in lines.iter().zip(residuals.iter().zip(&mut factors)) {
            for (k, (v, red)) in residual.iter().enumerate() {
                let t = v.abs() / (line.ends[k].sigma_m * scales[line.class] * red.max(0.05).sqrt());
                factor[k] = if huber {
                    (options.huber_k / t.max(1e-9)).min(1.0)
                } else {
                    (1.0 - (t / options.tukey_c).min(1.0).powi(2)).powi(2)
                };
            }
        }
    }
    finish(model, &work, &pattern, &start, step, scales, options)
}

fn finish(
    model: &mut Model,
    work: &Work<'_>,
    pattern: &Pattern,
    start: &DVector<f64>,
    mut step: DVector<f64>,
    mut scales: Vec<f64>,
    options: &AdjustOptions,
) -> Result<Adjustment, AdjustmentError> {
    let mut factors = work.keep(&work.residuals(&step, &work.ones(), &scales), &scales, options.outlier_k);
    // The biweight's own residuals decide first; then plain least squares, test and variances in turn.
    let mut round = 0;
    let (inverse, sigma0) = loop {
        let reduced = work.reduced(&factors, &scales);
        let (factor, right): (Factor, _) = pattern.factorise(&reduced, start)?;
        step = factor.solve(&right);
        let inverse = factor.inverse();
        let residuals = work.exact_residuals(&step, &factors, &scales, &inverse);
        let (new_scales, sigma0) = work.variance_components(&residuals, &factors, &scales);
        let kept = work.keep(&residuals, &new_scales, options.outlier_k);
        let settled = (sigma0 - 1.0).abs() < 0.01 && kept == factors;
        round += 1;
        if settled || round >= options.variance_rounds {
            break (inverse, sigma0);
        }
        scales = new_scales;
        factors = kept;
    };
    let residuals = work.exact_residuals(&step, &factors, &scales, &inverse);
    let common_mode_factor = work.common_mode(&residuals, &factors, &scales);
    let ends: Vec<Vec<EndResult>> = work
        .lines
        .iter()
        .zip(residuals.iter().zip(&factors))
        .map(|(line, (residual, factor))| {
            residual
                .iter()
                .zip(factor)
                .zip(&line.ends)
                .map(|(((v, r), f), e)| EndResult {
                    residual_m: *v,
                    sigma_m: e.sigma_m * scales[line.class],
                    redundancy: *r,
                    outlier: *f <= 0.0,
                })
                .collect()
        })
        .collect();
    let state = DVector::from_fn(model.count(), |i, _| (start[i] + step[i]) * work.scale[i]);
    model.set_state(state);
    // What neighbours have in common weakens all ties alike; the prior keeps its weight.
    let inverse = if common_mode_factor > 1.0 {
        let weaker: Vec<f64> = scales.iter().map(|s| s * common_mode_factor).collect();
        pattern.factorise(&work.reduced(&factors, &weaker), start)?.0.inverse()
    } else {
        inverse
    };
    let observability = Observability::new(&inverse, model.parameters());
    let covariance =
        DMatrix::from_fn(model.count(), model.count(), |i, j| inverse[(i, j)] * work.scale[i] * work.scale[j]);
    let solved = |i: usize| !work.lines[i].held_out;
    let used = |i: usize| factors[i].iter().filter(|f| **f > 0.0).count();
    Ok(Adjustment {
        covariance,
        used_ends: (0..factors.len()).filter(|i| solved(*i) && used(*i) >= 2).map(used).sum(),
        used_lines: (0..factors.len()).filter(|i| solved(*i) && used(*i) >= 2).count(),
        ends,
        class_scale: scales,
        sigma0,
        common_mode_factor,
        observability,
        last_step: step.amax(),
    })
}

/// Residual and redundancy of each end of a line.
type Residuals = Vec<Vec<(f64, f64)>>;

impl Work<'_> {
    fn ones(&self) -> Vec<Vec<f64>> {
        self.lines.iter().map(|line| vec![1.0; line.ends.len()]).collect()
    }

    fn weights(&self, i: usize, factors: &[f64], scales: &[f64]) -> Vec<f64> {
        let line = &self.lines[i];
        line.ends.iter().zip(factors).map(|(e, f)| f / (e.sigma_m * scales[line.class]).powi(2)).collect()
    }

    fn reduce(&self, i: usize, factors: &[f64], scales: &[f64]) -> Reduced<'_> {
        let offsets: Vec<f64> = self.lines[i].ends.iter().map(|e| e.offset_m).collect();
        Reduced::new(&self.shapes[i], &offsets, &self.weights(i, factors, scales))
    }

    /// The lines in the solution, landmarks eliminated.
    fn reduced(&self, factors: &[Vec<f64>], scales: &[f64]) -> Vec<Reduced<'_>> {
        let used = |i: &usize| !self.lines[*i].held_out && factors[*i].iter().filter(|f| **f > 0.0).count() >= 2;
        let rows: Vec<usize> = (0..self.lines.len()).filter(used).collect();
        rows.par_iter().map(|i| self.reduce(*i, &factors[*i], scales)).collect()
    }

    /// Residuals after a step, with the redundancy that the landmark alone leaves.
    fn residuals(&self, step: &DVector<f64>, factors: &[Vec<f64>], scales: &[f64]) -> Residuals {
        (0..self.lines.len())
            .into_par_iter()
            .map(|i| {
                let line = self.reduce(i, &factors[i], scales);
                let v = line.residuals(step);
                let total: f64 = line.weights.iter().sum();
                (0..v.len())
                    .map(|k| {
                        let w = line.weights[k] / factors[i][k].max(1e-12);
                        (v[k], if factors[i][k] > 0.0 { 1.0 - w / total.max(w) } else { 1.0 })
                    })
                    .collect()
            })
            .collect()
    }

    /// Residuals after a step with full redundancy numbers. For an end outside the solution (held out, taken out)
    /// the second number is the variance of its residual over that of the observation, which exceeds 1.
    fn exact_residuals(
        &self,
        step: &DVector<f64>,
        factors: &[Vec<f64>],
        scales: &[f64],
        inverse: &DMatrix<f64>,
    ) -> Residuals {
        (0..self.lines.len())
            .into_par_iter()
            .map(|i| {
                let line = self.reduce(i, &factors[i], scales);
                let v = line.residuals(step);
                let projected = line.projected(inverse);
                let total: f64 = line.weights.iter().sum();
                let sign = if self.lines[i].held_out { 1.0 } else { -1.0 };
                (0..v.len())
                    .map(|k| {
                        let w = 1.0 / (self.lines[i].ends[k].sigma_m * scales[self.lines[i].class]).powi(2);
                        let model = w * projected[k];
                        if factors[i][k] > 0.0 {
                            (v[k], (1.0 - w / total.max(w) + sign * model).max(1e-3))
                        } else {
                            (v[k], 1.0 + w / total.max(1e-300) + model)
                        }
                    })
                    .collect()
            })
            .collect()
    }

    /// Scale of each class from the median of its normalised residuals (1.4826 MAD about zero).
    fn robust_scales(&self, residuals: &Residuals, scales: &[f64]) -> Vec<f64> {
        let mut by_class: Vec<Vec<f64>> = vec![Vec::new(); self.classes];
        for (line, residual) in self.lines.iter().zip(residuals).filter(|(line, _)| !line.held_out) {
            for ((v, r), e) in residual.iter().zip(&line.ends) {
                if *r > 0.02 {
                    by_class[line.class].push(v.abs() / (e.sigma_m * r.sqrt()));
                }
            }
        }
        by_class
            .into_iter()
            .zip(scales)
            .map(|(mut t, scale)| {
                if t.len() < 20 {
                    return *scale;
                }
                let middle = t.len() / 2;
                t.select_nth_unstable_by(middle, f64::total_cmp);
                (1.4826 * t[middle]).max(0.05)
            })
            .collect()
    }

    /// Ends that pass the test have factor 1, the others 0; a line needs two.
    fn keep(&self, residuals: &Residuals, scales: &[f64], outlier_k: f64) -> Vec<Vec<f64>> {
        self.lines
            .iter()
            .zip(residuals)
            .map(|(line, residual)| {
                let mut factors: Vec<f64> = residual
                    .iter()
                    .zip(&line.ends)
                    .map(|((v, r), e)| f64::from(v.abs() <= outlier_k * e.sigma_m * scales[line.class] * r.sqrt()))
                    .collect();
                if factors.iter().filter(|f| **f > 0.0).count() < 2 {
                    factors.fill(0.0);
                }
                factors
            })
            .collect()
    }

    /// New scales `s² Σ v²/(σ² s²) / Σ r` per class, and sigma0 over all.
    fn variance_components(&self, residuals: &Residuals, factors: &[Vec<f64>], scales: &[f64]) -> (Vec<f64>, f64) {
        let mut sums = vec![(0.0, 0.0, 0_usize); self.classes];
        for (i, line) in self.lines.iter().enumerate().filter(|(_, line)| !line.held_out) {
            for (k, (v, r)) in residuals[i].iter().enumerate().filter(|(k, _)| factors[i][*k] > 0.0) {
                let sum = &mut sums[line.class];
                sum.0 += (v / (line.ends[k].sigma_m * scales[line.class])).powi(2);
                sum.1 += r;
                sum.2 += 1;
            }
        }
        let total = sums.iter().fold((0.0, 0.0), |t, s| (t.0 + s.0, t.1 + s.1));
        let new = sums
            .iter()
            .zip(scales)
            .map(|(s, scale)| if s.2 >= 20 && s.1 > 5.0 { scale * (s.0 / s.1).sqrt() } else { *scale })
            .collect();
        (new, if total.1 > 0.0 { (total.0 / total.1).sqrt() } else { 1.0 })
    }

    /// Whether residuals of one strip within one second move together: variance of their sums over what
    /// independence predicts, as a factor on sigmas, never below 1.
    fn common_mode(&self, residuals: &Residuals, factors: &[Vec<f64>], scales: &[f64]) -> f64 {
        let mut sums = std::collections::BTreeMap::new();
        for (i, line) in self.lines.iter().enumerate().filter(|(_, line)| !line.held_out) {
            for (k, (v, r)) in residuals[i].iter().enumerate().filter(|(k, _)| factors[i][*k] > 0.0) {
                let end = &line.ends[k];
                #[allow(clippy::cast_possible_truncation)]
                let sum = sums.entry((end.strip, end.time_s.floor() as i64)).or_insert((0.0, 0.0));
                let t = v / (end.sigma_m * scales[line.class]);
                sum.0 += t;
                sum.1 += r;
            }
        }
        let (square, expected) = sums.values().fold((0.0, 0.0), |(a, b), (s, n)| (a + s * s, b + n));
        if expected > 0.0 { (square / expected).sqrt().max(1.0) } else { 1.0 }
    }
}
