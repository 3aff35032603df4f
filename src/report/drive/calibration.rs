//! Calibration: what was estimated, what was fixed.

use crate::report::drive::data::{DriveCalibration, DriveSummary, TermSummary};
use crate::report::html::{Align, Table, bar, escape, section};
use crate::report::number::{decimals_for, fixed, length, mm, signed};
use crate::stage::drive::constants::Term;
use crate::stage::drive::over::Over;

const LEAD: &str = "Corrections of the mounting that the project gives, on its axes. Known from data says how much of a value comes \
from this drive: at 0 % it is what was assumed beforehand. Each term is tested for all scanners together: below 1 it differs from \
nothing by no more than chance, is fixed at its nominal value, and the others get better known.";

/// Terms and values.
pub(crate) fn terms(summary: &DriveSummary) -> String {
    let calibration = &summary.calibration;
    let mut table = Table::new(
        "Calibration",
        &[
            ("Scanner", "", Align::Text),
            ("Term", "", Align::Text),
            ("Value", "", Align::Number),
            ("Sigma", "", Align::Number),
            ("Prior sigma", "", Align::Number),
            ("Unit", "", Align::Text),
            ("Known from data", "", Align::Text),
            ("Test", "", Align::Number),
            ("Outcome", "", Align::Prose),
        ],
    );
    for term in &calibration.terms {
        let values = || calibration.estimates.iter().filter(|e| e.scanner == term.scanner && e.term == term.name);
        if let (true, Some((bias_m, sigma_m))) =
            (term.estimated && values().next().is_none(), curve_of(calibration, term))
        {
            let most_m = bias_m.iter().map(|b| b.abs()).fold(f64::NAN, f64::max);
            let sigma_m = sigma_m.iter().copied().fold(f64::NAN, f64::max);
            let value = format!("up to {}", mm(most_m));
            row(&mut table, term, &term.name, [value, format!("up to {}", mm(sigma_m)), dash(), "mm".into(), dash()]);
            continue;
        }
        if !term.estimated || values().next().is_none() {
            let cells = [fixed(0.0, 0), dash(), dash(), String::new(), dash()];
            row(&mut table, term, &term.name, cells);
            continue;
        }
        for e in values() {
            let decimals = decimals_for(e.sigma);
            let observed = 1.0 - (e.sigma / e.prior_sigma).powi(2);
            let class = match observed {
                share if share >= 0.9 => "good",
                share if share >= 0.5 => "partly",
                _ => "prior",
            };
            let cells = [
                signed(e.value, decimals),
                fixed(e.sigma, decimals),
                fixed(e.prior_sigma, decimals_for(e.prior_sigma).min(decimals)),
                escape(&e.unit),
                bar(observed, class),
            ];
            row(&mut table, term, &e.name, cells);
        }
    }
    let body = table.html();
    if body.is_empty() { body } else { section("calibration", "Calibration", LEAD, &body) }
}

/// Bias and standard deviations \[m\] of the curve that a term is.
fn curve_of<'a>(calibration: &'a DriveCalibration, term: &TermSummary) -> Option<(&'a [f64], &'a [f64])> {
    let over = Over::ALL.into_iter().find(|over| over.term().as_str() == term.name);
    if let Some(over) = over {
        let mut curves = calibration.range_bias_over.iter();
        let curve = curves.find(|c| (c.scanner, c.over.as_str()) == (term.scanner, over.as_str()))?;
        return Some((&curve.bias_m, &curve.sigma_m));
    }
    let curve = calibration.range_bias.iter().find(|c| c.scanner == term.scanner)?;
    Some((&curve.bias_m, &curve.sigma_m))
}

fn dash() -> String {
    String::from(crate::report::number::UNKNOWN)
}

fn row(table: &mut Table, term: &TermSummary, name: &str, [value, sigma, prior, unit, known]: [String; 5]) {
    let outcome = match (term.estimated, term.directions_not_seen) {
        (false, _) => String::from("fixed at its nominal value: the data do not ask for it"),
        (true, 0) => String::from("estimated"),
        (true, _) if term.name == Term::Range.as_str() => {
            String::from("estimated; a common constant is held near nothing")
        }
        (true, _) if Over::ALL.iter().any(|over| over.term().as_str() == term.name) => {
            String::from("estimated; its mean over the data is held at zero")
        }
        (true, n) => format!("estimated; {n} directions not seen, near nominal"),
    };
    table.row_of_html(
        if term.estimated { "taken" } else { "" },
        &[length(term.scanner), escape(name), value, sigma, prior, unit, known, fixed(term.test, 2), escape(&outcome)],
    );
}

/// Figures of the trajectory, a name and a value each.
pub(crate) fn figures(summary: &DriveSummary) -> Vec<(String, String)> {
    let (t, m) = (&summary.trajectory, &summary.measurements);
    let three = |v: &[f64; 3], decimals: usize| v.iter().map(|v| fixed(*v, decimals)).collect::<Vec<_>>().join(" / ");
    let mm3 = t.rms_sigma_position_ned_m.map(|v| v * 1e3);
    let mdeg = t.rms_sigma_roll_pitch_heading_deg.map(|v| v * 1e3);
    [
        ("Epochs", length(t.epochs)),
        ("Sigma north / east / down, rms", format!("{} mm", three(&mm3, 1))),
        ("Sigma roll / pitch / heading, rms", format!("{} mdeg", three(&mdeg, 2))),
        ("Runs of the smoother", length(t.runs)),
        ("Last change", format!("{} sigma", fixed(t.last_change_sigma, 3))),
        ("IMU", format!("{} samples, one every {} ms", length(m.imu_samples), fixed(m.imu_interval_s * 1e3, 2))),
        ("GNSS", format!("{} fixes", length(m.gnss_fixes))),
        ("Odometer", format!("{} readings", length(m.odometer_readings))),
        ("Known points", length(m.known_points)),
        ("Ties given to the smoother", length(t.ties_given)),
        ("Ties it left out", length(t.ties_left_out)),
    ]
    .map(|(name, value)| (String::from(name), value))
    .into()
}
