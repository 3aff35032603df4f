//! Slabs: facets of one orientation close to each other, which may be off together.
//!
//! A roof whose tiles reflect from deeper on one pass, a car park that has been laid anew, a meadow: all their facets
//! are off by one amount along their normal. A slab is all facets of one bin of orientations in one block of space;
//! its common error has variance τ² beside the noise of each facet, so that a slab never says more than 1/τ², however
//! many facets it has. τ is found from the residuals, for level, sloped and steep slabs.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Vector3};

use super::facet::Facet;
use crate::select::normal_bin;

/// Level below 10°, steep above 60°, else sloped.
pub(crate) fn class(facet: &Facet) -> usize {
    match facet.normal.z.abs() {
        z if z > 0.984_807_753 => 0,
        z if z < 0.5 => 2,
        _ => 1,
    }
}

/// Facets that may be off together.
#[derive(Debug, Clone)]
pub(crate) struct Slab {
    pub(crate) members: Vec<usize>,
    pub(crate) class: usize,
}

/// Deals facets into slabs: blocks of `edge_m`, bins of orientation, level ones apart from others.
pub(crate) fn slabs(facets: &[Facet], edge_m: f64) -> Vec<Slab> {
    let mut found: BTreeMap<([i64; 3], usize, u8), Vec<usize>> = BTreeMap::new();
    for (k, facet) in facets.iter().enumerate() {
        #[allow(clippy::cast_possible_truncation)]
        let block = facet.centre_m.map(|c| (c / edge_m).floor() as i64);
        found.entry((block.into(), class(facet), normal_bin(&facet.normal))).or_default().push(k);
    }
    found.into_iter().map(|((_, class, _), members)| Slab { members, class }).collect()
}

/// Fewest facets of a sloped or steep slab.
const COMPANY: usize = 3;

/// Facets that stand alone with their orientation: heaps of leaves are flat by chance here and there, but a roof has
/// neighbours that agree.
pub(crate) fn lonely(slabs: &[Slab], facets: usize) -> Vec<bool> {
    let mut lonely = vec![false; facets];
    for slab in slabs.iter().filter(|s| s.class != 0 && s.members.len() < COMPANY) {
        slab.members.iter().for_each(|k| lonely[*k] = true);
    }
    lonely
}

/// Sums over a slab: m = Σw, c = Σwv.
pub(crate) fn sums(slab: &Slab, w: &[f64], v: &[f64]) -> (f64, f64) {
    slab.members.iter().fold((0.0, 0.0), |(m, c), k| (m + w[*k], c + w[*k] * v[*k]))
}

/// Sigmas of χ² beyond which facets are off together.
const CHANCE: f64 = 2.0;
/// Steps of the search for τ².
const BISECTIONS: usize = 40;
/// Largest τ \[m\] that is looked for.
const LARGEST_TAU_M: f64 = 0.5;
/// Fewest slabs of a class for a τ of its own.
const FEWEST_SLABS: usize = 6;

/// τ² \[m²\] of each class: that at which Σ c²/(m (1 + τ² m)) is what it should be, the number of slabs less the share
/// of the unknowns (the generalised sum of squares of Paule and Mandel 1982).
#[allow(clippy::cast_precision_loss)]
pub(crate) fn variances_m2(slabs: &[Slab], w: &[f64], v: &[f64], unknowns: usize) -> [f64; 3] {
    let live: Vec<(usize, f64, f64)> = slabs
        .iter()
        .map(|s| (s.class, sums(s, w, v)))
        .filter(|(_, (m, _))| *m > 0.0)
        .map(|(class, (m, c))| (class, m, c))
        .collect();
    let free = (1.0 - unknowns as f64 / live.len().max(1) as f64).max(0.1);
    let of = |wanted: Option<usize>| {
        let of_class = || live.iter().filter(|(class, ..)| wanted.is_none_or(|w| w == *class));
        let expected = free * of_class().count() as f64;
        let sum = |tau_m2: f64| of_class().map(|(_, m, c)| c * c / (m * (1.0 + tau_m2 * m))).sum::<f64>();
        // a sum of squares that chance alone makes of independent facets, by two sigmas of χ², is no common error
        if sum(0.0) <= expected + CHANCE * (2.0 * expected).sqrt() {
            return (of_class().count(), 0.0);
        }
        let (mut low, mut high) = (0.0, LARGEST_TAU_M * LARGEST_TAU_M);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if sum(middle) > expected { low = middle } else { high = middle }
        }
        (of_class().count(), high)
    };
    let all = of(None).1;
    std::array::from_fn(|class| match of(Some(class)) {
        (count, own) if count >= FEWEST_SLABS => own,
        _ => all,
    })
}

/// The best guess of a slab's common error \[m\]: τ² c / (1 + τ² m).
pub(crate) fn common_error_m(m: f64, c: f64, tau_m2: f64) -> f64 {
    tau_m2 * c / (1.0 + tau_m2 * m)
}

/// A slab's normal matrix and right side, its common error eliminated:
/// N = Σ w J Jᵀ - (Σ w J)(Σ w J)ᵀ τ²/(1 + τ² m), and b alike.
pub(crate) fn normal_of(
    slab: &Slab,
    rows: &[DVector<f64>],
    w: &[f64],
    v: &[f64],
    tau_m2: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let unknowns = rows.first().map_or(0, DVector::len);
    let (mut n, mut b) = (DMatrix::zeros(unknowns, unknowns), DVector::zeros(unknowns));
    let mut sum = DVector::zeros(unknowns);
    for k in slab.members.iter().copied().filter(|k| w[*k] > 0.0) {
        n.ger(w[k], &rows[k], &rows[k], 1.0);
        b.axpy(-w[k] * v[k], &rows[k], 1.0);
        sum.axpy(w[k], &rows[k], 1.0);
    }
    let (m, c) = sums(slab, w, v);
    let share = tau_m2 / (1.0 + tau_m2 * m);
    n.ger(-share, &sum, &sum, 1.0);
    b.axpy(share * c, &sum, 1.0);
    (n, b)
}

/// What the noise of a slab's normals alone adds to its normal matrix: the same formula in expectation,
/// Σ (w - w² τ²/(1 + τ² m)) A Σₙ Aᵀ with A = ∂J/∂n.
pub(crate) fn pretended_of(
    slab: &Slab,
    facets: &[Facet],
    lever: &dyn Fn(&Vector3<f64>) -> DMatrix<f64>,
    w: &[f64],
    tau_m2: f64,
    sum: &mut DMatrix<f64>,
) {
    let m: f64 = slab.members.iter().map(|k| w[*k]).sum();
    let share = tau_m2 / (1.0 + tau_m2 * m);
    for k in slab.members.iter().copied().filter(|k| w[*k] > 0.0) {
        let a = lever(&facets[k].centre_m);
        *sum += &a * facets[k].normal_covariance * a.transpose() * (w[k] - w[k] * w[k] * share);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// `count` slabs of four facets each, 100 m apart; facet k is off by `error_m(slab, facet)`.
    fn row(count: usize, error_m: impl Fn(usize, usize) -> f64) -> (Vec<Facet>, Vec<f64>) {
        let slope = Vector3::new(0.5, 0.2, 1.0).normalize();
        let facet = |k: usize| Facet {
            #[allow(clippy::cast_precision_loss)]
            centre_m: Vector3::new((k / 4) as f64 * 100.0 + 1.0 + (k % 4) as f64, 1.0, 1.0),
            normal: slope,
            distance_m: 0.0,
            sigma_m: 0.002,
            normal_covariance: Matrix3::zeros(),
            time_s: [0.0; 2],
            points: [10; 2],
        };
        ((0..4 * count).map(facet).collect(), (0..4 * count).map(|k| error_m(k / 4, k % 4)).collect())
    }

    #[test]
    fn what_slabs_have_in_common_is_found_and_noise_is_not_taken_for_it() {
        let to_and_fro = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        let (facets, errors_m) = row(40, |slab, facet| 0.01 * to_and_fro(slab) + 0.002 * to_and_fro(facet));
        let w = vec![1.0 / (0.002 * 0.002); facets.len()];
        let found = slabs(&facets, 10.0);
        assert_eq!(found.len(), 40);
        let tau_m = variances_m2(&found, &w, &errors_m, 0)[1].sqrt();
        assert!((tau_m - 0.01).abs() < 0.001, "{tau_m}");
        let (_, alone) = row(40, |slab, facet| 0.002 * to_and_fro(slab / 2 + facet));
        assert!(variances_m2(&found, &w, &alone, 0)[1] < 1e-12);
    }

    #[test]
    fn a_slab_never_says_more_than_its_common_error_allows() {
        let (facets, errors_m) = row(1, |_, _| 0.0);
        let rows: Vec<DVector<f64>> = facets.iter().map(|f| DVector::from_column_slice(f.normal.as_slice())).collect();
        let w = vec![1e12; facets.len()];
        let (n, _) = normal_of(&slabs(&facets, 10.0)[0], &rows, &w, &errors_m, 0.01 * 0.01);
        let along = rows[0].dot(&(&n * &rows[0]));
        assert!((along - 1e4).abs() < 10.0, "{along}");
    }

    #[test]
    fn one_plane_of_leaves_has_no_company() {
        let (mut facets, _) = row(1, |_, _| 0.0);
        facets[3].normal = Vector3::new(-0.5, 0.2, 1.0).normalize();
        assert_eq!(lonely(&slabs(&facets, 10.0), 4), [false, false, false, true]);
    }
}
