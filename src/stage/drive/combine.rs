//! One calibration of several drives: normal equations of each added up, as Helmert's blocks are.
//!
//! Constants `x` are common to all drives, everything else is each drive's own. The smoother of drive i gives value `v_i` and covariance `Σ_i` of
//! `x` with the prior `N(0, P₀)` in it; what the drive itself says is `Λ_i = Σ_i⁻¹ - P₀⁻¹` and `g_i = Σ_i⁻¹ v_i`. All drives together:
//!
//! `(P₀⁻¹ + Σ Λ_i) x = Σ g_i`
//!
//! which is what one adjustment of all drives gives. Computed with `u = L⁻¹ x`, `P₀ = L Lᵀ`: the prior becomes the identity, and eigenvalues of
//! `L⁻¹ Σ_i L⁻ᵀ` lie between 0 (known by the drive) and 1 (not seen).
//!
//! **Agreement.** Before drive i is taken, the others say `z ~ N(0, I)` in a frame of their own; in the directions in which `Λ_i` is `λ` there, the
//! drive says `y = z + noise` of variance `1/λ`, so that `y² λ / (1 + λ)` is χ² of one degree of freedom when both are right.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SymmetricEigen};
use tieline_filter::CalibrationEstimate;
use tieline_filter::innovation::chi_squared_limit;

/// Directions that a drive tells less of than this share of what the others do say nothing of agreement.
const TELLING: f64 = 0.1;
/// Eigenvalues of covariances over prior ones are not below this: rounding.
const LEAST: f64 = 1e-12;
/// Probability that drives that agree are said to contradict each other.
const FALSE_ALARM: f64 = 0.001;
/// Beyond this probability all sigmas grow by what the drives differ.
const BY_CHANCE: f64 = 0.01;

/// How what a drive says fits what the others say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Squared difference over its variance, summed over the directions compared.
    pub squared: f64,
    /// Directions compared.
    pub freedom: usize,
}

impl Agreement {
    /// What `squared` is not to exceed: 1 in 1000 do.
    #[must_use]
    pub fn limit(&self) -> f64 {
        if self.freedom == 0 { 0.0 } else { chi_squared_limit(self.freedom, FALSE_ALARM) }
    }

    /// Whether the difference is no more than chance.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.squared <= self.limit()
    }
}

/// The common estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Combined {
    /// Values and covariance.
    pub estimate: CalibrationEstimate,
    /// Each drive against all the others, in their order.
    pub agreements: Vec<Agreement>,
    /// What the sigmas of all drives were multiplied by, for the drives differ by more than they say; 1 when they agree.
    pub sigma_factor: f64,
}

/// Combines estimates of the same constants that were made with the same prior covariance; `None` when one of the matrices is no
/// covariance.
#[must_use]
pub fn combine(prior: &DMatrix<f64>, estimates: &[&CalibrationEstimate]) -> Option<Combined> {
    let n = prior.nrows();
    if n == 0 {
        let agreements = vec![Agreement { squared: 0.0, freedom: 0 }; estimates.len()];
        return Some(Combined { estimate: CalibrationEstimate::default(), agreements, sigma_factor: 1.0 });
    }
    let root = prior.clone().cholesky()?.l();
    let said: Vec<Said> = estimates.iter().map(|e| Said::of(e, &root)).collect::<Option<_>>()?;
    let agreements = (0..said.len()).map(|i| {
        let others = said.iter().enumerate().filter(|(k, _)| *k != i).map(|(_, s)| s);
        said[i].against(&Sum::of(n, others, 1.0))
    });
    let agreements = agreements.collect::<Option<Vec<Agreement>>>()?;
    // one drive after the other against those before it: independent, so that their sum is χ² too
    let in_turn = (1..said.len()).map(|i| said[i].against(&Sum::of(n, said[..i].iter(), 1.0)));
    let (squared, freedom) =
        in_turn.collect::<Option<Vec<_>>>()?.iter().fold((0.0, 0), |(s, f), a| (s + a.squared, f + a.freedom));
    let chance = freedom == 0 || squared <= chi_squared_limit(freedom, BY_CHANCE);
    #[allow(clippy::cast_precision_loss)] // tens
    let sigma_factor = if chance { 1.0 } else { (squared / freedom as f64).sqrt() };
    let sum = Sum::of(n, said.iter(), sigma_factor.powi(-2));
    let information = sum.cholesky()?;
    let value = &root * information.solve(&sum.right);
    let covariance = &root * information.inverse() * root.transpose();
    let covariance = (&covariance + covariance.transpose()) * 0.5;
    let estimate = CalibrationEstimate { value: value.as_slice().to_vec(), covariance: covariance.as_slice().to_vec() };
    Some(Combined { estimate, agreements, sigma_factor })
}

/// What a drive says, without the prior: normal equations in units of it.
struct Said {
    normal: DMatrix<f64>,
    right: DVector<f64>,
}

impl Said {
    fn of(estimate: &CalibrationEstimate, root: &DMatrix<f64>) -> Option<Self> {
        let n = root.nrows();
        if estimate.value.len() != n || estimate.covariance.len() != n * n {
            return None;
        }
        let half = root.solve_lower_triangular(&DMatrix::from_row_slice(n, n, &estimate.covariance))?;
        let whole = root.solve_lower_triangular(&half.transpose())?;
        if !whole.iter().all(|v| v.is_finite()) {
            return None;
        }
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new((&whole + whole.transpose()) * 0.5);
        let information = eigenvalues.map(|w| 1.0 / w.clamp(LEAST, 1.0));
        let of = |d: &DVector<f64>| &eigenvectors * DMatrix::from_diagonal(d) * eigenvectors.transpose();
        let value = root.solve_lower_triangular(&DVector::from_column_slice(&estimate.value))?;
        Some(Self { normal: of(&information.map(|i| i - 1.0)), right: of(&information) * value })
    }

    /// How this fits what a sum says.
    fn against(&self, sum: &Sum) -> Option<Agreement> {
        let others = sum.cholesky()?;
        let middle = others.solve(&sum.right);
        // A = K⁻ᵀ with the sum's normal matrix K Kᵀ, so that its covariance is A Aᵀ
        let k = others.l();
        let half = k.solve_lower_triangular(&self.normal)?;
        let turned = k.solve_lower_triangular(&half.transpose())?;
        let score = k.solve_lower_triangular(&(&self.right - &self.normal * middle))?;
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new((&turned + turned.transpose()) * 0.5);
        let along = eigenvectors.transpose() * score;
        let mut agreement = Agreement { squared: 0.0, freedom: 0 };
        for (lambda, h) in eigenvalues.iter().zip(along.iter()).filter(|(lambda, _)| **lambda >= TELLING) {
            agreement.squared += h * h / (lambda * (1.0 + lambda));
            agreement.freedom += 1;
        }
        Some(agreement)
    }
}

/// The prior and what some drives say.
struct Sum {
    normal: DMatrix<f64>,
    right: DVector<f64>,
}

impl Sum {
    fn of<'a>(n: usize, said: impl Iterator<Item = &'a Said>, weight: f64) -> Self {
        let mut sum = Self { normal: DMatrix::identity(n, n), right: DVector::zeros(n) };
        for one in said {
            sum.normal += &one.normal * weight;
            sum.right += &one.right * weight;
        }
        sum
    }

    fn cholesky(&self) -> Option<Cholesky<f64, Dyn>> {
        self.normal.clone().cholesky()
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::SmallRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    const N: usize = 7;

    /// A prior with correlations, and far from the units of its neighbours.
    fn prior() -> DMatrix<f64> {
        DMatrix::from_fn(N, N, |i, j| {
            let scale = |k: usize| if k < 3 { 1e-3 } else { 1e-2 };
            let apart = i.abs_diff(j) as f64;
            scale(i) * scale(j) * ((-0.7 * apart).exp() + if i == j { 0.01 } else { 0.0 })
        })
    }

    fn normal(random: &mut SmallRng) -> f64 {
        (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
    }

    /// A drive: rows of equations with unit variance and what they measure.
    fn drive(random: &mut SmallRng, truth: &DVector<f64>, rows: usize) -> (DMatrix<f64>, DVector<f64>) {
        let scale = |k: usize| if k < 3 { 3e3 } else { 3e2 };
        let a = DMatrix::from_fn(rows, N, |_, k| scale(k) * normal(random) * if k == 6 { 0.0 } else { 1.0 });
        let noise = DVector::from_fn(rows, |_, _| normal(random));
        let b = &a * truth + noise;
        (a, b)
    }

    fn estimate(drives: &[&(DMatrix<f64>, DVector<f64>)]) -> CalibrationEstimate {
        let mut normal = prior().try_inverse().expect("regular");
        let mut right = DVector::zeros(N);
        for (a, b) in drives {
            normal += a.transpose() * a;
            right += a.transpose() * b;
        }
        let covariance = normal.try_inverse().expect("regular");
        let value = &covariance * right;
        CalibrationEstimate { value: value.as_slice().to_vec(), covariance: covariance.as_slice().to_vec() }
    }

    #[test]
    fn drives_combined_are_one_adjustment_of_all_their_equations() {
        let mut random = SmallRng::seed_from_u64(1);
        let truth = prior().cholesky().expect("regular").l() * DVector::from_fn(N, |_, _| normal(&mut random));
        // one with fewer equations than constants
        let drives: Vec<_> = [40, 3, 25].map(|rows| drive(&mut random, &truth, rows)).into();
        let each: Vec<CalibrationEstimate> = drives.iter().map(|d| estimate(&[d])).collect();
        let combined = combine(&prior(), &each.iter().collect::<Vec<_>>()).expect("covariances");
        let whole = estimate(&drives.iter().collect::<Vec<_>>());
        assert!((combined.sigma_factor - 1.0).abs() < 1e-12, "{combined:?}");
        for k in 0..N {
            let sigma = whole.sigma(k);
            assert!((combined.estimate.value[k] - whole.value[k]).abs() < 1e-7 * sigma, "value {k}");
            assert!((combined.estimate.sigma(k) / sigma - 1.0).abs() < 1e-7, "sigma {k}");
        }
        assert!(combined.agreements.iter().all(Agreement::holds), "{:?}", combined.agreements);
    }

    #[test]
    fn one_drive_is_left_as_it_is() {
        let mut random = SmallRng::seed_from_u64(2);
        let one = estimate(&[&drive(&mut random, &DVector::zeros(N), 20)]);
        let combined = combine(&prior(), &[&one]).expect("a covariance");
        for k in 0..N {
            assert!((combined.estimate.value[k] - one.value[k]).abs() < 1e-8 * one.sigma(k));
        }
        assert!(combined.agreements[0].squared <= combined.agreements[0].limit(), "{:?}", combined.agreements);
    }

    #[test]
    fn agreement_is_chi_squared_when_drives_are_right() {
        let mut random = SmallRng::seed_from_u64(3);
        let root = prior().cholesky().expect("regular").l();
        let (mut squared, mut freedom, mut alarms) = (0.0, 0.0, 0);
        for _ in 0..300 {
            let truth = &root * DVector::from_fn(N, |_, _| normal(&mut random));
            let each: Vec<_> = (0..2).map(|_| estimate(&[&drive(&mut random, &truth, 12)])).collect();
            let combined = combine(&prior(), &each.iter().collect::<Vec<_>>()).expect("covariances");
            squared += combined.agreements[1].squared;
            freedom += combined.agreements[1].freedom as f64;
            alarms += combined.agreements.iter().filter(|a| !a.holds()).count();
        }
        let ratio = squared / freedom;
        // 300 × 6 degrees of freedom: two per thousand beyond 4 sigma of √(2 / 1800)
        assert!((ratio - 1.0).abs() < 0.13, "{ratio}");
        assert!(alarms <= 6, "{alarms} of 600");
    }

    #[test]
    fn a_drive_with_another_mounting_is_found_and_sigmas_grow() {
        let mut random = SmallRng::seed_from_u64(4);
        let truth = DVector::zeros(N);
        let mut moved = truth.clone();
        moved[1] = 2e-3;
        let each: Vec<_> = [&truth, &truth, &moved].map(|t| estimate(&[&drive(&mut random, t, 30)])).into();
        let combined = combine(&prior(), &each.iter().collect::<Vec<_>>()).expect("covariances");
        let worst = combined.agreements.iter().enumerate().max_by(|a, b| a.1.squared.total_cmp(&b.1.squared));
        assert_eq!(worst.map(|w| w.0), Some(2), "{combined:?}");
        assert!(!combined.agreements[2].holds() && combined.sigma_factor > 1.5, "{combined:?}");
        let alike = combine(&prior(), &[&each[0], &each[1]]).expect("covariances");
        assert!(combined.estimate.sigma(1) > alike.estimate.sigma(1), "{combined:?}");
    }

    #[test]
    fn what_is_no_covariance_is_refused() {
        let bad = CalibrationEstimate { value: vec![0.0; N], covariance: vec![f64::NAN; N * N] };
        assert!(combine(&prior(), &[&bad]).is_none());
        let short = CalibrationEstimate { value: vec![0.0; 2], covariance: vec![0.0; 4] };
        assert!(combine(&prior(), &[&short]).is_none());
    }
}
