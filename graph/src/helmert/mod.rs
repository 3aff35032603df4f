//! Helmert blocking: the normal equations eliminated block by block up a tree of partial nets.
//!
//! Every block eliminates its own nodes and hands the reduced normal equations of its boundary to the block above
//! (Helmert 1880; Wolf 1978; in today's words a multifrontal Cholesky on a nested dissection).
//!
//! | module | holds |
//! |---|---|
//! | [`partition`] | the tree from places: bisection, separators by minimum vertex cover |
//! | [`cover`] | minimum vertex cover of a cut (Hopcroft and Karp; König) |
//! | [`elimination`] | the tree from a minimum-degree order, for graphs without places |
//! | [`tree`] | blocks, their order and boundaries |
//! | [`front`] | dense elimination of one block |
//! | [`block`] | one block: gathered, eliminated, handed up |
//! | [`factor`] | factorisation and solution in memory |
//! | [`out_of_core`] | factorisation with the panels on disk |
//! | [`inverse`] | selected inverse: covariances down the same tree |

pub mod block;
pub mod cover;
pub mod elimination;
pub mod factor;
pub mod front;
pub mod inverse;
pub mod out_of_core;
pub mod partition;
pub mod tree;
