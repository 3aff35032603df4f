//! Spots: where the brightness of a tile varies in two directions, and where other sightings see the same.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::TextureOptions;
use super::correlate::is_supported;
use super::ground::foot;
use super::keep::{TILE_M, TexturePoints};
use super::matching::{Matching, alike_m, half_cells};
use super::tie::{SpotRejection, SpotTie};
use super::view::{View, views};
use crate::xyz::spill::Tile;

/// Sightings of one source that lie nearer in time are of one visit \[s\].
const SAME_VISIT_S: f64 = 8.0;
/// Tiles worked on at a time.
const BATCH: usize = 32;

/// A place that cannot be tied, and why.
type Unfit = ([f64; 2], SpotRejection);
/// So far from a place that cannot be tied another is tried \[m\].
const UNFIT_M: f64 = 0.5;

/// Finds and matches the spots of all tiles; `search_m` is how far two sightings of these times may lie apart \[m\], `most_search_m` its bound.
/// The ties are not judged by their neighbours yet.
///
/// # Errors
/// When kept points cannot be read back.
pub fn find_spots(
    kept: &TexturePoints,
    search_m: &(dyn Fn(f64, f64) -> f64 + Sync),
    most_search_m: f64,
    options: &TextureOptions,
) -> std::io::Result<Vec<SpotTie>> {
    let levels = kept.brightness().normal_levels();
    let margin_m = 0.5 * options.window_m + most_search_m + 0.2;
    let mut found: Vec<SpotTie> = Vec::new();
    for batch in kept.tiles().chunks(BATCH) {
        let of_batch: Vec<std::io::Result<Vec<SpotTie>>> = batch
            .par_iter()
            .with_max_len(1)
            .map(|tile| {
                let views = views(kept, &levels, *tile, margin_m, options)?;
                Ok(of_tile(&views, *tile, (search_m, most_search_m), options))
            })
            .collect();
        for ties in of_batch {
            let ties = ties?;
            let first = found.last().map_or(0, |t| t.spot + 1);
            found.extend(ties.into_iter().map(|t| SpotTie { spot: t.spot + first, ..t }));
        }
    }
    leave_out_near(&mut found, options.spacing_m);
    Ok(found)
}

/// Of matches of the same two sightings whose windows overlap over the border of two tiles, the first found stays: they share edges, and errors.
#[allow(clippy::cast_possible_truncation)] // squares of a survey
fn leave_out_near(ties: &mut [SpotTie], spacing_m: f64) {
    let square = |place_m: &Vector3<f64>| [0, 1].map(|k| (place_m[k] / spacing_m).floor() as i64);
    let mut kept: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for k in 0..ties.len() {
        if ties[k].rejection.is_some() {
            continue;
        }
        let (tie, [x, y]) = (&ties[k], square(&ties[k].ends[0].place_m));
        let shares = |other: &SpotTie| {
            let sightings = |t: &SpotTie| {
                let [a, b] = t.ends.each_ref().map(|e| (e.source, e.time_s));
                if a.0 < b.0 || (a.0 == b.0 && a.1 <= b.1) { [a, b] } else { [b, a] }
            };
            let pairs = sightings(other).into_iter().zip(sightings(tie));
            other.spot != tie.spot
                && pairs.into_iter().all(|(a, b)| a.0 == b.0 && (a.1 - b.1).abs() < SAME_VISIT_S)
                && (other.ends[0].place_m - tie.ends[0].place_m).xy().norm() < spacing_m
        };
        let about = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| [x, y]));
        if about.filter_map(|at| kept.get(&at)).flatten().any(|other| shares(&ties[*other])) {
            ties[k].rejection = Some(SpotRejection::Near);
        } else {
            kept.entry([x, y]).or_default().push(k);
        }
    }
}

fn of_tile(
    views: &[View],
    tile: Tile,
    (search_m, most_search_m): (&(dyn Fn(f64, f64) -> f64 + Sync), f64),
    options: &TextureOptions,
) -> Vec<SpotTie> {
    let mut taken: Vec<[f64; 2]> = Vec::new();
    let mut ties = Vec::new();
    let mut spot = 0;
    for (k, view) in views.iter().enumerate().take(views.len().saturating_sub(1)) {
        let (places, unfit) = candidates(view, &mut taken, options);
        for (place_m, rejection) in unfit {
            let mut others = views[k + 1..].iter().map(|o| Matching::new([view, o], &[], (tile, options)));
            if let Some(tied) = others.find(|tied| tied.reaches(place_m)) {
                ties.push(tied.untied(spot, place_m, rejection));
                spot += 1;
            }
        }
        for place_m in places {
            let alike_m = alike_m(&view.raster, place_m, options);
            let search = (search_m, most_search_m);
            let of_spot: Vec<SpotTie> = views[k + 1..]
                .iter()
                .filter_map(|other| Matching::new([view, other], &alike_m, (tile, options)).spot(place_m, spot, search))
                .collect();
            spot += u32::from(!of_spot.is_empty());
            ties.extend(of_spot);
        }
    }
    ties
}

/// Places of a view whose brightness varies in two directions, the most distinct first, apart from each other and from those taken before; and those that cannot be tied
/// to any other, with the reason: they take no room from their neighbours.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn candidates(view: &View, taken: &mut Vec<[f64; 2]>, options: &TextureOptions) -> (Vec<[f64; 2]>, Vec<Unfit>) {
    /// The least curvature over that of noise alone.
    const OVER_NOISE: f64 = 4.0;
    const STEP: usize = 3;
    let raster = &view.raster;
    let (w, h) = (raster.columns, raster.rows);
    // sums from the south-west corner: g_x², g_x g_y, g_y², cells seen
    let mut sums = vec![[0.0_f64; 4]; (w + 1) * (h + 1)];
    for y in 0..h {
        let mut row = [0.0; 4];
        for x in 0..w {
            let g = raster.gradient(x, y).map(f64::from);
            if (g[0] + g[1]).is_finite() {
                for (r, v) in row.iter_mut().zip([g[0] * g[0], g[0] * g[1], g[1] * g[1], 1.0]) {
                    *r += v;
                }
            }
            let below = sums[y * (w + 1) + x + 1];
            sums[(y + 1) * (w + 1) + x + 1] = std::array::from_fn(|k| below[k] + row[k]);
        }
    }
    let half = half_cells(raster, options);
    // variance of a gradient of noise: that of the raster over 2 s², in cells
    let s = raster.smoothing_m / raster.cell_m;
    let in_bell = view.density_m2 * 4.0 * std::f64::consts::PI * raster.smoothing_m.powi(2);
    let of_noise = view.noise.powi(2) / in_bell.max(1.0) / (2.0 * s * s);
    let mut found: Vec<(f64, [f64; 2])> = Vec::new();
    for y in (half..h.saturating_sub(half)).step_by(STEP) {
        for x in (half..w.saturating_sub(half)).step_by(STEP) {
            let place_m = raster.place_m(x, y);
            if !place_m.iter().all(|v| (0.0..TILE_M).contains(v)) {
                continue;
            }
            let corner = |x: usize, y: usize| sums[y * (w + 1) + x];
            let (a, b) = (corner(x - half, y - half), corner(x + half, y - half));
            let (c, d) = (corner(x - half, y + half), corner(x + half, y + half));
            let [xx, xy, yy, seen]: [f64; 4] = std::array::from_fn(|k| d[k] - b[k] - c[k] + a[k]);
            let least = 0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
            if seen > 0.0 && least > OVER_NOISE * of_noise * seen {
                found.push((least, place_m));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1[0].total_cmp(&b.1[0])).then(a.1[1].total_cmp(&b.1[1])));
    let (mut places, mut unfit) = (Vec::new(), Vec::<Unfit>::new());
    let apart = |a: [f64; 2], b: [f64; 2], by_m: f64| (a[0] - b[0]).hypot(a[1] - b[1]) >= by_m;
    for (_, place_m) in found {
        if !taken.iter().all(|t| apart(*t, place_m, options.spacing_m))
            || !unfit.iter().all(|u| apart(u.0, place_m, UNFIT_M))
        {
            continue;
        }
        if let Some(rejection) = why_unfit(view, place_m, options) {
            unfit.push((place_m, rejection));
        } else {
            taken.push(place_m);
            places.push(place_m);
        }
    }
    (places, unfit)
}

/// Why a place cannot be tied whatever the other views see.
fn why_unfit(view: &View, place_m: [f64; 2], options: &TextureOptions) -> Option<SpotRejection> {
    if foot(&view.points, &view.plan, place_m, options.height_floor_m).is_none() {
        return Some(SpotRejection::NoPlane);
    }
    let cell = view.raster.cell_at(place_m)?;
    (!is_supported(&view.raster, cell, half_cells(&view.raster, options))).then_some(SpotRejection::Support)
}
