//! Nominal and covariance between events.

use nalgebra::Vector3;

use crate::imu::Imu;
use crate::kalman::Gaussian;
use crate::options::{Options, Process};
use crate::state::{ATTITUDE, Layout, NAV, Nominal, VELOCITY};
use crate::strapdown::{Increment, Locality, advance, frame_rate_radps};
use crate::transition::{StepSums, Transition};
use crate::update::Motion;

/// Intervals longer than this many usual ones are gaps.
const GAP: f64 = 1.5;
/// Gaps up to this length are bridged as if the rates had gone on \[s\].
const SHORT_GAP_S: f64 = 0.05;
/// What a platform may do unseen in a gap, as white noise: acceleration \[m/s/√s\] and rotation \[rad/√s\].
const UNSEEN: (f64, f64) = (2.0, 0.2);
/// Largest angle turned in one step of the covariance \[rad\].
const LARGEST_TURN_RAD: f64 = 0.1;

/// Runs the mechanisation over IMU samples: parts of samples, gaps, and what the platform does meanwhile.
#[derive(Debug, Clone)]
pub(crate) struct Mechaniser<'a> {
    imu: &'a Imu,
    /// Sample whose interval the present time lies in.
    sample: usize,
    locality: Locality,
}

/// A step of the mechanisation that is to be made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step {
    pub increment: Increment,
    /// Part of a gap, from and to \[s\].
    pub gap_s: Option<(f64, f64)>,
    pub end_s: f64,
}

impl<'a> Mechaniser<'a> {
    pub(crate) fn new(imu: &'a Imu, nominal: &Nominal) -> Self {
        let time_s = nominal.nav.time_s;
        let sample = imu.samples().partition_point(|s| s.time_s <= time_s + 1e-9).max(1);
        Self { imu, sample, locality: Locality::at(&nominal.nav.geodetic) }
    }

    /// The next step towards a time; `None` when it is reached or the samples end.
    pub(crate) fn step(&mut self, nominal: &Nominal, until_s: f64) -> Option<Step> {
        let now_s = nominal.nav.time_s;
        if now_s >= until_s - 1e-9 {
            return None;
        }
        let samples = self.imu.samples();
        while samples.get(self.sample)?.time_s <= now_s + 1e-9 {
            self.sample += 1;
        }
        let sample = samples[self.sample];
        let before = samples[self.sample - 1];
        let whole_s = sample.time_s - before.time_s;
        let end_s = sample.time_s.min(until_s);
        let share = (end_s - now_s) / whole_s;
        let usual_s = self.imu.interval_s();
        let errors = &nominal.parameters.imu;
        let (increment, gap_s) = if whole_s > GAP * usual_s {
            // mean rates of the samples at both ends, over the whole gap
            let mut bridge = sample;
            bridge.angle_rad = (before.angle_rad + sample.angle_rad) * (0.5 * whole_s / usual_s);
            bridge.velocity_mps = (before.velocity_mps + sample.velocity_mps) * (0.5 * whole_s / usual_s);
            (Increment::new(&bridge, None, whole_s, errors), Some((before.time_s, sample.time_s)))
        } else {
            let before_is_regular =
                self.sample >= 2 && before.time_s - samples[self.sample - 2].time_s <= GAP * usual_s;
            (Increment::new(&sample, before_is_regular.then_some(&before), whole_s, errors), None)
        };
        Some(Step { increment: increment.share(share), gap_s, end_s })
    }

    /// Makes a step.
    pub(crate) fn make(&mut self, step: &Step, nominal: &mut Nominal) -> crate::strapdown::StepTrace {
        let trace = advance(&mut nominal.nav, &step.increment, &mut self.locality);
        nominal.nav.time_s = step.end_s; // the sum of intervals would drift
        trace
    }

    /// Moves a nominal to a time without looking at the covariance.
    pub(crate) fn run(&mut self, nominal: &mut Nominal, until_s: f64) {
        while let Some(step) = self.step(nominal, until_s) {
            self.make(&step, nominal);
        }
    }
}

/// Moves nominal, covariance and the transition since the last node.
#[derive(Debug)]
pub(crate) struct Propagator<'a> {
    pub nominal: Nominal,
    pub motion: Motion,
    /// Gaps that were bridged \[s\].
    pub bridged: Vec<(f64, f64)>,
    mechaniser: Mechaniser<'a>,
    options: &'a Options,
    layout: &'a Layout,
    processes: Vec<Process>,
    sums: StepSums,
    angle_rad: Vector3<f64>,
    velocity_before_mps: Vector3<f64>,
    unseen_s: f64,
    transition: Option<Transition>,
}

impl<'a> Propagator<'a> {
    pub(crate) fn new(
        imu: &'a Imu,
        options: &'a Options,
        layout: &'a Layout,
        processes: Vec<Process>,
        nominal: Nominal,
    ) -> Self {
        Self {
            nominal,
            motion: Motion::default(),
            bridged: Vec::new(),
            mechaniser: Mechaniser::new(imu, &nominal),
            options,
            layout,
            processes,
            sums: StepSums::default(),
            angle_rad: Vector3::zeros(),
            velocity_before_mps: nominal.nav.velocity_ned_mps,
            unseen_s: 0.0,
            transition: None,
        }
    }

    /// Moves everything to a time.
    pub(crate) fn advance_to(&mut self, until_s: f64, gaussian: &mut Gaussian) {
        self.hold_at(until_s, gaussian);
        self.move_covariance(gaussian);
    }

    /// Moves the nominal to a time; the covariance follows in whole steps and stays [`Propagator::held_s`] behind.
    pub(crate) fn hold_at(&mut self, until_s: f64, gaussian: &mut Gaussian) {
        if self.sums.interval_s <= 0.0 {
            self.velocity_before_mps = self.nominal.nav.velocity_ned_mps; // measurements may have moved it
        }
        while let Some(step) = self.mechaniser.step(&self.nominal, until_s) {
            let trace = self.mechaniser.make(&step, &mut self.nominal);
            self.sums.add(&step.increment, &trace);
            self.angle_rad += step.increment.angle_rad;
            if let Some(gap) = step.gap_s.filter(|(a, b)| b - a > SHORT_GAP_S) {
                self.unseen_s += step.increment.interval_s;
                if self.bridged.last() != Some(&gap) {
                    self.bridged.push(gap);
                }
            }
            if self.sums.interval_s >= self.options.step_s - 1e-6 || self.sums.turned_rad > LARGEST_TURN_RAD {
                self.move_covariance(gaussian);
            }
        }
    }

    /// What the covariance is behind the nominal by \[s\].
    pub(crate) fn held_s(&self) -> f64 {
        self.sums.interval_s
    }

    /// The moment that the covariance stands at \[s\].
    pub(crate) fn covariance_time_s(&self) -> f64 {
        self.nominal.nav.time_s - self.held_s()
    }

    /// Whether the covariance has moved since the transition was last taken.
    pub(crate) fn has_moved(&self) -> bool {
        self.transition.is_some()
    }

    /// Moves the covariance over the steps summed: half of the noise before, half after.
    fn move_covariance(&mut self, gaussian: &mut Gaussian) {
        let interval_s = self.sums.interval_s;
        if interval_s <= 0.0 {
            return;
        }
        let nav = &self.nominal.nav;
        let mut transition = Transition::of(&self.sums, nav, &self.mechaniser.locality, self.layout.base);
        let mut noise = vec![0.0; self.layout.base];
        let n = &self.options.noise;
        let unseen = |density: f64| density * density * self.unseen_s;
        for k in 0..3 {
            noise[VELOCITY + k] = n.velocity_random_walk.powi(2) * interval_s + unseen(UNSEEN.0);
            noise[ATTITUDE + k] = n.angle_random_walk.powi(2) * interval_s + unseen(UNSEEN.1);
        }
        for (k, process) in self.processes.iter().enumerate() {
            (transition.decay[k], noise[NAV + k]) = process.over(interval_s);
        }
        gaussian.add_variances(&noise, 0.5);
        gaussian.advance_base(&transition);
        gaussian.add_variances(&noise, 0.5);
        self.nominal.decay(self.layout, &transition.decay);
        let body_from_ned = self.nominal.nav.ned_from_body.inverse();
        self.motion = Motion {
            rate_body_radps: self.angle_rad / interval_s - body_from_ned * frame_rate_radps(&self.nominal.nav),
            acceleration_ned_mps2: (self.nominal.nav.velocity_ned_mps - self.velocity_before_mps) / interval_s,
        };
        self.velocity_before_mps = self.nominal.nav.velocity_ned_mps;
        if let Some(before) = &self.transition {
            transition.follow(before);
        }
        self.transition = Some(transition);
        self.sums = StepSums::default();
        self.angle_rad = Vector3::zeros();
        self.unseen_s = 0.0;
    }

    /// The transition since it was last taken, if the covariance has moved.
    pub(crate) fn take_transition(&mut self) -> Option<Transition> {
        self.transition.take()
    }
}
