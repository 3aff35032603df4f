//! What a person should be told of an adjustment.

use tieline_filter::Solution;

use super::choose::Chosen;
use super::constants::Term;
use super::need::Verdict;

/// What there is to say of the choice of ties and of the terms.
pub(super) fn notes_of(chosen: &Chosen, solution: &Solution, verdicts: &[Verdict]) -> Vec<String> {
    let mut notes = vec![format!(
        "{} ties for the smoother, made of {} surface lines: of like loop ties one every {:.2} s ({:.2} s on walls seen from another side), of like \
         increments one every {:.2} s",
        chosen.ties.len(),
        chosen.of.iter().map(Vec::len).sum::<usize>(),
        chosen.spacing_s.loop_s,
        chosen.spacing_s.turned_s,
        chosen.spacing_s.increment_s
    )];
    let left_out = solution.ties.iter().filter(|t| t.why_not == Some("innovation")).count();
    if left_out > 0 {
        notes.push(format!("{left_out} ties do not fit all the others and were left out"));
    }
    notes.extend(notes_of_terms(verdicts));
    notes
}

/// What there is to say of terms.
pub(crate) fn notes_of_terms(verdicts: &[Verdict]) -> Vec<String> {
    let mut notes = Vec::new();
    for v in verdicts {
        let (scanner, term) = (v.scanner, v.term.as_str());
        if !v.needed {
            notes.push(format!("scanner {scanner}, {term}: the data do not ask for it; fixed at its nominal value"));
        } else if v.term == Term::Range {
            notes.push(format!("scanner {scanner}, {term}: a common constant cannot be told from heights and lever arms; it is held near nothing"));
        } else if v.term.is_curve() {
            notes.push(format!(
                "scanner {scanner}, {term}: its mean over the data cannot be told from a constant of the range; it is held at zero"
            ));
        } else if v.not_seen > 0 {
            notes.push(format!(
                "scanner {scanner}, {term}: {} directions are not seen and kept near nominal",
                v.not_seen
            ));
        }
    }
    notes
}
