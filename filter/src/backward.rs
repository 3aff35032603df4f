//! The backward pass over the tape.

use crate::adjoint::{Adjoint, smoothed};
use crate::doubt::{Judged, TieUpdate, judge};
use crate::kalman::Slots;
use crate::smoother::SmootherError;
use crate::state::{Layout, NAV, Nominal};
use crate::tape::{Moments, Tape};

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
    let (all_states, quick_states) = ((0..layout.base).collect::<Vec<_>>(), layout.quick_states());
    let mut whole = 0;
    for index in (0..tape.len()).rev() {
        let (record, moments) = tape.read(index)?;
        if let Some(moments) = moments {
            place -= 1;
            let states = if moments.is_whole(layout.base) { &all_states } else { &quick_states };
            let later: Option<&SmoothedNode> = nodes.last();
            let (node, moved) = smooth(layout, (moments, states), &nominals[place], &adjoint, later);
            largest = largest.max(moved);
            nodes.push(node);
            if moments.is_whole(layout.base) {
                interpolate_parameters(&mut nodes[whole..]);
                whole = nodes.len() - 1;
            }
        }
        for (number, deletion) in adjoint.back_through(&record, layout.base) {
            if let Some(tie) = waiting.next_if(|t| t.place == (index, number)) {
                judged.extend(judge(&deletion, tie, false_alarm));
            }
        }
    }
    nodes.reverse();
    Ok((nodes, largest, judged))
}

/// What changes slowly, between two nodes that were smoothed with all their states.
fn interpolate_parameters(nodes: &mut [SmoothedNode]) {
    let [first, between @ .., last] = nodes else { return };
    let (a, b) = (&first.nominal, &last.nominal);
    let span_s = b.nav.time_s - a.nav.time_s;
    for node in between {
        let share = (node.nominal.nav.time_s - a.nav.time_s) / span_s;
        node.nominal.parameters = node.nominal.parameters.between(&a.parameters, &b.parameters, share);
    }
}

/// A node smoothed, and its largest change over sigma against what was linearised at. Standard deviations of parameters
/// change slowly: where not all states are there, they are those of the node after it.
fn smooth(
    layout: &Layout,
    (moments, states): (Moments<'_>, &[usize]),
    nominal: &Nominal,
    adjoint: &Adjoint,
    later: Option<&SmoothedNode>,
) -> (SmoothedNode, f64) {
    let later = later.filter(|_| states.len() < layout.base).map(|n| &n.parameter_sigma);
    let wanted = if later.is_some() { NAV } else { layout.base };
    let mean: Vec<f64> = states.iter().map(|i| moments.mean[*i]).collect();
    let (of_states, covariance) = smoothed(moments.covariance_rows, &mean, (moments.mean.len(), wanted), adjoint);
    let mut error = vec![0.0; layout.base];
    for (i, e) in states.iter().zip(of_states) {
        error[*i] = e;
    }
    let sigma = |i: usize| covariance[i * wanted + i].max(0.0).sqrt();
    let largest = (0..NAV).map(|i| error[i].abs() / sigma(i).max(1e-12)).fold(0.0, f64::max);
    let mut nominal = *nominal;
    nominal.shift(layout, &error);
    let mut of_nav = [0.0; NAV * NAV];
    for i in 0..NAV {
        of_nav[i * NAV..(i + 1) * NAV].copy_from_slice(&covariance[i * wanted..i * wanted + NAV]);
    }
    let parameter_sigma = later.cloned().unwrap_or_else(|| (NAV..layout.base).map(sigma).collect());
    (SmoothedNode { nominal, covariance: of_nav, parameter_sigma }, largest)
}
