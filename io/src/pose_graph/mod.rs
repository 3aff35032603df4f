//! Pose graphs: g2o and TORO text.
//!
//! | tag | holds |
//! |---|---|
//! | `VERTEX_SE2`, `VERTEX_SE3:QUAT`, `VERTEX_XY`, `VERTEX_TRACKXYZ` | poses and points |
//! | `EDGE_SE2`, `EDGE_SE3:QUAT` | relations of poses |
//! | `EDGE_SE2_XY`, `EDGE_SE3_TRACKXYZ` | sightings of points; of the latter's sensor offsets the identity alone |
//! | `EDGE_PRIOR_SE2` (`EDGE_SE2_PRIOR`), `EDGE_SE3_PRIOR`, `EDGE_PRIOR_SE2_XY`, `EDGE_POINTXYZ_PRIOR` | known values |
//! | `FIX` | held vertices |
//! | `VERTEX2`, `EDGE2`, `VERTEX3`, `EDGE3` | TORO |

mod error;
mod read;
mod write;

use std::path::Path;

pub use error::{PoseGraphError, Problem};
pub use read::parse;
pub use write::{Format, format};

/// Value of a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum VertexValue {
    /// x, y \[m\], angle \[rad\].
    Pose2([f64; 3]),
    /// x, y, z \[m\], unit quaternion x, y, z, w.
    Pose3([f64; 7]),
    /// x, y \[m\].
    Point2([f64; 2]),
    /// x, y, z \[m\].
    Point3([f64; 3]),
}

/// A vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// Its number in the file.
    pub id: i64,
    /// Its value.
    pub value: VertexValue,
}

/// What was measured. Information matrices: upper triangle, row by row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measured {
    /// Second pose in the frame of the first.
    Between2([f64; 3], [f64; 6]),
    /// Second pose in the frame of the first.
    Between3([f64; 7], [f64; 21]),
    /// Point in the frame of a pose.
    Sighting2([f64; 2], [f64; 3]),
    /// Point in the frame of a pose.
    Sighting3([f64; 3], [f64; 6]),
    /// Known pose.
    Prior2([f64; 3], [f64; 6]),
    /// Known pose.
    Prior3([f64; 7], [f64; 21]),
    /// Known place of a pose or point in the plane.
    PriorXy([f64; 2], [f64; 3]),
    /// Known point in space.
    PriorXyz([f64; 3], [f64; 6]),
}

/// An edge: indices of vertices in [`PoseGraph::vertices`]; the same twice for known values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Vertices.
    pub vertices: [usize; 2],
    /// What was measured.
    pub measured: Measured,
}

/// A pose graph as a file has it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseGraph {
    /// Vertices in the order of the file.
    pub vertices: Vec<Vertex>,
    /// Edges in the order of the file.
    pub edges: Vec<Edge>,
    /// Indices of held vertices.
    pub fixed: Vec<usize>,
}

/// Reads a g2o or TORO file.
///
/// # Errors
/// [`PoseGraphError`], naming file and line.
pub fn read(path: &Path) -> Result<PoseGraph, PoseGraphError> {
    let text = std::fs::read(path).map_err(|source| PoseGraphError::Read { path: path.to_path_buf(), source })?;
    parse(&String::from_utf8_lossy(&text))
        .map_err(|problem| PoseGraphError::Content { path: path.to_path_buf(), problem })
}
