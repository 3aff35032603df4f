//! Submaps of a survey: each tile's sightings registered on each other along a tree, judged pair by pair.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use nalgebra::Vector3;
use rayon::prelude::*;
use tieline_matching::xyz::{Cloud, SubmapTie, Tile, TileOptions, TilePoints, judge_submaps, tie_submap};
use tieline_matching::{Sighting, StripIndex};

use super::{Direction, Part, PlaceKind, PlaceTie, Places};
use crate::settings::Settings;

/// Tiles worked on at a time, for each thread.
const BATCH: usize = 4;
/// A strip that comes back to a tile later than this sees it a second time \[s\].
const PASS_S: f64 = 16.0;
/// Fewest points of a sighting in a tile.
const FEWEST_POINTS: usize = 500;
/// Squares by which two sightings are seen to overlap \[m\], and the fewest that both must have points in \[m²\].
const SQUARE_M: f64 = 2.5;
const LEAST_OVERLAP_M2: f64 = 200.0;

/// Directions steeper than this by their upward part are heights.
const UPRIGHT: f64 = 0.9;

/// What one sighting saw of a tile.
struct View {
    sighting: Sighting,
    points_m: Vec<Vector3<f64>>,
    time_s: Vec<f64>,
    /// Squares with points, in order.
    squares: Vec<(i32, i32)>,
}

impl View {
    fn cloud(&self) -> Cloud<'_> {
        Cloud { points_m: &self.points_m, time_s: &self.time_s }
    }
}

/// A tile registered for a pair of sightings.
type OfPair = ([Sighting; 2], SubmapTie);

/// Registers all tiles and appends their ties.
pub(super) fn find(points: &TilePoints, strips: &StripIndex, settings: &Settings, places: &mut Places) -> Result<()> {
    let options = TileOptions { tile_m: points.choice.tile_m, ..TileOptions::default() };
    let tiles = points.tiles();
    let mut by_pair: BTreeMap<[Sighting; 2], Vec<SubmapTie>> = BTreeMap::new();
    for batch in tiles.chunks(BATCH * rayon::current_num_threads().max(1)) {
        let found: Vec<Result<Vec<OfPair>>> =
            batch.par_iter().map(|tile| of_tile(points, *tile, strips, settings, &options)).collect();
        for tile in found {
            for (pair, tie) in tile? {
                by_pair.entry(pair).or_default().push(tie);
            }
        }
    }
    for (pair, mut ties) in by_pair {
        judge_submaps(&mut ties, &options);
        for tie in ties {
            let why_not = tie.rejection.as_ref().map(|r| r.as_str().to_string());
            if let Some(why_not) = &why_not {
                places.reject(PlaceKind::Submap, why_not);
            }
            let mut found = place_tie(pair, &tie, settings.pairing.sigma_floor_m, why_not);
            if settings.surface_lines
                && let Some(tie) = found.as_mut().filter(|t| t.why_not.is_none())
            {
                leave_heights(tie, places);
            }
            places.ties.extend(found);
        }
    }
    Ok(())
}

/// Surface lines have the heights from the same points: told twice they would count twice.
fn leave_heights(tie: &mut PlaceTie, places: &mut Places) {
    let is_height = |d: &Direction| d.direction.z.abs() >= UPRIGHT;
    if tie.directions.iter().all(is_height) {
        places.reject(PlaceKind::Submap, "height_only");
        tie.why_not = Some("height_only".to_string());
    } else {
        tie.directions.retain(|d| !is_height(d));
    }
}

fn of_tile(
    points: &TilePoints,
    tile: Tile,
    strips: &StripIndex,
    settings: &Settings,
    options: &TileOptions,
) -> Result<Vec<OfPair>> {
    let views = views(points, tile, strips, settings)?;
    let centre_m = points.choice.corner_m(tile).map(|c| c + 0.5 * points.choice.tile_m);
    let tie = |(i, j): (usize, usize)| {
        let mut tie = tie_submap(centre_m, &views[i].cloud(), &views[j].cloud(), options);
        if let Some(found) = &mut tie.registration {
            // what they say is in the carriers: thousands of tiles would hold millions of them
            (found.facets, found.used) = (Vec::new(), Vec::new());
        }
        ([views[i].sighting, views[j].sighting], tie)
    };
    Ok(tree(&views, strips).into_par_iter().map(tie).collect())
}

/// The sightings of a tile, in order.
#[allow(clippy::cast_possible_truncation)] // squares of a tile
fn views(points: &TilePoints, tile: Tile, strips: &StripIndex, settings: &Settings) -> Result<Vec<View>> {
    let kept = points.of_tile(tile).context("a temporary file of points cannot be read back")?;
    let mut passes: BTreeMap<Sighting, View> = BTreeMap::new();
    let mut last: Option<(Sighting, f64)> = None;
    for point in &kept {
        let Some((strip, scanner)) = strips.find(point.source, point.time_s) else { continue };
        if settings.limits.scanners.as_ref().is_some_and(|s| !s.contains(&scanner)) {
            continue;
        }
        // points come by source and time
        let pass = match last {
            Some((s, time_s)) if s.strip == strip && s.scanner == scanner => {
                s.pass + u16::from(point.time_s - time_s > PASS_S)
            }
            _ => 0,
        };
        let sighting = Sighting { strip, pass, scanner };
        last = Some((sighting, point.time_s));
        let view = passes.entry(sighting).or_insert_with(|| View {
            sighting,
            points_m: Vec::new(),
            time_s: Vec::new(),
            squares: Vec::new(),
        });
        view.points_m.push(points.choice.place_m(tile, point));
        view.time_s.push(point.time_s);
    }
    let mut views: Vec<View> = passes.into_values().filter(|v| v.points_m.len() >= FEWEST_POINTS).collect();
    for view in &mut views {
        let square = |v: f64| (v / SQUARE_M).floor() as i32;
        view.squares = view.points_m.iter().map(|p| (square(p.x), square(p.y))).collect();
        view.squares.sort_unstable();
        view.squares.dedup();
    }
    Ok(views)
}

/// The pairs to register: a tree over the sightings. More pairs would tell the same noise twice.
///
/// Of pairs that share half and more of what the smaller one sees, those come first whose strips have most points, so that
/// neighbouring tiles are tied by the same pairs, which judge each other; then others by the area that they share.
#[allow(clippy::cast_precision_loss)]
fn tree(views: &[View], strips: &StripIndex) -> Vec<(usize, usize)> {
    let shared = |a: &View, b: &View| a.squares.iter().filter(|s| b.squares.binary_search(s).is_ok()).count();
    let points = |v: &View| strips.strips().get(v.sighting.strip as usize).map_or(0, |s| s.points);
    let mut order: Vec<usize> = (0..views.len()).collect();
    order.sort_by(|a, b| points(&views[*b]).cmp(&points(&views[*a])).then(a.cmp(b)));
    let mut pairs: Vec<(usize, (usize, usize))> = Vec::new();
    for (rank, i) in order.iter().enumerate() {
        for j in &order[rank + 1..] {
            let squares = shared(&views[*i], &views[*j]);
            let most = views[*i].squares.len().min(views[*j].squares.len());
            if squares as f64 * SQUARE_M * SQUARE_M >= LEAST_OVERLAP_M2 {
                // all that share enough count alike, in the order in which they come here
                pairs.push((if 2 * squares >= most { usize::MAX } else { squares }, (*i.min(j), *i.max(j))));
            }
        }
    }
    pairs.sort_by_key(|p| std::cmp::Reverse(p.0));
    let mut group: Vec<usize> = (0..views.len()).collect();
    let mut kept = Vec::new();
    for (_, (i, j)) in pairs {
        let (from, to) = (group[j], group[i]);
        if from != to {
            group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
            kept.push((i, j));
        }
    }
    kept
}

/// A registered tile as a tie: the fixed cloud is the first, and first less second place is the shift of the moving one. `floor_m` is what
/// all points of a strip in a second have in common, as at the ends of surface lines.
fn place_tie(sightings: [Sighting; 2], tie: &SubmapTie, floor_m: f64, why_not: Option<String>) -> Option<PlaceTie> {
    let found = tie.registration.as_ref()?;
    let directions = found.held.directions.column_iter().zip(found.held.sigma_m.iter()).zip(&found.carriers);
    let directions = directions.map(|((e, sigma_m), carriers)| {
        let direction = Vector3::new(e[0], e[1], e[2]);
        let part = |c: &tieline_matching::xyz::Carrier| Part {
            along: c.along,
            points_m: [c.centre_m, c.centre_m - found.shift_m],
            time_s: c.time_s,
        };
        Direction {
            direction,
            distance_m: direction.dot(&found.shift_m),
            sigma_m: sigma_m.hypot(std::f64::consts::SQRT_2 * floor_m),
            parts: carriers.iter().map(part).collect(),
        }
    });
    Some(PlaceTie {
        kind: PlaceKind::Submap,
        sightings,
        points_m: [found.origin_m, found.origin_m - found.shift_m],
        time_s: found.time_s,
        directions: directions.collect(),
        held_out: false,
        why_not,
    })
}
