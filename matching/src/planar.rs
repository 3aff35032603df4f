//! Planar patches of one spin of a multi-beam scanner.
//!
//! Such a spin is dense along its rings and sparse across them, and its density falls with the square of the range:
//! cells of one width are either too wide near the scanner or empty far from it. Patches therefore grow about points,
//! with the smallest radius whose points fill a plane in two directions. A point belongs to one patch at most.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::moments::{Moments, STEPS_PER_METRE};
use crate::patch::{Patch, Sighting};

/// What counts as a planar patch of a spin.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarOptions {
    /// Radii \[m\], tried in this order.
    pub radii_m: Vec<f64>,
    /// Fewest points.
    pub min_points: usize,
    /// Largest standard deviation of the points about the plane \[m\].
    pub max_roughness_m: f64,
    /// Least share of the points about the place that lie in the plane.
    pub min_share: f64,
    /// Least standard deviation of the points in the plane, across the longer extent, as a share of the radius.
    pub min_width: f64,
}

impl Default for PlanarOptions {
    fn default() -> Self {
        Self {
            radii_m: vec![0.6, 1.0, 1.7, 3.0],
            min_points: 12,
            max_roughness_m: 0.04,
            min_share: 0.8,
            min_width: 0.2,
        }
    }
}

/// Points further than this many robust sigmas from a plane are not of it.
const INLIER_SIGMAS: f64 = 3.0;
/// Rounds of plane and inliers.
const ROUNDS: usize = 4;
/// Least robust sigma of the points about a plane \[m\].
const LEAST_SIGMA_M: f64 = 0.005;
/// Largest roughness over the smaller spread in the plane: a plane, not a cushion.
const FLATNESS: f64 = 0.25;
/// Share of its points that a patch may lose to patches found before it.
const LEAST_LEFT: f64 = 0.5;

/// A patch in the making: its points, best first by their number.
struct Candidate {
    seed: usize,
    members: Vec<usize>,
}

/// Finds the planar patches among the points \[m\] of one scanner, which stands at the origin of their frame.
///
/// Normals point towards the scanner; the time of a patch is the mean of its points'. The result does not depend on the number of threads. Cost: about
/// n log n for points of even density.
///
/// # Panics
/// When `intensity` or `time_s` has not one value for each point.
#[must_use]
pub fn planar_patches(
    points_m: &[Vector3<f64>],
    intensity: &[u16],
    time_s: &[f64],
    sighting: Sighting,
    options: &PlanarOptions,
) -> Vec<Patch> {
    assert_eq!(points_m.len(), intensity.len(), "one intensity for each point");
    assert_eq!(points_m.len(), time_s.len(), "one time for each point");
    let mut free: Vec<usize> = (0..points_m.len()).filter(|i| points_m[*i].iter().all(|v| v.is_finite())).collect();
    let mut patches = Vec::new();
    for radius_m in &options.radii_m {
        let mut taken = vec![false; points_m.len()];
        for candidate in candidates(points_m, &free, *radius_m, options) {
            let found = candidate.members.len();
            let members: Vec<usize> = candidate.members.into_iter().filter(|i| !taken[*i]).collect();
            #[allow(clippy::cast_precision_loss)]
            let too_few = members.len() < options.min_points || (members.len() as f64) < LEAST_LEFT * found as f64;
            if too_few {
                continue;
            }
            if let Some(mut patch) = plane(points_m, Some(intensity), &members, sighting, *radius_m, options) {
                patch.time_s = mean_time_s(time_s, &members);
                members.iter().for_each(|i| taken[*i] = true);
                patches.push(patch);
            }
        }
        free.retain(|i| !taken[*i]);
    }
    patches
}

/// Mean time \[s\], as differences from the first: times are large and differ little.
#[allow(clippy::cast_precision_loss)]
fn mean_time_s(time_s: &[f64], members: &[usize]) -> f64 {
    let Some(first) = members.first().map(|i| time_s[*i]) else { return 0.0 };
    first + members.iter().map(|i| time_s[*i] - first).sum::<f64>() / members.len() as f64
}

/// Candidates of one radius, those with most points first.
fn candidates(points_m: &[Vector3<f64>], free: &[usize], radius_m: f64, options: &PlanarOptions) -> Vec<Candidate> {
    if free.len() < options.min_points {
        return Vec::new();
    }
    let coordinates: Vec<[f64; 3]> = free.iter().map(|i| points_m[*i].into()).collect();
    let Ok(tree) = ImmutableKdTree::<f64, 3>::new_from_slice(&coordinates) else { return Vec::new() };
    let mut found: Vec<Candidate> = seeds(points_m, free, radius_m)
        .into_par_iter()
        .filter_map(|seed| {
            let about: [f64; 3] = points_m[seed].into();
            let mut near: Vec<usize> = tree
                .query(&about)
                .within::<SquaredEuclidean<f64>>(radius_m * radius_m)
                .unsorted()
                .execute()
                .iter()
                .filter_map(|n| usize::try_from(n.item).ok().and_then(|i| free.get(i)).copied())
                .collect();
            near.sort_unstable();
            grow(points_m, &near, radius_m, options).map(|members| Candidate { seed, members })
        })
        .collect();
    found.sort_by_key(|c| (std::cmp::Reverse(c.members.len()), c.seed));
    found
}

/// The first point of every cube of half a radius.
#[allow(clippy::cast_possible_truncation)]
fn seeds(points_m: &[Vector3<f64>], free: &[usize], radius_m: f64) -> Vec<usize> {
    let cube = |i: usize| points_m[i].map(|v| (2.0 * v / radius_m).floor() as i64);
    let mut keyed: Vec<([i64; 3], usize)> = free.iter().map(|i| (cube(*i).into(), *i)).collect();
    keyed.sort_unstable();
    keyed.dedup_by_key(|k| k.0);
    keyed.into_iter().map(|k| k.1).collect()
}

/// The points near a place that lie in one plane, if most of them do.
#[allow(clippy::cast_precision_loss)]
fn grow(points_m: &[Vector3<f64>], near: &[usize], radius_m: f64, options: &PlanarOptions) -> Option<Vec<usize>> {
    let mut members = near.to_vec();
    for _ in 0..ROUNDS {
        if members.len() < options.min_points {
            return None;
        }
        let patch = fitted(points_m, None, &members, Sighting { strip: 0, pass: 0, scanner: 0 })?;
        let distance = |i: &usize| patch.normal.dot(&(points_m[*i] - patch.centroid_m)).abs();
        let mut distances: Vec<f64> = members.iter().map(distance).collect();
        let middle = distances.len() / 2;
        let (_, median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
        let limit = INLIER_SIGMAS * (1.4826 * *median).max(LEAST_SIGMA_M);
        let kept: Vec<usize> = near.iter().copied().filter(|i| distance(i) < limit).collect();
        let settled = kept == members;
        members = kept;
        if settled {
            break;
        }
    }
    let most = members.len() as f64 >= options.min_share * near.len() as f64;
    let sighting = Sighting { strip: 0, pass: 0, scanner: 0 };
    (most && plane(points_m, None, &members, sighting, radius_m, options).is_some()).then_some(members)
}

/// The patch of some points, when it is a plane of two dimensions.
fn plane(
    points_m: &[Vector3<f64>],
    intensity: Option<&[u16]>,
    members: &[usize],
    sighting: Sighting,
    radius_m: f64,
    options: &PlanarOptions,
) -> Option<Patch> {
    let patch = fitted(points_m, intensity, members, sighting).filter(|_| members.len() >= options.min_points)?;
    let wide = patch.spread_m[1] >= options.min_width * radius_m;
    let flat = patch.roughness_m <= (FLATNESS * patch.spread_m[1]).min(options.max_roughness_m);
    (wide && flat).then_some(patch)
}

/// Total least squares through some points, with its normal towards the origin.
#[allow(clippy::cast_possible_truncation)] // metres about the first point
fn fitted(
    points_m: &[Vector3<f64>],
    intensity: Option<&[u16]>,
    members: &[usize],
    sighting: Sighting,
) -> Option<Patch> {
    let corner = points_m[*members.first()?];
    let mut moments = Moments::default();
    for i in members {
        let steps = (points_m[*i] - corner).map(|v| (v * STEPS_PER_METRE).round() as i64);
        moments.add(steps.into(), 0, intensity.map_or(0, |values| i64::from(values[*i])));
    }
    let mut patch = Patch::from_moments(&moments, corner.into(), 0.0, sighting)?;
    if patch.normal.dot(&patch.centroid_m) > 0.0 {
        patch.normal = -patch.normal;
    }
    Some(patch)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Sighting = Sighting { strip: 1, pass: 0, scanner: 2 };

    /// Rings of a scanner 2 m above level ground, every 2° down, points every 0.5°; a step of 1 cm to and fro.
    fn ground(rings: i32) -> Vec<Vector3<f64>> {
        let mut points = Vec::new();
        for ring in 0..rings {
            let down = (12.0 + 2.0 * f64::from(ring)).to_radians();
            for k in 0..720 {
                let (sin, cos) = (0.5 * f64::from(k)).to_radians().sin_cos();
                let distance = 2.0 / down.tan();
                let step = if (k + ring) % 2 == 0 { 0.01 } else { -0.01 };
                points.push(Vector3::new(distance * cos, distance * sin, -2.0 + step));
            }
        }
        points
    }

    #[test]
    fn rings_on_the_ground_become_level_patches_that_look_up_at_the_scanner() {
        let points = ground(10);
        let patches =
            planar_patches(&points, &vec![7; points.len()], &vec![5.0; points.len()], HERE, &PlanarOptions::default());
        assert!(patches.len() > 20, "{}", patches.len());
        for patch in &patches {
            assert!(patch.normal.z > 0.999 && (patch.centroid_m.z + 2.0).abs() < 0.01, "{patch:?}");
            assert!((patch.roughness_m - 0.01).abs() < 0.002 && (patch.intensity - 7.0).abs() < 1e-6);
            assert!(patch.sighting == HERE && (patch.time_s - 5.0).abs() < 1e-12);
        }
        let members: u32 = patches.iter().map(|p| p.points).sum();
        assert!(members as usize <= points.len(), "no point twice");
    }

    #[test]
    fn one_ring_is_no_plane() {
        let points = ground(1);
        assert!(
            planar_patches(&points, &vec![0; points.len()], &vec![0.0; points.len()], HERE, &PlanarOptions::default())
                .is_empty()
        );
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let points = ground(8);
        let options = PlanarOptions::default();
        let a = planar_patches(&points, &vec![0; points.len()], &vec![0.0; points.len()], HERE, &options);
        let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        let b = threads
            .install(|| planar_patches(&points, &vec![0; points.len()], &vec![0.0; points.len()], HERE, &options));
        assert_eq!(a, b);
    }

    #[test]
    fn points_at_one_place_and_points_that_are_none_are_no_patch() {
        let mut points = vec![Vector3::new(3.0, 0.0, 0.0); 500];
        points.extend(vec![Vector3::repeat(f64::NAN); 5]);
        assert!(
            planar_patches(&points, &vec![0; points.len()], &vec![0.0; points.len()], HERE, &PlanarOptions::default())
                .is_empty()
        );
    }
}
