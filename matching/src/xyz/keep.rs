//! Points kept by tile while all points are read: in memory up to a bound, beyond it in unnamed temporary files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::Mutex;

use bytemuck::{Pod, Zeroable};
use nalgebra::Vector3;

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

/// A tile by column and row.
pub type Tile = (i32, i32);

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
        [f64::from(tile.0) * self.tile_m, f64::from(tile.1) * self.tile_m]
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
    most: usize,
    kept: usize,
    tiles: BTreeMap<Tile, Vec<TilePoint>>,
    file: Option<File>,
    written: u64,
    places: BTreeMap<Tile, Vec<(u64, usize)>>,
}

impl TileKeeper {
    /// A keeper that holds so many points in memory.
    #[must_use]
    pub fn new(choice: TileChoice, most: usize) -> Self {
        Self {
            choice,
            most: most.max(1),
            kept: 0,
            tiles: BTreeMap::new(),
            file: None,
            written: 0,
            places: BTreeMap::new(),
        }
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
                if !self.choice.takes(tile) {
                    continue;
                }
                let corner = self.choice.corner_m(tile);
                let place_m = [(place_m[0] - corner[0]) as f32, (place_m[1] - corner[1]) as f32, place_m[2] as f32];
                self.tiles.entry(tile).or_default().push(TilePoint { time_s, source, place_m, unused: 0 });
                self.kept += 1;
            }
        }
        if self.kept >= self.most { self.spill() } else { Ok(()) }
    }

    fn spill(&mut self) -> io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(tempfile::tempfile()?),
        };
        for (tile, points) in std::mem::take(&mut self.tiles) {
            file.write_all(bytemuck::cast_slice(&points))?;
            self.places.entry(tile).or_default().push((self.written, points.len()));
            self.written += std::mem::size_of_val(points.as_slice()) as u64;
        }
        self.kept = 0;
        Ok(())
    }
}

/// What all threads kept.
#[derive(Debug)]
pub struct TilePoints {
    /// How wide tiles are.
    pub choice: TileChoice,
    parts: Vec<Part>,
}

#[derive(Debug)]
struct Part {
    tiles: BTreeMap<Tile, Vec<TilePoint>>,
    file: Option<Mutex<File>>,
    places: BTreeMap<Tile, Vec<(u64, usize)>>,
}

impl TilePoints {
    /// Puts the keepers of all threads together.
    #[must_use]
    pub fn new(choice: TileChoice, keepers: Vec<TileKeeper>) -> Self {
        let part = |k: TileKeeper| Part { tiles: k.tiles, file: k.file.map(Mutex::new), places: k.places };
        Self { choice, parts: keepers.into_iter().map(part).collect() }
    }

    /// Tiles that hold points, in order.
    #[must_use]
    pub fn tiles(&self) -> Vec<Tile> {
        let mut tiles: Vec<Tile> =
            self.parts.iter().flat_map(|p| p.tiles.keys().chain(p.places.keys())).copied().collect();
        tiles.sort_unstable();
        tiles.dedup();
        tiles
    }

    /// The points of a tile by source, time and place: whichever thread kept them.
    ///
    /// # Errors
    /// When a temporary file cannot be read.
    pub fn of_tile(&self, tile: Tile) -> io::Result<Vec<TilePoint>> {
        let mut points = Vec::new();
        for part in &self.parts {
            for (start, count) in part.places.get(&tile).map_or(&[][..], Vec::as_slice) {
                let Some(file) = part.file.as_ref() else { break };
                let from = points.len();
                points.resize(from + count, TilePoint::zeroed());
                let mut file = file.lock().map_err(|_| io::Error::other("another thread failed"))?;
                file.seek(SeekFrom::Start(*start))?;
                file.read_exact(bytemuck::cast_slice_mut(&mut points[from..]))?;
            }
            points.extend_from_slice(part.tiles.get(&tile).map_or(&[], Vec::as_slice));
        }
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
