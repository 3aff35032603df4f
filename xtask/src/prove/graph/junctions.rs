//! Line 7: Bowie's method against the exact solution.

use anyhow::Result;
use tieline::net::{pose_graph, simulated, strip_block};
use tieline_graph::bowie::length::solve_by_length;
use tieline_graph::bowie::{BowieOptions, linear_step};
use tieline_graph::factor::Convention;
use tieline_graph::linear::blocks::Normal;
use tieline_graph::nonlinear::SolveOptions;
use tieline_graph::robust::Kernel;
use tieline_graph::system::{Method, Order, System};
use tieline_graph::{Kind, Problem, Values};
use tieline_io::pose_graph::{Measured, PoseGraph};
use tieline_simulate::block::{BlockOptions, simulate_block};
use tieline_simulate::net::{NetKind, simulate_net};

use super::super::Row;
use super::data;

/// The exact linear step, variable by variable, the weights of its numbers (diagonal of the normal matrix), and its
/// seconds.
fn exact(problem: &Problem) -> Result<(Vec<[f64; 2]>, f64)> {
    let begin = std::time::Instant::now();
    let options = SolveOptions::default();
    let mut system = System::new(problem, Order::Automatic, options.partition, Method::Helmert)?;
    let mut normal = Normal::default();
    system.pattern.assemble(problem, &problem.values, &Kernel::None, &mut normal);
    let mut right = normal.right.clone();
    system.solve(problem, &normal.numbers, &mut right)?;
    let weights = system.pattern.diagonal(&normal.numbers);
    let mut plain = Vec::with_capacity(right.len());
    for id in problem.variables().filter(|v| !problem.is_fixed(*v)) {
        let first = system.pattern.scalar[id.index()] as usize;
        plain.extend((first..first + problem.values.kind(id).dimension()).map(|k| [right[k], weights[k]]));
    }
    Ok((plain, begin.elapsed().as_secs_f64()))
}

/// Root mean square by which a step is off the exact one, over that of the exact one; metres and radians count by their
/// weights.
fn off(step: &[f64], exact: &[[f64; 2]]) -> f64 {
    let top: f64 = step.iter().zip(exact).map(|(x, [y, w])| w * (x - y).powi(2)).sum();
    (top / exact.iter().map(|[y, w]| w * y * y).sum::<f64>()).sqrt()
}

/// M3500 without the loops, and with every thirtieth: chains and sections whose ends are junctions.
fn thinned(stride: usize) -> Result<PoseGraph> {
    let mut graph = tieline_io::pose_graph::read(&data("M3500.g2o"))?;
    let mut seen = 0;
    graph.edges.retain(|edge| {
        let consecutive = edge.vertices[0].abs_diff(edge.vertices[1]) == 1;
        seen += usize::from(!consecutive);
        consecutive || seen % stride == 0
    });
    // moved off the solution of a chain, whose step would be zero
    for (k, vertex) in graph.vertices.iter_mut().enumerate() {
        if let tieline_io::pose_graph::VertexValue::Pose2(v) = &mut vertex.value {
            v[0] += 1e-3 * f64::from(u32::try_from(k % 7).unwrap_or(0));
        }
    }
    debug_assert!(graph.edges.iter().all(|e| matches!(e.measured, Measured::Between2(..))));
    Ok(graph)
}

/// Line 7.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let all = BowieOptions { loop_share: 1.0, ..BowieOptions::default() };
    for (label, stride) in [("chain", usize::MAX), ("sections between junctions", 30)] {
        let mut problem = pose_graph::problem(&thinned(stride)?, Convention::Plain)?;
        let (truth, _) = exact(&problem)?;
        let step = linear_step(&mut problem, &Kernel::None, &all, &[0])?;
        let name = format!("{label}: {} junctions, {} sections: first pass off exact", step.junctions, step.sections);
        rows.push(Row::at_most(name, off(&step.steps[0], &truth) * 1e9, 1.0, "1e-9"));
    }
    let file = tieline_io::pose_graph::read(&data("M3500.g2o"))?;
    let mut pose = pose_graph::problem(&file, Convention::Plain)?;
    pose.values = tieline_graph::initialise::chordal(&pose)?;
    let (net, _) = simulate_net(270_400, NetKind::Baselines, 7);
    let strips = BlockOptions { strips: 200, cross_strips: 4, knots: 60, ties: 60_000, seed: 3 };
    let (block, _) = simulate_block(&strips);
    let mut problems = vec![
        ("M3500", pose),
        ("block of 200 strips", strip_block::problem(&block, strips.knots)),
        ("net of 270,400 stations", simulated::problem(&net)),
    ];
    for (name, problem) in &mut problems {
        let (truth, exact_s) = exact(problem)?;
        println!("{name}: exact step in {exact_s:.3} s");
        for loop_share in [0.02, 0.1, 0.3] {
            let options = BowieOptions { loop_share, passes: 31, tolerance: 1e-12 };
            let step = linear_step(problem, &Kernel::None, &options, &[0, 2, 9, 29])?;
            let errors: Vec<String> = step.steps.iter().map(|s| format!("{:.1e}", off(s, &truth))).collect();
            println!(
                "  loops kept {loop_share}: {} junctions, {} sections, {} factors left out; {:.3} s + {:.3} s; off exact \
                 after 1, 3, 10, 30 passes: {}",
                step.junctions,
                step.sections,
                step.left_out,
                step.prepare_s,
                step.passes_s,
                errors.join(", ")
            );
            let (first, last) = (off(&step.steps[0], &truth), step.steps.last().map_or(f64::NAN, |s| off(s, &truth)));
            rows.push(Row::at_most(
                format!("{name}, loops kept {loop_share}: error of the last pass over the first's"),
                last / first,
                1.0,
                "",
            ));
        }
    }
    rows.extend(by_length("M3500 as a chain", pose_graph::problem(&thinned(usize::MAX)?, Convention::Plain)?, 1e-6)?);
    rows.extend(by_length("M3500", pose_graph::problem(&file, Convention::Plain)?, 1.0)?);
    rows.extend(by_length("net of 270,400 stations", simulated::problem(&net), 1.0)?);
    Ok(rows)
}

/// Root mean square of the distances of the nodes \[m\].
fn apart_m(problem: &Problem, a: &Values, b: &Values) -> f64 {
    let squares = problem.variables().map(|id| {
        let count = if problem.values.kind(id) == Kind::Pose2 { 2 } else { 3 };
        a.get(id)[..count].iter().zip(&b.get(id)[..count]).map(|(p, q)| (p - q).powi(2)).sum::<f64>()
    });
    (squares.sum::<f64>() / problem.values.len() as f64).sqrt()
}

/// Weights by length: what is left of the distance to the exact solution that the first values had.
fn by_length(name: &str, mut problem: Problem, bound: f64) -> Result<Vec<Row>> {
    let first = problem.values.clone();
    let begin = std::time::Instant::now();
    let done = solve_by_length(&mut problem)?;
    let seconds = begin.elapsed().as_secs_f64();
    let by_length = problem.values.clone();
    problem.values = tieline_graph::initialise::chordal(&problem).unwrap_or(by_length.clone());
    let exact = tieline_graph::nonlinear::solve(&mut problem, &SolveOptions::default())?;
    let (before, after) = (apart_m(&problem, &first, &problem.values), apart_m(&problem, &by_length, &problem.values));
    println!(
        "{name}, weights by length: {} junctions, {} sections, {} passes, {seconds:.3} s; chi2 {:.1} (exact {:.1}, in {:.3} s); \
         {after:.3e} m off exact, the first values {before:.3e} m",
        done.junctions, done.sections, done.passes, done.cost, exact.cost, exact.total_s
    );
    let name = format!("{name}, weights by length: distance to exact over that of the first values");
    Ok(vec![Row::at_most(name, after / before, bound, "")])
}
