//! Innovations: how well each measurement fits what the filter expected, those of ties over time.

use crate::report::chart::{Band, Chart, Curve, Mark, Panel};
use crate::report::drive::data::{DriveCharts, DriveSummary, TieInnovation};
use crate::report::html::{Align, Table, bar, escape, section};
use crate::report::number::{count, fixed, length};
use crate::stage::drive::ties::Class;

const LEAD: &str = "Measured less expected, in units of what was to be expected: the mean of its square is 1 a component \
when the sigmas are right, less when they are cautious. Above 2 a measurement is worse than its sigma says. Of ties, second and later sightings have \
innovations, in the first run of the filter; those that the smoother left out in the end are marked. Where all lean to one side for seconds, the filter \
had drifted there and the ties told it so: the smoother has taken that up.";
/// Most dots of a panel, those left out apart.
const MOST_DOTS: usize = 900;
/// Beyond this many standard deviations a dot stands on the edge.
const EDGE: f64 = 6.0;
/// Stretches that the root mean square is taken over, and how many innovations make one; with fewer a class has no panel.
const STRETCHES: usize = 60;
const FEWEST: usize = 8;

/// Innovations: those of ties over time, and all by kind of measurement.
pub(crate) fn html(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let over_time = over_time(summary, charts);
    let by_kind = by_kind(summary);
    if over_time.is_empty() && by_kind.is_empty() {
        return String::new();
    }
    section("innovations", "Innovations", LEAD, &format!("{over_time}{by_kind}"))
}

fn by_kind(summary: &DriveSummary) -> String {
    let mut table = Table::new(
        "Innovations by kind of measurement",
        &[
            ("Measurement", "", Align::Text),
            ("Number", "", Align::Number),
            ("Mean square", "a component", Align::Number),
            ("Down-weighted", "", Align::Number),
            ("Left out", "", Align::Number),
            ("Share taken as it is", "", Align::Text),
        ],
    );
    for (kind, i) in &summary.trajectory.innovations {
        let whole = i.count.saturating_sub(i.down_weighted + i.left_out);
        let share = whole as f64 / i.count.max(1) as f64;
        table.row_of_html(
            "",
            &[
                escape(&in_words(kind)),
                count(i.count as u64),
                fixed(i.mean_nis_per_component, 2),
                count(i.down_weighted as u64),
                count(i.left_out as u64),
                bar(share, "quiet"),
            ],
        );
    }
    table.html()
}

fn in_words(kind: &str) -> String {
    let words = match kind {
        "position" => "GNSS position",
        "velocity" => "GNSS velocity",
        "constraint" => "vehicle neither slides nor jumps",
        "zero_velocity" => "at rest: no velocity",
        "zero_rotation" => "at rest: no rotation",
        "tie" => "tie, second and later sightings",
        other => return other.replace('_', " "),
    };
    String::from(words)
}

/// A panel for each class of ties.
fn over_time(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let start_s = charts.origin.time_s;
    let mut chart = Chart {
        label: String::from("Innovations of ties over time, by class"),
        axis: format!("time, s after {}", charts.origin.words(start_s, 0)),
        limits: (charts.span_s.0 - start_s, charts.span_s.1 - start_s),
        shaded: summary.trajectory.outages.iter().map(|o| (o.start_s - start_s, o.end_s - start_s)).collect(),
        ..Chart::default()
    };
    let (mut all, mut left_out) = (0, 0);
    for class in [Class::ScannerToScanner, Class::PassToPass, Class::StripToStrip] {
        let mine: Vec<&TieInnovation> =
            charts.innovations.iter().filter(|i| i.class == class && i.normalised.is_finite()).collect();
        if mine.len() < FEWEST {
            continue;
        }
        let (out, kept): (Vec<&TieInnovation>, Vec<&TieInnovation>) = mine.iter().partition(|i| i.left_out);
        all += mine.len();
        left_out += out.len();
        chart.panels.push(Panel {
            axis: String::from(class.as_str()),
            height: 110.0,
            limits: (-EDGE * 1.08, EDGE * 1.08),
            bands: spread(&kept, charts.span_s, start_s),
            curves: vec![dots("after", &kept, start_s), dots("held", &out, start_s)],
        });
    }
    chart.legend = vec![
        ("dot", "after", format!("{} innovations of ties; {MOST_DOTS} a class are drawn at most", length(all))),
        ("dot", "held", format!("{} left out in the end", length(left_out))),
        ("band", "after", String::from("± root mean square of the others over time")),
    ];
    if !chart.shaded.is_empty() {
        chart.legend.push(("shade", "", String::from("no GNSS")));
    }
    if chart.panels.is_empty() {
        return String::new();
    }
    format!(
        "<figure class=\"innovations\"><figcaption>Innovations of ties over time, in standard deviations</figcaption>\n{}<p class=\"note\">Dots \
         on the upper and lower edge lie beyond {EDGE:.0} standard deviations.</p></figure>\n",
        chart.html()
    )
}

/// Every so many innovations as dots, held at the edge.
fn dots(class: &'static str, of: &[&TieInnovation], start_s: f64) -> Curve {
    let step = of.len().div_ceil(MOST_DOTS).max(1);
    let dot = |i: &&TieInnovation| (i.time_s - start_s, i.normalised.clamp(-EDGE, EDGE));
    Curve { class, mark: Mark::Scatter, points: of.iter().step_by(step).map(dot).collect() }
}

/// The root mean square over stretches of time, either way of zero; a gap where there are too few to tell.
#[allow(clippy::cast_precision_loss)]
fn spread(of: &[&TieInnovation], (from_s, to_s): (f64, f64), start_s: f64) -> Vec<Band> {
    let width_s = (to_s - from_s) / STRETCHES as f64;
    let point = |k: usize| {
        let (low_s, high_s) = (from_s + width_s * k as f64, from_s + width_s * (k + 1) as f64);
        let mine: Vec<f64> =
            of.iter().filter(|i| i.time_s >= low_s && i.time_s < high_s).map(|i| i.normalised.powi(2)).collect();
        let rms = (mine.iter().sum::<f64>() / mine.len() as f64).sqrt();
        let rms = if mine.len() < FEWEST { f64::NAN } else { rms };
        (0.5 * (low_s + high_s) - start_s, -rms, rms)
    };
    vec![Band { class: "after", points: (0..STRETCHES).map(point).collect() }]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn charts() -> DriveCharts {
        let one = |k: i32| TieInnovation {
            class: if k % 3 == 0 { Class::StripToStrip } else { Class::ScannerToScanner },
            time_s: 0.01 * f64::from(k),
            normalised: if k == 600 { 40.0 } else { f64::from(k % 5) - 2.0 },
            left_out: k == 600,
        };
        DriveCharts { span_s: (0.0, 100.0), innovations: (0..10_000).map(one).collect(), ..DriveCharts::default() }
    }

    #[test]
    fn ties_left_out_are_marked_and_what_is_drawn_is_bounded() {
        let html = html(&DriveSummary::default(), &charts());
        for words in
            ["10\u{202f}000 innovations", "1 left out", "scanner to scanner", "strip to strip", "class=\"dots held\""]
        {
            assert!(html.contains(words), "{words}");
        }
        assert!(!html.contains("pass to pass") && !html.contains("NaN"));
        assert!(html.matches("h0").count() <= 2 * (MOST_DOTS + 1), "{}", html.matches("h0").count());
    }

    #[test]
    fn the_band_is_the_root_mean_square_where_there_are_enough() {
        let charts = charts();
        let mine: Vec<&TieInnovation> = charts.innovations.iter().filter(|i| !i.left_out).collect();
        let bands = spread(&mine, (0.0, 200.0), 0.0);
        let known: Vec<f64> = bands[0].points.iter().map(|p| p.2).filter(|v| v.is_finite()).collect();
        assert_eq!(known.len(), 30);
        assert!(known.iter().all(|v| (v - 2.0_f64.sqrt()).abs() < 0.01), "{known:?}");
    }
}
