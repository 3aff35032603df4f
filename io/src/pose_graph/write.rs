//! Writing g2o and TORO text.

use std::fmt::Write;

use nalgebra::{Quaternion, UnitQuaternion};

use super::{Measured, PoseGraph, VertexValue};

/// A text format of pose graphs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// g2o.
    G2o,
    /// TORO: poses and their relations alone.
    Toro,
}

/// The text of a pose graph. Numbers are written with as many digits as they need to come back the same.
///
/// # Errors
/// What the format cannot hold, by its name.
pub fn format(graph: &PoseGraph, format: Format) -> Result<String, &'static str> {
    let mut text = String::new();
    for vertex in &graph.vertices {
        let (tag, numbers): (&str, Vec<f64>) = match (vertex.value, format) {
            (VertexValue::Pose2(v), Format::G2o) => ("VERTEX_SE2", v.to_vec()),
            (VertexValue::Pose3(v), Format::G2o) => ("VERTEX_SE3:QUAT", v.to_vec()),
            (VertexValue::Point2(v), Format::G2o) => ("VERTEX_XY", v.to_vec()),
            (VertexValue::Point3(v), Format::G2o) => ("VERTEX_TRACKXYZ", v.to_vec()),
            (VertexValue::Pose2(v), Format::Toro) => ("VERTEX2", v.to_vec()),
            (VertexValue::Pose3(v), Format::Toro) => ("VERTEX3", euler(&v)),
            _ => return Err("a TORO file holds poses alone, no points"),
        };
        line(&mut text, tag, &[vertex.id], &numbers);
    }
    if format == Format::G2o {
        for fixed in &graph.fixed {
            line(&mut text, "FIX", &[graph.vertices[*fixed].id], &[]);
        }
    }
    for edge in &graph.edges {
        let [a, b] = edge.vertices.map(|v| graph.vertices[v].id);
        match (edge.measured, format) {
            (Measured::Between2(m, w), Format::G2o) => line(&mut text, "EDGE_SE2", &[a, b], &[&m[..], &w].concat()),
            (Measured::Between3(m, w), Format::G2o) => {
                line(&mut text, "EDGE_SE3:QUAT", &[a, b], &[&m[..], &w].concat());
            }
            (Measured::Between2(m, w), Format::Toro) => {
                line(&mut text, "EDGE2", &[a, b], &[&m[..], &[w[0], w[1], w[3], w[5], w[2], w[4]]].concat());
            }
            (Measured::Between3(m, w), Format::Toro) => {
                line(&mut text, "EDGE3", &[a, b], &[&euler(&m)[..], &w].concat());
            }
            (_, Format::Toro) => return Err("a TORO file holds relations of poses alone"),
            (Measured::Sighting2(m, w), _) => line(&mut text, "EDGE_SE2_XY", &[a, b], &[&m[..], &w].concat()),
            (Measured::Sighting3(m, w), _) => line(&mut text, "EDGE_SE3_TRACKXYZ", &[a, b, 0], &[&m[..], &w].concat()),
            (Measured::Prior2(m, w), _) => line(&mut text, "EDGE_PRIOR_SE2", &[a], &[&m[..], &w].concat()),
            (Measured::Prior3(m, w), _) => line(&mut text, "EDGE_SE3_PRIOR", &[a, 0], &[&m[..], &w].concat()),
            (Measured::PriorXy(m, w), _) => line(&mut text, "EDGE_PRIOR_SE2_XY", &[a], &[&m[..], &w].concat()),
            (Measured::PriorXyz(m, w), _) => line(&mut text, "EDGE_POINTXYZ_PRIOR", &[a], &[&m[..], &w].concat()),
        }
    }
    Ok(text)
}

fn line(text: &mut String, tag: &str, ids: &[i64], numbers: &[f64]) {
    text.push_str(tag);
    for id in ids {
        let _ = write!(text, " {id}"); // a string takes everything
    }
    for number in numbers {
        let _ = write!(text, " {number}");
    }
    text.push('\n');
}

fn euler(v: &[f64; 7]) -> Vec<f64> {
    let q = UnitQuaternion::new_normalize(Quaternion::new(v[6], v[3], v[4], v[5]));
    let (roll, pitch, yaw) = q.euler_angles();
    vec![v[0], v[1], v[2], roll, pitch, yaw]
}
