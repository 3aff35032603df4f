//! Points of pavement, kept by tile while all points are read: in memory up to a bound, beyond it in unnamed temporary files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::Mutex;

use bytemuck::{Pod, Zeroable};

use super::brightness::Brightness;
use crate::block::SourceKey;

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

/// A tile by column and row.
pub(super) type Tile = (i32, i32);

/// What one thread keeps.
#[derive(Debug)]
pub struct PointKeeper {
    most: usize,
    kept: usize,
    tiles: BTreeMap<Tile, Vec<TexturePoint>>,
    file: Option<File>,
    written: u64,
    places: BTreeMap<Tile, Vec<(u64, usize)>>,
    brightness: Brightness,
}

impl PointKeeper {
    /// A keeper that holds so many points in memory.
    #[must_use]
    pub fn new(most: usize) -> Self {
        Self {
            most: most.max(1),
            kept: 0,
            tiles: BTreeMap::new(),
            file: None,
            written: 0,
            places: BTreeMap::new(),
            brightness: Brightness::default(),
        }
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
        let tile = ((place_m[0] / TILE_M).floor() as i32, (place_m[1] / TILE_M).floor() as i32);
        let corner = [f64::from(tile.0) * TILE_M, f64::from(tile.1) * TILE_M];
        self.brightness.count(source.scanner(), range_m, intensity);
        self.tiles.entry(tile).or_default().push(TexturePoint {
            time_s,
            source,
            place_m: [(place_m[0] - corner[0]) as f32, (place_m[1] - corner[1]) as f32, place_m[2] as f32],
            intensity,
            range_cm: (range_m * 100.0).clamp(0.0, 65_535.0) as u16,
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
pub struct TexturePoints {
    parts: Vec<Part>,
    brightness: Brightness,
}

#[derive(Debug)]
struct Part {
    tiles: BTreeMap<Tile, Vec<TexturePoint>>,
    file: Option<Mutex<File>>,
    places: BTreeMap<Tile, Vec<(u64, usize)>>,
}

impl TexturePoints {
    /// Puts the keepers of all threads together.
    #[must_use]
    pub fn new(keepers: Vec<PointKeeper>) -> Self {
        let mut brightness = Brightness::default();
        let part = |keeper: PointKeeper| {
            brightness.merge(&keeper.brightness);
            Part { tiles: keeper.tiles, file: keeper.file.map(Mutex::new), places: keeper.places }
        };
        let parts = keepers.into_iter().map(part).collect();
        Self { parts, brightness }
    }

    /// Counts of all points.
    #[must_use]
    pub(super) fn brightness(&self) -> &Brightness {
        &self.brightness
    }

    /// Tiles that hold points, in order.
    pub(super) fn tiles(&self) -> Vec<Tile> {
        let mut tiles: Vec<Tile> =
            self.parts.iter().flat_map(|p| p.tiles.keys().chain(p.places.keys())).copied().collect();
        tiles.sort_unstable();
        tiles.dedup();
        tiles
    }

    /// The points of a tile, in the order in which they were kept by each thread.
    ///
    /// # Errors
    /// When a temporary file cannot be read.
    pub(super) fn of_tile(&self, tile: Tile) -> io::Result<Vec<TexturePoint>> {
        let mut points = Vec::new();
        for part in &self.parts {
            for (start, count) in part.places.get(&tile).map_or(&[][..], Vec::as_slice) {
                let Some(file) = part.file.as_ref() else { break };
                let from = points.len();
                points.resize(from + count, TexturePoint::zeroed());
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
