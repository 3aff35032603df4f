//! A pose graph of a file as a problem.

use anyhow::{Context, Result, bail};
use nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};
use tieline_graph::factor::Convention;
use tieline_graph::factor::pose2::{Between2, Prior2, Sighting2};
use tieline_graph::factor::pose3::{Between3, Motion, Prior3, Sighting3};
use tieline_graph::factor::terrestrial::Known;
use tieline_graph::linear::nodes::NodeGraph;
use tieline_graph::system::SystemError;
use tieline_graph::{Kind, Problem, VariableId};
use tieline_io::pose_graph::{Measured, PoseGraph, VertexValue};

/// Full matrix out of its upper triangle.
fn full<const N: usize>(upper: &[f64]) -> nalgebra::SMatrix<f64, N, N> {
    let index = |r: usize, c: usize| r * N - r * (r + 1) / 2 + c;
    nalgebra::SMatrix::from_fn(|r, c| upper[index(r.min(c), r.max(c))])
}

fn motion(v: &[f64; 7]) -> Motion {
    Motion {
        translation: Vector3::new(v[0], v[1], v[2]),
        rotation: UnitQuaternion::new_normalize(Quaternion::new(v[6], v[3], v[4], v[5])),
    }
}

/// Whether an edge is odometry: relations of consecutive vertices; all others are loop edges.
fn is_loop(graph: &PoseGraph, vertices: [usize; 2]) -> bool {
    let [a, b] = vertices.map(|v| graph.vertices[v].id);
    (b - a).abs() != 1
}

/// The problem of a pose graph: variables in the order of the vertices, loop edges as ties. Without a held vertex or
/// known value the first vertex is held.
///
/// # Errors
/// When a part of the graph has nothing that holds it.
pub fn problem(graph: &PoseGraph, convention: Convention) -> Result<Problem> {
    let mut problem = Problem::new();
    for vertex in &graph.vertices {
        let id = match &vertex.value {
            VertexValue::Pose2(v) => problem.add_variable(Kind::Pose2, v),
            VertexValue::Pose3(v) => problem.add_variable(Kind::Pose3, v),
            VertexValue::Point2(v) => problem.add_variable(Kind::Point2, v),
            VertexValue::Point3(v) => problem.add_variable(Kind::Point3, v),
        };
        problem.set_name(id, vertex.id.to_string());
    }
    let mut known = false;
    for edge in &graph.edges {
        let ids = edge.vertices.map(|v| VariableId(u32::try_from(v).unwrap_or(u32::MAX)));
        let tie = is_loop(graph, edge.vertices);
        let name = || {
            format!(
                "the edge from {} to {}",
                problem_name(graph, edge.vertices[0]),
                problem_name(graph, edge.vertices[1])
            )
        };
        match &edge.measured {
            Measured::Between2(m, w) => {
                let factor = Between2::new(ids, *m, &full::<3>(w), convention).with_context(name)?;
                problem.add(factor.as_tie(tie));
            }
            Measured::Between3(m, w) => {
                let factor = Between3::new(ids, motion(m), &full::<6>(w), convention).with_context(name)?;
                problem.add(factor.as_tie(tie));
            }
            Measured::Sighting2(m, w) => {
                let factor = Sighting2::new(ids, Vector2::new(m[0], m[1]), &full::<2>(w)).with_context(name)?;
                problem.add(factor);
            }
            Measured::Sighting3(m, w) => {
                let factor = Sighting3::new(ids, Vector3::new(m[0], m[1], m[2]), &full::<3>(w)).with_context(name)?;
                problem.add(factor);
            }
            Measured::Prior2(m, w) => {
                problem.add(Prior2::new(ids[0], *m, &full::<3>(w)).with_context(name)?);
                known = true;
            }
            Measured::Prior3(m, w) => {
                problem.add(Prior3::new(ids[0], motion(m), &full::<6>(w)).with_context(name)?);
                known = true;
            }
            Measured::PriorXy(m, w) => {
                problem.add(Known::<2>::new(ids[0], *m, &full::<2>(w)).with_context(name)?);
                known = true;
            }
            Measured::PriorXyz(m, w) => {
                problem.add(Known::<3>::new(ids[0], *m, &full::<3>(w)).with_context(name)?);
                known = true;
            }
        }
    }
    for fixed in &graph.fixed {
        problem.fix(VariableId(u32::try_from(*fixed).unwrap_or(u32::MAX)));
    }
    check_parts(&problem, graph, known)?;
    if graph.fixed.is_empty() && !known {
        problem.fix(VariableId(0));
    }
    Ok(problem)
}

fn problem_name(graph: &PoseGraph, vertex: usize) -> i64 {
    graph.vertices[vertex].id
}

/// Every part of the graph needs something that holds it.
fn check_parts(problem: &Problem, graph: &PoseGraph, known: bool) -> Result<()> {
    let mut free = vec![false; problem.values.len()];
    let whole = NodeGraph::from_pairs(
        vec![1; problem.values.len()],
        graph.edges.iter().map(|e| {
            let [a, b] = e.vertices.map(|v| u32::try_from(v).unwrap_or(u32::MAX));
            (a, b)
        }),
    );
    let (component, count) = whole.components();
    if count == 1 {
        return Ok(());
    }
    let mut held = vec![false; count as usize];
    for fixed in &graph.fixed {
        held[component[*fixed] as usize] = true;
    }
    for edge in &graph.edges {
        if edge.vertices[0] == edge.vertices[1] {
            held[component[edge.vertices[0]] as usize] = true;
        }
    }
    if graph.fixed.is_empty() && !known {
        held[component[0] as usize] = true;
    }
    free.iter_mut().zip(&component).for_each(|(f, c)| *f = !held[*c as usize]);
    if let Some(vertex) = free.iter().position(|f| *f) {
        bail!(SystemError::Disconnected { components: count, name: graph.vertices[vertex].id.to_string() });
    }
    Ok(())
}

/// A pose graph with the values of a solution.
#[must_use]
pub fn with_values(graph: &PoseGraph, problem: &Problem) -> PoseGraph {
    let mut solved = graph.clone();
    for (vertex, id) in solved.vertices.iter_mut().zip(problem.variables()) {
        let v = problem.values.get(id);
        match &mut vertex.value {
            VertexValue::Pose2(value) => value.copy_from_slice(v),
            VertexValue::Pose3(value) => value.copy_from_slice(v),
            VertexValue::Point2(value) => value.copy_from_slice(v),
            VertexValue::Point3(value) => value.copy_from_slice(v),
        }
    }
    solved
}

/// Puts the values of another file's vertices into a graph, by their numbers.
pub fn take_values(graph: &mut PoseGraph, from: &PoseGraph) {
    let values: std::collections::HashMap<i64, VertexValue> = from.vertices.iter().map(|v| (v.id, v.value)).collect();
    for vertex in &mut graph.vertices {
        if let Some(value) = values.get(&vertex.id)
            && std::mem::discriminant(value) == std::mem::discriminant(&vertex.value)
        {
            vertex.value = *value;
        }
    }
}
