//! What depends on the range: bias of the scanners, and differences of sightings before and after.

use std::fmt::Write as _;

use crate::report::chart::{Band, Chart, Curve, Mark, Panel};
use crate::report::data::Discrepancy;
use crate::report::drive::data::{CurveSummary, DriveCharts, DriveSummary, PairPoint};
use crate::report::html::section;
use crate::report::number::round_up;
use crate::stage::drive::ties::Class;

const BIAS_LEAD: &str = "Measured less true range of each scanner, with twice its standard deviation either way. It is taken off \
every point. A constant that all ranges have in common cannot be told from the lever arm or the height; it is held near nothing.";
const FIT_LEAD: &str = "Each value is the median of pairs of sightings of like range, used and held out together; the band is the \
robust standard deviation about it. Differences count towards the vehicle: scanner to scanner is the higher scanner number \
less the lower within a visit, pass to pass and strip to strip the last sighting less the first. Without bias the line is flat at \
zero, and pairs that took no part lie on the line of the others.";
/// Bins are as wide as this share of the whole, or hold this share of the pairs, and this many at least.
const MOST_BINS: usize = 20;
const LEAST_PAIRS: usize = 12;

/// Range bias of the scanners.
pub(crate) fn bias(summary: &DriveSummary) -> String {
    let curves = &summary.calibration.range_bias;
    let largest = curves.iter().flat_map(|c| c.bias_m.iter().zip(&c.sigma_m)).map(|(b, s)| b.abs() + 2.0 * s);
    let largest_m = largest.filter(|v| v.is_finite()).fold(1e-3, f64::max);
    let limit = round_up(largest_m * 1e3);
    let farthest = curves.iter().flat_map(|c| c.range_m.last()).copied().fold(0.0, f64::max);
    let mut body = String::new();
    for curve in curves {
        let chart = bias_chart(curve, limit, farthest);
        if !chart.is_empty() {
            let _ = write!(body, "<figure><figcaption>Scanner {}</figcaption>\n{chart}</figure>\n", curve.scanner);
        }
    }
    if body.is_empty() {
        return String::new();
    }
    section("bias", "Range bias", BIAS_LEAD, &format!("<div class=\"figures\">\n{body}</div>\n"))
}

fn bias_chart(curve: &CurveSummary, limit_mm: f64, farthest_m: f64) -> String {
    let rows = || curve.range_m.iter().zip(curve.bias_m.iter().zip(&curve.sigma_m));
    let band = rows().map(|(r, (b, s))| (*r, (b - 2.0 * s) * 1e3, (b + 2.0 * s) * 1e3)).collect();
    let line = rows().map(|(r, (b, _))| (*r, b * 1e3)).collect();
    let panel = Panel {
        axis: String::from("bias, mm"),
        height: 180.0,
        limits: (-limit_mm, limit_mm),
        bands: vec![Band { class: "after", points: band }],
        curves: vec![Curve { class: "after", mark: Mark::Line, points: line }],
    };
    let legend = [("line", "measured less true"), ("band", "± 2 sigma")];
    Chart {
        label: format!("Range bias of scanner {} over range", curve.scanner),
        axis: String::from("range, m"),
        limits: (0.0, farthest_m * 1.02),
        shaded: Vec::new(),
        panels: vec![panel],
        legend: legend.map(|(shape, words)| (shape, "after", String::from(words))).into(),
    }
    .html()
}

/// Differences over range and lateral distance.
pub(crate) fn fit(charts: &DriveCharts) -> String {
    let mut body = String::new();
    for class in [Class::ScannerToScanner, Class::PassToPass, Class::StripToStrip] {
        let pairs: Vec<&PairPoint> = charts.pairs.iter().filter(|p| p.class == class).collect();
        for (over, axis, x) in [
            ("range", "range, m", (|p: &PairPoint| p.range_m) as fn(&PairPoint) -> f64),
            ("lateral distance", "lateral distance, m (right of the vehicle above zero)", |p| p.lateral_m),
        ] {
            let chart = binned_chart(&pairs, class, over, axis, x);
            if !chart.is_empty() {
                let name = class.as_str();
                let caption = format!("{}{}, over {over}", name[..1].to_uppercase(), &name[1..]);
                let _ = write!(body, "<figure><figcaption>{caption}</figcaption>\n{chart}</figure>\n");
            }
        }
    }
    if body.is_empty() {
        return String::new();
    }
    section("ranges", "Differences over range", FIT_LEAD, &format!("<div class=\"figures\">\n{body}</div>\n"))
}

/// Statistics of pairs in bins by x: middle, statistics. Bins are as wide as it takes to hold enough pairs, and not much wider, be
/// pairs dense or rare.
fn bins(pairs: &[&PairPoint], x: fn(&PairPoint) -> f64, value: fn(&PairPoint) -> f64) -> Vec<(f64, Discrepancy)> {
    let mut rows: Vec<(f64, f64)> = pairs.iter().map(|p| (x(p), value(p))).collect();
    rows.retain(|r| r.0.is_finite() && r.1.is_finite());
    rows.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    // the outermost half per cent is too wide a bin
    let rows = &rows[rows.len() / 200..rows.len() - rows.len() / 200];
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return Vec::new() };
    let (most, widest) = (rows.len() / MOST_BINS, (last.0 - first.0) / MOST_BINS as f64);
    let mut bins = Vec::new();
    let mut from = 0;
    for to in 1..=rows.len() {
        let group = &rows[from..to];
        let full = group.len() >= most || group[group.len() - 1].0 - group[0].0 >= widest;
        if full && group.len() >= LEAST_PAIRS {
            bins.push((group[group.len() / 2].0, Discrepancy::of(&group.iter().map(|r| r.1).collect::<Vec<_>>())));
            from = to;
        }
    }
    bins
}

fn binned_chart(pairs: &[&PairPoint], class: Class, over: &str, axis: &str, x: fn(&PairPoint) -> f64) -> String {
    let held: Vec<&PairPoint> = pairs.iter().filter(|p| p.held_out).copied().collect();
    let before = bins(pairs, x, |p| p.difference_m.0);
    let after = bins(pairs, x, |p| p.difference_m.1);
    let held_after = bins(&held, x, |p| p.difference_m.1);
    if before.len() < 2 {
        return String::new();
    }
    // the left and right of lines that hardly anything lies beyond
    let x_span = (before[0].0, before[before.len() - 1].0);
    let spare = 0.03 * (x_span.1 - x_span.0).max(0.1);
    let points = |bins: &[(f64, Discrepancy)]| bins.iter().map(|(x, d)| (*x, d.median_m * 1e3)).collect();
    let band = |class: &'static str, bins: &[(f64, Discrepancy)]| {
        let around =
            |(x, d): &(f64, Discrepancy)| (*x, (d.median_m - d.sigma_mad_m) * 1e3, (d.median_m + d.sigma_mad_m) * 1e3);
        Band { class, points: bins.iter().map(around).collect() }
    };
    let dots = |class, bins: &[(f64, Discrepancy)]| Curve { class, mark: Mark::Dots, points: points(bins) };
    // what was before may be much larger: what is left gets a panel of its own, at its own scale
    let mut lines = vec![dots("after", &after)];
    if held_after.len() > 1 {
        lines.push(dots("held", &held_after));
    }
    let panels = vec![
        Panel {
            axis: String::from("before, mm"),
            height: 110.0,
            bands: vec![band("before", &before)],
            curves: vec![dots("before", &before)],
            ..Panel::default()
        },
        Panel {
            axis: String::from("after, mm"),
            height: 110.0,
            bands: vec![band("after", &after)],
            curves: lines,
            ..Panel::default()
        },
    ];
    let mut legend = vec![
        ("dot", "before", format!("before, {} pairs", pairs.len())),
        ("dot", "after", String::from("after")),
        ("band", "after", String::from("± robust sd")),
    ];
    if held_after.len() > 1 {
        legend.push(("dot", "held", format!("after, the {} held out", held.len())));
    }
    Chart {
        label: format!("Difference of sightings, {}, over {over}, before and after", class.as_str()),
        axis: String::from(axis),
        limits: (x_span.0 - spare, x_span.1 + spare),
        shaded: Vec::new(),
        panels,
        legend,
    }
    .html()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_hold_like_numbers_and_nothing_unknown() {
        let pair = |i: i32| PairPoint {
            class: Class::PassToPass,
            east_north_m: [0.0; 2],
            difference_m: (0.0, if i % 10 == 0 { f64::NAN } else { 0.001 * f64::from(i / 50) }),
            range_m: f64::from(i) * 0.1,
            lateral_m: 0.0,
            held_out: false,
        };
        let pairs: Vec<PairPoint> = (0..1000).map(pair).collect();
        let found = bins(&pairs.iter().collect::<Vec<_>>(), |p| p.range_m, |p| p.difference_m.1);
        assert!((MOST_BINS - 1..=2 * MOST_BINS).contains(&found.len()), "{}", found.len());
        assert!(found.iter().all(|b| b.1.n >= LEAST_PAIRS));
        assert!(found.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1.median_m <= w[1].1.median_m));
        assert!(bins(&[], |p| p.range_m, |p| p.range_m).is_empty());
    }
}
