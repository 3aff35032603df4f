//! Normals of common planes, smoothed as far as their own sigmas cannot tell them from their neighbours'.
//!
//! A common plane tells of yaw, and of offsets along the ground, by its slope alone. The normal of a small patch of a few
//! rings is wrong by a degree or more: rows of the design matrix that are made with it hold information that is not
//! there (errors in variables), and hundreds of them hold a level road as firmly as a wall would. Each normal is therefore
//! drawn to the mean of its neighbours by the share `σ² / (σ² + τ²)`, with `σ²` its own variance and `τ²` what normals of
//! neighbours differ beyond theirs (James and Stein's estimator with a local mean).

use nalgebra::Vector3;
use tieline_matching::Patch;

/// Neighbours lie within this distance \[m\]…
const NEAR_M: f64 = 8.0;
/// …and their normals within this angle: cosine of 15°.
const ALIKE: f64 = 0.966;
/// With fewer neighbours a normal stays as it is.
const LEAST: usize = 3;

/// A normal to be smoothed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Raw {
    /// Station.
    pub station: usize,
    /// Where \[m\].
    pub point_m: Vector3<f64>,
    /// The normal.
    pub normal: Vector3<f64>,
    /// Its variance, mean of both directions \[rad²\].
    pub variance: f64,
}

/// Variance of the direction of a patch's normal, mean of both directions \[rad²\]: noise of its points, and what rings
/// are wrong by as a whole.
#[must_use]
pub fn variance(patch: &Patch, floor_m: f64) -> f64 {
    let of_plane = patch.roughness_m.powi(2) / f64::from(patch.points) + floor_m.powi(2);
    0.5 * of_plane * patch.spread_m.iter().map(|s| s.powi(-2)).sum::<f64>()
}

fn neighbours<'a>(all: &'a [Raw], of: &'a Raw) -> impl Iterator<Item = &'a Raw> {
    all.iter().filter(move |n| {
        n.station == of.station && (n.point_m - of.point_m).norm() < NEAR_M && n.normal.dot(&of.normal) > ALIKE
    })
}

/// The normals, smoothed; in the order given.
#[must_use]
#[allow(clippy::cast_precision_loss)]
pub fn smoothed(all: &[Raw]) -> Vec<Vector3<f64>> {
    all.iter()
        .map(|raw| {
            let (mut count, mut weights, mut sum) = (0_usize, 0.0, Vector3::zeros());
            for near in neighbours(all, raw) {
                let weight = 1.0 / (near.variance + 1e-8);
                count += 1;
                weights += weight;
                sum += near.normal * weight;
            }
            if count <= LEAST {
                return raw.normal;
            }
            let mean = sum.normalize();
            // weighted scatter about the mean, less what sigmas and the mean itself explain
            let scatter: f64 = neighbours(all, raw)
                .map(|near| 0.5 * (near.normal - mean).norm_squared() / (near.variance + 1e-8))
                .sum();
            let between = ((scatter - (count as f64 - 1.0)) / weights).max(0.0);
            let own = between / (between + raw.variance);
            (raw.normal * own + mean * (1.0 - own)).normalize()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places on a grid; normals as given, with a sigma.
    fn field(sigma: f64, normal: impl Fn(usize) -> Vector3<f64>) -> Vec<Raw> {
        (0..36)
            .map(|k| Raw {
                station: 0,
                point_m: Vector3::new((k % 6) as f64, (k / 6) as f64, 0.0),
                normal: normal(k).normalize(),
                variance: sigma * sigma,
            })
            .collect()
    }

    #[test]
    fn noise_is_smoothed_away_and_what_is_real_stays() {
        // a checkerboard of tilts of 0.02: noise when sigma says so, real when sigma is small
        let tilt = |k: usize| Vector3::new(if (k + k / 6).is_multiple_of(2) { 0.02 } else { -0.02 }, 0.0, 1.0);
        let slopes = |sigma| smoothed(&field(sigma, tilt)).iter().map(|n| n.x.abs()).fold(0.0, f64::max);
        assert!(slopes(0.02) < 0.004, "{}", slopes(0.02));
        assert!(slopes(0.001) > 0.019, "{}", slopes(0.001));
    }

    #[test]
    fn walls_and_lone_planes_are_left_alone() {
        let mut all = field(0.02, |_| Vector3::z());
        all.push(Raw { normal: Vector3::x(), ..all[0] });
        all.push(Raw { station: 1, normal: Vector3::new(0.05, 0.0, 1.0).normalize(), ..all[0] });
        let found = smoothed(&all);
        assert!((found[36] - Vector3::x()).norm() < 1e-12 && (found[37] - all[37].normal).norm() < 1e-12);
    }
}
