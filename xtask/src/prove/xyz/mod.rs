//! Proofs on XYZ points.

mod clouds;
mod judged;
mod pair;
mod straight;
mod strips;
mod texture;

pub(crate) use pair::registration;
pub(crate) use straight::straight;
pub(crate) use strips::strips;
pub(crate) use texture::{accuracy, false_ties, time};
