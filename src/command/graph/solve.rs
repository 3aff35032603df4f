//! `graph solve`: adjusts a pose graph or a net.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use tieline_graph::covariance::{Covariances, covariances};
use tieline_graph::factor::Convention;
use tieline_graph::nonlinear::{SolveOptions, Solved, solve_system};
use tieline_graph::system::{Method, Order, System};
use tieline_graph::{Problem, initialise};

use super::robust::{self, Robust};
use crate::cli::{Common, GraphConvention, GraphInitial, GraphMethod, GraphSolveArgs};
use crate::memory::peak_bytes;
use crate::net::pose_graph;

/// CPU seconds of this process so far.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |k: usize| fields.get(k).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

/// What a solution is told by.
#[derive(Debug, Default)]
pub struct Outcome {
    /// What the adjustment did.
    pub solved: Solved,
    /// From the graph in memory to convergence \[s\].
    pub solve_s: f64,
    /// CPU seconds of the program.
    pub total_cpu_s: f64,
    /// Where the values began.
    pub initial: &'static str,
    /// Covariances, when asked for.
    pub covariances: Option<Covariances>,
    /// Seconds for them.
    pub covariance_s: f64,
}

/// Settings of the solver by the arguments.
pub fn options(args: &GraphSolveArgs, kernel: tieline_graph::robust::Kernel) -> SolveOptions {
    let method = match args.method {
        GraphMethod::Cholesky => Method::Cholesky,
        _ => Method::Helmert,
    };
    let mut options = SolveOptions { method, kernel, ..SolveOptions::default() };
    options.partition.leaf_nodes = args.leaf;
    options
}

/// Adjusts what the arguments name.
///
/// # Errors
/// When a file cannot be read, the graph is not determined, or the output cannot be written.
pub fn run(args: &GraphSolveArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let path = args.files.first().context("name a file")?;
    run_pose_graph(path, args, common, out)
}

fn run_pose_graph(path: &Path, args: &GraphSolveArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let mut graph = tieline_io::pose_graph::read(path)?;
    if let Some(start) = &args.start {
        pose_graph::take_values(&mut graph, &tieline_io::pose_graph::read(start)?);
    }
    let convention = match args.convention {
        GraphConvention::Plain => Convention::Plain,
        GraphConvention::Log => Convention::Log,
        GraphConvention::G2o => Convention::G2o,
    };
    let robust = robust::parse(&args.robust)?;
    let mut problem = pose_graph::problem(&graph, convention)?;
    let outcome = adjust(&mut problem, args, robust)?;
    let name = match args.convention {
        GraphConvention::Plain => "plain",
        GraphConvention::Log => "log",
        GraphConvention::G2o => "g2o",
    };
    report(args, common, name, &problem, &outcome, out)
}

/// First values, solution, covariances.
///
/// # Errors
/// As the solver's.
pub fn adjust(problem: &mut Problem, args: &GraphSolveArgs, robust: Robust) -> Result<Outcome> {
    let begin = Instant::now();
    let options = options(args, robust.kernel());
    let initial = first_values(problem, args.initial, &options)?;
    let mut system = System::new(problem, Order::Automatic, options.partition, options.method.clone())?;
    let mut solved = robust.solve(problem, &mut system, &options, solve_system)?;
    solved.total_s += system.order_s;
    let solve_s = begin.elapsed().as_secs_f64();
    let mut outcome = Outcome { solved, solve_s, initial, ..Outcome::default() };
    if args.sigmas {
        if options.method_is_reference() {
            bail!("--sigmas needs --method helmert: the reference keeps no blocks to invert");
        }
        let begin = Instant::now();
        outcome.covariances = Some(covariances(problem, &mut system, &options.kernel, false)?);
        outcome.covariance_s = begin.elapsed().as_secs_f64();
    }
    outcome.total_cpu_s = cpu_s();
    Ok(outcome)
}

/// Puts first values into a problem; says which.
fn first_values(problem: &mut Problem, initial: GraphInitial, options: &SolveOptions) -> Result<&'static str> {
    match initial {
        GraphInitial::File => Ok("file"),
        GraphInitial::Chordal => {
            problem.values = initialise::chordal(problem)?;
            Ok("chordal")
        }
        GraphInitial::Incremental => {
            initialise::incremental(problem, options)?;
            Ok("incremental")
        }
        GraphInitial::Auto => {
            // with false loop edges about, linear first values are worse than any odometry
            if options.kernel != tieline_graph::robust::Kernel::None {
                return Ok("file");
            }
            let Ok(values) = initialise::chordal(problem) else { return Ok("file") };
            if problem.cost(&values, &options.kernel) < problem.cost(&problem.values, &options.kernel) {
                problem.values = values;
                return Ok("chordal");
            }
            Ok("file")
        }
    }
}

/// The result, as JSON or for people.
fn report(
    args: &GraphSolveArgs,
    common: &Common,
    convention: &str,
    problem: &Problem,
    outcome: &Outcome,
    out: &mut impl Write,
) -> Result<()> {
    let method = match args.method {
        GraphMethod::Cholesky => "cholesky",
        GraphMethod::Helmert => "helmert",
        GraphMethod::Bowie => "bowie",
    };
    let solved = &outcome.solved;
    if common.json {
        let mut value = serde_json::json!({
            "method": method,
            "convention": convention,
            "initial": outcome.initial,
            "chi2": solved.cost,
            "dof": solved.degrees_of_freedom,
            "converged": solved.converged,
            "iterations": solved.iterations,
            "order_s": solved.order_s,
            "factor_s": solved.factor_s,
            "solve_s": outcome.solve_s,
            "total_cpu_s": outcome.total_cpu_s,
            "peak_memory_bytes": peak_bytes(),
        });
        if let Some(covariances) = &outcome.covariances {
            value["covariance_s"] = outcome.covariance_s.into();
            if args.out.is_none() {
                let sigmas: serde_json::Map<String, serde_json::Value> = problem
                    .variables()
                    .filter(|v| !problem.is_fixed(*v))
                    .map(|v| (problem.name(v), covariances.sigmas(v).into()))
                    .collect();
                value["sigmas"] = sigmas.into();
            }
        }
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        writeln!(
            out,
            "{method}: chi2 {:.9} with {} degrees of freedom after {} iterations from {} values ({:.3} s)",
            solved.cost, solved.degrees_of_freedom, solved.iterations, outcome.initial, outcome.solve_s
        )?;
    }
    Ok(())
}
