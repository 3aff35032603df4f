//! XYZ points: ties that hold two or three directions at one place, found without a person and without training.
//!
//! [`register`] ties two submaps, or two strips, by all the small surfaces that they share; [`corners`] finds where three
//! planes meet, [`match_corners`] ties them between two sightings, [`ridges`] and [`match_ridges`] do so with edges of two planes; [`texture`] ties spots of pavement by their brightness. The derivations are in `docs/xyz.md`.

mod agreement;
mod corner;
mod corner_match;
mod face;
mod facet;
mod held;
mod keep;
mod normal_equations;
mod ridge;
mod slab;
mod submap;
mod submap_ties;
pub mod texture;
mod voxels;

pub use corner::{Corner, Edge};
pub use corner_match::{CornerOptions, CornerTie, NotTied, corners, match_corners};
pub use face::{Face, FaceOptions, faces};
pub use facet::Facet;
pub use held::Held;
pub use keep::{Tile, TileChoice, TileKeeper, TilePoint, TilePoints};
pub use normal_equations::Carrier;
pub use ridge::{Ridge, RidgeTie, match_ridges, ridges};
pub use submap::{Cloud, NotRegistered, Registration, SubmapOptions, register};
pub use submap_ties::{SubmapRejection, SubmapTie, TileOptions, judge_submaps, tie_submap, tie_submaps};
