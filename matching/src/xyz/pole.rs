//! Poles and trunks: upright cylinders among points that stand free.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};
use rayon::prelude::*;

use super::cylinder::fit;
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
pub(super) struct Local {
    pub(super) place_m: Vector3<f64>,
    pub(super) point: PostPoint,
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
