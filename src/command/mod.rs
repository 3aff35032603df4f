//! The commands: each takes its arguments and prints its result.

pub mod calibrate;
pub mod convert;
pub mod difference;
pub mod drive;
pub mod graph;
pub mod info;
pub mod navigate;
pub mod project;
pub mod simulate;
pub mod trajectory;
