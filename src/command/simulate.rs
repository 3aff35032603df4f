//! `simulate SCENARIO.toml --out DIR`: a survey with known errors.

use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use tieline_simulate::{Scenario, simulate};

use crate::cli::Common;

/// Simulates a scenario into a folder that is empty or not there yet.
///
/// # Errors
/// When the scenario makes no sense, the folder is in use, or the disk refuses.
pub fn run(scenario: &Path, folder: &Path, common: &Common, out: &mut impl Write) -> Result<()> {
    let scenario = Scenario::read(scenario)?;
    if std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
        bail!("the output folder {} is not empty: name another with --out", folder.display());
    }
    let report = simulate(&scenario, folder).with_context(|| format!("simulating into {}", folder.display()))?;
    if common.json {
        let strips: Vec<_> = report
            .strips
            .iter()
            .map(|s| serde_json::json!({ "path": s.path, "points": s.points, "span_s": [s.span_s.0, s.span_s.1] }))
            .collect();
        let value = serde_json::json!({ "project": report.project, "points": report.points(), "strips": strips });
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        for strip in &report.strips {
            let (start_s, end_s) = strip.span_s;
            writeln!(out, "{}: {} points, {start_s:.1} s to {end_s:.1} s", strip.path.display(), strip.points)?;
        }
        writeln!(
            out,
            "{} strips, {} points; what is wrong with them stands in {}\nnext: tieline run {}",
            report.strips.len(),
            report.points(),
            folder.join("truth").display(),
            report.project.display()
        )?;
    }
    Ok(())
}
