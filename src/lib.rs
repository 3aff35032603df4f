//! tieline: laser-scanning strip adjustment.
//!
//! The main path, top down: a [`project::Project`] is read, a [`survey::Survey`] opened, and [`command::project::run`]
//! takes it through the stages `match → solve → correct → report`, which [`job`] holds.

pub mod cli;
pub mod command;
pub mod cpu;
pub mod job;
pub mod memory;
pub mod navigation;
pub mod net;
pub mod outputs;
pub mod progress;
pub mod project;
pub mod report;
pub mod sample;
pub mod settings;
pub mod stage;
pub mod state;
pub mod summary;
pub mod survey;
