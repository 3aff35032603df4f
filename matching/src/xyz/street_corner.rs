//! Corners of a street: where two walls meet, and where the ground meets them.
//!
//! A wall is cut into layers of two metres: over more of its height ranges differ, and with them what a range may be wrong by. The patches of one sighting in a layer grow into faces; where two that
//! lie side by side make an angle, the patches within two metres of their edge are fitted anew, so that every sighting takes the same piece of either wall. With a piece of ground
//! at its foot the edge is a corner (rank 3), else it holds the two level directions (rank 2).

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::corner::{Corner, Edge};
use super::face::{Face, FaceOptions, face_of, faces, is_clear_of};
use crate::patch::{Patch, Sighting};

/// How corners of a street are found.
#[derive(Debug, Clone, PartialEq)]
pub struct StreetCornerOptions {
    /// What makes patches a face.
    pub face: FaceOptions,
    /// Patches of a wall that lie no further from the edge make its plane \[m\].
    pub reach_m: f64,
    /// Largest distance of an edge from the nearest patch of either wall, and of a corner from that of the ground \[m\].
    pub support_m: f64,
    /// Least sine of the angle between the walls.
    pub least_sine: f64,
    /// Fewest points of a plane.
    pub fewest_points: u32,
    /// Largest sigma in the worst direction that is held \[m\].
    pub max_sigma_m: f64,
    /// Height of a layer \[m\].
    pub layer_m: f64,
}

impl Default for StreetCornerOptions {
    fn default() -> Self {
        let face = FaceOptions { gap_m: 0.6, reach_m: 3.0, ..FaceOptions::default() };
        Self {
            face,
            reach_m: 2.0,
            support_m: 0.6,
            least_sine: 0.4,
            fewest_points: 40,
            max_sigma_m: 0.003,
            layer_m: 2.0,
        }
    }
}

/// A corner as one sighting has it.
#[derive(Debug, Clone, PartialEq)]
pub struct StreetCorner {
    /// Whose.
    pub sighting: Sighting,
    /// Layer of its walls, counted from the local origin.
    pub layer: i32,
    /// The planes of both walls about the edge.
    pub walls: [Patch; 2],
    /// The ground at its foot.
    pub ground: Option<Patch>,
    /// Centroids of the patches that its planes are of \[m\].
    pub members_m: Vec<Vector3<f64>>,
    /// The place: in the middle of the layer, or where the ground is \[m\].
    pub point_m: Vector3<f64>,
}

/// What all points of a wall, or of the ground, have in common within the reach of a corner \[m\].
pub(super) const COMMON_M: f64 = 0.0003;
/// Above this height of its normal a patch is ground, below the other a wall.
const LEVEL: f64 = 0.95;
const WALL: f64 = 0.15;

/// The corners among patches of any sightings, those of walls with their normals towards the vehicle. Fixed order.
#[must_use]
pub fn street_corners(patches: &[Patch], options: &StreetCornerOptions) -> Vec<StreetCorner> {
    let mut layers: BTreeMap<(Sighting, i32), Vec<Patch>> = BTreeMap::new();
    let mut ground: BTreeMap<Sighting, Vec<Patch>> = BTreeMap::new();
    for patch in patches {
        if patch.normal.z.abs() < WALL {
            let layer = layer_of(patch.centroid_m.z, options.layer_m);
            layers.entry((patch.sighting, layer)).or_default().push(patch.clone());
        } else if patch.normal.z > LEVEL {
            ground.entry(patch.sighting).or_default().push(patch.clone());
        }
    }
    let mut found = Vec::new();
    for ((sighting, layer), walls) in &layers {
        let level = ground.get(sighting).map_or(&[][..], Vec::as_slice);
        found.extend(of_layer((*sighting, *layer), walls, level, options));
    }
    found
}

#[allow(clippy::cast_possible_truncation)] // layers of a survey
fn layer_of(height_m: f64, layer_m: f64) -> i32 {
    (height_m / layer_m).floor() as i32
}

fn of_layer(
    (sighting, layer): (Sighting, i32),
    walls: &[Patch],
    level: &[Patch],
    options: &StreetCornerOptions,
) -> Vec<StreetCorner> {
    let height_m = (f64::from(layer) + 0.5) * options.layer_m;
    let faces = faces(walls, &options.face);
    let mut found: Vec<StreetCorner> = Vec::new();
    for (i, a) in faces.iter().enumerate() {
        for b in &faces[i + 1..] {
            let Some([first, second]) = about_edge(walls, [a, b], height_m, options) else { continue };
            let mut members_m: Vec<Vector3<f64>> = first.1.into_iter().chain(second.1).collect();
            let walls = [first.0, second.0];
            let Some(edge) = edge_at(&walls, height_m, options.least_sine) else { continue };
            let ground = ground_at(level, &walls, &edge, options).map(|(plane, of)| {
                members_m.extend(of);
                plane
            });
            let point_m = match &ground {
                Some(plane) => Corner::with_common([&walls[0], &walls[1], plane], COMMON_M).map(|c| c.point_m),
                None => (worst_m(&edge) <= options.max_sigma_m).then_some(edge.point_m),
            };
            let Some(point_m) = point_m else { continue };
            let corner = StreetCorner { sighting, layer, walls, ground, members_m, point_m };
            // pieces of one wall meet another at one edge: the better known stays
            let same = |o: &StreetCorner| {
                (o.point_m - corner.point_m).xy().norm() < options.support_m && is_alike(o, &corner, 0.97)
            };
            match found.iter().position(same) {
                Some(k) if weight(&found[k]) >= weight(&corner) => {}
                Some(k) => found[k] = corner,
                None => found.push(corner),
            }
        }
    }
    found
}

fn weight(corner: &StreetCorner) -> (bool, u32) {
    (corner.ground.is_some(), corner.walls.iter().map(|w| w.points).min().unwrap_or(0))
}

/// Whether two corners are of the same walls by their normals, whichever comes first; `cosine` is that of the largest angle.
pub(super) fn is_alike(a: &StreetCorner, b: &StreetCorner, cosine: f64) -> bool {
    order_of(a, b, cosine).is_some()
}

/// Which wall of `b` is which of `a`.
pub(super) fn order_of(a: &StreetCorner, b: &StreetCorner, cosine: f64) -> Option<[usize; 2]> {
    let fits = |order: &[usize; 2]| (0..2).all(|k| a.walls[k].normal.dot(&b.walls[order[k]].normal) >= cosine);
    [[0, 1], [1, 0]].into_iter().find(fits)
}

/// Largest sigma across an edge \[m\].
pub(super) fn worst_m(edge: &Edge) -> f64 {
    edge.covariance_m2.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// The edge of two walls at a height \[m\].
pub(super) fn edge_at(walls: &[Patch; 2], height_m: f64, least_sine: f64) -> Option<Edge> {
    let sine = walls[0].normal.cross(&walls[1].normal).norm();
    let edge = Edge::with_common([&walls[0], &walls[1]], COMMON_M).filter(|_| sine >= least_sine)?;
    let along_m = (height_m - edge.point_m.z) / edge.direction.z;
    // both walls stand, and so does their edge
    (edge.direction.z.abs() > 0.9).then(|| edge.moved([&walls[0], &walls[1]], along_m, COMMON_M))
}

/// A plane and the centroids of its patches \[m\].
type Fitted = (Patch, Vec<Vector3<f64>>);

/// The plane of patches, where it is enough of one. A cell with a little of the other wall, or of the ground, makes a patch that is rougher than the others: such ones are left out.
fn fitted(mut members: Vec<Patch>, options: &StreetCornerOptions) -> Option<Fitted> {
    /// Narrowest spread of points across the long axis \[m\].
    const NARROWEST_M: f64 = 0.1;
    /// Largest roughness over the median, and sigmas of chance of it.
    const ROUGHER: f64 = 1.15;
    const SIGMAS: f64 = 2.5;
    let mut roughness_m: Vec<f64> = members.iter().map(|p| p.roughness_m).collect();
    roughness_m.sort_by(f64::total_cmp);
    let middle_m = *roughness_m.get(roughness_m.len() / 2)?;
    // a standard deviation of n points is known to one part in √2n
    members.retain(|p| p.roughness_m <= middle_m * (ROUGHER + SIGMAS / (2.0 * f64::from(p.points)).sqrt()));
    let plane = face_of(&members).filter(|p| p.points >= options.fewest_points && p.spread_m[1] > NARROWEST_M)?;
    Some((plane, members.iter().map(|p| p.centroid_m).collect()))
}

/// Both walls by their patches within reach of the edge, on the sides where the faces are.
fn about_edge(
    patches: &[Patch],
    faces: [&Face; 2],
    height_m: f64,
    options: &StreetCornerOptions,
) -> Option<[Fitted; 2]> {
    let planes = faces.map(|f| f.plane.clone());
    let edge = edge_at(&planes, height_m, options.least_sine)?;
    if !faces.iter().all(|f| f.is_by(&edge.point_m, options.support_m)) {
        return None;
    }
    let both = [0, 1].map(|k| {
        let is_of = |p: &&Patch| {
            let off_m = (p.centroid_m - edge.point_m).xy().norm();
            off_m <= options.reach_m && lies_in(p, &planes[k], options) && is_clear_of(p, &planes[k], &planes[1 - k])
        };
        let members: Vec<Patch> = patches.iter().filter(is_of).cloned().collect();
        fitted(members, options)
    });
    let [Some(a), Some(b)] = both else { return None };
    Some([a, b])
}

/// Whether a patch lies in a plane, by its place and its normal.
fn lies_in(patch: &Patch, plane: &Patch, options: &StreetCornerOptions) -> bool {
    let off_m = plane.normal.dot(&(patch.centroid_m - plane.centroid_m)).abs();
    let angle_rad = patch.normal.cross(&plane.normal).norm().min(1.0).asin();
    off_m <= options.face.distance_m + 3.0 * patch.plane_sigma_m(&Vector3::zeros())
        && angle_rad <= options.face.normal_angle_rad + 3.0 * patch.normal_sigma_rad()
}

/// The ground at the foot of an edge: one plane by all level patches near it.
fn ground_at(level: &[Patch], walls: &[Patch; 2], edge: &Edge, options: &StreetCornerOptions) -> Option<Fitted> {
    let near = |p: &&Patch| {
        (p.centroid_m - edge.point_m).xy().norm() <= options.reach_m
            && (p.centroid_m.z - edge.point_m.z).abs() <= 0.5 * options.layer_m
            && walls.iter().all(|wall| is_clear_of(p, p, wall))
    };
    let near: Vec<Patch> = level.iter().filter(near).cloned().collect();
    let of_plane = |face: &Face| {
        let members: Vec<Patch> = near.iter().filter(|p| lies_in(p, &face.plane, options)).cloned().collect();
        fitted(members, options)
    };
    let supported = |plane: &Patch, face: &Face| {
        let corner = Corner::with_common([&walls[0], &walls[1], plane], COMMON_M)?;
        let worst_m = corner.covariance_m2.symmetric_eigenvalues().max().max(0.0).sqrt();
        let is_good = face.is_by(&corner.point_m, options.support_m) && worst_m <= options.max_sigma_m;
        is_good.then_some((worst_m, corner.point_m.z))
    };
    let candidates = faces(&near, &options.face).into_iter().filter_map(|face| {
        let plane = of_plane(&face)?;
        let (worst_m, height_m) = supported(&plane.0, &face)?;
        Some((worst_m, height_m, plane))
    });
    let candidates: Vec<(f64, f64, Fitted)> = candidates.collect();
    // a step or a curb at its foot: which of both another sighting takes is not known
    let heights = || candidates.iter().map(|c| c.1);
    let apart_m = heights().fold(f64::NEG_INFINITY, f64::max) - heights().fold(f64::INFINITY, f64::min);
    let best = candidates.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    (apart_m <= options.face.distance_m).then_some(best.2)
}
