//! Ridges: edges of two faces, found among the patches of one sighting and matched between two.
//!
//! An edge is a line: what is compared between two sightings is its place across itself, both taken where they run along each other.

use nalgebra::{Matrix2, Matrix3, SymmetricEigen, Vector2, Vector3};
use rstar::{AABB, RTree};

use super::agreement::{Disagreement, Neighbourhood, Said, judge};
use super::corner::Edge;
use super::corner_match::{CornerOptions, NotTied};
use super::face::{Boxed, Face, faces};
use crate::patch::Patch;

/// A ridge, or a valley, of one sighting.
#[derive(Debug, Clone, PartialEq)]
pub struct Ridge {
    /// The edge at the middle of what both faces hold of it.
    pub edge: Edge,
    /// Half of that length \[m\].
    pub half_length_m: f64,
    /// The faces.
    planes: [Patch; 2],
}

/// Shortest ridge, and shortest part that two sightings must have in common \[m\].
const LEAST_LENGTH_M: f64 = 2.0;
/// Steps along an edge at which its faces are looked for \[m\].
const STEP_M: f64 = 0.5;
/// How far from the middle of its faces an edge is followed \[m\].
const REACH_M: f64 = 15.0;
/// Sigmas within which two places across an edge are one.
const SIGMAS: f64 = 4.0;

impl Ridge {
    /// The ridge of two faces of some patches, where both hold it.
    fn of(faces: [&Face; 2], patches: &[Patch], options: &CornerOptions) -> Option<Self> {
        let edge = Edge::of(faces.map(|f| &f.plane))?;
        let held = |t_m: f64| {
            let point_m = edge.point_m + edge.direction * t_m;
            faces.iter().all(|f| f.is_by(&point_m, options.support_m))
        };
        #[allow(clippy::cast_possible_truncation)]
        let steps = (REACH_M / STEP_M) as i32;
        let (mut best, mut start): ((f64, f64), Option<f64>) = ((0.0, 0.0), None);
        for k in -steps..=steps + 1 {
            let t_m = f64::from(k) * STEP_M;
            match (k <= steps && held(t_m), start) {
                (true, None) => start = Some(t_m),
                (false, Some(from_m)) => {
                    if t_m - STEP_M - from_m > best.1 - best.0 {
                        best = (from_m, t_m - STEP_M);
                    }
                    start = None;
                }
                _ => {}
            }
        }
        let length_m = best.1 - best.0;
        if length_m < LEAST_LENGTH_M {
            return None;
        }
        let middle_m = edge.point_m + edge.direction * (0.5 * (best.0 + best.1));
        let clear = |k: usize| faces[k].plane_clear_of(patches, &[&faces[1 - k].plane]);
        let planes = [clear(0)?, clear(1)?];
        let edge = edge.at(planes.each_ref(), &middle_m)?;
        let known = edge.worst_sigma_m() <= options.max_sigma_m;
        known.then_some(Self { edge, half_length_m: 0.5 * length_m, planes })
    }

    /// The edge nearest to a place \[m\], with its covariance there.
    fn at(&self, place_m: &Vector3<f64>) -> Option<Edge> {
        self.edge.at(self.planes.each_ref(), place_m)
    }

    /// From where to where along a direction about a place the ridge runs \[m\].
    fn span_m(&self, from_m: &Vector3<f64>, direction: &Vector3<f64>) -> (f64, f64) {
        let middle_m = direction.dot(&(self.edge.point_m - from_m));
        (middle_m - self.half_length_m, middle_m + self.half_length_m)
    }

    /// The middle of what two ridges have in common, where that is long enough \[m\].
    fn common_m(&self, other: &Self) -> Option<Vector3<f64>> {
        let (origin_m, along) = (self.edge.point_m, self.edge.direction);
        let (a, b) = (self.span_m(&origin_m, &along), other.span_m(&origin_m, &along));
        let (from_m, to_m) = (a.0.max(b.0), a.1.min(b.1));
        (to_m - from_m >= LEAST_LENGTH_M).then(|| origin_m + along * (0.5 * (from_m + to_m)))
    }

    fn same_planes(&self, other: &Self, angle_rad: f64) -> bool {
        let least = angle_rad.cos();
        let like =
            |order: [usize; 2]| (0..2).all(|k| self.edge.normals[k].dot(&other.edge.normals[order[k]]).abs() >= least);
        like([0, 1]) || like([1, 0])
    }

    /// How far another ridge lies across this one \[m\], where both run along each other.
    fn apart_m(&self, other: &Self) -> Option<f64> {
        let place_m = self.common_m(other)?;
        let (own, their) = (self.edge.nearest_m(&place_m), other.edge.nearest_m(&place_m));
        let between_m = their - own;
        let along = self.edge.direction;
        Some((between_m - along * along.dot(&between_m)).norm())
    }
}

/// A ridge of the first sighting and what became of it.
#[derive(Debug, Clone, PartialEq)]
pub struct RidgeTie {
    /// The edge in the first sighting, where both ridges run along each other if there is a second.
    pub first: Edge,
    /// The same in the second.
    pub second: Option<Edge>,
    /// Directions across the edge that are held, at right angles, and sigma of the difference along each \[m\]: its eigenvectors.
    pub held: Vec<(Vector3<f64>, f64)>,
    /// Why it is not a tie.
    pub rejection: Option<NotTied>,
}

impl RidgeTie {
    /// Second minus first across the edge \[m\], where there is a second.
    #[must_use]
    pub fn difference_m(&self) -> Option<Vector3<f64>> {
        let between_m = self.second.as_ref()?.point_m - self.first.point_m;
        Some(self.held.iter().map(|(d, _)| d * d.dot(&between_m)).sum())
    }
}

/// The ridges among the patches of one sighting, in a fixed order.
#[must_use]
pub fn ridges(patches: &[Patch], options: &CornerOptions) -> Vec<Ridge> {
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
        found.extend(near.into_iter().filter_map(|j| Ridge::of([face, &faces[j]], patches, options)));
    }
    distinct(found, options)
}

/// Angles, over the largest between normals of two sightings, within which two ridges at one place are one: patches across the edge may
/// make a face of their own, a little tilted.
const ALIKE: f64 = 4.0;

/// Of ridges of nearly the same planes that run along each other the best known one: a long slope is more than one face.
fn distinct(mut ridges: Vec<Ridge>, options: &CornerOptions) -> Vec<Ridge> {
    let worst = |r: &Ridge| r.edge.worst_sigma_m();
    ridges.sort_by(|a, b| worst(a).total_cmp(&worst(b)));
    let tree = tree_of(&ridges);
    let mut kept = vec![true; ridges.len()];
    for (row, ridge) in ridges.iter().enumerate() {
        if kept[row] {
            let near = tree.locate_in_envelope_intersecting(around(ridge, options.search_m));
            for other in near.map(|b| b.row).filter(|o| *o > row) {
                let same = ridge.same_planes(&ridges[other], ALIKE * options.normal_angle_rad)
                    && ridge.apart_m(&ridges[other]).is_some_and(|d| d <= SIGMAS * options.max_sigma_m);
                kept[other] &= !same;
            }
        }
    }
    let mut rows = kept.into_iter();
    ridges.retain(|_| rows.next().unwrap_or(false));
    ridges
}

/// Box about a ridge, widened \[m\].
fn bounds(ridge: &Ridge, margin_m: f64) -> ([f64; 3], [f64; 3]) {
    let half_m = ridge.edge.direction.abs() * ridge.half_length_m;
    let point_m = ridge.edge.point_m;
    ((point_m - half_m).map(|v| v - margin_m).into(), (point_m + half_m).map(|v| v + margin_m).into())
}

fn around(ridge: &Ridge, reach_m: f64) -> AABB<[f64; 3]> {
    let (low, high) = bounds(ridge, reach_m);
    AABB::from_corners(low, high)
}

fn tree_of(ridges: &[Ridge]) -> RTree<Boxed> {
    let boxed = |(row, r): (usize, &Ridge)| {
        let (low, high) = bounds(r, 0.0);
        Boxed { row, low, high }
    };
    RTree::bulk_load(ridges.iter().enumerate().map(boxed).collect())
}

/// The rows of `others` that might be `ridge`, nearest first.
fn candidates(ridge: &Ridge, others: &[Ridge], tree: &RTree<Boxed>, options: &CornerOptions) -> Vec<(f64, usize)> {
    let mut found: Vec<(f64, usize)> = tree
        .locate_in_envelope_intersecting(around(ridge, options.search_m))
        .filter(|b| ridge.same_planes(&others[b.row], options.normal_angle_rad))
        .filter_map(|b| Some((ridge.apart_m(&others[b.row])?, b.row)))
        .filter(|(apart_m, _)| *apart_m <= options.search_m)
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found
}

/// Matches the ridges of two sightings. Every ridge of the first is in the result, with a reason where it is not tied.
#[must_use]
pub fn match_ridges(first: &[Ridge], second: &[Ridge], options: &CornerOptions) -> Vec<RidgeTie> {
    let (of_first, of_second) = (tree_of(first), tree_of(second));
    let tie = |(row, ridge): (usize, &Ridge)| {
        let found = candidates(ridge, second, &of_second, options);
        let mut rejection = match found[..] {
            [] => Some(NotTied::NoneFound),
            [best, next, ..] if next.0 < options.uniqueness * best.0.max(options.max_sigma_m) => {
                Some(NotTied::Ambiguous)
            }
            [best, ..] => {
                let back = candidates(&second[best.1], first, &of_first, options);
                (back.first().map(|b| b.1) != Some(row)).then_some(NotTied::NotReciprocal)
            }
        };
        let pair = found.first().and_then(|(_, row)| {
            let place_m = ridge.common_m(&second[*row])?;
            Some((ridge.at(&place_m)?, second[*row].at(&place_m)?))
        });
        let held = pair.as_ref().map_or_else(Vec::new, |(a, b)| across(a, b, options.max_sigma_m));
        if held.is_empty() {
            rejection = rejection.or(Some(NotTied::NoneFound));
        }
        let (own, other) = pair.map_or_else(|| (ridge.edge.clone(), None), |(a, b)| (a, Some(b)));
        RidgeTie { first: own, second: other, held, rejection }
    };
    let mut ties: Vec<RidgeTie> = first.iter().enumerate().map(tie).collect();
    agree(&mut ties, options);
    ties
}

/// Directions across two edges and the sigmas of their difference: eigenvectors of the sum of the covariances there. Worse known ones are
/// left out.
fn across(a: &Edge, b: &Edge, max_sigma_m: f64) -> Vec<(Vector3<f64>, f64)> {
    let turned = if a.direction.dot(&b.direction) < 0.0 { -b.direction } else { b.direction };
    let along = (a.direction + turned).normalize();
    let helper = if along.z.abs() < 0.7 { Vector3::z() } else { Vector3::x() };
    let u = along.cross(&helper).normalize();
    let v = along.cross(&u);
    let sum: Matrix3<f64> = a.covariance_m2 + b.covariance_m2;
    let plane = Matrix2::new(u.dot(&(sum * u)), u.dot(&(sum * v)), v.dot(&(sum * u)), v.dot(&(sum * v)));
    let eigen = SymmetricEigen::new(plane);
    let mut held: Vec<(Vector3<f64>, f64)> = (0..2)
        .map(|k| {
            let e: Vector2<f64> = eigen.eigenvectors.column(k).into_owned();
            (u * e.x + v * e.y, eigen.eigenvalues[k].max(0.0).sqrt())
        })
        .filter(|(_, sigma)| *sigma > 0.0 && *sigma <= max_sigma_m)
        .collect();
    held.sort_by(|a, b| a.1.total_cmp(&b.1));
    held
}

/// Rejects ties that disagree with what the others about them say together. Ridges of one house share their error: they are no judges.
fn agree(ties: &mut [RidgeTie], options: &CornerOptions) {
    let said = |t: &RidgeTie| {
        let shift_m = t.difference_m().filter(|_| t.rejection.is_none())?;
        Some(Said { place_m: [t.first.point_m.x, t.first.point_m.y], shift_m, held: t.held.clone() })
    };
    let said: Vec<Option<Said>> = ties.iter().map(said).collect();
    let hood = Neighbourhood { from_m: options.face.reach_m, to_m: options.neighbourhood_m, drift_m: options.drift_m };
    for (tie, reason) in ties.iter_mut().zip(judge(&said, &hood)) {
        if let Some(reason) = reason {
            tie.rejection = Some(match reason {
                Disagreement::Neighbours => NotTied::Neighbours,
                Disagreement::Alone => NotTied::Alone,
            });
        }
    }
}
