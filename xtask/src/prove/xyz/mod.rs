//! Proofs on XYZ points.

mod clouds;
mod judged;
mod pair;
mod texture;

pub(crate) use pair::registration;
pub(crate) use texture::{accuracy, false_ties, time};
