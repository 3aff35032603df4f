//! Corners of a street matched between sightings.

use nalgebra::{Matrix3, Vector3};

use super::corner::Corner;
use super::feature::FeatureTie;
use super::pairs::{Item, pairs};
use super::point::{XyzEnd, XyzKind};
use super::street_corner::{COMMON_M, StreetCorner, StreetCornerOptions, edge_at, order_of, worst_m};
use crate::patch::Patch;

/// Cosine of the largest angle between the normals of a wall in two sightings: 4°.
const ALIKE: f64 = 0.9976;
/// Matches corners between all sightings; `search_m` is how far two sightings of these times may lie apart \[m\], `most_search_m` its bound. Ties of one corner share its first sighting.
/// Corners without a candidate are left out; those with one have a reason where they are not tied. Neighbours have not judged them yet. Corners are put in order; of each tie
/// their rows are given as well.
#[must_use]
#[allow(clippy::cast_possible_truncation)] // corners of a survey
pub fn match_street_corners(
    corners: &mut [StreetCorner],
    search_m: &dyn Fn(f64, f64) -> f64,
    most_search_m: f64,
    options: &StreetCornerOptions,
) -> (Vec<FeatureTie>, Vec<[usize; 2]>) {
    let order = corners;
    order.sort_by(|a, b| {
        let key = |c: &StreetCorner| (c.sighting, c.layer);
        let plan = |k: usize| a.point_m[k].total_cmp(&b.point_m[k]);
        key(a).cmp(&key(b)).then(plan(0)).then(plan(1))
    });
    let item = |c: &StreetCorner| Item { sighting: c.sighting, place_m: c.point_m.xy(), time_s: time_s(c) };
    let items: Vec<Item<_>> = order.iter().map(item).collect();
    let fits = |a: usize, b: usize| order[a].layer == order[b].layer && order_of(&order[a], &order[b], ALIKE).is_some();
    let (mut ties, mut rows) = (Vec::new(), Vec::new());
    for ([first, second], rejection) in pairs(&items, search_m, most_search_m, &fits) {
        let Some((ends, free)) = ends(&order[first], &order[second], options) else { continue };
        ties.push(FeatureTie { kind: XyzKind::Corner, feature: first as u32, ends, free, rejection });
        rows.push([first, second]);
    }
    (ties, rows)
}

/// Mean time of the planes of a corner by their points \[s\].
fn time_s(corner: &StreetCorner) -> f64 {
    let planes = || corner.walls.iter().chain(&corner.ground);
    let total: f64 = planes().map(|p| f64::from(p.points)).sum();
    let first_s = corner.walls[0].time_s;
    first_s + planes().map(|p| (p.time_s - first_s) * f64::from(p.points)).sum::<f64>() / total
}

/// What both sightings have in common: three directions where both have the ground and it lies alike, else those across the edge, at one height.
fn ends(
    a: &StreetCorner,
    b: &StreetCorner,
    options: &StreetCornerOptions,
) -> Option<([XyzEnd; 2], Option<Vector3<f64>>)> {
    let of_ground = |c: &StreetCorner| {
        let corner = Corner::with_common([&c.walls[0], &c.walls[1], c.ground.as_ref()?], COMMON_M)?;
        Some((corner.point_m, corner.covariance_m2))
    };
    let level = a.ground.as_ref().zip(b.ground.as_ref()).is_some_and(|(a, b)| a.normal.dot(&b.normal) >= ALIKE);
    if level && let (Some(first), Some(second)) = (of_ground(a), of_ground(b)) {
        return Some(([end(a, first), end(b, second)], None));
    }
    let height_m = (f64::from(a.layer) + 0.5) * options.layer_m;
    let of_edge = |c: &StreetCorner| {
        edge_at(&c.walls, height_m, options.least_sine).filter(|e| worst_m(e) <= options.max_sigma_m)
    };
    let (first, second) = (of_edge(a)?, of_edge(b)?);
    let upwards = |d: Vector3<f64>| d * d.z.signum();
    let free = (upwards(first.direction) + upwards(second.direction)).normalize();
    let ends = [end(a, (first.point_m, first.covariance_m2)), end(b, (second.point_m, second.covariance_m2))];
    Some((ends, Some(free)))
}

fn end(corner: &StreetCorner, (place_m, covariance_m2): (Vector3<f64>, Matrix3<f64>)) -> XyzEnd {
    let planes: Vec<&Patch> = corner.walls.iter().chain(&corner.ground).collect();
    let points: u32 = planes.iter().map(|p| p.points).sum();
    let weighed = planes.iter().map(|p| f64::from(p.intensity) * f64::from(p.points)).sum::<f64>();
    XyzEnd {
        strip: corner.sighting.strip,
        scanner: corner.sighting.scanner,
        time_s: time_s(corner),
        place_m,
        covariance_m2,
        // neither wall alone: between them
        normal: (corner.walls[0].normal + corner.walls[1].normal).normalize(),
        points,
        intensity: weighed / f64::from(points.max(1)),
    }
}
