//! Pairs of strips before and after.

use crate::report::data::{PairSummary, Summary};
use crate::report::findings::{got_worse, is_adjusted};
use crate::report::html::{Align, Table, escape, section};
use crate::report::number::{length, mm, signed_mm};
use crate::report::plot::dumbbell;

/// Most rows: more do not help the eye, and `summary.json` has them all.
const MOST_ROWS: usize = 400;

const LEAD: &str = "Differences between the two strips of a pair, along the normals of the surfaces they share, second strip \
minus first. The median is what one strip as a whole lies above the other; the robust sd (1.4826 × median absolute deviation) \
is the spread about it, mostly measuring noise; the rms holds both. The shift is how far the second strip lies east, north and \
above the first, a dash where the surfaces do not fix that direction. Worst pairs first.";

/// The section.
pub(crate) fn html(summary: &Summary) -> String {
    let mut pairs: Vec<&PairSummary> = summary.pairs.iter().collect();
    let adjusted = is_adjusted(summary);
    let size = |p: &PairSummary| if adjusted { p.after.median_m.abs() } else { p.before.median_m.abs() };
    pairs.sort_by(|a, b| size(b).total_cmp(&size(a)));
    let limit_m = pairs.iter().map(|p| p.before.median_m.abs().max(p.after.median_m.abs())).fold(0.0, f64::max);

    let mut table = Table::new(
        "Pairs of strips, before and after the adjustment",
        &[
            ("Strips", "first / second", Align::Text),
            ("Number", "", Align::Number),
            ("before", "mm", Align::Number),
            ("after", "mm", Align::Number),
            ("", "○ before ● after", Align::Text),
            ("before", "mm", Align::Number),
            ("after", "mm", Align::Number),
            ("before", "mm", Align::Number),
            ("after", "mm", Align::Number),
            ("east", "mm", Align::Number),
            ("north", "mm", Align::Number),
            ("up", "mm", Align::Number),
            ("east", "mm", Align::Number),
            ("north", "mm", Align::Number),
            ("up", "mm", Align::Number),
        ],
    )
    .groups(&[("", 2), ("Median", 3), ("Robust sd", 2), ("Rms", 2), ("Shift before", 3), ("Shift after", 3)]);
    for pair in pairs.iter().take(MOST_ROWS) {
        let class = if adjusted && got_worse(pair) { "warning" } else { "" };
        table.row_of_html(class, &row(pair, limit_m, adjusted));
    }
    let more = if pairs.len() > MOST_ROWS {
        format!("<p>The {} worst of {} pairs; summary.json has them all.</p>\n", MOST_ROWS, length(pairs.len()))
    } else {
        String::new()
    };
    let body = if pairs.is_empty() { String::from("<p>No two strips were tied.</p>\n") } else { table.html() + &more };
    section("pairs", "Pairs of strips", LEAD, &body)
}

fn row(pair: &PairSummary, limit_m: f64, adjusted: bool) -> Vec<String> {
    let known = |n: usize, value: String| if n > 0 { value } else { String::from("–") };
    let (before, after) = (&pair.before, &pair.after);
    let mut cells = vec![
        format!("{}<br>{}", escape(&pair.a), escape(&pair.b)),
        length(before.n.max(after.n)),
        known(before.n, signed_mm(before.median_m)),
        known(after.n, signed_mm(after.median_m)),
        if adjusted { dumbbell(before.median_m, after.median_m, limit_m) } else { String::new() },
        known(before.n, mm(before.sigma_mad_m)),
        known(after.n, mm(after.sigma_mad_m)),
        known(before.n, mm(before.rms_m)),
        known(after.n, mm(after.rms_m)),
    ];
    cells.extend(pair.shift_before_m.iter().map(|v| known(before.n, signed_mm(*v))));
    cells.extend(pair.shift_after_m.iter().map(|v| known(after.n, signed_mm(*v))));
    cells
}
