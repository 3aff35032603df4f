//! Sightings of ties in the forward pass.

use nalgebra::Vector3;

use super::{EXTRA_SLOTS, Run};
use crate::doubt::{LEFT_OUT_WEIGHT, TieUpdate};
use crate::events::{Event, EventKind};
use crate::innovation::MeasurementKind;
use crate::kalman::{Measurement, Stay};
use crate::options::TieForm;
use crate::smoother::SmootherError;
use crate::state::Nominal;
use crate::update::tie;

/// A tie that is being seen.
#[derive(Debug, Clone, Default)]
pub(super) struct LiveTie {
    /// One entry a sighting (delayed form) or one only (landmark form).
    pub states: Vec<(usize, Vec<usize>, Vec<f64>)>,
}

/// A sighting that waits for the covariance to make a step: no longer than the step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Waiting {
    pub event: Event,
    /// That of its own moment.
    pub nominal: Nominal,
    pub until_s: f64,
}

/// Ties whose sightings span no more than this leave soon \[s\].
const BRIEF_S: f64 = 5.0;

impl Run<'_> {
    /// A sighting waits for the covariance to make a step.
    pub(super) fn wait(&mut self, event: &Event) {
        let until_s = self.propagator.covariance_time_s() + self.plan.options.step_s;
        self.waiting.push(Waiting { event: *event, nominal: self.propagator.nominal, until_s });
    }

    /// Takes a comparison of sightings in, with the weight that the run before found for it.
    fn compare(&mut self, mut m: Measurement, event: &Event, sighting: (usize, usize)) -> Result<(), SmootherError> {
        let noise = m.noise.clone();
        let trusted = self.plan.trust.and_then(|t| t.get(&sighting).copied()).unwrap_or(1.0);
        m.noise.iter_mut().for_each(|r| *r /= trusted);
        let operations = self.operations.len();
        let tested = self.take(m, event, MeasurementKind::Tie)?;
        let weight = trusted * tested;
        if self.operations.len() > operations {
            let place = (self.records, operations);
            self.result.tie_updates.push(TieUpdate { place, sighting, time_s: event.time_s, weight, noise });
        }
        let (t, s) = sighting;
        self.result.tie_weight[t][s] = Some(if weight > LEFT_OUT_WEIGHT { weight } else { 0.0 });
        Ok(())
    }

    /// A sighting of a tie: the first lets its states enter, the others compare, the last lets them leave.
    pub(super) fn sighting(&mut self, event: &Event, nominal: &Nominal) -> Result<(), SmootherError> {
        let EventKind::Sighting(t, s) = event.kind else { return Ok(()) };
        let tie = &self.plan.inputs.ties[t];
        let sighting = &tie.sightings[s];
        let held_s = nominal.nav.time_s - self.propagator.covariance_time_s();
        let calibration = self.plan.layout.calibration;
        let (values, rows) = tie::coordinates(nominal, tie, sighting, &self.origin_ecef_m, (held_s, calibration));
        let noise = tie::noise(tie, sighting);
        let rank = values.len();
        if let Some(known) = &tie.known_m {
            let from_origin = |(u, k): (&Vector3<f64>, &f64)| k - u.dot(&self.origin_ecef_m);
            let due = tie.directions.iter().zip(known).map(from_origin);
            let residual = due.zip(&values).map(|(k, v)| k - v).collect();
            return self.compare(Measurement { residual, rows, noise }, event, (t, s));
        }
        let last = s + 1 == tie.sightings.len();
        let delayed = self.plan.options.ties.form == TieForm::Delayed;
        let starts = self.live[t].is_none();
        if starts && last {
            return Ok(()); // its other sightings were before the beginning
        }
        if starts || (delayed && !last) {
            if self.gaussian.free_slots() < rank + if self.rest.is_none() { EXTRA_SLOTS } else { 0 } {
                return Ok(());
            }
            let span_s = tie.sightings[tie.sightings.len() - 1].time_s - sighting.time_s;
            let stay = if span_s <= BRIEF_S { Stay::Brief } else { Stay::Lasting };
            let slots: Option<Vec<usize>> = rows
                .into_iter()
                .enumerate()
                .map(|(k, row)| self.enter(row, if delayed { 0.0 } else { noise[k * rank + k] }, stay))
                .collect();
            if let Some(slots) = slots {
                self.live[t].get_or_insert_default().states.push((s, slots, values));
                self.result.tie_weight[t][s] = Some(1.0);
            }
            return Ok(());
        }
        let live = if last { self.live[t].take() } else { self.live[t].clone() };
        let Some(live) = live else { return Ok(()) };
        let measurement = if delayed {
            tie::all_at_once(tie, s, &values, &rows, &live.states)
        } else {
            tie::against_landmark(&values, &rows, &noise, &live.states[0].1, &live.states[0].2)
        };
        self.compare(measurement, event, (t, s))?;
        if last {
            for (_, slots, _) in &live.states {
                for at in slots {
                    self.gaussian.leave(*at);
                }
            }
        }
        Ok(())
    }
}
