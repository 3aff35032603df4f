//! Texture on pavement: spots that the intensity of two sightings shows alike, tied in three directions.
//!
//! Top down: points near the vehicle are kept by tile while they are read ([`PointKeeper`], [`TexturePoints`]); [`find_spots`] rasterises
//! each tile for each sighting, finds places whose brightness varies in two directions, correlates them with the other sightings, and lets
//! neighbours judge them ([`judge`]). Every spot that was looked at keeps what became of it. The derivations are in `docs/xyz.md`.

mod brightness;
mod correlate;
mod ground;
mod judge;
mod keep;
mod matching;
mod plan;
mod raster;
mod refine;
mod sampling;
mod spot;
mod tie;
mod view;

pub use brightness::Brightness;
pub use judge::{JudgeOptions, judge};
pub use keep::{PointKeeper, TILE_M, TexturePoint, TexturePoints};
pub use spot::find_spots;
pub use tie::{Picture, SpotEnd, SpotRejection, SpotTie};

/// How spots are found and matched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureOptions {
    /// Edge of the window that is compared \[m\].
    pub window_m: f64,
    /// Least distance between two spots \[m\]: windows that share edges share errors.
    pub spacing_m: f64,
    /// Fewest points of a sighting in a square metre.
    pub least_density_m2: f64,
    /// Narrowest and widest smoothing of the raster, one sigma \[m\]; within them it follows the density.
    pub smoothing_m: [f64; 2],
    /// Least correlation of a match.
    pub least_correlation: f64,
    /// A second peak, or the window's likeness to its own surroundings, above this share of the peak is an ambiguity.
    pub most_alike: f64,
    /// A peak nearer to another than this is of the same hill, whose width the covariance has \[m\].
    pub rival_m: f64,
    /// Reach of the look for repetition about a spot \[m\].
    pub repetition_m: f64,
    /// Largest standard deviation of a tie that holds both directions of the plane, in either \[m\].
    pub most_sigma_m: f64,
    /// Largest standard deviation of a tie that holds one, in it \[m\].
    pub most_line_sigma_m: f64,
    /// What heights of one sighting have in common beyond their points' noise \[m\].
    pub height_floor_m: f64,
}

impl Default for TextureOptions {
    fn default() -> Self {
        Self {
            window_m: 1.5,
            spacing_m: 1.5,
            least_density_m2: 40.0,
            smoothing_m: [0.03, 0.06],
            least_correlation: 0.7,
            most_alike: 0.8,
            rival_m: 0.25,
            repetition_m: 1.3,
            most_sigma_m: 0.014,
            most_line_sigma_m: 0.008,
            height_floor_m: 0.0003,
        }
    }
}
