//! What lies flat on the road: patches, markings, manhole covers. They change the material of a point, not its height.

use nalgebra::Vector2;

use super::features::{Feature, Features};
use super::material::Material;
use crate::drive::axis::Place;
use crate::drive::network::Network;
use crate::drive::scene_options::SceneOptions;
use crate::random::Random;

/// Side of a square of the index \[m\].
const CELL_M: f64 = 4.0;
/// Radius of a manhole cover \[m\].
const MANHOLE_M: f64 = 0.31;

/// The outline of something flat.
#[derive(Debug, Clone)]
enum Outline {
    /// Convex, in either order.
    Polygon(Vec<Vector2<f64>>),
    Circle(Vector2<f64>),
}

impl Outline {
    fn holds(&self, point: &Vector2<f64>) -> bool {
        match self {
            Self::Circle(centre) => (point - centre).norm_squared() < MANHOLE_M * MANHOLE_M,
            Self::Polygon(corners) => {
                let side = |k: usize| {
                    let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
                    (b.x - a.x) * (point.y - a.y) - (b.y - a.y) * (point.x - a.x)
                };
                let first = side(0);
                (1..corners.len()).all(|k| side(k) * first > 0.0)
            }
        }
    }

    fn bounds(&self) -> (Vector2<f64>, Vector2<f64>) {
        match self {
            Self::Circle(centre) => (centre.add_scalar(-MANHOLE_M), centre.add_scalar(MANHOLE_M)),
            Self::Polygon(corners) => {
                corners.iter().fold((corners[0], corners[0]), |(low, high), c| (low.inf(c), high.sup(c)))
            }
        }
    }
}

/// Everything flat, found by squares of the ground.
#[derive(Debug)]
pub(super) struct Paint {
    shapes: Vec<(Outline, Material)>,
    low: Vector2<f64>,
    columns: usize,
    cells: Vec<Vec<u32>>,
}

impl Paint {
    pub(super) fn new((low, high): (Vector2<f64>, Vector2<f64>)) -> Self {
        let columns = cell_of(high.x - low.x) + 1;
        let rows = cell_of(high.y - low.y) + 1;
        Self { shapes: Vec::new(), low, columns, cells: vec![Vec::new(); columns * rows] }
    }

    fn put(&mut self, outline: Outline, material: Material) {
        let (low, high) = outline.bounds();
        let (a, b) = (low - self.low, high - self.low);
        let number = u32::try_from(self.shapes.len()).unwrap_or(u32::MAX);
        for row in cell_of(a.y)..=cell_of(b.y) {
            for column in cell_of(a.x)..=cell_of(b.x).min(self.columns - 1) {
                if let Some(cell) = self.cells.get_mut(row * self.columns + column) {
                    cell.push(number);
                }
            }
        }
        self.shapes.push((outline, material));
    }

    /// What lies at a point; the last that was put there.
    pub(super) fn at(&self, point: &Vector2<f64>) -> Option<Material> {
        let from = point - self.low;
        let cell = self.cells.get(cell_of(from.y) * self.columns + cell_of(from.x))?;
        let found = cell.iter().rev().find(|number| self.shapes[**number as usize].0.holds(point))?;
        Some(self.shapes[*found as usize].1)
    }

    /// Paints the streets.
    pub(super) fn add_streets(
        &mut self,
        features: &mut Features,
        network: &Network,
        options: &SceneOptions,
        random: &mut Random,
    ) {
        for (number, way) in network.ways.iter().enumerate() {
            let length_m = way.axis.length_m;
            let at = |along_m: f64, right_m: f64| {
                let place = way.axis.at(along_m);
                (place, place.point + place.right() * right_m)
            };
            let is_clear = |along_m: f64, margin_m: f64| {
                network.across_but(&way.axis.at(along_m).point, number).from_curb_m > margin_m
            };
            let half_m = way.half_width_m;
            for along_m in steps(length_m, options.patch_spacing_m, random) {
                let (place, centre) = at(along_m, random.between(-0.6 * half_m, 0.6 * half_m));
                let size = (random.between(0.6, 4.0), random.between(0.4, 1.4));
                self.put(Outline::Polygon(rectangle(&place, centre, size)), Material::Patch);
            }
            for along_m in steps(length_m, 9.0, random) {
                if way.axis.is_straight(along_m - 1.5, along_m + 1.5) && is_clear(along_m, 3.0) {
                    let (place, centre) = at(along_m, 0.0);
                    let name = features.next("dash").to_string();
                    self.mark(features, network, "dash", &name, rectangle(&place, centre, (3.0, 0.12)));
                }
            }
            for along_m in steps(length_m, options.zebra_spacing_m, random) {
                if !way.axis.is_straight(along_m - 2.0, along_m + 2.0) || !is_clear(along_m, 3.0) {
                    continue;
                }
                let zebra = features.next("zebra");
                let (mut bar, mut right_m) = (0, 0.5 - half_m);
                while right_m < half_m - 0.5 {
                    let (place, centre) = at(along_m, right_m);
                    let name = format!("{zebra}.{bar}");
                    self.mark(features, network, "zebra", &name, rectangle(&place, centre, (3.0, 0.5)));
                    bar += 1;
                    right_m += 1.0;
                }
            }
            for along_m in steps(length_m, options.arrow_spacing_m, random) {
                if way.axis.is_straight(along_m - 3.0, along_m + 3.0) && is_clear(along_m, 3.0) {
                    let (place, shaft) = at(along_m, 1.6);
                    let arrow = features.next("arrow");
                    let outline = rectangle(&place, shaft, (2.4, 0.15));
                    self.mark(features, network, "arrow", &format!("{arrow}.0"), outline);
                    let (tip, root) = (at(along_m + 2.4, 1.6).1, at(along_m + 1.2, 1.6).1);
                    let wing = place.right() * 0.4;
                    let head = vec![root - wing, root + wing, tip];
                    self.mark(features, network, "arrow", &format!("{arrow}.1"), head);
                }
            }
            for along_m in steps(length_m, options.manhole_spacing_m, random) {
                let (_, centre) = at(along_m, random.between(-0.7 * half_m, 0.7 * half_m));
                self.put(Outline::Circle(centre), Material::Manhole);
                let name = features.next("manhole").to_string();
                let point_m = centre.push(network.road_height_m(&centre));
                features.list.push(Feature { kind: "manhole", name, point_m });
            }
        }
    }

    /// A marking; its corners are features.
    fn mark(
        &mut self,
        features: &mut Features,
        network: &Network,
        kind: &'static str,
        name: &str,
        corners: Vec<Vector2<f64>>,
    ) {
        for (k, corner) in corners.iter().enumerate() {
            let point_m = corner.push(network.road_height_m(corner));
            features.list.push(Feature { kind, name: format!("{name}.{k}"), point_m });
        }
        self.put(Outline::Polygon(corners), Material::Marking);
    }
}

/// A rectangle about a point: length along the street and width across \[m\].
fn rectangle(place: &Place, centre: Vector2<f64>, (length_m, width_m): (f64, f64)) -> Vec<Vector2<f64>> {
    let (along, across) = (place.direction * (0.5 * length_m), place.right() * (0.5 * width_m));
    vec![centre - along - across, centre + along - across, centre + along + across, centre - along + across]
}

/// Ways along a street \[m\] about a spacing apart; none where the spacing is not above zero.
pub(super) fn steps(length_m: f64, spacing_m: f64, random: &mut Random) -> Vec<f64> {
    let mut ways = Vec::new();
    if spacing_m > 0.0 {
        let mut at_m = spacing_m * random.between(0.2, 1.0);
        while at_m < length_m {
            ways.push(at_m);
            at_m += spacing_m * random.between(0.8, 1.2);
        }
    }
    ways
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative
fn cell_of(distance_m: f64) -> usize {
    (distance_m.max(0.0) / CELL_M) as usize
}
