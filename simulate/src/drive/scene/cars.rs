//! Cars: parked at the curb during one pass, or on the other lane while the vehicle comes along.

use nalgebra::{Vector2, Vector3};

use super::material::Material;
use super::paint::steps;
use crate::drive::motion::Driven;
use crate::drive::network::Network;
use crate::drive::scene_options::SceneOptions;
use crate::random::Random;

/// Half length, half width \[m\].
const HALF_M: [f64; 2] = [2.15, 0.88];
/// Bottom, bonnet and roof over the ground \[m\].
const HEIGHTS_M: [f64; 3] = [0.22, 0.95, 1.48];
/// Cabin: from the middle, back and front \[m\].
const CABIN_M: [f64; 2] = [-1.7, 0.7];
/// From the middle of a street to the other lane \[m\].
const OTHER_LANE_M: f64 = 1.7;
/// How far ahead of the vehicle an oncoming car appears \[m\].
const APPEARS_M: f64 = 70.0;

/// A car at a moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Car {
    /// Middle, on the ground \[m\].
    pub(super) foot: Vector3<f64>,
    direction: Vector2<f64>,
    /// Velocity \[m/s\].
    pub(super) velocity_mps: Vector3<f64>,
    /// Reference time of the foot and the times between which it is there \[s\].
    time_s: f64,
    pub(super) there_s: (f64, f64),
}

impl Car {
    /// Where a ray meets it, at a time: distance \[m\] and normal.
    pub(super) fn cast(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        time_s: f64,
    ) -> Option<(f64, Vector3<f64>)> {
        if time_s < self.there_s.0 || time_s > self.there_s.1 {
            return None;
        }
        let foot = self.foot + self.velocity_mps * (time_s - self.time_s);
        let to_car = foot + Vector3::z() - origin;
        let along_m = to_car.dot(direction);
        if along_m < -3.0 || to_car.norm_squared() - along_m * along_m > 7.0 {
            return None;
        }
        let turn = |v: Vector3<f64>| {
            let d = self.direction;
            Vector3::new(v.x * d.x + v.y * d.y, v.y * d.x - v.x * d.y, v.z)
        };
        let (o, d) = (turn(origin - foot), turn(*direction));
        let body =
            (Vector3::new(-HALF_M[0], -HALF_M[1], HEIGHTS_M[0]), Vector3::new(HALF_M[0], HALF_M[1], HEIGHTS_M[1]));
        let cabin = (
            Vector3::new(CABIN_M[0], -0.85 * HALF_M[1], HEIGHTS_M[1]),
            Vector3::new(CABIN_M[1], 0.85 * HALF_M[1], HEIGHTS_M[2]),
        );
        let nearest = [body, cabin].iter().filter_map(|b| enter_box(&o, &d, b)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (x, y) = (nearest.1.x, nearest.1.y);
        let along = self.direction;
        Some((nearest.0, Vector3::new(x * along.x - y * along.y, x * along.y + y * along.x, nearest.1.z)))
    }

    pub(super) fn material(&self) -> Material {
        match self.velocity_mps.norm() > 0.0 {
            true => Material::MovingCar,
            false => Material::ParkedCar,
        }
    }
}

/// Where a ray enters a box, from outside.
fn enter_box(
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
    (low, high): &(Vector3<f64>, Vector3<f64>),
) -> Option<(f64, Vector3<f64>)> {
    let (mut enter, mut leave, mut normal) = (0.0, f64::INFINITY, Vector3::zeros());
    for axis in 0..3 {
        let (a, b) = ((low[axis] - origin[axis]) / direction[axis], (high[axis] - origin[axis]) / direction[axis]);
        if a.is_nan() || b.is_nan() {
            return None;
        }
        if a.min(b) > enter {
            enter = a.min(b);
            normal = Vector3::zeros();
            normal[axis] = -direction[axis].signum();
        }
        leave = f64::min(leave, a.max(b));
    }
    (enter > 0.0 && enter <= leave).then_some((enter, normal))
}

/// The cars parked during a pass, other ones in each.
pub(super) fn parked(network: &Network, options: &SceneOptions, seed: u64, pass: usize) -> Vec<Car> {
    let mut random = Random::new(seed, &[64, pass as u64]);
    let mut cars = Vec::new();
    for way in &network.ways {
        for side in [-1.0, 1.0] {
            for along_m in steps(way.axis.length_m, options.parked_spacing_m, &mut random) {
                let place = way.axis.at(along_m);
                let right_m = side * (way.half_width_m - HALF_M[1] - random.between(0.15, 0.35));
                let point = place.point + place.right() * right_m;
                let from_curb_m = network.across(&point).from_curb_m;
                // not where another street comes in, and not in the lanes of a narrow one
                if (from_curb_m + HALF_M[1] + 0.25).abs() > 0.3 || way.half_width_m < 4.6 || way.walled {
                    continue;
                }
                cars.push(Car {
                    foot: point.push(network.road_at_m(&point, from_curb_m)),
                    direction: place.direction,
                    velocity_mps: Vector3::zeros(),
                    time_s: 0.0,
                    there_s: (f64::NEG_INFINITY, f64::INFINITY),
                });
            }
        }
    }
    cars
}

/// Cars that come towards the vehicle on the other lane, every so often, wherever its way ahead is straight.
pub(super) fn oncoming(network: &Network, driven: &Driven, options: &SceneOptions, seed: u64) -> Vec<Car> {
    let mut random = Random::new(seed, &[65]);
    let mut cars = Vec::new();
    if options.traffic_s <= 0.0 {
        return cars;
    }
    let (start_s, end_s) = driven.span_s;
    let mut time_s = start_s + options.traffic_s * random.uniform();
    while time_s < end_s {
        let here = driven.place_at(time_s);
        let ahead = driven.place_ahead(time_s, APPEARS_M);
        if here.direction.dot(&ahead.direction) > 0.999
            && ((ahead.point - here.point).norm() - APPEARS_M).abs() < 0.5
            && driven.speed_mps(time_s) > 1.0
        {
            let left = Vector2::new(-here.direction.y, here.direction.x);
            let begin = ahead.point + left * (OTHER_LANE_M + driven.lane_m);
            let speed_mps = random.between(6.0, 11.0);
            let end = begin - here.direction * (2.0 * APPEARS_M);
            let (from, to) = (network.road_height_m(&begin), network.road_height_m(&end));
            let takes_s = 2.0 * APPEARS_M / speed_mps;
            let climb_mps = (to - from) / takes_s;
            cars.push(Car {
                foot: begin.push(from),
                direction: -here.direction,
                velocity_mps: (-here.direction * speed_mps).push(climb_mps),
                time_s,
                there_s: (time_s, time_s + takes_s),
            });
        }
        time_s += options.traffic_s * random.between(0.7, 1.3);
    }
    cars
}
