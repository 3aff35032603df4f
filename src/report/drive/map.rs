//! The drive from above: its path, stretches without GNSS, and the ties by class.

use std::fmt::Write as _;

use crate::report::chart::legend;
use crate::report::drive::data::{DriveCharts, DriveSummary, PairPoint};
use crate::report::html::section;
use crate::report::number::{fixed, length, tick_step};
use crate::stage::drive::ties::Class;

const LEAD: &str = "North is up. Ties of all classes along the path; where a class is missing, nothing of its kind holds the \
trajectory there.";
/// Most dots, over all classes.
const MOST_DOTS: usize = 3000;
/// Most corners of the path.
const MOST_CORNERS: usize = 1500;
/// Longer side of the picture \[px\].
const SIZE: f64 = 900.0;
const MARGIN: f64 = 14.0;

/// The style of a class.
fn style(class: Class) -> &'static str {
    match class {
        Class::PassToPass => "third",
        Class::ScannerToScanner => "held",
        Class::StripToStrip => "after",
    }
}

/// From map coordinates to the picture.
struct Frame {
    west_m: f64,
    north_m: f64,
    scale: f64,
    width: f64,
    height: f64,
}

impl Frame {
    fn about(places: impl Iterator<Item = [f64; 2]>) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for place in places.filter(|p| p[0].is_finite() && p[1].is_finite()) {
            for k in 0..2 {
                low[k] = low[k].min(place[k]);
                high[k] = high[k].max(place[k]);
            }
        }
        let size_m = (high[0] - low[0]).max(high[1] - low[1]).max(1.0);
        let scale = (SIZE - 2.0 * MARGIN) / size_m;
        size_m.is_finite().then(|| Self {
            west_m: low[0],
            north_m: high[1],
            scale,
            width: (high[0] - low[0]).max(0.25 * size_m) * scale + 2.0 * MARGIN,
            height: (high[1] - low[1]).max(0.25 * size_m) * scale + 2.0 * MARGIN,
        })
    }

    fn place(&self, [east_m, north_m]: [f64; 2]) -> (f64, f64) {
        (MARGIN + (east_m - self.west_m) * self.scale, MARGIN + (self.north_m - north_m) * self.scale)
    }
}

/// The section; nothing without a path and ties.
pub(crate) fn html(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let places = charts.path.iter().map(|p| [p[1], p[2]]).chain(charts.pairs.iter().map(|p| p.east_north_m));
    let Some(frame) = Frame::about(places) else { return String::new() };
    let mut svg = format!(
        "<svg class=\"map chart\" viewBox=\"0 0 {:.0} {:.0}\" role=\"img\" aria-label=\"Map: ties by class and path\">\n",
        frame.width, frame.height
    );
    let mut entries = Vec::new();
    let whole: Vec<[f64; 2]> = thinned(&charts.path, MOST_CORNERS).map(|p| [p[1], p[2]]).collect();
    for outage in &summary.trajectory.outages {
        let inside: Vec<[f64; 3]> =
            charts.path.iter().filter(|p| p[0] >= outage.start_s && p[0] <= outage.end_s).copied().collect();
        let inside: Vec<[f64; 2]> = thinned(&inside, MOST_CORNERS).map(|p| [p[1], p[2]]).collect();
        let _ = writeln!(svg, "<path class=\"outage\" d=\"{}\"/>", path(&frame, &inside));
    }
    for class in [Class::ScannerToScanner, Class::StripToStrip, Class::PassToPass] {
        let pairs: Vec<&PairPoint> = charts.pairs.iter().filter(|p| p.class == class).collect();
        if pairs.is_empty() {
            continue;
        }
        let share = (MOST_DOTS * pairs.len()).div_ceil(charts.pairs.len()).clamp(1, MOST_DOTS);
        let mut dots = String::new();
        for pair in thinned(&pairs, share) {
            let (x, y) = frame.place(pair.east_north_m);
            if x.is_finite() && y.is_finite() {
                let _ = write!(dots, "M{x:.0} {y:.0}h0");
            }
        }
        let _ = writeln!(svg, "<path class=\"dots {}\" d=\"{dots}\"/>", style(class));
        entries.push(("dot", style(class), format!("{} ({})", class.as_str(), length(pairs.len()))));
    }
    let _ = writeln!(svg, "<path class=\"way\" d=\"{}\"/>\n</svg>", path(&frame, &whole));
    entries.push(("way", "", String::from("path")));
    if !summary.trajectory.outages.is_empty() {
        entries.push(("shade", "", String::from("path without GNSS")));
    }
    let width_m = frame.width / frame.scale;
    let bar_m = tick_step(width_m, 5.0);
    let body = format!(
        "<figure><div class=\"frame\" style=\"max-width:{:.0}vh\">{svg}<div class=\"scalebar\" style=\"width:{:.2}%\">{} m</div></div>\n{}\
         <p class=\"note\">East {} to {} m, north {} to {} m; at most {} pairs are drawn</p></figure>\n",
        (80.0 * frame.width / frame.height).max(30.0),
        100.0 * bar_m / width_m,
        fixed(bar_m, 0),
        legend(&entries),
        fixed(frame.west_m, 0),
        fixed(frame.west_m + (frame.width - 2.0 * MARGIN) / frame.scale, 0),
        fixed(frame.north_m - (frame.height - 2.0 * MARGIN) / frame.scale, 0),
        fixed(frame.north_m, 0),
        length(MOST_DOTS)
    );
    section("map", "Map", LEAD, &body)
}

/// Every so many items, evenly, so that no more than a number are left.
fn thinned<T>(items: &[T], most: usize) -> impl Iterator<Item = &T> {
    items.iter().step_by(items.len().div_ceil(most.max(1)).max(1))
}

fn path(frame: &Frame, places: &[[f64; 2]]) -> String {
    let mut path = String::new();
    for place in places {
        let (x, y) = frame.place(*place);
        if x.is_finite() && y.is_finite() {
            let _ = write!(path, "{}{x:.1} {y:.1}", if path.is_empty() { "M" } else { "L" });
        }
    }
    path
}
