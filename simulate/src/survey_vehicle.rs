//! A survey vehicle in the plane: an odometer, a gyro whose error drifts, and a sensor, a little off its nominal place,
//! that sights landmarks along the streets to either side.
//!
//! The vehicle drives in steps along arcs and slips a little to the side. The gyro shows the turn plus its error
//! (drawn when switched on, then a random walk, constant within a step) plus noise. The sensor knows ranges well and
//! bearings badly, as a wide beam does: of a house front abeam it knows the distance, not the place along the street.

use crate::random::Random;

/// What a drive is like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Route {
    /// Round two blocks of houses with a street in common, to the left round one and to the right round the other,
    /// so many times.
    FigureOfEight(usize),
    /// Straight on, so many steps.
    Straight(usize),
}

/// Time of a step \[s\].
pub const STEP_S: f64 = 0.5;
/// Sigma of the odometer over a step \[m\].
pub const ODOMETER_SIGMA_M: f64 = 0.01;
/// Sigma of the slip to the side over a step \[m\].
pub const SLIP_SIGMA_M: f64 = 0.005;
/// Sigma of the gyro's turn over a step, its drifting error apart \[rad\].
pub const TURN_SIGMA_RAD: f64 = 2.0e-4;
/// Sigma of the gyro's error when it is switched on \[rad/s\].
pub const RATE_SIGMA_RADPS: f64 = 1.5e-3;
/// Sigma of the change of the gyro's error over a step \[rad/s\].
pub const RATE_STEP_SIGMA_RADPS: f64 = 2.0e-5;
/// Nominal place of the sensor on the vehicle: forward, left \[m\], heading \[rad\].
pub const NOMINAL_MOUNT: [f64; 3] = [1.2, 0.0, 0.0];
/// Sigmas of the place of the sensor about the nominal one \[m, m, rad\].
pub const MOUNT_SIGMAS: [f64; 3] = [0.15, 0.15, 0.015];
/// Sigma of a range \[m\].
pub const RANGE_SIGMA_M: f64 = 0.03;
/// Sigma of a bearing \[rad\].
pub const BEARING_SIGMA_RAD: f64 = 0.015;
/// Nearest and farthest range \[m\].
const RANGES_M: [f64; 2] = [3.0, 20.0];
/// How far from abeam the sensor sees \[rad\].
const FROM_ABEAM_RAD: f64 = 0.6;
/// Way of a step on a street and in a corner \[m\].
const STREET_STEP_M: f64 = 4.0;
const CORNER_STEP_M: f64 = 2.5;
/// Steps of a corner.
const CORNER_STEPS: usize = 6;
/// A vehicle keeps to its lane within this heading, over so many steps.
const WEAVE_RAD: f64 = 2.5e-3;
const WEAVE_STEPS: f64 = 25.0;
/// Stream of random numbers.
const VEHICLE: u64 = 0x7665_6869;

/// What was read over a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepReading {
    /// Way by the odometer \[m\].
    pub way_m: f64,
    /// Turn by the gyro, to the left \[rad\].
    pub turn_rad: f64,
}

/// A landmark seen from a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandmarkSighting {
    /// Pose, by number.
    pub pose: usize,
    /// Landmark, by number.
    pub landmark: usize,
    /// Range \[m\].
    pub range_m: f64,
    /// Bearing from ahead, to the left \[rad\].
    pub bearing_rad: f64,
}

/// What a user has of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleDrive {
    /// Where it began: x, y \[m\], heading from the x axis to the left \[rad\].
    pub start: [f64; 3],
    /// A reading for each step, between pose `k` and pose `k + 1`.
    pub readings: Vec<StepReading>,
    /// Sightings in the order of the poses.
    pub sightings: Vec<LandmarkSighting>,
    /// Number of landmarks.
    pub landmarks: usize,
}

/// What a user never has.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleTruth {
    /// Poses: x, y \[m\], heading \[rad\].
    pub poses: Vec<[f64; 3]>,
    /// Error of the gyro in each step \[rad/s\].
    pub rates_radps: Vec<f64>,
    /// Place of the sensor on the vehicle: forward, left \[m\], heading \[rad\].
    pub mount: [f64; 3],
    /// Landmarks \[m\].
    pub landmarks_m: Vec<[f64; 2]>,
}

/// Simulates a drive.
#[must_use]
pub fn simulate_vehicle(route: Route, seed: u64) -> (VehicleDrive, VehicleTruth) {
    let mut random = Random::new(seed, &[VEHICLE]);
    let steps = plan(route);
    let start = [0.0, 0.0, std::f64::consts::FRAC_PI_2];
    let mut poses = vec![start];
    let mut rate = RATE_SIGMA_RADPS * random.normal();
    let (mut readings, mut rates_radps) = (Vec::new(), Vec::new());
    for (way_m, turn_rad) in steps {
        let slip_m = SLIP_SIGMA_M * random.normal();
        poses.push(moved(poses[poses.len() - 1], way_m, turn_rad, slip_m));
        readings.push(StepReading {
            way_m: way_m + ODOMETER_SIGMA_M * random.normal(),
            turn_rad: turn_rad + STEP_S * rate + TURN_SIGMA_RAD * random.normal(),
        });
        rates_radps.push(rate);
        rate += RATE_STEP_SIGMA_RADPS * random.normal();
    }
    let mount: [f64; 3] = std::array::from_fn(|k| NOMINAL_MOUNT[k] + MOUNT_SIGMAS[k] * random.normal());
    let landmarks_m = landmarks(&poses, &mut random);
    let mut sightings = Vec::new();
    for (pose, at) in poses.iter().enumerate() {
        let sensor = placed(*at, [mount[0], mount[1]]);
        for (landmark, place) in landmarks_m.iter().enumerate() {
            let (dx, dy) = (place[0] - sensor[0], place[1] - sensor[1]);
            let (range_m, bearing_rad) = (dx.hypot(dy), wrapped(dy.atan2(dx) - at[2] - mount[2]));
            let from_abeam = (bearing_rad.abs() - std::f64::consts::FRAC_PI_2).abs();
            if (RANGES_M[0]..RANGES_M[1]).contains(&range_m) && from_abeam < FROM_ABEAM_RAD {
                sightings.push(LandmarkSighting {
                    pose,
                    landmark,
                    range_m: range_m + RANGE_SIGMA_M * random.normal(),
                    bearing_rad: bearing_rad + BEARING_SIGMA_RAD * random.normal(),
                });
            }
        }
    }
    let drive = VehicleDrive { start, readings, sightings, landmarks: landmarks_m.len() };
    (drive, VehicleTruth { poses, rates_radps, mount, landmarks_m })
}

/// Way and turn of each step.
#[allow(clippy::cast_precision_loss)] // few steps
fn plan(route: Route) -> Vec<(f64, f64)> {
    let weave = |k: usize| WEAVE_RAD * (std::f64::consts::TAU * k as f64 / WEAVE_STEPS).sin();
    let mut steps = Vec::new();
    let street = |count: usize, steps: &mut Vec<(f64, f64)>| {
        let first = steps.len();
        // at both ends of a street the heading is that of the street
        let heading = |k: usize| if k == 0 || k == count { 0.0 } else { weave(k) };
        (0..count).for_each(|k| steps.push((STREET_STEP_M, heading(k + 1) - heading(k))));
        debug_assert_eq!(steps.len(), first + count);
    };
    match route {
        Route::Straight(count) => street(count, &mut steps),
        Route::FigureOfEight(laps) => {
            for block in 0..2 * laps {
                let side = if block % 2 == 0 { 1.0 } else { -1.0 };
                for count in [28, 20, 28, 20] {
                    street(count, &mut steps);
                    let turn_rad = side * std::f64::consts::FRAC_PI_2 / CORNER_STEPS as f64;
                    (0..CORNER_STEPS).for_each(|_| steps.push((CORNER_STEP_M, turn_rad)));
                }
            }
        }
    }
    steps
}

/// The pose after a step along an arc with a slip to the side of its chord.
fn moved(from: [f64; 3], way_m: f64, turn_rad: f64, slip_m: f64) -> [f64; 3] {
    let half = 0.5 * turn_rad;
    let chord = if half.abs() < 1e-6 { way_m } else { way_m * half.sin() / half };
    let middle = [from[0], from[1], from[2] + half];
    let [x, y] = placed(middle, [chord, slip_m]);
    [x, y, wrapped(from[2] + turn_rad)]
}

/// A point of the frame of a pose, in the map.
fn placed(pose: [f64; 3], point: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = pose[2].sin_cos();
    [pose[0] + cos * point[0] - sin * point[1], pose[1] + sin * point[0] + cos * point[1]]
}

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad.sin().atan2(angle_rad.cos())
}

/// Corners of house fronts and posts: to either side of the way, none on it, none beside another.
fn landmarks(poses: &[[f64; 3]], random: &mut Random) -> Vec<[f64; 2]> {
    let mut landmarks: Vec<[f64; 2]> = Vec::new();
    for pose in poses {
        for side in [-1.0, 1.0, -1.0, 1.0] {
            let at = placed(*pose, [random.between(-2.0, 2.0), side * random.between(7.0, 12.0)]);
            let distance = |p: &[f64]| (p[0] - at[0]).hypot(p[1] - at[1]);
            if landmarks.iter().all(|l| distance(l) > 2.5) && poses.iter().all(|p| distance(p) > 5.0) {
                landmarks.push(at);
            }
        }
    }
    landmarks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_of_eight_comes_back_to_its_start_within_the_slip() {
        let (drive, truth) = simulate_vehicle(Route::FigureOfEight(2), 3);
        let (first, last) = (truth.poses[0], truth.poses[truth.poses.len() - 1]);
        let slip = SLIP_SIGMA_M * f64::from(u32::try_from(drive.readings.len()).expect("few")).sqrt();
        assert!((last[0] - first[0]).hypot(last[1] - first[1]) < 5.0 * slip);
        assert!(wrapped(last[2] - first[2]).abs() < 1e-9);
        assert_eq!(truth.poses.len(), drive.readings.len() + 1);
    }

    #[test]
    fn landmarks_are_seen_again_when_a_street_is_driven_again() {
        let (drive, _) = simulate_vehicle(Route::FigureOfEight(2), 4);
        let again = |landmark: usize| {
            let mut poses = drive.sightings.iter().filter(|s| s.landmark == landmark).map(|s| s.pose);
            let first = poses.next();
            poses.any(|p| first.is_some_and(|f| p > f + 100))
        };
        let seen = (0..drive.landmarks).filter(|l| again(*l)).count();
        assert!(seen * 10 > drive.landmarks * 9, "{seen} of {}", drive.landmarks);
    }
}
