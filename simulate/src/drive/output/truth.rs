//! What a user never has.

use std::fmt::Write;

use nalgebra::{Rotation3, Vector3};

use super::super::errors::errors_at;
use super::super::survey::DriveSurvey;
use super::strips::Projection;
use super::{array, vector};
use crate::error::SimulateError;
use crate::output::StripReport;

/// Step of the table of the range bias \[m\].
const BIAS_STEP_M: f64 = 0.25;
/// Width of a bin of the histogram of ranges \[m\].
const BIN_M: f64 = 0.5;

/// True calibration: as `calibration.toml`, with what is wrong.
pub(super) fn calibration(survey: &DriveSurvey) -> String {
    let scenario = survey.scenario();
    let mut text = String::from(
        "# True time = stamp + latency; measured range = true range + bias; true = nominal + error.\n\
         # misalignment_body_deg: rotation vector in the body frame, on the left of the nominal mounting.\n",
    );
    let _ = write!(text, "\n[odometer]\nscale_error = {:?}\n", scenario.odometer.scale_error);
    for (channel, (options, scanner)) in scenario.scanners.iter().zip(survey.scanners()).enumerate() {
        let rotation = Rotation3::from_matrix_unchecked(scanner.true_body_from_scanner);
        let (roll, pitch, yaw) = rotation.euler_angles();
        let name = format!("scanner{}", channel + 1);
        let _ = write!(
            text,
            "\n[{name}]\nchannel = {channel}\nlever_arm_m = {}\nlever_arm_error_m = {}\nrpy_deg = {}\n\
             misalignment_body_deg = {}\nlatency_s = {:?}\n\n[{name}.bias]\noffset_m = {:?}\nppm = {:?}\nknots_m = {:?}\n",
            vector(&scanner.true_lever_arm_m),
            array(options.lever_arm_error_m),
            vector(&Vector3::new(roll, pitch, yaw).map(f64::to_degrees)),
            array(options.boresight_error_deg),
            options.latency_s,
            options.bias_offset_m,
            options.bias_ppm,
            options.bias_knots_m,
        );
        for (key, knots) in [("incidence", &options.bias_incidence), ("intensity", &options.bias_intensity)] {
            if !knots.is_empty() {
                let _ = writeln!(text, "{key} = {knots:?}");
            }
        }
        for bump in &options.bias_bumps {
            let _ = write!(
                text,
                "\n[[{name}.bias.bump]]\nheight_m = {:?}\nrange_m = {:?}\nwidth_m = {:?}\n",
                bump.height_m, bump.range_m, bump.width_m,
            );
        }
    }
    text
}

/// The range bias of each scanner, measured minus true; scanners count from 1.
pub(super) fn bias_functions(survey: &DriveSurvey) -> String {
    let mut text = String::from("scanner,range_m,bias_m\n");
    for (number, scanner) in (1..).zip(survey.scanners()) {
        let mut range_m = 1.5;
        while range_m <= scanner.options.max_range_m + 1e-9 {
            let _ = writeln!(text, "{number},{range_m:.2},{:.6}", scanner.bias_m(range_m));
            range_m += BIAS_STEP_M;
        }
    }
    text
}

/// The range bias of each scanner over incidence \[deg\] and intensity, measured minus true; scanners count from 1. None where no scanner has any.
pub(super) fn bias_over(survey: &DriveSurvey) -> Option<String> {
    let mut text = String::from("scanner,over,at,bias_m\n");
    let header = text.len();
    for (number, scanner) in (1..).zip(survey.scanners()) {
        let options = &scanner.options;
        for deg in (0..=90).map(f64::from).filter(|_| !options.bias_incidence.is_empty()) {
            let _ = writeln!(text, "{number},incidence,{deg:.2},{:.6}", scanner.bias_at_incidence_m(deg));
        }
        let steps = (0..=110).filter(|_| !options.bias_intensity.is_empty());
        for at in steps.map(|k| (f64::from(k) * 0.1).exp()) {
            let _ = writeln!(text, "{number},intensity,{at:.2},{:.6}", scanner.bias_at_intensity_m(at));
        }
    }
    (text.len() > header).then_some(text)
}

/// Outages, with the largest errors of the delivered trajectory in them.
pub(super) fn outages(survey: &DriveSurvey) -> String {
    let mut text =
        String::from("start_sow,end_sow,peak_n,peak_e,peak_d,peak_roll_deg,peak_pitch_deg,peak_heading_deg\n");
    for outage in &survey.scenario().gnss.outages {
        let start_s = survey.span_s().0 + outage.start_s;
        let end_s = (start_s + outage.length_s).min(survey.span_s().1);
        let peak = peak(survey, (start_s, end_s));
        let _ = write!(text, "{start_s:.6},{end_s:.6}");
        peak.iter().for_each(|v| {
            let _ = write!(text, ",{v:.6}");
        });
        text.push('\n');
    }
    text
}

/// Largest error, delivered minus true, within a span: north, east, down \[m\], roll, pitch, heading \[deg\].
fn peak(survey: &DriveSurvey, (start_s, end_s): (f64, f64)) -> [f64; 6] {
    let (delivered, truth) = (survey.delivered(), survey.truth());
    let mut peak = [0.0_f64; 6];
    for (k, time_s) in truth.time_s().iter().enumerate() {
        if *time_s < start_s || *time_s > end_s {
            continue;
        }
        let error = errors_at(delivered, truth, k);
        for (peak, error) in peak.iter_mut().zip(error) {
            if error.abs() > peak.abs() {
                *peak = error;
            }
        }
    }
    peak
}

/// When each pass was.
pub(super) fn passes(survey: &DriveSurvey) -> String {
    let mut text = String::from("pass,start_sow,end_sow,direction\n");
    for (number, (start_s, end_s)) in (1..).zip(survey.laps_s()) {
        let _ = writeln!(text, "{number},{start_s:.3},{end_s:.3},1");
    }
    text
}

/// Points of things whose place is known, in the strips' system.
pub(super) fn features(survey: &DriveSurvey) -> Result<String, SimulateError> {
    let projection = Projection::new(survey)?;
    let mut text = String::from("kind,id,x,y,z\n");
    for feature in survey.scene().features() {
        let map_m = projection.map_m(&feature.point_m)?;
        let _ = writeln!(text, "{},{},{:.4},{:.4},{:.4}", feature.kind, feature.name, map_m.x, map_m.y, map_m.z);
    }
    Ok(text)
}

/// What there is.
pub(super) fn manifest(survey: &DriveSurvey, strips: &[StripReport]) -> String {
    let scenario = survey.scenario();
    let points: serde_json::Map<String, serde_json::Value> = strips
        .iter()
        .map(|s| {
            let name = s.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
            (name, s.points.into())
        })
        .collect();
    let (start_s, end_s) = survey.span_s();
    let value = serde_json::json!({
        "name": scenario.name,
        "seed": scenario.seed,
        "crs": scenario.crs,
        "origin": scenario.origin,
        "week": scenario.week,
        "format": "las14",
        "las_time": "adjusted",
        "imu": scenario.imu.grade,
        "duration_s": end_s - start_s,
        "path_m": survey.length_m(),
        "points": points,
        "total": strips.iter().map(|s| s.points).sum::<u64>(),
        "triangles": survey.scene().triangles(),
    });
    format!("{value:#}\n")
}

/// How many points were measured at which range, a table per scanner.
pub(super) struct RangeHistogram {
    counts: Vec<Vec<u64>>,
}

impl RangeHistogram {
    pub(super) fn new(survey: &DriveSurvey) -> Self {
        let bins = |max_range_m: f64| vec![0; bin(max_range_m) + 1];
        Self { counts: survey.scanners().iter().map(|s| bins(s.options.max_range_m)).collect() }
    }

    pub(super) fn add(&mut self, ranges_m: &[(u8, f64)]) {
        for (scanner, range_m) in ranges_m {
            if let Some(count) = self.counts[usize::from(*scanner)].get_mut(bin(*range_m)) {
                *count += 1;
            }
        }
    }

    #[allow(clippy::cast_precision_loss)]
    pub(super) fn text(&self) -> String {
        let mut text = String::from("scanner,range_m,count\n");
        for (scanner, counts) in (1..).zip(&self.counts) {
            for (bin, count) in counts.iter().enumerate() {
                let _ = writeln!(text, "{scanner},{:.2},{count}", (bin as f64 + 0.5) * BIN_M);
            }
        }
        text
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative
fn bin(range_m: f64) -> usize {
    (range_m.max(0.0) / BIN_M) as usize
}
