//! Proofs on XYZ points.

mod clouds;
mod pair;

pub(crate) use pair::registration;
