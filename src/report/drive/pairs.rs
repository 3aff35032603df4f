//! Pairs of sightings by what they bind.
//!
//! A line seen by two scanners in each of two visits says something of the scanners and of the visits: it gives a pair of either class.
//! All differences count towards the vehicle, so that what a range bias does has one sign on the road and on walls.

use crate::report::drive::data::PairPoint;
use crate::stage::drive::DriveSolution;
use crate::stage::drive::residuals::Residual;
use crate::stage::drive::ties::{Class, DriveLine};

/// Pairs of all lines.
pub(crate) fn of(drive: &DriveSolution, residuals: &[Residual]) -> Vec<PairPoint> {
    let mut pairs = Vec::new();
    for residual in residuals {
        let line = &drive.lines[residual.line];
        let class = line.class();
        if class != Class::ScannerToScanner {
            pairs.push(pair(class, line, residual, (0, line.ends.len() - 1)));
        }
        for visit in 0..line.visits() {
            pairs.extend(scanners(line, visit).map(|ends| pair(Class::ScannerToScanner, line, residual, ends)));
        }
    }
    pairs
}

/// Ends of the lowest and the highest scanner of a visit, when these are two.
fn scanners(line: &DriveLine, visit: usize) -> Option<(usize, usize)> {
    let ends = || line.ends.iter().enumerate().filter(|(_, e)| e.visit == visit);
    let low = ends().min_by_key(|(k, e)| (e.scanner, *k))?;
    let high = ends().max_by_key(|(k, e)| (e.scanner, *k))?;
    (low.1.scanner != high.1.scanner).then_some((low.0, high.0))
}

fn pair(class: Class, line: &DriveLine, residual: &Residual, (from, to): (usize, usize)) -> PairPoint {
    let body_m = &line.ends[0].sighting.body_vector_m;
    let sign = if line.ends[0].normal_body.dot(body_m) > 0.0 { -1.0 } else { 1.0 };
    PairPoint {
        class,
        east_north_m: [line.point_map_m.x, line.point_map_m.y],
        difference_m: (
            sign * (residual.before_m[to] - residual.before_m[from]),
            sign * (residual.after_m[to] - residual.after_m[from]),
        ),
        range_m: 0.5 * (line.ends[from].range_m + line.ends[to].range_m),
        lateral_m: line.ends[from].sighting.body_vector_m.y,
        held_out: residual.held_out,
    }
}
