//! The calibration of stations: pairs and adjustment in turn until neither changes.

use std::collections::BTreeMap;

use anyhow::{Result, bail};
use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;
use tieline_graph::{
    AdjustOptions, Adjustment, Calibration, CalibrationSigmas, CalibrationTerms, Line, Model, Parameter,
    PoseCorrection, adjust,
};
use tieline_matching::{Patch, Rejection, Sighting, planar_patches};

use super::check::{Mounting, StationValue, agreement, mounting_rows, station_values, without_walls};
use super::hold_out::held_out;
use super::motion::{Motion, motions, need, specs, time_models};
use super::pairs::{CommonPlane, Fate, Ground, Patches, after_m, before_m, find, map_of, measured, moved};
use super::sight::{Sight, sight};
use super::{Mounts, Station, StationOptions};

/// Most rounds of pairing and adjustment; after the first of them the pairs stay: a few may come and go for ever.
const MOST_ROUNDS: usize = 25;
const FREE_ROUNDS: usize = 10;
/// The adjustment stands when no unknown moves by more than this share of its prior sigma.
const STANDS: f64 = 1e-4;
/// Where the estimate of the floor begins and how low it may go \[m\].
const FIRST_FLOOR_M: f64 = 0.01;
const LEAST_FLOOR_M: f64 = 0.0005;
/// Highest floor that is tried \[m\].
const MOST_FLOOR_M: f64 = 0.5;
/// A scanner with fewer common planes is weakly tied.
const FEW_PLANES: usize = 20;

/// A common plane with what became of it.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedPlane {
    /// Whose it is and what it is for.
    pub plane: CommonPlane,
    /// Common place, body frame \[m\].
    pub point_m: Vector3<f64>,
    /// Common normal, body frame.
    pub normal: Vector3<f64>,
    /// Distance of the planes there by the rough mounting \[m\].
    pub before_m: f64,
    /// By the calibrated mounting \[m\].
    pub after_m: f64,
    /// Sigma of each end, a posteriori \[m\].
    pub sigma_m: [f64; 2],
    /// Whether the outlier test took it out.
    pub outlier: bool,
}

/// The calibrated mounting and how it was found.
#[derive(Debug, Clone)]
pub struct StationsSolution {
    /// Patches in the body frame by the rough mounting.
    pub patches: Patches,
    /// Common planes.
    pub planes: Vec<SolvedPlane>,
    /// Correction of each scanner; nothing for the reference.
    pub corrections: Vec<Calibration>,
    /// Motion of the stations during their spins.
    pub motions: Vec<Motion>,
    /// The test of those motions over its limit; `None` where there was nothing to test.
    pub motion_test: Option<f64>,
    /// The unknowns: three angles and three lengths for each calibrated scanner.
    pub parameters: Vec<Parameter>,
    /// Their values.
    pub values: Vec<f64>,
    /// Their covariance, with the factor below.
    pub covariance: DMatrix<f64>,
    /// Factor on the sigmas because stations disagree more than chance allows (1: they do not).
    pub station_factor: f64,
    /// Rms of the stations' deviations from the common solution in their sigmas; NaN with one station.
    pub station_misfit: f64,
    /// What each station says by itself.
    pub stations: Vec<StationValue>,
    /// What is not seen.
    pub sight: Sight,
    /// The adjustment.
    pub adjustment: Adjustment,
    /// Sigma of what all points of a patch have in common, found from the misclosures \[m\].
    pub floor_m: f64,
    /// Rounds of pairing and adjustment.
    pub rounds: usize,
    /// Patches that overlap another scanner's and are no common plane, and why.
    pub refused: BTreeMap<Rejection, usize>,
    /// What a user should be told.
    pub notes: Vec<String>,
}

/// State of the rounds.
pub(super) struct Round {
    pub(super) planes: Vec<CommonPlane>,
    pub(super) lines: Vec<(Line, Option<Vector3<f64>>)>,
    pub(super) adjustment: Adjustment,
    refused: BTreeMap<Rejection, usize>,
    floor_m: f64,
    rounds: usize,
    stands: bool,
}

/// Calibrates the scanners of stations against the reference.
///
/// # Errors
/// No patches, no common planes, scanners without a plane in common with the others; angles in the wrong unit.
pub fn calibrate(stations: &[Station], mounts: &Mounts, options: &StationOptions) -> Result<StationsSolution> {
    let patches = patches_of(stations, mounts, options);
    let held = held_out(&patches, mounts.reference, options);
    let ground = Ground { mounts, patches: &patches, held: &held, options };
    let mut model = model_of(mounts, stations);
    check_units(&ground, &model, stations, options)?;
    let mut round = settle(&ground, &mut model)?;
    let motion_test = need(&model, &round.adjustment.covariance, stations.len());
    check_connected(mounts, &round.planes)?;
    round.lines = measured(&ground, &round.planes, &model, round.floor_m);
    let motions = motions(&model, &round.adjustment.covariance, stations);
    let own = Mounting::of(&model, &round.adjustment.covariance);
    let by_station = station_values(&round, &model, stations.len());
    let (station_misfit, station_factor) = agreement(&by_station, &own);
    let covariance = &own.covariance * station_factor.powi(2);
    let without_walls = without_walls(&round, &model);
    let sight = sight(mounts, &own.parameters, &covariance, without_walls.as_ref());
    let mut solution = StationsSolution {
        planes: solved(&round),
        corrections: (0..mounts.heads.len()).map(|h| model.calibration(h)).collect(),
        motions,
        motion_test,
        parameters: own.parameters,
        values: own.values,
        covariance,
        station_factor,
        station_misfit,
        stations: by_station,
        sight,
        floor_m: round.floor_m,
        rounds: round.rounds,
        refused: round.refused,
        adjustment: round.adjustment,
        notes: Vec::new(),
        patches: Vec::new(),
    };
    solution.notes = notes(&solution, mounts, round.stands);
    solution.patches = patches;
    Ok(solution)
}

/// The patches of every station and scanner in the body frame by the rough mounting.
#[allow(clippy::cast_possible_truncation)] // numbers of stations and scanners
fn patches_of(stations: &[Station], mounts: &Mounts, options: &StationOptions) -> Patches {
    stations
        .par_iter()
        .enumerate()
        .map(|(number, station)| {
            let spins = station.spins.iter().zip(&mounts.heads);
            spins
                .map(|(spin, head)| {
                    let sighting = Sighting { strip: number as u32, pass: 0, scanner: head.scanner };
                    let found =
                        planar_patches(&spin.points_m, &spin.intensity, &spin.time_s, sighting, &options.planar);
                    found.into_iter().map(|patch| mounted(patch, head)).collect()
                })
                .collect()
        })
        .collect()
}

/// A patch of a scanner's frame in the body frame.
fn mounted(mut patch: Patch, head: &super::Head) -> Patch {
    let turn = head.body_from_scanner;
    patch.centroid_m = head.lever_arm_m + turn * patch.centroid_m;
    patch.normal = turn * patch.normal;
    patch.long_axis = turn * patch.long_axis;
    patch
}

/// Boresight and lever arm of every scanner but the reference; of the stations no more than what they moved in a spin.
fn model_of(mounts: &Mounts, stations: &[Station]) -> Model {
    let both = CalibrationTerms { boresight: true, lever_arm: true, range_offset: false, range_scale: false };
    let terms: Vec<CalibrationTerms> = (0..mounts.heads.len())
        .map(|head| if head == mounts.reference { CalibrationTerms::NONE } else { both })
        .collect();
    let sigmas = CalibrationSigmas {
        boresight_rad: mounts.boresight_sigma_rad,
        lever_arm_m: mounts.lever_arm_sigma_m,
        range_offset_m: 1.0,
        range_scale: 1.0,
    };
    Model::with_terms(&specs(stations), &time_models(stations), &terms, &sigmas)
}

fn prior(model: &Model) -> DMatrix<f64> {
    let rows = mounting_rows(model);
    let variances = rows.iter().map(|i| model.parameters()[*i].prior_sigma.powi(2));
    DMatrix::from_diagonal(&nalgebra::DVector::from_iterator(rows.len(), variances))
}

/// Angles in radians under a name in degrees show by the planes that do not meet.
fn check_units(ground: &Ground<'_>, model: &Model, stations: &[Station], options: &StationOptions) -> Result<()> {
    let Some(turns) = &ground.mounts.if_radians else { return Ok(()) };
    let mut other = ground.mounts.clone();
    other.if_radians = None;
    for (head, turn) in other.heads.iter_mut().zip(turns) {
        head.body_from_scanner = *turn;
    }
    let patches = patches_of(stations, &other, options);
    let as_radians = Ground { mounts: &other, patches: &patches, ..*ground };
    let count = |ground: &Ground<'_>| find(ground, model, &prior(model)).0.len();
    let (degrees, radians) = (count(ground), count(&as_radians));
    if radians > 3 * degrees.max(3) {
        bail!(
            "extrinsics: roll_deg, pitch_deg, yaw_deg fit the points when taken for radians ({radians} common planes, \
             {degrees} in degrees); give degrees, or name the columns roll_rad, pitch_rad, yaw_rad"
        );
    }
    Ok(())
}

/// Pairs, measures and adjusts until nothing changes.
fn settle(ground: &Ground<'_>, model: &mut Model) -> Result<Round> {
    let mut covariance = prior(model);
    let mut floor_m = FIRST_FLOOR_M;
    let mut last: Option<Round> = None;
    let mut last_planes = Vec::new();
    for rounds in 1..=MOST_ROUNDS {
        let (planes, refused) = match last.take() {
            Some(last) if rounds > FREE_ROUNDS => (last.planes, last.refused),
            _ => find(ground, model, &covariance),
        };
        if rounds == 1 {
            check_connected(ground.mounts, &planes)?;
        }
        let lines = measured(ground, &planes, model, floor_m);
        let only: Vec<Line> = lines.iter().map(|l| l.0.clone()).collect();
        let adjustment = adjust(model, &only, &[], &AdjustOptions::default())?;
        covariance = Mounting::of(model, &adjustment.covariance).covariance;
        let new_floor_m = floor_of(ground, &planes, model, floor_m);
        let stands =
            adjustment.last_step < STANDS && (new_floor_m - floor_m).abs() <= 0.01 * floor_m && planes == last_planes;
        last_planes.clone_from(&planes);
        last = Some(Round { planes, lines, adjustment, refused, floor_m, rounds, stands });
        floor_m = new_floor_m;
        if stands {
            break;
        }
    }
    match last {
        Some(round) => Ok(round),
        None => bail!("no round of the adjustment was made"),
    }
}

/// The floor with which half of the planes in use lie within 0.6745 sigma: robust, without outliers.
fn floor_of(ground: &Ground<'_>, planes: &[CommonPlane], model: &Model, floor_m: f64) -> f64 {
    let lines = measured(ground, planes, model, floor_m);
    let in_use: Vec<(f64, f64)> = lines
        .iter()
        .filter(|(line, _)| !line.held_out)
        .filter_map(|(line, _)| {
            let own: f64 = line.ends.iter().map(|e| e.sigma_m.powi(2) - floor_m.powi(2)).sum();
            Some((after_m(line)?, own.max(0.0)))
        })
        .collect();
    if in_use.len() < FEW_PLANES {
        return floor_m;
    }
    #[allow(clippy::cast_precision_loss)]
    let freedom = (in_use.len().saturating_sub(model.count()).max(1) as f64 / in_use.len() as f64).sqrt();
    let scale = |floor_m: f64| {
        let mut t: Vec<f64> = in_use.iter().map(|(v, own)| v.abs() / (own + 2.0 * floor_m.powi(2)).sqrt()).collect();
        let middle = t.len() / 2;
        1.4826 * *t.select_nth_unstable_by(middle, f64::total_cmp).1 / freedom
    };
    let (mut low, mut high) = (LEAST_FLOOR_M, MOST_FLOOR_M);
    if scale(low) <= 1.0 {
        return low;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if scale(middle) > 1.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Every scanner must be tied to the reference, directly or through others.
fn check_connected(mounts: &Mounts, planes: &[CommonPlane]) -> Result<()> {
    let mut reached = vec![false; mounts.heads.len()];
    reached[mounts.reference] = true;
    for _ in 0..mounts.heads.len() {
        for plane in planes.iter().filter(|p| p.fate == Fate::Used) {
            let [a, b] = plane.heads;
            if reached[a] || reached[b] {
                (reached[a], reached[b]) = (true, true);
            }
        }
    }
    if let Some(head) = reached.iter().position(|r| !r) {
        let head = &mounts.heads[head];
        bail!(
            "scanner {} ({}) has no plane in common with scanner {}, also not through others: their fields of view do not \
             overlap, or the rough extrinsics are worse than extrinsics.boresight_sigma_deg = {} and lever_arm_sigma_m = {} say",
            head.scanner,
            head.name,
            mounts.heads[mounts.reference].scanner,
            mounts.boresight_sigma_rad.to_degrees(),
            mounts.lever_arm_sigma_m
        );
    }
    Ok(())
}

fn solved(round: &Round) -> Vec<SolvedPlane> {
    let results = round.planes.iter().zip(&round.lines).zip(&round.adjustment.ends);
    results
        .filter_map(|((plane, (line, point_m)), ends)| {
            let scale = round.adjustment.class_scale.get(line.class).copied().unwrap_or(1.0);
            let sigma = |k: usize| line.ends.get(k).map_or(f64::NAN, |e| e.sigma_m * scale);
            Some(SolvedPlane {
                plane: *plane,
                point_m: (*point_m)?,
                normal: line.normal,
                before_m: before_m(line)?,
                after_m: after_m(line)?,
                sigma_m: [sigma(0), sigma(1)],
                outlier: ends.iter().any(|e| e.outlier),
            })
        })
        .collect()
}

fn notes(solution: &StationsSolution, mounts: &Mounts, stands: bool) -> Vec<String> {
    let mut notes = Vec::new();
    if !stands {
        notes.push(format!("pairs and calibration had not settled after {MOST_ROUNDS} rounds"));
    }
    for (head, of) in mounts.heads.iter().enumerate().filter(|(h, _)| *h != mounts.reference) {
        let used = solution.planes.iter().filter(|p| p.plane.fate == Fate::Used && !p.outlier);
        let n = used.filter(|p| p.plane.heads.contains(&head)).count();
        if n < FEW_PLANES {
            notes.push(format!("warning: scanner {} ({}) hangs on {n} common planes only", of.scanner, of.name));
        }
    }
    for (value, p) in solution.values.iter().zip(&solution.parameters) {
        if value.abs() > 3.0 * p.prior_sigma {
            notes.push(format!(
                "warning: {} moved by {:.1} prior sigmas; check the rough extrinsics, or give a larger extrinsics.{}",
                p.name,
                value.abs() / p.prior_sigma,
                if p.is_angle { "boresight_sigma_deg" } else { "lever_arm_sigma_m" }
            ));
        }
    }
    match solution.motion_test {
        Some(test) if test > 1.0 => notes.push(format!(
            "points of a station do not fit one pose (test {test:.1} of its limit); as motion while the scanners turned: {}",
            solution
                .motions
                .iter()
                .map(|m| {
                    format!(
                        "station {} {:+.2} ± {:.2} m/s forward, {:+.1} ± {:.1} °/s to the right",
                        m.station + 1,
                        m.forward_mps.0,
                        m.forward_mps.1,
                        m.yaw_rate_radps.0.to_degrees(),
                        m.yaw_rate_radps.1.to_degrees()
                    )
                })
                .collect::<Vec<_>>()
                .join("; ")
        )),
        Some(test) => notes.push(format!("motion during the spins is estimated and is not more than chance (test {test:.2} of its limit)")),
        None => notes.push(String::from("motion during the spins was not looked for: the points of a station span no time, or more than one spin")),
    }
    if solution.station_factor > 1.0 {
        notes.push(format!(
            "stations differ by {:.1} times what their sigmas say; all sigmas are multiplied by that",
            solution.station_factor
        ));
    }
    notes
}

/// A patch by the calibrated mounting, body frame of the middle of its spin but for what the vehicle moved in it.
#[must_use]
pub fn calibrated_patch(patch: &Patch, head: usize, mounts: &Mounts, corrections: &[Calibration]) -> Patch {
    moved(patch, &map_of(&mounts.heads[head].lever_arm_m, &PoseCorrection::default(), &corrections[head]))
}
