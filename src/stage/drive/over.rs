//! Range corrections over something else than the range: the incidence and the intensity.
//!
//! A rangefinder may show a range longer or shorter by how steeply a beam meets a surface, for its spot is drawn out, and by how strong the echo is,
//! for a weak one passes its threshold later. Both act along the ray as the curve over the range does, `∂l = r/ρ B(x)`, with x the angle between
//! beam and normal in degrees, or the logarithm of the intensity.
//!
//! What such a curve adds in the mean over the data is a constant of the range, and the range correction has that already: the prior holds
//! the mean at zero.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::constants::Term;
use super::curve::Spline;
use super::known::Known;
use crate::project::{Project, RangeOver};

/// What a range correction may be over, beside the range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Over {
    /// The angle between beam and normal.
    Incidence,
    /// The intensity as the strips have it.
    Intensity,
}

/// What a beam met.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Target {
    /// Unit normal of the surface, either way, body axes.
    pub normal_body: Vector3<f64>,
    /// Intensity as the strips have it.
    pub intensity: f64,
}

impl Over {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Incidence, Self::Intensity];

    /// The name used in files and reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Incidence => "incidence",
            Self::Intensity => "intensity",
        }
    }

    /// The term of the calibration.
    #[must_use]
    pub fn term(self) -> Term {
        match self {
            Self::Incidence => Term::Incidence,
            Self::Intensity => Term::Intensity,
        }
    }

    /// Where a value, in degrees or as the strips have it, lies on the scale on which knots are evenly spaced.
    #[must_use]
    #[inline]
    pub fn on_scale(self, value: f64) -> f64 {
        match self {
            Self::Incidence => value,
            Self::Intensity => value.max(1.0).ln(),
        }
    }

    /// The value at a place of the scale.
    #[must_use]
    pub fn value(self, place: f64) -> f64 {
        match self {
            Self::Incidence => place,
            Self::Intensity => place.exp(),
        }
    }

    /// Where a ray to a target lies on the scale.
    #[must_use]
    pub fn place(self, target: &Target, ray_m: &Vector3<f64>) -> f64 {
        match self {
            Self::Incidence => incidence_deg(&target.normal_body, ray_m),
            Self::Intensity => self.on_scale(target.intensity),
        }
    }

    /// Spacing of knots, over how much a bend forgets, and how much data must span for a curve: on the scale.
    pub(super) fn lengths(self) -> (f64, f64, f64) {
        match self {
            Self::Incidence => (5.0, 20.0, 15.0),
            Self::Intensity => (0.25, 1.0, 0.7),
        }
    }

    /// Spacing of the rows of a file, on the scale.
    #[must_use]
    pub fn row_spacing(self) -> f64 {
        match self {
            Self::Incidence => 1.0,
            Self::Intensity => 0.1,
        }
    }

    /// The spline from a first to a last value that has so many coefficients; none where there is no such spline.
    #[must_use]
    pub fn spline_of(self, first: f64, last: f64, coefficients: usize) -> Option<Spline> {
        let is_on_scale = match self {
            Self::Incidence => first >= 0.0 && last <= 90.0,
            Self::Intensity => first >= 1.0,
        };
        is_on_scale.then(|| Spline::of_coefficients(self.on_scale(first), self.on_scale(last), coefficients)).flatten()
    }
}

/// Angle between a ray and a normal, either way \[deg\].
#[must_use]
#[inline]
pub fn incidence_deg(normal: &Vector3<f64>, ray_m: &Vector3<f64>) -> f64 {
    let cosine = normal.dot(ray_m).abs() / ray_m.norm().max(1e-3);
    cosine.min(1.0).acos().to_degrees()
}

/// A curve that is added to ranges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OverCurve {
    /// What it is over.
    pub over: Over,
    /// Spline on its scale.
    pub spline: Spline,
    /// Coefficients \[m\].
    pub coefficients_m: Vec<f64>,
}

/// What curves add to the range of a ray to a target \[m\].
#[must_use]
pub fn longer_m(curves: &[OverCurve], target: &Target, ray_m: &Vector3<f64>) -> f64 {
    curves.iter().map(|c| c.spline.at(&c.coefficients_m, c.over.place(target, ray_m))).sum()
}

/// Whether a term is among those that a project asks for; all are that are over nothing else than the range.
#[must_use]
pub fn is_asked(project: &Project, term: Term) -> bool {
    let has = |over: RangeOver| project.calibrate.range_over.contains(&over);
    match term {
        Term::Incidence => has(RangeOver::Incidence),
        Term::Intensity => has(RangeOver::Intensity),
        _ => true,
    }
}

/// What corrections are over that are asked for or known.
#[must_use]
pub fn wanted(project: &Project, known: &[Known]) -> Vec<Over> {
    let is_known = |over: Over| known.iter().flat_map(|k| &k.over).any(|c| c.over == over);
    let is_estimated = |over: Over| project.calibrate.enabled && is_asked(project, over.term());
    Over::ALL.into_iter().filter(|over| is_estimated(*over) || is_known(*over)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::project::parse_str;
    use crate::stage::drive::constants::{Beam, Constants, Spread};
    use crate::stage::drive::known;
    use crate::stage::drive::seen::tests::seen;

    /// A beam on level ground, seen over a patch.
    fn beam() -> Beam {
        Beam {
            patch: Spread { rays_m: [Vector3::new(0.2, 0.1, 0.0), Vector3::new(-0.1, 0.2, 0.0)], feature: [0.7, -0.4] },
            target: Target { normal_body: Vector3::z(), intensity: 900.0 },
            ..known::tests::beam()
        }
    }

    #[test]
    fn a_curve_moves_a_beam_as_its_derivatives_say() {
        let project = parse_str(
            "[[strips]]\npath = \"*.laz\"\n[imu]\npath = \"imu.txt\"\ngrade = \"ap60\"\n[platform]\n[[platform.scanner]]\nid = 0\n\
             lever_arm_m = [1.0, 0.2, -0.3]\n[calibrate]\nrange_over = [\"range\", \"incidence\", \"intensity\"]\n",
        )
        .expect("a project");
        assert_eq!(wanted(&project, &[]), Over::ALL);
        let arm_m = Vector3::new(1.0, 0.2, -0.3);
        for term in [Term::Incidence, Term::Intensity] {
            let constants = Constants::new(&project, &[], &[(2.0, 20.0)], &seen(), |_, t| t == term);
            let values: Vec<f64> = (0..constants.count()).map(|k| 1e-3 * (k as f64).sin()).collect();
            let over = constants.over_curves(0, &values);
            assert_eq!(over.len(), 1);
            let known = Known { over, ..Known::default() };
            let moved = known.applied(&beam(), &arm_m).body_vector_m - beam().body_vector_m;
            let rows = constants.derivatives(&beam());
            let said: Vector3<f64> = rows.iter().map(|(k, by)| by * values[*k]).sum();
            assert!((moved - said).norm() < 1e-15 && moved.norm() > 1e-4, "{term:?}: {moved} {said}");
        }
        // a level surface: the incidence is the angle to the vertical
        let ray_m = beam().body_vector_m - arm_m;
        let expected = (ray_m.z / ray_m.norm()).acos().to_degrees();
        assert!((Over::Incidence.place(&beam().target, &ray_m) - expected).abs() < 1e-12);
        assert!(
            (incidence_deg(&-Vector3::z(), &ray_m) - expected).abs() < 1e-12,
            "the side of a normal does not matter"
        );
    }

    #[test]
    fn a_known_boresight_turns_a_target_with_its_ray() {
        let (first, last) = (0.0, 80.0);
        let spline = Over::Incidence.spline_of(first, last, 7).expect("a span");
        let over = vec![OverCurve { over: Over::Incidence, spline, coefficients_m: (0..7).map(f64::from).collect() }];
        let longer_m = |boresight_rad: Vector3<f64>| {
            let with = Known { boresight_rad, over: over.clone(), ..Known::default() };
            let without = Known { boresight_rad, ..Known::default() };
            let narrow = Beam { patch: Spread::default(), ..beam() };
            let at = |known: &Known| known.applied(&narrow, &Vector3::zeros()).body_vector_m;
            (at(&with) - at(&without)).norm()
        };
        assert!((longer_m(Vector3::new(0.1, -0.2, 0.3)) - longer_m(Vector3::zeros())).abs() < 1e-9);
    }

    #[test]
    fn splines_off_their_scale_are_refused() {
        assert!(
            Over::Incidence.spline_of(-1.0, 80.0, 9).is_none() && Over::Incidence.spline_of(0.0, 91.0, 9).is_none()
        );
        assert!(Over::Intensity.spline_of(0.5, 80.0, 9).is_none() && Over::Intensity.spline_of(10.0, 9.0, 9).is_none());
        assert!(
            Over::Intensity.spline_of(10.0, 900.0, 3).is_none()
                && Over::Intensity.spline_of(10.0, f64::NAN, 9).is_none()
        );
        let spline = Over::Intensity.spline_of(10.0, 900.0, 9).expect("a span");
        let (first, last) = spline.span();
        assert!((first - 10_f64.ln()).abs() < 1e-12 && (last - 900_f64.ln()).abs() < 1e-12);
    }
}
