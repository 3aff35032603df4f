//! Ties: their differences as histograms and statistics, how many were found, and why others were not taken.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crate::report::data::{Discrepancy, Summary, TiePoint};
use crate::report::html::{Align, Table, bar, section};
use crate::report::number::{count, length, mm, round_up, signed_mm};
use crate::report::plot::{Series, histogram};

const FIT_LEAD: &str = "A tie is one surface seen by two strips; its difference is the distance between the two sightings along \
the surface's normal. Ties held out took no part in the adjustment: where they agree with the used ones, the result holds \
between the ties as well as at them. Outliers are in none of these numbers.";
const COUNT_LEAD: &str = "What was found in the overlaps, how much of it the adjustment used, and why candidates were turned \
down.";

/// Histograms and statistics.
pub(crate) fn fit(summary: &Summary, points: &[TiePoint]) -> String {
    let values = |held_out: Option<bool>, value: fn(&TiePoint) -> f64| -> Vec<f64> {
        let chosen = points.iter().filter(|p| !p.outlier && held_out.is_none_or(|h| h == p.held_out));
        chosen.map(value).filter(|v| v.is_finite()).collect()
    };
    let adjusted = summary.discrepancy.after.n > 0;
    let before = values(None, |p| p.before_m);
    let after = values(None, |p| p.after_m);
    let mut body = String::from("<div class=\"figures\">\n");
    let mut series = vec![Series { name: "before", class: "before", values_m: &before, filled: true }];
    if adjusted {
        series.push(Series { name: "after", class: "after", values_m: &after, filled: true });
    }
    let chart = histogram("Histogram of tie differences before and after", reach(&before, 0.99), &series);
    figure(&mut body, "Before and after, all ties", &chart);
    if adjusted {
        let (used, held) = (values(Some(false), |p| p.after_m), values(Some(true), |p| p.after_m));
        let series = [
            Series { name: "used in the adjustment", class: "after", values_m: &used, filled: true },
            Series { name: "held out", class: "held", values_m: &held, filled: false },
        ];
        let chart = histogram("Histogram of tie differences after, used and held out", reach(&after, 0.99), &series);
        figure(&mut body, "After: used against held out", &chart);
    }
    body.push_str("</div>\n");
    body.push_str(&statistics(summary));
    section("ties", "How well the ties fit", FIT_LEAD, &body)
}

fn figure(body: &mut String, caption: &str, chart: &str) {
    if !chart.is_empty() {
        let _ = write!(body, "<figure><figcaption>{caption}</figcaption>\n{chart}</figure>\n");
    }
}

/// A round number that a share of the sizes stays below.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a rank in the list
pub(crate) fn reach(values_m: &[f64], share: f64) -> f64 {
    let mut sizes: Vec<f64> = values_m.iter().map(|v| v.abs()).collect();
    sizes.sort_unstable_by(f64::total_cmp);
    let rank = (share * sizes.len() as f64) as usize;
    round_up(sizes.get(rank.min(sizes.len().saturating_sub(1))).map_or(0.01, |v| v.max(1e-3)))
}

fn statistics(summary: &Summary) -> String {
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
    let rows: [(&str, &Discrepancy); 4] = [
        ("Used, before", &d.before),
        ("Used, after", &d.after),
        ("Held out, before", &d.held_out_before),
        ("Held out, after", &d.held_out_after),
    ];
    for (name, s) in rows.into_iter().filter(|r| r.1.n > 0) {
        table.row(&[
            String::from(name),
            length(s.n),
            signed_mm(s.median_m),
            mm(s.sigma_mad_m),
            mm(s.rms_m),
            format!("± {}", mm(s.p95_m)),
        ]);
    }
    table.html()
}

/// Numbers found, used and rejected.
pub(crate) fn numbers(summary: &Summary) -> String {
    let mut kinds = Table::new(
        "Ties by kind",
        &[
            ("Kind", "", Align::Text),
            ("Found", "", Align::Number),
            ("Used", "", Align::Number),
            ("Held out", "", Align::Number),
        ],
    );
    for (kind, n) in summary.ties.iter().filter(|(_, n)| n.found + n.used + n.held_out > 0) {
        kinds.row(&[kind_in_words(kind), count(n.found), count(n.used), count(n.held_out)]);
    }
    let beside = format!("{}{}", kinds.html(), rejections(&summary.rejected));
    let body = format!("<div class=\"beside\">\n{beside}</div>\n{}", places(summary));
    section("numbers", "Ties found and rejected", COUNT_LEAD, &body)
}

/// Ties of places by kind: what they hold, and how far the places lie apart.
fn places(summary: &Summary) -> String {
    let mut table = Table::new(
        "Ties of places, distances along the directions that they hold",
        &[
            ("Kind", "", Align::Text),
            ("Found", "", Align::Number),
            ("Used", "", Align::Number),
            ("Held out", "", Align::Number),
            ("1, 2, 3 directions", "", Align::Number),
            ("Before, rms", "mm", Align::Number),
            ("After, rms", "mm", Align::Number),
            ("Held out, rms", "mm", Align::Number),
        ],
    );
    for (kind, p) in &summary.places {
        let rms = |d: &Discrepancy| if d.n > 0 { mm(d.rms_m) } else { String::from("–") };
        table.row(&[
            plain(kind),
            count(p.counts.found),
            count(p.counts.used),
            count(p.counts.held_out),
            p.rank.map(count).join(", "),
            rms(&p.before),
            rms(&p.after),
            rms(&p.held_out_after),
        ]);
    }
    if summary.places.is_empty() { String::new() } else { table.html() }
}

/// Ends rejected, by reason, the most frequent first.
pub(crate) fn rejections(by_reason: &BTreeMap<String, u64>) -> String {
    let mut reasons = Table::new(
        "Rejected, by reason",
        &[("Reason", "", Align::Text), ("Number", "", Align::Number), ("Share", "", Align::Text)],
    );
    let mut rejected: Vec<(&String, u64)> = by_reason.iter().map(|(reason, n)| (reason, *n)).collect();
    rejected.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(b.0)));
    let total: u64 = rejected.iter().map(|r| r.1).sum();
    for (reason, n) in rejected {
        let share = n as f64 / total.max(1) as f64;
        reasons.row_of_html("", &[crate::report::html::escape(&plain(reason)), count(n), bar(share, "quiet")]);
    }
    reasons.html()
}

/// A key as words: `normal_angle` is `normal angle`.
fn plain(key: &str) -> String {
    key.replace(['_', '-'], " ")
}

fn kind_in_words(kind: &str) -> String {
    let meaning = match kind {
        "surface_line" => "surface line (one direction, along the normal)",
        "line" => "line, a ridge (two directions)",
        "xyz_point" => "XYZ point, a corner (three directions)",
        "increment" => "increment (two scanners of one drive)",
        "submap" => "submap (up to three directions)",
        "control" => "control (known beforehand)",
        other => return plain(other),
    };
    String::from(meaning)
}
