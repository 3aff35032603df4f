//! How a patch shows rays that become longer: as the plane that was fitted to all of its points.

use nalgebra::Vector3;

/// How the rays of a patch's points spread: its plane was fitted to all of them, and what bends over a patch does not show at its feature alone.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Spread {
    /// Change of the ray for one standard deviation of the points, along either axis of the patch, body axes \[m\].
    pub rays_m: [Vector3<f64>; 2],
    /// The feature from the centroid, in those standard deviations.
    pub feature: [f64; 2],
}

impl Spread {
    /// Places over the patch, from the feature, with the share that each has in the height of the fitted plane at the feature: least squares over
    /// a uniformly filled rectangle of these standard deviations, `(1 + a s + b t) dA`, by the three points of Gauss in either direction
    /// (exact to the fifth power).
    pub(super) fn nodes(&self) -> [(Vector3<f64>, f64); 9] {
        const NODES: [(f64, f64); 3] =
            [(-1.341_640_786_499_874, 5.0 / 18.0), (0.0, 8.0 / 18.0), (1.341_640_786_499_874, 5.0 / 18.0)];
        let ([u, v], [a, b]) = (self.rays_m, self.feature);
        std::array::from_fn(|k| {
            let ((s, p), (t, q)) = (NODES[k / 3], NODES[k % 3]);
            (u * (s - a) + v * (t - b), p * q * (1.0 + a * s + b * t))
        })
    }

    /// A longer ray as the fitted plane shows it at the feature: the mean of `r/ρ f(r, ρ)` over the patch.
    pub fn mean_m(&self, ray_m: &Vector3<f64>, mut longer_m: impl FnMut(&Vector3<f64>, f64) -> f64) -> Vector3<f64> {
        self.nodes().iter().fold(Vector3::zeros(), |sum, (off_m, share)| {
            let ray_m = ray_m + off_m;
            let range_m = ray_m.norm().max(1e-3);
            sum + ray_m * (share * longer_m(&ray_m, range_m) / range_m)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_longer_ray_is_seen_as_the_plane_through_the_patch_shows_it() {
        // a wall 6 m to the right, 1 m high and half as wide, and rays that become longer by a bend of the second order
        let (along, up) = (Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 0.0, -1.0));
        let centroid_m = Vector3::new(5.0, 6.0, -4.0);
        let (half_along_m, half_up_m) = (0.25, 0.5);
        let longer_m = |range_m: f64| 0.004 * (range_m - 8.5).powi(2);
        let spreads = [half_up_m / 3.0_f64.sqrt(), half_along_m / 3.0_f64.sqrt()];
        let at = [0.8, -0.5];
        let patch = Spread { rays_m: [up * spreads[0], along * spreads[1]], feature: at };
        let feature_m = centroid_m + patch.rays_m[0] * at[0] + patch.rays_m[1] * at[1];
        let found_m = patch.mean_m(&feature_m, |_, range_m| longer_m(range_m)).y;
        // least squares through a fine grid of points, evaluated at the feature
        let (mut mean, mut slopes) = (0.0, [0.0; 2]);
        let n = 200;
        for i in 0..n {
            for k in 0..n {
                let step = |m: usize| (f64::from(u32::try_from(m).expect("small")) + 0.5) / 100.0 - 1.0;
                let place = centroid_m + up * (step(i) * half_up_m) + along * (step(k) * half_along_m);
                let off_m = place.y / place.norm() * longer_m(place.norm());
                mean += off_m;
                slopes[0] += off_m * step(i) * half_up_m / spreads[0];
                slopes[1] += off_m * step(k) * half_along_m / spreads[1];
            }
        }
        let count = f64::from(u32::try_from(n * n).expect("small"));
        let expected_m = (mean + slopes[0] * at[0] + slopes[1] * at[1]) / count;
        assert!((found_m - expected_m).abs() < 1e-6, "{found_m} {expected_m}");
        // at the feature alone it would be another
        let alone_m = feature_m.y / feature_m.norm() * longer_m(feature_m.norm());
        assert!((alone_m - expected_m).abs() > 2e-5, "{alone_m} {expected_m}");
    }
}
