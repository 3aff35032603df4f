//! Line 8: a block of 1,000 strips.

use anyhow::Result;
use tieline::memory::peak_bytes;
use tieline::net::strip_block;
use tieline_graph::VariableId;
use tieline_graph::covariance::selected;
use tieline_graph::helmert::out_of_core::Disk;
use tieline_graph::helmert::partition::PartitionOptions;
use tieline_graph::nonlinear::{SolveOptions, solve_system};
use tieline_graph::system::{Method, Order, System};
use tieline_simulate::block::{BlockOptions, simulate_block};

use super::super::Row;
use tieline::cpu::of_living_threads_s as cpu_s;

/// Line 8, in a process of its own for its memory: `prove graph --only 8`.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let small = BlockOptions { strips: 40, cross_strips: 3, knots: 40, ties: 16_000, seed: 11 };
    let mut rows = adjust("40 strips", &small, 8 << 20, true)?;
    let large = BlockOptions { strips: 1000, cross_strips: 10, knots: 200, ties: 1_000_000, seed: 5 };
    rows.extend(adjust("1,000 strips", &large, 96 << 20, false)?);
    Ok(rows)
}

#[allow(clippy::cast_precision_loss)]
fn adjust(name: &str, options: &BlockOptions, group_bytes: usize, knots_too: bool) -> Result<Vec<Row>> {
    let (block, truth) = simulate_block(options);
    let mut problem = strip_block::problem(&block, options.knots);
    drop(block);
    let folder = tempfile::tempdir()?;
    let disk = Disk { folder: folder.path().to_path_buf(), group_bytes };
    let solver = SolveOptions { method: Method::HelmertOnDisk(disk), ..SolveOptions::default() };
    let begin = cpu_s();
    let mut system = System::new(&problem, Order::Places, PartitionOptions::default(), solver.method.clone())?;
    println!(
        "{name}: {} unknowns, {} observations; {:.1} G multiplications, panels of {:.2} GB",
        problem.unknown_count(),
        problem.residual_count(),
        system.tree.flops() / 1e9,
        8e-9 * system.tree.panel_numbers() as f64
    );
    let solved = solve_system(&mut problem, &mut system, &solver)?;
    let each = (cpu_s() - begin - system.order_s) / solved.iterations as f64 + system.order_s;
    let mut rows = vec![
        Row::at_most(format!("{name}: order, linearise, factorise, solve once, CPU"), each, 60.0, "s"),
        Row::at_most(format!("{name}: iterations"), solved.iterations as f64, 4.0, ""),
    ];
    let freedom = solved.degrees_of_freedom as f64;
    // priors are observations: chi2 over the degrees of freedom is 1 within its scatter
    let off = (solved.cost / freedom - 1.0).abs() / (2.0 / freedom).sqrt();
    rows.push(Row::at_most(format!("{name}: chi2 over degrees of freedom off 1, in sigmas"), off, 4.0, ""));
    for row in &rows {
        row.print();
    }
    let covariances = selected(&problem, &system, false)?;
    let mut inside = (0.0, 0.0);
    let mut count = |estimate: &[f64], sigmas: &[f64], truth: &[f64]| {
        for ((e, s), t) in estimate.iter().zip(sigmas).zip(truth) {
            inside.0 += f64::from(u8::from((e - t).abs() <= 1.959_964 * s));
            inside.1 += 1.0;
        }
    };
    let calibration = VariableId(u32::try_from(truth.knots.len())?);
    count(problem.values.get(calibration), &covariances.sigmas(calibration), &truth.calibration);
    for (k, knot) in truth.knots.iter().enumerate() {
        let id = VariableId(u32::try_from(k)?);
        count(problem.values.get(id), &covariances.sigmas(id), knot);
    }
    let share = 100.0 * inside.0 / inside.1;
    rows.push(Row::between(format!("{name}: of {} values inside the 95 % interval", inside.1), share, 90.0, 99.0, "%"));
    if !knots_too {
        rows.push(Row::at_most(format!("{name}: peak resident memory"), peak_bytes() as f64 / 1e9, 2.0, "GB"));
    }
    Ok(rows)
}
