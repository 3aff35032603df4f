//! Cross-sections of the cloud at the places that were worst, before and after.

use std::fmt::Write as _;

use crate::report::chart::{Chart, Curve, Mark, Panel};
use crate::report::drive::data::{DriveCharts, Origin};
use crate::report::html::{escape, section};
use crate::report::number::{counted, mm};
use crate::stage::drive::cut::{Between, Cut, CutPoint, HALF_LENGTH_M, scanners};
use crate::stage::drive::ties::VISIT_GAP_S;

const LEAD: &str = "The cloud cut at the places where sightings of one surface were furthest apart before: between visits, and between scanners. Each cut is 3 m long \
and 0.3 m thick, 0.6 m in height on walls; heights off the surface are drawn larger than lengths along it. Left the points as delivered, right the same points corrected. One colour is \
one visit, or one scanner: where the colours lie on each other, the cloud is of one piece.";
/// Dots of one colour.
const MOST_DOTS: usize = 350;
/// Colours; what is seen more often shares the last.
const COLOURS: [&str; 4] = ["after", "held", "third", "before"];
/// With fewer points dots are drawn larger.
const SPARSE: usize = 300;
/// With fewer points on either side there is nothing to compare.
const FEWEST: usize = 10;

/// The section; nothing where nothing was collected.
pub(crate) fn html(charts: &DriveCharts, cut_points: &[Vec<CutPoint>]) -> String {
    let mut body = String::new();
    for (cut, points) in charts.cuts.iter().zip(cut_points).filter(|(_, p)| p.len() >= FEWEST) {
        let groups = groups(cut, points);
        if groups.len() < 2 {
            continue;
        }
        let _ = write!(
            body,
            "<h3>{}</h3>\n<div class=\"figures cut{}\">\n{}{}</div>\n",
            escape(&title(cut, &charts.origin)),
            if points.len() < SPARSE { " sparse" } else { "" },
            figure(cut, &groups, &charts.origin, "Before", |p| p.before_m),
            figure(cut, &groups, &charts.origin, "After", |p| p.after_m)
        );
    }
    if body.is_empty() { body } else { section("cuts", "Cross-sections at the worst places", LEAD, &body) }
}

fn title(cut: &Cut, origin: &Origin) -> String {
    let what = match cut.between {
        Between::Visits => "Between visits",
        Between::Scanners => "Between scanners",
    };
    let surface = if cut.is_steep { "a wall" } else { "level ground" };
    let lines = counted(cut.lines, "tie", "ties");
    format!(
        "{what}: {surface}, {} mm before, {} mm after (median of {lines}), {}",
        mm(cut.difference_m.0),
        mm(cut.difference_m.1),
        origin.words(cut.time_s.0, 0)
    )
}

/// Points of one visit or one scanner, with words for it.
type Group<'a> = (String, Vec<&'a CutPoint>);

fn groups<'a>(cut: &Cut, points: &'a [CutPoint]) -> Vec<Group<'a>> {
    match cut.between {
        Between::Scanners => {
            // of the visit that the line in the middle was seen in
            let near = |p: &&CutPoint| (p.time_s - cut.time_s.0).abs() <= VISIT_GAP_S;
            let of = |scanner: u16| -> Vec<&CutPoint> {
                points.iter().filter(near).filter(|p| p.scanner == scanner).collect()
            };
            scanners(points).into_iter().map(|s| (format!("scanner {s}"), of(s))).filter(|g| enough(&g.1)).collect()
        }
        Between::Visits => {
            let visits = points.chunk_by(|a, b| b.time_s - a.time_s <= VISIT_GAP_S);
            let visits = visits.map(|v| v.iter().collect::<Vec<_>>()).filter(|v| enough(v));
            visits.enumerate().map(|(k, v)| (format!("visit {}", k + 1), v)).collect()
        }
    }
}

fn enough(points: &[&CutPoint]) -> bool {
    points.iter().filter(|p| p.before_m.is_some()).count() >= FEWEST
        && points.iter().filter(|p| p.after_m.is_some()).count() >= FEWEST
}

fn figure(
    cut: &Cut,
    groups: &[Group<'_>],
    origin: &Origin,
    when: &str,
    place: fn(&CutPoint) -> Option<[f32; 2]>,
) -> String {
    let half_mm = cut.half_off_m * 1e3;
    let curve = |(k, (_, points)): (usize, &Group<'_>)| {
        let there: Vec<(f64, f64)> =
            points.iter().filter_map(|p| place(p)).map(|[x, y]| (f64::from(x), f64::from(y) * 1e3)).collect();
        let step = there.len().div_ceil(MOST_DOTS).max(1);
        Curve { class: colour(k), mark: Mark::Scatter, points: there.into_iter().step_by(step).collect() }
    };
    let (along, off) = if cut.is_steep {
        ("along the wall, m", "towards the vehicle, mm")
    } else {
        ("across the way, m (right above zero)", "height, mm")
    };
    let legend = |(k, (words, points)): (usize, &Group<'_>)| {
        let second = points.first().map_or(f64::NAN, |p| origin.second_of(p.time_s));
        ("dot", colour(k), format!("{words}, second {second:.0}"))
    };
    let chart = Chart {
        label: format!("Cross-section, {}: {}", when.to_lowercase(), title(cut, origin)),
        axis: String::from(along),
        limits: (-HALF_LENGTH_M, HALF_LENGTH_M),
        shaded: Vec::new(),
        panels: vec![Panel {
            axis: String::from(off),
            height: 190.0,
            limits: (-half_mm, half_mm),
            bands: Vec::new(),
            curves: groups.iter().enumerate().map(curve).collect(),
        }],
        legend: groups.iter().enumerate().map(legend).collect(),
    };
    format!("<figure><figcaption>{when}</figcaption>\n{}</figure>\n", chart.html())
}

fn colour(group: usize) -> &'static str {
    COLOURS[group.min(COLOURS.len() - 1)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn charts(between: Between) -> DriveCharts {
        let cut = Cut {
            between,
            before_m: Vector3::zeros(),
            after_m: Vector3::zeros(),
            along: Vector3::x(),
            normal: Vector3::z(),
            half_off_m: 0.2,
            half_thickness_m: 0.1,
            lines: 7,
            difference_m: (0.08, 0.002),
            is_steep: false,
            time_s: (10.0, 70.0),
        };
        DriveCharts { cuts: vec![cut], ..DriveCharts::default() }
    }

    fn points() -> Vec<CutPoint> {
        let point = |k: u16| CutPoint {
            time_s: if k < 1000 { 10.0 } else { 70.0 } + f64::from(k % 1000) * 1e-3,
            scanner: k % 2,
            before_m: Some([f32::from(k % 1000) * 0.002 - 1.0, if k < 1000 { -0.04 } else { 0.04 }]),
            after_m: Some([f32::from(k % 1000) * 0.002 - 1.0, 0.0]),
        };
        (0..2000).map(point).collect()
    }

    #[test]
    fn visits_and_scanners_have_their_colours_before_and_after() {
        let html = super::html(&charts(Between::Visits), &[points()]);
        for words in ["80.0 mm before, 2.0 mm after", "median of 7 ties", "visit 1, second 10", "visit 2, second 70"] {
            assert!(html.contains(words), "{words}: {}", &html[..2000]);
        }
        assert_eq!(html.matches("<figure>").count(), 2);
        assert!(html.matches("h0").count() <= 4 * (MOST_DOTS + 1) && html.matches("h0").count() >= 4 * 200);
        let html = super::html(&charts(Between::Scanners), &[points()]);
        assert!(html.contains("scanner 0, second") && html.contains("scanner 1, second") && !html.contains("visit 1"));
    }

    #[test]
    fn without_points_of_two_there_is_no_section() {
        assert!(html(&charts(Between::Visits), &[points()[..900].to_vec()]).is_empty());
        assert!(html(&charts(Between::Visits), &[]).is_empty());
    }
}
