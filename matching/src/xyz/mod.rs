//! XYZ points: ties that hold two or three directions at one place, found without a person and without training.
//!
//! [`register`] ties two submaps, or two strips, by all the small surfaces that they share; [`corners`] finds where three
//! planes meet, [`match_corners`] ties them between two sightings, [`ridges`] and [`match_ridges`] do so with edges of two planes; [`texture`] ties spots of pavement by their brightness.
//! [`XyzPoint`] is what drives make of all of them. The derivations are in `docs/xyz.md`.

mod agreement;
mod corner;
mod corner_match;
mod cylinder;
mod face;
mod facet;
mod feature;
mod held;
mod keep;
mod normal_equations;
mod pairs;
mod point;
mod pole;
mod pole_match;
mod post_points;
mod ridge;
mod slab;
mod spill;
mod street_corner;
mod street_match;
mod submap;
mod submap_ties;
pub mod texture;
mod voxels;

pub use corner::{Corner, Edge};
pub use corner_match::{CornerOptions, CornerTie, NotTied, corners, match_corners};
pub use face::{Face, FaceOptions, faces};
pub use facet::Facet;
pub use feature::{AgreeOptions, FeatureTie, agree};
pub use held::Held;
pub use keep::{TileChoice, TileKeeper, TilePoint, TilePoints};
pub use normal_equations::Carrier;
pub use point::{XyzEnd, XyzKind, XyzPoint, held_beside};
pub use pole::{Pole, PoleOptions, poles};
pub use pole_match::match_poles;
pub use post_points::{PostKeeper, PostPoint, PostPoints};
pub use ridge::{Ridge, RidgeTie, match_ridges, ridges};
pub use spill::Tile;
pub use street_corner::{StreetCorner, StreetCornerOptions, street_corners};
pub use street_match::match_street_corners;
pub use submap::{Cloud, NotRegistered, Registration, SubmapOptions, register};
pub use submap_ties::{SubmapRejection, SubmapTie, TileOptions, judge_submaps, tie_submap, tie_submaps};
