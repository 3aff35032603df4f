//! The report: one self-contained page, a summary for machines, pictures and georeferenced maps.

pub mod data;
