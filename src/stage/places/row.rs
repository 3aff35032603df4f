//! Ties of places as rows of the adjustment: one line for each direction held.
//!
//! Along a direction d the observation is `d·(p_i - p_j) = 0` with the places after the corrections. The directions of a tie are
//! eigenvectors of its covariance, so that its rows are independent. Each is a line of two ends: half of the variance at either.

use tieline_filter::Pose;
use tieline_graph::{EndPart, Line, LineEnd, Model, PointMap};

use super::{Direction, PlaceTie, Places};
use crate::stage::solve::Setup;
use crate::stage::trajectory::Poses;

/// Classes of variance that places follow on.
pub const FIRST_CLASS: usize = 6;

/// A row: its tie, and the line before any correction with the distance it was measured at.
#[derive(Debug, Clone)]
pub struct PlaceRow {
    /// Row of [`Places::ties`].
    pub tie: usize,
    /// The direction of it.
    pub direction: usize,
    distance_m: f64,
    line: Line,
}

/// The rows of all ties whose places have poses, those of one tie together.
#[must_use]
pub fn rows(places: &Places, setup: &Setup, poses: &Poses) -> Vec<PlaceRow> {
    let of_tie = |(tie, place): (usize, &PlaceTie)| {
        let rows = place.directions.iter().enumerate().map(|(k, d)| Some((k, d, line(tie, place, d, setup, poses)?)));
        let rows: Option<Vec<_>> = rows.collect();
        let row = |(direction, d, line): (usize, &Direction, Line)| PlaceRow {
            tie,
            direction,
            distance_m: d.distance_m,
            line,
        };
        rows.unwrap_or_default().into_iter().map(row).collect::<Vec<_>>()
    };
    places.in_use().flat_map(of_tie).collect()
}

/// The line of a direction; `None` where the trajectory does not cover one of its places.
fn line(tie: usize, place: &PlaceTie, direction: &Direction, setup: &Setup, poses: &Poses) -> Option<Line> {
    let end = |k: usize| {
        let sighting = place.sightings[k];
        let calibration = setup.block(sighting.strip, sighting.scanner);
        let pose = |time_s: f64| -> Option<Pose> { poses.at(sighting.strip, time_s) };
        let part = |p: &super::Part| {
            Some(EndPart {
                time_s: p.time_s[k],
                pose: pose(p.time_s[k])?,
                point_m: p.points_m[k] + setup.origin_m,
                along: p.along,
            })
        };
        Some(LineEnd {
            strip: Some(sighting.strip as usize),
            calibration,
            time_s: place.time_s[k],
            pose: pose(place.time_s[k])?,
            lever_arm_m: setup.lever_arms_m.get(calibration).copied().unwrap_or_default(),
            point_m: place.points_m[k] + setup.origin_m,
            offset_m: 0.0,
            sigma_m: direction.sigma_m * std::f64::consts::FRAC_1_SQRT_2,
            parts: direction.parts.iter().map(part).collect::<Option<Vec<_>>>()?,
        })
    };
    Some(Line {
        normal: direction.direction,
        class: FIRST_CLASS + place.kind as usize,
        held_out: place.held_out,
        judges_only: false,
        tie: Some(tie),
        ends: vec![end(0)?, end(1)?],
    })
}

/// A row measured at the present state of a model: its places are moved, what was measured along the direction stays.
#[must_use]
pub fn measured(row: &PlaceRow, model: &Model) -> Line {
    let mut line = row.line.clone();
    for (end, measured_m) in line.ends.iter_mut().zip([row.distance_m, 0.0]) {
        let Some(strip) = end.strip else { continue };
        let calibration = model.calibration(end.calibration);
        let displacement = |part: &EndPart| {
            let correction = model.pose_correction(strip, part.time_s);
            let map = PointMap::new(&part.pose, &end.lever_arm_m, &correction, &calibration);
            part.along.dot(&map.delta_m(&part.point_m))
        };
        end.offset_m = measured_m + end.parts.iter().map(displacement).sum::<f64>();
    }
    line
}
