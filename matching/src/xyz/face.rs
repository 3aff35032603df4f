//! Faces: patches of one sighting that lie in one plane next to each other, fitted as one plane.

use nalgebra::{Matrix3, Vector3};
use rstar::{AABB, RTree, RTreeObject};

use crate::patch::{Patch, principal_axes};
use crate::surface_line::bounds;

/// What makes patches one face.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceOptions {
    /// Largest gap between patches of a face \[m\].
    pub gap_m: f64,
    /// Largest distance of a patch's centroid from that of the first patch of the face \[m\]: a road is not one plane.
    pub reach_m: f64,
    /// Largest angle between normals beyond what their sigmas explain \[rad\].
    pub normal_angle_rad: f64,
    /// Largest distance of a patch from the plane of the face beyond what sigmas explain \[m\].
    pub distance_m: f64,
}

impl Default for FaceOptions {
    fn default() -> Self {
        Self { gap_m: 1.0, reach_m: 10.0, normal_angle_rad: 3.0_f64.to_radians(), distance_m: 0.01 }
    }
}

/// A face: the plane of some patches.
#[derive(Debug, Clone, PartialEq)]
pub struct Face {
    /// The plane of all of them, as a patch. Its roughness is such that its sigma is that of its points or, where the
    /// patches spread more about it than their points explain, that of the patches.
    pub plane: Patch,
    /// Upright boxes about the patches \[m\].
    pub boxes: Vec<([f64; 3], [f64; 3])>,
    /// Their rows among the patches that faces were grown from.
    members: Vec<usize>,
}

/// Sigmas allowed on top of the limits.
const SIGMAS: f64 = 3.0;
/// Patches from which their spread about the plane tells something.
const TELLING: usize = 5;
/// Sigmas of χ² beyond which their points do not explain it.
const CHANCE: f64 = 2.0;

/// Weighted mean and scatter of patches.
#[derive(Debug, Clone, Copy)]
struct Sums {
    n: f64,
    mean_m: Vector3<f64>,
    scatter_m2: Matrix3<f64>,
    time_s: f64,
    intensity: f64,
}

impl Sums {
    fn of(patch: &Patch) -> Self {
        let n = f64::from(patch.points);
        let part = |axis: &Vector3<f64>, variance_m2: f64| axis * axis.transpose() * (n * variance_m2);
        let scatter_m2 = part(&patch.long_axis, patch.spread_m[0].powi(2))
            + part(&patch.cross_axis(), patch.spread_m[1].powi(2))
            + part(&patch.normal, patch.roughness_m.powi(2) * (n - 3.0).max(0.0) / n);
        Self { n, mean_m: patch.centroid_m, scatter_m2, time_s: patch.time_s, intensity: f64::from(patch.intensity) }
    }

    fn with(&self, other: &Self) -> Self {
        let n = self.n + other.n;
        let apart_m = other.mean_m - self.mean_m;
        let share = other.n / n;
        Self {
            n,
            mean_m: self.mean_m + apart_m * share,
            scatter_m2: self.scatter_m2 + other.scatter_m2 + apart_m * apart_m.transpose() * (self.n * share),
            time_s: self.time_s + (other.time_s - self.time_s) * share,
            intensity: self.intensity + (other.intensity - self.intensity) * share,
        }
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts below 2³²
    fn plane(&self, like: &Patch) -> Option<Patch> {
        let (values, normal, long_axis) = principal_axes(&(self.scatter_m2 / self.n))?;
        Some(Patch {
            sighting: like.sighting,
            time_s: self.time_s,
            centroid_m: self.mean_m,
            normal: if normal.dot(&like.normal) < 0.0 { -normal } else { normal },
            long_axis,
            spread_m: [values[2].max(0.0).sqrt(), values[1].max(1e-6).sqrt()],
            roughness_m: (values[0].max(0.0) * self.n / (self.n - 3.0).max(1.0)).sqrt().max(5e-4),
            points: self.n as u32,
            intensity: self.intensity as f32,
        })
    }
}

/// An upright box of something in a row, for the tree \[m\].
pub(super) struct Boxed {
    pub(super) row: usize,
    pub(super) low: [f64; 3],
    pub(super) high: [f64; 3],
}

impl RTreeObject for Boxed {
    type Envelope = AABB<[f64; 3]>;
    fn envelope(&self) -> Self::Envelope {
        AABB::from_corners(self.low, self.high)
    }
}

/// Grows faces from the patches of one sighting, from the best known ones on. Every patch belongs to one face; the
/// order of the result is fixed.
#[must_use]
pub fn faces(patches: &[Patch], options: &FaceOptions) -> Vec<Face> {
    let boxed = |(row, patch): (usize, &Patch)| {
        let (low, high) = bounds(patch, 0.0);
        Boxed { row, low, high }
    };
    let tree = RTree::bulk_load(patches.iter().enumerate().map(boxed).collect());
    let mut order: Vec<usize> = (0..patches.len()).collect();
    // the smoothest first: a patch across a ridge is no seed
    let noise = |row: usize| patches[row].roughness_m.powi(2) / f64::from(patches[row].points);
    order.sort_by(|a, b| noise(*a).total_cmp(&noise(*b)).then(a.cmp(b)));
    let mut taken = vec![false; patches.len()];
    let mut faces = Vec::new();
    for seed in order {
        if !taken[seed] {
            faces.extend(grow(patches, seed, &tree, &mut taken, options));
        }
    }
    faces
}

fn grow(
    patches: &[Patch],
    seed: usize,
    tree: &RTree<Boxed>,
    taken: &mut [bool],
    options: &FaceOptions,
) -> Option<Face> {
    taken[seed] = true;
    let (mut members, mut sums) = (vec![seed], Sums::of(&patches[seed]));
    let mut plane = patches[seed].clone();
    let mut looked_at = 0;
    while let Some(&member) = members.get(looked_at) {
        looked_at += 1;
        let (low, high) = bounds(&patches[member], options.gap_m);
        let mut near: Vec<usize> =
            tree.locate_in_envelope_intersecting(AABB::from_corners(low, high)).map(|b| b.row).collect();
        near.sort_unstable();
        for row in near {
            let candidate = &patches[row];
            let far = (candidate.centroid_m - patches[seed].centroid_m).norm() > options.reach_m;
            if taken[row] || far || !lies_in(candidate, &plane, options) {
                continue;
            }
            let grown = sums.with(&Sums::of(candidate));
            if let Some(fitted) = grown.plane(&plane) {
                (sums, plane) = (grown, fitted);
                taken[row] = true;
                members.push(row);
            }
        }
    }
    plane.roughness_m = roughness_of_patches_m(patches, &members, &plane).max(plane.roughness_m);
    Some(Face { plane, boxes: members.iter().map(|m| bounds(&patches[*m], 0.0)).collect(), members })
}

/// The plane of some patches of one sighting, with the sigma of its points or, where it is larger, that of the patches; none for none.
#[must_use]
pub(crate) fn face_of(patches: &[Patch]) -> Option<Patch> {
    let first = patches.first()?;
    let sums = patches[1..].iter().fold(Sums::of(first), |sums, patch| sums.with(&Sums::of(patch)));
    let mut plane = sums.plane(first)?;
    let members: Vec<usize> = (0..patches.len()).collect();
    plane.roughness_m = roughness_of_patches_m(patches, &members, &plane).max(plane.roughness_m);
    Some(plane)
}

/// Share of its reach at which a patch lies across an edge whatever it looks like (a triangle before the edge has 0.82),
const ACROSS: f64 = 0.75;
/// and sigmas of its tilt towards the other plane beyond which it does where it lies nearer than its reach.
const TILTED: f64 = 1.5;

/// Whether a patch of one plane ends before another: one that reaches across the edge holds points of both, which pull its normal
/// towards the other's.
pub(super) fn is_clear_of(patch: &Patch, own: &Patch, other: &Patch) -> bool {
    let [long_m, cross_m] = patch.half_extent_m();
    let spread_m = |way: &Vector3<f64>, [long_m, cross_m]: [f64; 2]| {
        [long_m * way.dot(&patch.long_axis).abs(), cross_m * way.dot(&patch.cross_axis()).abs()]
    };
    let reach_m: f64 = spread_m(&other.normal, [long_m, cross_m]).iter().sum();
    let share = other.normal.dot(&(patch.centroid_m - other.centroid_m)).abs() / reach_m;
    if !(ACROSS..1.0).contains(&share) {
        return share >= 1.0;
    }
    let Some(towards) = (other.normal - own.normal * own.normal.dot(&other.normal)).try_normalize(1e-6) else {
        return false;
    };
    let [long_m, cross_m] = spread_m(&towards, patch.spread_m);
    let sigma_rad = patch.roughness_m / (f64::from(patch.points).sqrt() * long_m.hypot(cross_m));
    towards.dot(&patch.normal) <= TILTED * sigma_rad
}

fn lies_in(patch: &Patch, plane: &Patch, options: &FaceOptions) -> bool {
    let sigma_rad = patch.normal_sigma_rad().hypot(plane.normal_sigma_rad());
    let angle_rad = patch.normal.cross(&plane.normal).norm().min(1.0).asin();
    let between_m = patch.centroid_m - plane.centroid_m;
    let sigma_m = plane.plane_sigma_m(&between_m).hypot(patch.plane_sigma_m(&Vector3::zeros()));
    angle_rad <= options.normal_angle_rad + SIGMAS * sigma_rad
        && plane.normal.dot(&between_m).abs() <= options.distance_m + SIGMAS * sigma_m
}

/// The roughness that gives the plane the sigma of its patches: their points share errors, the patches do not. With k patches
/// whose centroids lie s about the plane, s/√k is the sigma, and `plane_sigma_m` divides by √n. Zero where the noise of their points
/// explains how the patches lie, by χ².
#[allow(clippy::cast_precision_loss)]
fn roughness_of_patches_m(patches: &[Patch], members: &[usize], plane: &Patch) -> f64 {
    if members.len() < TELLING {
        return 0.0;
    }
    let k = members.len() as f64;
    let off = |m: &usize| plane.normal.dot(&(patches[*m].centroid_m - plane.centroid_m));
    let squares = members.iter().map(|m| (off(m) / patches[*m].plane_sigma_m(&Vector3::zeros())).powi(2)).sum::<f64>();
    if squares <= k - 3.0 + CHANCE * (2.0 * (k - 3.0)).sqrt() {
        return 0.0;
    }
    let spread_m = (members.iter().map(|m| off(m).powi(2)).sum::<f64>() / (k - 3.0)).sqrt();
    spread_m * (f64::from(plane.points) / k).sqrt()
}

impl Face {
    /// Whether a point \[m\] lies by the face: within `gap_m` of the box about one of its patches.
    #[must_use]
    pub fn is_by(&self, point_m: &Vector3<f64>, gap_m: f64) -> bool {
        self.boxes
            .iter()
            .any(|(low, high)| (0..3).all(|k| low[k] - gap_m <= point_m[k] && point_m[k] <= high[k] + gap_m))
    }

    /// The plane of those of the face's patches, rows of `patches`, that end before some other planes: a row of patches across an edge
    /// would pull both of its planes alike. None where there are none.
    pub(super) fn plane_clear_of(&self, patches: &[Patch], others: &[&Patch]) -> Option<Patch> {
        let ends_before = |p: &&Patch| others.iter().all(|other| is_clear_of(p, &self.plane, other));
        let clear: Vec<Patch> = self.members.iter().map(|m| &patches[*m]).filter(ends_before).cloned().collect();
        face_of(&clear)
    }

    /// Upright box about the whole face, widened \[m\].
    #[must_use]
    pub(crate) fn extent_m(&self, margin_m: f64) -> ([f64; 3], [f64; 3]) {
        let low = |k: usize| self.boxes.iter().map(|b| b.0[k]).fold(f64::INFINITY, f64::min) - margin_m;
        let high = |k: usize| self.boxes.iter().map(|b| b.1[k]).fold(f64::NEG_INFINITY, f64::max) + margin_m;
        (std::array::from_fn(low), std::array::from_fn(high))
    }
}
