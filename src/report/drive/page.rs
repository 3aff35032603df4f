//! The page of a drive.

use crate::report::drive::data::{DriveCharts, DriveSummary};
use crate::report::drive::{calibration, cuts, fit, headline, innovation, map, ranges, timeline};
use crate::report::html::{Align, Table, escape, section};
use crate::report::number::{count, duration, fixed, signed_mm};
use crate::report::page::frame;
use crate::report::section::record;
use crate::stage::drive::cut::CutPoint;

/// The report of a drive as one HTML page.
pub(crate) fn render(summary: &DriveSummary, charts: &DriveCharts, cut_points: &[Vec<CutPoint>]) -> String {
    let mut shared = summary.shared();
    shared.trajectory = calibration::figures(summary).into_iter().collect();
    let sections: Vec<String> = [
        timeline::html(summary, charts),
        fit::html(summary, charts),
        ranges::bias(summary),
        ranges::fit(summary),
        cuts::html(charts, cut_points),
        map::html(summary, charts),
        calibration::terms(summary),
        innovation::html(summary, charts),
        strips(summary),
        record::remarks(&shared),
        record::settings(&shared),
        record::files(&shared),
        record::times(&shared),
    ]
    .into();
    frame(&format!("{} – drive report", summary.name), &headline::html(summary, charts), &sections)
}

/// Strips and how far the trajectory moved in them.
fn strips(summary: &DriveSummary) -> String {
    let mut table = Table::new(
        "Strips and the correction of their trajectory",
        &[
            ("Strip", "", Align::Text),
            ("Begin", "", Align::Text),
            ("Length", "", Align::Number),
            ("Points", "", Align::Number),
            ("Scanners", "", Align::Text),
            ("east", "mm", Align::Number),
            ("north", "mm", Align::Number),
            ("up", "mm", Align::Number),
            ("Largest", "mm", Align::Number),
        ],
    )
    .groups(&[("", 5), ("Correction at its middle", 3), ("", 1)]);
    for s in &summary.strips {
        let scanners: Vec<String> = s.scanners.iter().map(u16::to_string).collect();
        let begin = s.start_utc.as_deref().map_or_else(|| format!("{} s", fixed(s.start_s, 1)), escape);
        let mut cells =
            vec![escape(&s.name), begin, duration(s.end_s - s.start_s), count(s.points), scanners.join(", ")];
        cells.extend(s.correction_enu_m.iter().map(|v| signed_mm(*v)));
        cells.push(fixed(s.largest_correction_m * 1e3, 1));
        table.row_of_html("", &cells);
    }
    let body = table.html();
    if body.is_empty() { body } else { section("strips", "Strips", "", &body) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::drive::example;

    #[test]
    fn the_page_has_a_section_for_everything_it_is_given() {
        let (summary, charts) = example::drive();
        let html = render(&summary, &charts, &[]);
        let ids =
            ["trajectory", "ties", "bias", "ranges", "map", "calibration", "innovations", "strips", "files", "times"];
        for id in ids {
            assert!(
                html.contains(&format!("<section id=\"{id}\">")) && html.contains(&format!("href=\"#{id}\"")),
                "{id}"
            );
        }
        for text in ["pass to pass", "scanner to scanner", "no GNSS", "± 2 sigma", "dots held", "class=\"outage\""] {
            assert!(html.contains(text), "{text}");
        }
        assert!(html.len() < 600_000, "{}", html.len());
    }

    #[test]
    fn names_cannot_become_markup() {
        let (mut summary, charts) = example::drive();
        let evil = String::from("<script>alert('x')</script>\"&");
        summary.name.clone_from(&evil);
        summary.crs.clone_from(&evil);
        summary.strips.iter_mut().for_each(|s| {
            s.name.clone_from(&evil);
            s.start_utc = Some(evil.clone());
        });
        summary.notes.push(evil.clone());
        summary.rejected.insert(evil.clone(), 3);
        let ties = summary.ties_by_class["pass to pass"].clone();
        summary.ties_by_class.insert(evil.clone(), ties.clone());
        summary.ties.insert(evil.clone(), ties);
        let innovations = summary.trajectory.innovations["tie"].clone();
        summary.trajectory.innovations.insert(evil.clone(), innovations);
        summary.calibration.terms[0].name.clone_from(&evil);
        summary.calibration.estimates.iter_mut().for_each(|e| {
            e.term.clone_from(&evil);
            e.name.clone_from(&evil);
            e.unit.clone_from(&evil);
        });
        summary.timing.stage.insert(evil.clone(), 1.0);
        summary.files[0].notes.push(evil.clone());
        summary.files[0].output.clone_from(&evil);
        summary.settings[0].value.clone_from(&evil);
        summary.inputs[0].0 = evil;
        let html = render(&summary, &charts, &[]);
        assert!(!html.contains("<script") && html.matches("&lt;script&gt;").count() > 15);
    }

    #[test]
    fn what_is_not_known_is_a_dash_and_nothing_is_fetched() {
        let (mut summary, mut charts) = example::drive();
        summary.strips[0].correction_enu_m = [f64::NAN; 3];
        summary.strips[0].largest_correction_m = f64::NAN;
        summary.calibration.estimates[0].sigma = f64::NAN;
        summary.calibration.estimates[1].prior_sigma = f64::INFINITY;
        summary.calibration.terms[0].test = f64::INFINITY;
        summary.calibration.range_bias[0].bias_m[3] = f64::NAN;
        summary.calibration.range_bias[0].sigma_m[4] = f64::NAN;
        summary.trajectory.last_change_sigma = f64::INFINITY;
        summary.trajectory.outages[0].largest_sigma_enu_m = [f64::NAN; 3];
        summary.trajectory.outages[0].largest_sigma_before_enu_m = None;
        summary.trajectory.largest_correction.enu_m = [f64::NAN; 3];
        summary.trajectory.innovations.values_mut().for_each(|i| i.mean_nis_per_component = f64::NAN);
        charts.corrections[5].position_enu_m.x = f64::NAN;
        charts.corrections[6].sigma[4] = f64::NAN;
        charts.sigma_before[7] = None;
        charts.lines[0].0 = f64::NAN;
        charts.pairs[0].difference_m = (f64::NAN, f64::NAN);
        summary.difference_over[0].before[1].median_m = f64::NAN;
        summary.difference_over[0].after[2].sigma_mad_m = f64::NAN;
        charts.pairs[1].east_north_m = [f64::NAN; 2];
        charts.pairs[2].range_m = f64::NAN;
        charts.path[3][1] = f64::NAN;
        let html = render(&summary, &charts, &[]);
        for text in ["NaN", "inf<", "inf ", "http:", "https:", "//", "<link", "@import", "url(", "<img"] {
            assert!(!html.contains(text), "{text}");
        }
        assert!(html.contains(">–<") && html.contains("default-src 'none'"));
    }

    #[test]
    fn a_drive_of_which_nothing_is_known_has_a_page_too() {
        let html = render(&DriveSummary::default(), &DriveCharts::default(), &[]);
        assert!(html.contains("No surface was seen twice") && !html.contains("NaN"));
    }

    #[test]
    fn the_summary_has_the_keys_that_others_script_against() {
        let (summary, _) = example::drive();
        let value = serde_json::to_value(&summary).expect("a summary");
        for key in [
            "version",
            "name",
            "inputs",
            "settings",
            "strips",
            "ties",
            "ties_by_class",
            "rejected",
            "discrepancy",
            "difference_over",
            "calibration",
            "trajectory",
            "files",
            "notes",
            "timing",
            "peak_memory_bytes",
        ] {
            assert!(value.get(key).is_some(), "{key}");
        }
        for kind in ["surface_line", "increment"] {
            for key in ["found", "used", "held_out"] {
                assert!(value["ties"][kind][key].is_u64(), "{kind} {key}");
            }
        }
        for stage in ["before", "after", "held_out_before", "held_out_after"] {
            for key in ["median_m", "sigma_mad_m", "rms_m", "p95_m", "n"] {
                assert!(value["discrepancy"][stage][key].is_number(), "{stage} {key}");
                assert!(value["ties_by_class"]["pass to pass"]["discrepancy"][stage][key].is_number());
            }
        }
        assert!(value["trajectory"]["outages"][0]["start_s"].is_number());
        assert!(value["calibration"]["terms"][0]["estimated"].is_boolean());
        assert!(value["calibration"]["estimates"][0]["sigma"].is_number());
        assert!(value["timing"]["stage"].is_object() && value["timing"]["points_per_second"].is_number());
    }

    #[test]
    fn a_page_of_what_was_stored_is_the_page() {
        let (mut summary, mut charts) = example::drive();
        summary.strips[0].largest_correction_m = f64::NAN;
        summary.trajectory.last_change_sigma = f64::INFINITY;
        summary.trajectory.outages[0].largest_sigma_enu_m[1] = f64::NAN;
        summary.difference_over[0].before[1].median_m = f64::NAN;
        charts.sigma_before[7] = None;
        charts.lines[0].0 = f64::NAN;
        charts.pairs[0].difference_m = (f64::NAN, 0.1);
        let text = serde_json::to_string(&(&summary, &charts)).expect("JSON");
        let (again, charts_again): (DriveSummary, DriveCharts) = serde_json::from_str(&text).expect("the same");
        assert!(render(&summary, &charts, &[]) == render(&again, &charts_again, &[]));
    }

    #[test]
    fn a_run_ends_with_two_lines_before_the_address() {
        let (summary, charts) = example::drive();
        let text = headline::two_lines(&summary, &charts);
        assert_eq!(text.lines().count(), 2, "{text}");
        for part in
            ["robust sd", "held out", "moved by up to", "Calibrated (scanner): boresight (0, 1)", "without GNSS"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert_eq!(headline::two_lines(&DriveSummary::default(), &DriveCharts::default()).lines().count(), 2);
    }
}
