//! Nets and pose graphs: from files to a problem, and from its solution back to files.

pub mod pose_graph;
pub mod simulated;
