//! From the result of a drive to what its report tells.

use std::collections::BTreeMap;

use tieline_filter::TieKind;

use crate::outputs::drive::points::fate;
use crate::outputs::drive::{corrections, ranges_of_curve};
use crate::report::data::{Discrepancies, Discrepancy, TieCounts};
use crate::report::drive::DriveReport;
use crate::report::drive::curves::{CurveSummary, OverCurveSummary};
use crate::report::drive::data::{
    ClassSummary, DriveCalibration, DriveCharts, DriveStrip, DriveSummary, DriveTrajectory, EstimateSummary,
    InnovationSummary, LargestCorrection, MeasurementCounts, Origin, Outage, PairPoint, TermSummary, TieInnovation,
};
use crate::report::drive::{pairs, ranges};
use crate::stage::drive::calibrated::Calibrated;
use crate::stage::drive::constants::Term;
use crate::stage::drive::seen::OverSpline;
use crate::stage::drive::ties::Class;
use crate::stage::drive::{DriveSolution, cut};

/// A longer gap between GNSS fixes is an outage \[s\].
const OUTAGE_S: f64 = 5.0;
/// Spacing of the differences of the trajectories \[s\].
const SPACING_S: f64 = 0.1;

/// Summary and charts of a drive; corrected files, times and memory are filled in later.
pub(crate) fn gather(report: &DriveReport<'_>) -> (DriveSummary, DriveCharts) {
    let (matched, drive) = (report.matched, report.drive);
    let charts = charts(report);
    let inputs = &report.measurements.inputs;
    let name_of = |path: &std::path::Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let values = |held: bool, of: fn(&(f64, f64, bool)) -> f64| -> Discrepancy {
        let chosen = charts.lines.iter().filter(|l| l.2 == held);
        Discrepancy::of(&chosen.map(of).filter(|v| v.is_finite()).collect::<Vec<_>>())
    };
    let discrepancy = Discrepancies {
        before: values(false, |l| l.0),
        after: values(false, |l| l.1),
        held_out_before: values(true, |l| l.0),
        held_out_after: values(true, |l| l.1),
    };
    let (ties, ties_by_class) = ties(report, &charts.pairs);
    let summary = DriveSummary {
        version: String::from(env!("CARGO_PKG_VERSION")),
        name: String::from(report.project.name()),
        inputs: matched.survey.files.iter().map(|f| (name_of(f.las.path()), f.las.header().point_count)).collect(),
        measurements: MeasurementCounts {
            imu_samples: inputs.imu.samples().len(),
            imu_interval_s: inputs.imu.interval_s(),
            gnss_fixes: inputs.gnss.len(),
            odometer_readings: inputs.odometer.len(),
            known_points: inputs.points.len(),
        },
        crs: matched.survey.crs.as_ref().map_or_else(|| String::from("local metres"), |c| String::from(c.name())),
        settings: matched.settings.clone(),
        strips: strips(report, &charts),
        ties,
        ties_by_class,
        rejected: rejected(report),
        measured_again: drive.again.as_ref().map(|a| a.gain),
        discrepancy,
        difference_over: ranges::differences(&charts.pairs),
        calibration: calibration(&drive.calibrated()),
        trajectory: trajectory(report, &charts),
        notes: report.notes.to_vec(),
        ..DriveSummary::default()
    };
    (summary, charts)
}

fn charts(report: &DriveReport<'_>) -> DriveCharts {
    let (matched, drive) = (report.matched, report.drive);
    let strips = matched.strips.strips();
    let span_s = (
        strips.iter().map(|s| s.start_s).fold(f64::INFINITY, f64::min),
        strips.iter().map(|s| s.end_s).fold(f64::NEG_INFINITY, f64::max),
    );
    let corrections = corrections(matched, drive, SPACING_S);
    let old = matched.poses.shared();
    let sigma_before = corrections
        .iter()
        .map(|row| {
            let sigma = old?.sigma_at(row.time_s)?;
            let (p, r) = (sigma.position_ned_m, sigma.attitude_rph_rad);
            Some([p.y, p.x, p.z, r.x, r.y, r.z])
        })
        .collect();
    let mut tie_times_s = [Vec::new(), Vec::new()];
    for (tie, used) in drive.chosen.ties.iter().zip(&drive.solution.ties) {
        if used.why_not.is_none() {
            let times = &mut tie_times_s[usize::from(tie.kind == TieKind::Increment)];
            times.extend(tie.sightings.iter().map(|s| s.time_s - drive.clock_shift_s));
        }
    }
    let path = corrections.iter().filter_map(|row| {
        let place = drive.pose_at(row.time_s)?.position;
        Some([row.time_s, place.x, place.y])
    });
    let path = path.collect();
    let start_s = (span_s.0 / 10.0).floor() * 10.0;
    let time = matched.survey.clock.gps_time(start_s);
    let origin =
        Origin { time_s: start_s, second: time.map_or(start_s, |t| t.seconds_of_week), week: time.map(|t| t.week) };
    DriveCharts {
        origin,
        span_s,
        corrections,
        sigma_before,
        tie_times_s,
        lines: report.residuals.iter().map(|r| (r.difference_m().0, r.difference_m().1, r.held_out)).collect(),
        pairs: pairs::of(drive, report.residuals),
        path,
        innovations: innovations_of_ties(drive),
        cuts: cut::worst(matched, drive, report.residuals),
    }
}

/// Innovations of the ties' sightings, and whether they were left out in the end.
fn innovations_of_ties(drive: &DriveSolution) -> Vec<TieInnovation> {
    let of = |i: &tieline_filter::innovation::Innovation| {
        let (tie, sighting) = i.sighting?;
        let (line, visit) = *drive.chosen.of.get(tie)?.first()?;
        let fate = drive.solution.ties.get(tie)?;
        let weight = fate.weights.get(sighting).copied().unwrap_or(0.0);
        Some(TieInnovation {
            class: drive.lines[line].class_of(|end| visit.is_none_or(|v| end.visit == v)),
            time_s: i.time_s - drive.clock_shift_s,
            normalised: *i.normalised.first()?,
            left_out: fate.why_not.is_some() || weight <= 0.0,
        })
    };
    drive.solution.innovations.iter().filter_map(of).collect()
}

fn strips(report: &DriveReport<'_>, charts: &DriveCharts) -> Vec<DriveStrip> {
    let clock = &report.matched.survey.clock;
    let of = |strip: &tieline_matching::Strip| {
        let rows = charts.corrections.iter().filter(|r| r.time_s >= strip.start_s && r.time_s <= strip.end_s);
        let middle_s = 0.5 * (strip.start_s + strip.end_s);
        let middle = charts.corrections.iter().min_by(|a, b| {
            let off = |r: &tieline_filter::CorrectionRow| (r.time_s - middle_s).abs();
            off(a).total_cmp(&off(b))
        });
        DriveStrip {
            name: strip.name.clone(),
            points: strip.points,
            start_s: strip.start_s,
            end_s: strip.end_s,
            start_utc: clock.gps_time(strip.start_s).map(|t| t.utc_text()),
            scanners: strip.scanners.clone(),
            correction_enu_m: middle.map_or([f64::NAN; 3], |r| r.position_enu_m.into()),
            largest_correction_m: rows.map(|r| r.position_enu_m.norm()).fold(f64::NAN, f64::max),
        }
    };
    report.matched.strips.strips().iter().map(of).collect()
}

/// Ends of lines and matches of spots and corners that were rejected, by reason.
fn rejected(report: &DriveReport<'_>) -> BTreeMap<String, u64> {
    let mut counts = report.drive.ties(report.matched).rejected.clone();
    for reason in report.matched.spots.iter().filter_map(|s| s.rejection) {
        *counts.entry(format!("spot, {}", reason.as_str())).or_default() += 1;
    }
    for (feature, reason) in report.matched.features.iter().filter_map(|f| Some((f, f.rejection?))) {
        *counts.entry(format!("{}, {}", feature.kind.as_str(), reason.as_str())).or_default() += 1;
    }
    counts
}

type Ties = BTreeMap<String, ClassSummary>;

/// Ties by kind and by class: numbers of lines, and how far their sightings are apart.
fn ties(report: &DriveReport<'_>, pairs: &[PairPoint]) -> (Ties, Ties) {
    let drive = report.drive;
    let mut used = vec![false; drive.lines.len()];
    for (parts, tie) in drive.chosen.of.iter().zip(&drive.solution.ties) {
        for (line, _) in parts {
            used[*line] |= tie.why_not.is_none();
        }
    }
    let kinds = ["surface_line", "line", "xyz_point", "increment", "submap", "control"];
    let mut by_kind: Ties = kinds.iter().map(|k| (String::from(*k), ClassSummary::default())).collect();
    let mut by_class = Ties::new();
    let kind_of = |line: usize| if drive.lines[line].visits() == 1 { "increment" } else { "surface_line" };
    for (i, line) in drive.lines.iter().enumerate() {
        let count = |c: &mut TieCounts| {
            c.found += 1;
            c.used += u64::from(used[i]);
            c.held_out += u64::from(line.held_out);
        };
        count(&mut by_kind.entry(String::from(kind_of(i))).or_default().counts);
        count(&mut by_class.entry(String::from(line.class().as_str())).or_default().counts);
    }
    for point in &drive.points.0 {
        let (is_used, _) = fate(drive, point);
        for (of, name) in [(&mut by_kind, point.tie.kind.as_str()), (&mut by_class, point.class.as_str())] {
            let counts = &mut of.entry(String::from(name)).or_default().counts;
            counts.found += 1;
            counts.used += u64::from(is_used);
        }
    }
    for (kind, summary) in &mut by_kind {
        let mine = report.residuals.iter().filter(|r| kind_of(r.line) == kind);
        summary.discrepancy = discrepancies(mine.map(|r| (r.difference_m(), r.held_out)));
    }
    for class in [Class::PassToPass, Class::ScannerToScanner, Class::StripToStrip] {
        let mine: Vec<&PairPoint> = pairs.iter().filter(|p| p.class == class).collect();
        if !mine.is_empty() || by_class.contains_key(class.as_str()) {
            by_class.entry(String::from(class.as_str())).or_default().discrepancy =
                discrepancies(mine.iter().map(|p| (p.difference_m, p.held_out)));
        }
    }
    (by_kind, by_class)
}

fn discrepancies(of: impl Iterator<Item = ((f64, f64), bool)>) -> Discrepancies {
    let mut values: [Vec<f64>; 4] = Default::default();
    for ((before_m, after_m), held_out) in of.filter(|d| d.0.0.is_finite() && d.0.1.is_finite()) {
        let at = 2 * usize::from(held_out);
        values[at].push(before_m);
        values[at + 1].push(after_m);
    }
    let [before, after, held_out_before, held_out_after] = values.map(|v| Discrepancy::of(&v));
    Discrepancies { before, after, held_out_before, held_out_after }
}

/// Terms, values and range bias of a calibration.
pub(crate) fn calibration(calibrated: &Calibrated<'_>) -> DriveCalibration {
    let Calibrated { constants, estimate, ranges_m, verdicts } = calibrated;
    let terms = verdicts.iter().map(|v| TermSummary {
        scanner: v.scanner,
        name: String::from(v.term.as_str()),
        estimated: v.needed,
        test: v.ratio,
        directions_not_seen: v.not_seen,
    });
    let mut estimates = Vec::new();
    for group in constants.groups.iter().filter(|g| !g.term.is_curve()) {
        let (unit, factor) = match group.term {
            Term::Boresight => ("deg", 1_f64.to_degrees()),
            Term::Latency => ("s", 1.0),
            Term::LeverArm | Term::Range | Term::Incidence | Term::Intensity => ("m", 1.0),
        };
        for k in 0..group.prior.nrows() {
            let axis = if group.prior.nrows() == 3 { ["x", "y", "z"][k] } else { "" };
            let term = String::from(group.term.as_str());
            estimates.push(EstimateSummary {
                scanner: group.scanner,
                name: String::from(format!("{term} {axis}").trim_end()),
                term,
                unit: String::from(unit),
                value: estimate.value[group.first + k] * factor,
                sigma: estimate.sigma(group.first + k) * factor,
                prior_sigma: group.prior[(k, k)].sqrt() * factor,
            });
        }
    }
    let curve = |scanner: usize| {
        let mut curve = CurveSummary { scanner, ..CurveSummary::default() };
        for range_m in ranges_of_curve(calibrated, scanner) {
            let (bias_m, sigma_m) = calibrated.bias_at(scanner, range_m)?;
            curve.range_m.push(range_m);
            curve.bias_m.push(bias_m);
            curve.sigma_m.push(sigma_m);
        }
        Some(curve)
    };
    let curve_over = |own: &OverSpline| {
        let (scanner, over) = (own.scanner, String::from(own.over.as_str()));
        let mut curve = OverCurveSummary { scanner, over, ..OverCurveSummary::default() };
        for place in own.rows() {
            let (bias_m, sigma_m) = calibrated.bias_over(own, place)?;
            curve.at.push(own.over.value(place));
            curve.bias_m.push(bias_m);
            curve.sigma_m.push(sigma_m);
        }
        Some(curve)
    };
    DriveCalibration {
        range_bias_over: constants.over.iter().filter_map(curve_over).filter(|c| !c.at.is_empty()).collect(),
        terms: terms.collect(),
        estimates,
        range_bias: (0..ranges_m.len()).filter_map(curve).filter(|c| !c.range_m.is_empty()).collect(),
    }
}

fn trajectory(report: &DriveReport<'_>, charts: &DriveCharts) -> DriveTrajectory {
    let (solution, written) = (&report.drive.solution, &report.written);
    let largest = charts.corrections.iter().max_by(|a, b| a.position_enu_m.norm().total_cmp(&b.position_enu_m.norm()));
    let mut fixes_s: Vec<f64> =
        report.measurements.inputs.gnss.iter().map(|f| f.time_s - report.drive.clock_shift_s).collect();
    fixes_s.sort_by(f64::total_cmp);
    DriveTrajectory {
        epochs: written.epochs,
        span_s: [written.span_s.0, written.span_s.1],
        rms_sigma_position_ned_m: written.position_sigma_m,
        rms_sigma_roll_pitch_heading_deg: written.attitude_sigma_rad.map(f64::to_degrees),
        runs: solution.runs,
        last_change_sigma: solution.change,
        ties_given: report.drive.inputs.ties.len(),
        ties_left_out: solution.ties.iter().filter(|t| t.why_not.is_some()).count(),
        largest_correction: largest.map_or_else(LargestCorrection::default, |row| LargestCorrection {
            time_s: row.time_s,
            enu_m: row.position_enu_m.into(),
            length_m: row.position_enu_m.norm(),
        }),
        outages: gaps(&fixes_s, charts.span_s).into_iter().map(|gap| outage(gap, charts)).collect(),
        innovations: innovations(&solution.innovations),
        notes: solution.notes.clone(),
    }
}

/// Stretches of the strips' time without a fix, longer than [`OUTAGE_S`].
fn gaps(fixes_s: &[f64], span_s: (f64, f64)) -> Vec<(f64, f64)> {
    let mut times: Vec<f64> = fixes_s.to_vec();
    // before the first and after the last fix only what the strips cover counts
    times.insert(0, fixes_s.first().map_or(span_s.0, |f| f.min(span_s.0)));
    times.push(fixes_s.last().map_or(span_s.1, |f| f.max(span_s.1)));
    let long = times.windows(2).map(|w| (w[0], w[1])).filter(|g| g.1 - g.0 > OUTAGE_S);
    long.filter(|g| g.1 > span_s.0 && g.0 < span_s.1).collect()
}

fn outage((start_s, end_s): (f64, f64), charts: &DriveCharts) -> Outage {
    let inside = |t: f64| t >= start_s && t <= end_s;
    let rows = || charts.corrections.iter().filter(|r| inside(r.time_s));
    let sigma = |k: usize| rows().map(|r| r.sigma[k]).fold(f64::NAN, f64::max);
    let before = charts.corrections.iter().zip(&charts.sigma_before).filter(|(r, _)| inside(r.time_s));
    let mut largest_before: Option<[f64; 3]> = None;
    for sigma in before.filter_map(|(_, s)| *s) {
        let most = largest_before.get_or_insert([0.0; 3]);
        (0..3).for_each(|k| most[k] = most[k].max(sigma[k]));
    }
    Outage {
        start_s,
        end_s,
        largest_correction_m: rows().map(|r| r.position_enu_m.norm()).fold(f64::NAN, f64::max),
        largest_sigma_enu_m: [0, 1, 2].map(sigma),
        largest_sigma_rph_deg: [3, 4, 5].map(|k| sigma(k).to_degrees()),
        largest_sigma_before_enu_m: largest_before,
    }
}

#[allow(clippy::cast_precision_loss)]
fn innovations(all: &[tieline_filter::innovation::Innovation]) -> BTreeMap<String, InnovationSummary> {
    let mut kinds: BTreeMap<String, InnovationSummary> = BTreeMap::new();
    for i in all {
        let entry = kinds.entry(String::from(i.kind.as_str())).or_default();
        entry.count += 1;
        entry.down_weighted += usize::from(i.weight > 0.0 && i.weight < 1.0);
        entry.left_out += usize::from(i.weight <= 0.0);
        entry.mean_nis_per_component += i.squared / i.value.len().max(1) as f64;
    }
    kinds.values_mut().for_each(|k| k.mean_nis_per_component /= k.count.max(1) as f64);
    kinds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outages_are_the_gaps_within_the_strips() {
        let fixes: Vec<f64> = (0..=20).chain(80..=100).map(f64::from).collect();
        assert_eq!(gaps(&fixes, (10.0, 95.0)), vec![(20.0, 80.0)]);
        assert_eq!(gaps(&fixes, (10.0, 130.0)), vec![(20.0, 80.0), (100.0, 130.0)]);
        assert_eq!(gaps(&[], (0.0, 9.0)), vec![(0.0, 9.0)]);
        assert!(gaps(&fixes, (85.0, 95.0)).is_empty(), "the gap lies before the strips");
    }
}
