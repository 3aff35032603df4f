//! Points kept by tile while all points are read: in memory up to a bound, beyond it in unnamed temporary files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::Mutex;

use bytemuck::{Pod, Zeroable};

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

/// A tile by column and row.
pub(super) type Tile = (i32, i32);

/// What one thread keeps.
#[derive(Debug)]
pub struct PostKeeper {
    most: usize,
    kept: usize,
    tiles: BTreeMap<Tile, Vec<PostPoint>>,
    file: Option<File>,
    written: u64,
    places: BTreeMap<Tile, Vec<(u64, usize)>>,
}

impl PostKeeper {
    /// A keeper that holds so many points in memory.
    #[must_use]
    pub fn new(most: usize) -> Self {
        let (tiles, places) = (BTreeMap::new(), BTreeMap::new());
        Self { most: most.max(1), kept: 0, tiles, file: None, written: 0, places }
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
        let tile = ((place_m[0] / TILE_M).floor() as i32, (place_m[1] / TILE_M).floor() as i32);
        let corner = [f64::from(tile.0) * TILE_M, f64::from(tile.1) * TILE_M];
        let turn = (azimuth_rad / std::f64::consts::TAU).rem_euclid(1.0);
        self.tiles.entry(tile).or_default().push(PostPoint {
            time_s,
            source,
            place_m: [(place_m[0] - corner[0]) as f32, (place_m[1] - corner[1]) as f32, place_m[2] as f32],
            intensity,
            azimuth: (turn * 65_536.0) as u32 as u16,
        });
        self.kept += 1;
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
pub struct PostPoints {
    parts: Vec<Part>,
}

#[derive(Debug)]
struct Part {
    tiles: BTreeMap<Tile, Vec<PostPoint>>,
    file: Option<Mutex<File>>,
    places: BTreeMap<Tile, Vec<(u64, usize)>>,
}

impl PostPoints {
    /// Puts the keepers of all threads together.
    #[must_use]
    pub fn new(keepers: Vec<PostKeeper>) -> Self {
        let part = |k: PostKeeper| Part { tiles: k.tiles, file: k.file.map(Mutex::new), places: k.places };
        Self { parts: keepers.into_iter().map(part).collect() }
    }

    /// Tiles that hold points, in order.
    pub(super) fn tiles(&self) -> Vec<Tile> {
        let mut tiles: Vec<Tile> =
            self.parts.iter().flat_map(|p| p.tiles.keys().chain(p.places.keys())).copied().collect();
        tiles.sort_unstable();
        tiles.dedup();
        tiles
    }

    /// The points of a tile, in an order that may depend on the threads.
    ///
    /// # Errors
    /// When a temporary file cannot be read.
    pub(super) fn unordered(&self, tile: Tile) -> io::Result<Vec<PostPoint>> {
        let mut points = Vec::new();
        for part in &self.parts {
            for (start, count) in part.places.get(&tile).map_or(&[][..], Vec::as_slice) {
                let Some(file) = part.file.as_ref() else { break };
                let from = points.len();
                points.resize(from + count, PostPoint::zeroed());
                let mut file = file.lock().map_err(|_| io::Error::other("another thread failed"))?;
                file.seek(SeekFrom::Start(*start))?;
                file.read_exact(bytemuck::cast_slice_mut(&mut points[from..]))?;
            }
            points.extend_from_slice(part.tiles.get(&tile).map_or(&[], Vec::as_slice));
        }
        Ok(points)
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
