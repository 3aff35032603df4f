//! What one adjustment decides, and what it leaves for another.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use tieline_filter::{CalibrationEstimate, TieFit};

use super::choose::Chosen;
use super::constants::{Constants, Term};
use super::correction::DriveCorrection;
use super::merge::Part;
use super::need::{Verdict, judge};
use super::spots::factor_after;
use super::ties::DriveLine;
use super::variance::Factors;

/// What an adjustment decides before its last pass; with these another one goes there at once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Decisions {
    /// What the variances of ties turned out to be multiplied by.
    pub factors: Factors,
    /// Which terms of the calibration the data ask for.
    pub verdicts: Vec<Verdict>,
    /// Lines, by row, and visits that say something else than others of their kind.
    #[serde(default)]
    pub strays: BTreeSet<Part>,
    /// How often ties were measured again on the cloud as corrected so far.
    #[serde(default)]
    pub measured: usize,
    /// The same as `factors` of spots of pavement.
    #[serde(default = "one")]
    pub of_spots: f64,
}

fn one() -> f64 {
    1.0
}

impl Default for Decisions {
    fn default() -> Self {
        Self {
            factors: Factors::default(),
            verdicts: Vec::new(),
            strays: BTreeSet::new(),
            measured: 0,
            of_spots: one(),
        }
    }
}

impl Decisions {
    /// Judges the terms that were estimated; whether all of them are needed, so that nothing is left to be adjusted again without.
    pub fn judge(&mut self, constants: &Constants, estimate: &CalibrationEstimate) -> bool {
        let judged = judge(constants, estimate);
        let settled = judged.iter().all(|v| v.needed);
        self.verdicts.retain(|v| !v.needed);
        self.verdicts.extend(judged);
        self.verdicts.sort_by_key(|v| (v.scanner, v.term));
        settled
    }

    /// Takes the sigmas of ties from how they fit a solution that was made with those before, spots standing after lines; whether those of lines are about the same.
    pub fn learn_sigmas(&mut self, fits: &[TieFit], lines: &[DriveLine], chosen: &Chosen) -> bool {
        let first_spot = chosen.ties.len();
        let of_lines: Vec<TieFit> = fits.iter().filter(|f| f.tie < first_spot).copied().collect();
        let found = self.factors.after(&of_lines, lines, chosen);
        self.of_spots = factor_after(fits, first_spot, self.of_spots);
        let is_near = found.is_near(&self.factors);
        self.factors = found;
        is_near
    }

    /// Whether a term is in the adjustment.
    #[must_use]
    pub fn takes(&self, scanner: usize, term: Term) -> bool {
        self.verdicts.iter().all(|v| v.needed || (v.scanner, v.term) != (scanner, term))
    }
}

/// What an earlier adjustment leaves for one that goes there at once.
#[derive(Debug, Clone)]
pub struct Decided {
    /// What it decided.
    pub decisions: Decisions,
    /// What it moved patches by to measure ties again; the first adjustment is made for it where this is none.
    pub moved_by: Option<DriveCorrection>,
}
