//! The constants of a drive's calibration: which there are, what is known of them beforehand, how a sighting depends on them.
//!
//! With nominal lever arm a and ray r = l - a of a body vector l: boresight `∂l = e × r`, lever arm `∂l = e`, latency
//! `∂l = Cᵀ v + ω × l`, range correction `∂l = r/ρ B(ρ)`; all in the body frame, as DESIGN's observation equations.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Rotation3, UnitQuaternion, Vector3};
use tieline_graph::Calibration;

use super::curve::{RangeSpline, Weights};
use super::known::Known;
use super::over::{Over, OverCurve, Target};
use super::seen::{OverSpline, Seen};
use crate::project::Project;

pub use super::spread::Spread;

/// Standard deviation of a scanner's clock beforehand \[s\].
const LATENCY_SIGMA_S: f64 = 2e-4;
/// Range corrections beforehand: what is common to all ranges \[m\], what grows with them, and what bends \[m\].
const RANGE_OFFSET_SIGMA_M: f64 = 0.01;
const RANGE_SCALE_SIGMA: f64 = 1e-4;
const RANGE_BEND_SIGMA_M: f64 = 0.01;
/// Over this much in ln ρ a bend is independent.
const RANGE_BEND_LN: f64 = 0.5;
/// Spacing of knots in ln ρ.
const KNOT_LN: f64 = 0.125;

/// A term of a scanner's calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Term {
    /// Rotation vector in the body frame \[rad\], on the left of the mounting.
    Boresight,
    /// Added to the lever arm, body frame \[m\].
    LeverArm,
    /// True time less stamp \[s\].
    Latency,
    /// Range correction \[m\]: coefficients of a spline.
    Range,
    /// Range correction over the angle between beam and normal \[m\]: coefficients of a spline.
    Incidence,
    /// Range correction over the intensity \[m\]: coefficients of a spline.
    Intensity,
}

impl Term {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Boresight, Self::LeverArm, Self::Latency, Self::Range, Self::Incidence, Self::Intensity];

    /// The name used in reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Boresight => "boresight",
            Self::LeverArm => "lever arm",
            Self::Latency => "latency",
            Self::Range => "range correction",
            Self::Incidence => "range correction over incidence",
            Self::Intensity => "range correction over intensity",
        }
    }

    /// Whether its constants are coefficients of a curve.
    #[must_use]
    pub fn is_curve(self) -> bool {
        matches!(self, Self::Range | Self::Incidence | Self::Intensity)
    }
}

/// The constants of one term of one scanner: they stand together.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// Term.
    pub term: Term,
    /// First constant.
    pub first: usize,
    /// Covariance beforehand.
    pub prior: DMatrix<f64>,
}

impl Group {
    /// Its constants.
    #[must_use]
    pub fn constants(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.prior.nrows()
    }
}

/// All constants.
#[derive(Debug, Clone, PartialEq)]
pub struct Constants {
    /// By scanner and term.
    pub groups: Vec<Group>,
    /// Splines of range corrections, by scanner.
    pub splines: Vec<RangeSpline>,
    /// Splines of corrections over incidence and intensity, where these are asked for.
    pub over: Vec<OverSpline>,
    lever_arms_m: Vec<Vector3<f64>>,
    axes: Vec<Vector3<f64>>,
    known: Vec<Known>,
}

/// Where a beam was when it measured: what the derivatives need.
#[derive(Debug, Clone, Copy)]
pub struct Beam {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// From the IMU to the feature, body axes \[m\].
    pub body_vector_m: Vector3<f64>,
    /// Velocity of the IMU over ground, body axes \[m/s\].
    pub velocity_body_mps: Vector3<f64>,
    /// Angular rate against north, east, down, body axes \[rad/s\].
    pub rate_body_radps: Vector3<f64>,
    /// The patch that the feature is of.
    pub patch: Spread,
    /// What it met.
    pub target: Target,
}

impl Constants {
    /// The constants of a project's scanners that are wanted, beyond what is known of each; ranges \[m\] reach from the nearest to the
    /// farthest in use, for each; over what else corrections are estimated, and where there are data for it, is in `seen`.
    #[must_use]
    pub fn new(
        project: &Project,
        known: &[Known],
        ranges_m: &[(f64, f64)],
        seen: &[Seen],
        wanted: impl Fn(usize, Term) -> bool,
    ) -> Self {
        let section = &project.calibrate;
        let lever_arm = |scanner: usize| {
            let known = project.platform.scanner.iter().find(|s| usize::from(s.id) == scanner);
            known.map_or_else(Vector3::zeros, |s| Vector3::from(s.lever_arm_m))
        };
        let axis = |scanner: usize| {
            let known = project.platform.scanner.iter().find(|s| usize::from(s.id) == scanner);
            let [roll, pitch, yaw] = known.map_or([0.0; 3], |s| s.mounting_deg.map(f64::to_radians));
            UnitQuaternion::from_euler_angles(roll, pitch, yaw) * Vector3::x()
        };
        let splines: Vec<RangeSpline> =
            ranges_m.iter().map(|(near_m, far_m)| RangeSpline::new(*near_m, *far_m, KNOT_LN)).collect();
        let over: Vec<OverSpline> = seen.iter().filter_map(OverSpline::new).collect();
        let mut groups = Vec::new();
        let mut first = 0;
        for (scanner, spline) in splines.iter().enumerate() {
            for term in Term::ALL {
                let of_over = |asked: Over| {
                    let found = over.iter().find(|o| (o.scanner, o.over) == (scanner, asked));
                    (found.is_some(), found.map_or_else(|| DMatrix::zeros(0, 0), |o| o.prior.clone()))
                };
                let (asked, prior) = match term {
                    Term::Boresight => (section.boresight, axes(section.boresight_sigma_deg.to_radians())),
                    Term::LeverArm => (section.lever_arm, axes(section.lever_arm_sigma_m)),
                    Term::Latency => (section.latency, DMatrix::from_element(1, 1, LATENCY_SIGMA_S.powi(2))),
                    Term::Range => (section.has_range_curve(), range_prior(spline)),
                    Term::Incidence => of_over(Over::Incidence),
                    Term::Intensity => of_over(Over::Intensity),
                };
                if section.enabled && asked && wanted(scanner, term) {
                    let count = prior.nrows();
                    groups.push(Group { scanner, term, first, prior });
                    first += count;
                }
            }
        }
        Self {
            groups,
            splines,
            over,
            lever_arms_m: (0..ranges_m.len()).map(lever_arm).collect(),
            axes: (0..ranges_m.len()).map(axis).collect(),
            known: known.to_vec(),
        }
    }

    /// Number of constants.
    #[must_use]
    pub fn count(&self) -> usize {
        self.groups.last().map_or(0, |g| g.first + g.prior.nrows())
    }

    /// Covariance beforehand, row-major.
    #[must_use]
    pub fn covariance(&self) -> Vec<f64> {
        let n = self.count();
        let mut all = DMatrix::zeros(n, n);
        for group in &self.groups {
            all.view_mut((group.first, group.first), group.prior.shape()).copy_from(&group.prior);
        }
        all.as_slice().to_vec() // symmetric: either order
    }

    /// First constant of a term of a scanner.
    #[must_use]
    pub fn first(&self, scanner: usize, term: Term) -> Option<usize> {
        self.groups.iter().find(|g| g.scanner == scanner && g.term == term).map(|g| g.first)
    }

    /// A beam as the strips have it, with what is known of its scanner in its body vector.
    #[must_use]
    pub fn known_applied(&self, beam: &Beam) -> Beam {
        self.known.get(beam.scanner).map_or(*beam, |k| k.applied(beam, &self.lever_arm_m(beam.scanner)))
    }

    /// What the body vector of a beam changes by with each constant \[m per unit\]; what is known of the scanner is in the vector.
    #[must_use]
    pub fn derivatives(&self, beam: &Beam) -> Vec<(usize, Vector3<f64>)> {
        let mut rows = Vec::new();
        let known_arm_m = self.known.get(beam.scanner).map_or_else(Vector3::zeros, |k| k.lever_arm_m);
        let ray_m = beam.body_vector_m - self.lever_arm_m(beam.scanner) - known_arm_m;
        for group in self.groups.iter().filter(|g| g.scanner == beam.scanner) {
            let first = group.first;
            let mut put = |k: usize, by: Vector3<f64>| rows.push((first + k, by));
            match group.term {
                Term::Boresight => AXES.iter().enumerate().for_each(|(k, axis)| put(k, axis.cross(&ray_m))),
                Term::LeverArm => AXES.iter().enumerate().for_each(|(k, axis)| put(k, *axis)),
                Term::Latency => put(0, beam.velocity_body_mps + beam.rate_body_radps.cross(&beam.body_vector_m)),
                Term::Range => {
                    let spline = &self.splines[beam.scanner];
                    of_curve(beam, &ray_m, |_, range_m| spline.weights(range_m))
                        .into_iter()
                        .for_each(|(k, by)| put(k, by));
                }
                Term::Incidence | Term::Intensity => {
                    let Some(own) = self.over(group.scanner, group.term) else { continue };
                    let weights = |ray_m: &Vector3<f64>, _| own.spline.weights(own.over.place(&beam.target, ray_m));
                    of_curve(beam, &ray_m, weights).into_iter().for_each(|(k, by)| put(k, by));
                }
            }
        }
        rows
    }

    /// The spline of a scanner's correction over incidence or intensity.
    #[must_use]
    pub fn over(&self, scanner: usize, term: Term) -> Option<&OverSpline> {
        self.over.iter().find(|o| (o.scanner, o.over.term()) == (scanner, term))
    }

    /// From the scanner to the feature \[m\].
    #[must_use]
    pub fn range_m(&self, scanner: usize, body_vector_m: &Vector3<f64>) -> f64 {
        (body_vector_m - self.lever_arm_m(scanner)).norm()
    }

    /// Boresight and lever arm of a scanner, known and estimated, as corrections.
    #[must_use]
    pub fn calibration(&self, scanner: usize, values: &[f64]) -> Calibration {
        let three = |term: Term| {
            self.first(scanner, term).map_or_else(Vector3::zeros, |k| Vector3::from_column_slice(&values[k..k + 3]))
        };
        let known = self.known.get(scanner).cloned().unwrap_or_default();
        let turned = Rotation3::new(three(Term::Boresight)) * Rotation3::new(known.boresight_rad);
        Calibration {
            boresight_rad: turned.scaled_axis(),
            lever_arm_m: known.lever_arm_m + three(Term::LeverArm),
            range_offset_m: 0.0,
            range_scale: 0.0,
        }
    }

    /// The range correction of a scanner \[m\], known and estimated: splines with their coefficients, to be added.
    #[must_use]
    pub fn range_curves(&self, scanner: usize, values: &[f64]) -> Vec<(RangeSpline, Vec<f64>)> {
        let known = self.known.get(scanner).map_or_else(Vec::new, |k| k.ranges.clone());
        let estimated = self.first(scanner, Term::Range).map(|first| {
            let spline = self.splines[scanner];
            (spline, values[first..first + spline.coefficients()].to_vec())
        });
        known.into_iter().chain(estimated).collect()
    }

    /// The same over incidence and intensity.
    #[must_use]
    pub fn over_curves(&self, scanner: usize, values: &[f64]) -> Vec<OverCurve> {
        let known = self.known.get(scanner).map_or_else(Vec::new, |k| k.over.clone());
        let estimated = self.over.iter().filter(|o| o.scanner == scanner).filter_map(|o| {
            let first = self.first(scanner, o.over.term())?;
            let coefficients_m = values[first..first + o.spline.coefficients()].to_vec();
            Some(OverCurve { over: o.over, spline: o.spline, coefficients_m })
        });
        known.into_iter().chain(estimated).collect()
    }

    /// Nominal lever arm of a scanner, body frame \[m\].
    #[must_use]
    pub fn lever_arm_m(&self, scanner: usize) -> Vector3<f64> {
        self.lever_arms_m.get(scanner).copied().unwrap_or_default()
    }

    /// Axis that a profile scanner turns about, by its nominal mounting, body frame.
    #[must_use]
    pub fn axis(&self, scanner: usize) -> Vector3<f64> {
        self.axes.get(scanner).copied().unwrap_or_else(Vector3::x)
    }

    /// True time less stamp of a scanner \[s\], known and estimated.
    #[must_use]
    pub fn latency_s(&self, scanner: usize, values: &[f64]) -> f64 {
        self.known.get(scanner).map_or(0.0, |k| k.latency_s)
            + self.first(scanner, Term::Latency).map_or(0.0, |k| values[k])
    }
}

const AXES: [Vector3<f64>; 3] = [Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 1.0)];

/// What a body vector changes by with each coefficient of a curve that makes rays longer, as the plane through the patch shows it.
fn of_curve(
    beam: &Beam,
    ray_m: &Vector3<f64>,
    weights: impl Fn(&Vector3<f64>, f64) -> Weights,
) -> BTreeMap<usize, Vector3<f64>> {
    let mut by_knot: BTreeMap<usize, Vector3<f64>> = BTreeMap::new();
    for (off_m, share) in beam.patch.nodes() {
        let ray_m = ray_m + off_m;
        let range_m = ray_m.norm().max(1e-3);
        let (knot, weights) = weights(&ray_m, range_m);
        for (k, w) in weights.iter().enumerate() {
            *by_knot.entry(knot + k).or_default() += ray_m * (share * w / range_m);
        }
    }
    by_knot
}

/// Three axes of equal standard deviation.
fn axes(sigma: f64) -> DMatrix<f64> {
    DMatrix::from_diagonal_element(3, 3, sigma * sigma)
}

/// Coefficients beforehand: a common offset, a scale, and a bend that forgets.
fn range_prior(spline: &RangeSpline) -> DMatrix<f64> {
    let n = spline.coefficients();
    DMatrix::from_fn(n, n, |i, j| {
        let (a, b) = (spline.centre_ln(i), spline.centre_ln(j));
        let apart = 3.0_f64.sqrt() * (a - b).abs() / RANGE_BEND_LN;
        let bend = (1.0 + apart) * (-apart).exp();
        let own = if i == j { 1e-4 } else { 0.0 };
        RANGE_OFFSET_SIGMA_M.powi(2)
            + RANGE_SCALE_SIGMA.powi(2) * a.exp() * b.exp()
            + RANGE_BEND_SIGMA_M.powi(2) * (bend + own)
    })
}
