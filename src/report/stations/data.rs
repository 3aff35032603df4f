//! `summary.json` of a calibration of stations; its keys are public.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::report::data::{Discrepancies, Discrepancy, TieCounts, Timing};
use crate::report::stations::StationsReport;
use crate::settings::Setting;
use crate::stage::stations::pairs::{Fate, Slope};
use crate::stage::stations::solve::SolvedPlane;

/// A scanner.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ScannerSummary {
    /// Number, as in the points.
    pub id: u16,
    /// Name.
    pub name: String,
    /// Whether the others are calibrated against it.
    pub reference: bool,
}

/// A station.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StationSummary {
    /// Name.
    pub name: String,
    /// Points of each scanner.
    pub points: Vec<u64>,
    /// Patches of each scanner.
    pub patches: Vec<u64>,
    /// Common planes in use, of all pairs.
    pub used: u64,
    /// Common planes held out.
    pub held_out: u64,
}

/// Common planes of a kind and of a pair of scanners.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct GroupSummary {
    /// Scanners by name, `a - b`; empty for all pairs.
    pub pair: String,
    /// `ground`, `wall` or `sloped`; empty for all.
    pub kind: String,
    /// Distances of the planes along the normal.
    pub discrepancy: Discrepancies,
}

/// One unknown.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct UnknownSummary {
    /// Scanner.
    pub scanner: u16,
    /// Name, such as `boresight yaw`.
    pub name: String,
    /// `deg` or `m`.
    pub unit: String,
    /// Correction of the rough mounting.
    pub value: f64,
    /// Sigma.
    pub sigma: f64,
    /// Sigma beforehand.
    pub prior_sigma: f64,
    /// Share that the planes tell: 0 is held by its prior, 1 free of it.
    pub observed: f64,
    /// The same by ground alone.
    pub observed_by_ground: f64,
    /// Value and sigma by each station alone, where it sees it.
    pub by_station: BTreeMap<String, [f64; 2]>,
}

/// A combination of unknowns that is seen apart from the others.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DirectionSummary {
    /// Scanner.
    pub scanner: u16,
    /// Coefficient of each unknown that dominates it, in prior sigmas.
    pub members: Vec<(String, f64)>,
    /// Sigma by the planes alone over the prior sigma.
    pub sigma_over_prior: f64,
    /// Shift of a point 20 m away that one sigma makes \[m\].
    pub effect_m: f64,
    /// `seen`, `weakly seen` or `not seen`.
    pub grade: String,
}

/// Motion of a station while its scanners turned.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MotionSummary {
    /// Station.
    pub station: String,
    /// Speed forward and its sigma \[m/s\].
    pub forward_mps: (f64, f64),
    /// Turn rate to the right and its sigma \[deg/s\].
    pub yaw_rate_degps: (f64, f64),
}

/// `calibration`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StationsCalibration {
    /// The unknowns.
    pub unknowns: Vec<UnknownSummary>,
    /// Combinations, weakest first.
    pub directions: Vec<DirectionSummary>,
    /// What is not seen, and what hangs on what, in words.
    pub not_seen: Vec<String>,
    /// Rms of the stations' deviations from the common solution in their sigmas.
    pub station_misfit: f64,
    /// Motion during the spins: station, speed forward \[m/s\] and turn rate to the right \[deg/s\] with their sigmas; empty where
    /// the points span no time, or more than one spin.
    pub motions: Vec<MotionSummary>,
    /// Test of the motions over its limit: above 1 the points ask for them.
    pub motion_test: Option<f64>,
    /// Factor on the sigmas for that.
    pub station_factor: f64,
    /// Sigma of what all points of a patch have in common \[m\].
    pub floor_m: f64,
    /// Sigma of unit weight.
    pub sigma0: f64,
    /// Rounds of pairing and adjustment.
    pub rounds: usize,
    /// Common planes that the outlier test took out.
    pub outliers: usize,
}

/// The summary.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StationsSummary {
    /// Version of the program.
    pub version: String,
    /// Name of the project.
    pub name: String,
    /// Files and their points.
    pub inputs: Vec<(String, u64)>,
    /// Settings with their reasons.
    pub settings: Vec<Setting>,
    /// Remarks.
    pub notes: Vec<String>,
    /// Scanners.
    pub scanners: Vec<ScannerSummary>,
    /// Stations.
    pub stations: Vec<StationSummary>,
    /// Numbers of common planes, under `surface_line`.
    pub ties: BTreeMap<String, TieCounts>,
    /// Common planes of which one patch is held out and the other is not: they do neither.
    pub mixed: u64,
    /// Patches that overlap another scanner's and are no common plane, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// Distances of all common planes, outliers included.
    pub discrepancy: Discrepancies,
    /// The same by kind and by pair.
    pub groups: Vec<GroupSummary>,
    /// The calibration.
    pub calibration: StationsCalibration,
    /// Times.
    pub timing: Timing,
    /// Peak memory \[bytes\].
    pub peak_memory_bytes: u64,
}

/// Distances of some planes before and after, used and held out; those that do neither are left out, outliers are not.
#[must_use]
pub fn discrepancies<'a>(planes: &(impl Iterator<Item = &'a SolvedPlane> + Clone)) -> Discrepancies {
    let of = |fate: Fate, value: fn(&SolvedPlane) -> f64| {
        let values: Vec<f64> = planes.clone().filter(|p| p.plane.fate == fate).map(value).collect();
        Discrepancy::of(&values)
    };
    Discrepancies {
        before: of(Fate::Used, |p| p.before_m),
        after: of(Fate::Used, |p| p.after_m),
        held_out_before: of(Fate::HeldOut, |p| p.before_m),
        held_out_after: of(Fate::HeldOut, |p| p.after_m),
    }
}

/// Groups: by kind, by pair, by pair and kind; empty ones left out.
fn groups(report: &StationsReport<'_>) -> Vec<GroupSummary> {
    let (planes, heads) = (&report.solution.planes, &report.mounts.heads);
    let mut pairs: Vec<Option<[usize; 2]>> = vec![None];
    for i in 0..heads.len() {
        pairs.extend((i + 1..heads.len()).map(|j| Some([i, j])));
    }
    let mut groups = Vec::new();
    for pair in pairs {
        for kind in std::iter::once(None).chain(Slope::ALL.map(Some)) {
            if pair.is_none() && kind.is_none() {
                continue;
            }
            let chosen = planes.iter().filter(|p| {
                pair.is_none_or(|pair| p.plane.heads == pair) && kind.is_none_or(|kind| p.plane.slope == kind)
            });
            let discrepancy = discrepancies(&chosen);
            if discrepancy.after.n + discrepancy.held_out_after.n > 0 {
                groups.push(GroupSummary {
                    pair: pair.map_or_else(String::new, |[i, j]| format!("{} - {}", heads[i].name, heads[j].name)),
                    kind: kind.map_or("", Slope::as_str).to_string(),
                    discrepancy,
                });
            }
        }
    }
    groups
}

fn calibration(report: &StationsReport<'_>) -> StationsCalibration {
    let (solution, mounts) = (report.solution, report.mounts);
    let scanners: Vec<u16> = mounts.calibrated().map(|h| h.scanner).collect();
    let unknowns = solution.parameters.iter().enumerate().map(|(i, p)| {
        let (unit, factor) = if p.is_angle { ("deg", 1f64.to_degrees()) } else { ("m", 1.0) };
        let by_station = solution
            .stations
            .iter()
            .filter(|s| s.seen[i])
            .map(|s| (report.read.stations[s.station].name.clone(), [s.value[i] * factor, s.sigma[i] * factor]));
        UnknownSummary {
            scanner: scanners[i / 6],
            name: p.name.clone(),
            unit: String::from(unit),
            value: solution.values[i] * factor,
            sigma: solution.covariance[(i, i)].max(0.0).sqrt() * factor,
            prior_sigma: p.prior_sigma * factor,
            observed: solution.sight.share[i],
            observed_by_ground: solution.sight.share_of_ground.get(i).copied().unwrap_or(f64::NAN),
            by_station: by_station.collect(),
        }
    });
    let directions = solution.sight.directions.iter().map(|d| DirectionSummary {
        scanner: scanners[d.block],
        members: d.members.iter().map(|(c, name)| (name.clone(), *c)).collect(),
        sigma_over_prior: d.sigma_over_prior,
        effect_m: d.effect_m,
        grade: d.grade.as_str().to_string(),
    });
    StationsCalibration {
        unknowns: unknowns.collect(),
        directions: directions.collect(),
        not_seen: solution.sight.words(mounts, &solution.parameters),
        motions: solution
            .motions
            .iter()
            .map(|m| MotionSummary {
                station: report.read.stations[m.station].name.clone(),
                forward_mps: m.forward_mps,
                yaw_rate_degps: (m.yaw_rate_radps.0.to_degrees(), m.yaw_rate_radps.1.to_degrees()),
            })
            .collect(),
        motion_test: solution.motion_test,
        station_misfit: solution.station_misfit,
        station_factor: solution.station_factor,
        floor_m: solution.floor_m,
        sigma0: solution.adjustment.sigma0,
        rounds: solution.rounds,
        outliers: solution.planes.iter().filter(|p| p.outlier && p.plane.fate == Fate::Used).count(),
    }
}

/// The summary of a report.
#[must_use]
pub fn summarise(report: &StationsReport<'_>) -> StationsSummary {
    let (solution, mounts) = (report.solution, report.mounts);
    let count = |fate: Fate, station: Option<usize>| {
        let of = |p: &&SolvedPlane| p.plane.fate == fate && station.is_none_or(|s| p.plane.station == s);
        solution.planes.iter().filter(of).count() as u64
    };
    let taken = solution.planes.iter().filter(|p| p.plane.fate == Fate::Used && !p.outlier).count() as u64;
    let counts = TieCounts { found: solution.planes.len() as u64, used: taken, held_out: count(Fate::HeldOut, None) };
    StationsSummary {
        version: env!("CARGO_PKG_VERSION").to_string(),
        name: report.name.to_string(),
        inputs: report.read.inputs.clone(),
        settings: report.settings.to_vec(),
        notes: report.read.notes.iter().chain(&solution.notes).cloned().collect(),
        scanners: mounts
            .heads
            .iter()
            .enumerate()
            .map(|(i, h)| ScannerSummary { id: h.scanner, name: h.name.clone(), reference: i == mounts.reference })
            .collect(),
        stations: report
            .read
            .stations
            .iter()
            .enumerate()
            .map(|(i, s)| StationSummary {
                name: s.name.clone(),
                points: s.spins.iter().map(|spin| spin.points_m.len() as u64).collect(),
                patches: solution.patches[i].iter().map(|of_head| of_head.len() as u64).collect(),
                used: count(Fate::Used, Some(i)),
                held_out: count(Fate::HeldOut, Some(i)),
            })
            .collect(),
        ties: BTreeMap::from([(String::from("surface_line"), counts)]),
        mixed: count(Fate::Mixed, None),
        rejected: solution.refused.iter().map(|(reason, n)| (reason.as_str().to_string(), *n as u64)).collect(),
        discrepancy: discrepancies(&solution.planes.iter()),
        groups: groups(report),
        calibration: calibration(report),
        timing: report.timing.clone(),
        peak_memory_bytes: report.peak_memory_bytes,
    }
}
