//! What the numbers of a [`Summary`] say: sentences for the first screen, and checks that are passed or not.

use super::data::{PairSummary, Summary};
use super::number::{count, counted, fixed, length, mm};

/// Held-out ties may be worse than used ones by this factor before the adjustment counts as fitted to its ties.
const HELD_OUT_RATIO: f64 = 1.10;
/// Held-out ties may be off zero by this much \[m\] in the median.
const HELD_OUT_MEDIAN_M: f64 = 1e-3;
/// Pairs with fewer differences than this are not called the worst.
const PAIR_DIFFERENCES: usize = 10;
/// Sigma of unit weight outside this range means sigmas that are off.
const SIGMA0: std::ops::RangeInclusive<f64> = 0.7..=1.4;
/// Largest share of outliers that is nothing to look at.
const OUTLIER_SHARE: f64 = 0.05;

/// How a check came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Grade {
    /// As it should be.
    Good,
    /// To be looked at before the result is used.
    Warning,
    /// Worth knowing.
    Remark,
}

/// A check and its outcome in words.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Check {
    /// Outcome.
    pub(crate) grade: Grade,
    /// What was looked at and found.
    pub(crate) text: String,
}

impl Check {
    /// A check.
    pub(crate) fn new(grade: Grade, text: String) -> Self {
        Self { grade, text }
    }

    /// Good, or a warning.
    pub(crate) fn good_if(good: bool, text: String) -> Self {
        Self::new(if good { Grade::Good } else { Grade::Warning }, text)
    }

    /// Warnings come first, remarks last.
    pub(crate) fn place(&self) -> u8 {
        match self.grade {
            Grade::Warning => 0,
            Grade::Good => 1,
            Grade::Remark => 2,
        }
    }
}

/// The pair with the largest size of a value, among those with enough differences (among all where none has).
pub(crate) fn worst_pair(pairs: &[PairSummary], value: fn(&PairSummary) -> f64) -> Option<&PairSummary> {
    let enough = pairs.iter().any(|p| p.before.n.max(p.after.n) >= PAIR_DIFFERENCES);
    pairs
        .iter()
        .filter(|p| !enough || p.before.n.max(p.after.n) >= PAIR_DIFFERENCES)
        .filter(|p| value(p).is_finite())
        .max_by(|a, b| value(a).abs().total_cmp(&value(b).abs()))
}

/// Both names of a pair.
pub(crate) fn pair_name(pair: &PairSummary) -> String {
    format!("{} and {}", pair.a, pair.b)
}

/// Whether differences after an adjustment are known.
pub(crate) fn is_adjusted(summary: &Summary) -> bool {
    summary.discrepancy.after.n > 0
}

/// What got better, in three sentences.
pub(crate) fn sentences(summary: &Summary) -> Vec<String> {
    let d = &summary.discrepancy;
    if d.before.n == 0 {
        return vec![
            String::from("No ties were found between the strips, so nothing could be compared or adjusted."),
            String::from("The rejections and settings below say what was looked for and why it was not taken."),
        ];
    }
    let pairs = counted(summary.pairs.len(), "pair", "pairs");
    let n = length(d.before.n);
    if !is_adjusted(summary) {
        let mut all = vec![format!(
            "Where strips overlap they differ by {} mm (rms of {n} differences of {pairs}); nothing has been adjusted yet.",
            mm(d.before.rms_m)
        )];
        all.extend(worst_pair(&summary.pairs, |p| p.before.median_m).map(|worst| {
            format!(
                "The worst pair, {}, is apart by {} mm (median).",
                pair_name(worst),
                mm(worst.before.median_m.abs())
            )
        }));
        return all;
    }
    let (before, after) = (mm(d.before.rms_m), mm(d.after.rms_m));
    let first = if d.after.rms_m < d.before.rms_m {
        format!(
            "Where strips overlap they differed by {before} mm; after the adjustment they differ by {after} mm (rms of {n} differences of {pairs})."
        )
    } else {
        format!(
            "The adjustment did not help: strips differed by {before} mm before and differ by {after} mm after (rms of {n} differences of {pairs})."
        )
    };
    let mut all = vec![first, held_out_sentence(summary)];
    let worst = |value| worst_pair(&summary.pairs, value);
    if let (Some(before), Some(after)) = (worst(|p| p.before.median_m), worst(|p| p.after.median_m)) {
        all.push(format!(
            "The worst pair was apart by {} mm in the median ({}); the worst is now {} mm ({}).",
            mm(before.before.median_m.abs()),
            pair_name(before),
            mm(after.after.median_m.abs()),
            pair_name(after)
        ));
    }
    all
}

/// What the ties say that took no part.
fn held_out_sentence(summary: &Summary) -> String {
    let d = &summary.discrepancy;
    if d.held_out_after.n == 0 {
        return String::from("No ties were held out, so nothing independent confirms this.");
    }
    let (before, after) = (mm(d.held_out_before.rms_m), mm(d.held_out_after.rms_m));
    let n = length(d.held_out_after.n);
    let better = d.held_out_after.rms_m < d.held_out_before.rms_m;
    let agree = d.held_out_after.rms_m <= HELD_OUT_RATIO * d.after.rms_m;
    match (better, agree) {
        (true, true) => format!(
            "Ties that took no part in the adjustment confirm it: {before} mm before, {after} mm after ({n} differences)."
        ),
        (true, false) => format!(
            "Ties that took no part got better too, from {before} to {after} mm ({n} differences), yet less than the ties used: a part of the gain is fitted to the ties."
        ),
        (false, _) => format!(
            "Ties that took no part did not get better: {before} mm before, {after} mm after ({n} differences). Do not use this result as it is."
        ),
    }
}

/// Everything worth a remark on the first screen.
pub(crate) fn checks(summary: &Summary) -> Vec<Check> {
    let mut checks = Vec::new();
    if is_adjusted(summary) {
        held_out(summary, &mut checks);
        pairs(summary, &mut checks);
        strips(summary, &mut checks);
        adjustment(summary, &mut checks);
    }
    checks.extend(summary.calibration.warnings.iter().map(|w| Check::new(Grade::Warning, w.clone())));
    checks.sort_by_key(Check::place);
    checks
}

fn held_out(summary: &Summary, checks: &mut Vec<Check>) {
    let d = &summary.discrepancy;
    if d.held_out_after.n == 0 {
        checks.push(Check::new(Grade::Warning, String::from("No ties were held out: over-adjustment cannot be seen.")));
        return;
    }
    let ratio = d.held_out_after.rms_m / d.after.rms_m;
    checks.push(Check::good_if(
        ratio <= HELD_OUT_RATIO,
        format!(
            "Held-out ties are {} × as far apart as used ones (rms; up to {HELD_OUT_RATIO:.2} is good).",
            fixed(ratio, 2)
        ),
    ));
    let median_m = d.held_out_after.median_m;
    checks.push(Check::good_if(
        median_m.abs() <= HELD_OUT_MEDIAN_M,
        format!(
            "The median of the held-out ties is {} mm (within {} mm is good).",
            mm(median_m),
            mm(HELD_OUT_MEDIAN_M)
        ),
    ));
}

/// Whether a pair is further apart after than before, by more than chance.
pub(crate) fn got_worse(pair: &PairSummary) -> bool {
    if pair.after.n < PAIR_DIFFERENCES {
        return false;
    }
    let chance_m = 3.0 * pair.after.sigma_mad_m / (pair.after.n as f64).sqrt();
    pair.after.median_m.abs() > pair.before.median_m.abs() + chance_m.max(1e-3)
}

fn pairs(summary: &Summary, checks: &mut Vec<Check>) {
    let worse: Vec<String> = summary.pairs.iter().filter(|p| got_worse(p)).map(pair_name).collect();
    let text = if worse.is_empty() {
        String::from("No pair of strips is further apart than before.")
    } else {
        format!(
            "{} further apart than before: {}.",
            counted(worse.len(), "pair is", "pairs are"),
            shortened(&worse, "; ")
        )
    };
    checks.push(Check::good_if(worse.is_empty(), text));
}

fn strips(summary: &Summary, checks: &mut Vec<Check>) {
    let far: Vec<String> = summary.strips.iter().filter(|s| s.implausible).map(|s| s.name.clone()).collect();
    let text = if far.is_empty() {
        String::from("Every correction is plausible for the accuracy of the trajectory.")
    } else {
        let are = counted(far.len(), "strip is", "strips are");
        format!(
            "{are} corrected by more than the accuracy of the trajectory makes plausible: {}.",
            shortened(&far, ", ")
        )
    };
    checks.push(Check::good_if(far.is_empty(), text));
}

fn adjustment(summary: &Summary, checks: &mut Vec<Check>) {
    let c = &summary.calibration;
    if c.sigma0.is_finite() && c.sigma0 > 0.0 {
        let good = SIGMA0.contains(&c.sigma0);
        let meaning = match (good, c.sigma0 > 1.0) {
            (true, _) => "the sigmas of the ties are right",
            (false, true) => "the ties are worse than their sigmas say",
            (false, false) => "the ties are better than their sigmas say",
        };
        checks.push(Check::good_if(good, format!("Sigma of unit weight is {}: {meaning}.", fixed(c.sigma0, 2))));
    }
    let n = summary.discrepancy.after.n + c.outliers;
    let share = c.outliers as f64 / n as f64;
    checks.push(Check::good_if(
        share <= OUTLIER_SHARE,
        format!(
            "{} of {} observations ({} %) were taken out as outliers.",
            length(c.outliers),
            length(n),
            fixed(share * 100.0, 1)
        ),
    ));
    if !c.unobservable.is_empty() {
        let held = counted(c.unobservable.len(), "combination", "combinations");
        let text =
            format!("{held} of parameters cannot be known from these strips and kept to the prior; see Calibration.");
        checks.push(Check::new(Grade::Remark, text));
    }
    if !summary.notes.is_empty() {
        let notes = counted(summary.notes.len(), "remark", "remarks");
        checks.push(Check::new(Grade::Remark, format!("{notes} from the stages; see Remarks.")));
    }
}

/// The first of many names, and how many more there are.
fn shortened(names: &[String], between: &str) -> String {
    const SHOWN: usize = 5;
    let first = names[..names.len().min(SHOWN)].join(between);
    if names.len() > SHOWN {
        format!("{first}{between}and {} more", count((names.len() - SHOWN) as u64))
    } else {
        first
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::data::Discrepancy;
    use crate::report::example;

    #[test]
    fn three_sentences_tell_what_got_better() {
        let (summary, _) = example::survey(4, 500);
        let all = sentences(&summary);
        assert_eq!(all.len(), 3);
        assert!(all[0].contains(&mm(summary.discrepancy.before.rms_m)) && all[1].contains("confirm"));
    }

    #[test]
    fn held_out_ties_that_stay_behind_are_a_warning() {
        let (mut summary, _) = example::survey(4, 500);
        summary.discrepancy.held_out_after.rms_m = 2.0 * summary.discrepancy.after.rms_m;
        assert!(sentences(&summary)[1].contains("fitted to the ties"));
        assert!(checks(&summary).iter().any(|c| c.grade == Grade::Warning && c.text.contains("2.00 ×")));
        summary.discrepancy.held_out_after.rms_m = 1.0;
        assert!(sentences(&summary)[1].contains("Do not use"));
    }

    #[test]
    fn a_pair_that_got_worse_is_named() {
        let (mut summary, _) = example::survey(4, 500);
        summary.pairs[0].after = Discrepancy { median_m: 0.2, n: 100, ..Discrepancy::default() };
        let name = pair_name(&summary.pairs[0]);
        assert!(checks(&summary).iter().any(|c| c.grade == Grade::Warning && c.text.contains(&name)));
    }

    #[test]
    fn nothing_found_and_nothing_adjusted_are_said() {
        assert!(sentences(&Summary::default())[0].starts_with("No ties"));
        assert!(checks(&Summary::default()).is_empty());
        let (mut summary, _) = example::survey(4, 500);
        summary.discrepancy.after = Discrepancy::default();
        assert!(sentences(&summary)[0].contains("nothing has been adjusted yet"));
    }
}
