//! A facet: a small plane that two clouds share, measured as two parallel planes.
//!
//! Both clouds see one normal, each its own offset. The normal is the eigenvector of the smallest eigenvalue of the
//! pooled scatter W = S₁ + S₂, each about its own mean: the least-squares solution of two parallel planes. What is
//! left is one number, the distance of the two means along that normal, and it is all that a facet says about the
//! mismatch of the clouds.

use nalgebra::{Matrix3, Vector3};

use crate::moments::Moments;
use crate::patch::principal_axes;

/// What makes two heaps of points a facet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FacetLimits {
    /// Fewest points of each cloud.
    pub(crate) min_points: i64,
    /// Largest standard deviation of either cloud's points about the plane \[m\].
    pub(crate) max_roughness_m: f64,
    /// Largest angle between a cloud's own normal and the common one, beyond what noise explains \[rad\].
    pub(crate) normal_angle_rad: f64,
    /// What all points of a cloud in a facet have in common \[m\].
    pub(crate) sigma_floor_m: f64,
}

/// A plane in both clouds: how far the moving one lies above the fixed one, and how well that is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Facet {
    /// Mean of the points of both clouds \[m\], in the frame of the fixed cloud.
    pub centre_m: Vector3<f64>,
    /// Unit normal of both planes.
    pub normal: Vector3<f64>,
    /// Moving minus fixed along the normal \[m\].
    pub distance_m: f64,
    /// Sigma of that distance \[m\], from the noise of the points and a floor.
    pub sigma_m: f64,
    /// Covariance of the normal \[rad²\]: a matrix of rank 2 in the plane.
    pub normal_covariance: Matrix3<f64>,
    /// Mean time of the points of the fixed and of the moving cloud \[s\] after the clouds' own first times.
    pub time_s: [f64; 2],
    /// Number of points of the fixed and of the moving cloud.
    pub points: [u32; 2],
}

/// Largest roughness over the smaller spread in the plane: a plane, not a cushion.
const FLATNESS: f64 = 0.25;
/// Least spread of the points across the longer extent, over the width of the cell (a full square has 0.29).
const LEAST_SPREAD: f64 = 0.1;
/// Largest ratio of the roughnesses of the two clouds, counted from 5 mm.
const ROUGHNESS_RATIO: f64 = 3.0;
/// Roughness below which two surfaces are smooth alike \[m\].
const SMOOTH_M: f64 = 0.005;
/// Share of a surface's roughness that all its points in a facet may have in common.
const COMMON_ROUGHNESS: f64 = 0.1;
/// Least roughness that is believed \[m\].
const LEAST_ROUGHNESS_M: f64 = 5e-4;
/// Sigmas that the normals of the two clouds may differ by beyond the angle allowed.
const NORMAL_SIGMAS: f64 = 3.0;

/// Mean \[m\] from the corner and scatter Σ(x - x̄)(x - x̄)ᵀ \[m²\] of the points of one cloud.
struct Heap {
    n: f64,
    mean_m: Vector3<f64>,
    scatter_m2: Matrix3<f64>,
}

impl Heap {
    #[allow(clippy::cast_precision_loss)] // counts below 2³²
    fn new(moments: &Moments) -> Self {
        let n = moments.n as f64;
        let [xx, xy, xz, yy, yz, zz] = moments.covariance_m2();
        Self {
            n,
            mean_m: Vector3::from(moments.mean_m()),
            scatter_m2: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) * n,
        }
    }
    /// Standard deviation along the normal \[m\], one plane of three parameters taken off.
    fn roughness_m(&self, normal: &Vector3<f64>) -> f64 {
        let along = normal.dot(&(self.scatter_m2 * normal)).max(0.0);
        (along / (self.n - 3.0)).sqrt().max(LEAST_ROUGHNESS_M)
    }
    /// Whether its own normal agrees with the common one.
    fn agrees(&self, normal: &Vector3<f64>, roughness_m: f64, limits: &FacetLimits) -> bool {
        let Some((values, own, _)) = principal_axes(&(self.scatter_m2 / self.n)) else { return false };
        let sigma_rad = roughness_m / (self.n * values[1].max(1e-9)).sqrt();
        let angle_rad = own.cross(normal).norm().min(1.0).asin();
        angle_rad <= limits.normal_angle_rad + NORMAL_SIGMAS * sigma_rad
    }
}

/// The normal that looks up, of steep ones the one that looks to one side of a line through the plan: noise does not
/// turn it round from facet to facet of one wall.
fn outward(normal: Vector3<f64>) -> Vector3<f64> {
    let side = if normal.z.abs() > 0.5 { normal.z } else { 0.93 * normal.x + 0.37 * normal.y };
    if side < 0.0 { -normal } else { normal }
}

impl Facet {
    /// The facet of two heaps of points whose moments are counted from one corner \[m\], in a cell `width_m` wide;
    /// `None` where they are not one plane each, or not the same one.
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub(crate) fn of(
        moments: [&Moments; 2],
        corner_m: &Vector3<f64>,
        width_m: f64,
        limits: &FacetLimits,
    ) -> Option<Self> {
        if moments.iter().any(|m| m.n < limits.min_points.max(4)) {
            return None;
        }
        let heaps = moments.map(Heap::new);
        let n = heaps[0].n + heaps[1].n;
        let pooled = heaps[0].scatter_m2 + heaps[1].scatter_m2;
        let (values, normal, long_axis) = principal_axes(&(pooled / n))?;
        let normal = outward(normal);
        let spread_m = values[1].max(0.0).sqrt();
        let roughness_m = heaps.each_ref().map(|h| h.roughness_m(&normal));
        let [rough, smooth] = [roughness_m[0].max(roughness_m[1]), roughness_m[0].min(roughness_m[1])];
        if spread_m < LEAST_SPREAD * width_m
            || rough > limits.max_roughness_m.min(FLATNESS * spread_m)
            || rough > ROUGHNESS_RATIO * smooth.max(SMOOTH_M)
            || heaps.iter().zip(roughness_m).any(|(h, r)| !h.agrees(&normal, r, limits))
        {
            return None;
        }
        // two parallel planes: four parameters
        let noise_m2 = (normal.dot(&(pooled * normal)) / (n - 4.0)).max(LEAST_ROUGHNESS_M * LEAST_ROUGHNESS_M);
        let cross_axis = normal.cross(&long_axis);
        let between_m = heaps[1].mean_m - heaps[0].mean_m;
        let (u, v) = (between_m.dot(&long_axis), between_m.dot(&cross_axis));
        // the means lie within the extent of the points: the planes are compared where both were seen
        if u * u / values[2] + v * v / values[1] > 1.0 {
            return None;
        }
        let (in_u, in_v) = (n * values[2], n * values[1]);
        let lever = 1.0 / heaps[0].n + 1.0 / heaps[1].n + u * u / in_u + v * v / in_v;
        let floor_m2 = 2.0 * limits.sigma_floor_m.powi(2);
        let common_m2 = COMMON_ROUGHNESS.powi(2) * (roughness_m[0].powi(2) + roughness_m[1].powi(2));
        Some(Self {
            centre_m: corner_m + (heaps[0].mean_m * heaps[0].n + heaps[1].mean_m * heaps[1].n) / n,
            normal,
            distance_m: normal.dot(&between_m),
            sigma_m: (noise_m2 * lever + floor_m2 + common_m2).sqrt(),
            normal_covariance: (long_axis * long_axis.transpose() / in_u + cross_axis * cross_axis.transpose() / in_v)
                * noise_m2,
            time_s: moments.map(|m| m.time as f64 / (m.n as f64 * crate::moments::TICKS_PER_SECOND)),
            points: moments.map(|m| m.n as u32),
        })
    }

    /// Distance \[m\] of the planes once the moving cloud has been shifted by `step[0..3]` \[m\] and turned by the
    /// rotation vector `step[3..6]` \[rad\] about `origin_m`, to first order.
    #[must_use]
    pub fn residual_m(&self, step: &nalgebra::Vector6<f64>, origin_m: &Vector3<f64>) -> f64 {
        self.distance_m + self.jacobian(origin_m).dot(step)
    }

    /// Derivative of [`Facet::residual_m`]: nᵀ for the shift, ((c - o) × n)ᵀ \[m/rad\] for the turn.
    #[must_use]
    pub fn jacobian(&self, origin_m: &Vector3<f64>) -> nalgebra::Vector6<f64> {
        let turn = (self.centre_m - origin_m).cross(&self.normal);
        nalgebra::Vector6::new(self.normal.x, self.normal.y, self.normal.z, turn.x, turn.y, turn.z)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector6};
    use proptest::prelude::*;

    use super::*;
    use crate::moments::STEPS_PER_METRE;

    const LIMITS: FacetLimits =
        FacetLimits { min_points: 6, max_roughness_m: 0.05, normal_angle_rad: 0.05, sigma_floor_m: 0.0 };

    #[allow(clippy::cast_possible_truncation)]
    fn moments(points_m: &[Vector3<f64>]) -> Moments {
        let mut moments = Moments::default();
        for point in points_m {
            moments.add(point.map(|v| (v * STEPS_PER_METRE).round() as i64).into(), 0, 0);
        }
        moments
    }

    /// A square of 6 × 6 points on z = x / 2 + y / 4 with a step of 5 mm to and fro.
    fn slope(lift_m: f64) -> Vec<Vector3<f64>> {
        let at = |k: i32| 0.2 * f64::from(k);
        let step = |i: i32, j: i32| if (i + j) % 2 == 0 { 0.005 } else { -0.005 };
        (0..36)
            .map(|k| (k % 6, k / 6))
            .map(|(i, j)| Vector3::new(at(i), at(j), 2.0 + at(i) / 2.0 + at(j) / 4.0 + step(i, j) + lift_m))
            .collect()
    }

    #[test]
    fn two_parallel_planes_are_as_far_apart_as_they_were_put() {
        let facet = Facet::of([&moments(&slope(0.0)), &moments(&slope(0.03))], &Vector3::zeros(), 1.0, &LIMITS)
            .expect("a facet");
        let normal = Vector3::new(-0.5, -0.25, 1.0).normalize();
        assert!(facet.normal.cross(&normal).norm() < 1e-3 && facet.normal.z > 0.0);
        assert!((facet.distance_m - 0.03 * normal.z).abs() < 1e-4, "{}", facet.distance_m);
        // noise of 5 mm along z over 36 points each, and a tenth of it that all have in common
        let noise_m = 0.005 * normal.z;
        let expected_m = noise_m * (2.0_f64 / 36.0 + 0.02).sqrt();
        assert!((facet.sigma_m / expected_m - 1.0).abs() < 0.1, "{} {expected_m}", facet.sigma_m);
    }

    #[test]
    fn planes_that_lean_apart_are_no_facet() {
        let turned: Vec<Vector3<f64>> =
            slope(0.0).iter().map(|p| Rotation3::from_scaled_axis(Vector3::x() * 0.3) * p).collect();
        assert!(Facet::of([&moments(&slope(0.0)), &moments(&turned)], &Vector3::zeros(), 1.0, &LIMITS).is_none());
        let few = &slope(0.0)[..5];
        assert!(Facet::of([&moments(&slope(0.0)), &moments(few)], &Vector3::zeros(), 1.0, &LIMITS).is_none());
    }

    proptest! {
        #[test]
        fn the_analytic_jacobian_equals_the_central_difference(
            c in prop::array::uniform3(-20.0_f64..20.0),
            n in prop::array::uniform3(-1.0_f64..1.0),
            k in 0_usize..6,
        ) {
            prop_assume!(Vector3::from(n).norm() > 0.1);
            let facet = Facet {
                centre_m: Vector3::from(c),
                normal: Vector3::from(n).normalize(),
                // the turn acts where the two planes meet: at the solution
                distance_m: 0.0,
                sigma_m: 0.01,
                normal_covariance: Matrix3::zeros(),
                time_s: [0.0; 2],
                points: [10; 2],
            };
            let origin = Vector3::new(3.0, -2.0, 1.0);
            // the distance of the moving plane's own point after the motion x ← o + δt + exp(δθ)(x - o)
            let distance = |step: &Vector6<f64>| {
                let turn = Rotation3::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
                let moved = origin + Vector3::new(step[0], step[1], step[2]) + turn * (facet.centre_m - origin);
                facet.normal.dot(&(moved - facet.centre_m))
            };
            let mut h = Vector6::zeros();
            h[k] = 1e-4;
            let numeric = (distance(&h) - distance(&-h)) / 2e-4;
            prop_assert!((numeric - facet.jacobian(&origin)[k]).abs() < 1e-6, "{numeric}");
            let exact = facet.residual_m(&h, &origin) - facet.residual_m(&-h, &origin);
            prop_assert!((exact / 2e-4 - facet.jacobian(&origin)[k]).abs() < 1e-9);
        }
    }
}
