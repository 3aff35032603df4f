//! From summed cells to selected ties.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result};
use nalgebra::Vector3;
use rayon::prelude::*;
use tieline_filter::Pose;
use tieline_matching::xyz::{StreetCorner, StreetCornerOptions, street_corners};
use tieline_matching::{
    BinSketch, Cell, End, Patch, RejectOptions, Rejection, RowEnd, Sighting, SourceKey, Spacing, StripIndex,
    SurfaceLine, TileMerge, is_held_out, line_of, mix, normal_bin, pair_rows, patches_of_tile, reject_by_distance,
    select,
};

use crate::project::SurfaceWord;
use crate::settings::{Grouping, Limits, Settings};
use crate::stage::drive::over::incidence_deg;
use crate::stage::places::{Places, corners::FacePatches};
use crate::stage::scan::Scan;
use crate::stage::trajectory::Poses;

/// Strip number of a known point.
pub const CONTROL_STRIP: u32 = u32::MAX;

/// The ties of a survey.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Ties {
    /// Lines with at least one other end, used or not.
    pub lines: Vec<SurfaceLine>,
    /// Rows of `lines` selected for the solution or held out.
    pub selected: Vec<usize>,
    /// For each selected line: whether it is held out.
    pub held_out: Vec<bool>,
    /// Patches found.
    pub patches: u64,
    /// Lines found with two ends or more.
    pub found: u64,
    /// Ends rejected, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// Of a drive: patches that belong to no line but have one of another sighting not far off. Where the trajectory is better known
    /// they may turn out to be of one surface.
    #[serde(default)]
    pub lone: Vec<Patch>,
    /// Of strips: ties of places, which hold several directions.
    #[serde(default)]
    pub places: Places,
    /// Whether the surface lines judge the solution only.
    #[serde(default)]
    pub lines_judge: bool,
}

/// A known point on a surface, in the local frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlPoint {
    /// Position \[m\].
    pub point_m: Vector3<f64>,
    /// Sigma along any normal \[m\].
    pub sigma_m: f64,
}

/// What one tile gives: patches, those refused by reason, ties found, ties kept, lines without a tie.
struct OfTile {
    patches: u64,
    refused: BTreeMap<Rejection, u64>,
    found: u64,
    tied: Vec<SurfaceLine>,
    loose: Vec<SurfaceLine>,
    lone: Vec<Patch>,
    faces: Vec<Patch>,
    corners: Vec<StreetCorner>,
}

/// Tiles worked on at a time.
const BATCH: usize = 64;
/// Candidates kept per tie of the budget.
const CANDIDATES: usize = 2;

/// What [`find`] finds.
#[derive(Debug)]
pub struct Found {
    /// Surface lines.
    pub ties: Ties,
    /// Of strips: the patches that corners are looked for in, where they are asked for.
    pub faces: Option<FacePatches>,
    /// Of drives: corners of walls, where they are asked for.
    pub corners: Vec<StreetCorner>,
}

/// Finds, rejects and selects the surface lines of a survey; corners of walls, or the patches that corners of roofs are looked for in, as well.
///
/// # Errors
/// When cells that were spilled to disk cannot be read back.
pub fn find(
    scan: Scan,
    strips: &StripIndex,
    settings: &Settings,
    control: &[ControlPoint],
    poses: &Poses,
    corners: Option<&StreetCornerOptions>,
) -> Result<Found> {
    let (mut ties, mut all_corners) = (Ties::default(), Vec::new());
    let tiles = tiles(&scan.sketches, settings);
    let per_tile = (CANDIDATES * settings.max_ties).div_ceil(tiles.max(1)).max(12);
    let mut faces = FacePatches::new(settings, tiles);
    let mut merge = TileMerge::new(scan.runs).context("reading back a temporary file")?;
    loop {
        let mut batch = Vec::with_capacity(BATCH);
        while batch.len() < BATCH {
            let Some(cells) = merge.next_tile().context("reading back a temporary file")? else { break };
            batch.push(cells);
        }
        if batch.is_empty() {
            break;
        }
        let found: Vec<OfTile> = batch
            .into_par_iter()
            .map(|cells| {
                let faces = faces.as_ref().map_or_else(Vec::new, |f| faces_of(&cells, f, strips, settings, poses));
                let cells = thin_cells(cells, 3 * per_tile / 2, settings);
                let mut patches = patches_of_tile(&cells, &settings.grid, strips, &settings.patch);
                let count = patches.len() as u64;
                let (mut refused, mut grazing) = (BTreeMap::new(), Vec::new());
                patches.retain(|p| {
                    let why = beyond(p, &settings.limits, poses, &settings.grid.origin_m);
                    if corners.is_some()
                        && why == Some(Rejection::Grazing)
                        && SurfaceWord::of(p.normal.z) == SurfaceWord::Level
                    {
                        grazing.push(p.clone());
                    }
                    why.map(|why| *refused.entry(why).or_default() += 1).is_none()
                });
                if settings.is_drive {
                    face_the_vehicle(&mut patches, poses, &settings.grid.origin_m);
                }
                let corners = corners.map_or_else(Vec::new, |options| {
                    // the foot of a wall is met at a grazing angle: its height is known all the same, from many patches
                    let all: Vec<Patch> = patches.iter().cloned().chain(grazing).collect();
                    street_corners(&all, options)
                });
                thin_level(&mut patches, per_tile.div_ceil(2), settings);
                add_control(&mut patches, control, settings);
                let rows = pair_rows(&patches, &settings.pairing);
                let lone = if settings.is_drive { lone(&patches, &rows, per_tile, settings) } else { Vec::new() };
                let lines = rows.iter().map(|ends| line_of(&patches, ends));
                let (tied, loose): (Vec<_>, Vec<_>) = lines.partition(SurfaceLine::is_tie);
                let found = tied.len() as u64;
                let (tied, loose) = (thin(tied, per_tile), loose.into_iter().take(per_tile / 4).collect());
                OfTile { patches: count, refused, found, tied, loose, lone, faces, corners }
            })
            .collect();
        for tile in found {
            for (why, count) in tile.refused {
                *ties.rejected.entry(why.as_str().to_string()).or_default() += count;
            }
            ties.patches += tile.patches;
            ties.found += tile.found;
            ties.lines.extend(tile.tied);
            ties.lines.extend(tile.loose);
            ties.lone.extend(tile.lone);
            all_corners.extend(tile.corners);
            if let Some(faces) = &mut faces {
                faces.keep(tile.faces);
            }
        }
    }
    judge(&mut ties, strips, settings);
    ties.lines_judge = !settings.surface_lines;
    if ties.lines_judge {
        ties.held_out.fill(true);
    }
    Ok(Found { ties, faces, corners: all_corners })
}

/// Sloped and steep patches of all cells of a tile: a roof needs its neighbours, so that none are thinned out.
fn faces_of(
    cells: &[Cell],
    faces: &FacePatches,
    strips: &StripIndex,
    settings: &Settings,
    poses: &Poses,
) -> Vec<Patch> {
    let Some(cell) = cells.first() else { return Vec::new() };
    let [x, y, _] = cell.key.place.indices();
    if !faces.takes([x, y].map(|i| (f64::from(i) + 0.5) * settings.grid.cell_m())) {
        return Vec::new();
    }
    let mut patches = patches_of_tile(cells, &settings.grid, strips, &settings.patch);
    patches.retain(|p| beyond(p, &settings.limits, poses, &settings.grid.origin_m).is_none());
    faces.of(&patches)
}

/// Why a patch takes no part: beyond the limits that were asked for, or seen at a grazing angle.
fn beyond(patch: &Patch, limits: &Limits, poses: &Poses, origin_m: &[f64; 3]) -> Option<Rejection> {
    let map_m = patch.centroid_m + Vector3::from(*origin_m);
    let in_area = limits.area_m.is_none_or(|[west, south, east, north]| {
        (west..=east).contains(&map_m.x) && (south..=north).contains(&map_m.y)
    });
    let of_scanner = limits.scanners.as_ref().is_none_or(|s| s.contains(&patch.sighting.scanner));
    // control surfaces have no pose: no range and no beam
    let pose = || poses.at(patch.sighting.strip, patch.time_s);
    let in_range = limits
        .range_m
        .is_none_or(|[near, far]| pose().is_none_or(|pose| (near..=far).contains(&(map_m - pose.position).norm())));
    let of_kind = limits.surfaces.as_ref().is_none_or(|s| s.contains(&SurfaceWord::of(patch.normal.z)));
    if !(in_area && of_scanner && in_range && of_kind) {
        return Some(Rejection::Limits);
    }
    let largest_deg = limits.max_incidence_deg?;
    let pose = pose()?;
    let lever_arm_m =
        limits.lever_arms_m.get(&patch.sighting.scanner).map_or_else(Vector3::zeros, |a| Vector3::from(*a));
    is_grazing(&(map_m - pose.position), &patch.normal, &pose, &lever_arm_m, largest_deg).then_some(Rejection::Grazing)
}

/// Whether the beam of a scanner meets a surface at more than an angle \[deg\] from its normal (map axes). `offset_m` leads from the pose to the
/// surface, in the map; the lever arm from the IMU to the scanner, in the body.
fn is_grazing(
    offset_m: &Vector3<f64>,
    normal: &Vector3<f64>,
    pose: &Pose,
    lever_arm_m: &Vector3<f64>,
    largest_deg: f64,
) -> bool {
    incidence_deg(normal, &(offset_m - pose.map_from_ned * (pose.ned_from_body * lever_arm_m))) > largest_deg
}

/// Number of tiles that hold points, by the sparse sample.
#[allow(clippy::cast_possible_truncation)]
fn tiles(sketches: &[((SourceKey, i64), BinSketch)], settings: &Settings) -> usize {
    let width_m = settings.grid.cell_m() * 32.0;
    sketches
        .iter()
        .flat_map(|(_, bin)| bin.samples())
        .map(|s| ((s.point_m[0] / width_m).floor() as i64, (s.point_m[1] / width_m).floor() as i64))
        .collect::<BTreeSet<_>>()
        .len()
}

/// Where a tile has more room for ties than the budget can use, keeps whole blocks of columns, chosen by a hash of their
/// place: `limit` is the number of largest cells to look at.
#[allow(clippy::cast_precision_loss, clippy::cast_sign_loss)]
fn thin_cells(mut cells: Vec<Cell>, limit: usize, settings: &Settings) -> Vec<Cell> {
    let nodes = (1_usize << (5 - settings.patch.levels.min(5))).pow(2); // in a full tile of 32 × 32 columns
    if limit < nodes {
        let share = limit as f64 / nodes as f64;
        let block = |cell: &Cell| {
            let [x, y, _] = cell.key.place.indices();
            mix(mix((x >> 2) as u64) ^ (y >> 2) as u64) as f64
        };
        cells.retain(|cell| block(cell) < share * u64::MAX as f64);
    }
    cells
}

/// Where a tile has far more level patches than it needs, keeps whole blocks of them, chosen by a hash of their place;
/// sloped and steep ones all stay: they are few and carry what level ones cannot.
#[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss, clippy::cast_sign_loss)]
fn thin_level(patches: &mut Vec<Patch>, limit: usize, settings: &Settings) {
    let width_m = settings.grid.cell_m() * 4.0;
    let block = |p: &Patch| {
        let square = |v: f64| (v / width_m).floor() as i64 as u64;
        mix(mix(square(p.centroid_m.x)) ^ square(p.centroid_m.y))
    };
    let sightings: BTreeSet<Sighting> = patches.iter().map(|p| p.sighting).collect();
    let level = patches.iter().filter(|p| normal_bin(&p.normal) == 0).count();
    let share = (limit * sightings.len().max(2)) as f64 / level.max(1) as f64;
    if share < 0.8 {
        patches.retain(|p| normal_bin(&p.normal) != 0 || (block(p) as f64) < share * u64::MAX as f64);
    }
}

/// Turns the normals of walls towards the vehicle: the sign of one that lies level is chance, and two sightings of a wall would be taken for its
/// two sides.
fn face_the_vehicle(patches: &mut [Patch], poses: &Poses, origin_m: &[f64; 3]) {
    for patch in patches.iter_mut().filter(|p| SurfaceWord::of(p.normal.z) == SurfaceWord::Steep) {
        let Some(pose) = poses.at(patch.sighting.strip, patch.time_s) else { continue };
        if patch.normal.dot(&(patch.centroid_m + Vector3::from(*origin_m) - pose.position)) > 0.0 {
            patch.normal = -patch.normal;
        }
    }
}

/// Patches that no line holds, with one of another sighting as near as a trajectory may be wrong; as many as a tile keeps of ties.
#[allow(clippy::cast_possible_truncation)] // squares of a tile
fn lone(patches: &[Patch], lines: &[Vec<RowEnd>], limit: usize, settings: &Settings) -> Vec<Patch> {
    /// As near as so many search distances.
    const REACH: f64 = 4.0;
    let reach_m = REACH * settings.pairing.search_m;
    let square = |p: &Patch| [p.centroid_m.x, p.centroid_m.y].map(|v| (v / reach_m).floor() as i64);
    let mut seen: BTreeMap<[i64; 2], BTreeSet<Sighting>> = BTreeMap::new();
    for patch in patches {
        seen.entry(square(patch)).or_default().insert(patch.sighting);
    }
    let in_line: BTreeSet<usize> = lines.iter().flatten().map(|(row, _)| *row).collect();
    let has_neighbour = |p: &Patch| {
        let [x, y] = square(p);
        (-1..=1).any(|i| {
            (-1..=1).any(|j| seen.get(&[x + i, y + j]).is_some_and(|s| s.iter().any(|other| *other != p.sighting)))
        })
    };
    let alone = patches.iter().enumerate().filter(|(row, p)| !in_line.contains(row) && has_neighbour(p));
    let lines = alone.map(|(_, p)| SurfaceLine { ends: vec![End { patch: p.clone(), rejection: None }] }).collect();
    thin(lines, limit).into_iter().flat_map(|line| line.ends).map(|end| end.patch).collect()
}

/// A known point becomes a patch without extent of its own: it takes the plane of the patch that it lies on.
fn add_control(patches: &mut Vec<Patch>, control: &[ControlPoint], settings: &Settings) {
    let mut added = Vec::new();
    for known in control {
        let on = |p: &&Patch| {
            let d = known.point_m - p.centroid_m;
            let [a, b] = p.half_extent_m();
            d.dot(&p.long_axis).abs() <= a
                && d.dot(&p.cross_axis()).abs() <= b
                && d.dot(&p.normal).abs() <= settings.pairing.search_m
        };
        if let Some(patch) = patches.iter().filter(on).max_by_key(|p| p.points) {
            added.push(Patch {
                sighting: Sighting { strip: CONTROL_STRIP, pass: 0, scanner: 0 },
                centroid_m: known.point_m,
                roughness_m: known.sigma_m * 3.0,
                points: 9,
                ..patch.clone()
            });
        }
    }
    patches.extend(added);
}

/// Keeps the most informative ties of a tile, in turn over the directions of their normals.
fn thin(mut lines: Vec<SurfaceLine>, limit: usize) -> Vec<SurfaceLine> {
    if lines.len() <= limit {
        return lines;
    }
    let weight = |l: &SurfaceLine| l.used().map(|(_, p)| f64::from(p.points) / p.roughness_m.powi(2)).sum::<f64>();
    let mut bins: BTreeMap<u8, Vec<(f64, usize)>> = BTreeMap::new();
    for (i, line) in lines.iter().enumerate() {
        bins.entry(normal_bin(&line.ends[0].patch.normal)).or_default().push((weight(line), i));
    }
    for rows in bins.values_mut() {
        rows.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    }
    let deepest = bins.values().map(Vec::len).max().unwrap_or(0);
    let mut keep: Vec<usize> =
        (0..deepest).flat_map(|rank| bins.values().filter_map(move |r| r.get(rank).map(|x| x.1))).take(limit).collect();
    keep.sort_unstable();
    let mut row = 0;
    lines.retain(|_| {
        row += 1;
        keep.binary_search(&(row - 1)).is_ok()
    });
    lines
}

/// Rejects by distance, selects to the budget, holds out by place.
fn judge(ties: &mut Ties, strips: &StripIndex, settings: &Settings) {
    let grouping = settings.grouping();
    ties.selected = reject_and_select(&mut ties.lines, strips, &grouping);
    ties.held_out = ties
        .selected
        .iter()
        .map(|i| {
            let known = ties.lines[*i].used().any(|(_, p)| p.sighting.strip == CONTROL_STRIP);
            !known && is_held_out(&ties.lines[*i], grouping.seed, grouping.hold_out, grouping.place_m)
        })
        .collect();
    mark_budget(ties);
}

/// Rejects ends by their distances and selects lines to the budget: their rows.
pub(crate) fn reject_and_select(lines: &mut [SurfaceLine], strips: &StripIndex, grouping: &Grouping) -> Vec<usize> {
    let options = RejectOptions { sigma_floor_m: grouping.pairing.sigma_floor_m, ..RejectOptions::default() };
    reject_by_distance(lines, Clone::clone, &options);
    let spacing = Spacing { distance_m: grouping.spacing.0, time_s: grouping.spacing.1 };
    let spans: Vec<(f64, f64)> = strips.strips().iter().map(|s| (s.start_s, s.end_s)).collect();
    select(lines, grouping.max_ties, spacing, |strip| spans.get(strip as usize).copied().unwrap_or((0.0, 1.0)))
}

/// Marks the ties that the budget left out, counts all reasons, and lets go of most of the ties left out for nothing but
/// the budget: they are counted, and a sample of them stays for the maps.
fn mark_budget(ties: &mut Ties) {
    const KEPT_FOR_THE_MAPS: usize = 1_000;
    let selected: BTreeSet<usize> = ties.selected.iter().copied().collect();
    let mut left_out = 0;
    let mut keep = Vec::with_capacity(ties.lines.len());
    for (i, line) in ties.lines.iter_mut().enumerate() {
        let unused = !selected.contains(&i) && line.is_tie();
        if unused {
            for end in line.ends.iter_mut().filter(|e| e.rejection.is_none()) {
                end.rejection = Some(Rejection::Budget);
            }
            left_out += 1;
        }
        for reason in line.ends.iter().filter_map(|e| e.rejection) {
            *ties.rejected.entry(reason.as_str().to_string()).or_default() += 1;
        }
        keep.push(!unused || left_out <= KEPT_FOR_THE_MAPS);
    }
    ties.keep(&keep);
}

#[cfg(test)]
mod tests {
    use tieline_filter::{map_from_ned, ned_from_body};

    use super::*;

    #[test]
    fn the_angle_is_that_of_the_beam_from_the_scanner() {
        // heading east on the map, the scanner 2 m ahead of the IMU and 1 m above it
        let pose = Pose {
            time_s: 0.0,
            position: Vector3::zeros(),
            ned_from_body: ned_from_body(0.0, 0.0, std::f64::consts::FRAC_PI_2),
            map_from_ned: map_from_ned(0.0, 1.0),
        };
        let scanner_m = Vector3::new(2.0, 0.0, -1.0);
        // level ground 1 m below the IMU: 2 m below the scanner, and so far ahead of it
        let ahead = |way_m: f64| Vector3::new(2.0 + way_m, 0.0, -1.0);
        for (way_m, deg) in [(2.0, 45.0), (2.0 * 75.0_f64.to_radians().tan(), 75.0)] {
            let grazing = |limit_deg| is_grazing(&ahead(way_m), &Vector3::z(), &pose, &scanner_m, limit_deg);
            assert!(grazing(deg - 0.01) && !grazing(deg + 0.01), "{deg}");
            // which way the normal leads does not matter
            assert!(is_grazing(&ahead(way_m), &-Vector3::z(), &pose, &scanner_m, deg - 0.01));
        }
    }
}
