//! Planes that two scanners have in common: found at the present mounting, measured at a common place.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Matrix3, Quaternion, UnitQuaternion, Vector3, Vector6};
use tieline_filter::Pose;
use tieline_graph::{Calibration, Line, LineEnd, Model, PointMap, PoseCorrection};
use tieline_matching::{Gate, Measurement, Patch, Rejection, measure, pair_heads};

use super::normals::{Raw, smoothed, variance};
use super::{Mounts, StationOptions};

/// How a surface stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Slope {
    /// Ground: within 20° of level.
    Level,
    /// Between the two.
    Sloped,
    /// Walls: within 20° of upright.
    Steep,
}

impl Slope {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 3] = [Self::Level, Self::Sloped, Self::Steep];

    /// The slope of a surface by its normal in the body frame.
    #[must_use]
    pub fn of(normal: &Vector3<f64>) -> Self {
        let from_level = normal.z.abs().min(1.0).acos().to_degrees();
        if from_level < 20.0 {
            Self::Level
        } else if from_level > 70.0 {
            Self::Steep
        } else {
            Self::Sloped
        }
    }

    /// The word used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Level => "ground",
            Self::Sloped => "sloped",
            Self::Steep => "wall",
        }
    }
}

/// What a common plane is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fate {
    /// The adjustment uses it.
    Used,
    /// It judges the adjustment.
    HeldOut,
    /// One of its patches is held out and the other is not: it does neither.
    Mixed,
}

/// A plane that two scanners have in common at a station.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CommonPlane {
    /// Index of the station.
    pub station: usize,
    /// Indices of the scanners.
    pub heads: [usize; 2],
    /// Rows of their patches.
    pub patches: [usize; 2],
    /// How it stands.
    pub slope: Slope,
    /// What it is for.
    pub fate: Fate,
}

/// All patches of a survey: for every station and scanner, in the body frame by the rough mounting.
pub type Patches = Vec<Vec<Vec<Patch>>>;

/// Everything that pairs are made of.
#[derive(Debug)]
pub struct Ground<'a> {
    /// Scanners.
    pub mounts: &'a Mounts,
    /// Patches.
    pub patches: &'a Patches,
    /// Which of them are held out.
    pub held: &'a [Vec<Vec<bool>>],
    /// Settings.
    pub options: &'a StationOptions,
}

impl Ground<'_> {
    /// The patches of a common plane by the rough mounting.
    fn rough(&self, plane: &CommonPlane) -> [&Patch; 2] {
        std::array::from_fn(|k| &self.patches[plane.station][plane.heads[k]][plane.patches[k]])
    }
}

/// A direction of three sigmas may open the gates this far from the scanner \[m\].
const REACH_M: f64 = 20.0;
/// The search is never wider than this \[m\].
const WIDEST_M: f64 = 4.0;
/// Sigmas of the mounting that a gate allows for.
const GATE_SIGMAS: f64 = 3.0;

/// How points of a scanner move when it is corrected, and the vehicle with it.
#[must_use]
pub fn map_of(lever_arm_m: &Vector3<f64>, motion: &PoseCorrection, correction: &Calibration) -> PointMap {
    PointMap::new(&pose(0.0), lever_arm_m, motion, correction)
}

/// A patch after that.
#[must_use]
pub fn moved(patch: &Patch, map: &PointMap) -> Patch {
    let mut patch = patch.clone();
    patch.centroid_m += map.delta_m(&patch.centroid_m);
    patch.normal = (patch.normal + map.turn * patch.normal).normalize();
    let along = patch.long_axis + map.turn * patch.long_axis;
    patch.long_axis = (along - patch.normal * along.dot(&patch.normal)).normalize();
    patch
}

/// Derivatives of `n · x` by boresight and lever arm of a scanner: `[(x - a) × n, n]`.
fn row(point_m: &Vector3<f64>, arm_m: &Vector3<f64>, normal: &Vector3<f64>) -> Vector6<f64> {
    let turn = (point_m - arm_m).cross(normal);
    Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z)
}

/// Variance of the distance between two patches by what is not known of their mounting \[m²\].
fn variance_m2(mounts: &Mounts, covariance: &DMatrix<f64>, heads: [usize; 2], patches: [&Patch; 2]) -> f64 {
    let middle = 0.5 * (patches[0].centroid_m + patches[1].centroid_m);
    let rows: Vec<(usize, Vector6<f64>)> = (0..2)
        .filter_map(|k| {
            let sign = if k == 0 { 1.0 } else { -1.0 };
            let block = mounts.block(heads[k])?;
            Some((6 * block, sign * row(&middle, &mounts.heads[heads[k]].lever_arm_m, &patches[0].normal)))
        })
        .collect();
    let mut variance = 0.0;
    for (i, a) in &rows {
        for (j, b) in &rows {
            variance += (a.transpose() * covariance.fixed_view::<6, 6>(*i, *j) * b)[(0, 0)];
        }
    }
    variance.max(0.0)
}

/// Finds the common planes at the present state of a model whose unknowns have a covariance.
#[must_use]
pub fn find(
    ground: &Ground<'_>,
    model: &Model,
    covariance: &DMatrix<f64>,
) -> (Vec<CommonPlane>, BTreeMap<Rejection, usize>) {
    let (mounts, options) = (ground.mounts, ground.options);
    let angle_variance = |head: usize| {
        mounts.block(head).map_or(0.0, |b| (0..3).map(|k| covariance[(6 * b + k, 6 * b + k)]).fold(0.0, f64::max))
    };
    let (mut planes, mut refused) = (Vec::new(), BTreeMap::new());
    for (station, heads) in ground.patches.iter().enumerate() {
        let now: Vec<Vec<Patch>> = heads
            .iter()
            .enumerate()
            .map(|(h, patches)| patches.iter().map(|p| moved(p, &present(p, station, h, mounts, model))).collect())
            .collect();
        for i in 0..heads.len() {
            for j in i + 1..heads.len() {
                let angle_rad = (angle_variance(i) + angle_variance(j)).sqrt();
                let position_m = (0..2)
                    .filter_map(|k| mounts.block([i, j][k]))
                    .map(|b| covariance[(6 * b + 3, 6 * b + 3)])
                    .sum::<f64>()
                    .sqrt();
                let reach_m = (options.search_m + GATE_SIGMAS * (position_m + REACH_M * angle_rad)).min(WIDEST_M);
                let found = pair_heads(&now[i], &now[j], reach_m, |a, b| Gate {
                    distance_m: options.search_m + GATE_SIGMAS * variance_m2(mounts, covariance, [i, j], [a, b]).sqrt(),
                    angle_rad: options.normal_angle_rad + GATE_SIGMAS * angle_rad,
                });
                for (reason, n) in found.refused {
                    *refused.entry(reason).or_default() += n;
                }
                planes.extend(found.pairs.into_iter().map(|(a, b)| CommonPlane {
                    station,
                    heads: [i, j],
                    patches: [a, b],
                    slope: Slope::of(&now[i][a].normal),
                    fate: match (ground.held[station][i][a], ground.held[station][j][b]) {
                        (false, false) => Fate::Used,
                        (true, true) => Fate::HeldOut,
                        _ => Fate::Mixed,
                    },
                }));
            }
        }
    }
    (planes, refused)
}

/// How a patch moves at the present state.
fn present(patch: &Patch, station: usize, head: usize, mounts: &Mounts, model: &Model) -> PointMap {
    map_of(&mounts.heads[head].lever_arm_m, &model.pose_correction(station, patch.time_s), &model.calibration(head))
}

/// The pose of a station: the body frame itself.
fn pose(time_s: f64) -> Pose {
    Pose {
        time_s,
        position: Vector3::zeros(),
        ned_from_body: UnitQuaternion::new_unchecked(Quaternion::new(1.0, 0.0, 0.0, 0.0)),
        map_from_ned: Matrix3::identity(),
    }
}

/// A common plane at the present state: its patches, how they got there, and the measurement where footprints meet.
struct Seen {
    now: [Patch; 2],
    maps: [PointMap; 2],
    measurement: Option<Measurement>,
}

/// Measures the common planes at the present state: a line of two ends each, without ends where the footprints have
/// nothing in common any more; and the common points. `floor_m` is the sigma of what all points of a patch share.
#[must_use]
pub fn measured(
    ground: &Ground<'_>,
    planes: &[CommonPlane],
    model: &Model,
    floor_m: f64,
) -> Vec<(Line, Option<Vector3<f64>>)> {
    let seen: Vec<Seen> = planes.iter().map(|plane| see(ground, plane, model, floor_m)).collect();
    let raw: Vec<Raw> = planes.iter().zip(&seen).filter_map(|(plane, s)| raw(plane, s, floor_m)).collect();
    let mut normals = smoothed(&raw).into_iter();
    planes
        .iter()
        .zip(&seen)
        .map(|(plane, s)| {
            let normal = s.measurement.as_ref().and_then(|_| normals.next());
            (line(ground, plane, s, normal), s.measurement.as_ref().map(|m| m.point_m))
        })
        .collect()
}

fn see(ground: &Ground<'_>, plane: &CommonPlane, model: &Model, floor_m: f64) -> Seen {
    let rough = ground.rough(plane);
    let maps: [PointMap; 2] =
        std::array::from_fn(|k| present(rough[k], plane.station, plane.heads[k], ground.mounts, model));
    let now: [Patch; 2] = std::array::from_fn(|k| moved(rough[k], &maps[k]));
    let measurement = measure(&[&now[0], &now[1]], floor_m);
    Seen { now, maps, measurement }
}

fn raw(plane: &CommonPlane, seen: &Seen, floor_m: f64) -> Option<Raw> {
    let m = seen.measurement.as_ref()?;
    let information: f64 = seen.now.iter().map(|p| 1.0 / variance(p, floor_m)).sum();
    Some(Raw { station: plane.station, point_m: m.point_m, normal: m.normal, variance: 1.0 / information })
}

fn line(ground: &Ground<'_>, plane: &CommonPlane, seen: &Seen, smooth: Option<Vector3<f64>>) -> Line {
    let mut line = Line {
        normal: smooth.unwrap_or(seen.now[0].normal),
        class: Slope::ALL.iter().position(|s| *s == plane.slope).unwrap_or(0),
        held_out: plane.fate != Fate::Used,
        judges_only: false,
        tie: None,
        ends: Vec::new(),
    };
    let Some(measurement) = &seen.measurement else { return line };
    let rough = ground.rough(plane);
    for (k, (_, sigma_m)) in measurement.offsets.iter().enumerate() {
        let patch = &seen.now[k];
        let offset_m = -patch.normal.dot(&(measurement.point_m - patch.centroid_m)) / patch.normal.dot(&line.normal);
        let on_plane = measurement.point_m + line.normal * offset_m;
        line.ends.push(LineEnd {
            strip: Some(plane.station),
            calibration: plane.heads[k],
            time_s: rough[k].time_s,
            pose: pose(rough[k].time_s),
            lever_arm_m: ground.mounts.heads[plane.heads[k]].lever_arm_m,
            point_m: seen.maps[k].undo(&on_plane),
            offset_m,
            sigma_m: *sigma_m,
            parts: Vec::new(),
        });
    }
    line
}

/// Distance of the two planes of a line at its common place, by the rough mounting \[m\].
#[must_use]
pub fn before_m(line: &Line) -> Option<f64> {
    match line.ends.as_slice() {
        [a, b] => Some(line.normal.dot(&(a.point_m - b.point_m))),
        _ => None,
    }
}

/// The same at the state at which the line was measured \[m\].
#[must_use]
pub fn after_m(line: &Line) -> Option<f64> {
    match line.ends.as_slice() {
        [a, b] => Some(a.offset_m - b.offset_m),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_row_of_a_gate_equals_the_central_difference() {
        let arm_m = Vector3::new(0.1, -0.6, 0.4);
        let point_m = Vector3::new(12.0, -7.0, 1.5);
        let normal = Vector3::new(0.3, 0.9, -0.2).normalize();
        let moved = |k: usize, step: f64| {
            let mut correction = Calibration::default();
            match k {
                0..3 => correction.boresight_rad[k] = step,
                _ => correction.lever_arm_m[k - 3] = step,
            }
            let map = map_of(&arm_m, &PoseCorrection::default(), &correction);
            normal.dot(&(point_m + map.delta_m(&point_m)))
        };
        let analytic = row(&point_m, &arm_m, &normal);
        for k in 0..6 {
            let numeric = (moved(k, 1e-6) - moved(k, -1e-6)) / 2e-6;
            assert!((numeric - analytic[k]).abs() < 1e-6, "{k}: {numeric} {}", analytic[k]);
        }
    }

    #[test]
    fn a_line_measured_after_a_small_correction_changes_by_its_row() {
        use tieline_graph::{CalibrationSigmas, CalibrationTerms};
        use tieline_matching::Sighting;

        let patch = |scanner, normal: Vector3<f64>, centre: [f64; 3]| Patch {
            sighting: Sighting { strip: 0, pass: 0, scanner },
            time_s: 5.0,
            centroid_m: centre.into(),
            normal: normal.normalize(),
            long_axis: normal.normalize().cross(&Vector3::z()).normalize(),
            spread_m: [0.8, 0.5],
            roughness_m: 0.01,
            points: 60,
            intensity: 0.0,
        };
        let wall = Vector3::new(-1.0, 0.2, 0.05);
        let patches = vec![vec![vec![patch(0, wall, [20.0, 3.0, 0.5])], vec![patch(1, wall, [20.05, 3.1, 0.4])]]];
        let head = |scanner: u16| super::super::Head {
            scanner,
            name: scanner.to_string(),
            body_from_scanner: UnitQuaternion::identity(),
            lever_arm_m: Vector3::new(0.0, -0.6 * f64::from(scanner), 0.3),
        };
        let mounts = Mounts {
            heads: vec![head(0), head(1)],
            reference: 0,
            boresight_sigma_rad: 0.03,
            lever_arm_sigma_m: 0.3,
            if_radians: None,
        };
        let options = StationOptions::default();
        let held = vec![vec![vec![false], vec![false]]];
        let ground = Ground { mounts: &mounts, patches: &patches, held: &held, options: &options };
        let both = CalibrationTerms { boresight: true, lever_arm: true, range_offset: false, range_scale: false };
        let sigmas = CalibrationSigmas { boresight_rad: 0.03, lever_arm_m: 0.3, range_offset_m: 1.0, range_scale: 1.0 };
        let stations = vec![super::super::Station::default()];
        let mut model = Model::with_terms(
            &super::super::motion::specs(&stations),
            &[None],
            &[CalibrationTerms::NONE, both],
            &sigmas,
        );
        let plane = CommonPlane { station: 0, heads: [0, 1], patches: [0, 0], slope: Slope::Steep, fate: Fate::Used };
        let distance = |model: &Model| after_m(&measured(&ground, &[plane], model, 0.01)[0].0).expect("measured");
        let (line, _) = measured(&ground, &[plane], &model, 0.01).remove(0);
        let mut analytic = nalgebra::DVector::<f64>::zeros(model.count());
        for (end, sign) in line.ends.iter().zip([1.0, -1.0]) {
            for (i, value) in model.row(end, &line.normal) {
                analytic[i] += sign * value;
            }
        }
        for i in 0..model.count() {
            let mut step = |size: f64| {
                let mut state = nalgebra::DVector::zeros(6);
                state[i] = size;
                model.set_state(state);
                distance(&model)
            };
            let numeric: f64 = (step(1e-5) - step(-1e-5)) / 2e-5;
            // the common place wanders with the patch: of second order in the distance of the planes
            assert!(
                (numeric - analytic[i]).abs() < 0.02 * analytic[i].abs().max(1.0),
                "{i}: {numeric} {}",
                analytic[i]
            );
        }
    }
}
