//! The smoother: forward pass, backward pass, and again about the result until it no longer moves.

use crate::align::{AlignError, align};
use crate::backward::{SmoothedNode, backward};
use crate::doubt::{TieFit, Trust, after, after_first};
use crate::events::{EventDelays, Inputs, collect};
use crate::forward::{FilterNode, Forward, Plan, run, slots};
use crate::innovation::{Innovation, MeasurementKind};
use crate::options::{InitialState, Options};
use crate::rest::{Rest, find};
use crate::solution::{Solution, TieUse};
use crate::state::Nominal;
use crate::tape::Tape;
use crate::tie_plan::{TiePlan, plan_ties};
use crate::update::gnss::correlated_sigmas_m;

/// Why a trajectory cannot be estimated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SmootherError {
    /// A measurement without variance.
    #[error("{kind} at {time_s:.3} s has no standard deviation above zero; give it one")]
    NoVariance {
        /// Which measurement.
        kind: &'static str,
        /// When \[s\].
        time_s: f64,
    },
    /// Where the trajectory begins cannot be found.
    #[error(transparent)]
    Align(#[from] AlignError),
    /// The temporary file.
    #[error("the temporary file of the smoother: {0}; free the disk or set TMPDIR")]
    Spill(#[from] std::io::Error),
    /// The estimate ran away.
    #[error("the solution is not finite from {time_s:.1} s on: {remedy}")]
    NotFinite {
        /// First node \[s\].
        time_s: f64,
        /// What to look at.
        remedy: &'static str,
    },
}

/// The smoother.
#[derive(Debug, Clone, Copy)]
pub struct Smoother;

/// Change over sigma below which the solution stands.
const SETTLED: f64 = 0.1;
/// Change of a delay after which events are put to new times \[s\].
const DELAY_MOVED_S: f64 = 0.003;
/// So often at most.
const MOST_MOVES: usize = 3;

impl Smoother {
    /// Estimates the trajectory, from wherever it can be aligned.
    ///
    /// # Errors
    /// [`SmootherError`].
    pub fn run(inputs: &Inputs, options: &Options) -> Result<Solution, SmootherError> {
        let rests = if options.standstill.is_some() { find(&inputs.imu, &inputs.gnss) } else { Vec::new() };
        let (initial, how) = align(inputs, options, &rests)?;
        let mut solution = Self::run_from(inputs, options, &initial, rests)?;
        solution.notes.insert(0, how);
        Ok(solution)
    }

    /// Estimates the trajectory from a given beginning.
    ///
    /// # Errors
    /// [`SmootherError`].
    pub fn run_from(
        inputs: &Inputs,
        options: &Options,
        initial: &InitialState,
        rests: Vec<Rest>,
    ) -> Result<Solution, SmootherError> {
        let layout = options.layout();
        let span_s = (initial.nav.time_s, inputs.imu.span_s().1);
        let correlated_sigma_m = correlated_sigmas_m(&inputs.gnss, &options.gnss);
        let ties = plan_ties(&inputs.ties, options.ties.most_live, span_s);
        let mut delays =
            EventDelays { position_s: options.gnss.delay_s.0, velocity_s: options.gnss.velocity_delay_s.0 };
        let mut reference: Option<Vec<Nominal>> = None;
        let mut filter: Option<(Vec<FilterNode>, Vec<Innovation>)> = None;
        let mut trust: Option<Trust> = None;
        let (mut runs, mut moves) = (0, 0);
        let mut change = f64::INFINITY;
        loop {
            let events = collect(inputs, options, &rests, &ties.used, &delays, span_s);
            let plan = Plan {
                inputs,
                options,
                layout: &layout,
                events: &events,
                delays,
                initial,
                correlated_sigma_m: &correlated_sigma_m,
                reference: reference.as_deref(),
                trust: trust.as_ref(),
            };
            let mut tape = Tape::new(layout.base, options.memory_bytes);
            let mut forward = run(plan, &mut tape)?;
            check_finite(&forward)?;
            let ties_judged = (&forward.tie_updates[..], options.false_alarm);
            let (nodes, moved, judged) = backward(&layout, &mut tape, &forward.nominals, slots(options), ties_judged)?;
            let next_trust = match &trust {
                None => after_first(&forward.tie_weight, &judged, options.false_alarm),
                Some(trust) => after(trust, &judged),
            };
            let settled = trust
                .as_ref()
                .is_none_or(|t| t.len() == next_trust.len() && t.keys().all(|k| next_trust.contains_key(k)));
            runs += 1;
            if reference.is_some() {
                change = moved;
            } else {
                filter = Some((std::mem::take(&mut forward.nodes), std::mem::take(&mut forward.innovations)));
            }
            let done = runs >= options.most_runs || (change < SETTLED && settled);
            let moved_delays = delays_of(&nodes);
            let moved = |a: f64, b: f64, estimated: bool| estimated && (a - b).abs() > DELAY_MOVED_S;
            let late = moved(moved_delays.position_s, delays.position_s, layout.gnss_delay.is_some())
                || moved(moved_delays.velocity_s, delays.velocity_s, layout.velocity_delay.is_some());
            if late && !done && moves < MOST_MOVES {
                moves += 1;
                // events move to their new times: a fresh run, with nodes of its own
                delays = moved_delays;
                reference = None;
                trust = None;
                change = f64::INFINITY;
                continue;
            }
            if done {
                let (filter, innovations) = filter.unwrap_or_default();
                return Ok(Solution {
                    layout,
                    nodes,
                    filter,
                    calibration: std::mem::take(&mut forward.calibration),
                    innovations,
                    ties: TieUse::of_all(inputs, &ties, &forward.tie_weight),
                    tie_fits: TieFit::of_all(&judged),
                    notes: notes_of(&forward, &ties, runs, change),
                    rests,
                    runs,
                    change,
                });
            }
            reference = Some(nodes.iter().map(|n| n.nominal).collect());
            trust = Some(next_trust);
        }
    }
}

fn delays_of(nodes: &[SmoothedNode]) -> EventDelays {
    nodes.last().map_or_else(EventDelays::default, |n| EventDelays {
        position_s: n.nominal.parameters.gnss_delay_s,
        velocity_s: n.nominal.parameters.velocity_delay_s,
    })
}

fn check_finite(forward: &Forward) -> Result<(), SmootherError> {
    let bad = forward.nodes.iter().find(|n| {
        !(n.nominal.nav.geodetic.iter().chain(&n.nominal.nav.velocity_ned_mps).all(|v| v.is_finite())
            && n.variance.iter().all(|v| v.is_finite() && *v >= 0.0))
    });
    match bad {
        Some(node) => Err(SmootherError::NotFinite {
            time_s: node.nominal.nav.time_s,
            remedy: "check units and axes of the IMU and that GNSS and IMU share a clock",
        }),
        None => Ok(()),
    }
}

/// What a run over the data has to say.
fn notes_of(forward: &Forward, ties: &TiePlan, runs: usize, change: f64) -> Vec<String> {
    let mut notes: Vec<String> = forward
        .bridged
        .iter()
        .map(|(from, to)| {
            format!("IMU gap from {from:.3} s to {to:.3} s: bridged, with the uncertainty of unseen motion")
        })
        .collect();
    let mut lost: Vec<&(f64, MeasurementKind)> = forward.lost.iter().collect();
    lost.dedup_by_key(|l| l.1);
    for (time_s, kind) in lost {
        notes.push(format!(
            "at {time_s:.1} s so many {} measurements in a row did not fit that they were taken for the truth",
            kind.as_str()
        ));
    }
    if change > SETTLED && change.is_finite() {
        notes.push(format!("after {runs} runs the solution still moved by {change:.2} sigma"));
    }
    notes.extend(ties.notes.iter().cloned());
    notes
}
