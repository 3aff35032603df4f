//! The summary of a job: what was found, how good it is, what cannot be known.

pub(crate) mod places;

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use tieline_graph::{ParameterBlock, model::Parameter};
use tieline_matching::Sighting;

use crate::job::Matched;
use crate::project::Project;
use crate::report::data::{
    AdjustmentSummary, Discrepancies, Discrepancy, PairSummary, ParameterSummary, PlaceSummary, StripSummary, Summary,
    TieCounts, TiePoint, TrialSummary,
};
use crate::stage::places::PlaceKind;
use crate::stage::solve::{CLASSES, Solution, model_name};
use crate::stage::ties::CONTROL_STRIP;

/// A correction beyond this many prior sigmas is implausible.
const IMPLAUSIBLE: f64 = 3.0;

/// Name of who saw a patch: strip, and scanner where there are several.
#[must_use]
pub fn sighting_name(matched: &Matched, sighting: Sighting) -> String {
    if sighting.strip == CONTROL_STRIP {
        return String::from("control points");
    }
    let Some(strip) = matched.strips.strips().get(sighting.strip as usize) else { return String::from("?") };
    if strip.scanners.len() > 1 { format!("{}/{}", strip.name, sighting.scanner) } else { strip.name.clone() }
}

/// Summary and differences of a solved survey; files, timing and memory are filled in later.
#[must_use]
pub fn summarise(project: &Project, matched: &Matched, solution: &Solution) -> (Summary, Vec<TiePoint>) {
    let (pairs, points) = differences(matched, solution);
    let ties = &matched.ties;
    let held = ties.held_out.iter().filter(|h| **h).count() as u64;
    let lines = solution.lines.iter().zip(&solution.adjustment.ends).take(solution.rows.len());
    let used = lines.filter(|(l, e)| !l.held_out && e.iter().filter(|e| !e.outlier).count() >= 2).count() as u64;
    let counts = TieCounts { found: ties.found, used, held_out: held };
    let places = places::places(matched, solution);
    let mut notes = matched.survey.notes.clone();
    notes.extend(matched.poses.notes.iter().cloned());
    notes.extend(solution.setup.notes.iter().cloned());
    let summary = Summary {
        version: env!("CARGO_PKG_VERSION").to_string(),
        name: project.name().to_string(),
        inputs: matched
            .survey
            .files
            .iter()
            .map(|f| {
                (
                    f.las.path().file_name().unwrap_or_default().to_string_lossy().into_owned(),
                    f.las.header().point_count,
                )
            })
            .collect(),
        crs: matched.survey.crs.as_ref().map_or_else(|| String::from("local metres"), |c| c.name().to_string()),
        settings: matched.settings.clone(),
        notes,
        strips: strips(matched, solution),
        pairs,
        ties: kinds(counts, &places),
        places,
        rejected: rejected(matched, solution),
        discrepancy: discrepancies(&points),
        calibration: adjustment(matched, solution),
        ..Summary::default()
    };
    (summary, points)
}

fn kinds(surface_line: TieCounts, places: &BTreeMap<String, PlaceSummary>) -> BTreeMap<String, TieCounts> {
    let mut kinds: BTreeMap<String, TieCounts> = ["line", "xyz_point", "increment", "submap", "control"]
        .into_iter()
        .map(|kind| (kind.to_string(), TieCounts::default()))
        .collect();
    kinds.insert(String::from("surface_line"), surface_line);
    for kind in PlaceKind::ALL {
        if let Some(of_kind) = places.get(kind.as_str()) {
            kinds.insert(places::key(kind).to_string(), of_kind.counts);
        }
    }
    kinds
}

fn rejected(matched: &Matched, solution: &Solution) -> BTreeMap<String, u64> {
    let mut rejected = matched.ties.rejected.clone();
    rejected.extend(matched.ties.places.rejected.clone());
    let outliers = solution.adjustment.ends.iter().flatten().filter(|e| e.outlier).count() as u64;
    if outliers > 0 {
        rejected.insert(String::from("outlier"), outliers);
    }
    rejected
}

fn discrepancies(points: &[TiePoint]) -> Discrepancies {
    let of = |held_out: bool, value: fn(&TiePoint) -> f64| {
        let rows: Vec<f64> = points.iter().filter(|p| p.held_out == held_out && !p.outlier).map(value).collect();
        Discrepancy::of(&rows)
    };
    Discrepancies {
        before: of(false, |p| p.before_m),
        after: of(false, |p| p.after_m),
        held_out_before: of(true, |p| p.before_m),
        held_out_after: of(true, |p| p.after_m),
    }
}

/// Differences of every pair of sightings, and their statistics by pair.
fn differences(matched: &Matched, solution: &Solution) -> (Vec<PairSummary>, Vec<TiePoint>) {
    let mut rows: Vec<(Sighting, Sighting, TiePoint, Vector3<f64>)> = Vec::new();
    for (k, (row, ends)) in solution.rows.iter().enumerate() {
        let (before, after) = (&solution.lines_before[k], &solution.lines[k]);
        let results = &solution.adjustment.ends[k];
        if before.ends.len() != ends.len() || after.ends.len() != ends.len() || results.len() != ends.len() {
            continue; // footprints did not meet before or after
        }
        for a in 0..ends.len() {
            for b in a + 1..ends.len() {
                let of = |i: usize| Sighting { pass: 0, ..matched.ties.lines[*row].ends[ends[i]].patch.sighting };
                let (a, b) = if of(a) <= of(b) { (a, b) } else { (b, a) };
                let point = TiePoint {
                    map_m: before.ends[a].point_m.into(),
                    pair: 0,
                    normal_up: after.normal.z,
                    before_m: before.ends[b].offset_m - before.ends[a].offset_m,
                    after_m: after.ends[b].offset_m - after.ends[a].offset_m,
                    held_out: after.held_out,
                    outlier: results[a].outlier || results[b].outlier,
                };
                rows.push((of(a), of(b), point, after.normal));
            }
        }
    }
    rows.extend(places::points(matched, solution));
    type Rows = Vec<(TiePoint, Vector3<f64>)>;
    let mut by_pair: BTreeMap<(Sighting, Sighting), Rows> = BTreeMap::new();
    for (a, b, point, normal) in rows {
        by_pair.entry((a, b)).or_default().push((point, normal));
    }
    let (mut pairs, mut points) = (Vec::new(), Vec::new());
    for (number, ((a, b), rows)) in (0_u32..).zip(by_pair) {
        let kept: Vec<&(TiePoint, Vector3<f64>)> = rows.iter().filter(|(p, _)| !p.outlier).collect();
        let values = |f: fn(&TiePoint) -> f64| kept.iter().map(|(p, _)| f(p)).collect::<Vec<f64>>();
        let shift = |f: fn(&TiePoint) -> f64| robust_shift(&kept.iter().map(|(p, n)| (f(p), *n)).collect::<Vec<_>>());
        pairs.push(PairSummary {
            a: sighting_name(matched, a),
            b: sighting_name(matched, b),
            before: Discrepancy::of(&values(|p| p.before_m)),
            after: Discrepancy::of(&values(|p| p.after_m)),
            shift_before_m: shift(|p| p.before_m),
            shift_after_m: shift(|p| p.after_m),
        });
        points.extend(rows.into_iter().map(|(p, _)| TiePoint { pair: number, ..p }));
    }
    (pairs, points)
}

/// Shift of the second sighting against the first that explains differences along normals, by Huber's estimate;
/// NaN where the normals do not determine it.
fn robust_shift(rows: &[(f64, Vector3<f64>)]) -> [f64; 3] {
    if rows.len() < 10 {
        return [f64::NAN; 3];
    }
    let mut shift = Vector3::zeros();
    for _ in 0..8 {
        let mut sizes: Vec<f64> = rows.iter().map(|(d, n)| (d - n.dot(&shift)).abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let scale = (1.4826 * sizes[sizes.len() / 2]).max(1e-5);
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (d, n) in rows {
            let weight = (2.0 * scale / (d - n.dot(&shift)).abs().max(1e-12)).min(1.0);
            normal += n * n.transpose() * weight;
            right += n * (d * weight);
        }
        // tilted surfaces must make up a percent or so of the ties
        #[allow(clippy::cast_precision_loss)]
        let least = 2e-3 * rows.len() as f64;
        if normal.symmetric_eigenvalues().min() < least {
            return [f64::NAN; 3];
        }
        match normal.cholesky() {
            Some(factor) => shift = factor.solve(&right),
            None => return [f64::NAN; 3],
        }
    }
    shift.into()
}

fn strips(matched: &Matched, solution: &Solution) -> Vec<StripSummary> {
    matched
        .strips
        .strips()
        .iter()
        .enumerate()
        .map(|(i, strip)| {
            let middle_s = 0.5 * (strip.start_s + strip.end_s);
            let correction = solution.model.pose_correction(i, middle_s);
            let path = matched.poses.reports.iter().find(|r| r.strip == strip.name);
            let (p, r) = (correction.position_ned_m, correction.rotation_ned_rad.map(f64::to_degrees));
            let spec = &solution.setup.strips[i];
            let over = |v: &Vector3<f64>, s: &Vector3<f64>| v.component_div(s).amax();
            let largest =
                over(&p, &spec.position_sigma_m).max(over(&correction.rotation_ned_rad, &spec.rotation_sigma_rad));
            StripSummary {
                name: strip.name.clone(),
                points: strip.points,
                start_s: strip.start_s,
                end_s: strip.end_s,
                start_utc: matched.survey.clock.gps_time(strip.start_s).map(|t| t.utc_text()),
                mission: strip.mission,
                scanners: strip.scanners.clone(),
                fixed: spec.fixed,
                trajectory: path.map(|r| r.source.clone()).unwrap_or_default(),
                course_deg: path.map_or(0.0, |r| r.course_deg),
                speed_mps: path.map_or(0.0, |r| r.speed_mps),
                height_m: path.map_or(0.0, |r| r.height_m),
                correction_enu_m: [p.y, p.x, -p.z],
                rotation_enu_deg: [r.y, r.x, -r.z],
                largest_over_prior: largest,
                implausible: largest > IMPLAUSIBLE,
            }
        })
        .collect()
}

fn block_name(matched: &Matched, solution: &Solution, block: ParameterBlock) -> String {
    match block {
        ParameterBlock::Strip(i) => format!("strip {}", matched.strips.strips()[i].name),
        ParameterBlock::Calibration(i) => {
            let b = solution.setup.blocks[i];
            let several = solution.setup.blocks.iter().any(|o| o.mission != b.mission);
            if several {
                format!("scanner {}, mission {}", b.scanner, b.mission)
            } else {
                format!("scanner {}", b.scanner)
            }
        }
    }
}

/// Unit of a parameter and the factor from the adjustment's unit to it.
#[must_use]
pub fn unit_of(parameter: &Parameter) -> (&'static str, f64) {
    if parameter.is_angle {
        ("deg", 180.0 / std::f64::consts::PI)
    } else if parameter.name == "range scale" {
        ("ppm", 1e6)
    } else {
        ("m", 1.0)
    }
}

fn adjustment(matched: &Matched, solution: &Solution) -> AdjustmentSummary {
    let result = &solution.adjustment;
    let parameters = solution.parameters();
    let table = parameters
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let (unit, factor) = unit_of(p);
            ParameterSummary {
                block: block_name(matched, solution, p.block),
                name: p.name.clone(),
                unit: unit.to_string(),
                value: solution.model.state()[i] * factor,
                sigma: result.covariance[(i, i)].max(0.0).sqrt() * factor,
                prior_sigma: p.prior_sigma * factor,
                observed: result.observability.share[i],
            }
        })
        .chain(relative_calibration(matched, solution))
        .collect();
    let unobservable = result
        .observability
        .unobservable
        .iter()
        .map(|u| {
            let words: Vec<String> = u
                .members
                .iter()
                .map(|(i, share)| {
                    let sign = if *share < 0.0 { "−" } else { "+" };
                    format!("{sign} {} of {}", parameters[*i].name, block_name(matched, solution, parameters[*i].block))
                })
                .collect();
            words.join(" ").trim_start_matches("+ ").to_string()
        })
        .collect();
    let class_scale = result
        .class_scale
        .iter()
        .enumerate()
        .filter(|(class, _)| solution.lines.iter().any(|l| l.class == *class))
        .map(|(class, scale)| (CLASSES.get(class).copied().unwrap_or("other").to_string(), *scale))
        .collect();
    AdjustmentSummary {
        strip_model: strip_model(solution),
        trials: solution
            .trials
            .iter()
            .map(|t| TrialSummary {
                model: model_name(t.model),
                unknowns: t.unknowns,
                used_rms_m: t.used.rms_m,
                held_out_rms_m: t.held_out.rms_m,
                gain_t: t.gain_t,
                taken: t.taken,
                reason: t.reason.clone(),
            })
            .collect(),
        parameters: table,
        unobservable,
        condition: result.observability.condition,
        sigma0: result.sigma0,
        common_mode_factor: result.common_mode_factor,
        class_scale,
        iterations: solution.iterations,
        outliers: result.ends.iter().flatten().filter(|e| e.outlier).count(),
        warnings: warnings(matched, solution),
    }
}

/// Calibration of the scanners of one mission against the first of them: what ties between scanners determine, however
/// little is known of what they have in common.
fn relative_calibration(matched: &Matched, solution: &Solution) -> Vec<ParameterSummary> {
    let parameters = solution.parameters();
    let covariance = &solution.adjustment.covariance;
    let mut rows = Vec::new();
    for (i, p) in parameters.iter().enumerate() {
        let ParameterBlock::Calibration(block) = p.block else { continue };
        let b = solution.setup.blocks[block];
        let first = solution.setup.blocks.iter().position(|o| o.mission == b.mission);
        let Some(first) = first.filter(|f| *f != block) else { continue };
        let same = |q: &Parameter| q.block == ParameterBlock::Calibration(first) && q.name == p.name;
        let Some(j) = parameters.iter().position(same) else { continue };
        let variance = (covariance[(i, i)] + covariance[(j, j)] - 2.0 * covariance[(i, j)]).max(0.0);
        let prior_variance = 2.0 * p.prior_sigma * p.prior_sigma;
        let (unit, factor) = unit_of(p);
        rows.push(ParameterSummary {
            block: format!(
                "{} less {}",
                block_name(matched, solution, p.block),
                block_name(matched, solution, ParameterBlock::Calibration(first))
            ),
            name: p.name.clone(),
            unit: unit.to_string(),
            value: (solution.model.state()[i] - solution.model.state()[j]) * factor,
            sigma: variance.sqrt() * factor,
            prior_sigma: prior_variance.sqrt() * factor,
            observed: (1.0 - variance / prior_variance).clamp(0.0, 1.0),
        });
    }
    rows
}

fn strip_model(solution: &Solution) -> String {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for (model, spec) in solution.time_models.iter().zip(&solution.setup.strips) {
        *counts.entry(if spec.fixed { String::from("fixed") } else { model_name(*model) }).or_default() += 1;
    }
    if let (1, Some((name, _))) = (counts.len(), counts.iter().next()) {
        return name.clone();
    }
    counts.iter().map(|(name, n)| format!("{name} for {n}")).collect::<Vec<_>>().join(", ")
}

/// What an engineer must look at before trusting the result.
fn warnings(matched: &Matched, solution: &Solution) -> Vec<String> {
    let mut warnings = Vec::new();
    for (i, parameter) in solution.parameters().iter().enumerate() {
        let over = solution.model.state()[i].abs() / parameter.prior_sigma;
        if over > IMPLAUSIBLE {
            let (unit, factor) = unit_of(parameter);
            warnings.push(format!(
                "{} of {} is {:.4} {unit}, {over:.1} times its prior sigma: more than the {} makes plausible",
                parameter.name,
                block_name(matched, solution, parameter.block),
                solution.model.state()[i] * factor,
                if solution.setup.prior_is_given { "stated accuracy" } else { "assumed accuracy" },
            ));
        }
    }
    let seen: Vec<usize> = solution.lines.iter().flat_map(|l| l.ends.iter().filter_map(|e| e.strip)).collect();
    for (i, strip) in matched.strips.strips().iter().enumerate() {
        let count = seen.iter().filter(|s| **s == i).count();
        if count < 20 && !solution.setup.strips[i].fixed {
            warnings.push(format!("strip {} has {count} ties only: it is held mostly by its prior", strip.name));
        }
    }
    let f = solution.adjustment.common_mode_factor;
    if f > 2.0 {
        warnings.push(format!(
            "ties within a second share errors that the model does not hold: all sigmas are {f:.1} times larger than by \
             independent ties"
        ));
    }
    warnings
}
