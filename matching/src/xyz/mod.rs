//! XYZ points: ties that hold two or three directions at one place, found without a person and without training.
//!
//! [`register`] ties two submaps, or two strips, by all the small surfaces that they share. The derivations are in `docs/xyz.md`.

mod facet;
mod held;
mod normal_equations;
mod slab;
mod submap;
mod voxels;

pub use facet::Facet;
pub use held::Held;
pub use submap::{Cloud, NotRegistered, Registration, SubmapOptions, register};
