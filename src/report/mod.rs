//! The report: one self-contained page, a summary for machines, pictures and georeferenced maps.

mod chart;
mod colour;
pub mod data;
pub mod drive;
#[cfg(test)]
mod example;
mod findings;
pub mod geotiff;
mod grid;
mod html;
pub mod maps;
pub(crate) mod nullable;
mod number;
pub mod page;
mod plot;
mod section;
pub(crate) mod spots;
pub mod stations;
mod text;
mod write;

pub use grid::{Grid, Raster};
pub use text::three_lines;
pub use write::{ReportError, write_all};
