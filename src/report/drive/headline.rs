//! The first screen of a drive: what got better, and what to look at.

use std::fmt::Write as _;

use crate::report::data::{Discrepancies, Discrepancy};
use crate::report::drive::data::{ClassSummary, DriveCalibration, DriveCharts, DriveSummary};
use crate::report::findings::{Check, Grade};
use crate::report::html::escape;
use crate::report::number::{count, counted, duration, fixed, length, mm};
use crate::report::section::headline::{remarks, tile};

/// Largest share of ties left out that is nothing to look at.
const LEFT_OUT_SHARE: f64 = 0.05;
/// A class with fewer differences has no number of its own on the first screen.
const LEAST_DIFFERENCES: usize = 30;
/// Held-out ties may spread by this factor more than the others, and their median may be off by this much \[m\].
const HELD_OUT_RATIO: f64 = 1.10;
const HELD_OUT_MEDIAN_M: f64 = 1e-3;
/// A tie further apart than this many robust sd does not belong to the rest.
const FAR: f64 = 5.0;
/// Mean squares of innovations of ties that are ordinary.
const TIE_NIS: f64 = 2.0;

/// The first screen.
pub(crate) fn html(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let mut out = String::from("<header>\n");
    let _ = writeln!(out, "<p class=\"kind\">Drive report</p>\n<h1>{}</h1>", escape(&summary.name));
    let _ = writeln!(out, "<p class=\"facts\">{}</p>", facts(summary));
    for (i, sentence) in sentences(summary, charts).iter().enumerate() {
        let class = if i == 0 { " class=\"first\"" } else { "" };
        let _ = writeln!(out, "<p{class}>{}</p>", escape(sentence));
    }
    out += &tiles(summary, charts);
    out += &remarks(&checks(summary));
    out.push_str("</header>\n");
    out
}

fn facts(summary: &DriveSummary) -> String {
    let points: u64 = summary.strips.iter().map(|s| s.points).sum();
    let mut scanners: Vec<u16> = summary.strips.iter().flat_map(|s| s.scanners.iter().copied()).collect();
    scanners.sort_unstable();
    scanners.dedup();
    let mut facts = vec![
        counted(summary.strips.len(), "strip", "strips"),
        counted(scanners.len(), "scanner", "scanners"),
        format!("{} points", count(points)),
        summary.crs.clone(),
        format!("tieline {}", summary.version),
    ];
    if let Some(utc) = summary.strips.iter().filter_map(|s| s.start_utc.as_deref()).min() {
        facts.insert(3, format!("from {utc}"));
    }
    facts.retain(|f| !f.trim().is_empty());
    facts.iter().map(|f| format!("<span>{}</span>", escape(f))).collect()
}

/// Robust sd and rms.
fn both(d: &Discrepancy) -> String {
    format!("{} mm (robust sd; rms {} mm)", mm(d.sigma_mad_m), mm(d.rms_m))
}

fn sentences(summary: &DriveSummary, charts: &DriveCharts) -> Vec<String> {
    let d = &summary.discrepancy;
    if d.before.n == 0 {
        return vec![String::from("No surface was seen twice, so nothing could be compared or adjusted.")];
    }
    let n = length(d.before.n);
    let first = if d.after.sigma_mad_m < d.before.sigma_mad_m {
        format!(
            "Surfaces seen twice differed by {}; with the new trajectory and calibration they differ by {}, {n} ties.",
            both(&d.before),
            both(&d.after)
        )
    } else {
        format!(
            "The solution did not help: surfaces seen twice differed by {} before and differ by {} after, {n} ties.",
            both(&d.before),
            both(&d.after)
        )
    };
    let mut all = vec![first, held_out_sentence(d)];
    let largest = &summary.trajectory.largest_correction;
    if largest.length_m > 0.0 {
        let [east, north, up] = largest.enu_m.map(mm);
        all.push(format!(
            "The trajectory moved by up to {} mm (east {east}, north {north}, up {up} mm), {}.",
            mm(largest.length_m),
            place(summary, charts)
        ));
    }
    all
}

/// What the ties say that took no part. Nothing is taken out of the ties of a drive: the rms tells of what moved or was mistaken, the
/// robust sd of the solution.
fn held_out_sentence(d: &Discrepancies) -> String {
    if d.held_out_after.n == 0 {
        return String::from("No ties were held out, so nothing independent confirms this.");
    }
    let (before, after) = (both(&d.held_out_before), both(&d.held_out_after));
    let n = length(d.held_out_after.n);
    if d.held_out_after.sigma_mad_m >= d.held_out_before.sigma_mad_m {
        format!(
            "Ties that took no part did not get better: {before} before, {after} after, {n} ties. Do not use this result as it is."
        )
    } else if d.held_out_after.sigma_mad_m > HELD_OUT_RATIO * d.after.sigma_mad_m {
        format!(
            "Ties that took no part got better too, from {before} to {after}, {n} ties, yet less than the others: a part of the gain is fitted to the ties."
        )
    } else {
        format!("Ties that took no part in the solution confirm it: {before} before, {after} after, {n} ties.")
    }
}

/// Whether held-out ties agree with the others, and how far those go that do not fit.
fn held_out(d: &Discrepancies, checks: &mut Vec<Check>) {
    if d.after.n == 0 {
        return;
    }
    if d.held_out_after.n == 0 {
        checks.push(Check::new(Grade::Warning, String::from("No ties were held out: over-adjustment cannot be seen.")));
        return;
    }
    let ratio = d.held_out_after.sigma_mad_m / d.after.sigma_mad_m;
    let spread = format!(
        "Held-out ties spread {} × as far as the others (robust sd; up to {HELD_OUT_RATIO:.2} is good).",
        fixed(ratio, 2)
    );
    checks.push(Check::good_if(ratio <= HELD_OUT_RATIO, spread));
    let median_m = d.held_out_after.median_m;
    let median = format!(
        "The median of the held-out ties is {} mm (within {} mm is good).",
        mm(median_m),
        mm(HELD_OUT_MEDIAN_M)
    );
    checks.push(Check::good_if(median_m.abs() <= HELD_OUT_MEDIAN_M, median));
    let rms_m = d.after.rms_m.max(d.held_out_after.rms_m);
    if rms_m > FAR * d.after.sigma_mad_m {
        let text = format!(
            "A few ties are far from the rest (rms up to {} mm at a robust sd of {} mm): things that moved between two visits, or mistaken surfaces.",
            mm(rms_m),
            mm(d.after.sigma_mad_m)
        );
        checks.push(Check::new(Grade::Remark, text));
    }
}

/// Where the largest correction is.
fn place(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let time_s = summary.trajectory.largest_correction.time_s;
    let at = format!("at {}", charts.origin.words(time_s, 1));
    let outage = summary.trajectory.outages.iter().find(|o| time_s >= o.start_s && time_s <= o.end_s);
    match outage {
        Some(o) => format!("{at}, within the {} without GNSS", duration(o.end_s - o.start_s)),
        None => at,
    }
}

fn tiles(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let mut tiles = String::new();
    let d = &summary.discrepancy;
    if d.held_out_before.n > 0 {
        let (before, after) = (&d.held_out_before, &d.held_out_after);
        let note = format!("rms {} → {} mm, {} differences", mm(before.rms_m), mm(after.rms_m), length(after.n));
        let (before, after) = (mm(before.sigma_mad_m), mm(after.sigma_mad_m));
        tiles += &tile("Ties held out, robust sd", Some(before), Some(after), "mm", &note);
    }
    for (class, ties) in &summary.ties_by_class {
        let (before, after) = (&ties.discrepancy.before, &ties.discrepancy.after);
        if before.n >= LEAST_DIFFERENCES {
            let note =
                format!("median {} → {} mm, {} differences", mm(before.median_m), mm(after.median_m), length(after.n));
            let label = format!("{}{}, robust sd", class[..1].to_uppercase(), &class[1..]);
            tiles += &tile(&label, Some(mm(before.sigma_mad_m)), Some(mm(after.sigma_mad_m)), "mm", &note);
        }
    }
    let largest = &summary.trajectory.largest_correction;
    if largest.length_m > 0.0 {
        let note = place(summary, charts);
        tiles += &tile("Largest correction of the trajectory", None, Some(mm(largest.length_m)), "mm", &note);
    }
    let worst = summary.trajectory.outages.iter().map(|o| (o, norm(&o.largest_sigma_enu_m)));
    if let Some((outage, sigma_m)) = worst.filter(|o| o.1.is_finite()).max_by(|a, b| a.1.total_cmp(&b.1)) {
        let before = outage.largest_sigma_before_enu_m.as_ref().map(|s| mm(norm(s)));
        let [east, north, up] = outage.largest_sigma_enu_m.map(mm);
        let note = format!("largest: east {east}, north {north}, up {up} mm");
        tiles += &tile("Sigma of the position without GNSS, 3-D", before, Some(mm(sigma_m)), "mm", &note);
    }
    if tiles.is_empty() { tiles } else { format!("<div class=\"tiles wide\">\n{tiles}</div>\n") }
}

fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Everything worth a remark on the first screen.
fn checks(summary: &DriveSummary) -> Vec<Check> {
    let mut checks = Vec::new();
    held_out(&summary.discrepancy, &mut checks);
    for (class, ties) in summary.ties_by_class.iter().filter(|(_, t)| got_worse(t)) {
        let d = &ties.discrepancy;
        let text = format!(
            "{class}: differences did not get smaller, {} mm before and {} mm after (robust sd).",
            mm(d.before.sigma_mad_m),
            mm(d.after.sigma_mad_m)
        );
        checks.push(Check::new(Grade::Warning, text));
    }
    let t = &summary.trajectory;
    if t.ties_given > 0 {
        let share = t.ties_left_out as f64 / t.ties_given as f64;
        checks.push(Check::good_if(
            share <= LEFT_OUT_SHARE,
            format!(
                "{} of the {} ties given to the smoother ({}\u{202f}%) were left out.",
                length(t.ties_left_out),
                length(t.ties_given),
                fixed(share * 100.0, 1)
            ),
        ));
    }
    if let Some(tie) = t.innovations.get("tie").filter(|i| i.mean_nis_per_component.is_finite()) {
        let good = tie.mean_nis_per_component <= TIE_NIS;
        let meaning = match tie.mean_nis_per_component {
            nis if nis > TIE_NIS => "they fit worse than their sigmas say",
            nis if nis < 1.0 / TIE_NIS => "they fit better than their sigmas say, which are cautious",
            _ => "they fit as well as their sigmas say",
        };
        let nis = fixed(tie.mean_nis_per_component, 2);
        checks.push(Check::good_if(good, format!("Ties have a mean squared innovation of {nis}: {meaning}.")));
    }
    let fixed_terms = summary.calibration.terms.iter().filter(|t| !t.estimated).count();
    if fixed_terms > 0 {
        let terms = counted(fixed_terms, "term", "terms");
        let text =
            format!("{terms} of the calibration stayed nominal, for the data do not ask for more; see Calibration.");
        checks.push(Check::new(Grade::Remark, text));
    }
    if !summary.notes.is_empty() {
        let notes = counted(summary.notes.len(), "remark", "remarks");
        checks.push(Check::new(Grade::Remark, format!("{notes} from the stages; see Remarks.")));
    }
    checks.sort_by_key(Check::place);
    checks
}

fn got_worse(ties: &ClassSummary) -> bool {
    let d = &ties.discrepancy;
    d.after.n >= 10 && d.after.sigma_mad_m > 1.1 * d.before.sigma_mad_m + 1e-4
}

/// What got better, what was calibrated and how sure the trajectory is, for the terminal.
pub(crate) fn two_lines(summary: &DriveSummary, charts: &DriveCharts) -> String {
    let d = &summary.discrepancy;
    if d.before.n == 0 {
        return String::from("No surface was seen twice.\nNothing was calibrated.");
    }
    let change = |a: &Discrepancy, b: &Discrepancy| {
        format!(
            "median {} -> {}, robust sd {} -> {}, rms {} -> {} mm",
            mm(a.median_m),
            mm(b.median_m),
            mm(a.sigma_mad_m),
            mm(b.sigma_mad_m),
            mm(a.rms_m),
            mm(b.rms_m)
        )
    };
    let held = match d.held_out_after.n {
        0 => String::from("no ties held out"),
        _ => format!("held out: {}", change(&d.held_out_before, &d.held_out_after)),
    };
    let largest = &summary.trajectory.largest_correction;
    let first = format!(
        "Sightings of one surface: {}; {held}; the trajectory moved by up to {} mm, {}.",
        change(&d.before, &d.after),
        mm(largest.length_m),
        place(summary, charts)
    );
    format!("{first}\n{}; {}.", calibrated(&summary.calibration), sure(summary))
}

/// What was calibrated, in a sentence without its end.
pub(crate) fn calibrated(calibration: &DriveCalibration) -> String {
    let names = |estimated: bool| -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for term in calibration.terms.iter().filter(|t| t.estimated == estimated) {
            let of = || calibration.terms.iter().filter(|t| t.name == term.name && t.estimated == estimated);
            let scanners: Vec<String> = of().map(|t| t.scanner.to_string()).collect();
            let name = format!("{} ({})", term.name, scanners.join(", "));
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    };
    match (names(true), names(false)) {
        (yes, no) if yes.is_empty() && no.is_empty() => String::from("Nothing was calibrated"),
        (yes, no) if yes.is_empty() => format!("Nothing needed calibration; fixed: {}", no.join(", ")),
        (yes, no) if no.is_empty() => format!("Calibrated (scanner): {}", yes.join(", ")),
        (yes, no) => format!("Calibrated (scanner): {}; fixed: {}", yes.join(", "), no.join(", ")),
    }
}

fn sure(summary: &DriveSummary) -> String {
    let ned = |v: [f64; 3]| {
        let [n, e, d] = v.map(mm);
        format!("{n}/{e}/{d} mm north/east/down")
    };
    let worst = summary.trajectory.outages.iter().max_by(|a, b| {
        norm(&a.largest_sigma_enu_m).total_cmp(&norm(&b.largest_sigma_enu_m)) // NaN cannot hide a number that matters
    });
    match worst {
        None => format!("sigma of the trajectory {} (rms)", ned(summary.trajectory.rms_sigma_position_ned_m)),
        Some(o) => {
            let [e, n, u] = o.largest_sigma_enu_m;
            format!(
                "sigma of the trajectory up to {} in {} without GNSS",
                ned([n, e, u]),
                duration(o.end_s - o.start_s)
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::drive::example;

    #[test]
    fn a_few_cars_that_drove_off_are_a_remark_and_a_wider_spread_is_a_warning() {
        let (mut summary, _) = example::drive();
        let d = &mut summary.discrepancy;
        d.after.sigma_mad_m = 0.0011;
        (d.held_out_after.sigma_mad_m, d.held_out_after.rms_m) = (0.0011, 0.0114);
        assert!(held_out_sentence(&summary.discrepancy).contains("confirm"));
        let found = checks(&summary);
        assert!(found.iter().all(|c| c.grade != Grade::Warning), "{found:?}");
        assert!(found.iter().any(|c| c.text.contains("moved between two visits")));
        summary.discrepancy.held_out_after.sigma_mad_m = 0.0022;
        assert!(held_out_sentence(&summary.discrepancy).contains("fitted to the ties"));
        assert!(checks(&summary).iter().any(|c| c.grade == Grade::Warning && c.text.contains("2.00 ×")));
        summary.discrepancy.held_out_after.sigma_mad_m = 1.0;
        assert!(held_out_sentence(&summary.discrepancy).contains("Do not use"));
    }
}
