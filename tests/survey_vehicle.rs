//! What a survey vehicle cannot see, named: straight on, with turns, without control, without sightings.

#![allow(clippy::unwrap_used)] // a test may

use std::collections::BTreeSet;

use tieline::net::survey_vehicle::{
    LinkUse, VehicleGraph, VehicleModel, explicit_map, implicit_map, pinch, submap_links,
};
use tieline_graph::covariance::covariances;
use tieline_graph::nonlinear::{SolveOptions, solve, solve_system};
use tieline_graph::robust::Kernel;
use tieline_graph::system::{System, SystemError};
use tieline_graph::undetermined::{Undetermined, undetermined};
use tieline_simulate::survey_vehicle::{MOUNT_SIGMAS, Route, VehicleDrive, simulate_vehicle};

const STRAIGHT: Route = Route::Straight(20);
const TURNS: Route = Route::FigureOfEight(1);
/// No tolerances of the maker: what the drive alone determines.
const ALONE: VehicleModel = VehicleModel { rate: true, mount: true, start_known: true, tolerances: false };

fn explicit(drive: &VehicleDrive, model: VehicleModel) -> VehicleGraph {
    explicit_map(drive, model).unwrap()
}

fn implicit(drive: &VehicleDrive, model: VehicleModel) -> VehicleGraph {
    implicit_map(drive, &submap_links(drive, LinkUse::Once), model).unwrap()
}

/// A graph at its solution with the tolerances of the makers, then examined without them.
fn examined(with: impl Fn(VehicleModel) -> VehicleGraph, model: VehicleModel) -> (Vec<Undetermined>, VehicleGraph) {
    let mut solved = with(VehicleModel { tolerances: true, start_known: true, ..model });
    solve(&mut solved.problem, &SolveOptions::default()).unwrap();
    let mut graph = with(model);
    graph.problem.values = solved.problem.values;
    let found = undetermined(&graph.problem, pinch(&graph)).unwrap();
    (found, graph)
}

/// The kinds of unknowns in all combinations: the first word of their names, and the component.
fn named(found: &[Undetermined], graph: &VehicleGraph) -> BTreeSet<String> {
    let of = |f: &Undetermined| f.members.iter().map(|m| (m.variable, m.component)).collect::<Vec<_>>();
    let word = |(id, component)| {
        if id == graph.mount {
            return format!("mount {component}");
        }
        let name = graph.problem.name(id);
        name.split(' ').next().unwrap_or_default().to_string()
    };
    found.iter().flat_map(of).map(word).collect()
}

fn set(words: &[&str]) -> BTreeSet<String> {
    words.iter().map(|w| (*w).to_string()).collect()
}

/// Straight on for ten seconds: forward and left of the sensor, whatever hides them, and a rate common to all steps,
/// which bends the way and what is mapped from it, known no better than its maker knows it.
fn hidden_straight_on(found: &[Undetermined], graph: &VehicleGraph, with_offset: &[&str], with_rate: &[&str]) {
    assert_eq!(found.len(), 3);
    for (component, f) in found[..2].iter().enumerate() {
        assert!(f.leading().variable == graph.mount && f.leading().component == component && f.sigma > 10.0, "{f:?}");
    }
    assert_eq!(named(&found[..2], graph), set(&[&["mount 0", "mount 1"], with_offset].concat()));
    assert_eq!(named(&found[2..], graph), set(&[&["rate", "pose"], with_rate].concat()));
    assert!(found[2].sigma < 20.0, "known badly, but not unknown: {}", found[2].sigma);
}

#[test]
fn straight_on_the_offset_of_the_sensor_hides_in_the_map() {
    let (drive, _) = simulate_vehicle(STRAIGHT, 1);
    let (found, graph) = examined(|m| explicit(&drive, m), ALONE);
    hidden_straight_on(&found, &graph, &["landmark"], &["landmark"]);
}

#[test]
fn straight_on_links_of_submaps_do_not_see_the_offset_at_all() {
    let (drive, _) = simulate_vehicle(STRAIGHT, 1);
    let (found, graph) = examined(|m| implicit(&drive, m), ALONE);
    hidden_straight_on(&found, &graph, &[], &[]);
}

#[test]
fn turns_determine_everything() {
    let (drive, _) = simulate_vehicle(TURNS, 1);
    assert!(examined(|m| explicit(&drive, m), ALONE).0.is_empty());
    assert!(examined(|m| implicit(&drive, m), ALONE).0.is_empty());
}

#[test]
fn without_control_the_datum_is_free_and_nothing_else() {
    let (drive, _) = simulate_vehicle(TURNS, 1);
    let model = VehicleModel { start_known: false, ..ALONE };
    let (found, graph) = examined(|m| explicit(&drive, m), model);
    assert_eq!((found.len(), named(&found, &graph)), (3, set(&["pose", "landmark"])));
    let (found, graph) = examined(|m| implicit(&drive, m), model);
    assert_eq!((found.len(), named(&found, &graph)), (3, set(&["pose"])));
    assert!(found.iter().all(|f| f.sigma > 1e3), "nothing at all holds it");
}

#[test]
fn without_sightings_a_common_rate_bends_the_way_and_the_sensor_is_anywhere() {
    let (mut drive, _) = simulate_vehicle(STRAIGHT, 1);
    drive.sightings.clear();
    let (found, graph) = examined(|m| implicit(&drive, m), ALONE);
    assert_eq!(found.len(), 4);
    assert_eq!(named(&found, &graph), set(&["mount 0", "mount 1", "mount 2", "rate", "pose"]));
}

#[test]
fn the_solver_names_the_sensor_of_a_drive_that_is_straight_to_the_last_digit() {
    let (mut drive, _) = simulate_vehicle(STRAIGHT, 1);
    drive.readings.iter_mut().for_each(|r| r.turn_rad = 0.0);
    for mut graph in [explicit(&drive, ALONE), implicit(&drive, ALONE)] {
        let error = solve(&mut graph.problem, &SolveOptions::default()).unwrap_err();
        assert!(matches!(&error, SystemError::NotDetermined { name } if name == "sensor on vehicle"), "{error}");
    }
}

#[test]
fn sigmas_of_the_offset_are_the_makers_straight_on_and_far_better_with_turns() {
    for (route, bounds) in [(STRAIGHT, [0.7, 1.0]), (TURNS, [0.0, 0.1])] {
        let (drive, _) = simulate_vehicle(route, 2);
        let mut graph = explicit(&drive, VehicleModel::default());
        let options = SolveOptions::default();
        let mut system = System::new(&graph.problem, options.order, options.partition, options.method.clone()).unwrap();
        solve_system(&mut graph.problem, &mut system, &options).unwrap();
        let sigmas = covariances(&graph.problem, &mut system, &Kernel::None, false).unwrap().sigmas(graph.mount);
        for k in 0..2 {
            let share = sigmas[k] / MOUNT_SIGMAS[k];
            assert!((bounds[0]..=bounds[1]).contains(&share), "{route:?}: {share}");
        }
    }
}
