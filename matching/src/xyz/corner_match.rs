//! Corners found among the patches of one sighting, and matched between two.

use nalgebra::{Matrix3, Vector3};
use rstar::{AABB, RTree};

use super::corner::Corner;
use super::face::{Boxed, Face, FaceOptions, faces};
use crate::patch::Patch;

/// How corners are found and matched.
#[derive(Debug, Clone, PartialEq)]
pub struct CornerOptions {
    /// What makes patches a face.
    pub face: FaceOptions,
    /// Largest distance of a corner from the nearest patch of each of its faces \[m\]: cells across a ridge are no patches.
    pub support_m: f64,
    /// Largest sigma of a corner in its worst direction \[m\].
    pub max_sigma_m: f64,
    /// Largest mismatch \[m\].
    pub search_m: f64,
    /// Largest angle between the normals of a corner in the two sightings \[rad\].
    pub normal_angle_rad: f64,
    /// A second candidate must be further away than this many times the first, counted from `max_sigma_m`.
    pub uniqueness: f64,
    /// Reach of the neighbours that a tie is compared with \[m\].
    pub neighbourhood_m: f64,
    /// Largest difference of a tie from its neighbours beyond sigmas \[m\]: what a trajectory may drift over the reach.
    pub drift_m: f64,
}

impl Default for CornerOptions {
    fn default() -> Self {
        Self {
            face: FaceOptions::default(),
            support_m: 2.0,
            max_sigma_m: 0.05,
            search_m: 0.5,
            normal_angle_rad: 4.0_f64.to_radians(),
            uniqueness: 2.0,
            neighbourhood_m: 60.0,
            drift_m: 0.02,
        }
    }
}

/// Why a corner of the first sighting is not tied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum NotTied {
    /// No corner of the same planes within the search.
    NoneFound,
    /// Two corners of the other sighting might be it.
    Ambiguous,
    /// The other corner would rather have another one.
    NotReciprocal,
    /// It disagrees with its neighbours.
    Neighbours,
    /// Fewer than two neighbours can say anything about it.
    Alone,
}

impl NotTied {
    /// The word used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NoneFound => "none_found",
            Self::Ambiguous => "ambiguous",
            Self::NotReciprocal => "not_reciprocal",
            Self::Neighbours => "neighbours",
            Self::Alone => "alone",
        }
    }
}

/// A corner of the first sighting and what became of it.
#[derive(Debug, Clone, PartialEq)]
pub struct CornerTie {
    /// The corner in the first sighting.
    pub first: Corner,
    /// The nearest corner of the same planes in the second, where there is one.
    pub second: Option<Corner>,
    /// Why it is not a tie.
    pub rejection: Option<NotTied>,
}

impl CornerTie {
    /// Second minus first \[m\] and its covariance \[m²\], where there is a second.
    #[must_use]
    pub fn difference(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let second = self.second.as_ref()?;
        Some((second.point_m - self.first.point_m, second.covariance_m2 + self.first.covariance_m2))
    }
}

fn around(point_m: &Vector3<f64>, reach_m: f64) -> AABB<[f64; 3]> {
    AABB::from_corners(point_m.map(|v| v - reach_m).into(), point_m.map(|v| v + reach_m).into())
}

/// The corners among the patches of one sighting: every three faces that come near each other, where they meet by all of
/// them, with a sigma within the limit. Fixed order.
#[must_use]
pub fn corners(patches: &[Patch], options: &CornerOptions) -> Vec<Corner> {
    let faces = faces(patches, &options.face);
    let boxed = |(row, face): (usize, &Face)| {
        let (low, high) = face.extent_m(options.support_m);
        Boxed { row, low, high }
    };
    let tree = RTree::bulk_load(faces.iter().enumerate().map(boxed).collect());
    let mut found = Vec::new();
    for (i, face) in faces.iter().enumerate() {
        let (low, high) = face.extent_m(options.support_m);
        let near = tree.locate_in_envelope_intersecting(AABB::from_corners(low, high));
        let mut near: Vec<usize> = near.map(|b| b.row).filter(|j| *j > i).collect();
        near.sort_unstable();
        for (at, j) in near.iter().enumerate() {
            for k in &near[at + 1..] {
                found.extend(corner_of([face, &faces[*j], &faces[*k]], patches, options));
            }
        }
    }
    distinct(found, options)
}

/// Of corners of the same planes closer to each other than the largest sigma allowed the best known one: a long slope is
/// more than one face, and each meets the others.
fn distinct(mut corners: Vec<Corner>, options: &CornerOptions) -> Vec<Corner> {
    let worst = |c: &Corner| c.covariance_m2.symmetric_eigenvalues().max();
    corners.sort_by(|a, b| worst(a).total_cmp(&worst(b)));
    let tree = tree_of(&corners);
    let mut kept = vec![true; corners.len()];
    for (row, corner) in corners.iter().enumerate() {
        if kept[row] {
            let near = tree.locate_in_envelope_intersecting(around(&corner.point_m, SIGMAS * options.max_sigma_m));
            for other in near.map(|at| at.row).filter(|o| *o > row) {
                kept[other] &= !same_planes(corner, &corners[other], options.normal_angle_rad);
            }
        }
    }
    let mut rows = kept.into_iter();
    corners.retain(|_| rows.next().unwrap_or(false));
    corners
}

fn corner_of(faces: [&Face; 3], patches: &[Patch], options: &CornerOptions) -> Option<Corner> {
    let near = Corner::of(faces.map(|f| &f.plane))?;
    if !faces.iter().all(|f| f.is_by(&near.point_m, options.support_m)) {
        return None;
    }
    let clear = |k: usize| faces[k].plane_clear_of(patches, &[&faces[(k + 1) % 3].plane, &faces[(k + 2) % 3].plane]);
    let planes = [clear(0)?, clear(1)?, clear(2)?];
    let corner = Corner::of(planes.each_ref())?;
    let worst_m2 = corner.covariance_m2.symmetric_eigenvalues().max();
    (worst_m2 <= options.max_sigma_m * options.max_sigma_m).then_some(corner)
}

/// Whether two corners are of the same planes: each normal of one has its own in the other.
fn same_planes(a: &Corner, b: &Corner, angle_rad: f64) -> bool {
    const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let least = angle_rad.cos();
    ORDERS.iter().any(|order| (0..3).all(|k| a.normals[k].dot(&b.normals[order[k]]).abs() >= least))
}

/// The rows of `others` that might be `corner`, nearest first.
fn candidates(corner: &Corner, others: &[Corner], tree: &RTree<Boxed>, options: &CornerOptions) -> Vec<(f64, usize)> {
    let mut found: Vec<(f64, usize)> = tree
        .locate_in_envelope_intersecting(around(&corner.point_m, options.search_m))
        .map(|at| ((others[at.row].point_m - corner.point_m).norm(), at.row))
        .filter(|(distance_m, row)| {
            *distance_m <= options.search_m && same_planes(corner, &others[*row], options.normal_angle_rad)
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found
}

fn tree_of(corners: &[Corner]) -> RTree<Boxed> {
    let at = |(row, c): (usize, &Corner)| Boxed { row, low: c.point_m.into(), high: c.point_m.into() };
    RTree::bulk_load(corners.iter().enumerate().map(at).collect())
}

/// Matches the corners of two sightings. Every corner of the first is in the result, with a reason where it is not tied.
#[must_use]
pub fn match_corners(first: &[Corner], second: &[Corner], options: &CornerOptions) -> Vec<CornerTie> {
    let (of_first, of_second) = (tree_of(first), tree_of(second));
    let mut ties: Vec<CornerTie> = first
        .iter()
        .enumerate()
        .map(|(row, corner)| {
            let found = candidates(corner, second, &of_second, options);
            let rejection = match found[..] {
                [] => Some(NotTied::NoneFound),
                [best, next, ..] if next.0 < options.uniqueness * best.0.max(options.max_sigma_m) => {
                    Some(NotTied::Ambiguous)
                }
                [best, ..] => {
                    let back = candidates(&second[best.1], first, &of_first, options);
                    (back.first().map(|b| b.1) != Some(row)).then_some(NotTied::NotReciprocal)
                }
            };
            let second = found.first().map(|(_, row)| second[*row].clone());
            CornerTie { first: corner.clone(), second, rejection }
        })
        .collect();
    agree(&mut ties, &of_first, options);
    ties
}

/// Sigmas that a tie may differ from its neighbours by.
const SIGMAS: f64 = 4.0;
/// Fewest neighbours that can judge a tie.
const JUDGES: usize = 2;

/// Rejects ties that disagree with the median of their neighbours' differences, component by component.
///
/// A neighbour is another tie not rejected so far, within reach but not at the same place: corners of one wall share
/// their error, and would bear each other out.
fn agree(ties: &mut [CornerTie], tree: &RTree<Boxed>, options: &CornerOptions) {
    let differences: Vec<Option<(Vector3<f64>, Matrix3<f64>)>> =
        ties.iter().map(|t| t.difference().filter(|_| t.rejection.is_none())).collect();
    for row in 0..ties.len() {
        let Some((own_m, covariance_m2)) = differences[row] else { continue };
        let place_m = ties[row].first.point_m;
        let mut near: Vec<usize> = tree
            .locate_in_envelope_intersecting(around(&place_m, options.neighbourhood_m))
            .map(|at| at.row)
            .filter(|other| *other != row && (ties[*other].first.point_m - place_m).norm() > options.face.reach_m)
            .collect();
        near.sort_unstable();
        let theirs: Vec<(Vector3<f64>, Matrix3<f64>)> = near.iter().filter_map(|other| differences[*other]).collect();
        if theirs.len() < JUDGES {
            ties[row].rejection = Some(NotTied::Alone);
            continue;
        }
        let off = (0..3).any(|k| {
            let mut values: Vec<f64> = theirs.iter().map(|(d, _)| d[k]).collect();
            let middle = median(&mut values);
            let mut sigmas: Vec<f64> = theirs.iter().map(|(_, c)| c[(k, k)].sqrt()).collect();
            let sigma_m = covariance_m2[(k, k)].sqrt().hypot(median(&mut sigmas));
            (own_m[k] - middle).abs() > options.drift_m + SIGMAS * sigma_m
        });
        if off {
            ties[row].rejection = Some(NotTied::Neighbours);
        }
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    match n {
        0 => 0.0,
        n if n.is_multiple_of(2) => 0.5 * (values[n / 2 - 1] + values[n / 2]),
        n => values[n / 2],
    }
}
