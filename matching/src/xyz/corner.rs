//! Corners, where three planes meet, and edges, where two do: the place and its covariance from the planes.
//!
//! Three planes nₖᵀ x = nₖᵀ cₖ give x = A⁻¹ b, the rows of A being the normals. When plane k is off by hₖ at x (noise of its points
//! over √n, and of its normal over the distance from its centroid), x is off by A⁻¹ h: Σ = A⁻¹ diag(σₖ²) A⁻ᵀ with σₖ the sigma of
//! plane k *at x*. Two planes give the same with the least-squares inverse, and nothing along their edge.

use nalgebra::{Matrix3, Vector3};

use crate::patch::Patch;

/// Where three planes meet.
#[derive(Debug, Clone, PartialEq)]
pub struct Corner {
    /// The place \[m\].
    pub point_m: Vector3<f64>,
    /// Its covariance \[m²\].
    pub covariance_m2: Matrix3<f64>,
    /// Unit normals of the planes.
    pub normals: [Vector3<f64>; 3],
    /// Mean time of the planes \[s\], weighted by their information at the corner.
    pub time_s: f64,
}

/// Where two planes meet: a tie of rank 2.
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// The point of the edge nearest to the middle of the planes' centroids \[m\].
    pub point_m: Vector3<f64>,
    /// Unit vector along the edge: nothing is known along it.
    pub direction: Vector3<f64>,
    /// Covariance across the edge \[m²\]: of rank 2, zero along it.
    pub covariance_m2: Matrix3<f64>,
    /// Unit normals of the planes.
    pub normals: [Vector3<f64>; 2],
    /// Mean time of the planes \[s\], weighted by their information at the point.
    pub time_s: f64,
}

/// Least volume of the box that three unit normals span: below, the planes hardly meet.
const LEAST_VOLUME: f64 = 0.15;
/// Least sine of the angle between two planes of an edge.
const LEAST_SINE: f64 = 0.2;
/// What all points of a plane have in common where nothing else is said \[m\].
const FLOOR_M: f64 = 0.0005;

fn variance_m2(plane: &Patch, point_m: &Vector3<f64>, common_m: f64) -> f64 {
    plane.plane_sigma_m(&(point_m - plane.centroid_m)).powi(2) + common_m * common_m
}

/// Mean time of planes by their information.
fn mean_time_s(planes: &[&Patch], variances_m2: &[f64]) -> f64 {
    let first = planes.first().map_or(0.0, |p| p.time_s);
    let total: f64 = variances_m2.iter().map(|v| 1.0 / v).sum();
    first + planes.iter().zip(variances_m2).map(|(p, v)| (p.time_s - first) / v).sum::<f64>() / total
}

impl Corner {
    /// The corner of three planes; `None` when they hardly meet in a point.
    #[must_use]
    pub fn of(planes: [&Patch; 3]) -> Option<Self> {
        Self::with_common(planes, FLOOR_M)
    }

    /// The same where all points of a plane have so much in common \[m\].
    #[must_use]
    pub fn with_common(planes: [&Patch; 3], common_m: f64) -> Option<Self> {
        let normals = planes.map(|p| p.normal);
        let a = Matrix3::from_rows(&normals.map(|n| n.transpose()));
        if a.determinant().abs() < LEAST_VOLUME {
            return None;
        }
        let inverse = a.try_inverse()?;
        // about the mean of the centroids: map coordinates are large
        let middle_m = planes.iter().map(|p| p.centroid_m).sum::<Vector3<f64>>() / 3.0;
        let b = Vector3::from(planes.map(|p| p.normal.dot(&(p.centroid_m - middle_m))));
        let point_m = middle_m + inverse * b;
        let variances_m2 = planes.map(|p| variance_m2(p, &point_m, common_m));
        Some(Self {
            point_m,
            covariance_m2: inverse * Matrix3::from_diagonal(&Vector3::from(variances_m2)) * inverse.transpose(),
            normals,
            time_s: mean_time_s(&planes, &variances_m2),
        })
    }
}

impl Edge {
    /// The same edge at a point so far along its direction \[m\], with what its planes, whose points have so much in common \[m\], know there.
    #[must_use]
    pub fn moved(&self, planes: [&Patch; 2], along_m: f64, common_m: f64) -> Self {
        let point_m = self.point_m + self.direction * along_m;
        let [n, m] = self.normals;
        let inverse = Matrix3::from_rows(&[n.transpose(), m.transpose(), self.direction.transpose()]).try_inverse();
        let variances_m2 = planes.map(|p| variance_m2(p, &point_m, common_m));
        let known = Matrix3::from_diagonal(&Vector3::new(variances_m2[0], variances_m2[1], 0.0));
        let covariance_m2 = inverse.map_or(self.covariance_m2, |inverse| inverse * known * inverse.transpose());
        Self { point_m, covariance_m2, ..self.clone() }
    }

    /// The edge of two planes; `None` when they are nearly parallel.
    #[must_use]
    pub fn of(planes: [&Patch; 2]) -> Option<Self> {
        Self::with_common(planes, FLOOR_M)
    }

    /// The same where all points of a plane have so much in common \[m\].
    #[must_use]
    pub fn with_common(planes: [&Patch; 2], common_m: f64) -> Option<Self> {
        // map coordinates are large: about the mean of the centroids
        Self::near(planes, &((planes[0].centroid_m + planes[1].centroid_m) / 2.0), common_m)
    }

    /// The same edge at its point nearest to another place \[m\]: its covariance is that of the planes there.
    pub(super) fn at(&self, planes: [&Patch; 2], place_m: &Vector3<f64>) -> Option<Self> {
        Self::near(planes, place_m, FLOOR_M).filter(|e| e.direction.dot(&self.direction) > 0.0)
    }

    fn near(planes: [&Patch; 2], place_m: &Vector3<f64>, common_m: f64) -> Option<Self> {
        let [n, m] = planes.map(|p| p.normal);
        let across = n.cross(&m);
        let sine = across.norm();
        if sine < LEAST_SINE {
            return None;
        }
        let direction = across / sine;
        // the third plane, through the place and across the edge, is only there to choose a point
        let inverse = Matrix3::from_rows(&[n.transpose(), m.transpose(), direction.transpose()]).try_inverse()?;
        let [b, c] = planes.map(|p| p.normal.dot(&(p.centroid_m - place_m)));
        let point_m = place_m + inverse * Vector3::new(b, c, 0.0);
        let variances_m2 = planes.map(|p| variance_m2(p, &point_m, common_m));
        let known = Matrix3::from_diagonal(&Vector3::new(variances_m2[0], variances_m2[1], 0.0));
        Some(Self {
            point_m,
            direction,
            covariance_m2: inverse * known * inverse.transpose(),
            normals: [n, m],
            time_s: mean_time_s(&planes, &variances_m2),
        })
    }

    /// The point of the edge nearest to a place \[m\].
    pub(super) fn nearest_m(&self, place_m: &Vector3<f64>) -> Vector3<f64> {
        self.point_m + self.direction * self.direction.dot(&(place_m - self.point_m))
    }

    /// Sigma across the edge in the worse direction \[m\].
    pub(super) fn worst_sigma_m(&self) -> f64 {
        self.covariance_m2.symmetric_eigenvalues().max().max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    use super::*;
    use crate::patch::Sighting;

    fn plane(centroid_m: [f64; 3], normal: [f64; 3]) -> Patch {
        let normal = Vector3::from(normal).normalize();
        let helper = if normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        Patch {
            sighting: Sighting { strip: 0, pass: 0, scanner: 0 },
            time_s: 100.0 + centroid_m[0],
            centroid_m: Vector3::from(centroid_m),
            normal,
            long_axis: normal.cross(&helper).normalize(),
            spread_m: [1.2, 0.8],
            roughness_m: 0.02,
            points: 100,
            intensity: 0.0,
        }
    }

    /// A street corner: the road and two façades.
    fn street_corner(far_m: f64) -> [Patch; 3] {
        [
            plane([3.0 + far_m, 2.0, 10.0], [0.02, -0.01, 1.0]),
            plane([2.0 + far_m, 0.0, 13.0], [0.1, 1.0, 0.0]),
            plane([far_m, 2.0, 12.0], [1.0, -0.1, 0.02]),
        ]
    }

    #[test]
    fn a_corner_lies_in_its_three_planes() {
        for far_m in [0.0, 4e6] {
            let planes = street_corner(far_m);
            let corner = Corner::of(planes.each_ref()).expect("they meet");
            for plane in &planes {
                assert!(plane.normal.dot(&(corner.point_m - plane.centroid_m)).abs() < 1e-8);
            }
            assert!(corner.time_s > 100.0 + far_m && corner.time_s < 103.0 + far_m);
        }
    }

    /// The planes with plane k lifted by `errors[k][0]` \[m\] and turned about its axes by the other two \[rad\].
    fn disturbed(planes: &[Patch], errors: &[[f64; 3]]) -> Vec<Patch> {
        let turned = |(p, [lift_m, about_long, about_cross]): (&Patch, &[f64; 3])| {
            let turn = Rotation3::from_scaled_axis(p.long_axis * *about_long + p.cross_axis() * *about_cross);
            Patch { centroid_m: p.centroid_m + p.normal * *lift_m, normal: turn * p.normal, ..p.clone() }
        };
        planes.iter().zip(errors).map(turned).collect()
    }

    /// Sigmas of a plane's lift \[m\] and of its turns about the long and the cross axis \[rad\].
    fn sigmas(plane: &Patch) -> [f64; 3] {
        let s = plane.roughness_m / f64::from(plane.points).sqrt();
        [s.hypot(FLOOR_M), s / plane.spread_m[1], s / plane.spread_m[0]]
    }

    #[test]
    fn the_covariance_is_that_of_central_differences() {
        let planes = street_corner(0.0);
        let corner = Corner::of(planes.each_ref()).expect("they meet");
        let edge = Edge::of([&planes[0], &planes[1]]).expect("they meet");
        let (mut of_corner, mut of_edge) = (Matrix3::zeros(), Matrix3::zeros());
        let across = Matrix3::identity() - edge.direction * edge.direction.transpose();
        for k in 0..3 {
            for (i, sigma) in sigmas(&planes[k]).into_iter().enumerate() {
                let at = |sign: f64| {
                    let mut errors = [[0.0; 3]; 3];
                    errors[k][i] = sign * 1e-6;
                    let d = disturbed(&planes, &errors);
                    let corner = Corner::of([&d[0], &d[1], &d[2]]).expect("they meet").point_m;
                    (corner, Edge::of([&d[0], &d[1]]).expect("they meet").point_m)
                };
                let ((a, b), (c, d)) = (at(1.0), at(-1.0));
                let column = (a - c) / 2e-6 * sigma;
                of_corner += column * column.transpose();
                let column = across * (b - d) / 2e-6 * sigma;
                of_edge += column * column.transpose();
            }
        }
        let off = (of_corner - corner.covariance_m2).norm() / of_corner.norm();
        assert!(off < 1e-3, "{of_corner} {}", corner.covariance_m2);
        let off = (of_edge - edge.covariance_m2).norm() / of_edge.norm();
        assert!(off < 1e-2, "{of_edge} {}", edge.covariance_m2);
        assert!((edge.covariance_m2 * edge.direction).norm() < 1e-15, "nothing is claimed along the edge");
    }

    #[test]
    fn planes_that_hardly_meet_give_nothing() {
        let level = plane([0.0; 3], [0.0, 0.0, 1.0]);
        let nearly = plane([1.0, 0.0, 0.0], [0.1, 0.0, 1.0]);
        let wall = plane([2.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        assert!(Corner::of([&level, &nearly, &wall]).is_none());
        assert!(Edge::of([&level, &nearly]).is_none());
    }

    proptest! {
        #[test]
        fn a_corner_moves_with_its_planes(t in prop::array::uniform3(-50.0_f64..50.0)) {
            let planes = street_corner(0.0);
            let t = Vector3::from(t);
            let moved: Vec<Patch> =
                planes.iter().map(|p| Patch { centroid_m: p.centroid_m + t, ..p.clone() }).collect();
            let a = Corner::of(planes.each_ref()).expect("they meet");
            let b = Corner::of([&moved[0], &moved[1], &moved[2]]).expect("they meet");
            prop_assert!((b.point_m - a.point_m - t).norm() < 1e-9);
            prop_assert!((b.covariance_m2 - a.covariance_m2).norm() < 1e-12);
        }
    }
}
