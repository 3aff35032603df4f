//! The forward pass: an error-state Kalman filter over all events.

mod sighting;

use std::collections::HashMap;

use nalgebra::{UnitQuaternion, Vector3};

use crate::doubt::{TieUpdate, Trust};
use crate::earth::ecef_from_geodetic;
use crate::events::{CONSTRAINT_SPEED_MPS, Event, EventDelays, EventKind, Inputs};
use crate::innovation::{Innovation, LOST_AFTER, MeasurementKind, take_in};
use crate::kalman::{Gaussian, Measurement, Slots, Stay};
use crate::options::{InitialState, Options, Process};
use crate::propagate::Propagator;
use crate::smoother::SmootherError;
use crate::solution::CalibrationEstimate;
use crate::state::{ATTITUDE, Layout, Nominal, POSITION, VELOCITY};
use crate::tape::{NodeRecord, Operation, Tape};
use crate::transition::Transition;
use crate::update::{gnss, standstill, vehicle};
use sighting::{LiveTie, Waiting};

/// What the forward pass knows before it starts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan<'a> {
    pub inputs: &'a Inputs,
    pub options: &'a Options,
    pub layout: &'a Layout,
    pub events: &'a [Event],
    pub delays: EventDelays,
    pub initial: &'a InitialState,
    /// What the correlated error of each fix is counted in \[m\].
    pub correlated_sigma_m: &'a [Vector3<f64>],
    /// Nominals of the nodes to linearise at, and what the first was before: a run before this one.
    pub reference: Option<&'a [Nominal]>,
    /// Weights of sightings, from a run before; without, their innovations are tested.
    pub trust: Option<&'a Trust>,
}

/// A node as the filter saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterNode {
    /// Estimate.
    pub nominal: Nominal,
    /// Variances of position, velocity, attitude.
    pub variance: [f64; 9],
}

/// What the forward pass gives, beside the tape.
#[derive(Debug, Clone, Default)]
pub(crate) struct Forward {
    pub nodes: Vec<FilterNode>,
    pub nominals: Vec<Nominal>,
    pub innovations: Vec<Innovation>,
    /// Weight that each sighting of each tie got, if it was taken in.
    pub tie_weight: Vec<Vec<Option<f64>>>,
    pub tie_updates: Vec<TieUpdate>,
    pub lost: Vec<(f64, MeasurementKind)>,
    pub bridged: Vec<(f64, f64)>,
    pub calibration: CalibrationEstimate,
}

struct Run<'a> {
    plan: Plan<'a>,
    gaussian: Gaussian,
    propagator: Propagator<'a>,
    all_states: Vec<usize>,
    quick_states: Vec<usize>,
    /// By tie.
    live: Vec<Option<LiveTie>>,
    /// Sightings since the last record began.
    waiting: Vec<Waiting>,
    /// While several measurements are taken in that were all predicted by one nominal.
    keeps_nominal: bool,
    rest: Option<([usize; 3], UnitQuaternion<f64>)>,
    origin_ecef_m: Vector3<f64>,
    rejected: HashMap<MeasurementKind, usize>,
    /// What the next record will hold.
    transition: Option<Transition>,
    operations: Vec<Operation>,
    records: usize,
    /// Whether a measurement other than a tie, of which there are too many, has moved the estimate since the last node.
    moved: bool,
    result: Forward,
}

/// Slots beyond those of ties: the clone of a rest.
const EXTRA_SLOTS: usize = 3;
/// Slots of states that leave soon: that clone and those of a few increments.
const BRIEF_SLOTS: usize = 7;
/// Nodes from one that is smoothed with all its states to the next: most of them change slowly, and their rows of the
/// covariance are most of what the tape would hold.
const WHOLE_EVERY: usize = 8;

/// Room for the ties that may live at one time, and for the clone of a rest.
pub(crate) fn slots(options: &Options) -> Slots {
    let all = options.ties.most_live + EXTRA_SLOTS;
    Slots { brief: BRIEF_SLOTS.min(all), lasting: all }
}

/// Runs the filter forward and leaves its records on the tape.
///
/// # Errors
/// When a measurement has no variance, or the temporary file cannot be written.
pub(crate) fn run(plan: Plan<'_>, tape: &mut Tape) -> Result<Forward, SmootherError> {
    let layout = plan.layout;
    let prior = Nominal { nav: plan.initial.nav, parameters: plan.options.parameters(plan.initial) };
    let variances = plan.options.initial_variances(layout, plan.initial);
    let mut gaussian = Gaussian::new(&variances, slots(plan.options));
    if let Some(at) = layout.calibration {
        let count = layout.base - at;
        for (k, value) in plan.options.calibration_covariance.iter().enumerate() {
            gaussian.set_covariance(at + k / count, at + k % count, *value);
        }
    }
    let mut nominal = prior;
    if let Some(reference) = plan.reference {
        nominal = reference[0];
        let error = prior.minus(&nominal, layout);
        gaussian.mean_mut()[..layout.base].copy_from_slice(&error);
    }
    let processes: Vec<Process> = plan.options.processes(layout);
    let propagator = Propagator::new(&plan.inputs.imu, plan.options, layout, processes, nominal);
    let mut run = Run {
        plan,
        gaussian,
        propagator,
        all_states: (0..layout.base).collect(),
        quick_states: layout.quick_states(),
        live: vec![None; plan.inputs.ties.len()],
        waiting: Vec::new(),
        keeps_nominal: false,
        rest: None,
        origin_ecef_m: ecef_from_geodetic(&plan.initial.nav.geodetic),
        rejected: HashMap::new(),
        transition: None,
        operations: Vec::new(),
        records: 0,
        moved: false,
        result: Forward {
            tie_weight: plan.inputs.ties.iter().map(|t| vec![None; t.sightings.len()]).collect(),
            ..Forward::default()
        },
    };
    run.node(true);
    run.record(tape, (true, false))?;
    let mut next = 0;
    let mut main_s = plan.initial.nav.time_s;
    while next < plan.events.len() {
        let time_s = plan.events[next].time_s;
        // Nodes between are passed by the backward run, but not smoothed.
        let last = plan.events.last().map_or(time_s, |e| e.time_s);
        let is_main = time_s >= main_s + 0.999 * plan.options.node_interval_s || time_s >= last - 1e-6;
        let here = plan.events[next..].iter().take_while(|e| e.time_s < time_s + 1e-6);
        let only_sightings = here.clone().all(|e| matches!(e.kind, EventKind::Sighting(..)));
        if run.waiting.first().is_some_and(|w| time_s >= w.until_s) {
            run.propagator.hold_at(run.waiting[0].until_s, &mut run.gaussian);
            run.begin(tape)?;
        }
        if is_main || !only_sightings {
            run.propagator.advance_to(time_s, &mut run.gaussian);
        } else {
            // ties are many: they share the steps of the covariance
            run.propagator.hold_at(time_s, &mut run.gaussian);
            if run.propagator.has_moved() {
                while let Some(event) = plan.events.get(next).filter(|e| e.time_s < time_s + 1e-6) {
                    run.wait(event);
                    next += 1;
                }
                continue;
            }
        }
        run.begin(tape)?;
        if let Some(reference) = plan.reference.filter(|_| is_main) {
            run.move_nominal_to(&reference[run.result.nominals.len()]);
        }
        // events closer than a microsecond share a node
        while let Some(event) = plan.events.get(next).filter(|e| e.time_s < time_s + 1e-6) {
            run.happen(event)?;
            next += 1;
        }
        if is_main || run.moved {
            run.node(is_main);
        }
        if is_main {
            run.record(tape, (true, next == plan.events.len()))?;
            main_s = time_s;
        }
    }
    if let Some(at) = layout.calibration {
        // constants: what the filter knows at the end is all there is to know
        let (mean, states) = (run.gaussian.mean(), at..layout.base);
        run.result.calibration.value = mean[states.clone()].to_vec();
        run.result.calibration.covariance =
            states.flat_map(|i| run.gaussian.row(i)[at..layout.base].to_vec()).collect();
    }
    run.result.bridged = std::mem::take(&mut run.propagator.bridged);
    Ok(run.result)
}

impl Run<'_> {
    /// Moves the point of linearisation; the mean of the errors takes up the difference.
    fn move_nominal_to(&mut self, target: &Nominal) {
        let layout = self.plan.layout;
        let moved = target.minus(&self.propagator.nominal, layout);
        for (x, m) in self.gaussian.mean_mut().iter_mut().zip(&moved) {
            *x -= m;
        }
        let time_s = self.propagator.nominal.nav.time_s;
        self.propagator.nominal = *target;
        self.propagator.nominal.nav.time_s = time_s;
    }

    /// Without a reference the nominal follows the estimate.
    fn feed_back(&mut self) {
        if self.plan.reference.is_some() || self.keeps_nominal {
            return;
        }
        let error = self.error_now();
        self.propagator.nominal.shift(self.plan.layout, &error);
        self.gaussian.mean_mut()[..self.plan.layout.nominal_states()].fill(0.0);
    }

    /// The mean of the filter's own errors, carried over what the covariance is behind by.
    fn error_now(&self) -> Vec<f64> {
        let mut error = self.gaussian.mean()[..self.plan.layout.base].to_vec();
        let held_s = self.propagator.held_s();
        for k in 0..3 {
            error[POSITION + k] += held_s * error[VELOCITY + k];
        }
        error
    }

    /// Before anything happens: where the covariance has moved a new record begins, and what waited for it is taken in.
    fn begin(&mut self, tape: &mut Tape) -> Result<(), SmootherError> {
        if let Some(transition) = self.propagator.take_transition() {
            if self.transition.is_some() || !self.operations.is_empty() {
                self.record(tape, (false, false))?;
            }
            self.gaussian.advance_slots(&transition);
            self.transition = Some(transition);
        }
        if self.waiting.is_empty() {
            return Ok(());
        }
        let mut waiting = std::mem::take(&mut self.waiting);
        self.keeps_nominal = true; // theirs is that of their own moment
        for sighting in waiting.drain(..) {
            self.sighting(&sighting.event, &sighting.nominal)?;
        }
        self.keeps_nominal = false;
        self.waiting = waiting;
        self.feed_back();
        Ok(())
    }

    /// What happened since the last record goes onto the tape.
    fn record(&mut self, tape: &mut Tape, (is_main, is_last): (bool, bool)) -> Result<(), SmootherError> {
        let operations = std::mem::take(&mut self.operations);
        let record = NodeRecord { transition: self.transition.take(), operations };
        let whole = (self.result.nominals.len() - 1).is_multiple_of(WHOLE_EVERY) || is_last;
        let rows = if whole { &self.all_states } else { &self.quick_states };
        tape.push(&record, is_main.then_some((&self.gaussian, &rows[..])))?;
        self.records += 1;
        Ok(())
    }

    /// Closes a node: the estimate of the filter.
    fn node(&mut self, is_main: bool) {
        self.moved = false;
        let nominal = self.propagator.nominal;
        let mut estimate = nominal;
        estimate.shift(self.plan.layout, &self.error_now());
        let variance = std::array::from_fn(|k| self.gaussian.covariance(k, k));
        self.result.nodes.push(FilterNode { nominal: estimate, variance });
        if is_main {
            self.result.nominals.push(nominal);
        }
    }

    fn happen(&mut self, event: &Event) -> Result<(), SmootherError> {
        let Plan { inputs, options, layout, .. } = self.plan;
        let nominal = self.propagator.nominal;
        let motion = self.propagator.motion;
        match event.kind {
            EventKind::Tick => {}
            EventKind::Position(i) => {
                let delay_s = self.plan.delays.position_s;
                let sigma_m = &self.plan.correlated_sigma_m[i];
                let m = gnss::position(&nominal, layout, &inputs.gnss[i], &options.gnss, sigma_m, &motion, delay_s);
                self.take(m, event, MeasurementKind::Position)?;
            }
            EventKind::Velocity(i) => {
                if let Some(v) = &inputs.gnss[i].velocity {
                    let delay_s = self.plan.delays.velocity_s;
                    let m = gnss::velocity(&nominal, layout, v, &options.gnss, &motion, delay_s);
                    self.take(m, event, MeasurementKind::Velocity)?;
                }
            }
            EventKind::Known(i) => {
                let m = gnss::known_point(&nominal, &inputs.points[i]);
                self.take(m, event, MeasurementKind::KnownPoint)?;
            }
            EventKind::Odometer(first, count) => {
                if let Some(model) = &options.odometer {
                    let readings = &inputs.odometer[first..first + count];
                    #[allow(clippy::cast_precision_loss)]
                    let n = count as f64;
                    let speed_mps = readings.iter().map(|o| o.speed_mps).sum::<f64>() / n;
                    let variance = model.noise_mps.powi(2) / n;
                    let m = vehicle::odometer(&nominal, layout, speed_mps, model, &motion, variance);
                    self.take(m, event, MeasurementKind::Odometer)?;
                }
            }
            EventKind::Constraint => {
                if let Some(model) = &options.constraint
                    && nominal.nav.velocity_ned_mps.norm() > CONSTRAINT_SPEED_MPS
                {
                    self.take(
                        vehicle::constraint(&nominal, layout, model, &motion),
                        event,
                        MeasurementKind::Constraint,
                    )?;
                }
            }
            EventKind::RestBegins | EventKind::AtRest | EventKind::NotTurned => self.rest(event)?,
            EventKind::Sighting(..) => self.sighting(event, &nominal)?,
        }
        Ok(())
    }

    fn rest(&mut self, event: &Event) -> Result<(), SmootherError> {
        let Some(model) = self.plan.options.standstill else { return Ok(()) };
        let nominal = self.propagator.nominal;
        match event.kind {
            EventKind::RestBegins => {
                let mut clone = [0; 3];
                for (k, at) in clone.iter_mut().enumerate() {
                    let Some(slot) = self.enter(vec![(ATTITUDE + k, 1.0)], 0.0, Stay::Brief) else { return Ok(()) };
                    *at = slot;
                }
                self.rest = Some((clone, nominal.nav.ned_from_body));
            }
            EventKind::AtRest => {
                let m = standstill::velocity(&nominal, model.velocity_sigma_mps);
                self.take(m, event, MeasurementKind::ZeroVelocity)?;
            }
            EventKind::NotTurned => {
                if let Some((clone, then)) = self.rest.take() {
                    let m = standstill::rotation(&nominal, &then, clone, model.sway_rad);
                    self.take(m, event, MeasurementKind::ZeroRotation)?;
                    for at in clone {
                        self.gaussian.leave(at);
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// A state enters; the record remembers.
    fn enter(&mut self, row: Vec<(usize, f64)>, variance: f64, stay: Stay) -> Option<usize> {
        let at = self.gaussian.enter(&row, variance, stay)?;
        self.operations.push(Operation::Enter { at, row });
        Some(at)
    }

    /// Tests a measurement and takes it in; gives the weight it got.
    fn take(&mut self, m: Measurement, event: &Event, kind: MeasurementKind) -> Result<f64, SmootherError> {
        let rejected = self.rejected.entry(kind).or_default();
        let judged = kind == MeasurementKind::Tie && self.plan.trust.is_some();
        let lost = *rejected >= LOST_AFTER && kind != MeasurementKind::Tie;
        let forced = lost || judged;
        let at = (event.time_s, kind);
        let (mut innovation, record) = take_in(&mut self.gaussian, m, at, self.plan.options.false_alarm, forced)
            .map_err(|_| SmootherError::NoVariance { kind: kind.as_str(), time_s: event.time_s })?;
        if lost {
            self.result.lost.push(at);
        }
        *rejected = if innovation.weight > 0.0 { 0 } else { *rejected + 1 };
        let weight = innovation.weight;
        if let EventKind::Sighting(tie, sighting) = event.kind {
            innovation.sighting = Some((tie, sighting));
        }
        self.result.innovations.push(innovation);
        if let Some(record) = record {
            self.operations.push(Operation::Update(record));
            self.moved |= kind != MeasurementKind::Tie;
            self.feed_back();
        }
        Ok(weight)
    }
}
