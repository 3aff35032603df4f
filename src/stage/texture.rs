//! Texture of pavement in a drive: where spots are looked for.

use anyhow::{Context, Result};
use tieline_filter::Trajectory;
use tieline_matching::xyz::texture::{JudgeOptions, SpotTie, TextureOptions, TexturePoints, find_spots, judge};

use super::search::Search;

/// Finds the spots of a drive and lets neighbours judge them; gives what there is to say as well.
///
/// # Errors
/// When a temporary file cannot be read.
pub fn spots(points: &TexturePoints, trajectory: &Trajectory) -> Result<(Vec<SpotTie>, String)> {
    let search = Search::of(trajectory);
    let search_m = |a_s: f64, b_s: f64| search.radius_m(a_s, b_s);
    let mut ties = find_spots(points, &search_m, search.most_m(), &TextureOptions::default())
        .context("a temporary file of pavement cannot be read back")?;
    judge(&mut ties, &JudgeOptions::default());
    keep_pictures(&mut ties);
    let used = ties.iter().filter(|t| t.rejection.is_none()).count();
    let note = format!("texture of pavement: {used} of {} matches of spots are ties", ties.len());
    Ok((ties, note))
}

/// Pictures of the best matches, and of some for each reason, stay for the contact sheet.
fn keep_pictures(ties: &mut [SpotTie]) {
    const BEST: usize = 100;
    const OF_A_REASON: usize = 12;
    let mut order: Vec<usize> = (0..ties.len()).filter(|k| ties[*k].picture.is_some()).collect();
    let sigma = |t: &SpotTie| t.covariance_m2.fixed_view::<2, 2>(0, 0).trace();
    order.sort_by(|a, b| {
        let key = |k: usize| (ties[k].rejection, sigma(&ties[k]));
        key(*a).0.cmp(&key(*b).0).then(key(*a).1.total_cmp(&key(*b).1)).then(a.cmp(b))
    });
    let (mut last, mut count) = (None, 0);
    for k in order {
        let reason = ties[k].rejection;
        count = if last == Some(reason) { count + 1 } else { 1 };
        last = Some(reason);
        if count > reason.map_or(BEST, |_| OF_A_REASON) {
            ties[k].picture = None;
        }
    }
}
