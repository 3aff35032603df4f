//! A tile as each sighting saw it: ground points of one scanner in one visit, and their raster.

use super::TextureOptions;
use super::brightness::NormalLevels;
use super::ground::ground_only;
use super::keep::{TILE_M, TexturePoint, TexturePoints};
use super::plan::Plan;
use super::raster::Raster;
use crate::block::SourceKey;
use crate::xyz::spill::Tile;

/// Points of a source further apart in time are of two visits \[s\].
const VISIT_GAP_S: f64 = 2.0;

/// What one sighting saw of a tile.
#[derive(Debug)]
pub(super) struct View {
    pub(super) source: SourceKey,
    /// Places from the tile's corner, in order of time.
    pub(super) points: Vec<TexturePoint>,
    pub(super) plan: Plan,
    pub(super) raster: Raster,
    /// Standard deviation of the brightness of a point.
    pub(super) noise: f64,
    /// Points in a square metre, median.
    pub(super) density_m2: f64,
}

/// The views of a tile with a margin about it \[m\], densest first.
///
/// # Errors
/// When kept points cannot be read back.
pub(super) fn views(
    kept: &TexturePoints,
    levels: &NormalLevels,
    tile: Tile,
    margin_m: f64,
    options: &TextureOptions,
) -> std::io::Result<Vec<View>> {
    let points = points_about(kept, tile, margin_m)?;
    let mut sightings: Vec<(Vec<TexturePoint>, f64)> = points
        .chunk_by(|a, b| a.source == b.source && b.time_s - a.time_s <= VISIT_GAP_S)
        .filter_map(|of_visit| {
            let mut points = of_visit.to_vec();
            ground_only(&mut points, -margin_m, TILE_M + 2.0 * margin_m);
            let density_m2 = density_m2(&points, margin_m)?;
            (density_m2 >= options.least_density_m2).then_some((points, density_m2))
        })
        .collect();
    sightings.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0[0].source.cmp(&b.0[0].source)));
    let Some(sparsest) = sightings.last().map(|s| s.1).filter(|_| sightings.len() > 1) else { return Ok(Vec::new()) };
    let smoothing_m = (0.55 / sparsest.sqrt()).clamp(options.smoothing_m[0], options.smoothing_m[1]);
    let square = ([-margin_m; 2], TILE_M + 2.0 * margin_m);
    let view = |(points, density_m2): (Vec<TexturePoint>, f64)| {
        let value = |p: &TexturePoint| levels.relative(p.source.scanner(), f64::from(p.range_cm) / 100.0, p.intensity);
        let values: Vec<f64> = points.iter().map(value).collect();
        let place = |p: &TexturePoint| [0, 1].map(|k| f64::from(p.place_m[k]));
        let raster = Raster::new(points.iter().map(place).zip(values.iter().copied()), square, smoothing_m);
        let plan = Plan::new(&points, -margin_m, TILE_M + 2.0 * margin_m);
        View { source: points[0].source, plan, raster, noise: noise(&values), density_m2, points }
    };
    Ok(sightings.into_iter().map(view).collect())
}

/// Points of a tile and of its margin, sorted by source, time and place.
#[allow(clippy::cast_possible_truncation)] // within a few tiles
fn points_about(kept: &TexturePoints, (column, row): Tile, margin_m: f64) -> std::io::Result<Vec<TexturePoint>> {
    let mut points = Vec::new();
    for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
        let off = [f64::from(dx) * TILE_M, f64::from(dy) * TILE_M].map(|v| v as f32);
        let (low, high) = (-margin_m as f32, (TILE_M + margin_m) as f32);
        points.extend(kept.of_tile((column + dx, row + dy))?.into_iter().filter_map(|p| {
            let place_m = [p.place_m[0] + off[0], p.place_m[1] + off[1], p.place_m[2]];
            let within = place_m[..2].iter().all(|v| (low..high).contains(v));
            within.then_some(TexturePoint { place_m, ..p })
        }));
    }
    let place = |a: &TexturePoint, b: &TexturePoint, k: usize| a.place_m[k].total_cmp(&b.place_m[k]);
    points.sort_by(|a, b| {
        let by_time = a.source.cmp(&b.source).then(a.time_s.total_cmp(&b.time_s));
        by_time.then(place(a, b, 0)).then(place(a, b, 1)).then(place(a, b, 2))
    });
    Ok(points)
}

/// Median points in the square metres that hold any.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn density_m2(points: &[TexturePoint], margin_m: f64) -> Option<f64> {
    let columns = (TILE_M + 2.0 * margin_m).ceil() as usize + 1;
    let mut counts = vec![0_u32; columns * columns];
    for p in points {
        let at = [0, 1].map(|k| (f64::from(p.place_m[k]) + margin_m).max(0.0) as usize);
        counts[at[1].min(columns - 1) * columns + at[0].min(columns - 1)] += 1;
    }
    counts.retain(|n| *n > 0);
    counts.sort_unstable();
    counts.get(counts.len() / 2).map(|n| f64::from(*n))
}

/// Standard deviation of the brightness of a point: by the differences of points that follow each other.
fn noise(values: &[f64]) -> f64 {
    let mut steps: Vec<f64> = values.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    if steps.is_empty() {
        return 1.0;
    }
    let middle = steps.len() / 2;
    let (_, median, _) = steps.select_nth_unstable_by(middle, f64::total_cmp);
    (*median / 0.953_9).max(0.01) // |difference of two normal deviates|: median 0.6745 √2 sigmas
}
