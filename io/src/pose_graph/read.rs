//! Reading g2o and TORO text.

use std::collections::HashMap;

use nalgebra::{DMatrix, UnitQuaternion};

use super::error::Problem;
use super::{Edge, Measured, PoseGraph, Vertex, VertexValue};

const KNOWN: &str = "VERTEX_SE2, VERTEX_SE3:QUAT, VERTEX_XY, VERTEX_TRACKXYZ, EDGE_SE2, EDGE_SE3:QUAT, EDGE_SE2_XY, \
                     EDGE_SE3_TRACKXYZ, EDGE_PRIOR_SE2, EDGE_SE3_PRIOR, EDGE_PRIOR_SE2_XY, EDGE_POINTXYZ_PRIOR, FIX, \
                     VERTEX2, EDGE2, VERTEX3, EDGE3";

/// One line: its number, tag and words.
struct Line<'a> {
    number: usize,
    tag: &'a str,
    words: Vec<&'a str>,
}

impl Line<'_> {
    /// `N` numbers after `skip` words.
    fn numbers<const N: usize>(&self, skip: usize) -> Result<[f64; N], Problem> {
        let mut numbers = [0.0; N];
        if self.words.len() < skip + N {
            return Err(Problem::Short {
                line: self.number,
                tag: self.tag.to_string(),
                found: self.words.len(),
                wanted: skip + N,
            });
        }
        for (number, word) in numbers.iter_mut().zip(&self.words[skip..]) {
            *number = word
                .parse()
                .ok()
                .filter(|v: &f64| v.is_finite())
                .ok_or_else(|| Problem::NotANumber { line: self.number, value: (*word).to_string() })?;
        }
        Ok(numbers)
    }
    fn id(&self, index: usize) -> Result<i64, Problem> {
        let word = self.words.get(index).ok_or_else(|| Problem::Short {
            line: self.number,
            tag: self.tag.to_string(),
            found: self.words.len(),
            wanted: index + 1,
        })?;
        word.parse().map_err(|_| Problem::NotAnId { line: self.number, value: (*word).to_string() })
    }
    /// An information matrix of `n` rows: upper triangle after `skip` words.
    fn information<const N: usize>(&self, skip: usize, n: usize) -> Result<[f64; N], Problem> {
        let upper = self.numbers::<N>(skip)?;
        check_information(&upper, n, self.number, self.tag)?;
        Ok(upper)
    }
    fn pose3(&self, skip: usize) -> Result<[f64; 7], Problem> {
        let mut v = self.numbers::<7>(skip)?;
        let norm = v[3..].iter().map(|q| q * q).sum::<f64>().sqrt();
        if norm < 1e-6 {
            return Err(Problem::Quaternion { line: self.number, tag: self.tag.to_string() });
        }
        v[3..].iter_mut().for_each(|q| *q /= norm);
        Ok(v)
    }
    /// A pose with roll, pitch, yaw (TORO).
    fn euler_pose(&self, skip: usize) -> Result<[f64; 7], Problem> {
        let v = self.numbers::<6>(skip)?;
        let q = UnitQuaternion::from_euler_angles(v[3], v[4], v[5]);
        Ok([v[0], v[1], v[2], q.i, q.j, q.k, q.w])
    }
}

fn check_information(upper: &[f64], n: usize, line: usize, tag: &str) -> Result<(), Problem> {
    let index = |r: usize, c: usize| r * n - r * (r + 1) / 2 + c;
    let matrix = DMatrix::from_fn(n, n, |r, c| upper[index(r.min(c), r.max(c))]);
    matrix.cholesky().map(|_| ()).ok_or_else(|| Problem::Information { line, tag: tag.to_string() })
}

/// An edge whose vertices are still numbers of the file.
struct OpenEdge {
    line: usize,
    tag: String,
    ids: [i64; 2],
    measured: Measured,
}

/// Reads the text of a g2o or TORO file.
///
/// # Errors
/// [`Problem`], naming the line.
pub fn parse(text: &str) -> Result<PoseGraph, Problem> {
    let mut graph = PoseGraph::default();
    let mut index = HashMap::new();
    let mut open = Vec::new();
    let mut fixed = Vec::new();
    for (number, text) in text.lines().enumerate().map(|(k, l)| (k + 1, l)) {
        let mut words = text.split_whitespace();
        let Some(tag) = words.next().filter(|t| !t.starts_with('#')) else { continue };
        let line = Line { number, tag, words: words.collect() };
        if let Some(value) = vertex(&line)? {
            let id = line.id(0)?;
            if index.insert(id, graph.vertices.len()).is_some() {
                return Err(Problem::Twice { line: number, id });
            }
            graph.vertices.push(Vertex { id, value });
        } else if let Some((ids, measured)) = edge(&line)? {
            open.push(OpenEdge { line: number, tag: tag.to_string(), ids, measured });
        } else if tag == "FIX" {
            for k in 0..line.words.len() {
                fixed.push((number, line.id(k)?));
            }
        } else if !(tag == "PARAMS_SE3OFFSET" || tag == "PARAMS_SE2OFFSET") {
            return Err(Problem::Tag { line: number, tag: tag.to_string(), known: KNOWN });
        }
    }
    if graph.vertices.is_empty() {
        return Err(Problem::Empty);
    }
    for (line, id) in fixed {
        graph.fixed.push(*index.get(&id).ok_or(Problem::Unknown { line, id })?);
    }
    for edge in open {
        let edge = close(&graph, &index, edge)?;
        graph.edges.push(edge);
    }
    Ok(graph)
}

fn vertex(line: &Line<'_>) -> Result<Option<VertexValue>, Problem> {
    Ok(Some(match line.tag {
        "VERTEX_SE2" | "VERTEX2" => VertexValue::Pose2(line.numbers(1)?),
        "VERTEX_SE3:QUAT" => VertexValue::Pose3(line.pose3(1)?),
        "VERTEX3" => VertexValue::Pose3(line.euler_pose(1)?),
        "VERTEX_XY" => VertexValue::Point2(line.numbers(1)?),
        "VERTEX_TRACKXYZ" | "VERTEX_POINT_XYZ" => VertexValue::Point3(line.numbers(1)?),
        _ => return Ok(None),
    }))
}

fn edge(line: &Line<'_>) -> Result<Option<([i64; 2], Measured)>, Problem> {
    let pair = || Ok::<_, Problem>([line.id(0)?, line.id(1)?]);
    let one = || line.id(0).map(|id| [id, id]);
    Ok(Some(match line.tag {
        "EDGE_SE2" => (pair()?, Measured::Between2(line.numbers(2)?, line.information(5, 3)?)),
        "EDGE2" => {
            // TORO: xx xy yy aa xa ya
            let w = line.numbers::<6>(5)?;
            let upper = [w[0], w[1], w[4], w[2], w[5], w[3]];
            check_information(&upper, 3, line.number, line.tag)?;
            (pair()?, Measured::Between2(line.numbers(2)?, upper))
        }
        "EDGE_SE3:QUAT" => (pair()?, Measured::Between3(line.pose3(2)?, line.information(9, 6)?)),
        "EDGE3" => (pair()?, Measured::Between3(line.euler_pose(2)?, line.information(8, 6)?)),
        "EDGE_SE2_XY" => (pair()?, Measured::Sighting2(line.numbers(2)?, line.information(4, 2)?)),
        // the number of the sensor offset stands after the vertices
        "EDGE_SE3_TRACKXYZ" => (pair()?, Measured::Sighting3(line.numbers(3)?, line.information(6, 3)?)),
        "EDGE_PRIOR_SE2" | "EDGE_SE2_PRIOR" => (one()?, Measured::Prior2(line.numbers(1)?, line.information(4, 3)?)),
        // likewise
        "EDGE_SE3_PRIOR" => (one()?, Measured::Prior3(line.pose3(2)?, line.information(9, 6)?)),
        "EDGE_PRIOR_SE2_XY" | "EDGE_PRIOR_XY" => (one()?, Measured::PriorXy(line.numbers(1)?, line.information(3, 2)?)),
        "EDGE_POINTXYZ_PRIOR" | "EDGE_PRIOR_XYZ" => {
            (one()?, Measured::PriorXyz(line.numbers(1)?, line.information(4, 3)?))
        }
        _ => return Ok(None),
    }))
}

/// Finds the vertices of an edge and looks whether they are of its kind.
fn close(graph: &PoseGraph, index: &HashMap<i64, usize>, edge: OpenEdge) -> Result<Edge, Problem> {
    let find = |id: i64| index.get(&id).copied().ok_or(Problem::Unknown { line: edge.line, id });
    let vertices = [find(edge.ids[0])?, find(edge.ids[1])?];
    let kinds = vertices.map(|v| match graph.vertices[v].value {
        VertexValue::Pose2(_) => 'p',
        VertexValue::Pose3(_) => 'P',
        VertexValue::Point2(_) => 'x',
        VertexValue::Point3(_) => 'X',
    });
    let allowed: [&str; 2] = match edge.measured {
        Measured::Between2(..) => ["p", "p"],
        Measured::Between3(..) => ["P", "P"],
        Measured::Sighting2(..) => ["p", "x"],
        Measured::Sighting3(..) => ["P", "X"],
        Measured::Prior2(..) => ["p", "p"],
        Measured::Prior3(..) => ["P", "P"],
        Measured::PriorXy(..) => ["px", "px"],
        Measured::PriorXyz(..) => ["X", "X"],
    };
    for k in 0..2 {
        if !allowed[k].contains(kinds[k]) {
            return Err(Problem::Kind { line: edge.line, tag: edge.tag, id: edge.ids[k] });
        }
    }
    let known = matches!(
        edge.measured,
        Measured::Prior2(..) | Measured::Prior3(..) | Measured::PriorXy(..) | Measured::PriorXyz(..)
    );
    if !known && vertices[0] == vertices[1] {
        return Err(Problem::Loop { line: edge.line, tag: edge.tag, id: edge.ids[0] });
    }
    Ok(Edge { vertices, measured: edge.measured })
}
