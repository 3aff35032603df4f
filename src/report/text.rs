//! The end of a run in three lines, for the terminal.

use std::path::Path;

use super::data::Summary;
use super::findings::{Grade, checks, is_adjusted};
use super::number::{counted, mm};

/// What got better, what to look at or cannot be known, and where the report lies.
#[must_use]
pub fn three_lines(summary: &Summary, report: &Path) -> String {
    format!("{}\n{}\nReport: {}", what_got_better(summary), what_to_look_at(summary), report.display())
}

fn what_got_better(summary: &Summary) -> String {
    let d = &summary.discrepancy;
    if d.before.n == 0 {
        return String::from("No ties were found between the strips.");
    }
    let pairs = counted(summary.pairs.len(), "pair", "pairs");
    if !is_adjusted(summary) {
        return format!("Strips differ by {} mm (rms, {pairs}); not adjusted.", mm(d.before.rms_m));
    }
    let held_out = if d.held_out_after.n == 0 {
        String::from("no ties held out")
    } else {
        format!("held-out ties {} -> {} mm", mm(d.held_out_before.rms_m), mm(d.held_out_after.rms_m))
    };
    format!("Strips differed by {} mm, now {} mm (rms, {pairs}); {held_out}.", mm(d.before.rms_m), mm(d.after.rms_m))
}

fn what_to_look_at(summary: &Summary) -> String {
    let warnings = checks(summary).iter().filter(|c| c.grade == Grade::Warning).count();
    let warnings = match warnings {
        0 => String::from("No warnings"),
        n => counted(n, "warning", "warnings"),
    };
    let held = summary.calibration.unobservable.len();
    let held = match held {
        0 => String::from("everything estimated is determined by the ties"),
        n => format!(
            "{} cannot be known from these strips and kept to the prior",
            counted(n, "combination", "combinations")
        ),
    };
    if is_adjusted(summary) { format!("{warnings}; {held}.") } else { format!("{warnings}.") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::example;

    #[test]
    fn a_run_ends_with_three_lines() {
        let (summary, _) = example::survey(4, 500);
        let text = three_lines(&summary, Path::new("out/block/report.html"));
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3);
        assert!(lines[0].contains(&format!("now {} mm", mm(summary.discrepancy.after.rms_m))));
        assert!(lines[1].contains("cannot be known"));
        assert_eq!(lines[2], "Report: out/block/report.html");
        assert_eq!(three_lines(&Summary::default(), Path::new("r")).lines().count(), 3);
    }
}
