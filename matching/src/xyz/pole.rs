//! Poles and trunks: upright cylinders among points that stand free, each with its axis, radius and their covariance.
//!
//! A point p at height z lies `v = |q| - r` off the surface, `q = p_xy - c - t (z - z0)` being its way from the axis. With q̂ = q/|q|: ∂v/∂c = -q̂, ∂v/∂t = -q̂ (z - z0), ∂v/∂r = -1. From one side only an arc is
//! seen: how far the axis lies behind it goes with the radius, and the covariance says so.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};
use rayon::prelude::*;

use super::post_points::{PostPoint, PostPoints, TILE_M};
use super::spill::{Tile, corner_m};
use crate::block::SourceKey;

/// How poles are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoleOptions {
    /// All points of a pole lie so near to its axis \[m\].
    pub within_m: f64,
    /// About it nothing lies nearer than this \[m\]: it stands free.
    pub free_m: f64,
    /// Height of a slice \[m\]; what stands is seen in many.
    pub slice_m: f64,
    /// Fewest slices in which it is seen and stands free.
    pub fewest_slices: u32,
    /// Fewest points.
    pub fewest_points: usize,
    /// Least and largest radius \[m\].
    pub radius_m: [f64; 2],
    /// Largest standard deviation of the points about the cylinder \[m\].
    pub max_roughness_m: f64,
    /// A gap in time that ends a visit \[s\].
    pub visit_gap_s: f64,
}

impl Default for PoleOptions {
    fn default() -> Self {
        Self {
            within_m: 0.45,
            free_m: 0.9,
            slice_m: 0.2,
            fewest_slices: 6,
            fewest_points: 15,
            radius_m: [0.02, 0.4],
            max_roughness_m: 0.015,
            visit_gap_s: 2.0,
        }
    }
}

/// A pole as one sighting has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pole {
    /// Whose.
    pub source: SourceKey,
    /// Mean time of its points \[s\].
    pub time_s: f64,
    /// Where its axis is at the mean height of its points, local frame \[m\].
    pub point_m: Vector3<f64>,
    /// How far the axis leans east and north for each metre upwards.
    pub lean: Vector2<f64>,
    /// Radius \[m\].
    pub radius_m: f64,
    /// Covariance of east, north, lean east, lean north, radius.
    pub covariance: SMatrix<f64, 5, 5>,
    /// Unit vector in plan from the scanner to it.
    pub away: Vector2<f64>,
    /// Points.
    pub points: u32,
    /// Mean intensity.
    pub intensity: f64,
}

impl Pole {
    /// Where the axis is at a height \[m\], and the covariance of that place in plan and of the radius \[m²\].
    #[must_use]
    pub fn at(&self, height_m: f64) -> (Vector2<f64>, Matrix3<f64>) {
        let up_m = height_m - self.point_m.z;
        let mut by = SMatrix::<f64, 3, 5>::zeros();
        for k in 0..2 {
            by[(k, k)] = 1.0;
            by[(k, 2 + k)] = up_m;
        }
        by[(2, 4)] = 1.0;
        (self.point_m.xy() + self.lean * up_m, by * self.covariance * by.transpose())
    }
}

/// Tiles worked on at a time.
const BATCH: usize = 32;

/// The poles of all tiles, in fixed order.
///
/// # Errors
/// When kept points cannot be read back.
pub fn poles(kept: &PostPoints, options: &PoleOptions) -> std::io::Result<Vec<Pole>> {
    let mut found = Vec::new();
    for batch in kept.tiles().chunks(BATCH) {
        let of_batch: Vec<std::io::Result<Vec<Pole>>> =
            batch.par_iter().with_max_len(1).map(|tile| of_tile(kept, *tile, options)).collect();
        for poles in of_batch {
            found.extend(poles?);
        }
    }
    Ok(found)
}

/// A point from the corner of the tile that is worked on \[m\].
#[derive(Clone, Copy)]
struct Local {
    place_m: Vector3<f64>,
    point: PostPoint,
}

fn of_tile(kept: &PostPoints, tile: Tile, options: &PoleOptions) -> std::io::Result<Vec<Pole>> {
    let margin_m = options.free_m + options.within_m;
    let mut all: Vec<Local> = Vec::new();
    for (i, j) in (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j))) {
        let off = Vector3::new(f64::from(i) * TILE_M, f64::from(j) * TILE_M, 0.0);
        all.extend(kept.unordered((tile.0 + i, tile.1 + j))?.into_iter().filter_map(|point| {
            let place_m = Vector3::from(point.place_m.map(f64::from)) + off;
            let is_within = (0..2).all(|k| (-margin_m..TILE_M + margin_m).contains(&place_m[k]));
            is_within.then_some(Local { place_m, point })
        }));
    }
    // an order that does not depend on the threads that kept them
    let place = |p: &Local| p.place_m.map(f64::to_bits).into();
    all.sort_unstable_by(|a, b| {
        let by_time = a.point.source.cmp(&b.point.source).then(a.point.time_s.total_cmp(&b.point.time_s));
        by_time.then_with(|| <[u64; 3]>::cmp(&place(a), &place(b)))
    });
    let [east_m, north_m] = corner_m(tile, TILE_M);
    let corner_m = Vector3::new(east_m, north_m, 0.0);
    let is_one_visit = |a: &Local, b: &Local| {
        a.point.source == b.point.source && b.point.time_s - a.point.time_s <= options.visit_gap_s
    };
    let mut found = Vec::new();
    for visit in all.chunk_by(is_one_visit) {
        let poles = of_visit(visit, margin_m, options);
        let poles = poles.into_iter().filter(|p| (0..2).all(|k| (0.0..TILE_M).contains(&p.point_m[k])));
        found.extend(poles.map(|p| Pole { point_m: p.point_m + corner_m, ..p }));
    }
    Ok(found)
}

/// Edge of the squares that points are counted in \[m\].
const SQUARE_M: f64 = 0.1;
/// Slices that one square tells apart.
const SLICES: f64 = 128.0;

/// Points of a tile and its margin by squares of plan.
struct Squares {
    low_m: f64,
    columns: usize,
    /// Where the points of each square begin in `order`, and where the last end.
    starts: Vec<u32>,
    order: Vec<u32>,
    /// Slices of height in which each square holds points.
    slices: Vec<u128>,
}

impl Squares {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a tile
    fn new(points: &[Local], low_m: f64, slice: &dyn Fn(&Local) -> u32) -> Self {
        let columns = ((TILE_M - 2.0 * low_m) / SQUARE_M).ceil() as usize + 1;
        let count = columns * columns;
        let mut squares =
            Self { low_m, columns, starts: vec![0; count + 1], order: vec![0; points.len()], slices: vec![0; count] };
        let at: Vec<usize> = points.iter().map(|p| squares.index(squares.of(&p.place_m))).collect();
        for (k, point) in at.iter().zip(points) {
            squares.starts[k + 1] += 1;
            squares.slices[*k] |= 1 << slice(point);
        }
        (0..count).for_each(|k| squares.starts[k + 1] += squares.starts[k]);
        let mut next = squares.starts.clone();
        for (k, square) in (0..).zip(&at) {
            squares.order[next[*square] as usize] = k;
            next[*square] += 1;
        }
        squares
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative, bounded
    fn of(&self, place_m: &Vector3<f64>) -> [usize; 2] {
        [place_m.x, place_m.y].map(|v| (((v - self.low_m) / SQUARE_M).max(0.0) as usize).min(self.columns - 1))
    }

    fn index(&self, [x, y]: [usize; 2]) -> usize {
        x * self.columns + y
    }

    /// Squares by up to `reach` away.
    fn about(&self, [x, y]: [usize; 2], reach: usize) -> impl Iterator<Item = [usize; 2]> + use<> {
        let most = self.columns - 1;
        let ys = y.saturating_sub(reach)..=(y + reach).min(most);
        (x.saturating_sub(reach)..=(x + reach).min(most)).flat_map(move |x| ys.clone().map(move |y| [x, y]))
    }

    /// Rows of the points of a square.
    fn rows(&self, at: [usize; 2]) -> &[u32] {
        let k = self.index(at);
        &self.order[self.starts[k] as usize..self.starts[k + 1] as usize]
    }

    /// Slices and points in a square and its neighbours, none where the square is empty.
    fn score(&self, at: [usize; 2]) -> Option<(u32, usize)> {
        if self.rows(at).is_empty() {
            return None;
        }
        let (seen, count) =
            self.about(at, 1).fold((0, 0), |(seen, n), s| (seen | self.slices[self.index(s)], n + self.rows(s).len()));
        Some((seen.count_ones(), count))
    }
}

fn of_visit(points: &[Local], margin_m: f64, options: &PoleOptions) -> Vec<Pole> {
    if points.len() < options.fewest_points {
        return Vec::new();
    }
    let lowest_m = points.iter().map(|p| p.place_m.z).fold(f64::INFINITY, f64::min);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
    let slice = |p: &Local| ((p.place_m.z - lowest_m) / options.slice_m).clamp(0.0, SLICES - 1.0) as u32;
    let squares = Squares::new(points, -margin_m, &slice);
    let all = (0..squares.columns).flat_map(|x| (0..squares.columns).map(move |y| [x, y]));
    let scores: Vec<Option<(u32, usize)>> = all.clone().map(|at| squares.score(at)).collect();
    let score = |at: [usize; 2]| scores[squares.index(at)].map(|score| (score, std::cmp::Reverse(at)));
    let is_tall = |at: &[usize; 2]| scores[squares.index(*at)].is_some_and(|score| score.0 >= options.fewest_slices);
    let is_best = |at: &[usize; 2]| squares.about(*at, 2).all(|s| score(s) <= score(*at));
    let mut found = Vec::new();
    for at in all.filter(|at| is_tall(at) && is_best(at)) {
        let rows = |reach: usize| squares.about(at, reach).flat_map(|s| squares.rows(s)).map(|k| &points[*k as usize]);
        let near: Vec<&Local> = rows(14).collect();
        #[allow(clippy::cast_precision_loss)]
        let middle_m = rows(1).map(|p| p.place_m.xy()).sum::<Vector2<f64>>() / rows(1).count().max(1) as f64;
        // slices in which nothing stands about it
        let (mut own, mut other): (BTreeMap<u32, Vec<&Local>>, BTreeMap<u32, usize>) =
            (BTreeMap::new(), BTreeMap::new());
        for point in near {
            let off_m = (point.place_m.xy() - middle_m).norm();
            if off_m <= options.within_m {
                own.entry(slice(point)).or_default().push(point);
            } else if off_m <= options.free_m {
                *other.entry(slice(point)).or_default() += 1;
            }
        }
        own.retain(|slice, _| !other.contains_key(slice));
        if u32::try_from(own.len()).unwrap_or(u32::MAX) >= options.fewest_slices {
            let of_pole: Vec<&Local> = own.into_values().flatten().collect();
            found.extend(fit(&of_pole, options));
        }
    }
    found
}

/// A lean of so much is usual.
const LEAN: f64 = 0.02;
/// What radii are like before anything was measured: mean and standard deviation \[m\].
const RADIUS_M: [f64; 2] = [0.12, 0.15];
/// Points further off than so many standard deviations, and than this at least \[m\], are of something else.
const SIGMAS: f64 = 3.5;
const OFF_M: f64 = 0.012;
/// What points of a scanner have in common, and what a post is out of round \[m\].
const FLOOR_M: f64 = 0.00025;

/// The cylinder through some points; none where they are none.
#[allow(clippy::cast_precision_loss)] // counts
fn fit(points: &[&Local], options: &PoleOptions) -> Option<Pole> {
    let mut used: Vec<&Local> = points.to_vec();
    let height_m = points.iter().map(|p| p.place_m.z).sum::<f64>() / points.len().max(1) as f64;
    let azimuth = |p: &Local| (f64::from(p.point.azimuth) + 0.5) / 65_536.0 * std::f64::consts::TAU;
    let away = points.iter().map(|p| Vector2::new(azimuth(p).sin(), azimuth(p).cos())).sum::<Vector2<f64>>();
    let away = away.try_normalize(1e-6)?;
    let mut state = start(&used, &away, options);
    for round in 0..4 {
        if used.len() < options.fewest_points {
            return None;
        }
        let (normal, variance_m2) = least_squares(&used, height_m, &mut state)?;
        let limit_m = (SIGMAS * variance_m2.sqrt()).max(OFF_M);
        let kept: Vec<&Local> =
            points.iter().filter(|p| off_m(p, height_m, &state).0.abs() <= limit_m).copied().collect();
        let is_settled = kept.len() == used.len();
        if is_settled || round == 3 {
            return pole(&used, (height_m, away), &state, normal.try_inverse()?, variance_m2, options);
        }
        used = kept;
    }
    None
}

/// How far off the surface a point lies \[m\], and the unit vector from the axis to it.
fn off_m(p: &Local, height_m: f64, state: &SVector<f64, 5>) -> (f64, Vector2<f64>) {
    let up_m = p.place_m.z - height_m;
    let q = p.place_m.xy() - Vector2::new(state[0] + state[2] * up_m, state[1] + state[3] * up_m);
    let length_m = q.norm().max(1e-6);
    (length_m - state[4], q / length_m)
}

/// The circle of least algebraic distance, x² + y² = 2 c·p + k (Kåsa), or one behind the points where that is no pole.
#[allow(clippy::cast_precision_loss)]
fn start(points: &[&Local], away: &Vector2<f64>, options: &PoleOptions) -> SVector<f64, 5> {
    let mean_m = points.iter().map(|p| p.place_m.xy()).sum::<Vector2<f64>>() / points.len().max(1) as f64;
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for p in points {
        let off = p.place_m.xy() - mean_m;
        let row = Vector3::new(2.0 * off.x, 2.0 * off.y, 1.0);
        normal += row * row.transpose();
        right += row * off.norm_squared();
    }
    let circle = normal.try_inverse().map(|inverse| inverse * right).and_then(|s| {
        let radius_m = (s.z + s.xy().norm_squared()).max(0.0).sqrt();
        let is_behind = s.xy().dot(away) > 0.0;
        ((options.radius_m[0]..options.radius_m[1]).contains(&radius_m) && is_behind).then_some((s.xy(), radius_m))
    });
    let (centre, radius_m) = circle.unwrap_or((away * 0.06, 0.08));
    SVector::from([mean_m.x + centre.x, mean_m.y + centre.y, 0.0, 0.0, radius_m])
}

/// Gauss and Newton's steps to the least squares of distances; normal matrix and variance of a point.
#[allow(clippy::cast_precision_loss)]
fn least_squares(points: &[&Local], height_m: f64, state: &mut SVector<f64, 5>) -> Option<(SMatrix<f64, 5, 5>, f64)> {
    // weights of what is usual, against a point's noise
    const NOISE_M: f64 = 0.005;
    let prior = [0.0, 0.0, LEAN, LEAN, RADIUS_M[1]].map(|s: f64| if s > 0.0 { (NOISE_M / s).powi(2) } else { 0.0 });
    let mut result = None;
    for _ in 0..25 {
        let mut normal = SMatrix::<f64, 5, 5>::from_diagonal(&SVector::from(prior));
        let usual = SVector::from([0.0, 0.0, 0.0, 0.0, RADIUS_M[0]]);
        let mut right = SVector::from(prior).component_mul(&(usual - *state));
        let mut squares = 0.0;
        for p in points {
            let (v, q) = off_m(p, height_m, state);
            let up_m = p.place_m.z - height_m;
            let row = SVector::from([-q.x, -q.y, -q.x * up_m, -q.y * up_m, -1.0]);
            normal += row * row.transpose();
            right -= row * v;
            squares += v * v;
        }
        let step = normal.cholesky()?.solve(&right);
        // no further than a radius at a time
        let longest_m = step.fixed_rows::<2>(0).norm().max(step[4].abs());
        *state += step * (0.1 / longest_m.max(0.1));
        let freedom = (points.len() as f64 - 5.0).max(1.0);
        result = Some((normal, squares / freedom));
        if longest_m < 1e-6 {
            break;
        }
    }
    result.filter(|_| state.iter().all(|v| v.is_finite()))
}

#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation)]
fn pole(
    points: &[&Local],
    (height_m, away): (f64, Vector2<f64>),
    state: &SVector<f64, 5>,
    inverse: SMatrix<f64, 5, 5>,
    variance_m2: f64,
    options: &PoleOptions,
) -> Option<Pole> {
    /// Points of a pole are on its near side, by the mean cosine.
    const NEAR_SIDE: f64 = -0.4;
    /// Tilts are no poles.
    const MOST_LEAN: f64 = 0.15;
    let n = points.len() as f64;
    let lean = Vector2::new(state[2], state[3]);
    let facing = points.iter().map(|p| off_m(p, height_m, state).1.dot(&away)).sum::<f64>() / n;
    let is_pole = (options.radius_m[0]..=options.radius_m[1]).contains(&state[4])
        && variance_m2.sqrt() <= options.max_roughness_m
        && facing < NEAR_SIDE
        && lean.norm() < MOST_LEAN;
    let mut covariance = inverse * variance_m2;
    for k in [0, 1, 4] {
        covariance[(k, k)] += FLOOR_M * FLOOR_M;
    }
    let first_s = points[0].point.time_s;
    is_pole.then(|| Pole {
        source: points[0].point.source,
        time_s: first_s + points.iter().map(|p| p.point.time_s - first_s).sum::<f64>() / n,
        point_m: Vector3::new(state[0], state[1], height_m),
        lean,
        radius_m: state[4],
        covariance,
        away,
        points: points.len() as u32,
        intensity: points.iter().map(|p| f64::from(p.point.intensity)).sum::<f64>() / n,
    })
}
