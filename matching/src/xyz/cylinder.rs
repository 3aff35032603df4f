//! The cylinder through the points of a pole, with its covariance.
//!
//! A point p at height z lies `v = |q| - r` off the surface, `q = p_xy - c - t (z - z0)` being its way from the axis. With q̂ = q/|q|: ∂v/∂c = -q̂, ∂v/∂t = -q̂ (z - z0), ∂v/∂r = -1. From one side only an arc is
//! seen: how far the axis lies behind it goes with the radius, and the covariance says so.
//!
//! Noise is along the ray, across the surface where it faces the scanner and along it at the limb: what that does to expectations is taken
//! off ([`curvature`]), and the covariance counts each point by how much it really scatters ([`covariance`]).

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::pole::{Local, Pole, PoleOptions};

/// A lean of so much is usual.
const LEAN: f64 = 0.02;
/// What radii are like before anything was measured: mean and standard deviation \[m\].
const RADIUS_M: [f64; 2] = [0.12, 0.15];
/// Thinner poles are not looked for \[m\].
const THINNEST_M: f64 = 0.02;
/// Points further off than so many standard deviations, and than this at least \[m\], are of something else.
const SIGMAS: f64 = 3.5;
const OFF_M: f64 = 0.012;
/// What points of a scanner have in common, and what a post is out of round \[m\].
const FLOOR_M: f64 = 0.00025;

/// The cylinder through some points; none where they are none.
#[allow(clippy::cast_precision_loss)] // counts
pub(super) fn fit(points: &[&Local], options: &PoleOptions) -> Option<Pole> {
    let mut used: Vec<&Local> = points.to_vec();
    let height_m = points.iter().map(|p| p.place_m.z).sum::<f64>() / points.len().max(1) as f64;
    let azimuth = |p: &Local| (f64::from(p.point.azimuth) + 0.5) / 65_536.0 * std::f64::consts::TAU;
    let away = points.iter().map(|p| Vector2::new(azimuth(p).sin(), azimuth(p).cos())).sum::<Vector2<f64>>();
    let away = away.try_normalize(1e-6)?;
    let mut state = start(&used, &away, options);
    for round in 0..4 {
        if used.len() < options.fewest_points {
            return None;
        }
        let (normal, variance_m2) = least_squares(&used, (height_m, away), &mut state, options.max_roughness_m)?;
        let limit_m = (SIGMAS * variance_m2.sqrt()).max(OFF_M);
        let kept: Vec<&Local> =
            points.iter().filter(|p| off_m(p, height_m, &state).0.abs() <= limit_m).copied().collect();
        let is_settled = kept.len() == used.len();
        if is_settled || round == 3 {
            let covariance = covariance(&used, (height_m, away), &state, &normal, variance_m2)?;
            return pole(&used, (height_m, away), &state, covariance, variance_m2, options);
        }
        used = kept;
    }
    None
}

/// How far off the surface a point lies \[m\], and the unit vector from the axis to it.
fn off_m(p: &Local, height_m: f64, state: &SVector<f64, 5>) -> (f64, Vector2<f64>) {
    let up_m = p.place_m.z - height_m;
    let q = p.place_m.xy() - Vector2::new(state[0] + state[2] * up_m, state[1] + state[3] * up_m);
    let length_m = q.norm().max(1e-6);
    (length_m - state[4], q / length_m)
}

/// The circle of least algebraic distance, x² + y² = 2 c·p + k (Kåsa), or one behind the points where that is no pole.
#[allow(clippy::cast_precision_loss)]
fn start(points: &[&Local], away: &Vector2<f64>, options: &PoleOptions) -> SVector<f64, 5> {
    let mean_m = points.iter().map(|p| p.place_m.xy()).sum::<Vector2<f64>>() / points.len().max(1) as f64;
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for p in points {
        let off = p.place_m.xy() - mean_m;
        let row = Vector3::new(2.0 * off.x, 2.0 * off.y, 1.0);
        normal += row * row.transpose();
        right += row * off.norm_squared();
    }
    let circle = normal.try_inverse().map(|inverse| inverse * right).and_then(|s| {
        let radius_m = (s.z + s.xy().norm_squared()).max(0.0).sqrt();
        let is_behind = s.xy().dot(away) > 0.0;
        ((options.radius_m[0]..options.radius_m[1]).contains(&radius_m) && is_behind).then_some((s.xy(), radius_m))
    });
    let (centre, radius_m) = circle.unwrap_or((away * 0.06, 0.08));
    SVector::from([mean_m.x + centre.x, mean_m.y + centre.y, 0.0, 0.0, radius_m])
}

/// Gauss and Newton's steps to the least squares of distances; normal matrix and variance of a point.
#[allow(clippy::cast_precision_loss)]
fn least_squares(
    points: &[&Local],
    (height_m, away): (f64, Vector2<f64>),
    state: &mut SVector<f64, 5>,
    most_m: f64,
) -> Option<(SMatrix<f64, 5, 5>, f64)> {
    // weights of what is usual, against a point's noise
    const NOISE_M: f64 = 0.005;
    let prior = [0.0, 0.0, LEAN, LEAN, RADIUS_M[1]].map(|s: f64| if s > 0.0 { (NOISE_M / s).powi(2) } else { 0.0 });
    let mut result = None;
    for _ in 0..25 {
        let mut normal = SMatrix::<f64, 5, 5>::from_diagonal(&SVector::from(prior));
        let usual = SVector::from([0.0, 0.0, 0.0, 0.0, RADIUS_M[0]]);
        let mut right = SVector::from(prior).component_mul(&(usual - *state));
        let (mut squares, mut facing, mut curved) = (0.0, 0.0, SVector::zeros());
        for p in points {
            let ((v, q), row) = (off_m(p, height_m, state), row(p, height_m, state));
            normal += row * row.transpose();
            right -= row * v;
            squares += v * v;
            facing += q.dot(&away).powi(2);
            curved += curvature(p, (height_m, away), state);
        }
        let freedom = (points.len() as f64 - 5.0).max(1.0);
        let along_ray_m2 = squares / freedom * points.len() as f64 / facing.max(1e-6);
        right += curved * along_ray_m2.min(most_m * most_m);
        let step = normal.cholesky()?.solve(&right);
        // no further than a radius at a time
        let longest_m = step.fixed_rows::<2>(0).norm().max(step[4].abs());
        *state += step * (0.1 / longest_m.max(0.1));
        result = Some((normal, squares / freedom));
        if longest_m < 1e-6 {
            break;
        }
    }
    result.filter(|_| state.iter().all(|v| v.is_finite()))
}

/// What noise along the ray adds to the expectation of a point's row times its distance, for each square metre of its variance.
///
/// With the noise δ along `away` and c = q̂·away a distance is v = c δ + (1 - c²) δ²/2r and q̂ turns by (away - c q̂) δ/r, so that
/// E(q̂ v) = (q̂ (1 - c²)/2 + c (away - c q̂))/r · E(δ²). Left in, thin poles would be drawn towards the scanner: 1.6 mm at 5 cm and 5 mm noise.
fn curvature(p: &Local, (height_m, away): (f64, Vector2<f64>), state: &SVector<f64, 5>) -> SVector<f64, 5> {
    let (up_m, q) = (p.place_m.z - height_m, off_m(p, height_m, state).1);
    let (c, radius_m) = (q.dot(&away), state[4].abs().max(THINNEST_M));
    let bent = 0.5 * (1.0 - c * c);
    let of_place = -(q * bent + (away - q * c) * c) / radius_m;
    SVector::from([of_place.x, of_place.y, of_place.x * up_m, of_place.y * up_m, -bent / radius_m])
}

/// Share of a point's variance that does not go with the incidence of its ray.
const ANYHOW: f64 = 0.1;

/// Covariance of the state by how much each point really scatters: N⁻¹ (Σ σₖ² rₖ rₖᵀ) N⁻¹.
///
/// Noise is along the ray, so that of a point's distance off the surface goes with the cosine of its incidence: at the limb, which tells most
/// of the place across, it is least. Weights do not follow: at the limb rays are half of what lies behind.
#[allow(clippy::cast_precision_loss)] // counts
fn covariance(
    points: &[&Local],
    (height_m, away): (f64, Vector2<f64>),
    state: &SVector<f64, 5>,
    normal: &SMatrix<f64, 5, 5>,
    variance_m2: f64,
) -> Option<SMatrix<f64, 5, 5>> {
    let inverse = normal.try_inverse()?;
    let share = |q: &Vector2<f64>| ANYHOW + q.dot(&away).powi(2);
    let rows = || points.iter().map(|p| (row(p, height_m, state), share(&off_m(p, height_m, state).1)));
    let mean = rows().map(|(_, share)| share).sum::<f64>() / points.len() as f64;
    // what the normal matrix holds beside its points says as much as it did
    let noise = rows().fold(*normal, |noise, (row, share)| noise + row * row.transpose() * (share / mean - 1.0));
    Some(inverse * noise * inverse * variance_m2)
}

/// The derivative of how far off the surface a point lies.
fn row(p: &Local, height_m: f64, state: &SVector<f64, 5>) -> SVector<f64, 5> {
    let (up_m, q) = (p.place_m.z - height_m, off_m(p, height_m, state).1);
    SVector::from([-q.x, -q.y, -q.x * up_m, -q.y * up_m, -1.0])
}

#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation)]
fn pole(
    points: &[&Local],
    (height_m, away): (f64, Vector2<f64>),
    state: &SVector<f64, 5>,
    mut covariance: SMatrix<f64, 5, 5>,
    variance_m2: f64,
    options: &PoleOptions,
) -> Option<Pole> {
    /// Points of a pole are on its near side, by the mean cosine.
    const NEAR_SIDE: f64 = -0.4;
    /// Tilts are no poles.
    const MOST_LEAN: f64 = 0.15;
    let n = points.len() as f64;
    let lean = Vector2::new(state[2], state[3]);
    let facing = points.iter().map(|p| off_m(p, height_m, state).1.dot(&away)).sum::<f64>() / n;
    let is_pole = (options.radius_m[0]..=options.radius_m[1]).contains(&state[4])
        && variance_m2.sqrt() <= options.max_roughness_m
        && facing < NEAR_SIDE
        && lean.norm() < MOST_LEAN;
    for k in [0, 1, 4] {
        covariance[(k, k)] += FLOOR_M * FLOOR_M;
    }
    let first_s = points[0].point.time_s;
    is_pole.then(|| Pole {
        source: points[0].point.source,
        time_s: first_s + points.iter().map(|p| p.point.time_s - first_s).sum::<f64>() / n,
        point_m: Vector3::new(state[0], state[1], height_m),
        lean,
        radius_m: state[4],
        covariance,
        away,
        points: points.len() as u32,
        intensity: points.iter().map(|p| f64::from(p.point.intensity)).sum::<f64>() / n,
    })
}
