//! Cells of two clouds, and the facets in them.
//!
//! The moving cloud is put into the cells of the fixed one anew for every estimate of its place: at the end both are
//! cut by the same faces, and what a face does to the one it does to the other.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use nalgebra::{Isometry3, Vector3};
use rayon::prelude::*;

use super::facet::{Facet, FacetLimits};
use super::submap::{Cloud, NotRegistered};
use crate::moments::{Moments, STEPS_PER_METRE, TICKS_PER_SECOND};

/// Points that one task sums. Sums are whole numbers: their order does not matter.
const POINTS_PER_TASK: usize = 32_768;
/// Planes are tried over up to 2^`LEVELS` cells.
const LEVELS: u32 = 3;

/// Indices of a cell: columns x and y, layer.
type Place = [i32; 3];

/// Cells of one width about a common corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Grid {
    /// Corner of cell 0 0 0 \[m\].
    pub(crate) corner_m: Vector3<f64>,
    /// Width of the smallest cells \[m\], a whole number of steps.
    pub(crate) width_m: f64,
    /// Number of cells along each axis: what lies beyond the fixed cloud meets nothing.
    pub(crate) cells: [i32; 3],
}

/// Mixes the bits of a place: indices are small numbers, and the table wants them spread.
#[derive(Default)]
struct PlaceHasher(u64);

impl Hasher for PlaceHasher {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u64(u64::from(*byte));
        }
    }
    fn write_u64(&mut self, word: u64) {
        self.0 = (self.0.rotate_left(5) ^ word).wrapping_mul(0x517c_c1b7_2722_0a95);
    }
}

/// The number of a cell: below a million along each axis, so that numbers are in order of places.
#[allow(clippy::cast_sign_loss)]
fn number(place: &Place) -> u64 {
    place.iter().fold(0, |number, i| (number << 20) | u64::from(*i as u32))
}

/// One cell of one cloud.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Voxel {
    place: Place,
    moments: Moments,
}

impl Grid {
    /// Cells about the fixed cloud, of the width given or of the smallest of `widths_m` in which the median point of
    /// the sparser cloud has `wanted` points about it.
    pub(crate) fn about(
        fixed: &Cloud<'_>,
        moving: &Cloud<'_>,
        given_m: Option<f64>,
        widths_m: &[f64],
        wanted: i64,
        most_cells: f64,
    ) -> Result<Self, NotRegistered> {
        let finite = || fixed.points_m.iter().filter(|p| p.iter().all(|v| v.is_finite()));
        let low = finite().copied().reduce(|a, b| a.inf(&b)).ok_or(NotRegistered::NoPoints)?;
        let extent = finite().copied().reduce(|a, b| a.sup(&b)).ok_or(NotRegistered::NoPoints)? - low;
        let of = |width_m: f64| Self::over(&low, &(low + extent), width_m, most_cells);
        if let Some(width_m) = given_m {
            return of(width_m);
        }
        let sparser = if fixed.points_m.len() < moving.points_m.len() { fixed } else { moving };
        let mut grid = Err(NotRegistered::NoPoints);
        let mut cells: Vec<(Place, i64)> = Vec::new();
        for (tried, width_m) in widths_m.iter().enumerate() {
            grid = of(*width_m);
            let Ok(found) = &grid else { continue };
            // every width is twice the one before: cells are summed, points are read once
            cells = if cells.is_empty() { found.counts(sparser) } else { halved(&cells) };
            debug_assert!(tried == 0 || (width_m / widths_m[tried - 1] - 2.0).abs() < 1e-12);
            if median(&cells) >= wanted {
                break;
            }
        }
        grid
    }

    fn over(low: &Vector3<f64>, high: &Vector3<f64>, width_m: f64, most_cells: f64) -> Result<Self, NotRegistered> {
        // whole steps, so that moments can be counted from a neighbour's corner
        let width_m = (width_m * STEPS_PER_METRE).round().max(1.0) / STEPS_PER_METRE;
        let extent_m = (high - low).max();
        if extent_m / width_m + 2.0 >= most_cells {
            return Err(NotRegistered::TooWide { extent_m, cell_m: width_m });
        }
        // corners at whole widths: a cloud moved by some cells has the same ones
        let corner_m = low.map(|v| (v / width_m).floor() * width_m);
        #[allow(clippy::cast_possible_truncation)]
        let cells = ((high - corner_m) / width_m).map(|v| v.floor() as i32 + 1).into();
        Ok(Self { corner_m, width_m, cells })
    }

    /// The same space in cells that are wider by the least power of two that makes them `least_m` wide.
    pub(crate) fn widened(&self, least_m: f64) -> Self {
        let mut wide = *self;
        while wide.width_m < least_m {
            wide.width_m *= 2.0;
            wide.cells = wide.cells.map(|n| n / 2 + 1);
        }
        wide
    }

    /// Points in each cell, counted from zero of the frame.
    #[allow(clippy::cast_possible_truncation)]
    fn counts(&self, cloud: &Cloud<'_>) -> Vec<(Place, i64)> {
        let finite = cloud.points_m.par_iter().filter(|p| p.iter().all(|v| v.is_finite()));
        let mut places: Vec<Place> = finite.map(|p| p.map(|v| (v / self.width_m).floor() as i32).into()).collect();
        places.par_sort_unstable();
        #[allow(clippy::cast_possible_wrap)]
        places.chunk_by(|a, b| a == b).map(|of| (of[0], of.len() as i64)).collect()
    }

    /// The cells of a cloud after a motion, in order of their places. Points that are not numbers are left out.
    pub(crate) fn voxels(&self, cloud: &Cloud<'_>, motion: &Isometry3<f64>, first_s: f64) -> Vec<Voxel> {
        let parts: Vec<HashMap<u64, (Place, Moments), BuildHasherDefault<PlaceHasher>>> = cloud
            .points_m
            .par_chunks(POINTS_PER_TASK)
            .zip(cloud.time_s.par_chunks(POINTS_PER_TASK))
            .map(|(points_m, time_s)| self.sum(points_m, time_s, motion, first_s))
            .collect();
        let found: Vec<Voxel> =
            parts.into_iter().flatten().map(|(_, (place, moments))| Voxel { place, moments }).collect();
        // moments are wide: their numbers are sorted, not they
        let mut order: Vec<(u64, usize)> = found.iter().enumerate().map(|(k, v)| (number(&v.place), k)).collect();
        order.par_sort_unstable();
        let of_place = |same: &[(u64, usize)]| {
            let mut voxel = found[same[0].1];
            same[1..].iter().for_each(|(_, k)| voxel.moments.merge(&found[*k].moments));
            voxel
        };
        order.chunk_by(|a, b| a.0 == b.0).map(of_place).collect()
    }

    #[allow(clippy::cast_possible_truncation)]
    fn sum(
        &self,
        points_m: &[Vector3<f64>],
        time_s: &[f64],
        motion: &Isometry3<f64>,
        first_s: f64,
    ) -> HashMap<u64, (Place, Moments), BuildHasherDefault<PlaceHasher>> {
        let rotation = motion.rotation.to_rotation_matrix();
        let mut cells: HashMap<u64, (Place, Moments), BuildHasherDefault<PlaceHasher>> = HashMap::default();
        for (point, time) in points_m.iter().zip(time_s) {
            let moved = rotation * point + motion.translation.vector - self.corner_m;
            if !moved.iter().all(|v| v.is_finite()) {
                continue;
            }
            let place: Place = moved.map(|v| (v / self.width_m).floor() as i32).into();
            if place.iter().zip(self.cells).any(|(i, n)| !(0..n).contains(i)) {
                continue;
            }
            let inside = |k: usize| ((moved[k] - f64::from(place[k]) * self.width_m) * STEPS_PER_METRE).round() as i64;
            let cell = cells.entry(number(&place)).or_insert_with(|| (place, Moments::default()));
            cell.1.add([inside(0), inside(1), inside(2)], ((time - first_s) * TICKS_PER_SECOND).round() as i64, 0);
        }
        cells
    }

    /// The facets that two lists of cells share, in a fixed order.
    ///
    /// Layers of a column without a gap are joined first, so that a roof on the face between two layers is not cut in
    /// two. Columns are tried eight by eight, four by four, two by two and singly, and of one plane and its parts the ones
    /// that say more are kept: the sum of 1/σ² decides.
    pub(crate) fn facets<'a>(&self, fixed: &'a [Voxel], moving: &'a [Voxel], limits: &FacetLimits) -> Vec<Facet> {
        let of = |cloud: usize| move |v: &'a Voxel| Piece { place: v.place, cloud, moments: &v.moments };
        let mut pieces: Vec<Piece<'_>> = fixed.iter().map(of(0)).chain(moving.iter().map(of(1))).collect();
        pieces.par_sort_unstable_by_key(|p| p.rank(LEVELS));
        let nodes: Vec<&[Piece<'_>]> = pieces.chunk_by(|a, b| node(a, LEVELS) == node(b, LEVELS)).collect();
        let found: Vec<Vec<Facet>> =
            nodes.into_par_iter().with_min_len(16).map(|n| self.of_node(n, LEVELS, limits)).collect();
        found.into_iter().flatten().collect()
    }

    /// The facets of a node's pieces, which are in order of their layers.
    fn of_node(&self, pieces: &[Piece<'_>], level: u32, limits: &FacetLimits) -> Vec<Facet> {
        let mut facets = Vec::new();
        for stack in stacks(pieces) {
            if !both_have(stack, limits.min_points) {
                continue;
            }
            let whole = self.facet(stack, 1 << level, limits);
            let parts = if level == 0 { Vec::new() } else { self.of_parts(stack, level - 1, limits) };
            let say = |facets: &[Facet]| facets.iter().map(|f| f.sigma_m.powi(-2)).sum::<f64>();
            match whole {
                Some(facet) if facet.sigma_m.powi(-2) >= say(&parts) => facets.push(facet),
                None if level == 0 => facets.extend(self.of_layers(stack, limits)),
                _ => facets.extend(parts),
            }
        }
        facets
    }

    fn of_parts(&self, stack: &[Piece<'_>], level: u32, limits: &FacetLimits) -> Vec<Facet> {
        let mut parts = stack.to_vec();
        parts.sort_unstable_by_key(|p| p.rank(level));
        let nodes = parts.chunk_by(|a, b| node(a, level) == node(b, level));
        nodes.flat_map(|n| self.of_node(n, level, limits)).collect()
    }

    /// The layers of a single column that is no plane as a whole.
    fn of_layers(&self, stack: &[Piece<'_>], limits: &FacetLimits) -> Vec<Facet> {
        let layers = stack.chunk_by(|a, b| a.place[2] == b.place[2]);
        layers.filter_map(|l| self.facet(l, 1, limits).filter(|f| self.is_whole(f, l[0].place[2]))).collect()
    }

    /// The facet of some pieces, whose layers and columns lie next to each other.
    fn facet(&self, pieces: &[Piece<'_>], cells: i32, limits: &FacetLimits) -> Option<Facet> {
        let first = pieces.iter().map(|p| p.place).reduce(|a, b| std::array::from_fn(|k| a[k].min(b[k])))?;
        let mut sums = [Moments::default(); 2];
        for piece in pieces {
            let d = std::array::from_fn(|k| self.steps(piece.place[k] - first[k]));
            sums[piece.cloud].merge(&piece.moments.shifted(d, 0));
        }
        let corner_m = self.corner_m + Vector3::from(first.map(f64::from)) * self.width_m;
        Facet::of([&sums[0], &sums[1]], &corner_m, f64::from(cells) * self.width_m, limits)
    }

    /// Width of some cells in steps; widths are powers of two of a step.
    #[allow(clippy::cast_possible_truncation)]
    fn steps(&self, cells: i32) -> i64 {
        i64::from(cells) * (self.width_m * STEPS_PER_METRE).round() as i64
    }

    /// Whether a plane in one layer is not cut off by the layer's floor or ceiling along which it runs.
    fn is_whole(&self, facet: &Facet, layer: i32) -> bool {
        let floor_m = self.corner_m.z + f64::from(layer) * self.width_m;
        let above_m = facet.centre_m.z - floor_m;
        let clear_m = above_m.min(self.width_m - above_m);
        // half the rise of a plane across the cell, and room for its noise
        let slope = (1.0 - facet.normal.z.powi(2)).max(0.0).sqrt() / facet.normal.z.abs().max(1e-3);
        slope > 1.0 || clear_m > 0.5 * slope * self.width_m + 0.1 * self.width_m
    }
}

/// Cells twice as wide.
fn halved(cells: &[(Place, i64)]) -> Vec<(Place, i64)> {
    let mut wider: Vec<(Place, i64)> = cells.iter().map(|(place, count)| (place.map(|i| i >> 1), *count)).collect();
    wider.sort_unstable();
    let sum = |of: &[(Place, i64)]| (of[0].0, of.iter().map(|(_, count)| count).sum());
    wider.chunk_by(|a, b| a.0 == b.0).map(sum).collect()
}

/// Points in the cell of the median point.
fn median(cells: &[(Place, i64)]) -> i64 {
    let mut counts: Vec<i64> = cells.iter().map(|(_, count)| *count).collect();
    counts.sort_unstable();
    let total: i64 = counts.iter().sum();
    let mut below = 0;
    let mut up_to = |n: &i64| {
        below += n;
        2 * below >= total
    };
    counts.iter().copied().find(|n| up_to(n)).unwrap_or(0)
}

/// A cell of one of two clouds.
#[derive(Debug, Clone, Copy)]
struct Piece<'a> {
    place: Place,
    cloud: usize,
    moments: &'a Moments,
}

impl Piece<'_> {
    /// In order of the nodes of a level, of layers within them, of columns and clouds: 2 (20 - level) + 20 + 2 level + 1 bits.
    #[allow(clippy::cast_sign_loss)]
    fn rank(&self, level: u32) -> u64 {
        let [x, y, layer] = self.place.map(|i| u64::from(i as u32));
        let (high, low) = (|i: u64| i >> level, |i: u64| i & ((1 << level) - 1));
        let node = (high(x) << (20 - level)) | high(y);
        let column = (low(x) << level) | low(y);
        (((((node << 20) | layer) << (2 * level)) | column) << 1) | self.cloud as u64
    }
}

/// The node of a piece: its column, or the square of columns about it.
fn node(piece: &Piece<'_>, level: u32) -> [i32; 2] {
    [piece.place[0] >> level, piece.place[1] >> level]
}

fn both_have(pieces: &[Piece<'_>], points: i64) -> bool {
    let of = |cloud: usize| pieces.iter().filter(|p| p.cloud == cloud).map(|p| p.moments.n).sum::<i64>();
    of(0) >= points && of(1) >= points
}

/// Pieces in order of their layers, cut where a layer is empty.
fn stacks<'a, 'b>(pieces: &'b [Piece<'a>]) -> impl Iterator<Item = &'b [Piece<'a>]> {
    pieces.chunk_by(|a, b| b.place[2] - a.place[2] <= 1)
}
