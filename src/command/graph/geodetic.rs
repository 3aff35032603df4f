//! `graph solve` on geodetic nets.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use tieline_graph::VariableId;
use tieline_graph::covariance::{Covariances, covariances};
use tieline_graph::free_net::{self, MOST_UNKNOWNS};
use tieline_graph::robust::Kernel;
use tieline_graph::system::System;
use tieline_io::network::{Network, dynadjust, gama};

use super::solve::{Setup, method_name};
use crate::cli::{Common, GraphMethod, GraphSolveArgs};
use crate::cpu::of_living_threads_s as cpu_s;
use crate::memory::peak_bytes;
use crate::net::geodetic::GeodeticNet;

/// Whether the files are those of a net.
pub(super) fn is_net(path: &Path) -> bool {
    let extension = path.extension().map(|e| e.to_ascii_lowercase());
    extension.is_some_and(|e| e == "gkf" || e == "stn" || e == "msr")
}

fn read(args: &GraphSolveArgs) -> Result<Network> {
    let of = |wanted: &str| args.files.iter().find(|f| f.extension().is_some_and(|e| e.eq_ignore_ascii_case(wanted)));
    if let Some(path) = of("gkf") {
        return Ok(gama::read(path)?);
    }
    let stations = of("stn").context("a DynAdjust net needs its .stn beside the .msr")?;
    let measurements = of("msr").context("a DynAdjust net needs its .msr beside the .stn")?;
    Ok(dynadjust::read(stations, measurements)?)
}

/// A solved net in figures.
struct Solution {
    chi2: f64,
    dof: i64,
    defect: usize,
    iterations: usize,
    sigmas: Box<dyn Fn(VariableId) -> Vec<f64>>,
    checks: Option<Covariances>,
}

/// Adjusts a net.
///
/// # Errors
/// When a file cannot be read, the net is not determined, or the output cannot be written.
pub(super) fn run(args: &GraphSolveArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    if args.robust != "none" {
        bail!(
            "--robust {}: a geodetic net has no loop edges or ties to weight down; its suspects are named",
            args.robust
        );
    }
    let mut net = GeodeticNet::new(read(args)?)?;
    let before = net.problem.values.clone();
    let (begin, cpu) = (Instant::now(), cpu_s());
    let setup = Setup::of(args);
    let free = net.problem.unknown_count() <= MOST_UNKNOWNS;
    let solution = if free { small(&mut net)? } else { large(&mut net, &setup)? };
    let solve_s = begin.elapsed().as_secs_f64();
    #[allow(clippy::cast_precision_loss)] // few enough
    let m0 = (solution.chi2 / solution.dof.max(1) as f64).sqrt();
    let scale = if net.net.a_posteriori && solution.dof > 0 { m0 } else { 1.0 };
    let mut stations = Vec::new();
    for (k, station) in net.net.stations.iter().enumerate() {
        let mut sigmas = Vec::new();
        for id in [net.places[k], net.heights[k]].into_iter().flatten().filter(|id| !net.problem.is_fixed(*id)) {
            sigmas.extend((solution.sigmas)(id).iter().map(|s| s * scale));
        }
        stations.push(
            serde_json::json!({ "name": station.name, "coordinates_m": net.coordinates_m(k), "sigmas_m": sigmas }),
        );
    }
    let value = serde_json::json!({
        "method": if free { "dense" } else { method_name(args.method) },
        "convention": "plain",
        "chi2": solution.chi2,
        "dof": solution.dof,
        "defect": solution.defect,
        "iterations": solution.iterations,
        "sigma0": m0,
        "m0": m0 * net.net.sigma_apriori,
        "sum_of_squares": solution.chi2 * net.net.sigma_apriori.powi(2),
        "solve_s": solve_s,
        "solve_cpu_s": cpu_s() - cpu,
        "total_cpu_s": cpu_s(),
        "peak_memory_bytes": peak_bytes(),
        "stations": stations,
        "suspects": suspects(&net, &solution, scale),
    });
    if let Some(folder) = &args.out {
        super::output::net(folder, &net, &before, &value)?;
    }
    if common.json {
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        writeln!(
            out,
            "chi2 {:.6} with {} degrees of freedom, datum defect {}, sigma0 {m0:.4}, {} iterations",
            solution.chi2, solution.dof, solution.defect, solution.iterations
        )?;
        for suspect in value["suspects"].as_array().into_iter().flatten() {
            writeln!(out, "suspect: {suspect}")?;
        }
    }
    Ok(())
}

/// A net that fits densely: its defect is found, its datum may be free.
fn small(net: &mut GeodeticNet) -> Result<Solution> {
    let solved = free_net::solve(&mut net.problem, &net.datum)?;
    // redundancies by the selected inverse, where the datum is held
    let checks = if solved.defect == 0 {
        let setup = tieline_graph::nonlinear::SolveOptions::default();
        let mut system = System::new(&net.problem, setup.order, setup.partition, setup.method)?;
        Some(covariances(&net.problem, &mut system, &Kernel::None, true)?)
    } else {
        None
    };
    let (scalar, cofactors) = (solved.scalar, solved.cofactors);
    let dimensions: Vec<usize> = net.problem.variables().map(|v| net.problem.values.kind(v).dimension()).collect();
    let sigmas = move |id: VariableId| -> Vec<f64> {
        let start = scalar[id.index()];
        start.map_or_else(Vec::new, |s| {
            (s..s + dimensions[id.index()]).map(|k| cofactors[(k, k)].max(0.0).sqrt()).collect()
        })
    };
    Ok(Solution {
        chi2: solved.cost,
        dof: solved.degrees_of_freedom,
        defect: solved.defect,
        iterations: solved.iterations,
        sigmas: Box::new(sigmas),
        checks,
    })
}

/// A net with a datum, by Helmert blocking.
fn large(net: &mut GeodeticNet, setup: &Setup) -> Result<Solution> {
    let outcome = super::solve::adjust_net(&mut net.problem, &Setup { sigmas: false, ..setup.clone() })?;
    // sigmas and tests by the selected inverse, which the reference does not have
    let setup = Setup { method: GraphMethod::Helmert, ..setup.clone() };
    let (mut system, _temporary) = setup.system(&net.problem, &setup.options(Kernel::None))?;
    let checks = covariances(&net.problem, &mut system, &Kernel::None, true)?;
    if let Some(disk) = system.on_disk() {
        disk.delete();
    }
    let sigmas: Vec<Vec<f64>> = net.problem.variables().map(|id| checks.sigmas(id)).collect();
    Ok(Solution {
        chi2: outcome.solved.cost,
        dof: outcome.solved.degrees_of_freedom,
        defect: 0,
        iterations: outcome.solved.iterations,
        sigmas: Box::new(move |id| sigmas[id.index()].clone()),
        checks: Some(checks),
    })
}

/// Observations whose test value is beyond Baarda's 3.29, the worst first.
fn suspects(net: &GeodeticNet, solution: &Solution, scale: f64) -> Vec<serde_json::Value> {
    let Some(checks) = &solution.checks else { return Vec::new() };
    let mut list: Vec<(f64, serde_json::Value)> = Vec::new();
    for (factor, check) in net.problem.factors().zip(&checks.checks) {
        for (row, test) in check.tests().iter().enumerate() {
            let Some(w) = test.map(|w| w / scale).filter(|w| *w > 3.29) else { continue };
            let names: Vec<String> = factor.variables().iter().map(|v| net.problem.name(*v)).collect();
            let value = serde_json::json!({
                "observation": factor.label(), "stations": names, "row": row, "test": w,
                "redundancy": check.redundancies[row], "external_reliability": check.external[row],
            });
            list.push((w, value));
        }
    }
    list.sort_by(|a, b| b.0.total_cmp(&a.0));
    list.into_iter().map(|(_, v)| v).collect()
}
