//! Buildings along the streets: fronts with windows and doors set back, plain walls at the sides.

use nalgebra::{Vector2, Vector3};

use super::features::{Feature, Features};
use super::material::Material;
use super::mesh::MeshBuilder;
use crate::drive::network::{Network, Way};
use crate::drive::scenario::Sides;
use crate::drive::scene_options::SceneOptions;
use crate::random::Random;

/// Depth of a building \[m\].
const DEPTH_M: f64 = 9.0;
/// Width of an axis of windows, height of a floor \[m\].
const AXIS_M: f64 = 3.0;
const FLOOR_M: f64 = 3.3;
/// Length of a piece of an even wall \[m\], and its height.
const WALL_PIECE_M: f64 = 2.0;
const WALL_HEIGHT_M: f64 = 6.0;

/// A wall seen from outside: its left foot, unit vector to the right, its height.
struct Wall {
    foot: Vector3<f64>,
    along: Vector3<f64>,
    inwards: Vector3<f64>,
    length_m: f64,
    height_m: f64,
}

impl Wall {
    fn between(left: Vector2<f64>, right: Vector2<f64>, foot_m: f64, top_m: f64) -> Self {
        let along = (right - left).normalize();
        Self {
            foot: left.push(foot_m),
            along: along.push(0.0),
            inwards: Vector3::new(-along.y, along.x, 0.0),
            length_m: (right - left).norm(),
            height_m: top_m - foot_m,
        }
    }

    fn at(&self, right_m: f64, up_m: f64, in_m: f64) -> Vector3<f64> {
        self.foot + self.along * right_m + self.inwards * in_m + Vector3::z() * up_m
    }

    fn rectangle(&self, mesh: &mut MeshBuilder, u: (f64, f64), v: (f64, f64), in_m: f64, material: Material) {
        if u.1 - u.0 > 1e-6 && v.1 - v.0 > 1e-6 {
            let corners =
                [self.at(u.0, v.0, in_m), self.at(u.1, v.0, in_m), self.at(u.1, v.1, in_m), self.at(u.0, v.1, in_m)];
            mesh.polygon(&corners, material);
        }
    }

    /// An opening: glass or door set back, and its reveals.
    fn recess(&self, mesh: &mut MeshBuilder, u: (f64, f64), v: (f64, f64), depth_m: f64, back: Material) {
        self.rectangle(mesh, u, v, depth_m, back);
        for x in [u.0, u.1] {
            mesh.polygon(
                &[self.at(x, v.0, 0.0), self.at(x, v.0, depth_m), self.at(x, v.1, depth_m), self.at(x, v.1, 0.0)],
                Material::Reveal,
            );
        }
        for y in [v.0, v.1] {
            mesh.polygon(
                &[self.at(u.0, y, 0.0), self.at(u.1, y, 0.0), self.at(u.1, y, depth_m), self.at(u.0, y, depth_m)],
                Material::Reveal,
            );
        }
    }

    /// A front: axes of windows over floors, a door here and there; `ground_m` above the foot is the ground floor.
    fn front(&self, mesh: &mut MeshBuilder, ground_m: f64, recess_m: [f64; 2], random: &mut Random) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some ten
        let whole = |v: f64| v.floor().max(0.0) as u32;
        let axes = whole(self.length_m / AXIS_M).max(1);
        let axis_m = self.length_m / f64::from(axes);
        let floors = whole((self.height_m - ground_m - 0.6) / FLOOR_M);
        let (depth_m, half_m) = (random.between(recess_m[0], recess_m[1]), random.between(0.45, 0.75));
        for axis in 0..axes {
            let left = f64::from(axis) * axis_m;
            let middle = left + 0.5 * axis_m;
            let opening = (middle - half_m, middle + half_m);
            self.rectangle(mesh, (left, opening.0), (0.0, self.height_m), 0.0, Material::Facade);
            self.rectangle(mesh, (opening.1, left + axis_m), (0.0, self.height_m), 0.0, Material::Facade);
            let mut done_m = 0.0;
            for floor in 0..floors {
                let base = ground_m + f64::from(floor) * FLOOR_M;
                let is_door = floor == 0 && random.uniform() < 0.25;
                let (low, top) = if is_door { (base + 0.15, base + 2.3) } else { (base + 0.9, base + 2.5) };
                let back = if is_door { Material::Reveal } else { Material::Window };
                self.rectangle(mesh, opening, (done_m, low), 0.0, Material::Facade);
                self.recess(mesh, opening, (low, top), depth_m, back);
                done_m = top;
            }
            self.rectangle(mesh, opening, (done_m, self.height_m), 0.0, Material::Facade);
        }
    }
}

/// Adds the buildings along a street.
pub(super) fn add(
    mesh: &mut MeshBuilder,
    features: &mut Features,
    network: &Network,
    way: &Way,
    options: &SceneOptions,
    random: &mut Random,
) {
    for (side, is_there) in [
        (-1.0, matches!(way.facades, Sides::Both | Sides::Left)),
        (1.0, matches!(way.facades, Sides::Both | Sides::Right)),
    ] {
        if !is_there {
            continue;
        }
        if way.walled {
            add_even_wall(mesh, network, way, side);
            continue;
        }
        let mut at_m = 0.0;
        while at_m < way.axis.length_m {
            let wanted_m = random.between(11.0, 23.0);
            let length_m = if way.axis.is_straight(at_m, at_m + wanted_m) { wanted_m } else { 5.0 };
            if random.uniform() >= options.gap_share {
                add_building(mesh, features, network, way, options, random, (side, at_m, length_m));
            }
            at_m += length_m;
        }
    }
}

fn add_building(
    mesh: &mut MeshBuilder,
    features: &mut Features,
    network: &Network,
    way: &Way,
    options: &SceneOptions,
    random: &mut Random,
    (side, at_m, length_m): (f64, f64, f64),
) {
    let line_m = way.half_width_m + way.pavement_m;
    let place = way.axis.at(at_m + 0.5 * length_m);
    let out = place.right() * side;
    let setback_m = if random.uniform() < 0.5 { 0.0 } else { random.between(0.1, 0.9) };
    let turn_rad = random.between(-0.07, 0.07);
    let height_m = random.between(options.facade_height_m[0], options.facade_height_m[1]);
    // seen from the street, the left end comes first
    let along = Vector2::new(-out.y, out.x) * -1.0;
    let along = nalgebra::Rotation2::new(turn_rad) * along;
    let inwards = Vector2::new(-along.y, along.x);
    let middle = place.point + out * (line_m + setback_m + 0.5 * length_m * turn_rad.abs());
    let half = along * (0.5 * length_m);
    let (left, right) = (middle - half, middle + half);
    let footprint = [0.0, 0.5, 1.0].map(|d| [0.0, 0.25, 0.5, 0.75, 1.0].map(|u| (d, u)));
    let stands_free = footprint.iter().flatten().all(|(d, u)| {
        let point = left + (right - left) * *u + inwards * (d * DEPTH_M);
        let across = network.across(&point);
        across.from_curb_m > across.pavement_m - 0.3
    });
    if !stands_free {
        return;
    }
    let ground_m = network.ground_m(&middle);
    let foot_m = ground_m - 2.0;
    let top_m = ground_m + height_m;
    let front = Wall::between(left, right, foot_m, top_m);
    front.front(mesh, ground_m - foot_m, options.recess_m, random);
    let (left_back, right_back) = (left + inwards * DEPTH_M, right + inwards * DEPTH_M);
    for (a, b) in [(left_back, left), (right, right_back), (right_back, left_back)] {
        let wall = Wall::between(a, b, foot_m, top_m);
        wall.rectangle(mesh, (0.0, wall.length_m), (0.0, wall.height_m), 0.0, Material::Facade);
    }
    let number = features.next("facade");
    for (corner, point) in [left, right].iter().enumerate() {
        let name = format!("{number}.{corner}");
        features.list.push(Feature { kind: "facade", name, point_m: point.push(network.ground_m(point)) });
    }
}

/// An even wall along the building line, as in an underpass.
fn add_even_wall(mesh: &mut MeshBuilder, network: &Network, way: &Way, side: f64) {
    let line_m = way.half_width_m + way.pavement_m;
    let foot = |at_m: f64| {
        let place = way.axis.at(at_m);
        place.point + place.right() * (side * line_m)
    };
    let mut at_m = 0.0;
    while at_m < way.axis.length_m {
        let end_m = (at_m + WALL_PIECE_M).min(way.axis.length_m);
        let (a, b) = (foot(at_m), foot(end_m));
        let is_free = |p: &Vector2<f64>| network.across(p).from_curb_m > way.pavement_m - 0.3;
        if (b - a).norm() > 0.1 && is_free(&a) && is_free(&b) {
            let (za, zb) = (network.ground_m(&a), network.ground_m(&b));
            mesh.polygon(
                &[a.push(za - 0.5), b.push(zb - 0.5), b.push(zb + WALL_HEIGHT_M), a.push(za + WALL_HEIGHT_M)],
                Material::Facade,
            );
        }
        at_m = end_m;
    }
}
