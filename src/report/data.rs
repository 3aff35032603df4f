//! What the report is made of. [`Summary`] is `summary.json`; its keys are public.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::settings::Setting;

/// Statistics of differences.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Discrepancy {
    /// Median \[m\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub median_m: f64,
    /// 1.4826 × median absolute deviation from the median \[m\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub sigma_mad_m: f64,
    /// Root mean square \[m\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub rms_m: f64,
    /// 95th percentile of the absolute value \[m\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub p95_m: f64,
    /// Number.
    pub n: usize,
}

/// `discrepancy` of the summary.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Discrepancies {
    /// Ties in the solution, before.
    pub before: Discrepancy,
    /// Ties in the solution, after.
    pub after: Discrepancy,
    /// Held-out ties, before.
    pub held_out_before: Discrepancy,
    /// Held-out ties, after.
    pub held_out_after: Discrepancy,
}

/// Counts of ties of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TieCounts {
    /// Found.
    pub found: u64,
    /// In the solution.
    pub used: u64,
    /// Held out.
    pub held_out: u64,
}

/// Ties of places of one kind.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PlaceSummary {
    /// Numbers.
    pub counts: TieCounts,
    /// Of those used, how many hold one, two and three directions.
    pub rank: [u64; 3],
    /// Distances of the two places along all directions held, of ties used, before.
    pub before: Discrepancy,
    /// After.
    pub after: Discrepancy,
    /// After, of ties held out.
    pub held_out_after: Discrepancy,
}

/// One strip.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StripSummary {
    /// Name.
    pub name: String,
    /// Points.
    pub points: u64,
    /// First survey time \[s\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub start_s: f64,
    /// Last survey time \[s\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub end_s: f64,
    /// First time in UTC, when the week is known.
    pub start_utc: Option<String>,
    /// Mission.
    pub mission: u16,
    /// Scanners.
    pub scanners: Vec<u16>,
    /// Whether it was held fixed.
    pub fixed: bool,
    /// Where its poses come from.
    pub trajectory: String,
    /// Course \[deg\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub course_deg: f64,
    /// Speed \[m/s\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub speed_mps: f64,
    /// Height above the points \[m\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub height_m: f64,
    /// Correction at its middle: east, north, up \[m\].
    #[serde(deserialize_with = "super::nullable::three")]
    pub correction_enu_m: [f64; 3],
    /// Correction at its middle: rotation about east, north, up \[deg\].
    #[serde(deserialize_with = "super::nullable::three")]
    pub rotation_enu_deg: [f64; 3],
    /// Largest correction over the prior sigma of that component.
    #[serde(deserialize_with = "super::nullable::number")]
    pub largest_over_prior: f64,
    /// Whether that is more than the prior makes plausible.
    pub implausible: bool,
}

/// One pair of strips (or of scanners of one strip).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PairSummary {
    /// First.
    pub a: String,
    /// Second.
    pub b: String,
    /// Differences along the normal, second minus first, used and held out.
    pub before: Discrepancy,
    /// The same after.
    pub after: Discrepancy,
    /// Robust shift of the second against the first before: east, north, up \[m\]; NaN where not determined.
    #[serde(deserialize_with = "super::nullable::three")]
    pub shift_before_m: [f64; 3],
    /// The same after.
    #[serde(deserialize_with = "super::nullable::three")]
    pub shift_after_m: [f64; 3],
}

/// One estimated parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterSummary {
    /// What it belongs to.
    pub block: String,
    /// Name.
    pub name: String,
    /// `m`, `deg` or `ppm`.
    pub unit: String,
    /// Value.
    #[serde(deserialize_with = "super::nullable::number")]
    pub value: f64,
    /// Sigma.
    #[serde(deserialize_with = "super::nullable::number")]
    pub sigma: f64,
    /// Prior sigma.
    #[serde(deserialize_with = "super::nullable::number")]
    pub prior_sigma: f64,
    /// Share that the ties determine: 0 is held by the prior, 1 is free of it.
    #[serde(deserialize_with = "super::nullable::number")]
    pub observed: f64,
}

/// A model that was tried.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrialSummary {
    /// Name, such as `constant`.
    pub model: String,
    /// Unknowns.
    pub unknowns: usize,
    /// Rms of used ties \[m\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub used_rms_m: f64,
    /// Rms of held-out ties \[m\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub held_out_rms_m: f64,
    /// Gain against the model in use before, in standard errors (held-out ties, by place).
    #[serde(deserialize_with = "super::nullable::number")]
    pub gain_t: f64,
    /// Whether it was taken.
    pub taken: bool,
    /// Why, or why not.
    pub reason: String,
}

/// `calibration` of the summary.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct AdjustmentSummary {
    /// Model of the strips in use.
    pub strip_model: String,
    /// Models tried.
    pub trials: Vec<TrialSummary>,
    /// Calibration parameters.
    pub parameters: Vec<ParameterSummary>,
    /// Combinations held by the prior, in words.
    pub unobservable: Vec<String>,
    /// Condition of the normal equations in units of the prior.
    #[serde(deserialize_with = "super::nullable::number")]
    pub condition: f64,
    /// Sigma of unit weight.
    #[serde(deserialize_with = "super::nullable::number")]
    pub sigma0: f64,
    /// Factor on sigmas for errors that neighbours in time have in common.
    #[serde(deserialize_with = "super::nullable::number")]
    pub common_mode_factor: f64,
    /// A-posteriori over a-priori sigma by tie class.
    pub class_scale: BTreeMap<String, f64>,
    /// Outer iterations: ties were measured anew in each.
    pub iterations: usize,
    /// Observations taken out by the outlier test.
    pub outliers: usize,
    /// Warnings: over-adjustment, weak geometry.
    pub warnings: Vec<String>,
}

/// One corrected file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FileSummary {
    /// Input.
    pub input: String,
    /// Output.
    pub output: String,
    /// Points.
    pub points: u64,
    /// Largest shift of a point \[m\].
    #[serde(deserialize_with = "super::nullable::number")]
    pub largest_shift_m: f64,
    /// Scale of the output \[m\].
    #[serde(deserialize_with = "super::nullable::three")]
    pub scale_m: [f64; 3],
    /// What changed in the header, and other remarks.
    pub notes: Vec<String>,
}

/// `timing` of the summary.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Seconds of each stage.
    pub stage: BTreeMap<String, f64>,
    /// CPU seconds of each stage, all threads together; empty where the system does not tell.
    #[serde(default)]
    pub cpu: BTreeMap<String, f64>,
    /// How often each stage went over the points of the strips.
    #[serde(default)]
    pub passes: BTreeMap<String, f64>,
    /// Points per second of the whole job.
    #[serde(deserialize_with = "super::nullable::number")]
    pub points_per_second: f64,
}

/// `summary.json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// Version of tieline.
    pub version: String,
    /// Name of the job.
    pub name: String,
    /// Input files with their numbers of points.
    pub inputs: Vec<(String, u64)>,
    /// Reference system.
    pub crs: String,
    /// Settings with their reasons.
    pub settings: Vec<Setting>,
    /// Remarks of all stages.
    pub notes: Vec<String>,
    /// Strips.
    pub strips: Vec<StripSummary>,
    /// Pairs.
    pub pairs: Vec<PairSummary>,
    /// Ties by kind.
    pub ties: BTreeMap<String, TieCounts>,
    /// Ties of places by how they were found: `submap`, `ridge`, `corner`.
    #[serde(default)]
    pub places: BTreeMap<String, PlaceSummary>,
    /// Ends rejected, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// Differences before and after.
    pub discrepancy: Discrepancies,
    /// The adjustment.
    pub calibration: AdjustmentSummary,
    /// Corrected files.
    pub files: Vec<FileSummary>,
    /// `source` and statistics of the trajectory's correction.
    pub trajectory: BTreeMap<String, String>,
    /// Times.
    pub timing: Timing,
    /// Peak memory \[bytes\].
    pub peak_memory_bytes: u64,
}

/// One difference between two sightings of a surface, for histograms and maps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiePoint {
    /// Easting, northing, height \[m\], map frame.
    pub map_m: [f64; 3],
    /// Row of [`Summary::pairs`].
    pub pair: u32,
    /// Upward component of the unit normal.
    pub normal_up: f64,
    /// Second minus first along the normal before \[m\].
    pub before_m: f64,
    /// After \[m\].
    pub after_m: f64,
    /// Held out of the solution.
    pub held_out: bool,
    /// Taken out by the outlier test.
    pub outlier: bool,
}

impl Discrepancy {
    /// Statistics of values \[m\]; zeros for none.
    #[must_use]
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn of(values: &[f64]) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        let middle = |sorted: &[f64]| {
            let n = sorted.len();
            0.5 * (sorted[(n - 1) / 2] + sorted[n / 2])
        };
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let median_m = middle(&sorted);
        let mut sizes: Vec<f64> = values.iter().map(|v| (v - median_m).abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let sigma_mad_m = 1.4826 * middle(&sizes);
        let mut absolute: Vec<f64> = values.iter().map(|v| v.abs()).collect();
        absolute.sort_by(f64::total_cmp);
        let p95_m = absolute[((values.len() as f64 * 0.95) as usize).min(values.len() - 1)];
        let rms_m = (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
        Self { median_m, sigma_mad_m, rms_m, p95_m, n: values.len() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_a_hand_written_list() {
        let d = Discrepancy::of(&[0.01, -0.01, 0.03, 0.01, 0.01]);
        assert!((d.median_m - 0.01).abs() < 1e-15 && d.n == 5);
        assert!(d.sigma_mad_m.abs() < 1e-15);
        assert!((d.rms_m - (13e-4_f64 / 5.0).sqrt()).abs() < 1e-15 && (d.p95_m - 0.03).abs() < 1e-15);
    }
}
