//! What the smoother gives.

use nalgebra::{Matrix3, Matrix6, Vector3};

use crate::backward::SmoothedNode;
use crate::doubt::TieFit;
use crate::earth::ecef_from_geodetic;
use crate::events::Inputs;
use crate::forward::FilterNode;
use crate::frames::roll_pitch_heading_rad;
use crate::innovation::Innovation;
use crate::propagate::Mechaniser;
use crate::rest::Rest;
use crate::state::{ATTITUDE, Layout, NAV, Nominal, POSITION, VELOCITY};
use crate::strapdown::NavState;
use crate::tie_plan::TiePlan;
use crate::trajectory::{PoseSigma, PositionFrame, Trajectory, TrajectoryError};
use crate::update::tie::coordinates;

/// A pose with its standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EpochEstimate {
    /// Position, velocity, attitude.
    pub nav: NavState,
    /// Standard deviations.
    pub sigma: PoseSigma,
}

/// The constants that ties depend on, as estimated.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CalibrationEstimate {
    /// Values, each in its unit.
    pub value: Vec<f64>,
    /// Covariance, row-major.
    pub covariance: Vec<f64>,
}

impl CalibrationEstimate {
    /// Standard deviation of a constant.
    #[must_use]
    pub fn sigma(&self, number: usize) -> f64 {
        self.covariance[number * (self.value.len() + 1)].max(0.0).sqrt()
    }
}

/// How a tie fared.
#[derive(Debug, Clone, PartialEq)]
pub struct TieUse {
    /// Number of the tie.
    pub id: u64,
    /// Weight that each sighting got: 1 trusted, below 1 down-weighted, 0 left out.
    pub weights: Vec<f64>,
    /// Why it was not used.
    pub why_not: Option<&'static str>,
}

impl TieUse {
    pub(crate) fn of_all(inputs: &Inputs, plan: &TiePlan, weights: &[Vec<Option<f64>>]) -> Vec<Self> {
        inputs
            .ties
            .iter()
            .enumerate()
            .map(|(t, tie)| {
                let weights: Vec<f64> = weights[t].iter().map(|w| w.unwrap_or(0.0)).collect();
                let why_not = plan.why_not.get(t).copied().flatten().or_else(|| {
                    let compared = if tie.known_m.is_some() { &weights[..] } else { &weights[1..] };
                    compared.iter().all(|w| *w <= 0.0).then_some("innovation")
                });
                Self { id: tie.id, weights, why_not }
            })
            .collect()
    }
}

/// The smoothed trajectory with everything that was learnt on the way.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Where the states stand.
    pub layout: Layout,
    /// Smoothed nodes, a fraction of a second apart.
    pub nodes: Vec<SmoothedNode>,
    /// The same nodes as the forward filter saw them.
    pub filter: Vec<FilterNode>,
    /// The constants of the calibration.
    pub calibration: CalibrationEstimate,
    /// Innovations of the first forward pass.
    pub innovations: Vec<Innovation>,
    /// Ties, in the order they were given.
    pub ties: Vec<TieUse>,
    /// How their sightings fit.
    pub tie_fits: Vec<TieFit>,
    /// Rests found.
    pub rests: Vec<Rest>,
    /// Runs over the data.
    pub runs: usize,
    /// Largest change of the last run, over sigma.
    pub change: f64,
    /// What is to be said to a person.
    pub notes: Vec<String>,
}

impl Solution {
    /// First and last time on the clock of the IMU \[s\].
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        let time = |n: Option<&SmoothedNode>| n.map_or(f64::NAN, |n| n.nominal.nav.time_s);
        (time(self.nodes.first()), time(self.nodes.last()))
    }

    /// The smoothed poses at the epochs of the IMU, one after the other: between nodes the mechanisation runs from the node
    /// before, and what it misses at the next is spread over the interval.
    pub fn epochs<'a>(&'a self, inputs: &'a Inputs) -> impl Iterator<Item = EpochEstimate> + 'a {
        let nominals: Vec<Nominal> = self.nodes.iter().map(|n| n.nominal).collect();
        let variances: Vec<[f64; NAV]> = self.nodes.iter().map(|n| sigma_source(&n.covariance)).collect();
        let rotations: Vec<[f64; 6]> = self.nodes.iter().map(|n| attitude_block(&n.covariance)).collect();
        epochs_between(inputs, nominals, variances, rotations, &self.layout)
    }

    /// The poses of the forward filter at the epochs of the IMU; they jump where a measurement comes in.
    pub fn filter_epochs<'a>(&'a self, inputs: &'a Inputs) -> impl Iterator<Item = EpochEstimate> + 'a {
        let mut at = 0;
        let samples = inputs.imu.samples();
        let (start_s, end_s) = self.span_s();
        let mut state: Option<(usize, Mechaniser<'a>, Nominal)> = None;
        samples.iter().map(|s| s.time_s).filter(move |t| *t >= start_s && *t <= end_s).map(move |time_s| {
            while at + 1 < self.filter.len() && self.filter[at + 1].nominal.nav.time_s <= time_s + 1e-9 {
                at += 1;
            }
            let node = &self.filter[at];
            if state.as_ref().is_none_or(|s| s.0 != at) {
                state = Some((at, Mechaniser::new(&inputs.imu, &node.nominal), node.nominal));
            }
            let mut nav = node.nominal.nav;
            if let Some((_, mechaniser, nominal)) = &mut state {
                mechaniser.run(nominal, time_s);
                nav = nominal.nav;
            }
            let v = &node.variance;
            let covariance = [v[6], 0.0, 0.0, v[7], 0.0, v[8]];
            EpochEstimate { nav, sigma: sigma_of(v, &covariance, &nav) }
        })
    }

    /// What the clock of the IMU is ahead of GPS time by \[s\]: as the delay of GNSS positions shows it.
    #[must_use]
    pub fn clock_offset_s(&self) -> f64 {
        self.nodes.last().map_or(0.0, |n| n.nominal.parameters.gnss_delay_s)
    }

    /// The smoothed trajectory with its standard deviations, in GPS time, thinned to an interval \[s\] (0: every epoch of the IMU).
    ///
    /// # Errors
    /// [`TrajectoryError`] when there are fewer than two epochs.
    pub fn trajectory(&self, inputs: &Inputs, interval_s: f64) -> Result<Trajectory, TrajectoryError> {
        trajectory_of(self.epochs(inputs), interval_s, self.clock_offset_s())
    }

    /// The trajectory of the forward filter.
    ///
    /// # Errors
    /// As [`Solution::trajectory`].
    pub fn filter_trajectory(&self, inputs: &Inputs, interval_s: f64) -> Result<Trajectory, TrajectoryError> {
        trajectory_of(self.filter_epochs(inputs), interval_s, self.clock_offset_s())
    }

    /// Covariance of position and attitude at a time, north-east-down \[m, rad\]; `None` outside of the span.
    #[must_use]
    pub fn covariance_at(&self, time_s: f64) -> Option<Matrix6<f64>> {
        let next = self.nodes.partition_point(|n| n.nominal.nav.time_s < time_s);
        let after = self.nodes.get(next)?;
        let before = if next == 0 { after } else { &self.nodes[next - 1] };
        let (a, b) = (before.nominal.nav.time_s, after.nominal.nav.time_s);
        if time_s < a - 1e-6 {
            return None;
        }
        let share = if b > a { (time_s - a) / (b - a) } else { 0.0 };
        let index = |k: usize| if k < 3 { POSITION + k } else { ATTITUDE + k - 3 };
        Some(Matrix6::from_fn(|i, j| {
            let k = index(i) * NAV + index(j);
            before.covariance[k] * (1.0 - share) + after.covariance[k] * share
        }))
    }

    /// The smoothed pose at a time on the clock of the IMU; `None` outside of the span.
    #[must_use]
    pub fn pose_at(&self, inputs: &Inputs, time_s: f64) -> Option<NavState> {
        let next = self.nodes.partition_point(|n| n.nominal.nav.time_s <= time_s);
        let before = self.nodes.get(next.checked_sub(1)?)?;
        if (before.nominal.nav.time_s - time_s).abs() < 1e-9 {
            return Some(before.nominal.nav);
        }
        let after = self.nodes.get(next)?;
        Some(between(inputs, &before.nominal, &after.nominal, &self.layout, &[time_s])[0])
    }

    /// Residuals of all ties, used or not, in the order they were given: the offset of each sighting from the mean of all,
    /// along the first direction, by the smoothed trajectory \[m\]; NaN outside of its span. Every interval between nodes is
    /// mechanised once.
    #[must_use]
    pub fn tie_residuals_m(&self, inputs: &Inputs) -> Vec<Vec<f64>> {
        let mut residuals: Vec<Vec<f64>> = inputs.ties.iter().map(|t| vec![f64::NAN; t.sightings.len()]).collect();
        let Some(first) = self.nodes.first() else { return residuals };
        let origin = ecef_from_geodetic(&first.nominal.nav.geodetic);
        let offset_s = self.clock_offset_s();
        let (start_s, end_s) = self.span_s();
        let mut order: Vec<(f64, usize, usize)> = Vec::new();
        for (t, tie) in inputs.ties.iter().enumerate() {
            order.extend(tie.sightings.iter().enumerate().map(|(s, sighting)| (sighting.time_s + offset_s, t, s)));
        }
        order.retain(|o| o.0 >= start_s && o.0 < end_s);
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let interval_of = |time_s: f64| self.nodes.partition_point(|n| n.nominal.nav.time_s <= time_s);
        for group in order.chunk_by(|a, b| interval_of(a.0) == interval_of(b.0)) {
            let next = interval_of(group[0].0);
            let times: Vec<f64> = group.iter().map(|g| g.0).collect();
            let (from, to) = (&self.nodes[next - 1].nominal, &self.nodes[next].nominal);
            for (nav, (_, t, s)) in between(inputs, from, to, &self.layout, &times).into_iter().zip(group) {
                let tie = &inputs.ties[*t];
                let nominal = Nominal { nav, parameters: from.parameters };
                let sighting = tie.sightings[*s].calibrated(&self.calibration.value);
                residuals[*t][*s] = coordinates(&nominal, tie, &sighting, &origin, (0.0, None)).0[0];
            }
        }
        for (tie, values) in inputs.ties.iter().zip(&mut residuals) {
            #[allow(clippy::cast_precision_loss)]
            let mean = match &tie.known_m {
                Some(known) => known[0] - tie.directions[0].dot(&origin),
                None => values.iter().sum::<f64>() / values.len().max(1) as f64,
            };
            values.iter_mut().for_each(|v| *v -= mean);
        }
        residuals
    }
}

/// Poses at times within one interval between nodes, in order.
fn between(inputs: &Inputs, from: &Nominal, to: &Nominal, layout: &Layout, times_s: &[f64]) -> Vec<NavState> {
    let mut mechaniser = Mechaniser::new(&inputs.imu, from);
    let mut nominal = *from;
    let mut states = Vec::with_capacity(times_s.len());
    for time_s in times_s {
        mechaniser.run(&mut nominal, *time_s);
        states.push(nominal.nav);
    }
    mechaniser.run(&mut nominal, to.nav.time_s);
    let interval_s = to.nav.time_s - from.nav.time_s;
    let missed = to.minus(&nominal, layout);
    let three = |at: usize| Vector3::new(missed[at], missed[at + 1], missed[at + 2]);
    let (position, velocity, attitude) = (three(POSITION), three(VELOCITY), three(ATTITUDE));
    for nav in &mut states {
        let s = ((nav.time_s - from.nav.time_s) / interval_s).clamp(0.0, 1.0);
        // Hermite: no error and no velocity error at the node before, those missed at the next
        let offset = position * (s * s * (3.0 - 2.0 * s)) + velocity * (interval_s * s * s * (s - 1.0));
        crate::state::shift_nav(nav, &offset, &(velocity * s), &(attitude * s));
    }
    states
}

fn epochs_between<'a>(
    inputs: &'a Inputs,
    nominals: Vec<Nominal>,
    variances: Vec<[f64; NAV]>,
    rotations: Vec<[f64; 6]>,
    layout: &'a Layout,
) -> impl Iterator<Item = EpochEstimate> + 'a {
    let samples = inputs.imu.samples();
    (0..nominals.len().saturating_sub(1)).flat_map(move |k| {
        let (from, to) = (&nominals[k], &nominals[k + 1]);
        let (a, b) = (from.nav.time_s, to.nav.time_s);
        let is_last = k + 2 == nominals.len();
        let first = samples.partition_point(|s| s.time_s < a - 1e-9);
        let times: Vec<f64> = samples[first..]
            .iter()
            .map(|s| s.time_s)
            .take_while(|t| *t < b - 1e-9 || (is_last && *t <= b + 1e-9))
            .collect();
        let states = if times.is_empty() { Vec::new() } else { between(inputs, from, to, layout, &times) };
        let (v, r) = ((variances[k], variances[k + 1]), (rotations[k], rotations[k + 1]));
        states.into_iter().map(move |nav| {
            let s = ((nav.time_s - a) / (b - a)).clamp(0.0, 1.0);
            let variance: [f64; NAV] = std::array::from_fn(|i| v.0[i] * (1.0 - s) + v.1[i] * s);
            let rotation: [f64; 6] = std::array::from_fn(|i| r.0[i] * (1.0 - s) + r.1[i] * s);
            EpochEstimate { nav, sigma: sigma_of(&variance, &rotation, &nav) }
        })
    })
}

fn sigma_source(covariance: &[f64; NAV * NAV]) -> [f64; NAV] {
    std::array::from_fn(|i| covariance[i * NAV + i])
}

/// Upper triangle of the attitude's covariance.
fn attitude_block(covariance: &[f64; NAV * NAV]) -> [f64; 6] {
    let at = |i: usize, j: usize| covariance[(ATTITUDE + i) * NAV + ATTITUDE + j];
    [at(0, 0), at(0, 1), at(0, 2), at(1, 1), at(1, 2), at(2, 2)]
}

/// Standard deviations of a pose; those of roll, pitch and heading follow from the rotation about north, east, down.
fn sigma_of(variance: &[f64; NAV], rotation: &[f64; 6], nav: &NavState) -> PoseSigma {
    let root = |v: f64| v.max(0.0).sqrt();
    let three = |at: usize| Vector3::new(root(variance[at]), root(variance[at + 1]), root(variance[at + 2]));
    let (_, pitch, heading) = roll_pitch_heading_rad(&nav.ned_from_body);
    let (sh, ch) = heading.sin_cos();
    let (cos, tan) = (pitch.cos().max(1e-6), pitch.tan());
    let j = Matrix3::new(ch / cos, sh / cos, 0.0, -sh, ch, 0.0, ch * tan, sh * tan, 1.0);
    let r = rotation;
    let c = Matrix3::new(r[0], r[1], r[2], r[1], r[3], r[4], r[2], r[4], r[5]);
    let of_angles = j * c * j.transpose();
    PoseSigma {
        position_ned_m: three(POSITION),
        velocity_ned_mps: three(VELOCITY),
        attitude_rph_rad: of_angles.diagonal().map(root),
    }
}

/// A trajectory of epochs, thinned to an interval, in GPS time.
fn trajectory_of(
    epochs: impl Iterator<Item = EpochEstimate>,
    interval_s: f64,
    clock_offset_s: f64,
) -> Result<Trajectory, TrajectoryError> {
    let (mut time, mut position, mut attitude, mut velocity, mut sigma) = (vec![], vec![], vec![], vec![], vec![]);
    let mut next_s = f64::NEG_INFINITY;
    for epoch in epochs {
        if epoch.nav.time_s < next_s - 1e-6 {
            continue;
        }
        next_s = epoch.nav.time_s + interval_s;
        time.push(epoch.nav.time_s - clock_offset_s);
        position.push(epoch.nav.geodetic);
        attitude.push(epoch.nav.ned_from_body);
        velocity.push(epoch.nav.velocity_ned_mps);
        sigma.push(epoch.sigma);
    }
    Trajectory::new(PositionFrame::Geodetic, time, position, attitude, velocity)?.with_sigma(sigma)
}
