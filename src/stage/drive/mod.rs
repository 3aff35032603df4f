//! A drive: strips, inertial measurements and GNSS in one adjustment.
//!
//! Top down: surface lines of [`crate::stage::ties`] become ties of the smoother ([`ties`], [`choose`]); the smoother estimates the
//! trajectory and the calibration ([`constants`]) with them; the strips are corrected by the difference.

pub mod check;
pub mod choose;
pub mod constants;
pub mod curve;
pub mod known;
pub mod merge;
pub mod need;
pub mod residuals;
pub mod stray;
pub mod ties;
pub mod variance;

use std::collections::BTreeSet;

use anyhow::{Context, Result, bail};
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{Inputs, Pose, Solution, SurveyClock, Trajectory};

use crate::job::{Clock, Matched};
use crate::project::Project;
use crate::stage::navigate::{Measurements, options, smooth};
use choose::{Chosen, choose};
use constants::Constants;
use known::Known;
use need::{Verdict, judge};
use ties::{DriveLine, lines};
use variance::Factors;

/// Rounds of variance components.
const MOST_ROUNDS: usize = 3;
/// Live landmark and clone states in a drive.
pub const MOST_LIVE: usize = 128;

/// What became of a drive.
#[derive(Debug)]
pub struct DriveSolution {
    /// The smoother's.
    pub solution: Solution,
    /// What it was given, ties included.
    pub inputs: Inputs,
    /// The constants of the calibration.
    pub constants: Constants,
    /// Lines with their ends.
    pub lines: Vec<DriveLine>,
    /// Which of them became ties.
    pub chosen: Chosen,
    /// The new trajectory in the map, on the clock of the strips.
    pub trajectory: Trajectory,
    /// Seconds from the strips' clock to that of the measurements.
    pub clock_shift_s: f64,
    /// Nearest and farthest range of each scanner in use, the half per cent at either end left out \[m\].
    pub ranges_m: Vec<(f64, f64)>,
    /// What a person should be told.
    pub notes: Vec<String>,
    /// Which terms of the calibration the data ask for.
    pub verdicts: Vec<Verdict>,
}

impl DriveSolution {
    /// The new pose at a time of the strips' clock, in the map; held a moment beyond the ends, where GNSS and IMU end before
    /// the last profile.
    #[must_use]
    pub fn pose_at(&self, time_s: f64) -> Option<Pose> {
        let (first, last) = self.trajectory.span_s();
        self.trajectory.pose_at(time_s.clamp(first, last)).filter(|_| time_s > first - HELD_S && time_s < last + HELD_S)
    }
}

/// So far beyond its ends the new trajectory is held \[s\].
const HELD_S: f64 = 0.002;

/// Seconds from the strips' clock to that of the measurements.
fn clock_shift_s(strips: &SurveyClock, measurements: &SurveyClock) -> f64 {
    match (strips.reference_week, measurements.reference_week) {
        (Some(a), Some(b)) => (f64::from(a) - f64::from(b)) * SECONDS_PER_WEEK,
        _ => 0.0,
    }
}

/// Estimates trajectory and calibration of a drive, beyond what is known of its scanners.
///
/// # Errors
/// When a part is missing, or the smoother fails.
pub fn solve(
    project: &Project,
    matched: &Matched,
    measurements: &Measurements,
    known: &[Known],
    memory_bytes: u64,
    clock: &mut Clock,
) -> Result<DriveSolution> {
    let crs =
        matched.survey.crs.as_ref().context("the reference system of the strips is not known: set project.crs")?;
    let delivered = matched.poses.shared().context("a drive needs its trajectory: [trajectory]")?;
    let shift_s = clock_shift_s(&matched.survey.clock, &measurements.clock);
    check::parts(project, matched, measurements, shift_s)?;
    let scanners = matched.strips.scanner_numbers().len();
    let none = Constants::new(project, known, &vec![(1.0, 100.0); scanners], |_, _| false);
    let seen = clock.time("choose", || lines(matched, crs, &none, shift_s))?;
    if seen.is_empty() {
        bail!("no surface is seen twice from the trajectory: check that strips, trajectory and IMU are of one drive");
    }
    let of_platform = check::mounting(project, &seen)?;
    let ranges_m: Vec<(f64, f64)> = (0..scanners).map(|s| range_span(&seen, s, 0.0)).collect();
    let inner_m: Vec<(f64, f64)> = (0..scanners).map(|s| range_span(&seen, s, 0.005)).collect();
    let mut options = options(project)?;
    options.memory_bytes = usize::try_from(memory_bytes).unwrap_or(usize::MAX);
    options.ties.most_live = MOST_LIVE;
    let mut verdicts: Vec<Verdict> = Vec::new();
    let (mut factors, mut rounds, mut strays) = (Factors::default(), 0, BTreeSet::new());
    // all terms first; then with the sigmas that ties turn out to have, and without terms that the data do not ask for
    loop {
        let constants = Constants::new(project, known, &ranges_m, |scanner, term| {
            verdicts.iter().all(|v| v.needed || (v.scanner, v.term) != (scanner, term))
        });
        let (lines, chosen) = clock.time("choose", || {
            let mut lines = lines(matched, crs, &constants, shift_s)?;
            factors.apply(&mut lines);
            let chosen = choose(&lines, &strays, MOST_LIVE, delivered, shift_s);
            anyhow::Ok((lines, chosen))
        })?;
        options.calibration_covariance = constants.covariance();
        let inputs = Inputs { ties: chosen.ties.clone(), ..measurements.inputs.clone() };
        let solution = clock.time("smoother", || smooth(project, &inputs, &options))?;
        let geodetic = solution.trajectory(&inputs, 0.0)?;
        let trajectory = crs.to_map(&geodetic)?.shifted_in_time(-shift_s);
        let found = factors.after(&solution.tie_fits, &lines, &chosen);
        if rounds < MOST_ROUNDS && (rounds == 0 || !found.is_near(&factors)) {
            rounds += 1;
            factors = found;
            strays = stray::find(&lines, &solution.calibration.value, &trajectory, shift_s);
            continue;
        }
        let judged = judge(&constants, &solution.calibration);
        let dropped = judged.iter().filter(|v| !v.needed).count();
        verdicts.retain(|v| !v.needed);
        verdicts.extend(judged);
        if dropped > 0 {
            continue;
        }
        verdicts.sort_by_key(|v| (v.scanner, v.term));
        let mut notes = notes_of(&chosen, &solution, &verdicts);
        notes.extend(factors.note());
        notes.push(format!(
            "{} lines that say something else than others of their kind about them were left out",
            strays.len()
        ));
        notes.extend(of_platform);
        notes.extend(check::misfits(&constants, &solution.calibration.value, &lines));
        return Ok(DriveSolution {
            solution,
            inputs,
            constants,
            lines,
            chosen,
            trajectory,
            clock_shift_s: shift_s,
            ranges_m: inner_m,
            notes,
            verdicts,
        });
    }
}

/// What there is to say of the choice of ties and of the terms.
fn notes_of(chosen: &Chosen, solution: &Solution, verdicts: &[Verdict]) -> Vec<String> {
    let mut notes = vec![format!(
        "{} ties for the smoother, made of {} surface lines: of like loop ties one every {:.2} s, of like increments one every {:.2} s",
        chosen.ties.len(),
        chosen.of.iter().map(Vec::len).sum::<usize>(),
        chosen.spacing_s.0,
        chosen.spacing_s.1
    )];
    let left_out = solution.ties.iter().filter(|t| t.why_not == Some("innovation")).count();
    if left_out > 0 {
        notes.push(format!("{left_out} ties do not fit all the others and were left out"));
    }
    for v in verdicts {
        let (scanner, term) = (v.scanner, v.term.as_str());
        if !v.needed {
            notes.push(format!("scanner {scanner}, {term}: the data do not ask for it; fixed at its nominal value"));
        } else if v.term == constants::Term::Range {
            notes.push(format!("scanner {scanner}, {term}: a common constant cannot be told from heights and lever arms; it is held near nothing"));
        } else if v.not_seen > 0 {
            notes.push(format!(
                "scanner {scanner}, {term}: {} directions are not seen and kept near nominal",
                v.not_seen
            ));
        }
    }
    notes
}

/// Nearest and farthest range of a scanner's ends \[m\], a share at either end left out.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn range_span(lines: &[DriveLine], scanner: usize, left_out: f64) -> (f64, f64) {
    let mut ranges: Vec<f64> =
        lines.iter().flat_map(|l| &l.ends).filter(|e| usize::from(e.scanner) == scanner).map(|e| e.range_m).collect();
    ranges.sort_by(f64::total_cmp);
    let cut = (left_out * ranges.len() as f64) as usize;
    let ranges = &ranges[cut.min(ranges.len())..ranges.len() - cut.min(ranges.len())];
    match ranges {
        [] => (1.0, 100.0),
        [first, .., last] => (first.max(0.3), last.max(first + 1.0)),
        [one] => (*one, one + 1.0),
    }
}
