//! From the cells of a tile to patches: adaptive in size, walls and stacked surfaces included.
//!
//! Cells are cubes, but a plane does not care where their faces lie. Therefore the layers of a column that follow
//! each other without a gap are joined first, so that a roof on the face between two layers is not cut in two; and
//! columns are joined into larger ones first, and split only where the larger one is not planar. What still lies
//! parallel to and close by the face of its cell is dropped: its points are cut off on one side and the plane biased.

use crate::accumulate::GridOptions;
use crate::cell::Cell;
use crate::moments::{Moments, TICKS_PER_SECOND};
use crate::patch::{Patch, Sighting};
use crate::strip::StripIndex;

/// What makes a plane a patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchOptions {
    /// Largest cell is 2^`levels` base cells wide.
    pub levels: u32,
    /// Fewest points.
    pub min_points: u32,
    /// Largest standard deviation about the plane \[m\].
    pub max_roughness_m: f64,
    /// Walls are cut into patches of so many base cells in height: over a whole façade ranges differ by metres, and what a rangefinder errs by
    /// does not change evenly with them. None: a patch is as high as its wall.
    pub wall_layers: Option<u32>,
}

#[derive(Debug, Clone, Copy)]
struct Piece {
    column: [i32; 2],
    layer: i32,
    strip: u32,
    scanner: u16,
    bin: i64,
    moments: Moments,
}

/// Narrowest spread of a patch across its long axis, over the width of its cell (a full square has 0.29).
const MIN_SPREAD: f64 = 0.1;
/// Pieces from which keys are sorted in their stead.
const MANY_PIECES: usize = 64;
/// Time bins without points that end a pass.
const PASS_GAP_BINS: i64 = 2;

/// The patches of one tile, in a fixed order. `cells` are those of [`crate::runs::TileMerge::next_tile`].
#[must_use]
#[allow(clippy::cast_precision_loss)]
pub fn patches_of_tile(cells: &[Cell], grid: &GridOptions, strips: &StripIndex, options: &PatchOptions) -> Vec<Patch> {
    let mut pieces: Vec<Piece> = cells
        .iter()
        .filter_map(|cell| {
            let mean_ticks = cell.moments.time as f64 / cell.moments.n.max(1) as f64;
            let time_s = cell.key.bin as f64 * grid.time_bin_s + mean_ticks / TICKS_PER_SECOND;
            let (strip, scanner) = strips.find(cell.key.source, time_s)?;
            let [x, y, layer] = cell.key.place.indices();
            Some(Piece { column: [x, y], layer, strip, scanner, bin: cell.key.bin, moments: cell.moments })
        })
        .collect();
    let mut split = Split { grid, options, patches: Vec::new() };
    split.children(&mut pieces, options.levels);
    split.patches
}

struct Split<'a> {
    grid: &'a GridOptions,
    options: &'a PatchOptions,
    patches: Vec<Patch>,
}

/// A plane tried in a node: the patch, when it is one.
struct Trial {
    sighting: Sighting,
    patch: Option<Patch>,
    enough_points: bool,
    layers: std::ops::Range<usize>,
}

impl Split<'_> {
    /// Works on the pieces of several nodes of one level.
    fn children(&mut self, pieces: &mut [Piece], level: u32) {
        let node = |p: &Piece| (p.column[1] >> level, p.column[0] >> level);
        let key = |p: &Piece| (node(p), p.strip, p.scanner, p.bin, p.layer, p.column);
        if pieces.len() > MANY_PIECES {
            pieces.sort_by_cached_key(key); // pieces are large: moved once
        } else {
            pieces.sort_unstable_by_key(key);
        }
        let mut start = 0;
        while start < pieces.len() {
            let key = node(&pieces[start]);
            let len = pieces[start..].iter().take_while(|p| node(p) == key).count();
            self.node(&mut pieces[start..start + len], level);
            start += len;
        }
    }

    fn node(&mut self, pieces: &mut [Piece], level: u32) {
        let trials = self.trials(pieces, level);
        let distinct = |wanted: &dyn Fn(&Trial) -> bool| {
            let mut last = None; // trials of one sighting follow each other
            trials.iter().filter(|t| wanted(t) && last.replace(t.sighting) != Some(t.sighting)).count()
        };
        let planar = distinct(&|t| t.patch.is_some());
        let dense = distinct(&|t| t.enough_points);
        if level > 0 && dense > 0 && !(planar >= 2 && 2 * planar >= dense) {
            self.children(pieces, level - 1);
            return;
        }
        for trial in trials {
            if let Some(patch) = trial.patch {
                self.take(patch, &pieces[trial.layers], level);
            } else if level == 0 && trial.layers.len() > 1 && trial.enough_points {
                let pieces = &pieces[trial.layers];
                for run in pieces.chunk_by(|a, b| a.layer == b.layer) {
                    if let Some(patch) = self.plane(run, level, trial.sighting).filter(|p| self.is_whole(p)) {
                        self.patches.push(patch);
                    }
                }
            }
        }
    }

    /// Takes the patch of a stack, or those of its parts where it is a wall that is too high.
    fn take(&mut self, patch: Patch, stack: &[Piece], level: u32) {
        /// A surface whose normal's height is less is a wall: level faces between its parts do not run along it.
        const WALL: f64 = 0.5;
        let of_layer = |p: &Piece| self.options.wall_layers.map_or(0, |n| p.layer.div_euclid(n.max(1).cast_signed()));
        let parts = stack.chunk_by(|a, b| of_layer(a) == of_layer(b));
        if patch.normal.z.abs() >= WALL || parts.clone().count() < 2 {
            self.patches.push(patch);
            return;
        }
        for part in parts {
            if let Some(patch) = self.plane(part, level, patch.sighting) {
                self.patches.push(patch);
            }
        }
    }

    /// One trial for each sighting and each stack of layers without a gap; sorts the pieces of each by layer.
    fn trials(&self, pieces: &mut [Piece], level: u32) -> Vec<Trial> {
        let mut trials = Vec::new();
        let mut start = 0;
        while start < pieces.len() {
            let first = pieces[start];
            let same = |p: &&Piece| (p.strip, p.scanner) == (first.strip, first.scanner);
            let len = pieces[start..].iter().take_while(same).count();
            let of_scanner = &mut pieces[start..start + len];
            let mut offset = start;
            let passes = of_scanner.chunk_by_mut(|a, b| b.bin - a.bin <= PASS_GAP_BINS);
            for (pass, of_pass) in passes.enumerate() {
                #[allow(clippy::cast_possible_truncation)]
                let sighting = Sighting { strip: first.strip, pass: pass as u16, scanner: first.scanner };
                of_pass.sort_unstable_by_key(|p| (p.layer, p.column, p.bin));
                for stack in of_pass.chunk_by(|a, b| b.layer - a.layer <= 1) {
                    let points: i64 = stack.iter().map(|p| p.moments.n).sum();
                    let enough_points = points >= i64::from(self.options.min_points);
                    let patch = if enough_points { self.plane(stack, level, sighting) } else { None };
                    trials.push(Trial { sighting, patch, enough_points, layers: offset..offset + stack.len() });
                    offset += stack.len();
                }
            }
            start += len;
        }
        trials
    }

    /// The plane through joined pieces, when it is a patch.
    #[allow(clippy::cast_precision_loss)]
    fn plane(&self, pieces: &[Piece], level: u32, sighting: Sighting) -> Option<Patch> {
        let corner = [0, 1].map(|k| pieces.iter().map(|p| p.column[k]).min());
        let corner = [corner[0]?, corner[1]?, pieces.iter().map(|p| p.layer).min()?];
        let bin = pieces.iter().map(|p| p.bin).min()?;
        let mut sum = Moments::default();
        for p in pieces {
            let cells = [p.column[0] - corner[0], p.column[1] - corner[1], p.layer - corner[2]];
            let d = cells.map(|c| i64::from(c) << self.grid.cell_bits);
            #[allow(clippy::cast_possible_truncation)]
            let ticks = (p.bin - bin) * (self.grid.time_bin_s * TICKS_PER_SECOND) as i64;
            sum.merge(&p.moments.shifted(d, ticks));
        }
        if sum.n < i64::from(self.options.min_points) {
            return None;
        }
        let cell_m = self.grid.cell_m();
        let patch = Patch::from_moments(
            &sum,
            corner.map(|c| f64::from(c) * cell_m),
            bin as f64 * self.grid.time_bin_s,
            sighting,
        )?;
        let width_m = cell_m * f64::from(1_u32 << level);
        let planar = patch.roughness_m <= self.options.max_roughness_m
            && patch.roughness_m < 0.25 * patch.spread_m[1]
            && patch.spread_m[1] >= MIN_SPREAD * width_m;
        planar.then_some(patch)
    }

    /// Whether a patch of a single cell is not cut off by a face of the cell that runs along it.
    fn is_whole(&self, patch: &Patch) -> bool {
        let cell_m = self.grid.cell_m();
        (0..3).all(|k| {
            let along = patch.normal[k].abs();
            let in_cell = patch.centroid_m[k].rem_euclid(cell_m);
            let to_face_m = in_cell.min(cell_m - in_cell) * along;
            along < 0.8 || to_face_m > 4.0 * patch.roughness_m + 0.02
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::{PointFilter, ScannerField, SourceKey, SourceRule};
    use crate::cell::{CellKey, Place};
    use crate::sketch::{SightingRun, Sketches};
    use crate::strip::StripOptions;

    /// Cells of 0.25 m of a wall that stands at x = 0.1 m, 0.25 m wide and 6 m high, with a step of 2 mm to and fro.
    fn wall(source: SourceKey) -> Vec<Cell> {
        (0..24_i32)
            .map(|layer| {
                let mut moments = Moments::default();
                for k in 0..40_i64 {
                    let step = if k % 2 == 0 { 33 } else { -33 };
                    moments.add([1_638 + step, (k % 8) * 500, (k / 8) * 800], k, 9);
                }
                let place = Place::new(0, 0, i64::from(layer)).expect("inside");
                Cell { key: CellKey { place, source, bin: 0 }, moments }
            })
            .collect()
    }

    #[test]
    fn a_high_wall_is_cut_where_it_is_asked_for() {
        let source = SourceKey::new(0, 0, 0);
        let mut sketches = Sketches::default();
        [0.0, 0.4].iter().for_each(|time_s| sketches.see(&SightingRun::new(source, *time_s)));
        let strips = StripIndex::new(&sketches.into_sorted(), StripOptions::default(), |_, _, _| String::from("1"));
        let grid = GridOptions {
            origin_m: [0.0; 3],
            cell_bits: 12,
            time_bin_s: 0.5,
            cells_in_memory: 1_000,
            filter: PointFilter::default(),
            rule: SourceRule { by_file: false, by_point_source_id: false, scanner: ScannerField::Single },
        };
        let heights_m = |wall_layers| -> Vec<f64> {
            let options = PatchOptions { levels: 0, min_points: 8, max_roughness_m: 0.03, wall_layers };
            let patches = patches_of_tile(&wall(source), &grid, &strips, &options);
            patches.iter().map(|p| 2.0 * p.half_extent_m()[0]).collect()
        };
        let whole = heights_m(None);
        assert!(whole.len() == 1 && (whole[0] - 6.0).abs() < 0.1, "{whole:?}");
        let cut = heights_m(Some(4));
        assert!(cut.len() == 6 && cut.iter().all(|h| (h - 1.0).abs() < 0.1), "{cut:?}");
    }
}
