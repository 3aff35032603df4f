//! Cells of space, and the key under which the points of one source and time bin are summed in one.
//!
//! A cell is a cube whose edge is a power of two of steps, aligned with the survey's local origin. Keys sort by
//! tile (32 × 32 columns), so that a sorted run of cells can be worked on tile by tile.

use bytemuck::{Pod, Zeroable};

use crate::block::SourceKey;
use crate::moments::Moments;

/// Columns along the edge of a tile.
pub(crate) const TILE_COLUMNS: i32 = 1 << TILE_BITS;
const TILE_BITS: u32 = 5;
const HIGH_BITS: u32 = 17;
const HIGH_BIAS: i32 = 1 << (HIGH_BITS - 1);
const LAYER_BITS: u32 = 16;
const LAYER_BIAS: i32 = 1 << (LAYER_BITS - 1);

/// Where a cell lies: column and layer, packed so that cells of one tile and column sort together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Pod, Zeroable)]
#[repr(transparent)]
pub struct Place(u64);

impl Place {
    /// The place with column `ix`, `iy` and layer `iz`; `None` when it lies outside what can be packed
    /// (±2 million columns, ±32 768 layers).
    #[inline]
    #[must_use]
    #[allow(clippy::cast_sign_loss, clippy::cast_possible_truncation)] // checked against the packed width
    pub fn new(ix: i64, iy: i64, iz: i64) -> Option<Self> {
        let (xh, yh) = ((ix >> TILE_BITS) + i64::from(HIGH_BIAS), (iy >> TILE_BITS) + i64::from(HIGH_BIAS));
        let layer = iz + i64::from(LAYER_BIAS);
        let fits = |v: i64, bits: u32| (v as u64) < (1 << bits);
        if !(fits(xh, HIGH_BITS) && fits(yh, HIGH_BITS) && fits(layer, LAYER_BITS)) {
            return None;
        }
        let low = i64::from(TILE_COLUMNS - 1);
        let (xl, yl) = ((ix & low) as u64, (iy & low) as u64);
        Some(Self(
            ((yh as u64) << (HIGH_BITS + 2 * TILE_BITS + LAYER_BITS))
                | ((xh as u64) << (2 * TILE_BITS + LAYER_BITS))
                | (yl << (TILE_BITS + LAYER_BITS))
                | (xl << LAYER_BITS)
                | layer as u64,
        ))
    }

    /// Column and layer.
    #[must_use]
    #[allow(clippy::cast_possible_wrap, clippy::cast_possible_truncation)] // bit fields
    pub fn indices(self) -> [i32; 3] {
        let field = |shift: u32, bits: u32| ((self.0 >> shift) & ((1 << bits) - 1)) as i32;
        let xh = field(2 * TILE_BITS + LAYER_BITS, HIGH_BITS) - HIGH_BIAS;
        let yh = field(HIGH_BITS + 2 * TILE_BITS + LAYER_BITS, HIGH_BITS) - HIGH_BIAS;
        [
            (xh << TILE_BITS) | field(LAYER_BITS, TILE_BITS),
            (yh << TILE_BITS) | field(TILE_BITS + LAYER_BITS, TILE_BITS),
            field(0, LAYER_BITS) - LAYER_BIAS,
        ]
    }

    /// Number of the tile, which sorts before everything else in a key.
    #[must_use]
    pub fn tile(self) -> u64 {
        self.0 >> (2 * TILE_BITS + LAYER_BITS)
    }
}

/// Key of a cell: place, source and time bin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CellKey {
    /// Where.
    pub place: Place,
    /// Which source.
    pub source: SourceKey,
    /// Which time bin, see [`crate::GridOptions::time_bin_s`].
    pub bin: i64,
}

/// The sums of one cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Cell {
    /// Key.
    pub key: CellKey,
    /// Sums.
    pub moments: Moments,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_gives_back_its_indices() {
        for indices in [[0, 0, 0], [-1, -33, -7], [123_456, -1_000_000, 900]] {
            let [x, y, z] = indices.map(i64::from);
            assert_eq!(Place::new(x, y, z).expect("inside").indices(), indices);
        }
    }

    #[test]
    fn a_place_outside_the_packed_width_is_refused() {
        assert!(Place::new(1 << 40, 0, 0).is_none());
        assert!(Place::new(0, 0, 40_000).is_none());
    }

    #[test]
    fn places_of_one_tile_sort_together() {
        let a = Place::new(0, 0, 100).expect("inside");
        let b = Place::new(31, 31, -100).expect("inside");
        let c = Place::new(32, 0, 0).expect("inside");
        assert_eq!(a.tile(), b.tile());
        assert!(a < c && b < c && a.tile() != c.tile());
    }
}
