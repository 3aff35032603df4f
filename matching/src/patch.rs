//! A patch: a small planar piece of surface seen by one scanner in one pass.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::moments::{Moments, TICKS_PER_SECOND};

/// Who saw a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Sighting {
    /// Index of the strip.
    pub strip: u32,
    /// Visit of the strip to the place, from 0.
    pub pass: u16,
    /// Scanner, 0-based.
    pub scanner: u16,
}

/// A small planar piece of surface: the plane, how far it reaches, how well it is known.
///
/// Lengths in metres in the survey's local frame (map axes, moved to the local origin).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Patch {
    /// Who saw it.
    pub sighting: Sighting,
    /// Mean survey time \[s\].
    pub time_s: f64,
    /// Centroid of its points \[m\].
    pub centroid_m: Vector3<f64>,
    /// Unit normal, upward (towards +x, then +y, for exact verticals).
    pub normal: Vector3<f64>,
    /// Unit vector along its longer extent.
    pub long_axis: Vector3<f64>,
    /// Standard deviation of its points along the long axis and across it \[m\].
    pub spread_m: [f64; 2],
    /// Standard deviation of its points about the plane \[m\], with n - 3 in the divisor.
    pub roughness_m: f64,
    /// Number of points.
    pub points: u32,
    /// Mean intensity.
    pub intensity: f32,
}

/// Half the length of a uniformly filled side over its standard deviation: √3.
const HALF_LENGTH_PER_SPREAD: f64 = 1.732_050_807_568_877_2;

impl Patch {
    /// Half the extent along the long axis and across it \[m\], of a rectangle with the same second moments.
    #[must_use]
    pub fn half_extent_m(&self) -> [f64; 2] {
        self.spread_m.map(|s| s * HALF_LENGTH_PER_SPREAD)
    }

    /// Unit vector across the long axis, in the plane.
    #[must_use]
    pub fn cross_axis(&self) -> Vector3<f64> {
        self.normal.cross(&self.long_axis)
    }

    /// Sigma of the plane's height above a point that lies `d` from the centroid, from the noise of its points
    /// alone \[m\]: least squares of a plane, `σ² (1 + u²/λu + v²/λv) / n`.
    #[must_use]
    pub fn plane_sigma_m(&self, d: &Vector3<f64>) -> f64 {
        let (u, v) = (d.dot(&self.long_axis), d.dot(&self.cross_axis()));
        let lever = 1.0 + (u / self.spread_m[0]).powi(2) + (v / self.spread_m[1]).powi(2);
        self.roughness_m * (lever / f64::from(self.points)).sqrt()
    }

    /// Sigma of the direction of the normal \[rad\], about its worse axis.
    #[must_use]
    pub fn normal_sigma_rad(&self) -> f64 {
        self.roughness_m / (f64::from(self.points).sqrt() * self.spread_m[1])
    }

    /// The plane through moments that are counted from `corner_m`, in a time bin that starts at `bin_start_s`;
    /// `None` for fewer than four points or points in a line.
    ///
    /// The normal is the eigenvector of the smallest eigenvalue of the covariance (total least squares).
    #[must_use]
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts below 2³²
    pub fn from_moments(moments: &Moments, corner_m: [f64; 3], bin_start_s: f64, sighting: Sighting) -> Option<Self> {
        if moments.n < 4 {
            return None;
        }
        let n = moments.n as f64;
        let [xx, xy, xz, yy, yz, zz] = moments.covariance_m2();
        let covariance = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let (values, normal, long_axis) = principal_axes(&covariance)?;
        if values[1] < 1e-6 {
            return None;
        }
        let mean = moments.mean_m();
        let time_s = bin_start_s + moments.time as f64 / (n * TICKS_PER_SECOND);
        let up = if normal.z.abs() > 1e-9 {
            normal.z
        } else if normal.x.abs() > 1e-9 {
            normal.x
        } else {
            normal.y
        };
        Some(Self {
            sighting,
            time_s,
            centroid_m: Vector3::new(corner_m[0] + mean[0], corner_m[1] + mean[1], corner_m[2] + mean[2]),
            normal: if up < 0.0 { -normal } else { normal },
            long_axis,
            spread_m: [values[2].sqrt(), values[1].sqrt()],
            roughness_m: (values[0].max(0.0) * n / (n - 3.0)).sqrt().max(5e-4),
            points: moments.n as u32,
            intensity: (moments.intensity as f64 / n) as f32,
        })
    }
}

/// Eigenvalues in rising order, unit eigenvector of the smallest, unit eigenvector of the largest.
///
/// Closed form of Smith (1961), *Eigenvalues of a symmetric 3 × 3 matrix*; vectors as cross products of the rows
/// of `A - λ I`. `None` when the matrix is zero or not finite.
#[must_use]
pub(crate) fn principal_axes(a: &Matrix3<f64>) -> Option<([f64; 3], Vector3<f64>, Vector3<f64>)> {
    let mean = a.trace() / 3.0;
    let shifted = a - Matrix3::identity() * mean;
    let p = (shifted.norm_squared() / 6.0).sqrt();
    if !(p.is_finite() && p > 1e-12) {
        return None;
    }
    let r = ((shifted / p).determinant() / 2.0).clamp(-1.0, 1.0);
    let phi = r.acos() / 3.0;
    let largest = mean + 2.0 * p * phi.cos();
    let smallest = mean + 2.0 * p * (phi + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    let middle = 3.0 * mean - largest - smallest;
    let small_vector = null_vector(&(a - Matrix3::identity() * smallest))?;
    let large_vector =
        null_vector(&(a - Matrix3::identity() * largest)).unwrap_or_else(|| perpendicular(&small_vector));
    // The two come out orthogonal to rounding unless eigenvalues coincide; make it exact.
    let large_vector = (large_vector - small_vector * small_vector.dot(&large_vector)).normalize();
    // Refine the small eigenvalue, which suffers from cancellation.
    let smallest = (small_vector.transpose() * a * small_vector)[(0, 0)];
    Some(([smallest, middle, largest], small_vector, large_vector))
}

fn null_vector(m: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let rows = [m.row(0).transpose(), m.row(1).transpose(), m.row(2).transpose()];
    let crosses = [rows[0].cross(&rows[1]), rows[0].cross(&rows[2]), rows[1].cross(&rows[2])];
    let best = crosses.into_iter().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
    let length = best.norm();
    (length > 1e-18).then(|| best / length)
}

fn perpendicular(v: &Vector3<f64>) -> Vector3<f64> {
    let helper = if v.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    v.cross(&helper).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_closed_form_agrees_with_the_iterative_solver(v in prop::array::uniform6(-1.0_f64..1.0), thin in 1e-4_f64..0.1) {
            // a random covariance, flattened in one direction as patches are
            let b = Matrix3::new(v[0], v[1], v[2], v[3], v[4], v[5], v[1] * v[3], v[0] * v[5], v[2] + v[4]);
            prop_assume!(b.determinant().abs() > 1e-3);
            let q = b.qr().q();
            let a = q * Matrix3::from_diagonal(&Vector3::new(thin * thin, 0.2 + v[0].abs(), 2.0 + v[1].abs())) * q.transpose();
            let a = (a + a.transpose()) / 2.0;
            let ([l0, l1, l2], n, u) = principal_axes(&a).expect("a covariance");
            let oracle = a.symmetric_eigen();
            let mut expected: Vec<f64> = oracle.eigenvalues.iter().copied().collect();
            expected.sort_by(f64::total_cmp);
            prop_assert!((l0 - expected[0]).abs() < 1e-10 && (l1 - expected[1]).abs() < 1e-10 && (l2 - expected[2]).abs() < 1e-10);
            prop_assert!((a * n - n * l0).norm() < 1e-8, "the normal is an eigenvector");
            prop_assert!((a * u - u * l2).norm() < 1e-8 && n.dot(&u).abs() < 1e-12);
        }
    }

    #[test]
    fn a_tilted_plane_with_a_known_step_has_its_normal_and_roughness() {
        let mut moments = Moments::default();
        for i in 0..20_i64 {
            for j in 0..20_i64 {
                // z = x / 2, and a checkerboard of ± 160 steps (about 1 cm)
                let step = if (i + j) % 2 == 0 { 160 } else { -160 };
                moments.add([i * 800, j * 800, i * 400 + step + 1_000], 0, 7);
            }
        }
        let patch = Patch::from_moments(&moments, [10.0, 20.0, 5.0], 3.0, Sighting { strip: 0, pass: 0, scanner: 0 })
            .expect("a plane");
        let expected = Vector3::new(-0.5, 0.0, 1.0).normalize();
        // noise along z, not along the normal, turns the total-least-squares plane by σ² nx nz / λ = 4e-4
        assert!(patch.normal.cross(&expected).norm() < 5e-4);
        let along_normal = 160.0 / 16_384.0 * expected.z;
        assert!((patch.roughness_m - along_normal).abs() < 1e-4, "{}", patch.roughness_m);
        assert!(patch.centroid_m.x > 10.4 && patch.centroid_m.x < 10.5 && (patch.time_s - 3.0).abs() < 1e-9);
        assert!((patch.intensity - 7.0).abs() < 1e-6);
    }

    #[test]
    fn points_in_a_line_are_not_a_patch() {
        let mut moments = Moments::default();
        for i in 0..50 {
            moments.add([i * 300, 0, 0], 0, 0);
        }
        assert!(Patch::from_moments(&moments, [0.0; 3], 0.0, Sighting { strip: 0, pass: 0, scanner: 0 }).is_none());
    }
}
