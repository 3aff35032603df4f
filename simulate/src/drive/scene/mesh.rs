//! Triangles and the search for the first one along a ray.
//!
//! The tree of boxes is parry's and speaks `f32`; it only decides which triangles are looked at. Those are kept and
//! met in `f64`, so that no precision is lost at any distance from the origin (boxes are a millimetre too large).

use std::cell::Cell;

use nalgebra::Vector3;
use parry3d::bounding_volume::Aabb;
use parry3d::math::Vector;
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::Ray;

use super::material::Material;

/// By how much boxes are too large \[m\]: more than `f32` rounds by within 4 km.
const MARGIN_M: f32 = 1e-3;

/// A triangle of one material: a corner, two edges, the unit normal.
#[derive(Debug, Clone, Copy)]
pub(super) struct Triangle {
    corner: Vector3<f64>,
    edges: [Vector3<f64>; 2],
    pub(super) normal: Vector3<f64>,
    pub(super) material: Material,
}

/// Triangles in the making.
#[derive(Debug, Default)]
pub(super) struct MeshBuilder {
    triangles: Vec<Triangle>,
}

/// Triangles in a tree.
pub(super) struct Mesh {
    triangles: Vec<Triangle>,
    tree: Bvh,
}

impl std::fmt::Debug for Mesh {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Mesh of {} triangles", self.triangles.len())
    }
}

impl MeshBuilder {
    pub(super) fn triangle(&mut self, [a, b, c]: [Vector3<f64>; 3], material: Material) {
        let normal = (b - a).cross(&(c - a));
        if normal.norm() > 1e-9 {
            let normal = normal.normalize();
            self.triangles.push(Triangle { corner: a, edges: [b - a, c - a], normal, material });
        }
    }

    /// A convex polygon.
    pub(super) fn polygon(&mut self, corners: &[Vector3<f64>], material: Material) {
        for k in 2..corners.len() {
            self.triangle([corners[0], corners[k - 1], corners[k]], material);
        }
    }

    /// An upright prism about a point of the ground.
    pub(super) fn prism(&mut self, foot: &Vector3<f64>, radius_m: f64, height_m: f64, material: Material) {
        const SIDES: u32 = 10;
        let corner = |k: u32, up: f64| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(SIDES)).sin_cos();
            foot + Vector3::new(radius_m * cos, radius_m * sin, up)
        };
        for k in 0..SIDES {
            let below = -0.3;
            self.polygon(
                &[corner(k, below), corner(k + 1, below), corner(k + 1, height_m), corner(k, height_m)],
                material,
            );
        }
        let top: Vec<_> = (0..SIDES).map(|k| corner(k, height_m)).collect();
        self.polygon(&top, material);
    }

    pub(super) fn finish(self) -> Mesh {
        #[allow(clippy::cast_possible_truncation)]
        let single = |v: Vector3<f64>| Vector::new(v.x as f32, v.y as f32, v.z as f32);
        let boxes: Vec<Aabb> = self
            .triangles
            .iter()
            .map(|t| {
                let (b, c) = (t.corner + t.edges[0], t.corner + t.edges[1]);
                let margin = Vector::splat(MARGIN_M);
                Aabb::new(single(t.corner.inf(&b).inf(&c)) - margin, single(t.corner.sup(&b).sup(&c)) + margin)
            })
            .collect();
        Mesh { tree: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes), triangles: self.triangles }
    }
}

impl Triangle {
    /// Distance along a ray (Möller and Trumbore, 1997).
    fn distance_m(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        // a hair beyond the edges, so that no ray slips between two triangles
        const EDGE: f64 = -1e-9;
        let p = direction.cross(&self.edges[1]);
        let determinant = self.edges[0].dot(&p);
        if determinant.abs() < 1e-14 {
            return None;
        }
        let from_corner = origin - self.corner;
        let u = from_corner.dot(&p) / determinant;
        if !(EDGE..=1.0 - EDGE).contains(&u) {
            return None;
        }
        let q = from_corner.cross(&self.edges[0]);
        let v = direction.dot(&q) / determinant;
        if v < EDGE || u + v > 1.0 - EDGE {
            return None;
        }
        Some(self.edges[1].dot(&q) / determinant)
    }
}

impl Mesh {
    /// The first triangle along a ray within a distance \[m\].
    pub(super) fn cast(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        within_m: f64,
    ) -> Option<(f64, &Triangle)> {
        #[allow(clippy::cast_possible_truncation)]
        let single = |v: &Vector3<f64>| Vector::new(v.x as f32, v.y as f32, v.z as f32);
        #[allow(clippy::cast_possible_truncation)]
        let limit = within_m as f32;
        let best: Cell<Option<(f64, u32)>> = Cell::new(None);
        self.tree.cast_ray(&Ray::new(single(origin), single(direction)), limit, |leaf, _| {
            let distance_m = self.triangles[leaf as usize].distance_m(origin, direction)?;
            if distance_m <= 0.0 || distance_m > within_m {
                return None;
            }
            let is_nearer = best.get().is_none_or(|(d, number)| (distance_m, leaf) < (d, number));
            if is_nearer {
                best.set(Some((distance_m, leaf)));
            }
            #[allow(clippy::cast_possible_truncation)]
            Some(distance_m as f32)
        });
        best.get().map(|(distance_m, leaf)| (distance_m, &self.triangles[leaf as usize]))
    }

    pub(super) fn len(&self) -> usize {
        self.triangles.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn the_first_triangle_is_the_nearest_of_all_to_a_micrometre_far_from_the_origin() {
        let mut random = Random::new(3, &[1]);
        let far = Vector3::new(1500.0, -900.0, 30.0);
        let mut builder = MeshBuilder::default();
        let point = |random: &mut Random| {
            far + Vector3::new(random.between(-20.0, 20.0), random.between(-20.0, 20.0), random.between(-5.0, 5.0))
        };
        for _ in 0..400 {
            let a = point(&mut random);
            let b = a + (point(&mut random) - far) * 0.2;
            let c = a + (point(&mut random) - far) * 0.2;
            builder.triangle([a, b, c], Material::Facade);
        }
        let mesh = builder.finish();
        let mut hits = 0;
        for _ in 0..2000 {
            let origin = point(&mut random);
            let direction = (point(&mut random) - origin).normalize();
            let all = mesh.triangles.iter().filter_map(|t| t.distance_m(&origin, &direction)).filter(|d| *d > 0.0);
            let nearest = all.fold(f64::INFINITY, f64::min);
            match mesh.cast(&origin, &direction, 100.0) {
                Some((distance_m, _)) => {
                    hits += 1;
                    assert!((distance_m - nearest).abs() < 1e-6);
                }
                None => assert!(nearest > 100.0),
            }
        }
        assert!(hits > 500, "{hits}");
    }
}
