//! Ties: what the platform sees of one feature at several times.
//!
//! A feature has one to three coordinates along unit vectors that are fixed to the earth: the normal of a surface line,
//! two directions across a line, three of a point. A sighting at time t measures each as
//! `s = uᵀ (p + C l)` plus noise; `∂s/∂δp = uᵀ`, `∂s/∂δψ = -uᵀ [C l]×`, all in north, east, down at the platform.

use nalgebra::{Matrix3, Vector3};

use crate::earth::{ecef_from_geodetic, ned_from_ecef};
use crate::kalman::{Measurement, SparseRow};
use crate::observation::TieKind;
use crate::state::{ATTITUDE, Nominal, POSITION, VELOCITY};

/// One sighting of a feature.
#[derive(Debug, Clone, PartialEq)]
pub struct Sighting {
    /// Survey time \[s\].
    pub time_s: f64,
    /// From the IMU to the feature, body axes \[m\].
    pub body_vector_m: Vector3<f64>,
    /// Covariance along the feature's directions \[m²\]; only the first rows and columns count.
    pub covariance_m2: Matrix3<f64>,
    /// What the body vector changes by with each constant of the calibration that it depends on: number and derivative
    /// \[m per unit\].
    pub by_constant: Vec<(usize, Vector3<f64>)>,
}

impl Sighting {
    /// The sighting with the calibration applied.
    #[must_use]
    pub fn calibrated(&self, constants: &[f64]) -> Self {
        let by = |(number, by): &(usize, Vector3<f64>)| by * constants.get(*number).copied().unwrap_or(0.0);
        let moved: Vector3<f64> = self.by_constant.iter().map(by).sum();
        Self { body_vector_m: self.body_vector_m + moved, by_constant: Vec::new(), ..*self }
    }
}

/// A tie as the filter takes it.
#[derive(Debug, Clone, PartialEq)]
pub struct FilterTie {
    /// Number of the tie.
    pub id: u64,
    /// What it is.
    pub kind: TieKind,
    /// One to three unit vectors, earth-centred axes.
    pub directions: Vec<Vector3<f64>>,
    /// Sightings, in order of time.
    pub sightings: Vec<Sighting>,
    /// Coordinates along the directions from the centre of the earth \[m\], where the feature is known beforehand.
    pub known_m: Option<Vec<f64>>,
}

/// Coordinates of a sighting from the origin along the directions \[m\], with their rows.
///
/// The rows are over the errors `held_s` before the sighting, or after it where that is negative: over a twentieth of a second a position's error grows by
/// the velocity's; what else changes is below a tenth of a millimetre for any grade. `calibration` is where the constants
/// stand, if they are estimated.
#[must_use]
pub fn coordinates(
    nominal: &Nominal,
    tie: &FilterTie,
    sighting: &Sighting,
    origin_ecef_m: &Vector3<f64>,
    (held_s, calibration): (f64, Option<usize>),
) -> (Vec<f64>, Vec<SparseRow>) {
    let here = &nominal.nav.geodetic;
    let ned_from_ecef = ned_from_ecef(here.x, here.y);
    let arm_ned = nominal.nav.ned_from_body * sighting.body_vector_m;
    let place = ecef_from_geodetic(here) + ned_from_ecef.transpose() * arm_ned - origin_ecef_m;
    let values = tie.directions.iter().map(|u| u.dot(&place)).collect();
    let rows = tie
        .directions
        .iter()
        .map(|u| {
            let u = ned_from_ecef * u;
            let by_attitude = arm_ned.cross(&u); // -uᵀ [a]× = (a × u)ᵀ
            let now = (0..3).map(|k| (POSITION + k, u[k])).chain((0..3).map(|k| (ATTITUDE + k, by_attitude[k])));
            let moving = if held_s == 0.0 { 0 } else { 3 };
            let moved = now.chain((0..moving).map(|k| (VELOCITY + k, held_s * u[k])));
            let u_body = nominal.nav.ned_from_body.inverse_transform_vector(&u);
            let constants = calibration.into_iter().flat_map(|at| sighting.by_constant.iter().map(move |c| (at, c)));
            moved.chain(constants.map(|(at, (number, by))| (at + number, u_body.dot(by)))).collect()
        })
        .collect();
    (values, rows)
}

/// Covariance of a sighting along the directions, row-major.
#[must_use]
pub fn noise(tie: &FilterTie, sighting: &Sighting) -> Vec<f64> {
    let m = tie.directions.len();
    (0..m * m).map(|k| sighting.covariance_m2[(k / m, k % m)]).collect()
}

/// A sighting against a landmark: `0 = s - m` plus the noise of the sighting. `nominal_m` is what the landmark's states are
/// counted from.
#[must_use]
pub fn against_landmark(
    values_m: &[f64],
    rows: &[SparseRow],
    noise: &[f64],
    slots: &[usize],
    nominal_m: &[f64],
) -> Measurement {
    let rows = rows.iter().zip(slots).map(|(row, at)| row.iter().copied().chain([(*at, -1.0)]).collect()).collect();
    let residual = nominal_m.iter().zip(values_m).map(|(m, v)| m - v).collect();
    Measurement { residual, rows, noise: noise.to_vec() }
}

/// The last sighting against the clones of all others at once: n sightings give n - 1 differences from the last, whose
/// noise they share.
#[must_use]
pub fn all_at_once(
    tie: &FilterTie,
    last: usize,
    values_m: &[f64],
    rows: &[SparseRow],
    clones: &[(usize, Vec<usize>, Vec<f64>)],
) -> Measurement {
    let rank = values_m.len();
    let m = rank * clones.len();
    let shared = noise(tie, &tie.sightings[last]);
    let mut out = Measurement { residual: Vec::new(), rows: Vec::new(), noise: vec![0.0; m * m] };
    for (a, (sighting, slots, nominal_m)) in clones.iter().enumerate() {
        let own = noise(tie, &tie.sightings[*sighting]);
        let one = against_landmark(values_m, rows, &own, slots, nominal_m);
        out.residual.extend(one.residual);
        out.rows.extend(one.rows);
        for b in 0..clones.len() {
            for i in 0..rank {
                for j in 0..rank {
                    let mut v = shared[i * rank + j];
                    if a == b {
                        v += own[i * rank + j];
                    }
                    out.noise[(a * rank + i) * m + b * rank + j] = v;
                }
            }
        }
    }
    out
}
