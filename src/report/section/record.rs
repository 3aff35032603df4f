//! For the record: remarks, settings, files, times.

use crate::report::data::Summary;
use crate::report::html::{Align, Table, bar, escape, list, section};
use crate::report::number::{bytes, count, duration, fixed};

const SETTING_LEAD: &str = "Everything that was not asked for follows from the data, for the reason given. Each can be set in \
the project file under the key shown.";
const FILE_LEAD: &str = "Points keep their order and all their attributes; only coordinates change. What else differs from the \
input is listed.";
/// Stages in the order of the job; others come after.
const STAGES: [&str; 11] =
    ["scan", "match", "ties", "choose", "smoother", "calibrate", "solve", "adjust", "correct", "write", "report"];

/// Remarks of the stages.
pub(crate) fn remarks(summary: &Summary) -> String {
    if summary.notes.is_empty() { String::new() } else { section("remarks", "Remarks", "", &list(&summary.notes)) }
}

/// Settings with their reasons.
pub(crate) fn settings(summary: &Summary) -> String {
    let columns = [("Key", "", Align::Text), ("Value", "", Align::Text), ("Reason", "", Align::Prose)];
    let mut table = Table::new("Settings", &columns);
    for s in &summary.settings {
        table.row_of_html("", &[format!("<code>{}</code>", escape(&s.key)), escape(&s.value), escape(&s.reason)]);
    }
    let body = table.html();
    if body.is_empty() { body } else { section("settings", "Settings", SETTING_LEAD, &body) }
}

/// Files read and written.
pub(crate) fn files(summary: &Summary) -> String {
    let mut read = Table::new("Files read", &[("File", "", Align::Prose), ("Points", "", Align::Number)]);
    for (path, points) in &summary.inputs {
        read.row(&[path.clone(), count(*points)]);
    }
    let mut written = Table::new(
        "Files written",
        &[
            ("File", "", Align::Prose),
            ("From", "", Align::Prose),
            ("Points", "", Align::Number),
            ("Largest shift", "m", Align::Number),
            ("Scale", "m", Align::Number),
            ("Changed in the header, and remarks", "", Align::Prose),
        ],
    );
    for file in &summary.files {
        let same = file.scale_m.iter().all(|s| s.to_bits() == file.scale_m[0].to_bits());
        let scales: Vec<String> = file.scale_m.iter().take(if same { 1 } else { 3 }).map(f64::to_string).collect();
        let notes: Vec<String> = file.notes.iter().map(|n| escape(n)).collect();
        written.row_of_html(
            "",
            &[
                escape(&file.output),
                escape(&file.input),
                count(file.points),
                fixed(file.largest_shift_m, 3),
                scales.join(" / "),
                notes.join("<br>"),
            ],
        );
    }
    let mut body = written.html();
    let lead = if body.is_empty() { "" } else { FILE_LEAD };
    body += &read.html();
    if body.is_empty() { body } else { section("files", "Files", lead, &body) }
}

/// The trajectory, times and memory.
pub(crate) fn times(summary: &Summary) -> String {
    let mut trajectory = Table::new("Trajectory", &[("Figure", "", Align::Text), ("Value", "", Align::Prose)]);
    for (key, value) in &summary.trajectory {
        trajectory.row(&[key.replace('_', " "), value.clone()]);
    }
    let columns = [("Stage", "", Align::Text), ("Time", "", Align::Number), ("Share", "", Align::Text)];
    let mut stages = Table::new("Time by stage", &columns);
    let mut timed: Vec<(&String, f64)> = summary.timing.stage.iter().map(|(s, t)| (s, *t)).collect();
    timed.sort_by_key(|(stage, _)| STAGES.iter().position(|s| s == stage).unwrap_or(STAGES.len()));
    let total: f64 = timed.iter().map(|t| t.1).sum();
    for (stage, seconds) in timed {
        stages.row_of_html("", &[escape(stage), duration(seconds), bar(seconds / total, "quiet")]);
    }
    let mut facts = vec![format!("{} in all", duration(total))];
    if summary.timing.points_per_second > 0.0 {
        facts.push(format!("{} million points a second", fixed(summary.timing.points_per_second * 1e-6, 2)));
    }
    if summary.peak_memory_bytes > 0 {
        facts.push(format!("at most {} of memory", bytes(summary.peak_memory_bytes)));
    }
    let facts = if summary.timing.stage.is_empty() { String::new() } else { format!("<p>{}.</p>\n", facts.join(", ")) };
    let body = format!("{facts}<div class=\"beside\">\n{}{}</div>\n", stages.html(), trajectory.html());
    section("times", "Trajectory, time and memory", "", &body)
}
