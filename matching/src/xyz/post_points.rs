//! Points beside the road, kept by tile for posts and trunks.

use std::io;

use bytemuck::{Pod, Zeroable};

use super::spill::{Spill, Spilled, Tile, tile_at, within_tile_m};
use crate::block::SourceKey;

/// Edge of a tile \[m\].
pub(super) const TILE_M: f64 = 16.0;

/// A point as it is kept.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PostPoint {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Whose.
    pub source: SourceKey,
    /// East and north from the tile's south-west corner, height in the local frame \[m\].
    pub place_m: [f32; 3],
    /// Intensity.
    pub intensity: u16,
    /// Where the beam led in plan, clockwise from north, in 65 536ths of a turn.
    pub azimuth: u16,
}

/// What one thread keeps.
#[derive(Debug)]
pub struct PostKeeper {
    kept: Spill<PostPoint>,
}

impl PostKeeper {
    /// A keeper that holds so many points in memory.
    #[must_use]
    pub fn new(most: usize) -> Self {
        Self { kept: Spill::new(most) }
    }

    /// Keeps a point at a place of the local frame \[m\]; `azimuth_rad` is where its beam led in plan, clockwise from north.
    ///
    /// # Errors
    /// When a temporary file cannot be written.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // tiles of a survey, a turn in 16 bits
    pub fn keep(
        &mut self,
        place_m: [f64; 3],
        (time_s, source): (f64, SourceKey),
        azimuth_rad: f64,
        intensity: u16,
    ) -> io::Result<()> {
        let tile = tile_at(&place_m, TILE_M);
        let turn = (azimuth_rad / std::f64::consts::TAU).rem_euclid(1.0);
        let azimuth = (turn * 65_536.0) as u32 as u16;
        let place_m = within_tile_m(&place_m, tile, TILE_M);
        self.kept.add(tile, PostPoint { time_s, source, place_m, intensity, azimuth })
    }
}

/// What all threads kept.
#[derive(Debug)]
pub struct PostPoints {
    kept: Spilled<PostPoint>,
}

impl PostPoints {
    /// Puts the keepers of all threads together.
    #[must_use]
    pub fn new(keepers: Vec<PostKeeper>) -> Self {
        Self { kept: Spilled::new(keepers.into_iter().map(|k| k.kept)) }
    }

    /// Tiles that hold points, in order.
    pub(super) fn tiles(&self) -> Vec<Tile> {
        self.kept.tiles()
    }

    /// The points of a tile, in an order that may depend on the threads.
    ///
    /// # Errors
    /// When a temporary file cannot be read.
    pub(super) fn unordered(&self, tile: Tile) -> io::Result<Vec<PostPoint>> {
        self.kept.of_tile(tile)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_spilled_comes_back() {
        let fill = |most: usize, of: [u16; 2]| {
            let mut keepers = [PostKeeper::new(most), PostKeeper::new(most)];
            for k in 0..1000_u16 {
                let at = f64::from(k);
                let keeper = &mut keepers[usize::from(of[usize::from(k % 2)])];
                let whose = (at, SourceKey::new(1, 0, k % 3));
                keeper.keep([0.1 * at - 20.0, 3.0, 1.5], whose, -0.01 * at, k).expect("kept");
            }
            PostPoints::new(keepers.into())
        };
        let (spilled, held) = (fill(64, [0, 1]), fill(10_000, [1, 0]));
        assert_eq!(spilled.tiles(), held.tiles());
        assert!(held.tiles().len() > 5);
        for tile in held.tiles() {
            let sorted = |points: &PostPoints| {
                let mut points = points.unordered(tile).expect("read");
                points.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
                points
            };
            assert_eq!(sorted(&spilled), sorted(&held));
            assert!(!sorted(&held).is_empty());
        }
    }
}
