//! What depends on the range: bias of the scanners, and differences of sightings before and after.

use std::fmt::Write as _;

use crate::report::chart::{Band, Chart, Curve, Mark, Panel};
use crate::report::data::Discrepancy;
use crate::report::drive::curves::{CurveSummary, OverCurveSummary};
use crate::report::drive::data::{DifferenceOver, DriveSummary, PairPoint};
use crate::report::html::{Align, Table, section};
use crate::report::number::{mm, round_up};
use crate::stage::drive::over::Over;
use crate::stage::drive::ties::Class;

const BIAS_LEAD: &str = "Measured less true range of each scanner, with twice its standard deviation either way. It is taken off \
every point. A constant that all ranges have in common cannot be told from the lever arm or the height; it is held near nothing.";
const FIT_LEAD: &str = "Each value is the median of pairs of sightings of like range, of ties that the solution may use and of those held \
out of it apart; the band is the robust standard deviation about it. Differences count towards the vehicle: scanner to scanner is the higher scanner number \
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
    for curve in &summary.calibration.range_bias_over {
        let chart = over_chart(curve);
        if !chart.is_empty() {
            let (scanner, over) = (curve.scanner, &curve.over);
            let _ = write!(body, "<figure><figcaption>Scanner {scanner}, over {over}</figcaption>\n{chart}</figure>\n");
        }
    }
    if body.is_empty() {
        return String::new();
    }
    section("bias", "Range bias", BIAS_LEAD, &format!("<div class=\"figures\">\n{body}</div>\n"))
}

fn bias_chart(curve: &CurveSummary, limit_mm: f64, farthest_m: f64) -> String {
    let label = format!("Range bias of scanner {} over range", curve.scanner);
    let of = (curve.range_m.as_slice(), curve.bias_m.as_slice(), curve.sigma_m.as_slice());
    curve_chart(label, "range, m", (0.0, farthest_m * 1.02), limit_mm, of)
}

/// Bias over incidence, or over the logarithm of the intensity.
fn over_chart(curve: &OverCurveSummary) -> String {
    let is_incidence = curve.over == Over::Incidence.as_str();
    let at: Vec<f64> = curve.at.iter().map(|at| if is_incidence { *at } else { at.log10() }).collect();
    let (Some(first), Some(last)) = (at.first(), at.last()) else { return String::new() };
    let axis = if is_incidence { "incidence, deg" } else { "log10 of intensity" };
    let limits = if is_incidence { (0.0, 90.0) } else { (*first, *last) };
    let largest = curve.bias_m.iter().zip(&curve.sigma_m).map(|(b, s)| b.abs() + 2.0 * s).filter(|v| v.is_finite());
    let limit_mm = round_up(largest.fold(1e-3, f64::max) * 1e3);
    let label = format!("Range bias of scanner {} over {}", curve.scanner, curve.over);
    curve_chart(label, axis, limits, limit_mm, (&at, &curve.bias_m, &curve.sigma_m))
}

/// A curve of a bias \[m\] with its standard deviation \[m\].
fn curve_chart(
    label: String,
    axis: &str,
    limits: (f64, f64),
    limit_mm: f64,
    (at, bias_m, sigma_m): (&[f64], &[f64], &[f64]),
) -> String {
    let rows = || at.iter().zip(bias_m.iter().zip(sigma_m));
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
        label,
        axis: String::from(axis),
        limits,
        shaded: Vec::new(),
        panels: vec![panel],
        legend: legend.map(|(shape, words)| (shape, "after", String::from(words))).into(),
    }
    .html()
}

/// What differences are binned over: name, axis, value of a pair \[m\].
type Binned = (&'static str, &'static str, fn(&PairPoint) -> f64);
const OVER: [Binned; 2] = [
    ("range", "range, m", |p| p.range_m),
    ("lateral distance", "lateral distance, m (right of the vehicle above zero)", |p| p.lateral_m),
];

/// Differences of pairs over range and lateral distance, by class, of used ties and of those held out.
pub(crate) fn differences(pairs: &[PairPoint]) -> Vec<DifferenceOver> {
    let mut all = Vec::new();
    for class in [Class::ScannerToScanner, Class::PassToPass, Class::StripToStrip] {
        for (over, _, x) in OVER {
            for held_out in [false, true] {
                let mine: Vec<&PairPoint> =
                    pairs.iter().filter(|p| p.class == class && p.held_out == held_out).collect();
                let bins = bins(&mine, x);
                if !bins.is_empty() {
                    all.push(DifferenceOver {
                        class: String::from(class.as_str()),
                        over: String::from(over),
                        held_out,
                        at_m: bins.iter().map(|b| b.0).collect(),
                        before: bins.iter().map(|b| b.1).collect(),
                        after: bins.iter().map(|b| b.2).collect(),
                    });
                }
            }
        }
    }
    all
}

/// Differences over range and lateral distance.
pub(crate) fn fit(summary: &DriveSummary) -> String {
    let find = |class: &str, over: &str, held_out: bool| {
        let all = &summary.difference_over;
        all.iter().find(|d| d.class == class && d.over == over && d.held_out == held_out)
    };
    let mut body = String::new();
    let mut table = Table::new(
        "Largest median of a bin, of ties used and of those held out",
        &[
            ("Class", "", Align::Text),
            ("Over", "", Align::Text),
            ("Before", "mm", Align::Number),
            ("After", "mm", Align::Number),
            ("Before", "mm", Align::Number),
            ("After", "mm", Align::Number),
        ],
    )
    .groups(&[("", 2), ("Used", 2), ("Held out", 2)]);
    for class in [Class::ScannerToScanner, Class::PassToPass, Class::StripToStrip] {
        let name = class.as_str();
        let title = format!("{}{}", name[..1].to_uppercase(), &name[1..]);
        for (over, axis, _) in OVER {
            let Some(used) = find(name, over, false).filter(|d| d.at_m.len() > 1) else { continue };
            let held = find(name, over, true);
            let chart = binned_chart(used, held, axis);
            if !chart.is_empty() {
                let _ = write!(body, "<figure><figcaption>{title}, over {over}</figcaption>\n{chart}</figure>\n");
            }
            let worst = |bins: Option<&Vec<Discrepancy>>| {
                mm(bins.into_iter().flatten().map(|d| d.median_m.abs()).fold(f64::NAN, f64::max))
            };
            let of_held = [worst(held.map(|d| &d.before)), worst(held.map(|d| &d.after))];
            let [held_before, held_after] = of_held;
            table.row(&[
                title.clone(),
                String::from(over),
                worst(Some(&used.before)),
                worst(Some(&used.after)),
                held_before,
                held_after,
            ]);
        }
    }
    if body.is_empty() {
        return String::new();
    }
    let body = format!("<div class=\"figures\">\n{body}</div>\n{}", table.html());
    section("ranges", "Differences over range", FIT_LEAD, &body)
}

/// Statistics of pairs in bins by x: middle, before, after. Bins are as wide as it takes to hold enough pairs, and not much wider, be
/// pairs dense or rare.
fn bins(pairs: &[&PairPoint], x: fn(&PairPoint) -> f64) -> Vec<(f64, Discrepancy, Discrepancy)> {
    let mut rows: Vec<[f64; 3]> = pairs.iter().map(|p| [x(p), p.difference_m.0, p.difference_m.1]).collect();
    rows.retain(|r| r.iter().all(|v| v.is_finite()));
    rows.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2])));
    // the outermost half per cent is too wide a bin
    let rows = &rows[rows.len() / 200..rows.len() - rows.len() / 200];
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return Vec::new() };
    let (most, widest) = (rows.len() / MOST_BINS, (last[0] - first[0]) / MOST_BINS as f64);
    let mut bins = Vec::new();
    let mut from = 0;
    for to in 1..=rows.len() {
        let group = &rows[from..to];
        let full = group.len() >= most || group[group.len() - 1][0] - group[0][0] >= widest;
        if full && group.len() >= LEAST_PAIRS {
            let of = |k: usize| Discrepancy::of(&group.iter().map(|r| r[k]).collect::<Vec<_>>());
            bins.push((group[group.len() / 2][0], of(1), of(2)));
            from = to;
        }
    }
    bins
}

fn binned_chart(used: &DifferenceOver, held: Option<&DifferenceOver>, axis: &str) -> String {
    let held = held.filter(|h| h.at_m.len() > 1);
    // the left and right of lines that hardly anything lies beyond
    let (first, last) = (used.at_m[0], used.at_m[used.at_m.len() - 1]);
    let spare = 0.03 * (last - first).max(0.1);
    let band = |class: &'static str, bins: &[Discrepancy]| {
        let around =
            |(x, d): (&f64, &Discrepancy)| (*x, (d.median_m - d.sigma_mad_m) * 1e3, (d.median_m + d.sigma_mad_m) * 1e3);
        Band { class, points: used.at_m.iter().zip(bins).map(around).collect() }
    };
    let dots = |class, of: &DifferenceOver, bins: &[Discrepancy]| {
        let points = of.at_m.iter().zip(bins).map(|(x, d)| (*x, d.median_m * 1e3)).collect();
        Curve { class, mark: Mark::Dots, points }
    };
    // what was before may be much larger: what is left gets a panel of its own, at its own scale
    let panel = |words: &str, class: &'static str, of: fn(&DifferenceOver) -> &Vec<Discrepancy>| Panel {
        axis: format!("{words}, mm"),
        height: 110.0,
        bands: vec![band(class, of(used))],
        curves: std::iter::once(dots(class, used, of(used)))
            .chain(held.map(|held| dots("held", held, of(held))))
            .collect(),
        ..Panel::default()
    };
    let panels = vec![panel("before", "before", |d| &d.before), panel("after", "after", |d| &d.after)];
    let pairs = |of: &DifferenceOver| of.after.iter().map(|d| d.n).sum::<usize>();
    let mut legend = vec![
        ("dot", "before", format!("used, before: {} pairs", pairs(used))),
        ("dot", "after", String::from("used, after")),
        ("band", "after", String::from("± robust sd")),
    ];
    if let Some(held) = held {
        legend.push(("dot", "held", format!("held out, before and after: {} pairs", pairs(held))));
    }
    Chart {
        label: format!("Difference of sightings, {}, over {}, before and after", used.class, used.over),
        axis: String::from(axis),
        limits: (first - spare, last + spare),
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
        let found = bins(&pairs.iter().collect::<Vec<_>>(), |p| p.range_m);
        assert!((MOST_BINS - 1..=2 * MOST_BINS).contains(&found.len()), "{}", found.len());
        assert!(found.iter().all(|b| b.1.n >= LEAST_PAIRS));
        assert!(found.windows(2).all(|w| w[0].0 < w[1].0 && w[0].2.median_m <= w[1].2.median_m));
        assert!(bins(&[], |p| p.range_m).is_empty());
    }

    #[test]
    fn held_out_pairs_have_bins_of_their_own() {
        let pair = |i: i32| PairPoint {
            class: if i % 2 == 0 { Class::ScannerToScanner } else { Class::StripToStrip },
            east_north_m: [0.0; 2],
            // those held out are 7 mm apart before and 1 mm after, the others 5 mm and nothing
            difference_m: if i % 5 == 0 { (0.007, 0.001) } else { (0.005, 0.0) },
            range_m: f64::from(i % 97) * 0.3,
            lateral_m: f64::from(i % 89) - 44.0,
            held_out: i % 5 == 0,
        };
        let pairs: Vec<PairPoint> = (0..4000).map(pair).collect();
        let found = differences(&pairs);
        assert_eq!(found.len(), 8, "two classes, over two things, used and held out");
        for d in &found {
            let expected = if d.held_out { (0.007, 0.001) } else { (0.005, 0.0) };
            let medians = d.before.iter().zip(&d.after).map(|(b, a)| (b.median_m, a.median_m));
            assert!(medians.clone().count() > 5 && medians.clone().all(|m| m == expected), "{d:?}");
        }
        let summary = DriveSummary { difference_over: found, ..DriveSummary::default() };
        let html = fit(&summary);
        for words in ["over range", "over lateral distance", "held out, before and after", "7.0", "5.0", "1.0"] {
            assert!(html.contains(words), "{words}: {html}");
        }
    }
}
