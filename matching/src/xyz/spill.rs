//! Records by tile while all points are read: in memory up to a bound, beyond it in unnamed temporary files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::Mutex;

use bytemuck::Pod;

/// A tile by column and row.
pub type Tile = (i32, i32);

/// The tile that holds a place \[m\], of tiles so wide \[m\].
#[allow(clippy::cast_possible_truncation)] // tiles of a survey
pub(super) fn tile_at(place_m: &[f64; 3], tile_m: f64) -> Tile {
    ((place_m[0] / tile_m).floor() as i32, (place_m[1] / tile_m).floor() as i32)
}

/// South-west corner of a tile \[m\].
pub(super) fn corner_m(tile: Tile, tile_m: f64) -> [f64; 2] {
    [f64::from(tile.0) * tile_m, f64::from(tile.1) * tile_m]
}

/// East and north of a place from the corner of a tile, and its height \[m\].
#[allow(clippy::cast_possible_truncation)] // metres within a tile
pub(super) fn within_tile_m(place_m: &[f64; 3], tile: Tile, tile_m: f64) -> [f32; 3] {
    let corner = corner_m(tile, tile_m);
    [(place_m[0] - corner[0]) as f32, (place_m[1] - corner[1]) as f32, place_m[2] as f32]
}

/// What one thread keeps.
#[derive(Debug)]
pub(super) struct Spill<P> {
    most: usize,
    held: usize,
    tiles: BTreeMap<Tile, Vec<P>>,
    file: Option<File>,
    written: u64,
    /// Where in the file records of a tile begin, and how many there are.
    places: BTreeMap<Tile, Vec<(u64, usize)>>,
}

impl<P: Pod> Spill<P> {
    /// Holds so many records in memory.
    pub(super) fn new(most: usize) -> Self {
        let (tiles, places) = (BTreeMap::new(), BTreeMap::new());
        Self { most: most.max(1), held: 0, tiles, file: None, written: 0, places }
    }

    /// Adds a record.
    ///
    /// # Errors
    /// When a temporary file cannot be written.
    pub(super) fn add(&mut self, tile: Tile, record: P) -> io::Result<()> {
        self.tiles.entry(tile).or_default().push(record);
        self.held += 1;
        if self.held >= self.most { self.write() } else { Ok(()) }
    }

    fn write(&mut self) -> io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(tempfile::tempfile()?),
        };
        for (tile, records) in std::mem::take(&mut self.tiles) {
            file.write_all(bytemuck::cast_slice(&records))?;
            self.places.entry(tile).or_default().push((self.written, records.len()));
            self.written += std::mem::size_of_val(records.as_slice()) as u64;
        }
        self.held = 0;
        Ok(())
    }
}

/// What all threads kept.
#[derive(Debug)]
pub(super) struct Spilled<P> {
    parts: Vec<Part<P>>,
}

#[derive(Debug)]
struct Part<P> {
    tiles: BTreeMap<Tile, Vec<P>>,
    file: Option<Mutex<File>>,
    places: BTreeMap<Tile, Vec<(u64, usize)>>,
}

impl<P: Pod> Spilled<P> {
    /// Puts together what the threads kept.
    pub(super) fn new(kept: impl IntoIterator<Item = Spill<P>>) -> Self {
        let part = |k: Spill<P>| Part { tiles: k.tiles, file: k.file.map(Mutex::new), places: k.places };
        Self { parts: kept.into_iter().map(part).collect() }
    }

    /// Tiles that hold records, in order.
    pub(super) fn tiles(&self) -> Vec<Tile> {
        let mut tiles: Vec<Tile> =
            self.parts.iter().flat_map(|p| p.tiles.keys().chain(p.places.keys())).copied().collect();
        tiles.sort_unstable();
        tiles.dedup();
        tiles
    }

    /// The records of a tile, in the order in which each thread kept them: sort them where the threads must not show.
    ///
    /// # Errors
    /// When a temporary file cannot be read.
    pub(super) fn of_tile(&self, tile: Tile) -> io::Result<Vec<P>> {
        let mut records = Vec::new();
        for part in &self.parts {
            for (start, count) in part.places.get(&tile).map_or(&[][..], Vec::as_slice) {
                let Some(file) = part.file.as_ref() else { break };
                let from = records.len();
                records.resize(from + count, P::zeroed());
                let mut file = file.lock().map_err(|_| io::Error::other("another thread failed"))?;
                file.seek(SeekFrom::Start(*start))?;
                file.read_exact(bytemuck::cast_slice_mut(&mut records[from..]))?;
            }
            records.extend_from_slice(part.tiles.get(&tile).map_or(&[], Vec::as_slice));
        }
        Ok(records)
    }
}
