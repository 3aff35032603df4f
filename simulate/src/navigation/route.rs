//! A closed route and how it is driven or flown.

use nalgebra::{Vector2, Vector3};

use super::motion::Motion;
use super::process::normal3;
use super::spline::Spline;
use crate::random::Random;

/// A vehicle on a closed route.
#[derive(Debug, Clone, PartialEq)]
pub struct Vehicle {
    /// Latitude \[rad\], longitude \[rad\], height \[m\] of the route's origin.
    pub origin: Vector3<f64>,
    /// Corners of the route, north and east \[m\]; the route is smooth and stays inside of them.
    pub corners_m: Vec<[f64; 2]>,
    /// Highest speed \[m/s\].
    pub speed_mps: f64,
    /// Largest acceleration along the route \[m/s²\].
    pub acceleration_mps2: f64,
    /// Largest acceleration across the route \[m/s²\].
    pub lateral_mps2: f64,
    /// Amplitude of the route's height \[m\], two hills a lap.
    pub hill_m: f64,
    /// Stops: share of the lap and time stood there \[s\].
    pub stops: Vec<(f64, f64)>,
    /// Time stood at the beginning \[s\].
    pub first_rest_s: f64,
    /// Roll per acceleration to the right \[rad per m/s²\]: a car leans outwards, an aircraft inwards.
    pub roll_per_lateral: f64,
    /// Pitch per acceleration forward \[rad per m/s²\].
    pub pitch_per_forward: f64,
    /// Unevenness of the way: standard deviation of position \[m\] and attitude \[rad\] from one quarter of a second to the
    /// next, at full speed.
    pub unevenness: (f64, f64),
    /// What the platform trembles by at rest: the same.
    pub tremble: (f64, f64),
    /// Standard deviation of the place across the route from lap to lap \[m\].
    pub lane_m: f64,
}

/// Interval of the control points \[s\].
const KNOT_S: f64 = 0.25;
/// Control points beyond both ends.
const BEYOND: u32 = 6;
/// Spacing of the route's table \[m\].
const TABLE_M: f64 = 0.25;
/// Slowest approach to a stop \[m/s\].
const CREEP_MPS: f64 = 0.4;
/// Step of the speed \[s\].
const STEP_S: f64 = 0.01;

impl Vehicle {
    /// A car: 1.5 km through streets, two stops a lap, about three minutes.
    #[must_use]
    pub fn car() -> Self {
        Self {
            origin: Vector3::new(48.2_f64.to_radians(), 11.6_f64.to_radians(), 520.0),
            corners_m: vec![
                [0.0, 0.0],
                [80.0, 0.0],
                [160.0, 0.0],
                [240.0, 10.0],
                [320.0, 30.0],
                [400.0, 40.0],
                [440.0, 60.0],
                [450.0, 110.0],
                [440.0, 190.0],
                [450.0, 270.0],
                [420.0, 320.0],
                [340.0, 320.0],
                [300.0, 280.0],
                [230.0, 260.0],
                [180.0, 300.0],
                [90.0, 310.0],
                [10.0, 300.0],
                [-40.0, 260.0],
                [-50.0, 180.0],
                [-40.0, 100.0],
                [-50.0, 30.0],
            ],
            speed_mps: 12.0,
            acceleration_mps2: 1.5,
            lateral_mps2: 2.0,
            hill_m: 4.0,
            stops: vec![(0.3, 8.0), (0.75, 12.0)],
            first_rest_s: 60.0,
            roll_per_lateral: -0.005,
            pitch_per_forward: 0.005,
            unevenness: (0.004, 0.002),
            // 5 mm/s in velocity and 0.01° between two moments, as tieline_filter's StandstillModel has it
            tremble: (0.0018, 0.000_2),
            lane_m: 0.3,
        }
    }

    /// An aircraft: 12 km at 60 m/s, banked turns, no rest.
    #[must_use]
    pub fn aircraft() -> Self {
        let car = Self::car();
        Self {
            corners_m: car.corners_m.iter().map(|c| c.map(|v| 8.0 * v)).collect(),
            origin: car.origin + Vector3::new(0.0, 0.0, 1000.0),
            speed_mps: 60.0,
            acceleration_mps2: 1.0,
            lateral_mps2: 5.0,
            hill_m: 20.0,
            stops: Vec::new(),
            first_rest_s: 0.0,
            roll_per_lateral: 0.1,
            pitch_per_forward: 0.0,
            unevenness: (0.01, 0.002),
            tremble: (0.01, 0.002),
            lane_m: 3.0,
        }
    }

    /// The motion over a span of time.
    #[must_use]
    pub fn motion(&self, span_s: (f64, f64), seed: u64) -> Motion {
        let route = Route::new(&self.corners_m);
        let along = self.along(&route, span_s);
        let mut random = Random::new(seed, &[11]);
        let mut position = Vec::with_capacity(along.len());
        let mut angles = Vec::with_capacity(along.len());
        let lanes: Vec<f64> = (0..200).map(|_| random.normal() * self.lane_m).collect();
        let mut heading = route.at(along[0].0).1;
        for (k, (s, v)) in along.iter().enumerate() {
            let (place, direction, curvature) = route.at(*s);
            heading += wrapped(direction - heading);
            let turn = std::f64::consts::TAU * s / route.length_m;
            // from lap to lap the lane drifts, smoothly
            let lap = s / route.length_m;
            let lane = lane_at(&lanes, lap);
            let height = self.hill_m * ((2.0 * turn).sin() + 0.3 * (5.0 * turn).cos());
            let slope = self.hill_m * (2.0 * (2.0 * turn).cos() - 1.5 * (5.0 * turn).sin()) * std::f64::consts::TAU
                / route.length_m;
            let forward = if k > 0 { (v - along[k - 1].1) / KNOT_S } else { 0.0 };
            let quick = (v / self.speed_mps).clamp(0.0, 1.0);
            let rough = |a: (f64, f64), b: (f64, f64)| (a.0 + (b.0 - a.0) * quick, a.1 + (b.1 - a.1) * quick);
            let (uneven_m, uneven_rad) = rough(self.tremble, self.unevenness);
            let across = Vector2::new(-direction.sin(), direction.cos()) * lane;
            position
                .push(Vector3::new(place.x + across.x, place.y + across.y, -height) + normal3(&mut random) * uneven_m);
            let roll = self.roll_per_lateral * v * v * curvature + 0.01 * (7.0 * turn).sin();
            let pitch = slope.atan() + self.pitch_per_forward * forward;
            angles.push(Vector3::new(roll, pitch, heading) + normal3(&mut random) * uneven_rad);
        }
        let start_s = span_s.0 - f64::from(BEYOND) * KNOT_S;
        Motion::new(&self.origin, Spline::new(start_s, KNOT_S, position), Spline::new(start_s, KNOT_S, angles))
    }

    /// Place along the route \[m\] and speed \[m/s\] at every control point.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn along(&self, route: &Route, span_s: (f64, f64)) -> Vec<(f64, f64)> {
        let limit = self.speed_limits(route);
        let knots = ((span_s.1 - span_s.0) / KNOT_S).ceil() as u32 + 2 * BEYOND;
        let steps = (KNOT_S / STEP_S).round() as u32;
        let (mut s, mut v) = (0.0, if self.first_rest_s > 0.0 { 0.0 } else { self.speed_mps });
        let mut waiting_s = self.first_rest_s + f64::from(BEYOND) * KNOT_S;
        let mut last_stop = None;
        let mut out = Vec::new();
        for _ in 0..knots {
            out.push((s, v));
            for _ in 0..steps {
                if waiting_s > 0.0 {
                    waiting_s -= STEP_S;
                    continue;
                }
                let lap = (s / route.length_m).floor();
                let allowed = limit[((s - lap * route.length_m) / TABLE_M) as usize % limit.len()].max(CREEP_MPS);
                v += (allowed - v).clamp(-2.0 * self.acceleration_mps2 * STEP_S, self.acceleration_mps2 * STEP_S);
                s += v * STEP_S;
                for (number, (share, rest_s)) in self.stops.iter().enumerate() {
                    let at = share * route.length_m + lap * route.length_m;
                    if s >= at && s < at + 1.0 && last_stop != Some((lap as u64, number)) {
                        last_stop = Some((lap as u64, number));
                        waiting_s = *rest_s;
                        v = 0.0;
                    }
                }
            }
        }
        out
    }

    /// Highest speed along the route that bends and stops ahead allow.
    #[allow(clippy::cast_precision_loss)]
    fn speed_limits(&self, route: &Route) -> Vec<f64> {
        let n = route.table.len();
        let mut limit: Vec<f64> = (0..n)
            .map(|k| {
                let curvature = route.at(k as f64 * TABLE_M).2.abs();
                (self.lateral_mps2 / curvature.max(1e-9)).sqrt().min(self.speed_mps)
            })
            .collect();
        for (share, _) in &self.stops {
            let at = (share * route.length_m / TABLE_M).round();
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let at = at as usize % n;
            limit[at] = 0.0;
        }
        for k in (0..2 * n).rev() {
            let next = limit[(k + 1) % n];
            let reachable = (next * next + 2.0 * self.acceleration_mps2 * TABLE_M).sqrt();
            limit[k % n] = limit[k % n].min(reachable);
        }
        limit
    }
}

/// The lane of a moment, moving from one lap's to the next with the laps.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn lane_at(lanes: &[f64], lap: f64) -> f64 {
    let whole = lap.floor().max(0.0) as usize;
    let u = lap - lap.floor();
    let smooth = u * u * (3.0 - 2.0 * u);
    let lane = |k: usize| lanes[k % lanes.len()];
    lane(whole) * (1.0 - smooth) + lane(whole + 1) * smooth
}

/// An angle between -π and π.
fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
}

/// A closed curve: a periodic cubic B-spline, tabled by arc length.
struct Route {
    length_m: f64,
    /// Place and direction every [`TABLE_M`].
    table: Vec<(Vector2<f64>, f64)>,
}

impl Route {
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn new(corners_m: &[[f64; 2]]) -> Self {
        const FINE: usize = 2000;
        let n = corners_m.len();
        let place = |x: f64| {
            let (cell, u) = (x.floor() as usize, x - x.floor());
            let corner = |k: usize| Vector2::from(corners_m[(cell + k) % n]);
            let w = [
                (1.0 - u).powi(3),
                3.0 * u.powi(3) - 6.0 * u * u + 4.0,
                -3.0 * u.powi(3) + 3.0 * u * u + 3.0 * u + 1.0,
                u.powi(3),
            ];
            (0..4).map(|k| corner(k) * (w[k] / 6.0)).sum::<Vector2<f64>>()
        };
        let fine: Vec<Vector2<f64>> = (0..=n * FINE).map(|k| place(k as f64 / FINE as f64)).collect();
        let mut arc = vec![0.0];
        for pair in fine.windows(2) {
            arc.push(arc[arc.len() - 1] + (pair[1] - pair[0]).norm());
        }
        let length_m = arc[arc.len() - 1];
        let count = (length_m / TABLE_M).round() as usize;
        let mut table = Vec::with_capacity(count);
        let mut i = 0;
        for k in 0..count {
            let s = k as f64 * length_m / count as f64;
            while i + 2 < arc.len() && arc[i + 1] < s {
                i += 1;
            }
            let step = fine[i + 1] - fine[i];
            table.push((fine[i] + step * ((s - arc[i]) / (arc[i + 1] - arc[i])), step.y.atan2(step.x)));
        }
        Self { length_m, table }
    }

    /// Place \[m\], direction \[rad\] and curvature \[1/m\] at an arc length \[m\].
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn at(&self, s_m: f64) -> (Vector2<f64>, f64, f64) {
        let n = self.table.len();
        let spacing = self.length_m / n as f64;
        let x = s_m.rem_euclid(self.length_m) / spacing;
        let (i, u) = (x as usize % n, x - x.floor());
        let (a, b) = (&self.table[i], &self.table[(i + 1) % n]);
        let turn = wrapped(b.1 - a.1);
        let (before, after) = (self.table[(i + n - 8) % n].1, self.table[(i + 9) % n].1);
        (a.0 + (b.0 - a.0) * u, a.1 + turn * u, wrapped(after - before) / (17.0 * spacing))
    }
}
