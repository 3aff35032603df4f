//! Where data lie on the scales that range corrections may be over, and what is known of a curve there beforehand.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};

use super::constants::Constants;
use super::curve::Spline;
use super::known::Known;
use super::over::{self, Over};
use super::ties::Sighted;
use crate::project::Project;

/// Curves beforehand: what bends \[m\].
const BEND_SIGMA_M: f64 = 0.005;
/// And what they are in the mean over the data \[m\]: nothing.
const MEAN_SIGMA_M: f64 = 1e-5;
/// Data of a scanner are told by so many quantiles, evenly, ends included: every half per cent.
const QUANTILES: usize = 201;

/// Where the data of a scanner lie on the scale of what a correction is over.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// What it is.
    pub over: Over,
    /// Quantiles of the places, rising and even; none without data.
    quantiles: Vec<f64>,
    /// Between these lies all but the half per cent at either end; of several drives, of any of them.
    inner: (f64, f64),
}

impl Seen {
    /// Of all places.
    #[must_use]
    pub fn new(scanner: usize, over: Over, mut places: Vec<f64>) -> Self {
        places.retain(|p| p.is_finite());
        places.sort_by(f64::total_cmp);
        let quantile = |k: usize| places[k * (places.len() - 1) / (QUANTILES - 1)];
        let quantiles: Vec<f64> = if places.is_empty() { Vec::new() } else { (0..QUANTILES).map(quantile).collect() };
        let inner = if places.is_empty() { (0.0, 0.0) } else { (quantiles[1], quantiles[QUANTILES - 2]) };
        Self { scanner, over, quantiles, inner }
    }

    /// Takes in those of another drive, each drive counting alike.
    pub fn widen(&mut self, other: &Self) {
        if self.quantiles.is_empty() {
            self.inner = other.inner;
        } else if !other.quantiles.is_empty() {
            self.inner = (self.inner.0.min(other.inner.0), self.inner.1.max(other.inner.1));
        }
        self.quantiles.extend(&other.quantiles);
        self.quantiles.sort_by(f64::total_cmp);
    }

    /// What is to be said where there is too little for a curve.
    #[must_use]
    pub fn note(&self) -> Option<String> {
        self.span().is_none().then(|| {
            let unit = match self.over {
                Over::Incidence => "15 degrees",
                Over::Intensity => "a factor of two",
            };
            format!(
                "scanner {}, {}: the ties of this scanner span less than {unit}; it is not estimated",
                self.scanner,
                self.over.term().as_str()
            )
        })
    }

    /// First and last place, where there is enough between them.
    fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (*self.quantiles.first()?, *self.quantiles.last()?);
        (self.inner.1 - self.inner.0 >= self.over.lengths().2).then_some((first, last))
    }
}

/// The spline of a scanner's correction.
#[derive(Debug, Clone, PartialEq)]
pub struct OverSpline {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// What it is over.
    pub over: Over,
    /// On its scale.
    pub spline: Spline,
    /// Where curves are told: all data but the half per cent at either end, on the scale.
    pub inner: (f64, f64),
    /// Covariance of the coefficients beforehand \[m²\].
    pub prior: DMatrix<f64>,
}

impl OverSpline {
    /// A spline over all that was seen; none where that is too little.
    #[must_use]
    pub fn new(seen: &Seen) -> Option<Self> {
        let (first, last) = seen.span()?;
        let spline = Spline::new(first, last, seen.over.lengths().0);
        let prior = prior(&spline, seen);
        Some(Self { scanner: seen.scanner, over: seen.over, spline, inner: seen.inner, prior })
    }

    /// Places at which a curve is told, as the rows of a file have them.
    #[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss)]
    pub fn rows(&self) -> impl Iterator<Item = f64> + use<> {
        let step = self.over.row_spacing();
        let (first, last) = ((self.inner.0 / step).ceil() as i64, (self.inner.1 / step).floor() as i64);
        (first..=last).map(move |k| k as f64 * step)
    }
}

/// Coefficients beforehand: a bend that forgets, `P`, given that the mean over the data, `mᵀ c`, is nothing: `P - P m (mᵀ P m + s²)⁻¹ mᵀ P`.
#[allow(clippy::cast_precision_loss)]
fn prior(spline: &Spline, seen: &Seen) -> DMatrix<f64> {
    let n = spline.coefficients();
    let (_, forgets, _) = seen.over.lengths();
    let free = DMatrix::from_fn(n, n, |i, j| {
        let apart = 3.0_f64.sqrt() * (spline.centre(i) - spline.centre(j)).abs() / forgets;
        let own = if i == j { 1e-4 } else { 0.0 };
        BEND_SIGMA_M.powi(2) * ((1.0 + apart) * (-apart).exp() + own)
    });
    let mut mean = DVector::zeros(n);
    for place in &seen.quantiles {
        let (first, weights) = spline.weights(*place);
        weights.iter().enumerate().for_each(|(k, w)| mean[first + k] += w / seen.quantiles.len() as f64);
    }
    let across = &free * &mean;
    let variance_m2 = mean.dot(&across) + MEAN_SIGMA_M.powi(2);
    let held = &free - &across * across.transpose() / variance_m2;
    (&held + held.transpose()) * 0.5
}

/// What was seen of all drives: those of equal scanner and scale taken together.
pub fn widen_all(all: &mut Vec<Seen>, others: &[Seen]) {
    let known: BTreeSet<(usize, Over)> = all.iter().map(|s| (s.scanner, s.over)).collect();
    for other in others {
        if known.contains(&(other.scanner, other.over)) {
            all.iter_mut().filter(|s| (s.scanner, s.over) == (other.scanner, other.over)).for_each(|s| s.widen(other));
        } else {
            all.push(other.clone());
        }
    }
}

/// What the ends of all lines have of what corrections are over that are asked for or known, by scanners.
#[must_use]
pub fn seen_of(project: &Project, known: &[Known], sighted: &Sighted, constants: &Constants) -> Vec<Seen> {
    let scanners = constants.splines.len();
    let of = |over: Over| (0..scanners).map(move |scanner| sighted.seen(scanner, over, constants));
    over::wanted(project, known).into_iter().flat_map(of).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Angles from 10° to 70°, most of them steep, and intensities over three decades.
    pub(in super::super) fn seen() -> Vec<Seen> {
        let share = |k: u32| f64::from(k) / 999.0;
        vec![
            Seen::new(0, Over::Incidence, (0..1000).map(|k| 70.0 - 60.0 * share(k).powi(3)).collect()),
            Seen::new(0, Over::Intensity, (0..1000).map(|k| 4.0 + 7.0 * share(k)).collect()),
        ]
    }

    #[test]
    fn the_mean_over_the_data_is_held_and_bends_are_free() {
        for seen in seen() {
            let own = OverSpline::new(&seen).expect("enough");
            let n = own.spline.coefficients();
            assert!(own.prior.clone().cholesky().is_some(), "{:?}: no covariance", own.over);
            let row = |places: &[f64]| {
                let mut row = DVector::zeros(n);
                for place in places {
                    let (first, weights) = own.spline.weights(*place);
                    (0..4).for_each(|k| row[first + k] += weights[k] / places.len() as f64);
                }
                row
            };
            let sigma_m = |row: &DVector<f64>| row.dot(&(&own.prior * row)).sqrt();
            let mean_m = sigma_m(&row(&seen.quantiles));
            assert!(mean_m < 1.01 * MEAN_SIGMA_M, "{:?}: {mean_m}", own.over);
            let bend_m = sigma_m(&(row(&[seen.quantiles[0]]) - row(&[seen.quantiles[QUANTILES - 1]])));
            assert!(bend_m > BEND_SIGMA_M, "{:?}: {bend_m}", own.over);
        }
    }

    #[test]
    fn too_little_makes_no_curve_and_drives_are_taken_together() {
        let narrow = Seen::new(1, Over::Incidence, (0..100).map(|k| 30.0 + 0.1 * f64::from(k)).collect());
        assert!(OverSpline::new(&narrow).is_none());
        assert!(narrow.note().is_some_and(|note| note.contains("scanner 1") && note.contains("incidence")));
        let nothing = Seen::new(1, Over::Intensity, Vec::new());
        assert!(OverSpline::new(&nothing).is_none() && nothing.note().is_some());
        let mut all = vec![narrow.clone()];
        let other = Seen::new(1, Over::Incidence, (0..100).map(|k| 50.0 + 0.1 * f64::from(k)).collect());
        widen_all(&mut all, &[other, seen().remove(1)]);
        assert_eq!(all.len(), 2);
        let rows: Vec<f64> = OverSpline::new(&all[0]).expect("enough together").rows().collect();
        assert_eq!((rows[0], rows[rows.len() - 1]), (30.0, 59.0));
    }
}
