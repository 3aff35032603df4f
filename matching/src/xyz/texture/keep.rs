//! Points of pavement, kept by tile for its texture, and the counts of their brightness.

use std::io;

use bytemuck::{Pod, Zeroable};

use super::brightness::Brightness;
use crate::block::SourceKey;
use crate::xyz::spill::{Spill, Spilled, Tile, tile_at, within_tile_m};

/// Edge of a tile \[m\].
pub const TILE_M: f64 = 16.0;

/// A point as it is kept.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TexturePoint {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Whose.
    pub source: SourceKey,
    /// East and north from the tile's south-west corner, height in the local frame \[m\].
    pub place_m: [f32; 3],
    /// Intensity.
    pub intensity: u16,
    /// Range \[cm\].
    pub range_cm: u16,
}

/// What one thread keeps.
#[derive(Debug)]
pub struct PointKeeper {
    kept: Spill<TexturePoint>,
    brightness: Brightness,
}

impl PointKeeper {
    /// A keeper that holds so many points in memory.
    #[must_use]
    pub fn new(most: usize) -> Self {
        Self { kept: Spill::new(most), brightness: Brightness::default() }
    }

    /// Keeps a point at a place of the local frame \[m\].
    ///
    /// # Errors
    /// When a temporary file cannot be written.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // tiles of a survey, ranges of metres
    pub fn keep(
        &mut self,
        place_m: [f64; 3],
        (time_s, source): (f64, SourceKey),
        range_m: f64,
        intensity: u16,
    ) -> io::Result<()> {
        self.brightness.count(source.scanner(), range_m, intensity);
        let tile = tile_at(&place_m, TILE_M);
        let place_m = within_tile_m(&place_m, tile, TILE_M);
        let range_cm = (range_m * 100.0).clamp(0.0, 65_535.0) as u16;
        self.kept.add(tile, TexturePoint { time_s, source, place_m, intensity, range_cm })
    }
}

/// What all threads kept.
#[derive(Debug)]
pub struct TexturePoints {
    kept: Spilled<TexturePoint>,
    brightness: Brightness,
}

impl TexturePoints {
    /// Puts the keepers of all threads together.
    #[must_use]
    pub fn new(keepers: Vec<PointKeeper>) -> Self {
        let mut brightness = Brightness::default();
        keepers.iter().for_each(|k| brightness.merge(&k.brightness));
        Self { kept: Spilled::new(keepers.into_iter().map(|k| k.kept)), brightness }
    }

    /// Counts of all points.
    #[must_use]
    pub(super) fn brightness(&self) -> &Brightness {
        &self.brightness
    }

    /// Tiles that hold points, in order.
    pub(super) fn tiles(&self) -> Vec<Tile> {
        self.kept.tiles()
    }

    /// The points of a tile, in the order in which they were kept by each thread.
    ///
    /// # Errors
    /// When a temporary file cannot be read.
    pub(super) fn of_tile(&self, tile: Tile) -> io::Result<Vec<TexturePoint>> {
        self.kept.of_tile(tile)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_spilled_comes_back() {
        let fill = |most: usize| {
            let mut keeper = PointKeeper::new(most);
            for k in 0..1000_u16 {
                let at = f64::from(k);
                keeper.keep([0.1 * at - 20.0, 3.0, 1.5], (at, SourceKey::new(1, 0, k % 2)), 4.0, k).expect("kept");
            }
            TexturePoints::new(vec![keeper])
        };
        let (spilled, held) = (fill(64), fill(10_000));
        assert_eq!(spilled.tiles(), held.tiles());
        assert!(held.tiles().len() > 5);
        for tile in held.tiles() {
            let (a, b) = (spilled.of_tile(tile).expect("read"), held.of_tile(tile).expect("read"));
            assert_eq!(a, b);
            assert!(a.iter().all(|p| (0.0..16.0).contains(&p.place_m[0]) && p.range_cm == 400));
        }
    }
}
