//! Bowie's method: junctions and sections (Bowie 1927; Agarwal, Burgard and Stachniss 2014).
//!
//! Of a net a skeleton is kept: the links of a spanning tree, trajectories first, and some of the links that close
//! loops. Nodes where the skeleton branches are junctions, the chains between them sections. Sections collapse to
//! virtual constraints on their ends (the Schur complement of the chain), the junction net is solved, and the
//! corrections go back down the sections. What the skeleton leaves out is brought in by iteration: the misclosures of
//! the whole net are adjusted on the skeleton again and again, as conjugate gradients do.
//!
//! Where nothing is left out (trees, chains, all loops kept) the first pass is the exact linear step.
//!
//! [`length`] is Bowie's own way, with weights by length and every coordinate for itself.

pub mod length;

use std::time::Instant;

use crate::linear::blocks::Normal;
use crate::linear::nodes::{NO_NODE, NodeGraph};
use crate::nonlinear::SolveOptions;
use crate::problem::Problem;
use crate::robust::Kernel;
use crate::system::{Order, System, SystemError};
use crate::variable::VariableId;

/// Settings of the method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BowieOptions {
    /// Links that close loops are kept up to this share of the nodes; 1 or more keeps all of a sparse graph.
    pub loop_share: f64,
    /// Most passes over the junction net.
    pub passes: usize,
    /// Misclosures that are left over those at the start, at which the passes end.
    pub tolerance: f64,
}

impl Default for BowieOptions {
    fn default() -> Self {
        Self { loop_share: 0.1, passes: 200, tolerance: 1e-10 }
    }
}

/// What a linear step by junctions and sections did.
#[derive(Debug, Clone, Default)]
pub struct BowieStep {
    /// Nodes where the skeleton branches.
    pub junctions: usize,
    /// Chains between them.
    pub sections: usize,
    /// Factors that the skeleton leaves out.
    pub left_out: usize,
    /// The step after each pass, by variables' scalars of the problem one after the other; only those asked for.
    pub steps: Vec<Vec<f64>>,
    /// Misclosures left after each pass, over those at the start.
    pub misclosure: Vec<f64>,
    /// Seconds for skeleton and its factorisation.
    pub prepare_s: f64,
    /// Seconds for all passes.
    pub passes_s: f64,
}

/// Which factors the skeleton leaves out.
#[must_use]
pub fn skeleton(problem: &Problem, options: &BowieOptions) -> Vec<bool> {
    let graph = NodeGraph::new(problem);
    let mut parent: Vec<u32> = (0..=u32::try_from(graph.len()).unwrap_or(u32::MAX)).collect();
    let ground = u32::try_from(graph.len()).unwrap_or(u32::MAX); // all held variables
    let nodes_of: Vec<Vec<u32>> = problem.factors().map(|factor| ends(&graph, factor, ground)).collect();
    let ties: Vec<bool> = problem.factors().map(crate::factor::Factor::is_tie).collect();
    let mut left_out = vec![false; nodes_of.len()];
    let mut closing = Vec::new();
    // links of neighbours in the order of the graph first: odometry; then what ties more than two nodes
    for round in 0..3 {
        for (number, nodes) in nodes_of.iter().enumerate() {
            let wanted = match nodes.len() {
                2 => usize::from(nodes[1] - nodes[0] != 1),
                0 | 1 => continue,
                _ if ties[number] => 2,
                _ => continue,
            };
            if wanted != round {
                continue;
            }
            let first = root(&mut parent, nodes[0]);
            let mut joins = false;
            for node in &nodes[1..] {
                let other = root(&mut parent, *node);
                joins |= other != root(&mut parent, first);
                parent[other as usize] = root(&mut parent, first);
            }
            if !joins {
                closing.push(number);
            }
        }
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    let kept = (options.loop_share.max(0.0) * graph.len() as f64) as usize;
    let stride = closing.len().div_ceil(kept.max(1)).max(1);
    for (k, number) in closing.iter().enumerate() {
        left_out[*number] = kept == 0 || k % stride != 0;
    }
    left_out
}

/// The nodes that a factor ties, sorted; held variables are one node, `ground`, and what everything depends on is none.
fn ends(graph: &NodeGraph, factor: &dyn crate::factor::Factor, ground: u32) -> Vec<u32> {
    let node = |v: &VariableId| graph.node_of[v.index()];
    let local = |n: &u32| *n == NO_NODE || !graph.global[*n as usize];
    let mut nodes: Vec<u32> =
        factor.variables().iter().map(node).filter(local).map(|n| if n == NO_NODE { ground } else { n }).collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

fn root(parent: &mut [u32], mut node: u32) -> u32 {
    while parent[node as usize] != node {
        parent[node as usize] = parent[parent[node as usize] as usize];
        node = parent[node as usize];
    }
    node
}

/// One linear step from the values of a problem.
///
/// `keep`: passes after which the step is kept for comparison (0 the first).
///
/// # Errors
/// [`SystemError`]; also where the skeleton alone does not determine a node, as with directions without distances.
pub fn linear_step(
    problem: &mut Problem,
    kernel: &Kernel,
    options: &BowieOptions,
    keep: &[usize],
) -> Result<BowieStep, SystemError> {
    let solver = SolveOptions::default();
    let whole = System::new(problem, Order::Automatic, solver.partition, solver.method.clone())?;
    let mut normal = Normal::default();
    whole.pattern.assemble(problem, &problem.values, kernel, &mut normal);
    let begin = Instant::now();
    let left_out = skeleton(problem, options);
    problem.leave_out(&left_out);
    let prepared = prepare(problem, kernel);
    problem.leave_out(&[]);
    let (part, junctions, sections) = prepared?;
    let mut result = BowieStep {
        junctions,
        sections,
        left_out: left_out.iter().filter(|l| **l).count(),
        prepare_s: begin.elapsed().as_secs_f64(),
        ..BowieStep::default()
    };
    let begin = Instant::now();
    // from the order of the whole to that of the skeleton
    let mut map = vec![0_usize; whole.scalars()];
    for id in problem.variables().filter(|v| !problem.is_fixed(*v)) {
        let (from, to) = (whole.pattern.scalar[id.index()] as usize, part.pattern.scalar[id.index()] as usize);
        for k in 0..problem.values.kind(id).dimension() {
            map[from + k] = to + k;
        }
    }
    let on_skeleton = |misclosure: &[f64]| {
        let mut right = vec![0.0; misclosure.len()];
        map.iter().zip(misclosure).for_each(|(to, v)| right[*to] = *v);
        part.solve_again(&mut right);
        map.iter().map(|to| right[*to]).collect::<Vec<f64>>()
    };
    passes(&whole, &normal, options, keep, on_skeleton, &mut result);
    result.passes_s = begin.elapsed().as_secs_f64();
    // from the order of elimination to that of the variables
    for step in &mut result.steps {
        let mut plain = Vec::with_capacity(step.len());
        for id in problem.variables().filter(|v| !problem.is_fixed(*v)) {
            let first = whole.pattern.scalar[id.index()] as usize;
            plain.extend_from_slice(&step[first..first + problem.values.kind(id).dimension()]);
        }
        *step = plain;
    }
    Ok(result)
}

/// Factorises the skeleton; counts junctions and sections.
fn prepare(problem: &Problem, kernel: &Kernel) -> Result<(System, usize, usize), SystemError> {
    let graph = NodeGraph::new(problem);
    let degrees: Vec<usize> = (0..u32::try_from(graph.len()).unwrap_or(u32::MAX)).map(|n| graph.of(n).len()).collect();
    let junctions = degrees.iter().filter(|d| **d > 2).count();
    let ends: usize = degrees.iter().filter(|d| **d != 2).sum();
    // sections are eliminated before junctions: no order needs fewer operations for chains
    let mut system =
        System::new(problem, Order::MinimumDegree, SolveOptions::default().partition, SolveOptions::default().method)?;
    let mut normal = Normal::default();
    system.pattern.assemble(problem, &problem.values, kernel, &mut normal);
    let mut right = normal.right.clone();
    system.solve(problem, &normal.numbers, &mut right)?;
    Ok((system, junctions, ends / 2))
}

/// Conjugate gradients on the whole net, the skeleton as preconditioner; the first pass is Bowie's solution.
fn passes(
    whole: &System,
    normal: &Normal,
    options: &BowieOptions,
    keep: &[usize],
    on_skeleton: impl Fn(&[f64]) -> Vec<f64>,
    result: &mut BowieStep,
) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let mut step = vec![0.0; whole.scalars()];
    let mut left = normal.right.clone();
    let mut correction = on_skeleton(&left);
    let mut direction = correction.clone();
    let mut square = dot(&left, &correction);
    let first = square;
    for pass in 0..options.passes {
        let image = whole.pattern.multiply(&normal.numbers, &direction);
        let curvature = dot(&direction, &image);
        if curvature <= 0.0 || square <= 0.0 {
            break;
        }
        let length = square / curvature;
        step.iter_mut().zip(&direction).for_each(|(s, d)| *s += length * d);
        left.iter_mut().zip(&image).for_each(|(l, i)| *l -= length * i);
        if keep.contains(&pass) {
            result.steps.push(step.clone());
        }
        correction = on_skeleton(&left);
        let next = dot(&left, &correction);
        result.misclosure.push((next.max(0.0) / first).sqrt());
        if next <= options.tolerance.powi(2) * first {
            break;
        }
        let ratio = next / square;
        direction.iter_mut().zip(&correction).for_each(|(d, c)| *d = c + ratio * *d);
        square = next;
    }
    result.steps.push(step);
}

/// Adjusts a problem by junctions and sections: linear steps until the cost no longer falls.
///
/// # Errors
/// [`SystemError`].
pub fn solve(
    problem: &mut Problem,
    kernel: &Kernel,
    options: &BowieOptions,
    iterations: usize,
) -> Result<(crate::nonlinear::Solved, BowieStep), SystemError> {
    let begin = Instant::now();
    let mut cost = problem.cost(&problem.values, kernel);
    let mut solved = crate::nonlinear::Solved { first_cost: cost, ..crate::nonlinear::Solved::default() };
    let mut last = BowieStep::default();
    while solved.iterations < iterations {
        let step = linear_step(problem, kernel, options, &[])?;
        let plain = step.steps.last().cloned().unwrap_or_default();
        let mut moved = problem.values.clone();
        let mut first = 0;
        for id in problem.variables().filter(|v| !problem.is_fixed(*v)) {
            let count = moved.kind(id).dimension();
            moved.retract(id, &plain[first..first + count]);
            first += count;
        }
        let new_cost = problem.cost(&moved, kernel);
        solved.iterations += 1;
        last = step;
        if new_cost > cost {
            break;
        }
        let small = cost - new_cost <= 1e-9 * cost;
        problem.values = moved;
        cost = new_cost;
        if small {
            solved.converged = true;
            break;
        }
    }
    solved.cost = cost;
    solved.degrees_of_freedom = i64::try_from(problem.residual_count()).unwrap_or(i64::MAX)
        - i64::try_from(problem.unknown_count()).unwrap_or(0);
    solved.total_s = begin.elapsed().as_secs_f64();
    Ok((solved, last))
}
