//! Posts and trunks in a drive: found, matched between sightings, and when the scan passed them.

use anyhow::{Context, Result};
use nalgebra::Vector3;
use tieline_filter::Trajectory;
use tieline_matching::StripIndex;
use tieline_matching::xyz::{AgreeOptions, FeatureTie, PoleOptions, PostPoints, agree, match_poles, poles};

use super::corners::is_passed;
use super::search::Search;
use crate::project::Project;

/// Worse known ties say nothing that others do not \[m\].
const MOST_SIGMA_M: f64 = 0.012;

/// Finds the poles of a drive, matches them and lets those about them judge them; gives what there is to say as well.
///
/// # Errors
/// When a temporary file cannot be read.
pub fn poles_of(
    points: &PostPoints,
    strips: &StripIndex,
    project: &Project,
    trajectory: &Trajectory,
    origin_m: &Vector3<f64>,
) -> Result<(Vec<FeatureTie>, String)> {
    let found = poles(points, &PoleOptions::default())
        .context("a temporary file of what stands beside the road cannot be read back")?;
    let search = Search::of(trajectory);
    let radius_m = |a_s: f64, b_s: f64| search.radius_m(a_s, b_s);
    let whose = |source, time_s| strips.find(source, time_s);
    let mut ties = match_poles(&found, &whose, &radius_m, search.most_m(), MOST_SIGMA_M);
    ties.retain_mut(|tie| tie.ends.iter_mut().all(|end| is_passed(end, project, trajectory, origin_m)));
    agree(&mut ties, &AgreeOptions::default());
    let used = ties.iter().filter(|t| t.rejection.is_none()).count();
    let note = format!("poles and trunks: {used} of {} matches of {} sightings are ties", ties.len(), found.len());
    Ok((ties, note))
}
