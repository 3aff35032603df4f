//! A drive with false ties: surfaces matched that are not one.

use std::path::Path;

use anyhow::Result;
use tieline::job::{Clock, DEFAULT_MEMORY_BYTES, JobOptions, Matched, match_strips};
use tieline::progress::Progress;
use tieline::project::Project;
use tieline::stage::{drive, navigate};
use tieline_matching::mix;

use super::{Errors, errors_within, windows};

/// One tie in so many is false.
const ONE_IN: u64 = 20;
/// By this much and up to five times this \[m\].
const LEAST_M: f64 = 0.1;

/// The drive solved with a twentieth of its surface lines false: matching, choice of ties, calibration and smoother see them.
pub(super) fn solved_with_false_ties(project: &Path, seed: u64) -> Result<Errors> {
    let data = project.parent().unwrap_or(Path::new("."));
    let project = Project::load(project)?;
    let options =
        JobOptions { out: data.join("out"), memory_bytes: DEFAULT_MEMORY_BYTES, progress: Progress::silent() };
    let measurements = navigate::load(&project, &[])?;
    let mut matched = match_strips(&project, &options, &mut Clock::default())?;
    falsify(&mut matched, seed);
    let solved =
        drive::solve(&project, &matched, &measurements, &[], None, DEFAULT_MEMORY_BYTES, &mut Clock::default())?;
    let trajectory = solved.solution.trajectory(&solved.inputs, 0.0)?;
    errors_within(data, &trajectory, &windows(&data.join("truth/outages.csv"), 0)?)
}

/// Moves the last patch of lines by 0.1 to 0.5 m along its normal, up or down.
fn falsify(matched: &mut Matched, seed: u64) {
    for row in matched.ties.selected.clone() {
        let number = mix(mix(seed) ^ row as u64);
        if !number.is_multiple_of(ONE_IN) {
            continue;
        }
        let size_m = LEAST_M * (1.0 + 4.0 * ((number >> 8) % 1000) as f64 / 1000.0);
        let by_m = if (number >> 40) & 1 == 0 { size_m } else { -size_m };
        let used = matched.ties.lines[row].ends.iter_mut().rev().find(|e| e.rejection.is_none());
        if let Some(end) = used {
            end.patch.centroid_m += end.patch.normal * by_m;
        }
    }
}
