//! What one adjustment decides, and what it leaves for another.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use tieline_filter::{CalibrationEstimate, TieFit};
use tieline_matching::xyz::XyzKind;

use super::choose::Chosen;
use super::constants::{Constants, Term};
use super::correction::DriveCorrection;
use super::merge::Part;
use super::need::{Verdict, judge};
use super::points::{PointFactors, PointTie, factors_after};
use super::ties::DriveLine;
use super::variance::Factors;

/// What an adjustment decides before its last pass; with these another one goes there at once.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
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
    /// The same as `factors` of points, by how they were found.
    #[serde(default)]
    pub of_points: PointFactors,
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

    /// Takes the sigmas of ties from how they fit a solution that was made with those before, points standing after lines; whether those of lines are about the same.
    pub fn learn_sigmas(&mut self, fits: &[TieFit], lines: &[DriveLine], chosen: &Chosen, points: &[PointTie]) -> bool {
        let first_point = chosen.ties.len();
        let of_lines: Vec<TieFit> = fits.iter().filter(|f| f.tie < first_point).copied().collect();
        let found = self.factors.after(&of_lines, lines, chosen);
        self.of_points = factors_after(fits, first_point, points, &self.of_points);
        let is_near = found.is_near(&self.factors);
        self.factors = found;
        is_near
    }

    /// What the variances of points turned out to be multiplied by.
    #[must_use]
    pub fn factor_of(&self, kind: XyzKind) -> f64 {
        self.of_points.get(&kind).copied().unwrap_or(1.0)
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
