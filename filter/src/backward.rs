//! The backward pass over the tape.

use crate::adjoint::{Adjoint, smoothed};
use crate::doubt::{Judged, TieUpdate, judge};
use crate::kalman::Slots;
use crate::smoother::SmootherError;
use crate::state::{Layout, NAV, Nominal};
use crate::tape::{Moments, Operation, Tape};

/// A node of the smoothed solution.
#[derive(Debug, Clone, PartialEq)]
pub struct SmoothedNode {
    /// Estimate.
    pub nominal: Nominal,
    /// Covariance of position, velocity, attitude in north-east-down, row-major 9 × 9.
    pub covariance: [f64; NAV * NAV],
    /// Standard deviations of the other states, from the gyro biases on.
    pub parameter_sigma: Vec<f64>,
}

/// Runs back over the tape. Gives the nodes, the largest change over sigma against what was linearised at, and how the
/// sightings of ties fare against all the rest.
///
/// # Errors
/// When the temporary file cannot be read.
pub(crate) fn backward(
    layout: &Layout,
    tape: &mut Tape,
    nominals: &[Nominal],
    slots: Slots,
    (tie_updates, false_alarm): (&[TieUpdate], f64),
) -> Result<(Vec<SmoothedNode>, f64, Vec<Judged>), SmootherError> {
    let mut adjoint = Adjoint::new(layout.base, slots);
    let mut nodes = Vec::with_capacity(nominals.len());
    let mut largest: f64 = 0.0;
    let mut judged = Vec::with_capacity(tie_updates.len());
    let mut waiting = tie_updates.iter().rev().peekable();
    let mut place = nominals.len();
    for index in (0..tape.len()).rev() {
        let (record, moments) = tape.read(index)?;
        if let Some(moments) = moments {
            place -= 1;
            // standard deviations of parameters change slowly: every eighth node has its own
            let sigma = nodes
                .last()
                .filter(|_| !place.is_multiple_of(PARAMETERS_EVERY))
                .map(|n: &SmoothedNode| &n.parameter_sigma);
            let (node, moved) = smooth(layout, moments, &nominals[place], &adjoint, sigma);
            largest = largest.max(moved);
            nodes.push(node);
        }
        for (number, operation) in record.operations.iter().enumerate().rev() {
            match operation {
                Operation::Update(update) => {
                    let deletion = adjoint.back_through_update(update);
                    if let Some(tie) = waiting.next_if(|t| t.place == (index, number)) {
                        judged.extend(judge(&deletion, tie, false_alarm));
                    }
                }
                Operation::Enter { at, row } => adjoint.back_through_entry(*at, row),
            }
        }
        if let Some(transition) = &record.transition {
            adjoint.back_through_transition(transition, layout.base);
        }
    }
    nodes.reverse();
    Ok((nodes, largest, judged))
}

/// Nodes from one with its own standard deviations of parameters to the next.
const PARAMETERS_EVERY: usize = 8;

/// A node smoothed, and its largest change over sigma against what was linearised at.
fn smooth(
    layout: &Layout,
    moments: Moments<'_>,
    nominal: &Nominal,
    adjoint: &Adjoint,
    parameter_sigma: Option<&Vec<f64>>,
) -> (SmoothedNode, f64) {
    let base = layout.base;
    let wanted = if parameter_sigma.is_some() { NAV } else { base };
    let states = (moments.mean.len(), base, wanted);
    let (error, covariance) = smoothed(moments.covariance_rows, moments.mean, states, adjoint);
    let sigma = |i: usize| covariance[i * wanted + i].max(0.0).sqrt();
    let largest = (0..NAV).map(|i| error[i].abs() / sigma(i).max(1e-12)).fold(0.0, f64::max);
    let mut nominal = *nominal;
    nominal.shift(layout, &error);
    let mut of_nav = [0.0; NAV * NAV];
    for i in 0..NAV {
        of_nav[i * NAV..(i + 1) * NAV].copy_from_slice(&covariance[i * wanted..i * wanted + NAV]);
    }
    let parameter_sigma = parameter_sigma.cloned().unwrap_or_else(|| (NAV..base).map(sigma).collect());
    (SmoothedNode { nominal, covariance: of_nav, parameter_sigma }, largest)
}
