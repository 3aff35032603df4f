//! Proofs on XYZ points.

mod clouds;
mod pair;
mod strips;
mod texture;

pub(crate) use pair::registration;
pub(crate) use strips::strips;
pub(crate) use texture::{accuracy, false_ties, time};
