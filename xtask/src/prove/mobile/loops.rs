//! Loops through an outage: trajectory, calibration and false ties, from the same runs.

use std::sync::OnceLock;

use anyhow::{Result, anyhow};

use super::super::Row;
use super::calibration::{Judged, inside_95, judge, middle_and_worst};
use super::falsify::solved_with_false_ties;
use super::{Errors, errors, errors_within, median, moved_over_sigma, seeds, simulate, solved, text, tieline, windows};

/// Seeds of the scenario without a range bias.
const UNBIASED_SEEDS: u64 = 3;

/// One seed.
struct Loop {
    handed_out: Errors,
    first_pass: Errors,
    now: Errors,
    /// With a twentieth of the ties false.
    falsified: Errors,
    /// Movement where it was well known before, over its sigma: root mean square, and 95 %.
    moved: (f64, f64),
    calibration: Judged,
}

fn one(seed: u64) -> Result<Loop> {
    let folder = tempfile::tempdir()?;
    let project = simulate("loop113", seed, folder.path(), |t| t)?;
    let (data, out) = (folder.path().join("data"), folder.path().join("out"));
    tieline(&["run", "--quiet", "--out", text(&out)?, text(&project)?])?;
    let passes = windows(&data.join("truth/passes.csv"), 1)?;
    let first = passes.first().copied().ok_or_else(|| anyhow!("no passes"))?;
    Ok(Loop {
        handed_out: errors(&data, &data)?,
        first_pass: errors_within(&data, &solved(&out)?, &[first])?,
        now: errors(&data, &out)?,
        falsified: solved_with_false_ties(&project, seed)?,
        moved: moved_over_sigma(&data, &out, first)?,
        calibration: judge(&data, &out)?,
    })
}

/// All seeds, run once for all lines.
fn runs() -> Result<&'static [Loop]> {
    static RUNS: OnceLock<Result<Vec<Loop>, String>> = OnceLock::new();
    let all = RUNS.get_or_init(|| {
        (1..=seeds())
            .map(|seed| {
                let run = one(seed).map_err(|error| format!("seed {seed}: {error:#}"))?;
                show(seed, &run);
                Ok(run)
            })
            .collect()
    });
    all.as_deref().map_err(|error| anyhow!("{error}"))
}

fn show(seed: u64, run: &Loop) {
    let ned = |e: &Errors| e.largest_ned_m.map(|v| format!("{v:.3}")).join(" ");
    let c = &run.calibration;
    println!(
        "seed {seed}, largest N E D [m]: handed out {}, now {} ({:.0} % inside 2 sigma), first pass {}, with 5 % false ties {}",
        ned(&run.handed_out),
        ned(&run.now),
        run.now.inside,
        ned(&run.first_pass),
        ned(&run.falsified)
    );
    println!(
        "        curves {:.2} mm (every range alike {:.2} mm) to {:.1} m, {:.1} % of the points; boresight between scanners off by {:+.4} {:+.4} {:+.4}°",
        1e3 * c.curve_rms_m[0],
        1e3 * c.curve_rms_m[1],
        c.reach_m,
        100.0 * c.covered,
        c.relative_deg[0],
        c.relative_deg[1],
        c.relative_deg[2]
    );
}

fn medians(runs: &[Loop], of: impl Fn(&Loop) -> f64) -> f64 {
    median(&mut runs.iter().map(of).collect::<Vec<_>>())
}

const AXES: [&str; 3] = ["north", "east", "down"];

/// Line 2: a loop through an outage.
#[allow(clippy::cast_precision_loss)]
pub(crate) fn loop_closure() -> Result<Vec<Row>> {
    let runs = runs()?;
    let mut rows = vec![Row::between(
        "loop113: handed out, largest plan error, median",
        medians(runs, |r| r.handed_out.largest_plan_m),
        0.10,
        f64::INFINITY,
        "m",
    )];
    for (k, (middle, worst)) in [(0.02, 0.03), (0.02, 0.03), (0.015, 0.025)].into_iter().enumerate() {
        let of = |r: &Loop| r.now.largest_ned_m[k];
        let axis = AXES[k];
        rows.push(Row::at_most(
            format!("loop113: largest error {axis}, median of seeds"),
            medians(runs, of),
            middle,
            "m",
        ));
        let most = runs.iter().map(of).fold(0.0, f64::max);
        rows.push(Row::at_most(format!("loop113: largest error {axis}, worst seed"), most, worst, "m"));
    }
    let mean = runs.iter().map(|r| r.now.inside).sum::<f64>() / runs.len() as f64;
    rows.push(Row::between("loop113: errors inside 2 sigma", mean, 90.0, 99.0, "%"));
    println!("first pass moved, over its sigma, 95 % of epochs: median of seeds {:.2}", medians(runs, |r| r.moved.1));
    let moved = medians(runs, |r| r.moved.0);
    rows.push(Row::at_most("loop113: first pass moved, root mean square over its sigma", moved, 1.0, ""));
    Ok(rows)
}

/// Line 4: calibration of the same drives, and of drives without a range bias.
pub(crate) fn calibration() -> Result<Vec<Row>> {
    let runs = runs()?;
    let (middle, worst) = middle_and_worst(runs.iter().map(|r| 1e3 * r.calibration.curve_rms_m[0]));
    println!("range bias, rms of the curves' errors: median {middle:.2} mm, worst {worst:.2} mm");
    let mut rows = vec![Row::at_most("loop113: range bias, rms of the curves' errors, worst seed", worst, 1.0, "mm")];
    for (k, axis) in ["x", "y", "z"].iter().enumerate() {
        let (middle, worst) = middle_and_worst(runs.iter().map(|r| r.calibration.relative_deg[k]));
        println!("boresight between the scanners, {axis}: median {middle:.4}°, worst {worst:.4}°");
        rows.push(Row::at_most(
            format!("loop113: boresight between scanners, {axis}, median of seeds"),
            middle,
            0.003,
            "deg",
        ));
    }
    let ratios: Vec<f64> = runs.iter().flat_map(|r| r.calibration.ratios.iter().copied()).collect();
    let name = format!("loop113: inside the 95 % interval, {} values", ratios.len());
    rows.push(Row::between(name, inside_95(&ratios), 90.0, 99.0, "%"));
    let mut invented = Vec::new();
    for seed in 1..=seeds().min(UNBIASED_SEEDS) {
        let folder = tempfile::tempdir()?;
        let unbiased =
            |t: String| -> String { t.lines().filter(|l| !l.starts_with("bias_")).map(|l| format!("{l}\n")).collect() };
        let project = simulate("loop113", seed, folder.path(), unbiased)?;
        let out = folder.path().join("out");
        tieline(&["run", "--quiet", "--out", text(&out)?, text(&project)?])?;
        let judged = judge(&folder.path().join("data"), &out)?;
        println!("seed {seed} without a range bias: {:.2} mm invented", 1e3 * judged.curve_rms_m[0]);
        invented.push(1e3 * judged.curve_rms_m[0]);
    }
    let (_, worst) = middle_and_worst(invented.into_iter());
    rows.push(Row::at_most("loop113 without a range bias: invented, worst seed", worst, 0.3, "mm"));
    Ok(rows)
}

/// Line 6: false ties. Cars that stand there in one pass only are in the scene of every seed.
pub(crate) fn false_ties() -> Result<Vec<Row>> {
    let runs = runs()?;
    let mut rows = Vec::new();
    for (k, axis) in AXES.iter().enumerate() {
        let (with, without) =
            (medians(runs, |r| r.falsified.largest_ned_m[k]), medians(runs, |r| r.now.largest_ned_m[k]));
        println!("largest error {axis}, median of seeds: {with:.4} m with false ties, {without:.4} m without");
        rows.push(Row::at_most(format!("loop113: 5 % false ties: the error {axis} grows by"), with / without, 1.2, ""));
    }
    Ok(rows)
}
