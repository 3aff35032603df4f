//! The trajectory over time: what changed, how sure it is, where GNSS was missing and ties were.

use std::fmt::Write as _;

use crate::report::chart::{Band, Chart, Curve, Mark, Panel};
use crate::report::drive::data::{DriveCharts, DriveSummary};
use crate::report::html::{Align, Table, section};
use crate::report::number::{duration, fixed, mm};

const LEAD: &str = "New less old trajectory, as it corrects the points. The band is twice the standard deviation of the new \
trajectory either way: where the difference leaves it, the old trajectory was off by more than the new one may be. Shaded: more \
than 5 s without GNSS. Below: how many sightings of ties \
the smoother used in each second: of loop ties, which bind several visits, and of increments within one visit.";
/// Most values of a curve.
const MOST_POINTS: usize = 600;
const PANEL: f64 = 96.0;

/// The section.
pub(crate) fn html(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let figures = [
        ("Position: new less old", differences(summary, charts, 0)),
        ("Attitude: new less old", differences(summary, charts, 3)),
        ("Standard deviation of the position", sigmas(summary, charts, 0)),
        ("Standard deviation of the attitude", sigmas(summary, charts, 3)),
    ];
    let mut body = String::from("<div class=\"figures\">\n");
    for (caption, chart) in figures.iter().filter(|f| !f.1.is_empty()) {
        let _ = write!(body, "<figure><figcaption>{caption}</figcaption>\n{chart}</figure>\n");
    }
    body.push_str("</div>\n");
    body.push_str(&outages(summary, charts));
    section("trajectory", "Trajectory over time", LEAD, &body)
}

const NAMES: [&str; 6] = ["east", "north", "up", "roll", "pitch", "heading"];

/// Unit of an axis and the factor to it, by the largest value in metres or radians.
fn unit(first: usize, largest: f64) -> (&'static str, f64) {
    match (first < 3, largest) {
        (true, v) if v < 1.0 => ("mm", 1e3),
        (true, _) => ("m", 1.0),
        (false, v) if v.to_degrees() < 1.0 => ("mdeg", 1e3_f64.to_degrees()),
        (false, _) => ("°", 1_f64.to_degrees()),
    }
}

/// Every so many rows, so that a chart stays small; peaks of the rows between are kept by [`thinned`].
fn step(rows: usize) -> usize {
    rows.div_ceil(MOST_POINTS / 2).max(1)
}

/// Of each group of rows the least and the greatest value, in their order.
fn thinned(values: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut kept = Vec::new();
    for group in values.chunks(step(values.len())) {
        let low = group.iter().enumerate().min_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let high = group.iter().enumerate().max_by(|a, b| a.1.1.total_cmp(&b.1.1));
        if let (Some(low), Some(high)) = (low, high) {
            kept.push(if low.0 <= high.0 { *low.1 } else { *high.1 });
            if low.0 != high.0 {
                kept.push(if low.0 <= high.0 { *high.1 } else { *low.1 });
            }
        }
    }
    kept
}

fn frame(summary: &DriveSummary, charts: &DriveCharts, label: &str) -> Chart {
    let start_s = charts.origin.time_s;
    Chart {
        label: String::from(label),
        axis: format!("time, s after {}", charts.origin.words(start_s, 0)),
        limits: (charts.span_s.0 - start_s, charts.span_s.1 - start_s),
        shaded: summary.trajectory.outages.iter().map(|o| (o.start_s - start_s, o.end_s - start_s)).collect(),
        ..Chart::default()
    }
}

fn shade_legend(chart: &mut Chart) {
    if !chart.shaded.is_empty() {
        chart.legend.push(("shade", "", String::from("no GNSS")));
    }
}

/// Three components of the difference, with the ties below.
fn differences(summary: &DriveSummary, charts: &DriveCharts, first: usize) -> String {
    let start_s = charts.origin.time_s;
    let value = |row: &tieline_filter::CorrectionRow, k: usize| match k {
        0..3 => row.position_enu_m[k],
        _ => row.attitude_rph_rad[k - 3],
    };
    let largest = charts.corrections.iter().flat_map(|r| (first..first + 3).map(|k| value(r, k).abs()));
    let (unit, factor) = unit(first, largest.fold(0.0, f64::max));
    let what = if first < 3 { "position" } else { "attitude" };
    let mut chart = frame(summary, charts, &format!("Difference of the trajectories over time: {what}"));
    for (k, name) in NAMES.iter().enumerate().skip(first).take(3) {
        let points: Vec<(f64, f64)> =
            charts.corrections.iter().map(|r| (r.time_s - start_s, value(r, k) * factor)).collect();
        let band = charts.corrections.iter().step_by(step(charts.corrections.len())).map(|r| {
            let (v, s) = (value(r, k) * factor, 2.0 * r.sigma[k] * factor);
            (r.time_s - start_s, v - s, v + s)
        });
        chart.panels.push(Panel {
            axis: format!("{name}, {unit}"),
            height: PANEL,
            bands: vec![Band { class: "after", points: band.collect() }],
            curves: vec![Curve { class: "after", mark: Mark::Line, points: thinned(&points) }],
            ..Panel::default()
        });
    }
    if charts.corrections.is_empty() {
        return String::new();
    }
    let [loops, increments] = &charts.tie_times_s;
    chart.panels.push(density(charts, loops, "loops, 1/s"));
    chart.panels.push(density(charts, increments, "incr., 1/s"));
    chart.legend = vec![
        ("line", "after", String::from("new less old")),
        ("band", "after", String::from("± 2 sigma")),
        ("fill", "held", String::from("sightings of loop ties and of increments")),
    ];
    shade_legend(&mut chart);
    chart.html()
}

/// Sightings of used ties a second, as steps.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn density(charts: &DriveCharts, times_s: &[f64], axis: &str) -> Panel {
    let (from_s, to_s) = charts.span_s;
    let bins = ((to_s - from_s).max(1.0) as usize).clamp(1, 150);
    let width_s = (to_s - from_s) / bins as f64;
    let mut counts = vec![0_usize; bins];
    for time_s in times_s.iter().filter(|t| **t >= from_s && **t <= to_s) {
        counts[(((time_s - from_s) / width_s) as usize).min(bins - 1)] += 1;
    }
    // steps: two corners a bin
    let points = counts.iter().enumerate().flat_map(|(i, n)| {
        let at = |k: usize| (from_s - charts.origin.time_s + k as f64 * width_s, *n as f64 / width_s);
        [at(i), at(i + 1)]
    });
    let curves = vec![Curve { class: "held", mark: Mark::Area, points: points.collect() }];
    Panel { axis: String::from(axis), height: 62.0, curves, ..Panel::default() }
}

/// Standard deviations before and after.
fn sigmas(summary: &DriveSummary, charts: &DriveCharts, first: usize) -> String {
    let start_s = charts.origin.time_s;
    let rows = || charts.corrections.iter().zip(&charts.sigma_before).step_by(step(charts.corrections.len()));
    let most = rows().flat_map(|(r, old)| {
        (first..first + 3).map(move |k| r.sigma[k].max(old.map_or(0.0, |o| o[k]))) // NaN loses against a number
    });
    let (unit, factor) = unit(first, most.fold(0.0, f64::max));
    let what = if first < 3 { "position" } else { "attitude" };
    let mut chart = frame(summary, charts, &format!("Standard deviations of the {what} over time"));
    for (k, name) in NAMES.iter().enumerate().skip(first).take(3) {
        let new = rows().map(|(r, _)| (r.time_s - start_s, r.sigma[k] * factor)).collect();
        let old = rows().map(|(r, old)| (r.time_s - start_s, old.map_or(f64::NAN, |o| o[k] * factor))).collect();
        chart.panels.push(Panel {
            axis: format!("{name}, {unit}"),
            height: 86.0,
            curves: vec![
                Curve { class: "before", mark: Mark::Line, points: old },
                Curve { class: "after", mark: Mark::Line, points: new },
            ],
            ..Panel::default()
        });
    }
    if charts.sigma_before.iter().any(Option::is_some) {
        chart.legend.push(("line", "before", String::from("old trajectory, as its file says")));
    }
    chart.legend.push(("line", "after", String::from("new trajectory")));
    shade_legend(&mut chart);
    if charts.corrections.is_empty() { String::new() } else { chart.html() }
}

/// Table of the stretches without GNSS.
fn outages(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let mut table = Table::new(
        "Stretches without GNSS",
        &[
            ("From", "second of week", Align::Number),
            ("Length", "", Align::Number),
            ("Largest correction", "mm", Align::Number),
            ("east", "mm", Align::Number),
            ("north", "mm", Align::Number),
            ("up", "mm", Align::Number),
            ("roll", "mdeg", Align::Number),
            ("pitch", "mdeg", Align::Number),
            ("heading", "mdeg", Align::Number),
            ("east", "mm", Align::Number),
            ("north", "mm", Align::Number),
            ("up", "mm", Align::Number),
        ],
    )
    .groups(&[("", 3), ("Largest sigma, new", 6), ("Largest sigma, old", 3)]);
    for outage in &summary.trajectory.outages {
        let mut cells = vec![
            format!("{:.1}", charts.origin.second_of(outage.start_s)),
            duration(outage.end_s - outage.start_s),
            mm(outage.largest_correction_m),
        ];
        cells.extend(outage.largest_sigma_enu_m.iter().map(|s| mm(*s)));
        cells.extend(outage.largest_sigma_rph_deg.iter().map(|s| fixed(s * 1e3, 1)));
        cells.extend(outage.largest_sigma_before_enu_m.unwrap_or([f64::NAN; 3]).iter().map(|s| mm(*s)));
        table.row(&cells);
    }
    let html = table.html();
    if html.is_empty() { String::from("<p>GNSS is there throughout: no gap of more than 5 s.</p>\n") } else { html }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_the_peaks() {
        let values: Vec<(f64, f64)> = (0..10_000).map(|i| (f64::from(i), f64::from(u8::from(i == 4321)))).collect();
        let kept = thinned(&values);
        assert!(kept.len() <= MOST_POINTS && kept.contains(&(4321.0, 1.0)));
        assert!(kept.windows(2).all(|w| w[0].0 < w[1].0));
    }
}
