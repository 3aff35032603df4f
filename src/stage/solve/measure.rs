//! Ties measured at the present state of a model.

use tieline_filter::Pose;
use tieline_graph::{Line, LineEnd, Model, PointMap};
use tieline_matching::{Patch, measure};

use super::Setup;
use crate::stage::ties::{CONTROL_STRIP, Ties};
use crate::stage::trajectory::Poses;

/// One selected line: its row, its ends in use and their poses.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub(super) line: usize,
    pub(super) ends: Vec<usize>,
    poses: Vec<Option<Pose>>,
    held_out: bool,
    judges_only: bool,
    class: usize,
}

/// Tie classes: relation of the sightings × slope of the surface; the names of the variance components.
pub const CLASSES: [&str; 9] = [
    "strip to strip, level",
    "strip to strip, sloped",
    "strip to strip, steep",
    "scanner to scanner, level",
    "scanner to scanner, sloped",
    "scanner to scanner, steep",
    "submap",
    "ridge",
    "corner",
];

fn class(patches: &[&Patch]) -> usize {
    let one_strip = patches.iter().all(|p| p.sighting.strip == patches[0].sighting.strip);
    let slope_deg = patches[0].normal.z.abs().min(1.0).acos().to_degrees();
    let steepness = if slope_deg < 10.0 {
        0
    } else if slope_deg < 60.0 {
        1
    } else {
        2
    };
    usize::from(one_strip) * 3 + steepness
}

fn is_known(patch: &Patch, setup: &Setup) -> bool {
    let strip = patch.sighting.strip;
    strip == CONTROL_STRIP || setup.is_control.get(strip as usize).copied().unwrap_or(false)
}

/// The selected lines whose ends have poses.
pub(super) fn rows(ties: &Ties, setup: &Setup, poses: &Poses) -> Vec<Row> {
    ties.selected
        .iter()
        .zip(&ties.held_out)
        .filter_map(|(line, held_out)| {
            let (mut ends, mut of_ends, mut patches) = (Vec::new(), Vec::new(), Vec::new());
            for (end, patch) in ties.lines[*line].used() {
                let known = is_known(patch, setup);
                let pose = if known { None } else { poses.at(patch.sighting.strip, patch.time_s) };
                if known || pose.is_some() {
                    ends.push(end);
                    of_ends.push(pose);
                    patches.push(patch);
                }
            }
            (ends.len() >= 2 && of_ends.iter().any(Option::is_some)).then(|| Row {
                line: *line,
                ends,
                poses: of_ends,
                held_out: *held_out,
                judges_only: ties.lines_judge,
                class: class(&patches),
            })
        })
        .collect()
}

/// A patch as it lies after the present corrections; the map, to undo it.
fn moved(patch: &Patch, pose: Option<&Pose>, setup: &Setup, model: &Model) -> (Patch, Option<PointMap>) {
    let Some(pose) = pose else { return (patch.clone(), None) };
    let sighting = patch.sighting;
    let block = setup.block(sighting.strip, sighting.scanner);
    let correction = model.pose_correction(sighting.strip as usize, patch.time_s);
    let mut map = PointMap::new(pose, &setup.lever_arms_m[block], &correction, &model.calibration(block));
    map.scanner_m -= setup.origin_m; // patches live in the local frame
    let mut patch = patch.clone();
    patch.centroid_m += map.delta_m(&patch.centroid_m);
    patch.normal = (patch.normal + map.turn * patch.normal).normalize();
    let along = patch.long_axis + map.turn * patch.long_axis;
    patch.long_axis = (along - patch.normal * along.dot(&patch.normal)).normalize();
    (patch, Some(map))
}

/// A patch after the corrections of a model.
#[must_use]
pub fn corrected_patch(patch: &Patch, poses: &Poses, setup: &Setup, model: &Model) -> Patch {
    if is_known(patch, setup) {
        return patch.clone();
    }
    moved(patch, poses.at(patch.sighting.strip, patch.time_s).as_ref(), setup, model).0
}

/// Measures one line. When footprints no longer meet, the line comes back without ends and takes no part.
pub(super) fn line(row: &Row, ties: &Ties, setup: &Setup, _poses: &Poses, model: &Model) -> Line {
    let originals: Vec<&Patch> = row.ends.iter().map(|e| &ties.lines[row.line].ends[*e].patch).collect();
    let (patches, maps): (Vec<Patch>, Vec<Option<PointMap>>) =
        originals.iter().zip(&row.poses).map(|(p, pose)| moved(p, pose.as_ref(), setup, model)).unzip();
    let references: Vec<&Patch> = patches.iter().collect();
    let Some(measurement) = measure(&references, setup.sigma_floor_m) else {
        let normal = originals[0].normal;
        return of_row(row, normal, Vec::new());
    };
    let ends = (0..patches.len())
        .map(|k| {
            let (offset_m, sigma_m) = measurement.offsets[k];
            let on_plane = measurement.point_m + measurement.normal * offset_m;
            let original = maps[k].as_ref().map_or(on_plane, |map| map.undo(&on_plane));
            let sighting = originals[k].sighting;
            let block = if row.poses[k].is_some() { setup.block(sighting.strip, sighting.scanner) } else { 0 };
            LineEnd {
                strip: row.poses[k].map(|_| sighting.strip as usize),
                calibration: block,
                time_s: originals[k].time_s,
                pose: row.poses[k].unwrap_or(NO_POSE),
                lever_arm_m: setup.lever_arms_m.get(block).copied().unwrap_or_default(),
                point_m: original + setup.origin_m,
                offset_m,
                sigma_m,
                parts: Vec::new(),
            }
        })
        .collect();
    of_row(row, measurement.normal, ends)
}

fn of_row(row: &Row, normal: nalgebra::Vector3<f64>, ends: Vec<LineEnd>) -> Line {
    Line { normal, class: row.class, held_out: row.held_out, judges_only: row.judges_only, tie: None, ends }
}

/// Stands in for the pose of a known surface, which has none.
const NO_POSE: Pose = Pose {
    time_s: 0.0,
    position: nalgebra::Vector3::new(0.0, 0.0, 0.0),
    ned_from_body: nalgebra::UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(1.0, 0.0, 0.0, 0.0)),
    map_from_ned: nalgebra::Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
};
