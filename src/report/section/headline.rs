//! The first screen: what got better, in sentences and large numbers, and what to look at.

use std::fmt::Write as _;

use crate::report::data::{Discrepancy, Summary};
use crate::report::findings::{Check, Grade, checks, is_adjusted, pair_name, sentences, worst_pair};
use crate::report::html::escape;
use crate::report::number::{count, counted, fixed, length, mm};

/// The first screen.
pub(crate) fn html(summary: &Summary) -> String {
    let mut out = String::from("<header>\n");
    let _ = writeln!(out, "<p class=\"kind\">Strip adjustment report</p>\n<h1>{}</h1>", escape(&summary.name));
    let _ = writeln!(out, "<p class=\"facts\">{}</p>", facts(summary));
    for (i, sentence) in sentences(summary).iter().enumerate() {
        let class = if i == 0 { " class=\"first\"" } else { "" };
        let _ = writeln!(out, "<p{class}>{}</p>", escape(sentence));
    }
    out.push_str(&tiles(summary));
    out.push_str(&remarks(&checks(summary)));
    out.push_str("</header>\n");
    out
}

/// Strips, points, reference system and version in a line.
fn facts(summary: &Summary) -> String {
    let points: u64 = summary.strips.iter().map(|s| s.points).sum();
    let mut facts = vec![
        counted(summary.strips.len(), "strip", "strips"),
        format!("{} points", count(points)),
        summary.crs.clone(),
        format!("tieline {}", summary.version),
    ];
    if let Some(utc) = summary.strips.iter().filter_map(|s| s.start_utc.as_deref()).min() {
        facts.insert(2, format!("from {utc}"));
    }
    facts.retain(|f| !f.trim().is_empty());
    facts.iter().map(|f| format!("<span>{}</span>", escape(f))).collect()
}

/// Large numbers, before and after.
fn tiles(summary: &Summary) -> String {
    let d = &summary.discrepancy;
    let mut tiles = String::new();
    if d.before.n > 0 {
        tiles += &difference_tile("Ties used, rms", &d.before, &d.after);
    }
    if d.held_out_before.n > 0 {
        tiles += &difference_tile("Ties held out, rms", &d.held_out_before, &d.held_out_after);
    }
    let worst = |value| worst_pair(&summary.pairs, value);
    if let Some(before) = worst(|p| p.before.median_m) {
        let after = worst(|p| p.after.median_m).filter(|p| p.after.n > 0);
        let note = after.map_or_else(|| pair_name(before), |p| format!("now {}", pair_name(p)));
        let after = after.map(|p| mm(p.after.median_m.abs()));
        tiles += &tile("Worst pair, median", Some(mm(before.before.median_m.abs())), after, "mm", &note);
    }
    let size = |enu: &[f64; 3]| enu.iter().map(|v| v * v).sum::<f64>().sqrt();
    let sized = summary.strips.iter().map(|s| (s, size(&s.correction_enu_m))).filter(|s| s.1.is_finite());
    if let (true, Some((strip, size_m))) = (is_adjusted(summary), sized.max_by(|a, b| a.1.total_cmp(&b.1))) {
        tiles +=
            &tile("Largest correction of a strip", None, Some(fixed(size_m, 3)), "m", &format!("strip {}", strip.name));
    }
    if tiles.is_empty() { tiles } else { format!("<div class=\"tiles\">\n{tiles}</div>\n") }
}

fn difference_tile(label: &str, before: &Discrepancy, after: &Discrepancy) -> String {
    let n = length(before.n.max(after.n));
    if after.n == 0 {
        let note = format!("median {} mm, {n} differences", mm(before.median_m));
        return tile(label, Some(mm(before.rms_m)), None, "mm", &note);
    }
    let note = format!("median {} → {} mm, {n} differences", mm(before.median_m), mm(after.median_m));
    tile(label, Some(mm(before.rms_m)), Some(mm(after.rms_m)), "mm", &note)
}

/// Large numbers with what they are.
pub(crate) fn tile(label: &str, before: Option<String>, after: Option<String>, unit: &str, note: &str) -> String {
    let numbers = match (before, after) {
        (Some(before), Some(after)) => {
            format!("<span class=\"was\">{before}</span> <span class=\"to\">→</span> <b>{after}</b>")
        }
        (Some(only), None) | (None, Some(only)) => format!("<b>{only}</b>"),
        (None, None) => String::new(),
    };
    format!(
        "<div class=\"tile\"><p class=\"label\">{}</p><p class=\"big\">{numbers} <small>{}</small></p><p class=\"note\">{}</p></div>\n",
        escape(label),
        escape(unit),
        escape(note)
    )
}

/// Checks as a list.
pub(crate) fn remarks(checks: &[Check]) -> String {
    if checks.is_empty() {
        return String::new();
    }
    let mut out = String::from("<ul class=\"checks\">\n");
    for check in checks {
        let (class, mark, word) = match check.grade {
            Grade::Good => ("good", "✓", "Good: "),
            Grade::Warning => ("warning", "!", "Warning: "),
            Grade::Remark => ("remark", "i", "Remark: "),
        };
        let _ = writeln!(
            out,
            "<li class=\"{class}\"><i aria-hidden=\"true\">{mark}</i><span><span class=\"unseen\">{word}</span>{}</span></li>",
            escape(&check.text)
        );
    }
    out.push_str("</ul>\n");
    out
}
