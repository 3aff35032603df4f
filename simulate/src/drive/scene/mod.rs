//! The streets as a laser sees them.

mod cars;
mod facade;
mod features;
mod furniture;
mod ground;
mod material;
mod mesh;
mod paint;

use nalgebra::{Vector2, Vector3};

use super::motion::Driven;
use super::network::Network;
use super::scenario::DriveScenario;
use crate::random::Random;
use crate::world::Tree;
use cars::Car;
pub use features::Feature;
use features::Features;
pub use material::Material;
use mesh::{Mesh, MeshBuilder};
use paint::Paint;

/// What a beam meets.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    pub(super) distance_m: f64,
    /// Cosine of the angle of incidence.
    pub(super) cosine: f64,
    pub(super) normal: Vector3<f64>,
    pub(super) material: Material,
}

/// The scene.
#[derive(Debug)]
pub struct Scene {
    mesh: Mesh,
    paint: Paint,
    trees: Vec<Tree>,
    parked: Vec<Vec<Car>>,
    oncoming: Vec<Car>,
    features: Vec<Feature>,
    roughness_m: f64,
}

/// What moves or is loose near the vehicle during a block.
#[derive(Debug)]
pub(super) struct Nearby<'a> {
    trees: Vec<&'a Tree>,
    cars: Vec<&'a Car>,
}

impl Scene {
    /// Builds the streets of a scenario; `driven` is the way of the vehicle, for those who meet it.
    pub(super) fn new(scenario: &DriveScenario, network: &Network, driven: &Driven) -> Self {
        let options = &scenario.scene;
        let bounds = bounds(network, options.verge_m);
        let mut mesh = MeshBuilder::default();
        let mut features = Features::default();
        let mut paint = Paint::new(bounds);
        ground::add(&mut mesh, network, bounds, options.verge_m);
        paint.add_streets(&mut features, network, options, &mut Random::new(scenario.scene_seed, &[61]));
        let mut trees = Vec::new();
        for (number, way) in (0_u64..).zip(&network.ways) {
            let mut random = Random::new(scenario.scene_seed, &[62, number]);
            facade::add(&mut mesh, &mut features, network, way, options, &mut random);
            let mut random = Random::new(scenario.scene_seed, &[63, number]);
            trees.extend(furniture::add(&mut mesh, &mut features, network, way, options, &mut random));
        }
        let passes = scenario.drive.laps.len();
        Self {
            mesh: mesh.finish(),
            paint,
            trees,
            parked: (0..passes).map(|pass| cars::parked(network, options, scenario.seed, pass)).collect(),
            oncoming: cars::oncoming(network, driven, options, scenario.seed),
            features: features.list,
            roughness_m: options.roughness_m,
        }
    }

    /// Number of triangles.
    #[must_use]
    pub fn triangles(&self) -> usize {
        self.mesh.len()
    }

    /// Things whose place is known.
    #[must_use]
    pub fn features(&self) -> &[Feature] {
        &self.features
    }

    /// What is loose within a distance of a place during a pass and a span of time.
    pub(super) fn nearby(&self, pass: usize, place: &Vector3<f64>, within_m: f64, span_s: (f64, f64)) -> Nearby<'_> {
        let is_near = |point: &Vector3<f64>| (point - place).xy().norm() < within_m;
        let is_there = |car: &&Car| car.there_s.0 <= span_s.1 && car.there_s.1 >= span_s.0;
        Nearby {
            trees: self.trees.iter().filter(|t| is_near(&t.centre_m())).collect(),
            cars: self.parked[pass]
                .iter()
                .filter(|c| is_near(&c.foot))
                .chain(self.oncoming.iter().filter(is_there))
                .collect(),
        }
    }

    /// The first solid thing along a ray.
    pub(super) fn solid(
        &self,
        nearby: &Nearby<'_>,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        time_s: f64,
        within_m: f64,
    ) -> Option<Hit> {
        let mut hit = self.mesh.cast(origin, direction, within_m).map(|(distance_m, triangle)| {
            let mut material = triangle.material;
            if material == Material::Asphalt {
                let point = origin + direction * distance_m;
                material = self.paint.at(&point.xy()).unwrap_or(material);
            }
            let cosine = triangle.normal.dot(direction).abs();
            Hit { distance_m, cosine, normal: triangle.normal, material }
        });
        for car in &nearby.cars {
            if let Some((distance_m, normal)) = car.cast(origin, direction, time_s)
                && distance_m < hit.map_or(within_m, |h| h.distance_m)
            {
                let cosine = normal.dot(direction).abs();
                hit = Some(Hit { distance_m, cosine, normal, material: car.material() });
            }
        }
        hit
    }

    /// The first leaf along a ray before a distance \[m\].
    pub(super) fn leaf_m(
        nearby: &Nearby<'_>,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        before_m: f64,
        random: &mut Random,
    ) -> Option<f64> {
        let mut first: Option<f64> = None;
        for tree in &nearby.trees {
            if let Some((enter, leave)) = tree.span(origin, direction)
                && leave > 0.0
            {
                let at_m = enter.max(0.0) + Tree::depth_m(random);
                if at_m < leave.min(first.unwrap_or(before_m)) {
                    first = Some(at_m);
                }
            }
        }
        first
    }

    /// By how much the surface of a hit lies off, along the beam \[m\].
    pub(super) fn roughness_m(&self, hit: &Hit, random: &mut Random) -> f64 {
        self.roughness_m * hit.material.roughness() * random.normal() / hit.cosine.max(0.2)
    }
}

impl Hit {
    /// Share of the light of a beam that comes back from a range, against a surface that reflects a tenth and is hit
    /// squarely at the range `reach_m`.
    pub(super) fn strength(&self, reach_m: f64) -> f64 {
        let range_m = self.distance_m.max(3.0); // nearer, the receiver sees part of the beam only
        self.material.reflectance() / 0.1 * self.cosine * (reach_m / range_m).powi(2)
    }
}

/// Ground that has to be there: all streets with their verges.
fn bounds(network: &Network, verge_m: f64) -> (Vector2<f64>, Vector2<f64>) {
    let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    for way in &network.ways {
        let margin = Vector2::repeat(way.half_width_m + way.pavement_m + verge_m + 2.0);
        let mut at_m = 0.0;
        while at_m <= way.axis.length_m {
            let point = way.axis.at(at_m).point;
            low = low.inf(&(point - margin));
            high = high.sup(&(point + margin));
            at_m += 1.0;
        }
    }
    (low, high)
}
