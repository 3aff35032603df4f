//! The page: one file that needs no other, readable on a screen of any width, in the dark, and on paper.

use std::fmt::Write as _;

use super::data::{Summary, TiePoint};
use super::html::escape;
use super::maps::Pictures;
use super::section::{adjustment, headline, maps, pairs, record, strips, ties};

const STYLE: &str = include_str!("style.css");
/// Nothing may be fetched: the browser enforces what the page promises.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:";

/// The report as one HTML page.
#[must_use]
pub fn render(summary: &Summary, points: &[TiePoint], pictures: &Pictures) -> String {
    let sections = [
        pairs::html(summary),
        ties::fit(summary, points),
        maps::html(pictures, points),
        strips::html(summary),
        adjustment::calibration(summary),
        adjustment::trials(summary),
        ties::numbers(summary),
        record::remarks(summary),
        record::settings(summary),
        record::files(summary),
        record::times(summary),
    ];
    frame(&format!("{} – strip adjustment report", summary.name), &headline::html(summary), &sections)
}

/// A page of a first screen and sections.
pub(crate) fn frame(title: &str, first_screen: &str, sections: &[String]) -> String {
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <title>{}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n{first_screen}",
        escape(title)
    );
    page.push_str(&contents(sections));
    for section in sections {
        page.push_str(section);
    }
    page.push_str("</main>\n</body>\n</html>\n");
    page
}

/// Links to the sections that are there.
fn contents(sections: &[String]) -> String {
    let mut links = String::new();
    for section in sections {
        let id = section.split("id=\"").nth(1).and_then(|rest| rest.split('"').next());
        let heading = section.split("<h2>").nth(1).and_then(|rest| rest.split("</h2>").next());
        if let (Some(id), Some(heading)) = (id, heading) {
            let _ = write!(links, "<a href=\"#{id}\">{heading}</a>");
        }
    }
    format!("<nav aria-label=\"Sections\">{links}</nav>\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{example, maps};

    fn page(summary: &Summary, points: &[TiePoint]) -> String {
        render(summary, points, &maps::draw(points).expect("drawn").pictures)
    }

    #[test]
    fn the_page_shows_the_numbers_it_is_given() {
        let (mut summary, points) = example::survey(4, 2000);
        summary.discrepancy.before.rms_m = 0.050_34;
        summary.discrepancy.after.rms_m = 0.008_71;
        summary.pairs[0].after.median_m = -0.012_34;
        summary.strips[1].correction_enu_m[2] = -0.123_44;
        let html = page(&summary, &points);
        for text in ["50.3", "8.7", "−12.3", "−0.1234", "EPSG:25832", "match.patch_m"] {
            assert!(html.contains(text), "{text}");
        }
        for id in ["pairs", "ties", "maps", "strips", "calibration", "models", "numbers", "settings", "files", "times"]
        {
            assert!(
                html.contains(&format!("<section id=\"{id}\">")) && html.contains(&format!("href=\"#{id}\"")),
                "{id}"
            );
        }
        assert!(html.len() < 3_000_000, "{}", html.len());
    }

    #[test]
    fn names_cannot_become_markup() {
        let (mut summary, points) = example::survey(3, 200);
        let evil = String::from("<script>alert('x')</script>\"&");
        summary.name.clone_from(&evil);
        summary.crs.clone_from(&evil);
        summary.strips.iter_mut().for_each(|s| {
            s.name.clone_from(&evil);
            s.trajectory.clone_from(&evil);
            s.start_utc = Some(evil.clone());
        });
        summary.pairs.iter_mut().for_each(|p| (p.a, p.b) = (evil.clone(), evil.clone()));
        summary.notes.push(evil.clone());
        summary.rejected.insert(evil.clone(), 3);
        summary.trajectory.insert(evil.clone(), evil.clone());
        summary.timing.stage.insert(evil.clone(), 1.0);
        let c = &mut summary.calibration;
        c.unobservable.push(evil.clone());
        c.warnings.push(evil.clone());
        c.parameters[0].block.clone_from(&evil);
        c.parameters[0].unit.clone_from(&evil);
        c.trials[0].reason.clone_from(&evil);
        c.class_scale.insert(evil.clone(), 1.0);
        summary.files[0].notes.push(evil.clone());
        summary.settings[0].value.clone_from(&evil);
        summary.inputs[0].0 = evil;
        let html = page(&summary, &points);
        assert!(!html.contains("<script") && html.matches("&lt;script&gt;").count() > 20);
    }

    #[test]
    fn what_is_not_known_is_a_dash_and_nothing_is_fetched() {
        let (mut summary, mut points) = example::survey(3, 200);
        summary.pairs[0].shift_after_m = [f64::NAN; 3];
        summary.pairs[1].after.median_m = f64::NAN;
        summary.strips[0].course_deg = f64::NAN;
        summary.strips[0].correction_enu_m = [f64::NAN; 3];
        summary.calibration.sigma0 = f64::NAN;
        summary.calibration.condition = f64::INFINITY;
        summary.calibration.parameters[0].sigma = f64::NAN;
        summary.calibration.parameters[0].observed = f64::NAN;
        summary.calibration.parameters[1].prior_sigma = f64::INFINITY;
        points[0].before_m = f64::NAN;
        points[1].map_m = [f64::NAN; 3];
        let html = page(&summary, &points);
        for text in ["NaN", "inf<", "http:", "https:", "//", "<link", "@import", "url("] {
            let clean: String = html.split("base64,").map(|s| s.split_once('"').map_or(s, |p| p.1)).collect();
            assert!(!clean.contains(text), "{text}");
        }
        assert!(html.contains(">–<"));
    }

    #[test]
    fn a_survey_without_ties_or_without_an_adjustment_has_a_page_too() {
        let html = page(&Summary::default(), &[]);
        assert!(html.contains("No ties were found") && !html.contains("NaN"));
        let (mut summary, points) = example::survey(3, 200);
        summary.discrepancy.after = crate::report::data::Discrepancy::default();
        summary.calibration = crate::report::data::AdjustmentSummary::default();
        let html = page(&summary, &points);
        assert!(html.contains("nothing has been adjusted yet") && !html.contains("id=\"calibration\""));
    }
}
