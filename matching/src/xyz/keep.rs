//! Points for submaps, kept by tile with a margin; of a share of the tiles.

use std::io;

use bytemuck::{Pod, Zeroable};
use nalgebra::Vector3;

use super::spill::{Spill, Spilled, Tile, corner_m, within_tile_m};
use crate::block::SourceKey;
use crate::sketch::mix;

/// A point as it is kept.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TilePoint {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Whose.
    pub source: SourceKey,
    /// East and north from the tile's south-west corner, height in the local frame \[m\].
    place_m: [f32; 3],
    unused: u32,
}

/// Which tiles are kept, and how wide they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileChoice {
    /// Edge of a tile \[m\].
    pub tile_m: f64,
    /// Points so far beyond the edge of a tile belong to it as well \[m\].
    pub margin_m: f64,
    /// Share of all tiles that are kept, drawn by a hash of their place.
    pub share: f64,
}

impl TileChoice {
    /// Whether a tile is among those drawn.
    #[must_use]
    #[allow(clippy::cast_precision_loss, clippy::cast_sign_loss)]
    pub fn takes(&self, tile: Tile) -> bool {
        self.share >= 1.0
            || (mix(mix(i64::from(tile.0) as u64) ^ i64::from(tile.1) as u64) as f64) < self.share * u64::MAX as f64
    }

    /// South-west corner of a tile in the local frame \[m\].
    #[must_use]
    pub fn corner_m(&self, tile: Tile) -> [f64; 2] {
        corner_m(tile, self.tile_m)
    }

    /// Place of a kept point in the local frame \[m\].
    #[must_use]
    pub fn place_m(&self, tile: Tile, point: &TilePoint) -> Vector3<f64> {
        let corner = self.corner_m(tile);
        let [x, y, z] = point.place_m.map(f64::from);
        Vector3::new(corner[0] + x, corner[1] + y, z)
    }
}

/// What one thread keeps.
#[derive(Debug)]
pub struct TileKeeper {
    choice: TileChoice,
    kept: Spill<TilePoint>,
}

impl TileKeeper {
    /// A keeper that holds so many points in memory.
    #[must_use]
    pub fn new(choice: TileChoice, most: usize) -> Self {
        Self { choice, kept: Spill::new(most) }
    }

    /// Keeps a point at a place of the local frame \[m\], where its tile is drawn.
    ///
    /// # Errors
    /// When a temporary file cannot be written.
    #[allow(clippy::cast_possible_truncation)] // tiles of a survey
    pub fn keep(&mut self, place_m: [f64; 3], time_s: f64, source: SourceKey) -> io::Result<()> {
        let TileChoice { tile_m, margin_m, .. } = self.choice;
        let range = |axis: usize| {
            let at = |shift_m: f64| ((place_m[axis] + shift_m) / tile_m).floor() as i32;
            at(-margin_m)..=at(margin_m)
        };
        for column in range(0) {
            for row in range(1) {
                let tile = (column, row);
                if self.choice.takes(tile) {
                    let place_m = within_tile_m(&place_m, tile, tile_m);
                    self.kept.add(tile, TilePoint { time_s, source, place_m, unused: 0 })?;
                }
            }
        }
        Ok(())
    }
}

/// What all threads kept.
#[derive(Debug)]
pub struct TilePoints {
    /// How wide tiles are.
    pub choice: TileChoice,
    kept: Spilled<TilePoint>,
}

impl TilePoints {
    /// Puts the keepers of all threads together.
    #[must_use]
    pub fn new(choice: TileChoice, keepers: Vec<TileKeeper>) -> Self {
        Self { choice, kept: Spilled::new(keepers.into_iter().map(|k| k.kept)) }
    }

    /// Tiles that hold points, in order.
    #[must_use]
    pub fn tiles(&self) -> Vec<Tile> {
        self.kept.tiles()
    }

    /// The points of a tile by source, time and place: whichever thread kept them.
    ///
    /// # Errors
    /// When a temporary file cannot be read.
    pub fn of_tile(&self, tile: Tile) -> io::Result<Vec<TilePoint>> {
        let mut points = self.kept.of_tile(tile)?;
        points.sort_unstable_by(|a, b| {
            let places = || a.place_m.iter().zip(&b.place_m).map(|(a, b)| a.total_cmp(b));
            a.source
                .cmp(&b.source)
                .then(a.time_s.total_cmp(&b.time_s))
                .then_with(|| places().find(|o| o.is_ne()).unwrap_or(std::cmp::Ordering::Equal))
        });
        Ok(points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHOICE: TileChoice = TileChoice { tile_m: 20.0, margin_m: 1.0, share: 1.0 };

    fn filled(choice: TileChoice, most: usize, threads: usize) -> TilePoints {
        let mut keepers: Vec<TileKeeper> = (0..threads).map(|_| TileKeeper::new(choice, most)).collect();
        for k in 0..1000_u16 {
            let at = f64::from(k);
            let keeper = &mut keepers[usize::from(k) % threads];
            keeper.keep([0.1 * at - 20.0, 3.0, 1.5], at, SourceKey::new(1, 0, k % 2)).expect("kept");
        }
        TilePoints::new(choice, keepers)
    }

    #[test]
    fn what_was_spilled_comes_back_whichever_thread_kept_it() {
        let (spilled, held) = (filled(CHOICE, 64, 3), filled(CHOICE, 10_000, 1));
        assert_eq!(spilled.tiles(), held.tiles());
        assert_eq!(held.tiles().len(), 5 + 2, "the first and the last points lie in margins of further tiles");
        for tile in held.tiles() {
            let (a, b) = (spilled.of_tile(tile).expect("read"), held.of_tile(tile).expect("read"));
            assert_eq!(a, b);
            let places: Vec<Vector3<f64>> = a.iter().map(|p| CHOICE.place_m(tile, p)).collect();
            let expected = a.iter().map(|p| Vector3::new(0.1 * p.time_s - 20.0, 3.0, 1.5));
            assert!(places.iter().zip(expected).all(|(p, e)| (p - e).norm() < 1e-5));
        }
    }

    #[test]
    fn a_share_of_the_tiles_is_drawn_whole() {
        let some = TileChoice { share: 0.5, ..CHOICE };
        let (part, all) = (filled(some, 64, 2), filled(CHOICE, 64, 2));
        let expected: Vec<Tile> = all.tiles().into_iter().filter(|t| some.takes(*t)).collect();
        assert!(!expected.is_empty() && expected.len() < all.tiles().len());
        assert_eq!(part.tiles(), expected);
        for tile in expected {
            assert_eq!(part.of_tile(tile).expect("read"), all.of_tile(tile).expect("read"));
        }
        let tiles = (0..100).flat_map(|i| (0..100).map(move |j| (i, j)));
        let drawn = tiles.filter(|t| some.takes(*t)).count();
        assert!((4_700..5_300).contains(&drawn), "{drawn} of 10000");
    }
}
