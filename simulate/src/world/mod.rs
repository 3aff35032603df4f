//! The world: rolling ground, houses, trees, and cars that stay for one strip only.
//!
//! Coordinates are east, north, up \[m\] about the scenario's origin. Rays are cast exactly: Newton on the analytic
//! ground, clipping on the convex houses.

mod build;
mod index;
mod solid;
mod terrain;
mod tree;

use nalgebra::{Vector2, Vector3};

use crate::random::Random;
use index::Index;
pub use solid::{Roof, Solid};
pub use terrain::Terrain;
pub use tree::Tree;

/// ASPRS classes.
mod class {
    pub(super) const GROUND: u8 = 2;
    pub(super) const VEGETATION: u8 = 5;
    pub(super) const BUILDING: u8 = 6;
    pub(super) const ROAD: u8 = 11;
}

/// The world.
#[derive(Debug)]
pub struct World {
    terrain: Terrain,
    solids: Vec<Solid>,
    trees: Vec<Tree>,
    roads: Vec<Road>,
    solid_index: Index,
    tree_index: Index,
    highest_m: f64,
    roughness_m: f64,
}

/// A straight road across the area.
#[derive(Debug, Clone, Copy)]
struct Road {
    normal: Vector2<f64>,
    offset_m: f64,
}

/// Half the width of a road \[m\].
const ROAD_HALF_WIDTH_M: f64 = 3.5;
/// Two echoes nearer than this \[m\] are one to the receiver.
const SEPARATION_M: f64 = 1.5;

/// An echo on its way: distance along the ray and what sent it back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Return {
    /// From the scanner \[m\].
    pub distance_m: f64,
    /// ASPRS class.
    pub class: u8,
    /// Brightness, 0 to 1, with the cosine of the incidence in it.
    pub brightness: f64,
}

impl World {
    /// The returns of a pulse, the nearest first: leaves on the way and the surface behind them. Empty when the ray
    /// meets nothing.
    pub(crate) fn cast(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        strip: u32,
        random: &mut Random,
    ) -> Vec<Return> {
        let Some(surface) = self.surface(origin, direction, strip, random) else { return Vec::new() };
        let mut returns = Vec::with_capacity(2);
        if let Some((leaf_m, passes)) = self.leaf(origin, direction, surface.distance_m, random) {
            returns.push(Return {
                distance_m: leaf_m,
                class: class::VEGETATION,
                brightness: random.between(0.15, 0.4),
            });
            if !passes || surface.distance_m - leaf_m < SEPARATION_M {
                return returns;
            }
        }
        returns.push(surface);
        returns
    }

    /// The first solid surface.
    fn surface(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        strip: u32,
        random: &mut Random,
    ) -> Option<Return> {
        let (ground_m, ground_normal) = self.terrain.hit(origin, direction)?;
        let mut best: Option<(f64, Vector3<f64>, f64)> = None;
        let from_m = (self.highest_m - origin.z) / direction.z;
        self.solid_index.along(origin, direction, (from_m.max(0.0), ground_m), |number| {
            let solid = &self.solids[number as usize];
            if solid.only_strip.is_some_and(|only| only != strip) {
                return;
            }
            if let Some((t, normal)) = solid.hit(origin, direction)
                && t < best.map_or(ground_m, |b| b.0)
            {
                best = Some((t, normal, solid.reflectance));
            }
        });
        if let Some((distance_m, normal, reflectance)) = best {
            let brightness = reflectance * -normal.dot(direction);
            return Some(Return { distance_m, class: class::BUILDING, brightness });
        }
        let place = (origin + direction * ground_m).xy();
        let cosine = -ground_normal.dot(direction);
        Some(match self.is_road(&place) {
            true => Return { distance_m: ground_m, class: class::ROAD, brightness: 0.12 * cosine },
            false => {
                let rough_m = if self.roughness_m > 0.0 { self.roughness_m * random.normal() } else { 0.0 };
                let distance_m = ground_m + rough_m;
                Return { distance_m, class: class::GROUND, brightness: 0.45 * cosine }
            }
        })
    }

    /// Where a leaf sends light back \[m\], and whether enough passes for another echo.
    fn leaf(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        surface_m: f64,
        random: &mut Random,
    ) -> Option<(f64, bool)> {
        let mut nearest: Option<(f64, f64)> = None;
        let from_m = (self.highest_m - origin.z) / direction.z;
        self.tree_index.along(origin, direction, (from_m.max(0.0), surface_m), |number| {
            if let Some((enter, leave)) = self.trees[number as usize].span(origin, direction)
                && nearest.is_none_or(|n| enter < n.0)
            {
                nearest = Some((enter, leave));
            }
        });
        let (enter, leave) = nearest?;
        let leaf_m = enter + Tree::depth_m(random);
        (leaf_m < leave.min(surface_m)).then(|| (leaf_m, random.uniform() < 0.7))
    }

    fn is_road(&self, place: &Vector2<f64>) -> bool {
        self.roads.iter().any(|road| (road.normal.dot(place) - road.offset_m).abs() < ROAD_HALF_WIDTH_M)
    }

    /// Distance \[m\] of a point to the nearest surface of ground or house: how well an echo fits the world.
    #[must_use]
    pub fn distance_to_surface_m(&self, point: &Vector3<f64>) -> f64 {
        let (z, dx, dy) = self.terrain.height(point.x, point.y);
        let ground_m = (point.z - z).abs() / (1.0 + dx * dx + dy * dy).sqrt();
        self.solids.iter().map(|solid| solid.outside_m(point).abs()).fold(ground_m, f64::min)
    }

    /// Highest point of the world \[m\].
    #[must_use]
    pub fn highest_m(&self) -> f64 {
        self.highest_m
    }
    /// The ground.
    #[must_use]
    pub fn terrain(&self) -> &Terrain {
        &self.terrain
    }
    /// Number of houses and cars.
    #[must_use]
    pub fn solid_count(&self) -> usize {
        self.solids.len()
    }
    /// Number of trees.
    #[must_use]
    pub fn tree_count(&self) -> usize {
        self.trees.len()
    }
}
