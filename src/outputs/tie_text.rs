//! `ties.txt` of a drive: the ties that went to the smoother, for other smoothers.

use std::path::Path;

use anyhow::Result;
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{SurveyClock, TieClass};
use tieline_io::crs::Crs;
use tieline_io::ties::text::{TextSighting, TextTie, TieTextHeader, write_tie_text};

use crate::stage::drive::DriveSolution;
use crate::stage::drive::ties::End;

/// Writes `ties.txt`; `clock` is that of the measurements, `crs` that of the strips.
///
/// # Errors
/// When it cannot be written.
pub fn write_tie_text_of(drive: &DriveSolution, clock: &SurveyClock, crs: Option<&Crs>, path: &Path) -> Result<()> {
    let datum = crs.map(|c| match c.epsg() {
        Some(code) => format!("that of EPSG:{code}"),
        None => String::from("that of the trajectory"),
    });
    // times of a file are not negative: they count from the week of the first
    let times = || drive.inputs.ties.iter().flat_map(|t| &t.sightings).map(|s| s.time_s);
    let first_week = (times().fold(f64::INFINITY, f64::min) / SECONDS_PER_WEEK).floor();
    let (week, later_s) = match clock.gps_time(first_week * SECONDS_PER_WEEK) {
        Some(first) => (Some(first.week), -first_week * SECONDS_PER_WEEK),
        None => (clock.reference_week, 0.0),
    };
    let header = TieTextHeader { week, datum };
    let lines = (0..drive.chosen.ties.len()).map(|k| tie(drive, k, later_s));
    // a known point is no tie of sightings to each other, and may have one
    let is_tie = |k: &usize| drive.points.1[*k].known_map_m.is_none();
    let points = (0..drive.points.1.len()).filter(is_tie).map(|k| point(drive, k, later_s));
    Ok(write_tie_text(path, &header, lines.chain(points))?)
}

/// One of the chosen ties of lines.
fn tie(drive: &DriveSolution, number: usize, later_s: f64) -> TextTie {
    let (line, visit) = drive.chosen.of[number][0]; // the others of a mean were seen by the same scanners
    let line = &drive.lines[line];
    let is_of = |end: &End| visit.is_none_or(|v| end.visit == v);
    let scanners = line.ends.iter().filter(|e| is_of(e)).map(|e| e.scanner);
    written(drive, number, line.class_of(is_of), scanners, later_s)
}

/// One of the points.
fn point(drive: &DriveSolution, number: usize, later_s: f64) -> TextTie {
    let point = &drive.points.1[number];
    written(drive, drive.chosen.ties.len() + number, point.class, point.ends.iter().map(|e| e.scanner), later_s)
}

/// One of the smoother's ties with the estimated calibration in its body vectors.
fn written(
    drive: &DriveSolution,
    number: usize,
    class: TieClass,
    scanners: impl Iterator<Item = u16>,
    later_s: f64,
) -> TextTie {
    let constants = &drive.solution.calibration.value;
    let (of, fate) = (&drive.inputs.ties[number], &drive.solution.ties[number]);
    let sightings = of.sightings.iter().zip(scanners).zip(&fate.weights).map(|((sighting, scanner), weight)| {
        let sighting = sighting.calibrated(constants);
        let rank = of.directions.len();
        let used = fate.why_not.is_none() && *weight > 0.0;
        TextSighting {
            time_s: sighting.time_s + later_s,
            scanner,
            body_vector_m: sighting.body_vector_m,
            covariance_m2: sighting
                .covariance_m2
                .map_with_location(|i, j, v| if i < rank && j < rank { v } else { 0.0 }),
            used,
            weight: if used { *weight } else { 0.0 },
        }
    });
    TextTie { id: of.id, class, kind: of.kind, directions: of.directions.clone(), sightings: sightings.collect() }
}
