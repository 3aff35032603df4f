//! How well the ties fit: histograms, and statistics by class and kind.

use std::fmt::Write as _;

use crate::report::drive::data::{ClassSummary, DriveCharts, DriveSummary};
use crate::report::html::{Align, Table, section};
use crate::report::number::{count, length, mm, signed_mm};
use crate::report::plot::{Series, histogram};
use crate::report::section::ties::{reach, rejections};

const LEAD: &str = "A tie is a surface seen twice or more: by two scanners in one visit, in two passes of a strip, or in two \
strips. Its difference is the distance of the last sighting from the first along the surface's normal. A fifth of the ties, whole \
places of them, are held out: they judge the solution. Of the others the smoother took a part; all of them are in these numbers. Nothing is taken out of these numbers; a parked car that drove off \
between two visits is in the rms, hardly in the median and the robust standard deviation.";

/// The section.
pub(crate) fn html(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let values = |held: Option<bool>, of: fn(&(f64, f64, bool)) -> f64| -> Vec<f64> {
        let chosen = charts.lines.iter().filter(|l| held.is_none_or(|h| h == l.2));
        chosen.map(of).filter(|v| v.is_finite()).collect()
    };
    let (before, after) = (values(None, |l| l.0), values(None, |l| l.1));
    let (used, held) = (values(Some(false), |l| l.1), values(Some(true), |l| l.1));
    let series = |name, class, values_m, filled| Series { name, class, values_m, filled };
    let charts = [
        (
            "Before and after, all ties",
            histogram(
                "Histogram of tie differences before and after",
                reach(&before, 0.97),
                &[series("before", "before", &before, true), series("after", "after", &after, true)],
            ),
        ),
        (
            "After: ties not held out against those held out",
            histogram(
                "Histogram of tie differences after, not held out and held out",
                reach(&after, 0.97),
                &[series("not held out", "after", &used, true), series("held out", "held", &held, false)],
            ),
        ),
    ];
    let mut body = String::from("<div class=\"figures\">\n");
    for (caption, chart) in charts.iter().filter(|c| !c.1.is_empty()) {
        let _ = write!(body, "<figure><figcaption>{caption}</figcaption>\n{chart}</figure>\n");
    }
    body.push_str("</div>\n");
    body += &statistics(summary);
    body += &by("Ties by class", "Class", summary.ties_by_class.iter().map(|(name, t)| (name.clone(), t)));
    body += "<p class=\"note\">A tie that two scanners see in each of two visits counts under its visits; what its scanners differ \
             by within a visit is among the differences of scanner to scanner too. By class, differences count towards the vehicle, as over range below. Used are those that the smoother took: of many that say the same it takes the best.</p>\n";
    body += &by("Ties by kind", "Kind", summary.ties.iter().map(|(kind, t)| (kind.replace('_', " "), t)));
    body += &rejections(&summary.rejected);
    section("ties", "How well the ties fit", LEAD, &body)
}

fn statistics(summary: &DriveSummary) -> String {
    let mut table = Table::new(
        "Differences of the ties along the normal",
        &[
            ("Ties", "", Align::Text),
            ("Number", "", Align::Number),
            ("Median", "mm", Align::Number),
            ("Robust sd", "mm", Align::Number),
            ("Rms", "mm", Align::Number),
            ("95 % within", "mm", Align::Number),
        ],
    );
    let d = &summary.discrepancy;
    let rows = [
        ("Not held out, before", &d.before),
        ("Not held out, after", &d.after),
        ("Held out, before", &d.held_out_before),
        ("Held out, after", &d.held_out_after),
    ];
    for (name, s) in rows.into_iter().filter(|r| r.1.n > 0) {
        let p95 = format!("± {}", mm(s.p95_m));
        table.row(&[String::from(name), length(s.n), signed_mm(s.median_m), mm(s.sigma_mad_m), mm(s.rms_m), p95]);
    }
    table.html()
}

/// Numbers and differences, a row each; `summary.json` has those of held-out ties before as well.
fn by<'a>(caption: &str, of: &str, rows: impl Iterator<Item = (String, &'a ClassSummary)>) -> String {
    let mut columns = vec![
        (of, "", Align::Text),
        ("Found", "", Align::Number),
        ("Used", "", Align::Number),
        ("Held out", "", Align::Number),
    ];
    for _ in 0..3 {
        columns.extend([
            ("Median", "mm", Align::Number),
            ("Robust sd", "mm", Align::Number),
            ("Rms", "mm", Align::Number),
        ]);
    }
    let mut table =
        Table::new(caption, &columns).groups(&[("", 4), ("Before", 3), ("After", 3), ("Held out, after", 3)]);
    for (name, ties) in rows.filter(|r| r.1.counts.found > 0) {
        let mut cells = vec![name, count(ties.counts.found), count(ties.counts.used), count(ties.counts.held_out)];
        let d = &ties.discrepancy;
        for s in [&d.before, &d.after, &d.held_out_after] {
            let known = |v: f64| if s.n == 0 { f64::NAN } else { v };
            cells.extend([signed_mm(known(s.median_m)), mm(known(s.sigma_mad_m)), mm(known(s.rms_m))]);
        }
        table.row(&cells);
    }
    table.html()
}
