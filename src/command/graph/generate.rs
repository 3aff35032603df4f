//! `graph generate`: nets of any size.

use std::io::Write;

use anyhow::Result;
use tieline_simulate::net::{NetKind, simulate_net};

use super::solve::{Setup, adjust_net};
use crate::cli::{Common, GraphGenerateArgs, GraphKind};
use crate::memory::peak_bytes;
use crate::net::simulated;

/// Makes a net, and adjusts it when asked to.
///
/// # Errors
/// When the folder cannot be written, or the net cannot be adjusted.
pub(super) fn run(args: &GraphGenerateArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let kind = match args.kind {
        GraphKind::Directions => NetKind::Directions,
        GraphKind::Baselines => NetKind::Baselines,
    };
    let (net, _) = simulate_net(args.stations, kind, args.seed);
    let stations = net.approximate_m.len();
    if !args.solve {
        writeln!(out, "{stations} stations: the net is not written; add --solve to adjust it")?;
        return Ok(());
    }
    let mut problem = simulated::problem(&net);
    drop(net);
    let setup = Setup {
        method: args.method,
        sections: crate::cli::GraphSections::Schur,
        leaf: args.leaf,
        memory: args.memory,
        blocks: args.blocks.clone(),
        sigmas: args.sigmas,
        iterations: args.iterations,
    };
    let outcome = adjust_net(&mut problem, &setup)?;
    let solved = &outcome.solved;
    let value = serde_json::json!({
        "stations": stations,
        "unknowns": problem.unknown_count(),
        "observations": problem.residual_count(),
        "chi2": solved.cost,
        "dof": solved.degrees_of_freedom,
        "iterations": solved.iterations,
        "order_s": solved.order_s,
        "factor_s": solved.factor_s,
        "substitute_s": solved.substitute_s,
        "assemble_s": solved.assemble_s,
        "solve_s": outcome.solve_s,
        "solve_cpu_s": outcome.solve_cpu_s,
        "covariance_s": outcome.covariance_s,
        "covariance_cpu_s": outcome.covariance_cpu_s,
        "resumed_blocks": outcome.resumed_blocks,
        "panel_numbers": outcome.panel_numbers,
        "flops": outcome.flops,
        "total_cpu_s": outcome.total_cpu_s,
        "peak_memory_bytes": peak_bytes(),
    });
    if common.json {
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        writeln!(
            out,
            "{stations} stations: chi2 {:.3}, {} degrees of freedom, {:.2} s",
            solved.cost, solved.degrees_of_freedom, outcome.solve_s
        )?;
    }
    Ok(())
}
