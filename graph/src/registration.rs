//! Registration of two submaps in the plane by points that both hold: their relative pose and its information.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

use crate::rotation::{perpendicular, turn};
use crate::variable::wrap;

/// A point of a submap, in its frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Place \[m\].
    pub place_m: Vector2<f64>,
    /// Its covariance \[m²\].
    pub covariance_m2: Matrix2<f64>,
}

impl Seen {
    /// From range \[m\] and bearing \[rad\], with the sigmas along and across the beam \[m\].
    #[must_use]
    pub fn from_range_bearing(range_m: f64, bearing_rad: f64, along_sigma_m: f64, across_sigma_m: f64) -> Self {
        let r = turn(bearing_rad);
        let own = Matrix2::new(along_sigma_m.powi(2), 0.0, 0.0, across_sigma_m.powi(2));
        Self { place_m: r * Vector2::new(range_m, 0.0), covariance_m2: r * own * r.transpose() }
    }
}

/// Two submaps put onto each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Registered {
    /// Frame of the second submap in that of the first: x, y \[m\], angle \[rad\].
    pub second_in_first: [f64; 3],
    /// Its information, as [`crate::factor::pose2::Between2`] takes it: from the normal matrix, so it knows the shape
    /// of what was seen. In a street whose fronts are seen from abeam it is weak along the street.
    pub information: Matrix3<f64>,
    /// Sum of squares of the whitened residuals.
    pub chi2: f64,
    /// Residuals less unknowns.
    pub degrees_of_freedom: usize,
}

/// Why submaps cannot be registered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RegistrationError {
    /// Not the same points, or too few.
    #[error("a registration takes two points or more, the same in both submaps; found {first} and {second}")]
    Points {
        /// Points of the first submap.
        first: usize,
        /// Points of the second.
        second: usize,
    },
    /// Points in one place, or covariances that are none.
    #[error("the points do not fix the angle: all in one place, or with a covariance that is not positive definite")]
    NotDetermined,
}

/// Most iterations, and the step that is the last.
const ITERATIONS: usize = 20;
const LAST_STEP: f64 = 1e-10;

/// Relative pose of two submaps from points known to be the same, in the same order: least squares with the
/// covariances of both sides, `Σ vᵀ (A + R B Rᵀ)⁻¹ v` with `v = a - (R b + t)`. It is the normal equations of both
/// submaps with the points eliminated.
///
/// # Errors
/// [`RegistrationError`].
pub fn register(first: &[Seen], second: &[Seen]) -> Result<Registered, RegistrationError> {
    let n = first.len();
    if n < 2 || second.len() != n {
        return Err(RegistrationError::Points { first: n, second: second.len() });
    }
    let [mut x, mut y, mut angle] = unweighted(first, second);
    let mut information = Matrix3::zeros();
    let mut chi2 = 0.0;
    for _ in 0..ITERATIONS {
        let r = turn(angle);
        let mut right = Vector3::zeros();
        (information, chi2) = (Matrix3::zeros(), 0.0);
        for (a, b) in first.iter().zip(second) {
            let weight = (a.covariance_m2 + r * b.covariance_m2 * r.transpose()).try_inverse();
            let weight = weight.ok_or(RegistrationError::NotDetermined)?;
            let swing = r * perpendicular(&b.place_m);
            let v = a.place_m - (r * b.place_m + Vector2::new(x, y));
            let j = Matrix2x3::new(r[(0, 0)], r[(0, 1)], swing.x, r[(1, 0)], r[(1, 1)], swing.y);
            information += j.transpose() * weight * j;
            right += j.transpose() * weight * v;
            chi2 += v.dot(&(weight * v));
        }
        let step = information.cholesky().ok_or(RegistrationError::NotDetermined)?.solve(&right);
        if !step.iter().all(|s| s.is_finite()) {
            return Err(RegistrationError::NotDetermined);
        }
        let shift = r * Vector2::new(step.x, step.y);
        (x, y, angle) = (x + shift.x, y + shift.y, wrap(angle + step.z));
        if step.amax() < LAST_STEP {
            break;
        }
    }
    Ok(Registered { second_in_first: [x, y, angle], information, chi2, degrees_of_freedom: 2 * n - 3 })
}

/// First values: the same with equal weights, in closed form.
#[allow(clippy::cast_precision_loss)] // few points
fn unweighted(first: &[Seen], second: &[Seen]) -> [f64; 3] {
    let middle = |points: &[Seen]| points.iter().map(|p| p.place_m).sum::<Vector2<f64>>() / points.len() as f64;
    let (ma, mb) = (middle(first), middle(second));
    let (mut cos, mut sin) = (0.0, 0.0);
    for (a, b) in first.iter().zip(second) {
        let (a, b) = (a.place_m - ma, b.place_m - mb);
        cos += b.dot(&a);
        sin += perpendicular(&b).dot(&a);
    }
    let angle = sin.atan2(cos);
    let t = ma - turn(angle) * mb;
    [t.x, t.y, angle]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fronts of a street, 10 m to either side, seen from abeam with 0.03 m along and 0.3 m across the beam.
    fn street(pose: [f64; 3]) -> Vec<Seen> {
        let places = [(-3.0, 10.0), (2.0, 10.0), (-1.0, -10.0), (4.0, -10.0)];
        let seen = places.iter().map(|(x, y)| {
            let d = turn(-pose[2]) * (Vector2::new(*x, *y) - Vector2::new(pose[0], pose[1]));
            Seen::from_range_bearing(d.norm(), d.y.atan2(d.x), 0.03, 0.3)
        });
        seen.collect()
    }

    #[test]
    fn a_known_move_comes_back_exactly() {
        let second = [1.5, -0.4, 2.9];
        let found = register(&street([0.0; 3]), &street(second)).expect("four points");
        for (f, s) in found.second_in_first.iter().zip(second) {
            assert!((f - s).abs() < 1e-9, "{found:?}");
        }
        assert!(found.chi2 < 1e-12 && found.degrees_of_freedom == 5);
    }

    #[test]
    fn the_way_along_a_street_is_weaker_than_across() {
        let found = register(&street([0.0; 3]), &street([1.0, 0.0, 0.0])).expect("four points");
        let covariance = found.information.try_inverse().expect("determined");
        assert!(covariance[(0, 0)].sqrt() > 3.0 * covariance[(1, 1)].sqrt(), "{covariance}");
    }

    #[test]
    fn points_in_one_place_or_of_different_number_are_refused() {
        let seen = street([0.0; 3]);
        assert_eq!(register(&seen, &seen[..3]), Err(RegistrationError::Points { first: 4, second: 3 }));
        assert_eq!(register(&seen[..1], &seen[..1]), Err(RegistrationError::Points { first: 1, second: 1 }));
        let hidden = Seen { covariance_m2: Matrix2::zeros(), ..seen[0] };
        assert_eq!(register(&[hidden, hidden], &[hidden, hidden]), Err(RegistrationError::NotDetermined));
    }
}
