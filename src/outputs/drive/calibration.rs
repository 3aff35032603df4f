//! `calibration.toml` of a drive.

use std::fmt::Write as _;

use nalgebra::{Rotation3, Vector3};

use crate::project::Project;
use crate::stage::drive::calibrated::Calibrated;
use crate::stage::drive::constants::{Group, Term};

/// Platform, latencies and range corrections as found; which terms were estimated; every estimate with its sigma, and those of the
/// other scanners less the first.
pub(super) fn text(project: &Project, calibrated: &Calibrated<'_>) -> String {
    let Calibrated { constants, estimate, ranges_m, verdicts } = calibrated;
    let mut text = String::from(
        "# Calibration estimated by tieline: calibrate.known = \"calibration.toml\" takes it as known. [platform] goes into a project whose strips\n\
         # are made with it. Range corrections are added to a range, all of a scanner together: coefficients of a cubic B-spline, knots evenly spaced in the\n\
         # logarithm of the range; range_bias.csv has the curve.\n\n[platform]\n",
    );
    if let Some(arm) = project.platform.gnss_lever_arm_m {
        let _ = writeln!(text, "gnss_lever_arm_m = {arm:?}");
    }
    for scanner in 0..ranges_m.len() {
        let nominal =
            project.platform.scanner.iter().find(|s| usize::from(s.id) == scanner).cloned().unwrap_or_default();
        let c = constants.calibration(scanner, &estimate.value);
        let before = Rotation3::new(Vector3::from(nominal.boresight_deg).map(f64::to_radians));
        let boresight = (Rotation3::new(c.boresight_rad) * before).scaled_axis().map(f64::to_degrees);
        let arm = Vector3::from(nominal.lever_arm_m) + c.lever_arm_m;
        let _ = writeln!(
            text,
            "\n[[platform.scanner]]\nid = {scanner}\nlever_arm_m = [{:.5}, {:.5}, {:.5}]\nmounting_deg = {:?}\n\
             boresight_deg = [{:.6}, {:.6}, {:.6}]",
            arm.x, arm.y, arm.z, nominal.mounting_deg, boresight.x, boresight.y, boresight.z
        );
    }
    for scanner in 0..ranges_m.len() {
        let latency_s = constants.latency_s(scanner, &estimate.value);
        let _ = writeln!(text, "\n[[latency]]\nscanner = {scanner}\nlatency_s = {latency_s:.9}");
        for (spline, coefficients_m) in constants.range_curves(scanner, &estimate.value) {
            let (first_m, last_m) = spline.span_m();
            let _ = writeln!(
                text,
                "\n[[range_correction]]\nscanner = {scanner}\nfirst_m = {first_m:?}\nlast_m = {last_m:?}\ncoefficients_m = {coefficients_m:.7?}"
            );
        }
        for curve in constants.over_curves(scanner, &estimate.value) {
            let (first, last) = curve.spline.span();
            let (over, first, last) = (curve.over.as_str(), curve.over.value(first), curve.over.value(last));
            let _ = writeln!(
                text,
                "\n[[range_correction_over]]\nscanner = {scanner}\nover = \"{over}\"\nfirst = {first:?}\nlast = {last:?}\ncoefficients_m = {:.7?}",
                curve.coefficients_m
            );
        }
    }
    for verdict in verdicts.iter() {
        let _ = writeln!(
            text,
            "\n[[term]]\nscanner = {}\nname = \"{}\"\nestimated = {} # {}\ntest = {:.3} # above 1: the data ask for it\n\
             directions_not_seen = {}",
            verdict.scanner,
            verdict.term.as_str(),
            verdict.needed,
            if verdict.needed { "estimated" } else { "fixed at its nominal value" },
            verdict.ratio,
            verdict.not_seen
        );
    }
    estimates(&mut text, calibrated);
    text
}

/// Estimates of all terms but curves.
fn estimates(text: &mut String, calibrated: &Calibrated<'_>) {
    let Calibrated { constants, estimate, .. } = calibrated;
    for group in constants.groups.iter().filter(|g| !g.term.is_curve()) {
        let (unit, factor) = unit(group.term);
        for k in 0..group.prior.nrows() {
            let i = group.first + k;
            let _ = writeln!(
                text,
                "\n[[estimate]]\nscanner = {}\nname = \"{}\"\nunit = \"{unit}\"\nvalue = {:.7}\nsigma = {:.7}\nprior_sigma = {:.7}",
                group.scanner,
                name(group, k),
                estimate.value[i] * factor,
                estimate.sigma(i) * factor,
                group.prior[(k, k)].sqrt() * factor
            );
        }
        let Some(first) = constants.first(0, group.term).filter(|_| group.scanner > 0) else { continue };
        let n = estimate.value.len();
        for k in 0..group.prior.nrows() {
            let (i, j) = (group.first + k, first + k);
            let variance =
                estimate.covariance[i * n + i] + estimate.covariance[j * n + j] - 2.0 * estimate.covariance[i * n + j];
            let _ = writeln!(
                text,
                "\n[[relative]]\nscanner = {}\nless = 0\nname = \"{}\"\nunit = \"{unit}\"\nvalue = {:.7}\nsigma = {:.7}",
                group.scanner,
                name(group, k),
                (estimate.value[i] - estimate.value[j]) * factor,
                variance.max(0.0).sqrt() * factor
            );
        }
    }
}

/// Term and axis.
fn name(group: &Group, k: usize) -> String {
    let axis = if group.prior.nrows() == 3 { ["x", "y", "z"][k] } else { "" };
    format!("{} {axis}", group.term.as_str()).trim_end().to_string()
}

/// Unit of a term in the file, and what leads to it.
fn unit(term: Term) -> (&'static str, f64) {
    match term {
        Term::Boresight => ("deg", 1f64.to_degrees()),
        Term::Latency => ("s", 1.0),
        Term::LeverArm | Term::Range | Term::Incidence | Term::Intensity => ("m", 1.0),
    }
}
