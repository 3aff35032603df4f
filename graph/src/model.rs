//! The unknowns of a strip adjustment, their priors and their order in the normal equations.
//!
//! Per strip six corrections (position north, east, down; rotation north, east, down), each a sum of the functions
//! of a [`Basis`]; per scanner and mission boresight, lever arm, range offset and range scale, each freely switched.
//! Every unknown has a prior, so that nothing singular is ever inverted.

use nalgebra::{DVector, Vector3};
use serde::{Deserialize, Serialize};

use crate::basis::{Basis, TimeModel};
use crate::georeference::{Calibration, Derivatives, PoseCorrection};
use crate::observation::LineEnd;
use tieline_filter::Pose;

/// What the adjustment is told of a strip.
#[derive(Debug, Clone, PartialEq)]
pub struct StripSpec {
    /// First survey time \[s\].
    pub start_s: f64,
    /// Last survey time \[s\].
    pub end_s: f64,
    /// Whether its trajectory is held fixed.
    pub fixed: bool,
    /// Prior sigma of the position corrections, north-east-down \[m\].
    pub position_sigma_m: Vector3<f64>,
    /// Prior sigma of the rotation corrections, north-east-down \[rad\].
    pub rotation_sigma_rad: Vector3<f64>,
}

/// Which calibration terms are unknowns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrationTerms {
    /// Three boresight angles.
    pub boresight: bool,
    /// Three components of the lever arm.
    pub lever_arm: bool,
    /// Range offset.
    pub range_offset: bool,
    /// Range scale.
    pub range_scale: bool,
}

impl CalibrationTerms {
    /// None of them.
    pub const NONE: Self = Self { boresight: false, lever_arm: false, range_offset: false, range_scale: false };
}

impl Default for CalibrationTerms {
    fn default() -> Self {
        Self { boresight: true, lever_arm: true, range_offset: true, range_scale: true }
    }
}

/// Prior sigmas of the calibration terms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CalibrationSigmas {
    /// Boresight, each component \[rad\].
    pub boresight_rad: f64,
    /// Lever arm, each component \[m\].
    pub lever_arm_m: f64,
    /// Range offset \[m\].
    pub range_offset_m: f64,
    /// Range scale \[1\].
    pub range_scale: f64,
}

/// What an unknown belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum ParameterBlock {
    /// A strip, by index.
    Strip(usize),
    /// A scanner in a mission, by index of the calibration block.
    Calibration(usize),
}

/// One unknown.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// What it belongs to.
    pub block: ParameterBlock,
    /// Name, such as `boresight roll` or `down constant`.
    pub name: String,
    /// Whether it is an angle \[rad\]; else metres or metres per metre.
    pub is_angle: bool,
    /// Prior sigma.
    pub prior_sigma: f64,
}

/// The unknowns and the present state of a strip adjustment.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    parameters: Vec<Parameter>,
    strips: Vec<Option<(usize, Basis)>>,
    calibrations: Vec<[Option<usize>; 8]>,
    state: DVector<f64>,
}

const STRIP_COMPONENTS: [&str; 6] = ["north", "east", "down", "rotation north", "rotation east", "rotation down"];
const CALIBRATION_NAMES: [&str; 8] = [
    "boresight roll",
    "boresight pitch",
    "boresight yaw",
    "lever arm forward",
    "lever arm right",
    "lever arm down",
    "range offset",
    "range scale",
];

impl Model {
    /// The model of strips (corrections over time as `time_models` says for each; `None`: not corrected) and
    /// calibration blocks.
    #[must_use]
    pub fn new(
        strips: &[StripSpec],
        time_models: &[Option<TimeModel>],
        calibrations: usize,
        terms: CalibrationTerms,
        sigmas: &CalibrationSigmas,
    ) -> Self {
        Self::with_terms(strips, time_models, &vec![terms; calibrations], sigmas)
    }

    /// The same with terms of its own for each calibration block: [`CalibrationTerms::NONE`] for a scanner that the
    /// others are compared with.
    #[must_use]
    pub fn with_terms(
        strips: &[StripSpec],
        time_models: &[Option<TimeModel>],
        terms: &[CalibrationTerms],
        sigmas: &CalibrationSigmas,
    ) -> Self {
        let mut parameters = Vec::new();
        let strips = strips
            .iter()
            .enumerate()
            .map(|(i, strip)| {
                let model = time_models.get(i).copied().flatten().filter(|_| !strip.fixed)?;
                let basis = Basis::new(model, strip.start_s, strip.end_s);
                let first = parameters.len();
                for k in 0..basis.count() {
                    for (component, name) in STRIP_COMPONENTS.iter().enumerate() {
                        let is_angle = component >= 3;
                        let prior_sigma = if is_angle {
                            strip.rotation_sigma_rad[component - 3]
                        } else {
                            strip.position_sigma_m[component]
                        };
                        let name = format!("{name} {}", basis.coefficient_name(k));
                        parameters.push(Parameter { block: ParameterBlock::Strip(i), name, is_angle, prior_sigma });
                    }
                }
                Some((first, basis))
            })
            .collect();
        let calibrations = terms
            .iter()
            .enumerate()
            .map(|(block, terms)| {
                std::array::from_fn(|k| {
                    let (wanted, prior_sigma) = match k {
                        0..3 => (terms.boresight, sigmas.boresight_rad),
                        3..6 => (terms.lever_arm, sigmas.lever_arm_m),
                        6 => (terms.range_offset, sigmas.range_offset_m),
                        _ => (terms.range_scale, sigmas.range_scale),
                    };
                    wanted.then(|| {
                        parameters.push(Parameter {
                            block: ParameterBlock::Calibration(block),
                            name: CALIBRATION_NAMES[k].to_string(),
                            is_angle: k < 3,
                            prior_sigma,
                        });
                        parameters.len() - 1
                    })
                })
            })
            .collect();
        let state = DVector::zeros(parameters.len());
        Self { parameters, strips, calibrations, state }
    }

    /// Number of unknowns.
    #[must_use]
    pub fn count(&self) -> usize {
        self.parameters.len()
    }
    /// The unknowns, in order.
    #[must_use]
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }
    /// The unknowns that belong together, in order: the six of one knot of a strip, those of one calibration.
    #[must_use]
    pub fn nodes(&self) -> Vec<std::ops::Range<usize>> {
        let knots = self.strips.iter().flatten().flat_map(|(first, basis)| {
            let first = *first;
            (0..basis.count()).map(move |k| first + 6 * k..first + 6 * (k + 1))
        });
        let calibrations = self.calibrations.iter().filter_map(|terms| {
            let first = terms.iter().flatten().min()?;
            Some(*first..first + terms.iter().flatten().count())
        });
        knots.chain(calibrations).collect()
    }
    /// Their present values.
    #[must_use]
    pub fn state(&self) -> &DVector<f64> {
        &self.state
    }
    /// Sets their values.
    ///
    /// # Panics
    /// When the length is not [`Model::count`].
    pub fn set_state(&mut self, state: DVector<f64>) {
        assert_eq!(state.len(), self.parameters.len(), "one value for each unknown");
        self.state = state;
    }
    /// Index of the first coefficient of a strip and its basis; `None` when the strip is not corrected.
    #[must_use]
    pub fn strip_basis(&self, strip: usize) -> Option<(usize, Basis)> {
        self.strips.get(strip).copied().flatten()
    }

    /// The correction of a strip's pose at a time.
    #[must_use]
    pub fn pose_correction(&self, strip: usize, time_s: f64) -> PoseCorrection {
        let mut sum = [0.0; 6];
        if let Some((first, basis)) = self.strip_basis(strip) {
            let (k0, weights, n) = basis.at(time_s);
            for (k, weight) in weights.iter().enumerate().take(n) {
                for (component, value) in sum.iter_mut().enumerate() {
                    *value += weight * self.state[first + (k0 + k) * 6 + component];
                }
            }
        }
        PoseCorrection {
            position_ned_m: Vector3::new(sum[0], sum[1], sum[2]),
            rotation_ned_rad: Vector3::new(sum[3], sum[4], sum[5]),
        }
    }

    /// The correction of a scanner.
    #[must_use]
    pub fn calibration(&self, block: usize) -> Calibration {
        let value = |k: usize| self.calibrations[block][k].map_or(0.0, |i| self.state[i]);
        Calibration {
            boresight_rad: Vector3::new(value(0), value(1), value(2)),
            lever_arm_m: Vector3::new(value(3), value(4), value(5)),
            range_offset_m: value(6),
            range_scale: value(7),
        }
    }

    /// Row of the design matrix of an end: indices of unknowns and derivatives of `n · x`.
    #[must_use]
    pub fn row(&self, end: &LineEnd, normal: &Vector3<f64>) -> Vec<(usize, f64)> {
        if end.parts.is_empty() {
            return self.row_at(end, (end.time_s, &end.pose), &end.point_m, normal);
        }
        let mut sum = std::collections::BTreeMap::new();
        for part in &end.parts {
            for (index, value) in self.row_at(end, (part.time_s, &part.pose), &part.point_m, &part.along) {
                *sum.entry(index).or_insert(0.0) += value;
            }
        }
        sum.into_iter().collect()
    }

    /// The derivatives of `along·x` for a point \[m\] that the end's strip and scanner measured at a time \[s\] from a pose.
    fn row_at(
        &self,
        end: &LineEnd,
        (time_s, pose): (f64, &Pose),
        point_m: &Vector3<f64>,
        along: &Vector3<f64>,
    ) -> Vec<(usize, f64)> {
        let Some(strip) = end.strip else { return Vec::new() };
        let correction = self.pose_correction(strip, time_s);
        let calibration = self.calibration(end.calibration);
        let d = Derivatives::new(pose, &end.lever_arm_m, &correction, &calibration, point_m, along);
        let mut row = Vec::with_capacity(32);
        if let Some((first, basis)) = self.strip_basis(strip) {
            let (k0, weights, n) = basis.at(time_s);
            for (k, weight) in weights.iter().enumerate().take(n) {
                for component in 0..3 {
                    row.push((first + (k0 + k) * 6 + component, weight * d.position[component]));
                }
                for component in 0..3 {
                    row.push((first + (k0 + k) * 6 + 3 + component, weight * d.rotation[component]));
                }
            }
        }
        let by_term = [
            d.boresight.x,
            d.boresight.y,
            d.boresight.z,
            d.lever_arm.x,
            d.lever_arm.y,
            d.lever_arm.z,
            d.range_offset,
            d.range_scale,
        ];
        for (index, value) in self.calibrations[end.calibration].iter().zip(by_term) {
            if let Some(index) = index {
                row.push((*index, value));
            }
        }
        row
    }
}
