//! The first screen of a drive: what got better, and what to look at.

use std::fmt::Write as _;

use crate::report::data::{Discrepancy, Summary};
use crate::report::drive::data::{ClassSummary, DriveCharts, DriveSummary};
use crate::report::findings::{Check, Grade, held_out, held_out_sentence};
use crate::report::html::escape;
use crate::report::number::{count, counted, duration, fixed, length, mm};
use crate::report::section::headline::{difference_tile, remarks, tile};

/// Largest share of ties left out that is nothing to look at.
const LEFT_OUT_SHARE: f64 = 0.05;
/// A class with fewer differences has no number of its own on the first screen.
const LEAST_DIFFERENCES: usize = 30;
/// Mean squares of innovations of ties that are ordinary.
const TIE_NIS: f64 = 2.0;

/// The first screen.
pub(crate) fn html(summary: &DriveSummary, shared: &Summary, charts: &DriveCharts) -> String {
    let mut out = String::from("<header>\n");
    let _ = writeln!(out, "<p class=\"kind\">Drive report</p>\n<h1>{}</h1>", escape(&summary.name));
    let _ = writeln!(out, "<p class=\"facts\">{}</p>", facts(summary));
    for (i, sentence) in sentences(summary, shared, charts).iter().enumerate() {
        let class = if i == 0 { " class=\"first\"" } else { "" };
        let _ = writeln!(out, "<p{class}>{}</p>", escape(sentence));
    }
    out += &tiles(summary, charts);
    out += &remarks(&checks(summary, shared));
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

fn sentences(summary: &DriveSummary, shared: &Summary, charts: &DriveCharts) -> Vec<String> {
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
    let mut all = vec![first, held_out_sentence(shared)];
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
        tiles += &difference_tile("Ties held out, rms", &d.held_out_before, &d.held_out_after);
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
fn checks(summary: &DriveSummary, shared: &Summary) -> Vec<Check> {
    let mut checks = Vec::new();
    if summary.discrepancy.after.n > 0 {
        held_out(shared, &mut checks);
    }
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
    format!("{first}\n{}; {}.", calibrated(summary), sure(summary))
}

fn calibrated(summary: &DriveSummary) -> String {
    let names = |estimated: bool| -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for term in summary.calibration.terms.iter().filter(|t| t.estimated == estimated) {
            let of = || summary.calibration.terms.iter().filter(|t| t.name == term.name && t.estimated == estimated);
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
