//! How ends are judged: weights, outlier test, variance components.

use crate::observation::Line;

/// Deviation of an end from the mean of its line \[m\] and the variance of it, in variances of the end: the redundancy
/// where the end is in the solution, above 1 where it is not.
pub(super) type Deviation = (f64, f64);

/// Weights of the ends of a line \[1/m²\] by their factors and the scale of their class.
pub(super) fn weights(line: &Line, factors: &[f64], scales: &[f64]) -> Vec<f64> {
    line.ends.iter().zip(factors).map(|(e, f)| f / (e.sigma_m * scales[line.class]).powi(2)).collect()
}

/// Whether a line is in the solution: not held out, two ends or more with a weight.
pub(super) fn is_used(line: &Line, factors: &[f64]) -> bool {
    !line.held_out && has_mean(factors)
}

/// Whether a line has two ends or more with a weight.
pub(super) fn has_mean(factors: &[f64]) -> bool {
    factors.iter().filter(|f| **f > 0.0).count() >= 2
}

/// Scale of each class from the median of its normalised residuals (1.4826 MAD about zero).
pub(super) fn robust_scales(lines: &[Line], residuals: &[Vec<Deviation>], scales: &[f64]) -> Vec<f64> {
    let mut by_class: Vec<Vec<f64>> = vec![Vec::new(); scales.len()];
    for (line, residual) in lines.iter().zip(residuals).filter(|(line, _)| !line.held_out) {
        for ((v, r), e) in residual.iter().zip(&line.ends) {
            if *r > 0.02 {
                by_class[line.class].push(v.abs() / (e.sigma_m * r.sqrt()));
            }
        }
    }
    // ties of places are few: unknowns may follow them, and what is left says nothing yet
    let mut least = vec![0.05; scales.len()];
    lines.iter().filter(|l| l.tie.is_some()).for_each(|l| least[l.class] = 1.0);
    by_class
        .into_iter()
        .zip(scales.iter().zip(least))
        .map(|(mut t, (scale, least))| {
            if t.len() < 20 {
                return *scale;
            }
            let middle = t.len() / 2;
            t.select_nth_unstable_by(middle, f64::total_cmp);
            (1.4826 * t[middle]).max(least)
        })
        .collect()
}

/// Ends that pass the test have factor 1, the others 0; a line needs two. Of a tie of several directions all pass or none.
pub(super) fn keep(lines: &[Line], residuals: &[Vec<Deviation>], scales: &[f64], outlier_k: f64) -> Vec<Vec<f64>> {
    let mut factors = keep_each(lines, residuals, scales, outlier_k);
    let mut first = 0;
    for tie in lines.chunk_by(|a, b| a.tie.is_some() && a.tie == b.tie) {
        let of_tie = &mut factors[first..first + tie.len()];
        first += tie.len();
        if of_tie.iter().any(|f| f.contains(&0.0)) && tie[0].tie.is_some() {
            of_tie.iter_mut().for_each(|f| f.fill(0.0));
        }
    }
    factors
}

fn keep_each(lines: &[Line], residuals: &[Vec<Deviation>], scales: &[f64], outlier_k: f64) -> Vec<Vec<f64>> {
    lines
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
pub(super) fn variance_components(
    lines: &[Line],
    residuals: &[Vec<Deviation>],
    factors: &[Vec<f64>],
    scales: &[f64],
) -> (Vec<f64>, f64) {
    let mut sums = vec![(0.0, 0.0, 0_usize); scales.len()];
    for (i, line) in lines.iter().enumerate().filter(|(_, line)| !line.held_out) {
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
pub(super) fn common_mode(lines: &[Line], residuals: &[Vec<Deviation>], factors: &[Vec<f64>], scales: &[f64]) -> f64 {
    let mut sums = std::collections::BTreeMap::new();
    for (i, line) in lines.iter().enumerate().filter(|(_, line)| !line.held_out) {
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
