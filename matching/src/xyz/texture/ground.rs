//! What of a sighting is ground, and where a place of it lies: height by a plane, time by the way of the scan over it.

use nalgebra::{Matrix3, Vector3};

use super::keep::TexturePoint;
use super::plan::Plan;

/// Edge of the squares whose lowest point stands for the ground \[m\].
const SQUARE_M: f64 = 0.25;
/// Higher than this above the lowest points about it a point is not of the ground \[m\]: a cross slope of a tenth over a square and its
/// neighbours, and the noise.
const ABOVE_M: f32 = 0.10;

/// Keeps the points that lie on the lowest surface of a square of plan (`columns` squares wide, from `low_m`).
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub(super) fn ground_only(points: &mut Vec<TexturePoint>, low_m: f64, width_m: f64) {
    let columns = (width_m / SQUARE_M).ceil() as usize + 1;
    let square = |p: &TexturePoint| {
        let at = [0, 1].map(|k| ((f64::from(p.place_m[k]) - low_m) / SQUARE_M).max(0.0) as usize);
        (at[0].min(columns - 1), at[1].min(columns - 1))
    };
    let mut lowest = vec![f32::INFINITY; columns * columns];
    for p in points.iter() {
        let (x, y) = square(p);
        let low = &mut lowest[y * columns + x];
        *low = low.min(p.place_m[2]);
    }
    points.retain(|p| {
        let (x, y) = square(p);
        let about = (y.saturating_sub(1)..=(y + 1).min(columns - 1))
            .flat_map(|r| (x.saturating_sub(1)..=(x + 1).min(columns - 1)).map(move |c| (c, r)));
        p.place_m[2] < about.map(|(c, r)| lowest[r * columns + c]).fold(f32::INFINITY, f32::min) + ABOVE_M
    });
}

/// A place on the ground of one sighting.
#[derive(Debug, Clone, Copy)]
pub(super) struct Foot {
    /// Height \[m\].
    pub(super) height_m: f64,
    /// Slope east and north.
    pub(super) slope: [f64; 2],
    /// Standard deviation of the height \[m\].
    pub(super) sigma_m: f64,
    /// When the scan passed the place \[s\].
    pub(super) time_s: f64,
    /// Points.
    pub(super) points: u32,
    /// Their mean intensity, as in the file.
    pub(super) intensity: f64,
}

/// Points about a place that tell its height and time \[m\].
const RADIUS_M: f64 = 0.6;
/// Rougher than this it is no pavement \[m\].
const ROUGHEST_M: f64 = 0.03;
/// Steeper than this it is none either.
const STEEPEST: f64 = 0.2;
/// Points that fit one passing of the scan by less than this, one sigma \[s\].
const ONE_PASSING_S: f64 = 0.15;

/// Least squares of value over 1, x, y, without what is further off than three sigmas: coefficients, standard deviation about them, and
/// the inverse normal matrix.
fn fitted(rows: &[(Vector3<f64>, f64)]) -> Option<(Vector3<f64>, f64, Matrix3<f64>, usize)> {
    let (mut taken, mut limit) = (vec![true; rows.len()], f64::INFINITY);
    let mut result = None;
    for _ in 0..3 {
        let (mut n, mut b, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0_usize);
        for ((a, v), _) in rows.iter().zip(&taken).filter(|(_, t)| **t) {
            n += a * a.transpose();
            b += a * *v;
            count += 1;
        }
        if count < 12 {
            return None;
        }
        let inverse = n.try_inverse()?;
        let x = inverse * b;
        let off = |(a, v): &(Vector3<f64>, f64)| v - a.dot(&x);
        let square: f64 = rows.iter().zip(&taken).filter(|(_, t)| **t).map(|(r, _)| off(r).powi(2)).sum();
        #[allow(clippy::cast_precision_loss)]
        let sigma = (square / (count as f64 - 3.0)).sqrt();
        result = Some((x, sigma, inverse, count));
        limit = limit.min(3.0 * sigma.max(1e-6));
        taken = rows.iter().map(|r| off(r).abs() <= limit).collect();
        limit = f64::INFINITY;
    }
    result
}

/// The ground at a place.
pub(super) fn foot(points: &[TexturePoint], plan: &Plan, place_m: [f64; 2], floor_m: f64) -> Option<Foot> {
    let (mut heights, mut times) = (Vec::new(), Vec::new());
    let mut intensities = 0.0;
    let mut first_s = None;
    for p in plan.about(place_m, RADIUS_M).map(|k| &points[k]) {
        let off = [0, 1].map(|k| f64::from(p.place_m[k]) - place_m[k]);
        if off[0].hypot(off[1]) <= RADIUS_M {
            let row = Vector3::new(1.0, off[0], off[1]);
            heights.push((row, f64::from(p.place_m[2])));
            intensities += f64::from(p.intensity);
            times.push((row, p.time_s - *first_s.get_or_insert(p.time_s)));
        }
    }
    #[allow(clippy::cast_precision_loss)]
    let intensity = intensities / heights.len().max(1) as f64;
    let (plane, roughness_m, inverse, count) = fitted(&heights)?;
    let (passing, late_s, _, _) = fitted(&times)?;
    let good = roughness_m < ROUGHEST_M && plane.y.hypot(plane.z) < STEEPEST && late_s < ONE_PASSING_S;
    good.then(|| Foot {
        height_m: plane.x,
        slope: [plane.y, plane.z],
        sigma_m: (roughness_m.powi(2) * inverse[(0, 0)] + floor_m.powi(2)).sqrt(),
        time_s: first_s.unwrap_or(0.0) + passing.x,
        points: u32::try_from(count).unwrap_or(u32::MAX),
        intensity,
    })
}
