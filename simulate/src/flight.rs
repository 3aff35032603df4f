//! Flight lines and the true motion along them.

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};
use tieline_filter::{PositionFrame, Trajectory, TrajectoryError, ned_from_body};

use crate::random::Random;
use crate::scenario::{Area, Flight, Scenario};

/// The trajectory goes on this long before and after a line \[s\].
const MARGIN_S: f64 = 1.0;

/// A flight line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightLine {
    /// Number from 0; the strip of the line.
    pub number: u32,
    /// Begin of the line, east, north, up \[m\].
    pub from_m: Vector3<f64>,
    /// Course, clockwise from north \[rad\].
    pub course_rad: f64,
    /// Speed over ground \[m/s\].
    pub speed_mps: f64,
    /// First and last moment of recording \[s of week\].
    pub span_s: (f64, f64),
    motion: Motion,
}

/// Phases and sizes of the slow oscillations of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Motion {
    phase: [f64; 6],
    oscillation_rad: f64,
    crab_rad: f64,
    pitch_rad: f64,
}

/// A pose in the axes at the origin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LinePose {
    pub(crate) position_m: Vector3<f64>,
    pub(crate) ned_from_body: UnitQuaternion<f64>,
}

/// The lines of a scenario, one after the other in time.
pub(crate) fn lines(scenario: &Scenario) -> Vec<FlightLine> {
    let flight = &scenario.flight;
    let mut lines: Vec<FlightLine> = Vec::new();
    let mut start_s = scenario.start_s;
    for group in &flight.groups {
        for i in 0..group.lines {
            let right_m = group.offset_m + (f64::from(i) - 0.5 * f64::from(group.lines - 1)) * group.spacing_m;
            let first_course_rad = group.direction_deg.to_radians();
            let (sin, cos) = first_course_rad.sin_cos();
            let middle = Vector3::new(cos, -sin, 0.0) * right_m + Vector3::z() * group.height_m;
            let course_rad = first_course_rad + if i % 2 == 1 { std::f64::consts::PI } else { 0.0 };
            let half_m = half_length_m(&scenario.area, flight, course_rad);
            let number = u32::try_from(lines.len()).unwrap_or(u32::MAX);
            let end_s = start_s + 2.0 * half_m / flight.speed_mps;
            lines.push(FlightLine {
                number,
                from_m: middle - forward(course_rad) * half_m,
                course_rad,
                speed_mps: flight.speed_mps,
                span_s: (start_s, end_s),
                motion: Motion::new(scenario.seed, number, flight),
            });
            start_s = end_s + flight.turn_s + 2.0 * MARGIN_S;
        }
    }
    lines
}

/// Half the way over the area in a direction, with the way before and after \[m\].
fn half_length_m(area: &Area, flight: &Flight, course_rad: f64) -> f64 {
    let (sin, cos) = course_rad.sin_cos();
    0.5 * (area.east_m * sin.abs() + area.north_m * cos.abs()) + flight.lead_m
}

fn forward(course_rad: f64) -> Vector3<f64> {
    Vector3::new(course_rad.sin(), course_rad.cos(), 0.0)
}

impl Motion {
    fn new(seed: u64, line: u32, flight: &Flight) -> Self {
        let mut random = Random::new(seed, &[4, u64::from(line)]);
        let mut phase = [0.0; 6];
        phase.iter_mut().for_each(|p| *p = random.between(0.0, TAU));
        Self {
            phase,
            oscillation_rad: flight.oscillation_deg.to_radians(),
            crab_rad: flight.crab_deg.to_radians() * random.between(-1.0, 1.0),
            pitch_rad: random.between(1.0, 3.0_f64).to_radians(),
        }
    }
}

impl FlightLine {
    /// The true pose at a time \[s of week\]: smooth, with periods of 3 to 40 s.
    pub(crate) fn pose(&self, time_s: f64) -> LinePose {
        let t = time_s - self.span_s.0;
        let wave = |number: usize, period_s: f64| (TAU * t / period_s + self.motion.phase[number]).sin();
        let right = Vector3::new(self.course_rad.cos(), -self.course_rad.sin(), 0.0);
        let position_m = self.from_m
            + forward(self.course_rad) * (self.speed_mps * t)
            + right * (1.2 * wave(0, 37.0))
            + Vector3::z() * (0.8 * wave(1, 29.0));
        let size = self.motion.oscillation_rad;
        let roll = size * (0.7 * wave(2, 7.3) + 0.3 * wave(3, 3.1));
        let pitch = self.motion.pitch_rad + 0.5 * size * wave(4, 9.1);
        let heading = self.course_rad + self.motion.crab_rad + 0.5 * size * wave(5, 11.7);
        LinePose { position_m, ned_from_body: ned_from_body(roll, pitch, heading) }
    }

    /// Velocity north, east, down \[m/s\].
    pub(crate) fn velocity_ned_mps(&self, time_s: f64) -> Vector3<f64> {
        let step_s = 1e-3;
        let v = (self.pose(time_s + step_s).position_m - self.pose(time_s - step_s).position_m) / (2.0 * step_s);
        Vector3::new(v.y, v.x, -v.z)
    }

    /// Times \[s\] of the line's epochs: whole multiples of the interval, from a second before to a second after.
    pub(crate) fn epochs_s(&self, rate_hz: f64) -> impl Iterator<Item = f64> {
        let (first, last) =
            (((self.span_s.0 - MARGIN_S) * rate_hz).floor(), ((self.span_s.1 + MARGIN_S) * rate_hz).ceil());
        std::iter::successors(Some(first), |k| Some(k + 1.0)).take_while(move |k| *k <= last).map(move |k| k / rate_hz)
    }
}

/// A trajectory of all lines in east, north, up; `change` may alter the poses of a line.
pub(crate) fn trajectory(
    lines: &[FlightLine],
    rate_hz: f64,
    change: impl Fn(&FlightLine, f64, LinePose) -> LinePose,
) -> Result<Trajectory, TrajectoryError> {
    let (mut time_s, mut position, mut attitude, mut velocity) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for line in lines {
        for t in line.epochs_s(rate_hz) {
            let pose = change(line, t, line.pose(t));
            time_s.push(t);
            position.push(pose.position_m);
            attitude.push(pose.ned_from_body);
            velocity.push(line.velocity_ned_mps(t));
        }
    }
    Trajectory::new(PositionFrame::Map, time_s, position, attitude, velocity)
}
