//! The report of a calibration of stations.

pub mod data;
mod page;

use std::path::Path;

use anyhow::{Context, Result};
use tieline_io::output::write_whole;

use crate::report::data::Timing;
use crate::report::number::{fixed, length, mm};
use crate::settings::Setting;
use crate::stage::stations::read::Read;
use crate::stage::stations::{Mounts, StationsSolution};
use data::{StationsSummary, summarise};

/// All that the report tells.
#[derive(Debug)]
pub struct StationsReport<'a> {
    /// Name of the project.
    pub name: &'a str,
    /// Scanners.
    pub mounts: &'a Mounts,
    /// Stations.
    pub read: &'a Read,
    /// The calibration.
    pub solution: &'a StationsSolution,
    /// Settings with their reasons.
    pub settings: &'a [Setting],
    /// Times of the stages.
    pub timing: Timing,
    /// Peak memory \[bytes\].
    pub peak_memory_bytes: u64,
}

/// Writes `report.html` and `summary.json`; gives the summary.
///
/// # Errors
/// When one cannot be written.
pub fn write_report(out: &Path, report: &StationsReport<'_>) -> Result<StationsSummary> {
    let summary = summarise(report);
    let json = serde_json::to_string_pretty(&summary).context("the summary cannot be written as JSON")?;
    let write = |name: &str, text: &str| {
        write_whole(&out.join(name), text.as_bytes()).with_context(|| format!("writing {}", out.join(name).display()))
    };
    write("summary.json", &format!("{json}\n"))?;
    write("report.html", &page::render(&summary, report))?;
    Ok(summary)
}

/// What got better, what is not seen, and where the report lies.
#[must_use]
pub fn three_lines(summary: &StationsSummary, page: &Path) -> String {
    let d = &summary.discrepancy;
    let worst = summary.calibration.directions.first();
    let weakest = worst.map_or_else(String::new, |d| {
        let name = summary.scanners.iter().find(|s| s.id == d.scanner).map_or("", |s| s.name.as_str());
        let members: Vec<String> =
            d.members.iter().map(|(m, c)| format!("{}{m}", if *c < 0.0 { "-" } else { "" })).collect();
        format!("; weakest ({}): {name} {}, {} mm at 20 m", d.grade, members.join(" "), fixed(1e3 * d.effect_m, 0))
    });
    format!(
        "Planes common to two scanners differed by {} mm (robust sd), now {} mm ({}); held out {} -> {} mm ({}).\n\
         Not seen: the boresight and lever arm that all scanners have in common{weakest}.\nReport: {}",
        mm(d.before.sigma_mad_m),
        mm(d.after.sigma_mad_m),
        length(d.after.n),
        mm(d.held_out_before.sigma_mad_m),
        mm(d.held_out_after.sigma_mad_m),
        length(d.held_out_after.n),
        page.display()
    )
}
