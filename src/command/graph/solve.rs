//! `graph solve`: adjusts a pose graph or a net.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use tieline_graph::covariance::{Covariances, covariances};
use tieline_graph::factor::Convention;
use tieline_graph::helmert::out_of_core::{self, Disk};
use tieline_graph::nonlinear::{SolveOptions, Solved, solve_system};
use tieline_graph::robust::Kernel;
use tieline_graph::snooping::{Snooped, solve_snooping};
use tieline_graph::system::{Method, System};
use tieline_graph::{Problem, Values, initialise};

use super::robust::{self, Robust};
use super::sections::Sections;
use crate::cli::{Common, GraphConvention, GraphInitial, GraphMethod, GraphSections, GraphSolveArgs};
use crate::cpu::of_living_threads_s as cpu_s;
use crate::memory::peak_bytes;
use crate::net::pose_graph;

/// What a solution is told by.
#[derive(Debug, Default)]
pub(super) struct Outcome {
    /// What the adjustment did.
    pub(super) solved: Solved,
    /// From the graph in memory to convergence \[s\].
    pub(super) solve_s: f64,
    /// CPU seconds from the graph in memory to convergence.
    pub(super) solve_cpu_s: f64,
    /// CPU seconds for covariances.
    pub(super) covariance_cpu_s: f64,
    /// CPU seconds of the program.
    pub(super) total_cpu_s: f64,
    /// Where the values began.
    pub(super) initial: &'static str,
    /// Covariances, when asked for.
    pub(super) covariances: Option<Covariances>,
    /// Seconds for them.
    pub(super) covariance_s: f64,
    /// Groups of blocks taken over from a run that was killed.
    pub(super) resumed_blocks: usize,
    /// Junctions and sections.
    pub(super) bowie: Option<Sections>,
    /// What data snooping took out, when asked for.
    pub(super) snooped: Option<Vec<Snooped>>,
    /// Numbers in the panels.
    pub(super) panel_numbers: usize,
    /// Multiplications of a factorisation.
    pub(super) flops: f64,
}

/// How to solve.
#[derive(Debug, Clone)]
pub(super) struct Setup {
    /// How the normal equations are solved.
    pub(super) method: GraphMethod,
    /// What a section counts as.
    pub(super) sections: GraphSections,
    /// Most nodes of a leaf.
    pub(super) leaf: usize,
    /// Memory for the factorisation \[MiB\].
    pub(super) memory: Option<u64>,
    /// Folder of block files.
    pub(super) blocks: Option<PathBuf>,
    /// Whether sigmas are wanted.
    pub(super) sigmas: bool,
    /// Most iterations.
    pub(super) iterations: usize,
}

impl Setup {
    pub(super) fn of(args: &GraphSolveArgs) -> Self {
        Self {
            method: args.method,
            sections: args.sections.unwrap_or(GraphSections::Schur),
            leaf: args.leaf,
            memory: args.memory,
            blocks: args.blocks.clone(),
            sigmas: args.sigmas,
            iterations: args.iterations,
        }
    }
    /// Settings of the solver.
    pub(super) fn options(&self, kernel: Kernel) -> SolveOptions {
        let method = match self.method {
            GraphMethod::Cholesky => Method::Cholesky,
            _ => Method::Helmert,
        };
        let mut options = SolveOptions { method, kernel, iterations: self.iterations, ..SolveOptions::default() };
        options.partition.leaf_nodes = self.leaf;
        options
    }
    /// A system, on disk where the memory asks for it.
    pub(super) fn system(
        &self,
        problem: &Problem,
        options: &SolveOptions,
    ) -> Result<(System, Option<tempfile::TempDir>)> {
        let mut system = System::new(problem, options.order, options.partition, options.method.clone())?;
        let bytes = 8 * system.tree.panel_numbers() as u64;
        let budget = self.memory.map(|mib| mib << 20);
        let mut temporary = None;
        if self.blocks.is_some() || budget.is_some_and(|b| bytes > b) {
            if self.method != GraphMethod::Helmert {
                bail!("the factorisation needs {} MiB; --memory and --blocks are for --method helmert", bytes >> 20);
            }
            let folder = match &self.blocks {
                Some(folder) => {
                    out_of_core::prepare(folder)?;
                    folder.clone()
                }
                None => {
                    let folder = tempfile::tempdir().context("a folder for block files")?;
                    let path = folder.path().to_path_buf();
                    temporary = Some(folder);
                    path
                }
            };
            let group_bytes = usize::try_from(budget.unwrap_or(128 << 20) / 8).unwrap_or(usize::MAX);
            system.use_disk(Disk { folder, group_bytes });
        }
        Ok((system, temporary))
    }
}

/// Adjusts a net from its own values.
///
/// # Errors
/// As the solver's.
pub(super) fn adjust_net(problem: &mut Problem, setup: &Setup) -> Result<Outcome> {
    adjust(problem, setup, Robust::Kernel(Kernel::None), GraphInitial::File)
}

/// Adjusts what the arguments name.
///
/// # Errors
/// When a file cannot be read, the graph is not determined, or the output cannot be written.
pub(super) fn run(args: &GraphSolveArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let path = args.files.first().context("name a file")?;
    if args.sections.is_some() && args.method != GraphMethod::Bowie {
        bail!("--sections is for --method bowie; add that, or leave --sections out");
    }
    if super::geodetic::is_net(path) {
        return super::geodetic::run(args, common, out);
    }
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
    let before = problem.values.clone();
    let outcome = adjust(&mut problem, &Setup::of(args), robust, args.initial)?;
    if let Some(folder) = &args.out {
        let toro = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("graph"));
        super::output::pose_graph(folder, &graph, toro, &before, &problem, outcome.covariances.as_ref())?;
    }
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
pub(super) fn adjust(problem: &mut Problem, setup: &Setup, robust: Robust, initial: GraphInitial) -> Result<Outcome> {
    let (begin, cpu) = (Instant::now(), cpu_s());
    let options = setup.options(robust.kernel());
    // large nets are not copied for nothing
    let from_file = if initial == GraphInitial::Auto { problem.values.clone() } else { Values::default() };
    let wanted = initial;
    let initial = first_values(problem, initial, &options)?;
    if setup.method == GraphMethod::Bowie {
        let mut outcome = super::sections::adjust(problem, setup, robust.kernel())?;
        outcome.solve_s = begin.elapsed().as_secs_f64();
        outcome.solve_cpu_s = cpu_s() - cpu;
        outcome.initial = initial;
        super::sections::compare(problem, &options, &mut outcome)?;
        outcome.total_cpu_s = cpu_s();
        return Ok(outcome);
    }
    if let Robust::Snooping(limit) = robust {
        return snoop(problem, setup, &options, limit, initial, (begin, cpu));
    }
    let (mut system, _temporary) = setup.system(problem, &options)?;
    let from_file = (initial == "chordal" && wanted == GraphInitial::Auto).then_some(from_file);
    let mut initial = initial;
    let mut solved = robust.solve(problem, &mut system, &options, solve_system)?;
    if let Some(values) = from_file.filter(|_| !solved.converged && options.iterations > 1) {
        // the better guess is not always in the better basin
        let (first, first_values) = (solved, std::mem::replace(&mut problem.values, values));
        solved = robust.solve(problem, &mut system, &options, solve_system)?;
        initial = "file";
        if first.cost < solved.cost {
            (solved, problem.values, initial) = (first, first_values, "chordal");
        }
    }
    solved.total_s += system.order_s;
    let solve_s = begin.elapsed().as_secs_f64();
    let mut outcome = Outcome {
        solved,
        solve_s,
        solve_cpu_s: cpu_s() - cpu,
        initial,
        panel_numbers: system.tree.panel_numbers(),
        flops: system.tree.flops(),
        ..Outcome::default()
    };
    if setup.sigmas {
        if options.method_is_reference() {
            bail!("--sigmas needs --method helmert: the reference keeps no blocks to invert");
        }
        let (begin, cpu) = (Instant::now(), cpu_s());
        outcome.covariances = Some(covariances(problem, &mut system, &options.kernel, false)?);
        outcome.covariance_s = begin.elapsed().as_secs_f64();
        outcome.covariance_cpu_s = cpu_s() - cpu;
    }
    if let Some(disk) = system.on_disk() {
        outcome.resumed_blocks = disk.resumed;
        disk.delete();
    }
    outcome.total_cpu_s = cpu_s();
    Ok(outcome)
}

/// Data snooping: adjusts, takes out what fails its test, and adjusts again.
fn snoop(
    problem: &mut Problem,
    setup: &Setup,
    options: &SolveOptions,
    limit: f64,
    initial: &'static str,
    (begin, cpu): (Instant, f64),
) -> Result<Outcome> {
    if options.method_is_reference() || setup.blocks.is_some() || setup.memory.is_some() {
        bail!("--robust snooping needs --method helmert in memory: it looks at every redundancy");
    }
    let (solved, mut system, snooped) = solve_snooping(problem, options, limit)?;
    let mut outcome = Outcome {
        solved,
        solve_s: begin.elapsed().as_secs_f64(),
        solve_cpu_s: cpu_s() - cpu,
        initial,
        snooped: Some(snooped),
        ..Outcome::default()
    };
    if setup.sigmas {
        let (begin, cpu) = (Instant::now(), cpu_s());
        outcome.covariances = Some(covariances(problem, &mut system, &options.kernel, false)?);
        outcome.covariance_s = begin.elapsed().as_secs_f64();
        outcome.covariance_cpu_s = cpu_s() - cpu;
    }
    outcome.total_cpu_s = cpu_s();
    Ok(outcome)
}

/// Ties that data snooping took out, by the names of their variables.
fn taken_out(problem: &Problem, snooped: &[Snooped]) -> Vec<serde_json::Value> {
    let factors: Vec<_> = problem.factors().collect();
    let one = |s: &Snooped| {
        let names: Vec<String> = factors[s.factor].variables().iter().map(|v| problem.name(*v)).collect();
        serde_json::json!({ "between": names, "test": s.test })
    };
    snooped.iter().map(one).collect()
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
            if options.kernel != Kernel::None {
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

/// What a method is called.
pub(super) fn method_name(method: GraphMethod) -> &'static str {
    match method {
        GraphMethod::Cholesky => "cholesky",
        GraphMethod::Helmert => "helmert",
        GraphMethod::Bowie => "bowie",
    }
}

/// Sigma of unit weight; nothing without redundancy.
#[allow(clippy::cast_precision_loss)] // few enough
fn sigma0(solved: &Solved) -> Option<f64> {
    (solved.degrees_of_freedom > 0).then(|| (solved.cost / solved.degrees_of_freedom as f64).sqrt())
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
    let method = method_name(args.method);
    let solved = &outcome.solved;
    if common.json {
        let mut value = serde_json::json!({
            "method": method,
            "convention": convention,
            "initial": outcome.initial,
            "chi2": solved.cost,
            "dof": solved.degrees_of_freedom,
            "sigma0": sigma0(solved),
            "converged": solved.converged,
            "iterations": solved.iterations,
            "order_s": solved.order_s,
            "factor_s": solved.factor_s,
            "solve_s": outcome.solve_s,
            "solve_cpu_s": outcome.solve_cpu_s,
            "total_cpu_s": outcome.total_cpu_s,
            "peak_memory_bytes": peak_bytes(),
        });
        if let Some(sections) = &outcome.bowie {
            value["bowie"] = serde_json::to_value(sections)?;
        }
        if let Some(snooped) = &outcome.snooped {
            value["taken_out"] = taken_out(problem, snooped).into();
        }
        if let Some(covariances) = &outcome.covariances {
            value["covariance_s"] = outcome.covariance_s.into();
            value["covariance_cpu_s"] = outcome.covariance_cpu_s.into();
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
        if let Some(sections) = &outcome.bowie {
            writeln!(out, "{sections}")?;
        }
        for tie in outcome.snooped.iter().flat_map(|snooped| taken_out(problem, snooped)) {
            writeln!(out, "taken out: {tie}")?;
        }
    }
    Ok(())
}
