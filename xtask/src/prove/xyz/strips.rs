//! Line 3: real strips tied by corners and submaps alone, beside the solution of surface lines, and by both together.

use anyhow::{Context, Result};
use nalgebra::{DVector, Vector3};
use serde_json::Value;
use tieline::job::{Clock, DEFAULT_MEMORY_BYTES, JobOptions, Matched, correct_strips, match_strips, solve_strips};
use tieline::progress::Progress;
use tieline::project::{Project, StripModelChoice, XyzChoice, XyzWord};
use tieline::stage::solve::Solution;
use tieline::summary::summarise;
use tieline_graph::{LineEnd, PointMap, TimeModel};

use crate::prove::Row;
use crate::prove::real::{judge, laz_in, number, root};

/// What counts as equal in the judge's figures \[mm\].
const DIGIT_MM: f64 = 0.1;

/// Which ties are taken.
#[derive(Clone, Copy)]
enum Take {
    Surfaces,
    Places,
    Both,
}

/// A solved survey and what the judge says.
struct Run {
    matched: Matched,
    solution: Solution,
    judged: Value,
}

fn run(name: &str, take: Take, by: &str, model: StripModelChoice) -> Result<Run> {
    let mut project = Project::load(&root().join(format!("samples/real/{name}.toml")))?;
    project.solve.strips = model;
    if !matches!(take, Take::Surfaces) {
        project.matching.xyz = XyzChoice::Kinds(vec![XyzWord::Corner, XyzWord::Submap]);
    }
    if matches!(take, Take::Places) {
        project.matching.surface_lines = Some(false);
    }
    let folder = tempfile::tempdir()?;
    let options = JobOptions {
        out: folder.path().to_path_buf(),
        memory_bytes: DEFAULT_MEMORY_BYTES,
        progress: Progress::silent(),
    };
    let mut clock = Clock::default();
    let matched = match_strips(&project, &options, &mut clock)?;
    let solution = solve_strips(&project, &matched, &mut clock)?;
    let state = (&solution.setup, &solution.model);
    let corrected = folder.path().join("corrected");
    correct_strips(&project, &matched, state, false, &corrected, Progress::silent(), &mut clock)?;
    let judged = judge(&laz_in(&corrected)?, by)?;
    let summary = summarise(&project, &matched, &solution).0;
    for (kind, p) in &summary.places {
        println!(
            "  {kind}: {} found, {} used ({} / {} / {} of rank 1 / 2 / 3), {} held out; rms along what is held {:.1} mm before, {:.1} after, {:.1} held out",
            p.counts.found,
            p.counts.used,
            p.rank[0],
            p.rank[1],
            p.rank[2],
            p.counts.held_out,
            p.before.rms_m * 1e3,
            p.after.rms_m * 1e3,
            p.held_out_after.rms_m * 1e3
        );
    }
    let held = &summary.discrepancy.held_out_after;
    println!(
        "  {}, common-mode factor {:.2}, factors {:?}; ties held out {} ({:.1} mm rms); xyz {:.1} CPU s of {:.1}",
        summary.calibration.strip_model,
        summary.calibration.common_mode_factor,
        summary.calibration.class_scale,
        held.n,
        held.rms_m * 1e3,
        clock.timing(matched.points).cpu.get("xyz").copied().unwrap_or(0.0),
        clock.timing(matched.points).cpu.values().sum::<f64>()
    );
    Ok(Run { matched, solution, judged })
}

/// A place of a strip: what it is called, strip, survey time \[s\], place in the map \[m\].
type Station = (String, usize, f64, Vector3<f64>);

/// The middles of the three thirds of what each strip sees, by the ends of its surface lines.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn stations(run: &Run) -> Vec<Station> {
    let mut found = Vec::new();
    for (i, strip) in run.matched.strips.strips().iter().enumerate() {
        let ends = run.solution.lines.iter().flat_map(|l| &l.ends).filter(|e| e.strip == Some(i));
        let mut ends: Vec<&LineEnd> = ends.collect();
        ends.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        for (third, part) in ends.chunks(ends.len().div_ceil(3).max(1)).enumerate() {
            let n = part.len() as f64;
            let time_s = part.iter().map(|e| e.time_s - part[0].time_s).sum::<f64>() / n + part[0].time_s;
            let point_m = part.iter().map(|e| e.point_m).sum::<Vector3<f64>>() / n;
            let name = ["first third", "middle", "last third"][third];
            found.push((format!("{} {name}", strip.name), i, time_s, point_m));
        }
    }
    found
}

/// Displacement \[m\] of such places along one axis by the corrections, less the mean over all of them, with its sigma \[m\]: what all strips
/// have in common no tie knows.
#[allow(clippy::cast_precision_loss)]
fn displacements(run: &Run, stations: &[Station], axis: usize) -> Result<Vec<(f64, f64)>> {
    let (solution, matched) = (&run.solution, &run.matched);
    let along = Vector3::ith(axis, 1.0);
    let mut rows: Vec<(f64, DVector<f64>)> = Vec::new();
    for (_, strip, time_s, point_m) in stations {
        let number = u32::try_from(*strip)?;
        let pose = matched.poses.at(number, *time_s).context("a strip without a pose")?;
        let block = solution.setup.block(number, matched.strips.strips()[*strip].scanners[0]);
        let end = LineEnd {
            strip: Some(*strip),
            calibration: block,
            time_s: *time_s,
            pose,
            lever_arm_m: solution.setup.lever_arms_m[block],
            point_m: *point_m,
            offset_m: 0.0,
            sigma_m: 1.0,
            parts: Vec::new(),
        };
        let (correction, calibration) =
            (solution.model.pose_correction(*strip, *time_s), solution.model.calibration(block));
        let map = PointMap::new(&pose, &end.lever_arm_m, &correction, &calibration);
        let mut row = DVector::zeros(solution.model.count());
        solution.model.row(&end, &along).into_iter().for_each(|(c, v)| row[c] += v);
        rows.push((along.dot(&map.delta_m(point_m)), row));
    }
    let count = rows.len() as f64;
    let mean_m = rows.iter().map(|r| r.0).sum::<f64>() / count;
    let mean: DVector<f64> = rows.iter().map(|r| &r.1).sum::<DVector<f64>>() / count;
    let of = |(value_m, row): (f64, DVector<f64>)| {
        let g = row - &mean;
        (value_m - mean_m, g.dot(&(&solution.adjustment.covariance * &g)).max(0.0).sqrt())
    };
    Ok(rows.into_iter().map(of).collect())
}

/// The largest difference of two solutions over their joint sigma in any strip, with where; shown strip by strip.
fn agreement(a: &Run, b: &Run) -> Result<f64> {
    let (axes, stations) = (["east", "north", "up"], stations(a));
    let mut worst = 0.0_f64;
    let mut lines: std::collections::BTreeMap<String, String> = std::collections::BTreeMap::new();
    for (axis, name) in axes.iter().enumerate() {
        let both = displacements(a, &stations, axis)?.into_iter().zip(displacements(b, &stations, axis)?);
        for ((place, ..), ((x, s), (y, t))) in stations.iter().zip(both) {
            let ratio = (y - x).abs() / s.hypot(t);
            worst = worst.max(ratio);
            let text = format!("{name} {:+.1} ± {:.1} mm ({ratio:.1})  ", (y - x) * 1e3, s.hypot(t) * 1e3);
            lines.entry(place.clone()).or_default().push_str(&text);
        }
    }
    for (place, line) in lines {
        println!("    {place:<17} {line}");
    }
    Ok(worst)
}

fn of_set(name: &str, by: &str) -> Result<Vec<Row>> {
    println!("{name}, surface lines:");
    let surfaces = run(name, Take::Surfaces, by, StripModelChoice::Auto)?;
    // the sigmas of a stiffer model do not know of what it leaves out: both in the model that the surface lines ask for
    let has_drift = surfaces.solution.time_models.contains(&Some(TimeModel::Linear));
    let model = if has_drift { StripModelChoice::Linear } else { StripModelChoice::Constant };
    println!("{name}, corners and submaps, model by themselves:");
    let places = run(name, Take::Places, by, StripModelChoice::Auto)?;
    println!("  places of the strips, less the mean of all, against surface lines:");
    let chosen = agreement(&surfaces, &places)?;
    println!("{name}, corners and submaps, {model:?}:");
    let alike = run(name, Take::Places, by, model)?;
    println!("  places of the strips, less the mean of all, against surface lines:");
    let worst = agreement(&surfaces, &alike)?;
    println!("{name}, all:");
    let both = run(name, Take::Both, by, StripModelChoice::Auto)?;
    let mm = |run: &Run, key: &str| number(&run.judged["total"][key]) * 1e3;
    let mut rows = vec![
        Row::at_most(format!("{name}: places against surface lines, worst strip"), worst, 3.0, "sigma"),
        Row::at_most(format!("{name}: the same, model by themselves"), chosen, 3.0, "sigma"),
    ];
    for (key, words) in
        [("rms_of_medians_m", "rms of pair medians"), ("cell_rms_m", "cell rms"), ("rms_shift_xy_m", "shift rms")]
    {
        println!(
            "  {words}: surface lines {:.2}, places {:.2}, both {:.2} mm",
            mm(&surfaces, key),
            mm(&places, key),
            mm(&both, key)
        );
        let bound = mm(&surfaces, key) + DIGIT_MM;
        rows.push(Row::at_most(format!("{name}: {words} with both"), mm(&both, key), bound, "mm"));
    }
    Ok(rows)
}

/// CPU seconds of `match` with a choice of kinds: the least of three.
fn match_cpu_s(name: &str, xyz: &XyzChoice) -> Result<f64> {
    let mut project = Project::load(&root().join(format!("samples/real/{name}.toml")))?;
    project.matching.xyz = xyz.clone();
    let mut least_s = f64::INFINITY;
    for _ in 0..3 {
        let folder = tempfile::tempdir()?;
        let out = folder.path().to_path_buf();
        let options = JobOptions { out, memory_bytes: DEFAULT_MEMORY_BYTES, progress: Progress::silent() };
        let mut clock = Clock::default();
        let matched = match_strips(&project, &options, &mut clock)?;
        least_s = least_s.min(clock.timing(matched.points).cpu.values().sum());
    }
    Ok(least_s)
}

/// Both sets, and what `auto` costs.
pub(crate) fn strips() -> Result<Vec<Row>> {
    let mut rows = of_set("als-zurich-8strips", "psid")?;
    rows.extend(of_set("als-ign-dual-scanner", "psid+user")?);
    for name in ["als-zurich-8strips", "als-ign-dual-scanner"] {
        let ratio = match_cpu_s(name, &XyzChoice::Auto)? / match_cpu_s(name, &XyzChoice::Off)?;
        rows.push(Row::at_most(format!("{name}: CPU of match, auto over off"), ratio, 2.0, ""));
    }
    Ok(rows)
}
