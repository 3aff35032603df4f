//! Lamp posts and trees.

use nalgebra::{Vector2, Vector3};

use super::features::{Feature, Features};
use super::material::Material;
use super::mesh::MeshBuilder;
use super::paint::steps;
use crate::drive::network::{Network, Way};
use crate::drive::scene_options::SceneOptions;
use crate::random::Random;
use crate::world::Tree;

/// Adds lamp posts and trunks along a street; gives the crowns.
pub(super) fn add(
    mesh: &mut MeshBuilder,
    features: &mut Features,
    network: &Network,
    way: &Way,
    options: &SceneOptions,
    random: &mut Random,
) -> Vec<Tree> {
    let mut crowns = Vec::new();
    let foot_of = |along_m: f64, right_m: f64| -> Option<Vector3<f64>> {
        let place = way.axis.at(along_m);
        let point: Vector2<f64> = place.point + place.right() * right_m;
        let across = network.across(&point);
        let is_free = across.from_curb_m > 0.25 && across.from_curb_m < across.pavement_m.max(0.8);
        is_free.then(|| point.push(network.pavement_at_m(&point, across.from_curb_m)))
    };
    if way.walled {
        return crowns;
    }
    for side in [-1.0, 1.0] {
        for along_m in steps(way.axis.length_m, options.pole_spacing_m, random) {
            if let Some(foot) = foot_of(along_m, side * (way.half_width_m + 0.5)) {
                mesh.prism(&foot, random.between(0.05, 0.09), random.between(5.0, 7.5), Material::Pole);
                let name = features.next("pole").to_string();
                features.list.push(Feature { kind: "pole", name, point_m: foot });
            }
        }
        for along_m in steps(way.axis.length_m, options.tree_spacing_m, random) {
            let Some(foot) = foot_of(along_m, side * (way.half_width_m + 0.9)) else { continue };
            let (radius_m, half_height_m) = (random.between(1.1, 1.9), random.between(1.4, 2.4));
            let stem_m = random.between(2.4, 3.2);
            mesh.prism(&foot, random.between(0.1, 0.18), stem_m + 0.3, Material::Trunk);
            crowns.push(Tree::new(foot + Vector3::z() * (stem_m + half_height_m), radius_m, half_height_m));
        }
    }
    crowns
}
