//! Normal equations on the graph of nodes.
//!
//! | module | holds |
//! |---|---|
//! | [`nodes`] | nodes: variables that are eliminated together; which nodes share a factor |
//! | [`blocks`] | block normal equations: pattern once, scatter by slot |
//! | [`reference`] | sparse Cholesky of a library on the same order, as reference |

pub mod blocks;
pub mod nodes;
pub mod reference;
