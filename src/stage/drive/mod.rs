//! A drive: strips, inertial measurements and GNSS in one adjustment.
//!
//! Top down: surface lines of [`crate::stage::ties`] become ties of the smoother ([`ties`], [`choose`]); the smoother estimates the
//! trajectory and the calibration ([`constants`]) with them; the strips are corrected by the difference.

pub mod again;
pub mod alike;
pub mod calibrated;
pub mod check;
pub mod choose;
pub mod combine;
pub mod constants;
pub mod correction;
pub mod curve;
pub mod cut;
pub mod decided;
pub mod features;
pub mod known;
pub mod merge;
pub mod motion;
pub mod need;
mod notes;
pub mod over;
pub mod picked;
pub mod points;
pub mod residuals;
mod result;
pub mod seen;
pub mod spots;
pub mod spread;
pub mod stray;
pub mod surfaces;
pub mod ties;
pub mod variance;

use anyhow::{Context, Result, bail};
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{Inputs, Options, Pose, Solution, SurveyClock, Trajectory};
use tieline_io::crs::Crs;
use tieline_matching::xyz::{XyzKind, XyzPoint};

use crate::job::{Clock, Matched};
use crate::project::Project;
use crate::stage::navigate::{Measurements, options, smooth};
use again::{MeasuredAgain, measure_again};
use choose::{Chosen, choose};
use constants::{Constants, Term};
use correction::DriveCorrection;
pub use decided::{Decided, Decisions};
use known::Known;
pub(crate) use notes::notes_of_terms;
use points::{PointTie, point_ties};
pub use result::DriveSolution;
use seen::{Seen, seen_of};
use ties::{DriveLine, Sighted, range_span, sighted};

/// Why a drive without a reference system is refused.
const NO_CRS: &str = "the reference system of the strips is not known: set project.crs";
/// Why a drive without the trajectory that its strips were made with is refused.
const NO_TRAJECTORY: &str = "a drive needs the trajectory that its strips were made with: [trajectory]";
/// Ties are measured again so often at most, and no more once a smaller share of their pairs changes than this.
const MOST_MEASURED: usize = 4;
const SETTLED_SHARE: f64 = 0.02;
/// Rounds of variance components.
const MOST_ROUNDS: usize = 3;
/// Live landmark and clone states in a drive.
pub const MOST_LIVE: usize = 192;
/// And while the variances of ties are being found, for which fewer do.
const MOST_LIVE_IN_ROUNDS: usize = 96;

/// So far beyond its ends the new trajectory is held \[s\].
const HELD_S: f64 = 0.002;

/// The pose of a trajectory at a time \[s\], held a moment beyond the ends.
fn held_pose_at(trajectory: &Trajectory, time_s: f64) -> Option<Pose> {
    let (first, last) = trajectory.span_s();
    trajectory.pose_at(time_s.clamp(first, last)).filter(|_| time_s > first - HELD_S && time_s < last + HELD_S)
}

/// Seconds from the strips' clock to that of the measurements.
fn clock_shift_s(strips: &SurveyClock, measurements: &SurveyClock) -> f64 {
    match (strips.reference_week, measurements.reference_week) {
        (Some(a), Some(b)) => (f64::from(a) - f64::from(b)) * SECONDS_PER_WEEK,
        _ => 0.0,
    }
}

/// A drive that is ready to be adjusted.
#[derive(Debug)]
pub struct Prepared<'a> {
    project: &'a Project,
    matched: &'a Matched,
    measurements: &'a Measurements,
    known: &'a [Known],
    crs: &'a Crs,
    delivered: &'a Trajectory,
    clock_shift_s: f64,
    options: Options,
    again: Option<MeasuredAgain>,
    sighted: Sighted,
    /// Points picked by hand.
    picked: Vec<XyzPoint>,
    /// Nearest and farthest range of each scanner \[m\].
    pub ranges_m: Vec<(f64, f64)>,
    /// The same with the half per cent at either end left out \[m\].
    pub inner_ranges_m: Vec<(f64, f64)>,
    /// Where the ends of each scanner lie on the scales of incidence and intensity, where corrections over these are asked for or known.
    pub over: Vec<Seen>,
    /// What is to be said of the platform.
    pub notes: Vec<String>,
}

/// An adjustment with the sigmas that its ties turned out to have.
#[derive(Debug)]
pub struct Adjusted {
    /// The constants that were estimated.
    pub constants: Constants,
    /// The smoother's result.
    pub solution: Solution,
    inputs: Inputs,
    lines: Vec<DriveLine>,
    chosen: Chosen,
    points: (Vec<PointTie>, Vec<PointTie>),
}

impl<'a> Prepared<'a> {
    /// Looks at the parts of a drive; what is known of its scanners is taken as it is.
    ///
    /// # Errors
    /// When a part is missing, or does not fit the others.
    pub fn new(
        project: &'a Project,
        matched: &'a Matched,
        measurements: &'a Measurements,
        known: &'a [Known],
        memory_bytes: u64,
        clock: &mut Clock,
    ) -> Result<Self> {
        let crs = matched.survey.crs.as_ref().context(NO_CRS)?;
        let delivered = matched.poses.shared().context(NO_TRAJECTORY)?;
        let clock_shift_s = clock_shift_s(&matched.survey.clock, &measurements.clock);
        check::parts(project, matched, measurements, clock_shift_s)?;
        let scanners = matched.strips.scanner_numbers().len();
        let none = Constants::new(project, known, &vec![(1.0, 100.0); scanners], &[], |_, _| false);
        let sighted = clock.time("choose", || sighted(matched, None, crs, &none, clock_shift_s))?;
        let seen = sighted.delivered();
        if seen.is_empty() {
            bail!(
                "no surface is seen twice from the trajectory: check that strips, trajectory and IMU are of one drive"
            );
        }
        let mut notes = check::mounting(project, &check::beams_of(seen))?;
        let over = seen_of(project, known, &sighted, &none);
        notes.extend(over.iter().filter_map(Seen::note));
        let ranges_m: Vec<(f64, f64)> = (0..scanners).map(|s| range_span(seen, s, 0.0)).collect();
        let inner_ranges_m: Vec<(f64, f64)> = (0..scanners).map(|s| range_span(seen, s, 0.005)).collect();
        let mut options = options(project)?;
        options.memory_bytes = usize::try_from(memory_bytes).unwrap_or(usize::MAX);
        let picked = picked::points_of(project, matched)?;
        let for_found = if matched.spots.is_empty() && matched.features.is_empty() { 0 } else { spots::MOST_LIVE };
        let for_picked = point_ties(matched, &picked, crs, &none, clock_shift_s)?;
        options.ties.most_live = MOST_LIVE + for_found + points::most_live(for_picked.iter().map(|p| &p.tie));
        Ok(Self {
            project,
            matched,
            measurements,
            known,
            crs,
            delivered,
            clock_shift_s,
            options,
            again: None,
            sighted,
            picked,
            ranges_m,
            inner_ranges_m,
            over,
            notes,
        })
    }

    /// Measures the ties again as a correction moves their patches; adjustments after it use these. Gives the share of their pairs that changed against
    /// the measurement before.
    ///
    /// # Errors
    /// When a place cannot be projected.
    fn measure_again(&mut self, correction: &DriveCorrection, times: usize, clock: &mut Clock) -> Result<f64> {
        let none = Constants::new(self.project, self.known, &self.ranges_m, &[], |_, _| false);
        let mut again = clock.time("ties again", || measure_again(self.matched, self.delivered, &none, correction));
        let changed = again.changed(self.again.as_ref());
        again.gain.times = times;
        self.sighted =
            clock.time("choose", || sighted(self.matched, Some(&again), self.crs, &none, self.clock_shift_s))?;
        self.again = Some(again);
        Ok(changed)
    }

    /// A solution's trajectory in the map, on the clock of the strips.
    fn trajectory(&self, solution: &Solution, inputs: &Inputs) -> Result<Trajectory> {
        let geodetic = solution.trajectory(inputs, 0.0)?;
        Ok(self.crs.to_map(&geodetic)?.shifted_in_time(-self.clock_shift_s))
    }

    /// Numbers of the scanners as they stand in the files, in order.
    #[must_use]
    pub fn scanner_numbers(&self) -> &[u16] {
        self.matched.strips.scanner_numbers()
    }

    /// Adjusts until all terms that are left are needed: all terms first; then with the sigmas that ties turn out to have, and without terms that
    /// the data do not ask for. Constants and lines with which to begin may be at hand.
    fn settle(
        &self,
        mut at_hand: Option<(Constants, Vec<DriveLine>)>,
        decisions: &mut Decisions,
        rounds: &mut usize,
        clock: &mut Clock,
    ) -> Result<Adjusted> {
        loop {
            let adjusted = match at_hand.take() {
                Some((constants, lines)) => self.adjust_lines(constants, lines, decisions, rounds, clock)?,
                None => self.adjust(&self.ranges_m, &self.over, decisions, rounds, clock)?,
            };
            if decisions.judge(&adjusted.constants, &adjusted.solution.calibration) {
                return Ok(adjusted);
            }
        }
    }

    /// Adjusts with the terms that are decided for, range splines over `ranges_m`, others over what was `seen`, until the factors of the variances settle; `rounds` counts
    /// how often they have been found already.
    ///
    /// # Errors
    /// When the smoother fails.
    pub fn adjust(
        &self,
        ranges_m: &[(f64, f64)],
        seen: &[Seen],
        decisions: &mut Decisions,
        rounds: &mut usize,
        clock: &mut Clock,
    ) -> Result<Adjusted> {
        let wanted = |s, term: Term| decisions.takes(s, term) && over::is_asked(self.project, term);
        let constants = Constants::new(self.project, self.known, ranges_m, seen, wanted);
        let lines = clock.time("choose", || self.sighted.lines(&constants));
        self.adjust_lines(constants, lines, decisions, rounds, clock)
    }

    /// The same with constants and the lines that have their derivatives.
    fn adjust_lines(
        &self,
        constants: Constants,
        mut lines: Vec<DriveLine>,
        decisions: &mut Decisions,
        rounds: &mut usize,
        clock: &mut Clock,
    ) -> Result<Adjusted> {
        let options = Options { calibration_covariance: constants.covariance(), ..self.options.clone() };
        let once = |lines: &mut [DriveLine], decisions: &Decisions, most_live: usize, clock: &mut Clock| {
            let chosen = clock.time("choose", || {
                decisions.factors.apply(lines);
                choose(lines, &decisions.strays, most_live, self.delivered, self.clock_shift_s)
            });
            let factor_of = |kind: XyzKind| decisions.factor_of(kind);
            let mut found = spots::points_of(self.matched, factor_of(XyzKind::Texture));
            found.extend(features::points_of(&self.matched.features, &factor_of));
            found.extend_from_slice(&self.picked);
            let all = point_ties(self.matched, &found, self.crs, &constants, self.clock_shift_s)?;
            let points = spots::thinned(&all, chosen.ties.len() as u64);
            let ties = chosen.ties.iter().chain(points.iter().map(|p| &p.tie)).cloned().collect();
            let inputs = Inputs { ties, ..self.measurements.inputs.clone() };
            let solution = clock.time("smoother", || smooth(self.project, &inputs, &options))?;
            anyhow::Ok((chosen, (all, points), inputs, solution))
        };
        while *rounds < MOST_ROUNDS {
            let (chosen, points, inputs, solution) = once(&mut lines, decisions, MOST_LIVE_IN_ROUNDS, clock)?;
            let is_near = decisions.learn_sigmas(&solution.tie_fits, &lines, &chosen, &points.1);
            // strays are looked for once the first adjustment is there
            *rounds = if *rounds > 0 && is_near { MOST_ROUNDS } else { *rounds + 1 };
            let trajectory = self.trajectory(&solution, &inputs)?;
            decisions.strays = stray::find(&lines, &solution.calibration.value, &trajectory, self.clock_shift_s);
        }
        let (chosen, points, inputs, solution) = once(&mut lines, decisions, MOST_LIVE, clock)?;
        Ok(Adjusted { constants, solution, inputs, lines, chosen, points })
    }
}

/// Estimates trajectory and calibration of a drive, beyond what is known of its scanners; with ties as `match` found them first, then with those
/// measured again on the cloud that this corrects, until these hardly change. What was decided before is taken as it is, else it is found here.
///
/// # Errors
/// When a part is missing, or the smoother fails.
pub fn solve(
    project: &Project,
    matched: &Matched,
    measurements: &Measurements,
    known: &[Known],
    decided: Option<&Decided>,
    memory_bytes: u64,
    clock: &mut Clock,
) -> Result<DriveSolution> {
    let mut drive = Prepared::new(project, matched, measurements, known, memory_bytes, clock)?;
    let mut decisions = decided.map(|d| d.decisions.clone()).unwrap_or_default();
    let mut rounds = if decided.is_some() { MOST_ROUNDS } else { 0 };
    let is_again = project.matching.measure_again.unwrap_or(true);
    let mut moved_by = decided.and_then(|d| d.moved_by.clone()).filter(|_| is_again);
    if moved_by.is_none() && decisions.measured > 0 {
        // rows of other lines than those to begin with
        decisions.strays.clear();
        decisions.measured = 0;
    }
    let adjusted = if let Some(correction) = &moved_by {
        drive.measure_again(correction, decisions.measured, clock)?;
        drive.settle(None, &mut decisions, &mut rounds, clock)?
    } else {
        let mut adjusted = drive.settle(None, &mut decisions, &mut rounds, clock)?;
        for _ in 0..if is_again { MOST_MEASURED } else { 0 } {
            let Adjusted { constants, solution, inputs, .. } = adjusted;
            let trajectory = drive.trajectory(&solution, &inputs)?;
            let values = &solution.calibration.value;
            let correction = DriveCorrection::new(&constants, values, trajectory.clone());
            decisions.measured += 1;
            let changed = drive.measure_again(&correction, decisions.measured, clock)?;
            let lines = clock.time("choose", || {
                let mut lines = drive.sighted.lines(&constants);
                decisions.factors.apply(&mut lines);
                decisions.strays = stray::find(&lines, values, &trajectory, drive.clock_shift_s);
                lines
            });
            moved_by = Some(correction);
            // of other ties sigmas may be others
            rounds = if changed > SETTLED_SHARE { MOST_ROUNDS - 1 } else { MOST_ROUNDS };
            adjusted = drive.settle(Some((constants, lines)), &mut decisions, &mut rounds, clock)?;
            if changed <= SETTLED_SHARE {
                break;
            }
        }
        adjusted
    };
    let Adjusted { constants, solution, inputs, lines, chosen, points } = adjusted;
    let trajectory = drive.trajectory(&solution, &inputs)?;
    let mut notes = notes::notes_of(&chosen, &solution, &decisions.verdicts);
    notes.extend(drive.again.as_ref().map(|again| again.gain.note()));
    notes.extend(decisions.factors.note());
    notes.extend(spots::note((&points.0, &points.1), decisions.factor_of(XyzKind::Texture)));
    for (kind, name) in [(XyzKind::Corner, "corners of walls"), (XyzKind::Pole, "poles and trunks")] {
        notes.extend(features::note((&points.0, &points.1), kind, name, &decisions));
    }
    let astray = decisions.strays.len();
    notes.push(format!("{astray} lines that say something else than others of their kind about them were left out"));
    notes.extend(drive.notes);
    notes.extend(check::misfits(&constants, &solution.calibration.value, &lines));
    let mut drive = DriveSolution {
        solution,
        inputs,
        constants,
        lines,
        chosen,
        points,
        trajectory,
        clock_shift_s: drive.clock_shift_s,
        ranges_m: drive.inner_ranges_m,
        notes,
        decisions,
        again: drive.again,
        moved_by,
        picked: Vec::new(),
    };
    let shift_s = matched.survey.strip_files().next().map_or(0.0, |f| f.time_shift_s);
    drive.picked = picked::fates(&drive, shift_s);
    drive.notes.extend(picked::notes(&drive.picked));
    Ok(drive)
}
