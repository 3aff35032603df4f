//! `simulate SCENARIO.toml --out DIR`: a survey with known errors.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use tieline_simulate::output::StripReport;
use tieline_simulate::{AnyScenario, simulate, simulate_drive};

use crate::cli::Common;
use crate::progress::Progress;

/// What was simulated.
struct Done {
    project: PathBuf,
    strips: Vec<StripReport>,
    /// Duration \[s\] and length of the way \[m\] of a drive.
    drive: Option<(f64, f64)>,
}

/// Simulates a scenario into a folder that is empty or not there yet, or whose files may be overwritten.
///
/// # Errors
/// When the scenario makes no sense, the folder is in use, or the disk refuses.
pub fn run(scenario: &Path, folder: &Path, overwrite: bool, common: &Common, out: &mut impl Write) -> Result<()> {
    let scenario = AnyScenario::read(scenario)?;
    let is_used = std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some());
    if is_used && !overwrite {
        bail!("the output folder {} is not empty: name another with --out, or give --overwrite", folder.display());
    }
    let done = record(&scenario, folder, common).with_context(|| format!("simulating into {}", folder.display()))?;
    let points: u64 = done.strips.iter().map(|s| s.points).sum();
    if common.json {
        let strips: Vec<_> = done
            .strips
            .iter()
            .map(|s| serde_json::json!({ "path": s.path, "points": s.points, "span_s": [s.span_s.0, s.span_s.1] }))
            .collect();
        let mut value = serde_json::json!({ "project": done.project, "points": points, "strips": strips });
        if let Some((duration_s, length_m)) = done.drive {
            value["duration_s"] = duration_s.into();
            value["length_m"] = length_m.into();
        }
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        for strip in &done.strips {
            let (start_s, end_s) = strip.span_s;
            writeln!(out, "{}: {} points, {start_s:.1} s to {end_s:.1} s", strip.path.display(), strip.points)?;
        }
        if let Some((duration_s, length_m)) = done.drive {
            writeln!(out, "a drive of {duration_s:.0} s over {length_m:.0} m")?;
        }
        writeln!(
            out,
            "{} strips, {points} points; what is wrong with them stands in {}\nnext: tieline run {}",
            done.strips.len(),
            folder.join("truth").display(),
            done.project.display()
        )?;
    }
    Ok(())
}

fn record(scenario: &AnyScenario, folder: &Path, common: &Common) -> Result<Done> {
    match scenario {
        AnyScenario::Flight(scenario) => {
            let report = simulate(scenario, folder)?;
            Ok(Done { project: report.project, strips: report.strips, drive: None })
        }
        AnyScenario::Drive(scenario) => {
            let bar = Progress::new(common.quiet).bar("simulating pulses", 0);
            let report = simulate_drive(scenario, folder, &mut |done, total| {
                bar.set_length(total);
                bar.set_position(done);
            })?;
            bar.finish_and_clear();
            let drive = Some((report.duration_s, report.length_m));
            Ok(Done { project: report.project, strips: report.strips, drive })
        }
    }
}
