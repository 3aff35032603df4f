//! Spots: where the brightness of a tile varies in two directions, and where other sightings see the same.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector2, Vector3};
use rayon::prelude::*;

use super::TextureOptions;
use super::correlate::{Surface, correlate, is_supported};
use super::ground::foot;
use super::keep::{TILE_M, TexturePoints, Tile};
use super::raster::Raster;
use super::refine::{Refined, refine};
use super::sampling::{Edges, larger};
use super::tie::{Picture, SpotEnd, SpotRejection, SpotTie};
use super::view::{View, views};
use crate::block::SourceKey;

/// Sightings of one source that lie nearer in time are of one visit \[s\].
const SAME_VISIT_S: f64 = 8.0;
/// Tiles worked on at a time.
const BATCH: usize = 32;

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
        for place_m in candidates(view, &mut taken, options) {
            let repeats_m = repeats_m(&view.raster, place_m, options);
            let of_spot: Vec<SpotTie> = views[k + 1..]
                .iter()
                .filter_map(|other| {
                    let tied = Matching { first: view, second: other, tile, repeats_m, options };
                    tied.spot(place_m, spot, search_m, most_search_m)
                })
                .collect();
            spot += u32::from(!of_spot.is_empty());
            ties.extend(of_spot);
        }
    }
    ties
}

/// Places of a view whose brightness varies in two directions, the most distinct first, apart from each other and from those taken before.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn candidates(view: &View, taken: &mut Vec<[f64; 2]>, options: &TextureOptions) -> Vec<[f64; 2]> {
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
    let mut places = Vec::new();
    for (_, place_m) in found {
        if taken.iter().all(|t| (t[0] - place_m[0]).hypot(t[1] - place_m[1]) >= options.spacing_m) {
            taken.push(place_m);
            places.push(place_m);
        }
    }
    places
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn half_cells(raster: &Raster, options: &TextureOptions) -> usize {
    (0.5 * options.window_m / raster.cell_m).round() as usize
}

/// How near to a place its window is to be seen again \[m\]; infinite where it is not.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn repeats_m(raster: &Raster, place_m: [f64; 2], options: &TextureOptions) -> f64 {
    let Some(cell) = raster.cell_at(place_m) else { return f64::INFINITY };
    let reach = (options.repetition_m / raster.cell_m).round() as usize;
    let peaks = correlate(raster, cell, raster, half_cells(raster, options), (reach, 2)).peaks();
    let alike = peaks.iter().filter(|(value, _)| f64::from(*value) > options.most_alike);
    let apart_m = alike.map(|(_, shift)| apart_m(*shift, [0, 0], raster)).filter(|m| *m >= options.rival_m);
    apart_m.fold(f64::INFINITY, f64::min)
}

/// Distance of two shifts \[m\].
#[allow(clippy::cast_precision_loss)]
fn apart_m(a: [i64; 2], b: [i64; 2], raster: &Raster) -> f64 {
    ((a[0] - b[0]) as f64).hypot((a[1] - b[1]) as f64) * raster.cell_m
}

/// A spot of one view in another.
struct Matching<'a> {
    first: &'a View,
    second: &'a View,
    tile: Tile,
    /// How near to it the window is to be seen again \[m\].
    repeats_m: f64,
    options: &'a TextureOptions,
}

impl Matching<'_> {
    /// The tie of a place, or why there is none; nothing where the second view does not reach.
    fn spot(
        &self,
        place_m: [f64; 2],
        spot: u32,
        search_m: &(dyn Fn(f64, f64) -> f64 + Sync),
        most_search_m: f64,
    ) -> Option<SpotTie> {
        let (a, b) = (&self.first.raster, &self.second.raster);
        let cell = a.cell_at(place_m)?;
        if !b.at(cell.0, cell.1).is_finite() {
            return None;
        }
        let half = half_cells(a, self.options);
        let place_m = a.place_m(cell.0, cell.1);
        let here = |rejection| self.untied(spot, place_m, rejection);
        let Some(own) = foot(&self.first.points, &self.first.plan, place_m, self.options.height_floor_m) else {
            return Some(here(SpotRejection::NoPlane));
        };
        if !is_supported(a, cell, half) {
            return Some(here(SpotRejection::Support));
        }
        let other_s =
            foot(&self.second.points, &self.second.plan, place_m, self.options.height_floor_m).map(|f| f.time_s);
        let Some(other_s) = other_s else { return Some(here(SpotRejection::NoPlane)) };
        let search_m = search_m(own.time_s, other_s).min(most_search_m);
        // where both the right place and a like one lie within the search they are no further apart than this
        let confused_m = 2.0 * search_m;
        if self.repeats_m <= confused_m {
            return Some(here(SpotRejection::Repeated));
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let reach = (search_m / a.cell_m).ceil() as usize;
        let surface = correlate(a, cell, b, half, (reach, 1));
        let matched = self.peak(cell, half, &surface, self.options.least_correlation);
        let (shift, second) = match matched {
            Ok(found) => found,
            Err((rejection, shift)) => {
                let mut tie = here(rejection);
                tie.picture = shift.map(|s| self.picture(cell, s.map(|v| v as f64), half, &surface));
                return Some(tie);
            }
        };
        let refined = refine(a, cell, b, half, shift);
        let at = refined.as_ref().map_or(shift.map(|v| v as f64), |r| [r.shift_m.x / a.cell_m, r.shift_m.y / a.cell_m]);
        let picture = Some(self.picture(cell, at, half, &surface));
        let Some(refined) = refined else {
            return Some(SpotTie { picture, second, ..here(SpotRejection::NotConverged) });
        };
        let of_shift_m2 = self.covariance_m2(&refined);
        let there_m = [place_m[0] + refined.shift_m.x, place_m[1] + refined.shift_m.y];
        let Some(other) = foot(&self.second.points, &self.second.plan, there_m, self.options.height_floor_m) else {
            return Some(SpotTie { picture, second, ..here(SpotRejection::NoPlane) });
        };
        // an error along the plane moves the place along it; beside it the heights have errors of their own
        let slope = [0, 1].map(|k| 0.5 * (own.slope[k] + other.slope[k]));
        let along = Matrix3x2::new(1.0, 0.0, 0.0, 1.0, slope[0], slope[1]);
        let mut covariance_m2 = along * of_shift_m2 * along.transpose();
        covariance_m2[(2, 2)] += own.sigma_m.powi(2) + other.sigma_m.powi(2);
        // a thing at the end of a row in one sighting may be one within the row in the other
        let rejection = if repeats_m(b, there_m, self.options) <= confused_m {
            Some(SpotRejection::Repeated)
        } else if largest_sigma_m(&of_shift_m2) > self.options.most_sigma_m {
            Some(SpotRejection::Imprecise)
        } else {
            self.comes_back(cell, half, shift, &refined)
        };
        Some(SpotTie {
            spot,
            ends: [self.end(place_m, &own, self.first.source), self.end(there_m, &other, self.second.source)],
            covariance_m2,
            correlation: refined.correlation,
            second,
            rejection,
            picture,
        })
    }

    /// Covariance of a shift \[m²\]: what the residuals show varies along edges, what the gaps between points leave open a whole edge has in common.
    /// Points that lie anyhow show in both, so that in each direction the larger counts.
    fn covariance_m2(&self, refined: &Refined) -> Matrix2<f64> {
        let edges = Edges::new(&refined.cells);
        let scatter = edges.scatter(&self.first.points, &self.first.plan, &Vector2::zeros())
            + edges.scatter(&self.second.points, &self.second.plan, &refined.shift_m);
        larger(&refined.covariance_m2, &(refined.inverse * scatter * refined.inverse))
    }

    /// The highest peak and the correlation of the second, or why there is none, with the shift where there was a peak.
    #[allow(clippy::type_complexity)]
    fn peak(
        &self,
        cell: (usize, usize),
        half: usize,
        surface: &Surface,
        least: f64,
    ) -> Result<([i64; 2], f64), (SpotRejection, Option<[i64; 2]>)> {
        let peaks = surface.peaks();
        let Some((highest, shift)) = peaks.first().copied() else { return Err((SpotRejection::Support, None)) };
        if f64::from(highest) < least {
            return Err((SpotRejection::NoneFound, Some(shift)));
        }
        if shift.iter().any(|s| s.unsigned_abs() >= surface.reach as u64) {
            return Err((SpotRejection::SearchRim, Some(shift)));
        }
        let rival = peaks.iter().find(|p| apart_m(p.1, shift, &self.first.raster) >= self.options.rival_m);
        let second = rival.map_or(0.0, |p| f64::from(p.0).max(0.0));
        if second > self.options.most_alike * f64::from(highest) {
            return Err((SpotRejection::Ambiguous, Some(shift)));
        }
        let there = [cell.0 as i64 + shift[0], cell.1 as i64 + shift[1]];
        let there = there.map(|v| usize::try_from(v).unwrap_or(0));
        if !is_supported(&self.second.raster, (there[0], there[1]), half) {
            return Err((SpotRejection::Support, Some(shift)));
        }
        Ok((shift, second))
    }

    /// Looks for the place of the second view in the first.
    fn comes_back(
        &self,
        cell: (usize, usize),
        half: usize,
        shift: [i64; 2],
        refined: &Refined,
    ) -> Option<SpotRejection> {
        /// Beside three sigmas \[m\].
        const BACK_M: f64 = 0.01;
        let (a, b) = (&self.first.raster, &self.second.raster);
        let there = [cell.0 as i64 + shift[0], cell.1 as i64 + shift[1]].map(|v| usize::try_from(v).unwrap_or(0));
        let back = refine(b, (there[0], there[1]), a, half, [-shift[0], -shift[1]]);
        let differs = back.is_none_or(|back| {
            (back.shift_m + refined.shift_m).norm() > BACK_M + 3.0 * largest_sigma_m(&refined.covariance_m2)
        });
        differs.then_some(SpotRejection::NotReciprocal)
    }

    fn end(&self, place_m: [f64; 2], foot: &super::ground::Foot, source: SourceKey) -> SpotEnd {
        let corner = [f64::from(self.tile.0) * TILE_M, f64::from(self.tile.1) * TILE_M];
        SpotEnd {
            source,
            time_s: foot.time_s,
            place_m: Vector3::new(place_m[0] + corner[0], place_m[1] + corner[1], foot.height_m),
            points: foot.points,
            intensity: foot.intensity,
        }
    }

    /// A spot without a tie.
    fn untied(&self, spot: u32, place_m: [f64; 2], rejection: SpotRejection) -> SpotTie {
        let none = super::ground::Foot {
            height_m: 0.0,
            slope: [0.0; 2],
            sigma_m: 0.0,
            time_s: 0.0,
            points: 0,
            intensity: 0.0,
        };
        let end = |view: &View| {
            let foot = foot(&view.points, &view.plan, place_m, self.options.height_floor_m).unwrap_or(none);
            self.end(place_m, &foot, view.source)
        };
        SpotTie {
            spot,
            ends: [end(self.first), end(self.second)],
            covariance_m2: Matrix3::zeros(),
            correlation: 0.0,
            second: 0.0,
            rejection: Some(rejection),
            picture: None,
        }
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    fn picture(&self, cell: (usize, usize), shift: [f64; 2], half: usize, surface: &Surface) -> Picture {
        let window = |raster: &Raster, at: [f64; 2]| -> Vec<u8> {
            let half = half as i64;
            let cells = (-half..=half).flat_map(|dy| (-half..=half).map(move |dx| (dx, dy)));
            let value = |(dx, dy): (i64, i64)| {
                let (x, y) = (at[0].round() as i64 + dx, at[1].round() as i64 + dy);
                let within = x >= 0 && y >= 0 && x < raster.columns as i64 && y < raster.rows as i64;
                let value = if within { raster.at(x as usize, y as usize) } else { f32::NAN };
                // a sixth of asphalt to six times it
                if value.is_finite() { 1 + ((value + 1.8) / 3.6 * 254.0).clamp(0.0, 254.0) as u8 } else { 0 }
            };
            cells.map(value).collect()
        };
        let here = [cell.0 as f64, cell.1 as f64];
        let of = |v: &f32| if v.is_finite() { 1 + (v.clamp(0.0, 1.0) * 254.0) as u8 } else { 0 };
        Picture {
            side: 2 * half + 1,
            cell_m: self.first.raster.cell_m,
            windows: [
                window(&self.first.raster, here),
                window(&self.second.raster, [here[0] + shift[0], here[1] + shift[1]]),
            ],
            surface_side: 2 * surface.reach + 1,
            surface: surface.values.iter().map(of).collect(),
            peak: shift.map(|s| s + surface.reach as f64),
        }
    }
}

/// Standard deviation in the worst direction \[m\].
fn largest_sigma_m(covariance_m2: &Matrix2<f64>) -> f64 {
    covariance_m2.symmetric_eigenvalues().max().max(0.0).sqrt()
}
