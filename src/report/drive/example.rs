//! A made-up drive for tests: a block driven twice, without GNSS for a part of the second lap.

use nalgebra::{Vector3, Vector6};
use tieline_filter::CorrectionRow;

use crate::report::data::{Discrepancies, Discrepancy, FileSummary, TieCounts, Timing};
use crate::report::drive::curves::{CurveSummary, OverCurveSummary};
use crate::report::drive::data::{
    ClassSummary, DriveCalibration, DriveCharts, DriveStrip, DriveSummary, DriveTrajectory, EstimateSummary,
    InnovationSummary, LargestCorrection, MeasurementCounts, Origin, Outage, PairPoint, TermSummary, TieInnovation,
};
use crate::settings::Setting;
use crate::stage::drive::again::Gain;
use crate::stage::drive::ties::Class;

/// First and last second of the strips, and of the stretch without GNSS.
const SPAN_S: (f64, f64) = (209_040.0, 209_240.0);
const OUTAGE_S: (f64, f64) = (209_150.0, 209_210.0);

/// Summary and charts.
pub(crate) fn drive() -> (DriveSummary, DriveCharts) {
    let charts = charts();
    let discrepancy = |values: &mut dyn Iterator<Item = ((f64, f64), bool)>| -> Discrepancies {
        let values: Vec<((f64, f64), bool)> = values.collect();
        let of = |held: bool, of: fn(&(f64, f64)) -> f64| {
            Discrepancy::of(&values.iter().filter(|v| v.1 == held).map(|v| of(&v.0)).collect::<Vec<_>>())
        };
        Discrepancies {
            before: of(false, |v| v.0),
            after: of(false, |v| v.1),
            held_out_before: of(true, |v| v.0),
            held_out_after: of(true, |v| v.1),
        }
    };
    let class = |class: Class| {
        let mut mine = charts.pairs.iter().filter(|p| p.class == class).map(|p| (p.difference_m, p.held_out));
        ClassSummary { counts: TieCounts { found: 500, used: 300, held_out: 100 }, discrepancy: discrepancy(&mut mine) }
    };
    let classes = [Class::PassToPass, Class::ScannerToScanner].map(|c| (String::from(c.as_str()), class(c)));
    let setting = Setting { key: "match.patch_m".into(), value: "0.5".into(), reason: "holds 40 points".into() };
    let file = FileSummary {
        input: String::from("strips/pass1.laz"),
        output: String::from("out/block/corrected/pass1.laz"),
        points: 1_234_567,
        largest_shift_m: 0.142,
        scale_m: [0.001; 3],
        notes: vec![String::from("bounds and generating software")],
    };
    let strip = |name: &str, start_s: f64| DriveStrip {
        name: String::from(name),
        points: 1_234_567,
        start_s,
        end_s: start_s + 100.0,
        start_utc: Some(String::from("2024-09-03T10:03:42 UTC")),
        scanners: vec![0, 1],
        correction_enu_m: [0.01, -0.02, 0.03],
        largest_correction_m: 0.14,
    };
    let summary = DriveSummary {
        version: String::from("0.1.0"),
        name: String::from("Block, twice"),
        inputs: vec![(String::from("pass1.laz"), 1_234_567)],
        measurements: MeasurementCounts { imu_samples: 60_000, imu_interval_s: 0.005, ..MeasurementCounts::default() },
        crs: String::from("EPSG:32633"),
        settings: vec![setting],
        strips: vec![strip("1", SPAN_S.0), strip("2", SPAN_S.0 + 100.0)],
        ties: [("surface_line", Class::PassToPass), ("increment", Class::ScannerToScanner)]
            .map(|(kind, c)| (String::from(kind), class(c)))
            .into(),
        ties_by_class: classes.into(),
        rejected: [(String::from("normal_angle"), 321)].into(),
        difference_over: crate::report::drive::ranges::differences(&charts.pairs),
        measured_again: Some(Gain {
            pairs_before: 9_000,
            pairs_after: 9_050,
            pairs_gained: 80,
            pairs_lost: 30,
            ..Gain::default()
        }),
        discrepancy: discrepancy(&mut charts.lines.iter().map(|l| ((l.0, l.1), l.2))),
        calibration: calibration(),
        trajectory: trajectory(),
        files: vec![file],
        notes: vec![String::from("2 ties do not fit all the others and were left out")],
        timing: Timing {
            stage: [(String::from("solve"), 4.2)].into(),
            points_per_second: 250_000.0,
            ..Timing::default()
        },
        peak_memory_bytes: 611 << 20,
    };
    (summary, charts)
}

fn charts() -> DriveCharts {
    let bump = |t: f64| ((t - OUTAGE_S.0) / (OUTAGE_S.1 - OUTAGE_S.0) * std::f64::consts::PI).sin().max(0.0);
    let within = |t: f64| if t > OUTAGE_S.0 && t < OUTAGE_S.1 { bump(t) } else { 0.0 };
    let times = || (0..=1000).map(|i| SPAN_S.0 + 0.2 * f64::from(i));
    let corrections = times().map(|t| CorrectionRow {
        time_s: t,
        position_enu_m: Vector3::new(0.1, -0.08, 0.11) * within(t) + Vector3::repeat(0.002 * (t * 0.3).sin()),
        attitude_rph_rad: Vector3::new(1e-5, 2e-5, 2e-4) * within(t),
        sigma: Vector6::new(6e-3, 6e-3, 5e-3, 1e-5, 1e-5, 6e-5) * (1.0 + within(t)),
    });
    let place = |t: f64| {
        let angle = (t - SPAN_S.0) / 100.0 * std::f64::consts::TAU;
        [463_000.0 + 120.0 * angle.cos(), 5_340_000.0 + 80.0 * angle.sin()]
    };
    let pairs = (0..4000).map(|i| {
        let x = f64::from(i);
        let noise_m = 0.002 * (x * 12.9898).sin();
        let time_s = SPAN_S.0 + 0.05 * x;
        let scanners = i % 2 == 0;
        PairPoint {
            class: if scanners { Class::ScannerToScanner } else { Class::PassToPass },
            east_north_m: place(time_s).map(|v| v + 8.0 * (x * 78.233).sin()),
            difference_m: (noise_m + if scanners { 0.004 } else { 0.1 * within(time_s) }, noise_m),
            range_m: 2.5 + 30.0 * (x * 0.37).sin().powi(2),
            lateral_m: 12.0 * (x * 0.11).sin(),
            held_out: i % 10 < 2,
        }
    });
    let pairs: Vec<PairPoint> = pairs.collect();
    DriveCharts {
        origin: Origin { time_s: SPAN_S.0, second: SPAN_S.0, week: Some(2330) },
        span_s: SPAN_S,
        sigma_before: times().map(|t| Some([0.02 + 0.05 * within(t), 0.02, 0.03, 1e-5, 1e-5, 2e-4])).collect(),
        tie_times_s: [times().step_by(3).collect(), times().step_by(2).collect()],
        lines: pairs.iter().map(|p| (p.difference_m.0, p.difference_m.1, p.held_out)).collect(),
        path: times().map(|t| [t, place(t)[0], place(t)[1]]).collect(),
        corrections: corrections.collect(),
        innovations: pairs
            .iter()
            .enumerate()
            .map(|(i, p)| TieInnovation {
                class: p.class,
                time_s: SPAN_S.0 + 0.05 * i as f64,
                normalised: 400.0 * p.difference_m.1,
                left_out: i % 97 == 0,
            })
            .collect(),
        cuts: Vec::new(),
        pairs,
    }
}

fn calibration() -> DriveCalibration {
    let term = |scanner: usize, name: &str, estimated: bool, test: f64| TermSummary {
        scanner,
        name: String::from(name),
        estimated,
        test,
        directions_not_seen: 0,
    };
    let estimates = (0..6).map(|i| EstimateSummary {
        scanner: i / 3,
        term: String::from("boresight"),
        name: format!("boresight {}", ["x", "y", "z"][i % 3]),
        unit: String::from("deg"),
        value: 0.0123,
        sigma: 0.0004,
        prior_sigma: 0.05,
    });
    let curve = |scanner: usize| {
        let range_m: Vec<f64> = (10..140).map(|i| 0.25 * f64::from(i)).collect();
        CurveSummary {
            scanner,
            bias_m: range_m.iter().map(|r| 0.004 * (r * 0.3).sin()).collect(),
            sigma_m: range_m.iter().map(|r| 0.0004 + 0.0001 * r).collect(),
            range_m,
        }
    };
    let at: Vec<f64> = (30..110).map(|i| (0.1 * f64::from(i)).exp()).collect();
    let over = OverCurveSummary {
        scanner: 0,
        over: String::from("intensity"),
        bias_m: at.iter().map(|at| 0.001 * (at.ln() - 7.0)).collect(),
        sigma_m: vec![0.0003; at.len()],
        at,
    };
    DriveCalibration {
        terms: vec![
            term(0, "boresight", true, 9.4),
            term(0, "lever arm", false, 0.1),
            term(0, "range correction", true, 14.0),
            term(0, "range correction over intensity", true, 2.5),
            term(1, "boresight", true, 5.8),
            term(1, "latency", false, 0.2),
            term(1, "range correction", true, 3.0),
        ],
        estimates: estimates.collect(),
        range_bias: vec![curve(0), curve(1)],
        range_bias_over: vec![over],
    }
}

fn trajectory() -> DriveTrajectory {
    let innovation = |count| InnovationSummary { count, down_weighted: 4, left_out: 2, mean_nis_per_component: 0.97 };
    DriveTrajectory {
        epochs: 60_000,
        span_s: [209_000.0, 209_300.0],
        rms_sigma_position_ned_m: [0.006, 0.006, 0.005],
        rms_sigma_roll_pitch_heading_deg: [0.001, 0.001, 0.005],
        runs: 3,
        last_change_sigma: 0.04,
        ties_given: 3600,
        ties_left_out: 6,
        largest_correction: LargestCorrection {
            time_s: 0.5 * (OUTAGE_S.0 + OUTAGE_S.1),
            enu_m: [0.1, -0.08, 0.11],
            length_m: 0.169,
        },
        outages: vec![Outage {
            start_s: OUTAGE_S.0,
            end_s: OUTAGE_S.1,
            largest_correction_m: 0.169,
            largest_sigma_enu_m: [0.012, 0.012, 0.01],
            largest_sigma_rph_deg: [0.001, 0.001, 0.007],
            largest_sigma_before_enu_m: Some([0.07, 0.07, 0.03]),
        }],
        innovations: ["position", "tie"].map(|kind| (String::from(kind), innovation(3000))).into(),
        notes: Vec::new(),
    }
}
