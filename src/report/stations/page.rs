//! The page of a calibration of stations.

use std::fmt::Write as _;

use crate::report::chart::{Chart, Curve, Mark, Panel};
use crate::report::data::{Discrepancy, Summary};
use crate::report::findings::{Check, Grade};
use crate::report::html::{Align, Table, bar, escape, list, section};
use crate::report::number::{count, counted, decimals_for, fixed, length, mm, signed, signed_mm};
use crate::report::page::frame;
use crate::report::plot::{Series, histogram};
use crate::report::section::headline::{remarks, tile};
use crate::report::section::record;
use crate::report::section::ties::{reach, rejections};
use crate::report::stations::StationsReport;
use crate::report::stations::data::StationsSummary;
use crate::stage::stations::pairs::{Fate, Slope};
use crate::stage::stations::solve::SolvedPlane;

const LEAD: &str = "A common plane is a piece of surface that two scanners saw at one station. Its distance is taken along the \
common normal at the middle of what both footprints cover, nowhere else. A fifth, whole squares of 5 m (ground) or 10 m (what \
stands), was chosen before the adjustment and took no part. Nothing is taken out of these numbers.";
const UNKNOWN_LEAD: &str = "Corrections of the rough mounting against the reference scanner, about and along the axes of the \
vehicle: forward, right, down. Seen is the share of a value that the planes tell; the rest is the rough value.";
const DIRECTION_LEAD: &str = "The six unknowns of a scanner are not seen one by one but in combinations; members are in units of \
their sigma beforehand. A combination is weak when one sigma of it shifts a point 20 m away by more than 30 mm.";

/// Fewer distances have no robust sd.
const LEAST_FOR_SD: usize = 3;

/// The report as one HTML page.
pub(crate) fn render(summary: &StationsSummary, report: &StationsReport<'_>) -> String {
    let shared = Summary {
        inputs: summary.inputs.clone(),
        settings: summary.settings.clone(),
        notes: summary.notes.clone(),
        timing: summary.timing.clone(),
        peak_memory_bytes: summary.peak_memory_bytes,
        ..Summary::default()
    };
    let sections = [
        fit(summary, &report.solution.planes),
        ranges(&report.solution.planes),
        unknowns(summary),
        directions(summary),
        stations(summary),
        record::remarks(&shared),
        record::settings(&shared),
        record::files(&shared),
        record::times(&shared),
    ];
    frame(&format!("{} – calibration report", summary.name), &headline(summary), &sections)
}

fn both(d: &Discrepancy) -> String {
    format!("{} mm (robust sd; rms {} mm)", mm(d.sigma_mad_m), mm(d.rms_m))
}

fn headline(summary: &StationsSummary) -> String {
    let d = &summary.discrepancy;
    let points: u64 = summary.inputs.iter().map(|i| i.1).sum();
    let facts = [
        counted(summary.stations.len(), "station", "stations"),
        counted(summary.scanners.len(), "scanner", "scanners"),
        format!("{} points", count(points)),
        format!("tieline {}", summary.version),
    ];
    let facts: String = facts.iter().map(|f| format!("<span>{}</span>", escape(f))).collect();
    let mut out = format!(
        "<header>\n<p class=\"kind\">Calibration report</p>\n<h1>{}</h1>\n<p class=\"facts\">{facts}</p>\n",
        escape(&summary.name)
    );
    let _ = writeln!(
        out,
        "<p class=\"first\">Planes that two scanners have in common lay {} apart by the rough mounting and lie {} apart by the \
         calibrated one, {} planes.</p>\n<p>Planes that took no part: {} before, {} after, {} planes.</p>",
        both(&d.before),
        both(&d.after),
        length(d.after.n),
        both(&d.held_out_before),
        both(&d.held_out_after),
        length(d.held_out_after.n)
    );
    out.push_str("<div class=\"tiles\">\n");
    out += &tile(
        "Held out, robust sd",
        Some(mm(d.held_out_before.sigma_mad_m)),
        Some(mm(d.held_out_after.sigma_mad_m)),
        "mm",
        &counted(d.held_out_after.n, "plane", "planes"),
    );
    for kind in [Slope::Level, Slope::Steep] {
        if let Some(group) = summary.groups.iter().find(|g| g.pair.is_empty() && g.kind == kind.as_str()) {
            let d = &group.discrepancy;
            out += &tile(
                &format!("Held out, {}", kind.as_str()),
                Some(mm(d.held_out_before.sigma_mad_m)),
                Some(mm(d.held_out_after.sigma_mad_m)),
                "mm",
                &counted(d.held_out_after.n, "plane", "planes"),
            );
        }
    }
    out.push_str("</div>\n");
    let c = &summary.calibration;
    let mut checks = Vec::new();
    if c.station_misfit.is_finite() {
        checks.push(Check::good_if(
            c.station_factor <= 1.0,
            format!("Stations differ by {} times what their sigmas say.", fixed(c.station_misfit, 2)),
        ));
    }
    checks.extend(c.not_seen.iter().map(|words| {
        let mut text = words.clone();
        text[..1].make_ascii_uppercase();
        Check::new(Grade::Remark, text)
    }));
    out += &remarks(&checks);
    out.push_str("</header>\n");
    out
}

fn values(planes: &[SolvedPlane], fates: &[Fate], of: fn(&SolvedPlane) -> f64) -> Vec<f64> {
    planes.iter().filter(|p| fates.contains(&p.plane.fate)).map(of).filter(|v| v.is_finite()).collect()
}

fn fit(summary: &StationsSummary, planes: &[SolvedPlane]) -> String {
    let all = [Fate::Used, Fate::HeldOut];
    let (before, after) = (values(planes, &all, |p| p.before_m), values(planes, &all, |p| p.after_m));
    let (used, held) = (values(planes, &[Fate::Used], |p| p.after_m), values(planes, &[Fate::HeldOut], |p| p.after_m));
    let series = |name, class, values_m, filled| Series { name, class, values_m, filled };
    let charts = [
        (
            "Before and after",
            histogram(
                "Histogram of distances before and after",
                reach(&before, 0.97),
                &[series("before", "before", &before, true), series("after", "after", &after, true)],
            ),
        ),
        (
            "After: planes used against those held out",
            histogram(
                "Histogram of distances after, used and held out",
                reach(&after, 0.97),
                &[series("used", "after", &used, true), series("held out", "held", &held, false)],
            ),
        ),
    ];
    let mut body = String::from("<div class=\"figures\">\n");
    for (caption, chart) in charts.iter().filter(|c| !c.1.is_empty()) {
        let _ = write!(body, "<figure><figcaption>{caption}</figcaption>\n{chart}</figure>\n");
    }
    body.push_str("</div>\n");
    let stage = [
        ("n", "", Align::Number),
        ("before", "mm", Align::Number),
        ("after", "mm", Align::Number),
        ("median after", "mm", Align::Number),
    ];
    let mut columns = vec![("Scanners", "", Align::Text), ("Planes", "", Align::Text)];
    columns.extend(stage);
    columns.extend(stage);
    let mut table =
        Table::new("Distances of common planes, robust sd", &columns).groups(&[("", 2), ("Used", 4), ("Held out", 4)]);
    let name = |text: &str| if text.is_empty() { String::from("all") } else { text.to_string() };
    let rows = std::iter::once((String::from("all"), String::from("all"), &summary.discrepancy))
        .chain(summary.groups.iter().map(|g| (name(&g.pair), name(&g.kind), &g.discrepancy)));
    for (pair, kind, d) in rows {
        let mut cells = vec![pair, kind];
        for (before, after) in [(&d.before, &d.after), (&d.held_out_before, &d.held_out_after)] {
            let known = |v: f64| if after.n < LEAST_FOR_SD { f64::NAN } else { v };
            cells.extend([
                length(after.n),
                mm(known(before.sigma_mad_m)),
                mm(known(after.sigma_mad_m)),
                signed_mm(known(after.median_m)),
            ]);
        }
        table.row(&cells);
    }
    body += &table.html();
    let _ = writeln!(
        body,
        "<p class=\"note\">{} planes lie on the border of a held-out square: they took no part and are in no number here. The outlier test took \
         {} out of the adjustment; what it took out is in these numbers.</p>",
        count(summary.mixed),
        counted(summary.calibration.outliers, "plane", "planes")
    );
    body += &rejections(&summary.rejected);
    section("ties", "How well the planes agree", LEAD, &body)
}

/// Distances over the distance from the vehicle, before and after.
fn ranges(planes: &[SolvedPlane]) -> String {
    let mut body = String::from("<div class=\"figures\">\n");
    for slope in [Slope::Level, Slope::Steep] {
        let far_m = planes.iter().filter(|p| p.plane.slope == slope).map(|p| p.point_m.norm()).fold(1.0, f64::max);
        let dots = |fate: Fate, class, of: fn(&SolvedPlane) -> f64| Curve {
            class,
            mark: Mark::Scatter,
            points: planes
                .iter()
                .filter(|p| p.plane.slope == slope && p.plane.fate == fate)
                .map(|p| (p.point_m.norm(), 1e3 * of(p)))
                .collect(),
        };
        let panel = |axis: &str, of: fn(&SolvedPlane) -> f64, limits| Panel {
            axis: axis.to_string(),
            height: 130.0,
            limits,
            bands: Vec::new(),
            curves: vec![dots(Fate::Used, "after", of), dots(Fate::HeldOut, "held", of)],
        };
        let chart = Chart {
            label: format!("Distances of common planes over range: {}", slope.as_str()),
            axis: String::from("distance from the vehicle [m]"),
            limits: (0.0, 1.05 * far_m),
            shaded: Vec::new(),
            panels: vec![
                panel("before [mm]", |p| p.before_m, (0.0, 0.0)),
                panel("after [mm]", |p| p.after_m, (0.0, 0.0)),
            ],
            legend: vec![("dot", "after", String::from("used")), ("dot", "held", String::from("held out"))],
        };
        let _ = write!(body, "<figure><figcaption>{}</figcaption>\n{}</figure>\n", slope.as_str(), chart.html());
    }
    body.push_str("</div>\n");
    section("ranges", "Over distance", "Every dot is a common plane.", &body)
}

fn unknowns(summary: &StationsSummary) -> String {
    let stations: Vec<&str> = summary.stations.iter().map(|s| s.name.as_str()).collect();
    let mut columns = vec![
        ("Scanner", "", Align::Text),
        ("Unknown", "", Align::Text),
        ("Value", "", Align::Number),
        ("± sigma", "", Align::Number),
        ("± before", "", Align::Number),
        ("Seen", "", Align::Text),
        ("by ground", "", Align::Text),
    ];
    let numbers: Vec<String> = (1..=stations.len()).map(|k| format!("Station {k}")).collect();
    columns.extend(numbers.iter().map(|n| (n.as_str(), "alone", Align::Number)));
    let mut table = Table::new("Corrections of the mounting", &columns);
    for u in &summary.calibration.unknowns {
        let name = summary.scanners.iter().find(|s| s.id == u.scanner).map_or("", |s| s.name.as_str());
        let decimals = decimals_for(u.sigma);
        let unit = if u.unit == "deg" { "°" } else { " m" };
        let mut cells = vec![
            escape(name),
            escape(&u.name),
            format!("{}{unit}", signed(u.value, decimals)),
            fixed(u.sigma, decimals),
            fixed(u.prior_sigma, 2),
            bar(u.observed, "quiet"),
            bar(u.observed_by_ground, "quiet"),
        ];
        cells.extend(stations.iter().map(|s| match u.by_station.get(*s) {
            Some([value, sigma]) => format!("{} ± {}", signed(*value, decimals), fixed(*sigma, decimals)),
            None => String::from("–"),
        }));
        table.row_of_html("", &cells);
    }
    section("calibration", "Calibration", UNKNOWN_LEAD, &table.html())
}

fn directions(summary: &StationsSummary) -> String {
    let mut table = Table::new(
        "Combinations, weakest first",
        &[
            ("Scanner", "", Align::Text),
            ("Combination", "", Align::Prose),
            ("Sigma", "of that before", Align::Number),
            ("At 20 m", "mm", Align::Number),
            ("", "", Align::Text),
        ],
    );
    for d in &summary.calibration.directions {
        let name = summary.scanners.iter().find(|s| s.id == d.scanner).map_or("", |s| s.name.as_str());
        let members: Vec<String> = d.members.iter().map(|(m, c)| format!("{} {m}", signed(*c, 2))).collect();
        table.row(&[
            name.to_string(),
            members.join(", "),
            fixed(d.sigma_over_prior, 4),
            fixed(1e3 * d.effect_m, 1),
            d.grade.clone(),
        ]);
    }
    let body = table.html() + &list(&summary.calibration.not_seen);
    section("sight", "What is seen and what is not", DIRECTION_LEAD, &body)
}

fn stations(summary: &StationsSummary) -> String {
    let mut table = Table::new(
        "Stations",
        &[
            ("", "", Align::Number),
            ("Station", "", Align::Text),
            ("Points", "by scanner", Align::Text),
            ("Patches", "by scanner", Align::Text),
            ("Planes used", "", Align::Number),
            ("Held out", "", Align::Number),
        ],
    );
    let each = |values: &[u64]| values.iter().map(|v| count(*v)).collect::<Vec<_>>().join(" / ");
    for (k, s) in summary.stations.iter().enumerate() {
        table.row(&[
            (k + 1).to_string(),
            s.name.clone(),
            each(&s.points),
            each(&s.patches),
            count(s.used),
            count(s.held_out),
        ]);
    }
    section("stations", "Stations", "", &table.html())
}
