//! A survey vehicle maps two blocks of houses: a gyro that drifts, a sensor that is not where the drawing says.
//!
//!     cargo run --release --example survey_vehicle
//!
//! The same sightings as an explicit map (landmarks are unknowns) and as an implicit one (links of submaps), with and
//! without the error of the heading rate and the place of the sensor as unknowns. See docs/graph.md.

#![allow(clippy::print_stdout)] // an example shows what it finds

use anyhow::Result;
use tieline::net::survey_vehicle::{LinkUse, VehicleGraph, VehicleModel, explicit_map, implicit_map, submap_links};
use tieline_graph::covariance::covariances;
use tieline_graph::nonlinear::{SolveOptions, solve_system};
use tieline_graph::robust::Kernel;
use tieline_graph::system::System;
use tieline_simulate::survey_vehicle::{Route, VehicleTruth, simulate_vehicle};

fn main() -> Result<()> {
    let (drive, truth) = simulate_vehicle(Route::FigureOfEight(2), 1);
    let links = submap_links(&drive, LinkUse::Once);
    println!(
        "{} poses, {} landmarks, {} sightings, {} links",
        truth.poses.len(),
        drive.landmarks,
        drive.sightings.len(),
        links.len()
    );
    for (rate, mount) in [(true, true), (false, true), (true, false), (false, false)] {
        let model = VehicleModel { rate, mount, ..VehicleModel::default() };
        report("explicit", explicit_map(&drive, model)?, &truth)?;
        report("implicit", implicit_map(&drive, &links, model)?, &truth)?;
    }
    Ok(())
}

/// Adjusts a graph and compares it with the truth, which the graph does not know.
fn report(name: &str, mut graph: VehicleGraph, truth: &VehicleTruth) -> Result<()> {
    let options = SolveOptions::default();
    let mut system = System::new(&graph.problem, options.order, options.partition, options.method.clone())?;
    let solved = solve_system(&mut graph.problem, &mut system, &options)?;
    let sigmas = covariances(&graph.problem, &mut system, &Kernel::None, false)?;

    let values = &graph.problem.values;
    let off_m = |(id, t): (_, &[f64; 3])| (values.xy(id) - nalgebra::Vector2::new(t[0], t[1])).norm_squared();
    let rms_m =
        (graph.poses.iter().copied().zip(&truth.poses).map(off_m).sum::<f64>() / truth.poses.len() as f64).sqrt();
    println!(
        "{name}: {} unknowns, {} iterations, chi2 {:.1} of {}, rms {rms_m:.3} m",
        graph.problem.unknown_count(),
        solved.iterations,
        solved.cost,
        solved.degrees_of_freedom
    );
    println!("  mount {:?} ± {:?}, truth {:?}", values.get(graph.mount), sigmas.sigmas(graph.mount), truth.mount);
    let far = graph.poses[truth.poses.len() / 4];
    println!("  pose ± {:?}", sigmas.sigmas(far));
    Ok(())
}
