//! tieline: laser-scanning strip adjustment.
//!
//! The main path, top down: a [`project::Project`] is read, a [`survey::Survey`] opened, and [`job::run`] takes it
//! through the stages `match → solve → correct → report`.

pub mod job;
pub mod progress;
pub mod project;
pub mod report;
pub mod sample;
pub mod settings;
pub mod stage;
pub mod survey;
