//! Nets and pose graphs: from files to a problem, and from its solution back to files.

pub mod approximate;
pub mod geodetic;
pub mod pose_graph;
pub mod simulated;
pub mod strip_block;
pub mod survey_vehicle;
