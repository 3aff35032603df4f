//! A simulated drive of a survey vehicle as a graph: with landmarks as variables (an explicit map), or with links of
//! submaps (an implicit map).

use std::collections::HashMap;

use nalgebra::{Matrix2, Matrix3};
use tieline_graph::factor::motion::{ArcMotion, ArcReading, ArcSigmas, along_arc};
use tieline_graph::factor::mounted::{MountedBetween2, MountedSighting2};
use tieline_graph::factor::pose2::Prior2;
use tieline_graph::factor::vector::{RandomWalk, ScalarPrior};
use tieline_graph::factor::{Convention, NotPositiveDefinite};
use tieline_graph::registration::{Registered, Seen, register};
use tieline_graph::{Kind, Problem, VariableId};
use tieline_simulate::survey_vehicle::{
    BEARING_SIGMA_RAD, LandmarkSighting, MOUNT_SIGMAS, NOMINAL_MOUNT, ODOMETER_SIGMA_M, RANGE_SIGMA_M,
    RATE_SIGMA_RADPS, RATE_STEP_SIGMA_RADPS, SLIP_SIGMA_M, STEP_S, TURN_SIGMA_RAD, VehicleDrive,
};

/// What is estimated and what is known beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VehicleModel {
    /// The error of the heading rate is an unknown of every step, not zero.
    pub rate: bool,
    /// The place of the sensor on the vehicle is an unknown, not the nominal one.
    pub mount: bool,
    /// The first pose is held: without it the datum is free.
    pub start_known: bool,
    /// The maker's tolerances of gyro and mounting are observations.
    pub tolerances: bool,
}

impl Default for VehicleModel {
    fn default() -> Self {
        Self { rate: true, mount: true, start_known: true, tolerances: true }
    }
}

/// The graph of a drive.
#[derive(Debug)]
pub struct VehicleGraph {
    /// Variables and factors.
    pub problem: Problem,
    /// Poses in their order.
    pub poses: Vec<VariableId>,
    /// Error of the heading rate in each step \[rad/s\].
    pub rates: Vec<VariableId>,
    /// Place of the sensor on the vehicle, one for the whole drive.
    pub mount: VariableId,
    /// Landmarks by their number; nothing where one was not seen, nothing at all in an implicit map.
    pub landmarks: Vec<Option<VariableId>>,
}

impl VehicleGraph {
    /// Poses, rates and mount, dead reckoned: what both maps have in common.
    fn new(drive: &VehicleDrive, model: VehicleModel) -> Result<Self, NotPositiveDefinite> {
        let mut problem = Problem::new();
        let mut at = drive.start;
        let mut poses = vec![problem.add_variable(Kind::Pose2, &at)];
        let mut rates: Vec<VariableId> = Vec::new();
        let sigmas = ArcSigmas { along_m: ODOMETER_SIGMA_M, across_m: SLIP_SIGMA_M, turn_rad: TURN_SIGMA_RAD };
        for (k, reading) in drive.readings.iter().enumerate() {
            at = along_arc(at, reading.way_m, reading.turn_rad);
            // the node of a pose is x, y, heading, rate
            rates.push(problem.add_attached(poses[k], Kind::Scalar, &[0.0]));
            problem.set_name(rates[k], format!("rate {k}"));
            poses.push(problem.add_variable(Kind::Pose2, &at));
            let reading = ArcReading { way_m: reading.way_m, turn_rad: reading.turn_rad, duration_s: STEP_S };
            problem.add(ArcMotion::new([poses[k], rates[k], poses[k + 1]], reading, sigmas));
            if k > 0 {
                problem.add(RandomWalk::new([rates[k - 1], rates[k]], &[RATE_STEP_SIGMA_RADPS]));
            }
        }
        for (k, pose) in poses.iter().enumerate() {
            problem.set_name(*pose, format!("pose {k}"));
        }
        let mount = problem.add_variable(Kind::Pose2, &NOMINAL_MOUNT);
        problem.set_name(mount, "sensor on vehicle");
        problem.set_global(mount);
        if model.tolerances {
            let information = Matrix3::from_diagonal(&MOUNT_SIGMAS.map(|s| 1.0 / (s * s)).into());
            problem.add(Prior2::new(mount, NOMINAL_MOUNT, &information)?);
            if let Some(first) = rates.first() {
                problem.add(ScalarPrior::new(*first, 0, 0.0, RATE_SIGMA_RADPS));
            }
        }
        problem.set_fixed(poses[0], model.start_known);
        problem.set_fixed(mount, !model.mount);
        rates.iter().for_each(|rate| problem.set_fixed(*rate, !model.rate));
        Ok(Self { problem, poses, rates, mount, landmarks: Vec::new() })
    }
}

/// A sighting in the frame of the sensor.
fn seen(sighting: &LandmarkSighting) -> Seen {
    let LandmarkSighting { range_m, bearing_rad, .. } = *sighting;
    Seen::from_range_bearing(range_m, bearing_rad, RANGE_SIGMA_M, range_m * BEARING_SIGMA_RAD)
}

/// The drive with an explicit map: every landmark a variable, every sighting a factor.
///
/// # Errors
/// [`NotPositiveDefinite`] when a sighting has a range of zero.
pub fn explicit_map(drive: &VehicleDrive, model: VehicleModel) -> Result<VehicleGraph, NotPositiveDefinite> {
    let mut graph = VehicleGraph::new(drive, model)?;
    graph.landmarks = vec![None; drive.landmarks];
    for sighting in &drive.sightings {
        let Seen { place_m, covariance_m2 } = seen(sighting);
        let problem = &mut graph.problem;
        let pose = graph.poses[sighting.pose];
        let landmark = *graph.landmarks[sighting.landmark].get_or_insert_with(|| {
            // first value: where dead reckoning and the nominal mounting put it
            let sensor_m = place_m + nalgebra::Vector2::new(NOMINAL_MOUNT[0], NOMINAL_MOUNT[1]);
            let at = problem.values.xy(pose) + tieline_graph::rotation::turn(problem.values.get(pose)[2]) * sensor_m;
            let id = problem.add_variable(Kind::Point2, &[at.x, at.y]);
            problem.set_name(id, format!("landmark {}", sighting.landmark));
            id
        });
        let information: Matrix2<f64> = covariance_m2.try_inverse().ok_or(NotPositiveDefinite)?;
        problem.add(MountedSighting2::new([pose, graph.mount, landmark], place_m, &information)?);
    }
    Ok(graph)
}

/// A link of two submaps: what the sensor saw from two poses, registered.
#[derive(Debug, Clone, PartialEq)]
pub struct SubmapLink {
    /// The poses.
    pub poses: [usize; 2],
    /// Relation of the sensor's frames, and its information.
    pub registered: Registered,
}

/// Which sightings a link may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkUse {
    /// Each sighting in one link: links are independent, and some sightings are left over.
    Once,
    /// Each sighting in every link of its pose: links share their errors, which the graph does not know.
    Again,
}

/// Steps between neighbours that are linked, and least steps between the ends of a loop.
const NEIGHBOUR_STEPS: usize = 1;
const LOOP_STEPS: usize = 60;
/// Least common landmarks of a link.
const LEAST_COMMON: usize = 3;

/// Links between neighbours and over loops, by registration of the landmarks that two poses have in common.
///
/// Where each sighting is used once, landmarks of even number link neighbours, those of odd number close loops.
#[must_use]
pub fn submap_links(drive: &VehicleDrive, using: LinkUse) -> Vec<SubmapLink> {
    let mut by_pose: Vec<HashMap<usize, Seen>> = vec![HashMap::new(); drive.readings.len() + 1];
    for sighting in &drive.sightings {
        by_pose[sighting.pose].insert(sighting.landmark, seen(sighting));
    }
    let once = using == LinkUse::Once;
    let common = |by_pose: &[HashMap<usize, Seen>], i: usize, j: usize, parity: usize| {
        let both = by_pose[i].keys().filter(|l| by_pose[j].contains_key(l) && (!once || **l % 2 == parity));
        let mut both: Vec<usize> = both.copied().collect();
        both.sort_unstable();
        both
    };
    let mut links = Vec::new();
    for j in 0..by_pose.len() {
        // of two loops that share as many landmarks the earlier one
        let loops = (0..j.saturating_sub(LOOP_STEPS)).map(|i| (i, common(&by_pose, i, j, 1)));
        let best = loops.max_by_key(|(i, both)| (both.len(), std::cmp::Reverse(*i)));
        let neighbour = j.checked_sub(NEIGHBOUR_STEPS).map(|i| (i, common(&by_pose, i, j, 0)));
        for (i, both) in [best, neighbour].into_iter().flatten().filter(|(_, both)| both.len() >= LEAST_COMMON) {
            let side = |pose: usize| -> Vec<Seen> { both.iter().map(|l| by_pose[pose][l]).collect() };
            let Ok(registered) = register(&side(i), &side(j)) else { continue };
            links.push(SubmapLink { poses: [i, j], registered });
            if once {
                for landmark in &both {
                    by_pose[i].remove(landmark);
                    by_pose[j].remove(landmark);
                }
            }
        }
    }
    links
}

/// The drive with an implicit map: links of submaps between poses, no landmark a variable.
///
/// # Errors
/// [`NotPositiveDefinite`] when the information of a link is none.
pub fn implicit_map(
    drive: &VehicleDrive,
    links: &[SubmapLink],
    model: VehicleModel,
) -> Result<VehicleGraph, NotPositiveDefinite> {
    let mut graph = VehicleGraph::new(drive, model)?;
    for link in links {
        let ids = [graph.poses[link.poses[0]], graph.poses[link.poses[1]], graph.mount];
        let Registered { second_in_first, information, .. } = &link.registered;
        graph.problem.add(MountedBetween2::new(ids, *second_in_first, information, Convention::Plain)?.as_tie(true));
    }
    Ok(graph)
}

/// What would do at a pinch of each unknown, to tell what a drive leaves undetermined: 2 m and 0.1 rad of poses and
/// landmarks, of gyro and mounting what their makers promise, which is what one knows without the drive.
pub fn pinch(graph: &VehicleGraph) -> impl Fn(VariableId, usize) -> f64 {
    let (mount, kinds) = (graph.mount, graph.problem.values.clone());
    move |id, component| match kinds.kind(id) {
        _ if id == mount => MOUNT_SIGMAS[component],
        Kind::Scalar => RATE_SIGMA_RADPS,
        Kind::Pose2 if component == 2 => 0.1,
        _ => 2.0,
    }
}
