//! What is left when return pairs say nothing: level flight, its course from the times of the points.
//!
//! A line scanner draws its lines across the course: time is a plane over the ground, whose gradient points along
//! the course and whose steepness is the inverse of the speed, however the strip was clipped. Height and side
//! follow from the scan angle where it varies enough: `c = c0 + (Z - z) tan θ` with `c` across the course.

use nalgebra::{DMatrix, Matrix2, Matrix3, Vector2, Vector3};

use crate::sensor_path::{PathSource, SPEEDS_MPS, SensorPath};
use crate::sketch::SamplePoint;

/// Height above the points that is assumed when nothing tells it \[m\].
pub const ASSUMED_HEIGHT_M: f64 = 1_000.0;

/// A level path over the sample of one strip; `None` when even the course cannot be told.
#[must_use]
pub fn level_path(samples: &[SamplePoint], start_s: f64, end_s: f64) -> Option<SensorPath> {
    if samples.len() < 20 {
        return None;
    }
    let middle_s = 0.5 * (start_s + end_s);
    let half_s = (0.5 * (end_s - start_s)).max(0.05);
    let (velocity, centre) = course(samples, middle_s)?;
    let forward = velocity.normalize();
    let right = Vector2::new(forward.y, -forward.x);
    let ground_m = mean(samples.iter().map(|s| s.point_m[2]));
    let (side_m, height_m, sigma_m, source) = match scan_angle_fit(samples, &centre, &right) {
        Some((side_m, top_m, sigma_m)) => (side_m, top_m, sigma_m, PathSource::ScanAngle { points: samples.len() }),
        None => (0.0, ground_m + ASSUMED_HEIGHT_M, 0.5 * ASSUMED_HEIGHT_M, PathSource::AssumedHeight),
    };
    let middle = centre + right * side_m;
    let mut covariance = DMatrix::zeros(6, 6);
    for axis in 0..3 {
        covariance[(axis, axis)] = sigma_m * sigma_m;
    }
    Some(SensorPath {
        coefficients: vec![
            Vector3::new(middle.x, middle.y, height_m),
            Vector3::new(velocity.x * half_s, velocity.y * half_s, 0.0),
        ],
        middle_s,
        half_s,
        covariance,
        source,
    })
}

#[allow(clippy::cast_precision_loss)]
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0_usize), |(s, n), v| (s + v, n + 1));
    sum / n.max(1) as f64
}

/// Velocity over ground \[m/s\] and the point that is passed at `middle_s`, from `t = t0 + g · (x, y)` by robust
/// least squares.
fn course(samples: &[SamplePoint], middle_s: f64) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let origin = Vector2::new(mean(samples.iter().map(|s| s.point_m[0])), mean(samples.iter().map(|s| s.point_m[1])));
    let mut weights = vec![1.0; samples.len()];
    let mut plane = Vector3::zeros();
    for _ in 0..8 {
        let (mut normal, mut rhs) = (Matrix3::zeros(), Vector3::zeros());
        for (s, w) in samples.iter().zip(&weights) {
            let a = Vector3::new(1.0, s.point_m[0] - origin.x, s.point_m[1] - origin.y);
            normal += a * a.transpose() * *w;
            rhs += a * ((s.time_s - middle_s) * w);
        }
        plane = normal.lu().solve(&rhs)?;
        let residuals: Vec<f64> = samples
            .iter()
            .map(|s| {
                let a = Vector3::new(1.0, s.point_m[0] - origin.x, s.point_m[1] - origin.y);
                (s.time_s - middle_s - a.dot(&plane)).abs()
            })
            .collect();
        let mut sorted = residuals.clone();
        sorted.sort_by(f64::total_cmp);
        let scale = 1.4826 * sorted[sorted.len() / 2] + 1e-6;
        weights = residuals.iter().map(|r| (2.0 * scale / r.max(1e-9)).min(1.0)).collect();
    }
    let gradient = Vector2::new(plane.y, plane.z);
    // the gradient is the inverse of the speed
    if gradient.norm() < 1e-6 || !SPEEDS_MPS.contains(&(1.0 / gradient.norm())) {
        return None;
    }
    let velocity = gradient / gradient.norm_squared();
    // the point on the course line nearest to the samples' centre where the plane reads middle_s
    Some((velocity, origin - velocity * plane.x))
}

/// Side of the course line and height of the sensor, with a sigma, from the scan angle; the sign of the angle is
/// found, not trusted.
#[allow(clippy::cast_precision_loss)]
fn scan_angle_fit(samples: &[SamplePoint], centre: &Vector2<f64>, right: &Vector2<f64>) -> Option<(f64, f64, f64)> {
    let rows: Vec<(f64, f64, f64)> = samples
        .iter()
        .map(|s| {
            let across = (Vector2::new(s.point_m[0], s.point_m[1]) - centre).dot(right);
            (across, s.point_m[2], f64::from(s.scan_angle_deg).to_radians().tan())
        })
        .collect();
    let tangents: Vec<f64> = rows.iter().map(|r| r.2).collect();
    let centre_tangent = mean(tangents.iter().copied());
    let spread = mean(tangents.iter().map(|t| (t - centre_tangent).powi(2))).sqrt();
    if spread < 0.01 {
        return None;
    }
    let fit = |sign: f64| {
        let (mut normal, mut rhs) = (Matrix2::zeros(), Vector2::zeros());
        for (c, z, tangent) in &rows {
            let a = Vector2::new(1.0, sign * tangent);
            normal += a * a.transpose();
            rhs += a * (c + sign * z * tangent);
        }
        let inverse = normal.try_inverse()?;
        let x = inverse * rhs;
        let square = mean(rows.iter().map(|(c, z, t)| (c + sign * z * t - x.x - sign * t * x.y).powi(2)));
        // scan angles are rounded: their error is common to neighbours, so the fit's own sigma is taken ten-fold
        Some((x.x, x.y, 10.0 * (square * inverse[(1, 1)]).sqrt(), square))
    };
    let ground_m = mean(rows.iter().map(|r| r.1));
    let best = [1.0, -1.0]
        .into_iter()
        .filter_map(fit)
        .filter(|(_, top, _, _)| (20.0..=10_000.0).contains(&(top - ground_m)))
        .min_by(|a, b| a.3.total_cmp(&b.3))?;
    let height_m = best.1 - ground_m;
    let sigma_m = best.2.hypot(0.05 * height_m);
    (sigma_m < 0.5 * height_m).then_some((best.0, best.1, sigma_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strip(angles: bool) -> Vec<SamplePoint> {
        (0..400)
            .map(|k| {
                let u = f64::from(k) / 400.0;
                let across = -60.0 + 120.0 * (f64::from(k) * 0.37).fract();
                // flown north-east at 50 m/s, 900 m up, the strip lies to the right
                let along = 50.0 * (4.0 * u - 2.0);
                let c = 250.0 + across;
                let s = std::f64::consts::FRAC_1_SQRT_2;
                let angle = if angles { (c / 900.0).atan().to_degrees().round() } else { 0.0 };
                #[allow(clippy::cast_possible_truncation)]
                let scan_angle_deg = -angle as f32;
                let point_m = [s * along + s * c, s * along - s * c, 0.0];
                SamplePoint { time_s: 10.0 + 4.0 * u, point_m, scan_angle_deg }
            })
            .collect()
    }

    #[test]
    fn course_side_and_height_come_from_times_and_scan_angles_of_either_sign() {
        let path = level_path(&strip(true), 10.0, 14.0).expect("a strip");
        let (position, velocity) = path.at(12.0);
        assert!((velocity.x - velocity.y).abs() < 0.5 && (velocity.norm() - 50.0).abs() < 1.0, "{velocity}");
        assert!(position.xy().norm() < 3.0 * path.sigma_m(12.0).norm(), "{position}");
        assert!((position.z - 900.0).abs() < 3.0 * path.sigma_m(12.0).norm());
    }

    #[test]
    fn without_scan_angles_a_height_is_assumed_and_said() {
        let path = level_path(&strip(false), 10.0, 14.0).expect("a strip");
        assert_eq!(path.source, PathSource::AssumedHeight);
        assert!(path.sigma_m(12.0).z >= 500.0);
    }

    #[test]
    fn points_without_motion_have_no_course() {
        let still: Vec<SamplePoint> = strip(true)
            .into_iter()
            .map(|s| SamplePoint { time_s: 10.0 + f64::from(s.scan_angle_deg) * 1e-9, ..s })
            .collect();
        assert!(level_path(&still, 10.0, 14.0).is_none());
    }
}
