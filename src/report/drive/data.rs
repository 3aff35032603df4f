//! What the report of a drive is made of. [`DriveSummary`] is `summary.json` of a drive; its keys are public.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use tieline_filter::CorrectionRow;

use super::curves::{CurveSummary, OverCurveSummary};
use crate::report::data::{Discrepancies, Discrepancy, FileSummary, Summary, TieCounts, Timing};
use crate::report::nullable;
use crate::settings::Setting;
use crate::stage::drive::again::Gain;
use crate::stage::drive::cut::{Cut, CutPoint};
use crate::stage::drive::ties::Class;

/// Numbers of measurements.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct MeasurementCounts {
    /// Samples of the IMU.
    pub imu_samples: usize,
    /// Seconds between them.
    #[serde(deserialize_with = "nullable::numbers")]
    pub imu_interval_s: f64,
    /// GNSS fixes.
    pub gnss_fixes: usize,
    /// Readings of the odometer.
    pub odometer_readings: usize,
    /// Known points.
    pub known_points: usize,
}

/// One strip.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct DriveStrip {
    /// Name.
    pub name: String,
    /// Points.
    pub points: u64,
    /// First survey time \[s\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub start_s: f64,
    /// Last survey time \[s\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub end_s: f64,
    /// First time in UTC, when the week is known.
    pub start_utc: Option<String>,
    /// Scanners.
    pub scanners: Vec<u16>,
    /// Correction of the trajectory at its middle: east, north, up \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub correction_enu_m: [f64; 3],
    /// Largest correction of the trajectory within it \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub largest_correction_m: f64,
}

/// Ties of a kind or class.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct ClassSummary {
    /// Their numbers.
    #[serde(flatten)]
    pub counts: TieCounts,
    /// Their differences.
    pub discrepancy: Discrepancies,
}

/// Differences of pairs of sightings over range or lateral distance, in bins; used ties and held-out ones apart.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct DifferenceOver {
    /// What the pairs bind.
    pub class: String,
    /// `range` or `lateral distance`.
    pub over: String,
    /// Whether these are the ties that took no part.
    pub held_out: bool,
    /// Middle of each bin \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub at_m: Vec<f64>,
    /// By the trajectory and mounting that the strips were made with.
    pub before: Vec<Discrepancy>,
    /// By the new ones.
    pub after: Vec<Discrepancy>,
}

/// A term of the calibration.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct TermSummary {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// Name.
    pub name: String,
    /// Estimated, or fixed at its nominal value.
    pub estimated: bool,
    /// Above 1 the data ask for it.
    #[serde(deserialize_with = "nullable::numbers")]
    pub test: f64,
    /// Directions of it that the data do not see.
    pub directions_not_seen: usize,
}

/// A value of the calibration, as a correction of the platform.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct EstimateSummary {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// Term.
    pub term: String,
    /// Term and axis.
    pub name: String,
    /// `deg`, `m` or `s`.
    pub unit: String,
    /// Value.
    #[serde(deserialize_with = "nullable::numbers")]
    pub value: f64,
    /// Standard deviation.
    #[serde(deserialize_with = "nullable::numbers")]
    pub sigma: f64,
    /// Standard deviation beforehand.
    #[serde(deserialize_with = "nullable::numbers")]
    pub prior_sigma: f64,
}

/// `calibration` of the summary.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct DriveCalibration {
    /// Terms.
    pub terms: Vec<TermSummary>,
    /// Values.
    pub estimates: Vec<EstimateSummary>,
    /// Range bias of the scanners whose range correction is estimated.
    pub range_bias: Vec<CurveSummary>,
    /// The same over incidence and intensity, where it is estimated or known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub range_bias_over: Vec<OverCurveSummary>,
}

/// A stretch without GNSS.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Outage {
    /// Last fix before \[s\], survey time.
    #[serde(deserialize_with = "nullable::numbers")]
    pub start_s: f64,
    /// First fix after \[s\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub end_s: f64,
    /// Largest correction of the trajectory in it \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub largest_correction_m: f64,
    /// Largest standard deviation of the new trajectory in it: east, north, up \[m\]; roll, pitch, heading \[deg\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub largest_sigma_enu_m: [f64; 3],
    /// Roll, pitch, heading \[deg\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub largest_sigma_rph_deg: [f64; 3],
    /// The same of the trajectory that the strips were made with, where it is known \[m\].
    #[serde(default, deserialize_with = "nullable::numbers")]
    pub largest_sigma_before_enu_m: Option<[f64; 3]>,
}

/// The largest correction.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct LargestCorrection {
    /// Survey time \[s\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub time_s: f64,
    /// East, north, up \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub enu_m: [f64; 3],
    /// Length \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub length_m: f64,
}

/// Innovations of a kind of measurement.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct InnovationSummary {
    /// Measurements.
    pub count: usize,
    /// Down-weighted.
    pub down_weighted: usize,
    /// Left out.
    pub left_out: usize,
    /// Normalised innovation squared per component, mean: 1 when the filter is right.
    #[serde(deserialize_with = "nullable::numbers")]
    pub mean_nis_per_component: f64,
}

/// `trajectory` of the summary.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct DriveTrajectory {
    /// Epochs.
    pub epochs: usize,
    /// First and last time \[s\], clock of the measurements.
    #[serde(deserialize_with = "nullable::numbers")]
    pub span_s: [f64; 2],
    /// Root mean squares of the standard deviations north, east, down \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub rms_sigma_position_ned_m: [f64; 3],
    /// The same of roll, pitch, heading \[deg\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub rms_sigma_roll_pitch_heading_deg: [f64; 3],
    /// Runs of the smoother.
    pub runs: usize,
    /// Largest change of the last run, over sigma.
    #[serde(deserialize_with = "nullable::numbers")]
    pub last_change_sigma: f64,
    /// Ties given to the smoother, and left out by it.
    pub ties_given: usize,
    /// Left out.
    pub ties_left_out: usize,
    /// Largest difference, new less old.
    pub largest_correction: LargestCorrection,
    /// Stretches of more than 5 s without GNSS.
    pub outages: Vec<Outage>,
    /// Innovations by kind of measurement.
    pub innovations: BTreeMap<String, InnovationSummary>,
    /// Remarks of the smoother.
    pub notes: Vec<String>,
}

/// `summary.json` of a drive.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct DriveSummary {
    /// Version of tieline.
    pub version: String,
    /// Name of the job.
    pub name: String,
    /// Input files with their numbers of points.
    pub inputs: Vec<(String, u64)>,
    /// What the trajectory was made of.
    pub measurements: MeasurementCounts,
    /// Reference system.
    pub crs: String,
    /// Settings with their reasons.
    pub settings: Vec<Setting>,
    /// Strips.
    pub strips: Vec<DriveStrip>,
    /// Ties by kind.
    pub ties: BTreeMap<String, ClassSummary>,
    /// Ties by what they bind; differences count towards the vehicle, those of scanner to scanner are of one visit of any tie, the
    /// scanner of the highest number less that of the lowest.
    pub ties_by_class: BTreeMap<String, ClassSummary>,
    /// Ends rejected, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// What it changed to measure ties again on the corrected cloud.
    #[serde(default)]
    pub measured_again: Option<Gain>,
    /// Differences, last less first sighting of each line, before and after.
    pub discrepancy: Discrepancies,
    /// Differences over range and lateral distance, by class; they count towards the vehicle.
    pub difference_over: Vec<DifferenceOver>,
    /// Calibration.
    pub calibration: DriveCalibration,
    /// Trajectory.
    pub trajectory: DriveTrajectory,
    /// Corrected files.
    pub files: Vec<FileSummary>,
    /// Remarks of all stages.
    pub notes: Vec<String>,
    /// Times.
    pub timing: Timing,
    /// Peak memory \[bytes\].
    pub peak_memory_bytes: u64,
}

impl DriveSummary {
    /// The parts that the report of strips has as well, for the sections that both share.
    pub(crate) fn shared(&self) -> Summary {
        Summary {
            version: self.version.clone(),
            name: self.name.clone(),
            inputs: self.inputs.clone(),
            crs: self.crs.clone(),
            settings: self.settings.clone(),
            notes: self.notes.clone(),
            ties: self.ties.iter().map(|(kind, t)| (kind.clone(), t.counts)).collect(),
            rejected: self.rejected.clone(),
            discrepancy: self.discrepancy,
            files: self.files.clone(),
            timing: self.timing.clone(),
            peak_memory_bytes: self.peak_memory_bytes,
            ..Summary::default()
        }
    }
}

/// Two sightings of a line as the charts show them.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct PairPoint {
    /// What they bind.
    pub(crate) class: Class,
    /// East, north \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) east_north_m: [f64; 2],
    /// Higher scanner less lower, or later less earlier, towards the vehicle: before, after \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) difference_m: (f64, f64),
    /// Mean range of the two sightings \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) range_m: f64,
    /// To the right of the vehicle, at the first sighting \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) lateral_m: f64,
    /// Held out of the solution.
    pub(crate) held_out: bool,
}

/// What time axes count from.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct Origin {
    /// Survey time \[s\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) time_s: f64,
    /// The same as seconds of week, and the week; as they are where the week is not known.
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) second: f64,
    /// GPS week.
    pub(crate) week: Option<u32>,
}

impl Origin {
    /// Seconds of week of a survey time \[s\]; they run on past the end of the week.
    pub(crate) fn second_of(&self, time_s: f64) -> f64 {
        time_s - self.time_s + self.second
    }

    /// A survey time \[s\] in words.
    pub(crate) fn words(&self, time_s: f64, decimals: usize) -> String {
        let second = format!("second {:.decimals$}", self.second_of(time_s));
        self.week.map_or_else(|| second.clone(), |week| format!("{second} of GPS week {week}"))
    }
}

/// What a sighting of a tie said against what the filter expected of it.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct TieInnovation {
    /// What the tie binds.
    pub(crate) class: Class,
    /// Survey time \[s\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) time_s: f64,
    /// Over its expected standard deviation.
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) normalised: f64,
    /// Whether the smoother left the sighting out in the end.
    pub(crate) left_out: bool,
}

/// What only the charts need.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct DriveCharts {
    /// What the time axes count from.
    pub(crate) origin: Origin,
    /// First and last time of the strips \[s\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) span_s: (f64, f64),
    /// Differences of the trajectories, with the new one's standard deviations.
    pub(crate) corrections: Vec<CorrectionRow>,
    /// Standard deviations of the old one at these times, where known: east, north, up \[m\], roll, pitch, heading \[rad\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) sigma_before: Vec<Option<[f64; 6]>>,
    /// Times of the sightings of used ties: loop ties, increments \[s\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) tie_times_s: [Vec<f64>; 2],
    /// Differences of all lines, last less first sighting: before, after \[m\], held out.
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) lines: Vec<(f64, f64, bool)>,
    /// Pairs of sightings by class.
    pub(crate) pairs: Vec<PairPoint>,
    /// Path: time \[s\], east, north \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub(crate) path: Vec<[f64; 3]>,
    /// Innovations of ties, in order of time.
    #[serde(default)]
    pub(crate) innovations: Vec<TieInnovation>,
    /// Where the cloud is cut to be looked at.
    #[serde(default)]
    pub(crate) cuts: Vec<Cut>,
}

/// What `correct` leaves for the report.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct CorrectedDrive {
    /// Corrected files.
    pub(crate) files: Vec<FileSummary>,
    /// Points of the cuts, in their order.
    pub(crate) cut_points: Vec<Vec<CutPoint>>,
}
