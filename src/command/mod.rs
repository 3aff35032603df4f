//! The commands: each takes its arguments and prints its result.

pub mod project;
