//! The measurements of a job in order of time.

use crate::aiding::{GnssFix, KnownPoint, OdometerSample};
use crate::imu::Imu;
use crate::options::Options;
use crate::rest::Rest;
use crate::update::tie::FilterTie;

/// All measurements of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct Inputs {
    /// Inertial measurements.
    pub imu: Imu,
    /// GNSS fixes, in order of time.
    pub gnss: Vec<GnssFix>,
    /// Odometer readings, in order of time.
    pub odometer: Vec<OdometerSample>,
    /// Known points.
    pub points: Vec<KnownPoint>,
    /// Ties.
    pub ties: Vec<FilterTie>,
}

/// What happens at a moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum EventKind {
    /// Nothing: a node for the sake of its spacing.
    Tick,
    /// A rest begins: its attitude is cloned.
    RestBegins,
    /// The velocity is zero.
    AtRest,
    /// The rest ends: its attitude is still that of its beginning.
    NotTurned,
    /// Readings of the odometer, averaged: first and number.
    Odometer(usize, usize),
    /// The non-holonomic constraint.
    Constraint,
    /// A GNSS position.
    Position(usize),
    /// A GNSS velocity.
    Velocity(usize),
    /// A known point.
    Known(usize),
    /// A sighting of a tie: tie and sighting.
    Sighting(usize, usize),
}

/// An event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// Survey time \[s\].
    pub time_s: f64,
    /// What happens.
    pub kind: EventKind,
}

/// How long a vehicle rocks after it has stopped \[s\].
const ROCKING_S: f64 = 1.0;
/// Shortest time in which the attitude is held still \[s\].
const LEAST_STILL_S: f64 = 1.0;
/// Longest mean of odometer readings \[s\].
const ODOMETER_MEAN_S: f64 = 0.25;
/// Below this speed the non-holonomic constraint says nothing that rest does not \[m/s\].
pub(crate) const CONSTRAINT_SPEED_MPS: f64 = 0.5;

/// Delays that events are shifted by \[s\], against the clock of the IMU. GNSS keeps GPS time, and so does everything else
/// but the IMU: the delay of positions is that of all of them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EventDelays {
    /// Of positions, and of all that is stamped in GPS time.
    pub position_s: f64,
    /// Of velocities.
    pub velocity_s: f64,
}

/// Collects the events between two times, sorted.
#[must_use]
pub fn collect(
    inputs: &Inputs,
    options: &Options,
    rests: &[Rest],
    used_ties: &[usize],
    delays: &EventDelays,
    (start_s, end_s): (f64, f64),
) -> Vec<Event> {
    let mut events = Vec::new();
    let mut put = |time_s: f64, kind: EventKind| {
        if time_s > start_s && time_s <= end_s {
            events.push(Event { time_s, kind });
        }
    };
    for (i, fix) in inputs.gnss.iter().enumerate() {
        put(fix.time_s + delays.position_s, EventKind::Position(i));
        if options.gnss.use_velocity && fix.velocity.is_some() {
            put(fix.time_s + delays.velocity_s, EventKind::Velocity(i));
        }
    }
    for (i, point) in inputs.points.iter().enumerate() {
        put(point.time_s + delays.position_s, EventKind::Known(i));
    }
    if options.odometer.is_some() {
        let mut first = 0;
        while first < inputs.odometer.len() {
            let begin_s = inputs.odometer[first].time_s;
            let count =
                inputs.odometer[first..].iter().take_while(|o| o.time_s < begin_s + ODOMETER_MEAN_S).count().max(1);
            let last_s = inputs.odometer[first + count - 1].time_s;
            put(0.5 * (begin_s + last_s) + delays.position_s, EventKind::Odometer(first, count));
            first += count;
        }
    }
    let at_rest = |time_s: f64| {
        let next = rests.partition_point(|r| r.end_s < time_s);
        rests.get(next).is_some_and(|r| r.start_s <= time_s)
    };
    if let Some(constraint) = &options.constraint {
        for time_s in spaced(start_s, end_s, constraint.interval_s) {
            if !at_rest(time_s) {
                put(time_s, EventKind::Constraint);
            }
        }
    }
    if let Some(standstill) = &options.standstill {
        for rest in rests {
            let (from_s, to_s) = (rest.start_s.max(start_s + 1e-3), rest.end_s.min(end_s));
            put(0.5 * (from_s + to_s), EventKind::AtRest); // a short rest has no whole interval
            for time_s in spaced(from_s, to_s, standstill.interval_s) {
                put(time_s, EventKind::AtRest);
            }
            // a vehicle rocks for a moment after it stops
            if to_s - from_s > LEAST_STILL_S + ROCKING_S {
                put(from_s + ROCKING_S, EventKind::RestBegins);
                put(to_s, EventKind::NotTurned);
            }
        }
    }
    for &t in used_ties {
        for (s, sighting) in inputs.ties[t].sightings.iter().enumerate() {
            put(sighting.time_s + delays.position_s, EventKind::Sighting(t, s));
        }
    }
    for time_s in spaced(start_s, end_s, options.node_interval_s) {
        put(time_s, EventKind::Tick);
    }
    put(end_s, EventKind::Tick);
    events.sort_by(|a, b| a.time_s.total_cmp(&b.time_s).then(a.kind.cmp(&b.kind)));
    events
}

/// Times on whole multiples of an interval within a span.
fn spaced(start_s: f64, end_s: f64, interval_s: f64) -> impl Iterator<Item = f64> {
    let first = (start_s / interval_s).floor() + 1.0;
    (0_u32..).map(move |k| (first + f64::from(k)) * interval_s).take_while(move |t| *t <= end_s)
}
