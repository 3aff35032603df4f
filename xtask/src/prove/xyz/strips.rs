//! Line 3: real strips tied by corners and submaps alone, beside the solution of surface lines, and by both together.

use anyhow::{Context, Result};
use nalgebra::{DVector, Vector3};
use serde_json::Value;
use tieline::job::{Clock, DEFAULT_MEMORY_BYTES, JobOptions, Matched, correct_strips, match_strips, solve_strips};
use tieline::progress::Progress;
use tieline::project::{Project, XyzChoice, XyzKind};
use tieline::stage::solve::Solution;
use tieline::summary::summarise;
use tieline_graph::LineEnd;

use crate::prove::Row;
use crate::prove::real::{judge, laz_in, number, root};

/// The last digit of the judge's figures \[mm\].
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

fn run(name: &str, take: Take, by: &str) -> Result<Run> {
    let mut project = Project::load(&root().join(format!("samples/real/{name}.toml")))?;
    if !matches!(take, Take::Surfaces) {
        project.matching.xyz = XyzChoice::Kinds(vec![XyzKind::Corner, XyzKind::Submap]);
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

/// Displacement \[m\] of the ground below each strip at its start, middle and end along one axis, less the mean over all strips, with its sigma
/// \[m\]: what all strips have in common no tie knows.
fn displacements(run: &Run, axis: usize) -> Result<Vec<(String, f64, f64)>> {
    let (solution, matched) = (&run.solution, &run.matched);
    let n = solution.model.count();
    let along = Vector3::ith(axis, 1.0);
    let mut rows: Vec<(String, f64, DVector<f64>)> = Vec::new();
    for (i, strip) in matched.strips.strips().iter().enumerate() {
        let number = u32::try_from(i)?;
        let report = matched.poses.reports.iter().find(|r| r.strip == strip.name).context("a strip without a path")?;
        for share in [0.02, 0.5, 0.98] {
            let time_s = strip.start_s + share * (strip.end_s - strip.start_s);
            let pose = matched.poses.at(number, time_s).context("a strip without a pose")?;
            let block = solution.setup.block(number, strip.scanners[0]);
            let end = LineEnd {
                strip: Some(i),
                calibration: block,
                time_s,
                pose,
                lever_arm_m: solution.setup.lever_arms_m[block],
                point_m: pose.position - Vector3::z() * report.height_m,
                offset_m: 0.0,
                sigma_m: 1.0,
                parts: Vec::new(),
            };
            let correction = solution.model.pose_correction(i, time_s);
            let map =
                tieline_graph::PointMap::new(&pose, &end.lever_arm_m, &correction, &solution.model.calibration(block));
            let mut row = DVector::zeros(n);
            solution.model.row(&end, &along).into_iter().for_each(|(c, v)| row[c] += v);
            let at = ["start", "middle", "end"][usize::from(share > 0.1) + usize::from(share > 0.9)];
            rows.push((format!("{} {at}", strip.name), along.dot(&map.delta_m(&end.point_m)), row));
        }
    }
    #[allow(clippy::cast_precision_loss)]
    let count = rows.len() as f64;
    let mean_m = rows.iter().map(|r| r.1).sum::<f64>() / count;
    let mean: DVector<f64> = rows.iter().map(|r| &r.2).sum::<DVector<f64>>() / count;
    let of = |(name, value_m, row): (String, f64, DVector<f64>)| {
        let g = row - &mean;
        (name, value_m - mean_m, g.dot(&(&solution.adjustment.covariance * &g)).max(0.0).sqrt())
    };
    Ok(rows.into_iter().map(of).collect())
}

/// The largest difference of two solutions over their joint sigma in any strip, with where; shown strip by strip.
fn agreement(a: &Run, b: &Run) -> Result<f64> {
    let axes = ["east", "north", "up"];
    let mut worst = 0.0_f64;
    let mut lines: std::collections::BTreeMap<String, String> = std::collections::BTreeMap::new();
    for (axis, name) in axes.iter().enumerate() {
        for ((place, x, s), (_, y, t)) in displacements(a, axis)?.into_iter().zip(displacements(b, axis)?) {
            let ratio = (y - x).abs() / s.hypot(t);
            worst = worst.max(ratio);
            let text = format!("{name} {:+.1} ± {:.1} mm ({ratio:.1})  ", (y - x) * 1e3, s.hypot(t) * 1e3);
            lines.entry(place).or_default().push_str(&text);
        }
    }
    for (place, line) in lines {
        println!("    {place:<14} {line}");
    }
    Ok(worst)
}

fn of_set(name: &str, by: &str) -> Result<Vec<Row>> {
    println!("{name}, surface lines:");
    let surfaces = run(name, Take::Surfaces, by)?;
    println!("{name}, corners and submaps:");
    let places = run(name, Take::Places, by)?;
    println!("  ground below the strips, less the mean of all, against surface lines:");
    let worst = agreement(&surfaces, &places)?;
    println!("{name}, all:");
    let both = run(name, Take::Both, by)?;
    let mm = |run: &Run, key: &str| number(&run.judged["total"][key]) * 1e3;
    let mut rows =
        vec![Row::at_most(format!("{name}: places against surface lines, worst strip"), worst, 3.0, "sigma")];
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

/// Both sets.
pub(crate) fn strips() -> Result<Vec<Row>> {
    let mut rows = of_set("als-zurich-8strips", "psid")?;
    rows.extend(of_set("als-ign-dual-scanner", "psid+user")?);
    Ok(rows)
}
