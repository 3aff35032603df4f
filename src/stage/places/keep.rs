//! Which points are kept for submaps.

use std::io;

use tieline_matching::xyz::{TileChoice, TileKeeper, TilePoint};
use tieline_matching::{CONTROL_FILE, PointBlock, is_place_held_out};

use crate::project::XyzWord;
use crate::settings::Settings;

/// Edge of a submap in the smallest cells of the survey \[cells\], and between which edges \[m\]: a house or two, some thousand points of each
/// strip. Of wider ones there are too few in a small survey to tell a drift.
const TILE_CELLS: f64 = 12.5;
const TILE_M: [f64; 2] = [25.0, 50.0];
/// Points beyond a tile's edge that may belong to it once they are put right \[m\].
const MARGIN_M: f64 = 1.0;
/// Most points that are kept, in memory and in temporary files: a gigabyte, and a thousand submaps of five strips.
const MOST_POINTS: f64 = 3.2e7;

/// Share of the tiles that `auto` takes: registering all of them takes about three times as long as all else that `match` does.
const AUTO_SHARE: f64 = 0.2;

/// The points that submaps are made of.
#[derive(Debug, Clone, Copy)]
pub struct SubmapPoints {
    /// Tiles and the share of them that is kept.
    pub choice: TileChoice,
    /// Points that one thread keeps in memory.
    most: usize,
}

impl SubmapPoints {
    /// The points to keep of a survey of so many; half the memory is for them. `None` when submaps are not asked for.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn new(settings: &Settings, points: u64, memory_bytes: u64, threads: usize) -> Option<Self> {
        if settings.is_drive || !settings.xyz.contains(&XyzWord::Submap) {
            return None;
        }
        let most = usize::try_from(memory_bytes).unwrap_or(usize::MAX) / 2 / size_of::<TilePoint>() / threads.max(1);
        Some(Self {
            choice: TileChoice {
                tile_m: (TILE_CELLS * settings.grid.cell_m()).clamp(TILE_M[0], TILE_M[1]),
                margin_m: MARGIN_M,
                share: (MOST_POINTS / points.max(1) as f64).min(if settings.xyz_auto { AUTO_SHARE } else { 1.0 }),
            },
            most: most.clamp(20_000, 50_000_000),
        })
    }

    /// What one thread keeps.
    #[must_use]
    pub fn keeper(&self) -> TileKeeper {
        TileKeeper::new(self.choice, self.most)
    }
}

/// Whether surface lines that are held out judge the solution at a place: what lies there must not be in it.
fn is_judged(place_m: [f64; 3], settings: &Settings) -> bool {
    let square_m = settings.grouping().place_m;
    settings.surface_lines && is_place_held_out([place_m[0], place_m[1]], settings.seed, settings.hold_out, square_m)
}

/// Keeps those points of a block of strips that take part.
///
/// # Errors
/// When a temporary file cannot be written.
pub fn keep(keeper: &mut TileKeeper, block: &PointBlock<'_>, settings: &Settings) -> io::Result<()> {
    if block.file >= CONTROL_FILE {
        return Ok(());
    }
    let grid = &settings.grid;
    for i in 0..block.len() {
        let time_s = block.gps_time_s[i] + block.time_shift_s;
        if !time_s.is_finite() || !grid.filter.takes(block, i) {
            continue;
        }
        let raw = [block.x[i], block.y[i], block.z[i]];
        let map_m: [f64; 3] = std::array::from_fn(|k| f64::from(raw[k]) * block.scale_m[k] + block.offset_m[k]);
        let in_area = settings.limits.area_m.is_none_or(|[west, south, east, north]| {
            (west..=east).contains(&map_m[0]) && (south..=north).contains(&map_m[1])
        });
        let place_m: [f64; 3] = std::array::from_fn(|k| map_m[k] - grid.origin_m[k]);
        if in_area && !is_judged(place_m, settings) {
            keeper.keep(place_m, time_s, grid.rule.source(block, i))?;
        }
    }
    Ok(())
}
