//! Strips: what they are and how they were corrected.

use crate::report::data::{StripSummary, Summary};
use crate::report::findings::is_adjusted;
use crate::report::html::{Align, Table, escape, section};
use crate::report::number::{count, duration, fixed, length, signed};

/// Most rows; `summary.json` has them all.
const MOST_ROWS: usize = 400;

const LEAD: &str = "The correction is the one at the middle of the strip, added to its trajectory: east, north, up, and small \
rotations about these axes in thousandths of a degree. Largest / prior is the largest component of the correction divided by \
the accuracy (1 sigma) that was assumed for it: a few is ordinary, more than that deserves a look.";

/// The section.
pub(crate) fn html(summary: &Summary) -> String {
    let adjusted = is_adjusted(summary);
    let mut columns = vec![
        ("Strip", "", Align::Text),
        ("Begin", "", Align::Text),
        ("Length", "", Align::Number),
        ("Points", "", Align::Number),
        ("Course", "°", Align::Number),
        ("Speed", "m/s", Align::Number),
        ("Height", "m above ground", Align::Number),
    ];
    if adjusted {
        columns.extend([
            ("east", "m", Align::Number),
            ("north", "m", Align::Number),
            ("up", "m", Align::Number),
            ("about east", "mdeg", Align::Number),
            ("about north", "mdeg", Align::Number),
            ("about up", "mdeg", Align::Number),
            ("Largest / prior", "", Align::Number),
            ("Plausible", "", Align::Text),
        ]);
    }
    columns.extend([("Scanners", "", Align::Text), ("Trajectory", "", Align::Prose)]);
    let mut table = Table::new("Strips and their corrections", &columns);
    if adjusted {
        table = table.groups(&[("", 7), ("Correction", 3), ("Rotation", 3), ("", 4)]);
    }
    for strip in summary.strips.iter().take(MOST_ROWS) {
        let class = if strip.implausible { "warning" } else { "" };
        table.row_of_html(class, &row(strip, adjusted));
    }
    let more = if summary.strips.len() > MOST_ROWS {
        format!("<p>The first {MOST_ROWS} of {} strips; summary.json has them all.</p>\n", length(summary.strips.len()))
    } else {
        String::new()
    };
    section("strips", "Strips", if adjusted { LEAD } else { "" }, &(table.html() + &more))
}

fn row(strip: &StripSummary, adjusted: bool) -> Vec<String> {
    let begin = strip.start_utc.as_deref().map_or_else(|| format!("{} s", fixed(strip.start_s, 1)), escape);
    let mut cells = vec![
        escape(&strip.name),
        begin,
        duration(strip.end_s - strip.start_s),
        count(strip.points),
        fixed(strip.course_deg, 1),
        fixed(strip.speed_mps, 1),
        fixed(strip.height_m, 0),
    ];
    if adjusted {
        cells.extend(strip.correction_enu_m.iter().map(|v| signed(*v, 4)));
        cells.extend(strip.rotation_enu_deg.iter().map(|v| signed(v * 1e3, 2)));
        cells.push(format!("{} ×", fixed(strip.largest_over_prior, 2)));
        let verdict = match (strip.fixed, strip.implausible) {
            (true, _) => "held fixed",
            (false, true) => "<b>! too large</b>",
            (false, false) => "✓ yes",
        };
        cells.push(String::from(verdict));
    }
    let scanners: Vec<String> = strip.scanners.iter().map(u16::to_string).collect();
    cells.push(scanners.join(", "));
    cells.push(escape(&strip.trajectory));
    cells
}
