//! XYZ points: ties that hold two or three directions at one place, found without a person and without training.
//!
//! [`register`] ties two submaps, or two strips, by all the small surfaces that they share; [`corners`] finds where three
//! planes meet, [`match_corners`] ties them between two sightings; [`texture`] ties spots of pavement by their brightness. [`XyzPoint`] is what jobs make of all of them. The derivations are in `docs/xyz.md`.

mod corner;
mod corner_match;
mod face;
mod facet;
mod held;
mod normal_equations;
mod point;
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
pub use point::{XyzEnd, XyzKind, XyzPoint, held_beside};
pub use submap::{Cloud, NotRegistered, Registration, SubmapOptions, register};
pub use submap_ties::{SubmapRejection, SubmapTie, TileOptions, tie_submaps};
