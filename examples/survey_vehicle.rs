//! A survey vehicle maps two blocks of houses, with a gyro that drifts and a sensor that is not where the drawing says.
//!
//!     cargo run --release --example survey_vehicle
//!
//! The same sightings make an explicit map (landmarks are unknowns) and an implicit one (links of submaps), with and
//! without the error of the heading rate and the place of the sensor as unknowns. docs/graph.md has the equations.

#![allow(clippy::print_stdout)] // an example shows what it finds

use anyhow::{Context, Result};
use tieline::net::survey_vehicle::{LinkUse, VehicleGraph, VehicleModel, explicit_map, implicit_map, submap_links};
use tieline_graph::covariance::covariances;
use tieline_graph::nonlinear::{SolveOptions, solve_system};
use tieline_graph::robust::Kernel;
use tieline_graph::system::System;
use tieline_simulate::survey_vehicle::{Route, VehicleTruth, simulate_vehicle};

fn main() -> Result<()> {
    // what the vehicle measured, and the truth, which no graph is shown
    let (drive, truth) = simulate_vehicle(Route::FigureOfEight(2), 1);
    let links = submap_links(&drive, LinkUse::Once);
    let linked: usize = links.iter().map(|l| l.registered.degrees_of_freedom + 3).sum();
    println!("{} poses, {} landmarks, {} sightings", truth.poses.len(), drive.landmarks, drive.sightings.len());
    println!("{} links of submaps from {linked} of the sightings\n", links.len());
    println!("map       rate  sensor  unknowns  chi2/dof  rms, m  NEES of the last pose (3)");
    for (rate, mount) in [(true, true), (false, true), (true, false), (false, false)] {
        let model = VehicleModel { rate, mount, ..VehicleModel::default() };
        report("explicit", model, explicit_map(&drive, model)?, &truth)?;
        report("implicit", model, implicit_map(&drive, &links, model)?, &truth)?;
    }
    Ok(())
}

/// Adjusts a graph and compares it with the truth.
fn report(map: &str, model: VehicleModel, mut graph: VehicleGraph, truth: &VehicleTruth) -> Result<()> {
    let options = SolveOptions::default();
    let mut system = System::new(&graph.problem, options.order, options.partition, options.method.clone())?;
    let solved = solve_system(&mut graph.problem, &mut system, &options)?;
    let covariances = covariances(&graph.problem, &mut system, &Kernel::None, false)?;

    let estimate = &graph.problem.values;
    let mut true_values = estimate.clone();
    graph.poses.iter().zip(&truth.poses).for_each(|(id, pose)| true_values.get_mut(*id).copy_from_slice(pose));
    let square_m2: f64 = graph.poses.iter().map(|id| (estimate.xy(*id) - true_values.xy(*id)).norm_squared()).sum();
    let last = *graph.poses.last().context("a drive has poses")?;
    let nees = covariances.normalised_square(last, &estimate.tangent_to(last, &true_values));
    println!(
        "{map}  {:>4}  {:>6}  {:>8}  {:>8.3}  {:>6.3}  {:.1}",
        if model.rate { "yes" } else { "no" },
        if model.mount { "yes" } else { "no" },
        graph.problem.unknown_count(),
        solved.cost / f64::from(i32::try_from(solved.degrees_of_freedom)?),
        (square_m2 / f64::from(u32::try_from(graph.poses.len())?)).sqrt(),
        nees.context("the last pose is free")?
    );
    Ok(())
}
