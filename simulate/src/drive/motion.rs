//! How the streets are driven: way, speed, stops, and the smooth motion of the IMU that follows from them.

use nalgebra::{Vector2, Vector3};
use tieline_filter::ned_from_body;

use super::axis::{Axis, Place, wrapped};
use super::network::Network;
use super::scenario::DriveScenario;
use crate::navigation::Motion;
use crate::navigation::spline::Spline;
use crate::random::Random;

/// Interval of the control points of the motion \[s\].
const KNOT_S: f64 = 0.1;
/// Control points before the begin and after the end.
const BEYOND: u32 = 8;
/// Spacing of the table of the way \[m\].
const TABLE_M: f64 = 0.25;
/// Steps of the table that a mean is taken over to both sides: a wheel is turned over 8 m.
const STEER: i32 = 16;
/// Slowest approach to a stop \[m/s\].
const CREEP_MPS: f64 = 0.2;
/// Step of the speed \[s\].
const STEP_S: f64 = 0.01;
/// Way over which the place in the lane wanders, and over which the speed does \[m\].
const LANE_M: f64 = 35.0;
const MOOD_M: f64 = 50.0;
/// Half the distance over which the ground tilts the vehicle, along and across \[m\].
const WHEELS_M: (f64, f64) = (1.3, 0.8);
/// Correlation time of pitching, rolling and heaving \[s\].
const SWAY_S: f64 = 0.7;
/// Roll per acceleration to the right, pitch per acceleration forward \[rad per m/s²\].
const LEAN: (f64, f64) = (-0.005, 0.005);
/// Recording goes on this long before the first lap and after the last \[s\].
const MARGIN_S: f64 = 1.0;

/// A drive.
#[derive(Debug, Clone)]
pub(super) struct Driven {
    /// The motion of the IMU.
    pub(super) motion: Motion,
    /// First and last moment of the data \[s of week\].
    pub(super) span_s: (f64, f64),
    /// First and last moment of each lap \[s of week\].
    pub(super) laps_s: Vec<(f64, f64)>,
    /// From the middle of the street to the lane \[m\].
    pub(super) lane_m: f64,
    way: Way,
    /// Way \[m\] and speed \[m/s\] at the control points.
    along: Vec<(f64, f64)>,
}

/// The vehicle's way, tabled.
#[derive(Debug, Clone)]
struct Way {
    places: Vec<Place>,
    length_m: f64,
}

/// A random function of a way, smooth over a length, mean 0 and standard deviation 1 at its knots.
struct Wander {
    knots: Vec<f64>,
    spacing_m: f64,
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative, and some thousand
fn whole(value: f64) -> usize {
    value.max(0.0) as usize
}

impl Wander {
    fn new(random: &mut Random, length_m: f64, spacing_m: f64) -> Self {
        let knots = (0..whole(length_m / spacing_m) + 3).map(|_| random.normal().clamp(-2.0, 2.0)).collect();
        Self { knots, spacing_m }
    }

    fn at(&self, way_m: f64) -> f64 {
        let x = (way_m / self.spacing_m).max(0.0);
        let k = whole(x).min(self.knots.len() - 2);
        let u = (x - x.floor()).clamp(0.0, 1.0);
        let smooth = u * u * (3.0 - 2.0 * u);
        self.knots[k] * (1.0 - smooth) + self.knots[k + 1] * smooth
    }
}

impl Way {
    #[allow(clippy::cast_precision_loss)] // some ten thousand
    fn new(axis: &Axis, lane_m: f64, lane_sd_m: f64, random: &mut Random) -> Self {
        let wander = Wander::new(random, axis.length_m, LANE_M);
        let driven = |way_m: f64| {
            let place = axis.at(way_m);
            place.point + place.right() * (lane_m + lane_sd_m * wander.at(way_m))
        };
        let count = whole(axis.length_m / TABLE_M) + 1;
        let steered: Vec<Vector2<f64>> = (-1..=i64::try_from(count).unwrap_or(i64::MAX))
            .map(|k| {
                let middle_m = k as f64 * TABLE_M;
                let sum: Vector2<f64> = (-STEER..=STEER).map(|j| driven(middle_m + f64::from(j) * TABLE_M)).sum();
                sum / f64::from(2 * STEER + 1)
            })
            .collect();
        let places = (1..=count)
            .map(|k| Place { point: steered[k], direction: (steered[k + 1] - steered[k - 1]).normalize() })
            .collect();
        Self { places, length_m: (count - 1) as f64 * TABLE_M }
    }

    fn at(&self, way_m: f64) -> Place {
        let x = way_m / TABLE_M;
        let k = whole(x).min(self.places.len() - 2);
        #[allow(clippy::cast_precision_loss)]
        let u = x - k as f64;
        let (a, b) = (&self.places[k], &self.places[k + 1]);
        Place {
            point: a.point + (b.point - a.point) * u,
            direction: (a.direction + (b.direction - a.direction) * u).normalize(),
        }
    }

    /// Curvature \[1/m\], positive to the right.
    fn curvature(&self, k: usize) -> f64 {
        let (a, b) = (k.saturating_sub(2), (k + 2).min(self.places.len() - 1));
        let heading = |p: &Place| p.direction.x.atan2(p.direction.y);
        #[allow(clippy::cast_precision_loss)]
        let length_m = (b - a) as f64 * TABLE_M;
        wrapped(heading(&self.places[b]) - heading(&self.places[a])) / length_m
    }
}

impl Driven {
    /// Drives the laps of a scenario that was checked.
    pub(super) fn new(scenario: &DriveScenario, network: &Network) -> Self {
        let options = &scenario.drive;
        let (axis, ends_m) = scenario.route();
        let mut random = Random::new(scenario.scene_seed, &[51]);
        let way = Way::new(&axis, options.lane_m, options.lane_sd_m, &mut random);
        let limit = speed_limits(&way, scenario, &mut random);
        let along = drive(&way, &limit, scenario);
        let start_s = scenario.start_s;
        #[allow(clippy::cast_precision_loss)]
        let time_of = |knot: usize| start_s + (knot as f64 - f64::from(BEYOND)) * KNOT_S;
        let moving = along.partition_point(|a| a.0 <= 0.0);
        let mut begin_s = time_of(moving) - MARGIN_S;
        let mut laps_s = Vec::new();
        for (number, end_m) in ends_m.iter().enumerate() {
            let is_last = number + 1 == ends_m.len();
            let knot = along.partition_point(|a| a.0 < if is_last { way.length_m - 0.5 } else { *end_m });
            let end_s = time_of(knot) + if is_last { 2.0 * MARGIN_S } else { 0.0 };
            laps_s.push((begin_s, end_s));
            begin_s = end_s;
        }
        let last_s = time_of(along.len() - 1 - BEYOND as usize);
        let motion = motion(&way, &along, scenario, network);
        Self { motion, span_s: (start_s, last_s), laps_s, lane_m: options.lane_m, way, along }
    }

    /// Number of the control point before a time, and the share of the interval.
    fn knot(&self, time_s: f64) -> (usize, f64) {
        let x = (time_s - self.span_s.0) / KNOT_S + f64::from(BEYOND);
        (whole(x).min(self.along.len() - 2), x - x.floor())
    }

    fn way_m(&self, time_s: f64) -> f64 {
        let (k, u) = self.knot(time_s);
        self.along[k].0 * (1.0 - u) + self.along[k + 1].0 * u
    }

    /// Where the vehicle is in its lane.
    pub(super) fn place_at(&self, time_s: f64) -> Place {
        self.way.at(self.way_m(time_s))
    }

    /// Where it will be some way later.
    pub(super) fn place_ahead(&self, time_s: f64, ahead_m: f64) -> Place {
        self.way.at((self.way_m(time_s) + ahead_m).min(self.way.length_m))
    }

    /// How fast it is.
    pub(super) fn speed_mps(&self, time_s: f64) -> f64 {
        self.along[self.knot(time_s).0].1
    }

    /// Length of the way \[m\].
    pub(super) fn length_m(&self) -> f64 {
        self.way.length_m
    }
}

/// Highest speed along the way that bends, mood and stops ahead allow.
#[allow(clippy::cast_precision_loss)]
fn speed_limits(way: &Way, scenario: &DriveScenario, random: &mut Random) -> Vec<f64> {
    let options = &scenario.drive;
    let mood = Wander::new(random, way.length_m, MOOD_M);
    let mut limit: Vec<f64> = (0..way.places.len())
        .map(|k| {
            let share = 1.0 - options.speed_changes * (0.5 + 0.5 * mood.at(k as f64 * TABLE_M)).clamp(0.0, 1.0);
            let bend_mps = (options.lateral_mps2 / way.curvature(k).abs().max(1e-9)).sqrt();
            bend_mps.min(options.speed_mps * share)
        })
        .collect();
    for stop in &options.stops {
        if let Some(limit) = limit.get_mut(whole(stop.way_m / TABLE_M)) {
            *limit = 0.0;
        }
    }
    let mut next = 0.0_f64;
    for limit in limit.iter_mut().rev() {
        *limit = limit.min((next * next + 2.0 * options.acceleration_mps2 * TABLE_M).sqrt());
        next = *limit;
    }
    limit
}

/// Way \[m\] and speed \[m/s\] at every control point.
fn drive(way: &Way, limit: &[f64], scenario: &DriveScenario) -> Vec<(f64, f64)> {
    let options = &scenario.drive;
    let mut stops = options.stops.clone();
    stops.sort_by(|a, b| a.way_m.total_cmp(&b.way_m));
    let mut next_stop = 0;
    let (mut s, mut v) = (0.0, 0.0);
    let mut waiting_s = options.first_rest_s + f64::from(BEYOND) * KNOT_S;
    let mut left_s = options.last_rest_s + 2.0 * f64::from(BEYOND) * KNOT_S;
    let mut along = Vec::new();
    while left_s > 0.0 {
        along.push((s, v));
        for _ in 0..whole((KNOT_S / STEP_S).round()) {
            if waiting_s > 0.0 {
                waiting_s -= STEP_S;
                continue;
            }
            if s >= way.length_m - 0.5 {
                v = 0.0;
                left_s -= STEP_S;
                continue;
            }
            let allowed = limit[whole(s / TABLE_M).min(limit.len() - 1)].max(CREEP_MPS);
            v += (allowed - v).clamp(-2.0 * options.acceleration_mps2 * STEP_S, options.acceleration_mps2 * STEP_S);
            s += v * STEP_S;
            if let Some(stop) = stops.get(next_stop)
                && s >= stop.way_m
            {
                next_stop += 1;
                waiting_s = stop.rest_s;
                v = 0.0;
            }
        }
    }
    along
}

/// The motion of the IMU: the vehicle stands on the road, leans in bends and when it brakes, sways and vibrates.
fn motion(way: &Way, along: &[(f64, f64)], scenario: &DriveScenario, network: &Network) -> Motion {
    let options = &scenario.drive;
    let mut random = Random::new(scenario.seed, &[52]);
    let mut normal = move || Vector3::new(random.normal(), random.normal(), random.normal());
    let axle_m = Vector3::from(scenario.vehicle.axle_lever_arm_m);
    let sway_rad = options.sway_deg.to_radians();
    let keep = (-KNOT_S / SWAY_S).exp();
    let (mut sway, mut heave) = (normal(), normal());
    let (mut position, mut angles) = (Vec::with_capacity(along.len()), Vec::with_capacity(along.len()));
    let mut heading: Option<f64> = None;
    for (k, (s, v)) in along.iter().enumerate() {
        let place = way.at(*s);
        let direction = place.direction.x.atan2(place.direction.y);
        let course = heading.map_or(direction, |h| h + wrapped(direction - h));
        heading = Some(course);
        let (ahead, right) = (place.direction * WHEELS_M.0, place.right() * WHEELS_M.1);
        let height_m = |offset: Vector2<f64>| network.road_height_m(&(place.point + offset));
        let climb = (height_m(ahead) - height_m(-ahead)) / (2.0 * WHEELS_M.0);
        let bank = (height_m(-right) - height_m(right)) / (2.0 * WHEELS_M.1);
        let curvature = way.curvature(whole(s / TABLE_M).min(way.places.len() - 1));
        let jolt_mps2 = if k > 0 { (v - along[k - 1].1) / KNOT_S } else { 0.0 };
        let forward_mps2 = jolt_mps2.clamp(-options.acceleration_mps2, options.acceleration_mps2);
        let quick = (v / options.speed_mps).clamp(0.0, 1.0);
        let spread = (1.0 - keep * keep).sqrt();
        sway = sway * keep + normal() * spread;
        heave = heave * keep + normal() * spread;
        let shake = options.vibration_m * (0.2 + 0.8 * quick);
        let roll = bank.atan() + LEAN.0 * v * v * curvature;
        let pitch = climb.atan() + LEAN.1 * forward_mps2;
        let turn = Vector3::new(roll, pitch, course)
            + sway.component_mul(&Vector3::new(1.0, 1.0, 0.1)) * (sway_rad * quick)
            + normal() * shake;
        let contact = Vector3::new(place.point.y, place.point.x, -height_m(Vector2::zeros()));
        // a hundredth of a metre a degree
        let rough = heave.component_mul(&Vector3::new(0.1, 0.1, 1.0)) * (0.01 * options.sway_deg * quick);
        position.push(contact - ned_from_body(turn.x, turn.y, turn.z) * axle_m + rough + normal() * shake);
        angles.push(turn);
    }
    let first_s = scenario.start_s - f64::from(BEYOND) * KNOT_S;
    Motion::new(&scenario.origin_rad(), Spline::new(first_s, KNOT_S, position), Spline::new(first_s, KNOT_S, angles))
}
