//! A spot of one view in another: where it is, how well that is known, and in which directions.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector2, Vector3};

use super::TextureOptions;
use super::correlate::{Surface, correlate, is_supported};
use super::ground::{Foot, foot};
use super::keep::TILE_M;
use super::raster::Raster;
use super::refine::{Refined, refine};
use super::sampling::Edges;
use super::tie::{Picture, SpotEnd, SpotRejection, SpotTie};
use super::view::View;
use crate::block::SourceKey;
use crate::xyz::spill::{Tile, corner_m};

/// Two shifts are of one line as long as they lie off it by no more than this; peaks are known to a cell.
const OFF_LINE_CELLS: f64 = 1.5;

/// Cells to either side of the middle of a window.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub(super) fn half_cells(raster: &Raster, options: &TextureOptions) -> usize {
    (0.5 * options.window_m / raster.cell_m).round() as usize
}

/// Where about a place its window is to be seen again, from the place on \[m\].
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub(super) fn alike_m(raster: &Raster, place_m: [f64; 2], options: &TextureOptions) -> Vec<Vector2<f64>> {
    let Some(cell) = raster.cell_at(place_m) else { return Vec::new() };
    let reach = (options.repetition_m / raster.cell_m).round() as usize;
    let peaks = correlate(raster, cell, raster, half_cells(raster, options), (reach, 2)).peaks();
    let alike = peaks.iter().filter(|(value, _)| f64::from(*value) > options.most_alike);
    alike.map(|(_, shift)| metres(*shift, raster)).filter(|m| m.norm() >= options.rival_m).collect()
}

/// A shift of whole cells \[m\].
#[allow(clippy::cast_precision_loss)]
fn metres(shift: [i64; 2], raster: &Raster) -> Vector2<f64> {
    Vector2::new(shift[0] as f64, shift[1] as f64) * raster.cell_m
}

/// Whether a place is no less known for what looks like it: nothing does, or only what lies off along the direction that is not held anyway.
fn is_unique(alike_m: &[Vector2<f64>], within_m: f64, free: Option<&Vector2<f64>>, cell_m: f64) -> bool {
    alike_m
        .iter()
        .filter(|m| m.norm() <= within_m)
        .all(|m| free.is_some_and(|f| f.perp(m).abs() <= OFF_LINE_CELLS * cell_m))
}

/// The highest peak by value and shift; along a straight edge all are nearly as high, and the nearest counts.
#[allow(clippy::cast_precision_loss)]
fn likeliest(peaks: &[(f32, [i64; 2])], reach: usize) -> Option<(f32, [i64; 2])> {
    /// What the rim of the search must be higher by.
    const OF_THE_RIM: f64 = 0.03;
    let far = |shift: [i64; 2]| shift.iter().map(|s| (*s as f64 / reach.max(1) as f64).powi(2)).sum::<f64>();
    let score = |p: &(f32, [i64; 2])| f64::from(p.0) - OF_THE_RIM * far(p.1);
    peaks.iter().copied().reduce(|best, p| if score(&p) > score(&best) { p } else { best })
}

/// A spot of one view in another.
pub(super) struct Matching<'a> {
    first: &'a View,
    second: &'a View,
    /// Of both views.
    rasters: [&'a Raster; 2],
    tile: Tile,
    /// Where about it its window is to be seen again \[m\].
    alike_m: &'a [Vector2<f64>],
    options: &'a TextureOptions,
}

/// The highest peak of a correlation.
struct Peak {
    /// In cells.
    shift: [i64; 2],
    /// Correlation of the next one.
    second: f64,
    /// Others that are nearly as high, from it on \[m\].
    rivals_m: Vec<Vector2<f64>>,
}

impl<'a> Matching<'a> {
    /// Of two views of a tile.
    pub(super) fn new(
        [first, second]: [&'a View; 2],
        alike_m: &'a [Vector2<f64>],
        (tile, options): (Tile, &'a TextureOptions),
    ) -> Self {
        Self { first, second, rasters: [&first.raster, &second.raster], tile, alike_m, options }
    }

    /// The tie of a place, or why there is none; nothing where the second view does not reach.
    pub(super) fn spot(
        &self,
        place_m: [f64; 2],
        spot: u32,
        (search_m, most_search_m): (&(dyn Fn(f64, f64) -> f64 + Sync), f64),
    ) -> Option<SpotTie> {
        let [a, b] = self.rasters;
        let cell = a.cell_at(place_m).filter(|_| self.reaches(place_m))?;
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
        let of_alike = self.alike_m.iter().find(|m| m.norm() <= confused_m).map(|m| m.normalize());
        if !is_unique(self.alike_m, confused_m, of_alike.as_ref(), a.cell_m) {
            return Some(here(SpotRejection::Repeated));
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let reach = (search_m / a.cell_m).ceil() as usize;
        let surface = correlate(a, cell, b, half, (reach, 1));
        let Peak { shift, second, rivals_m } = match self.peak(cell, half, &surface) {
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
        // where the residuals alone say too much, the points need not be asked
        let of_shift_m2 = match self.free(&refined.covariance_m2) {
            Err(_) => refined.covariance_m2,
            Ok(_) => self.covariance_m2(&refined),
        };
        let there_m = [place_m[0] + refined.shift_m.x, place_m[1] + refined.shift_m.y];
        let Some(other) = foot(&self.second.points, &self.second.plan, there_m, self.options.height_floor_m) else {
            return Some(SpotTie { picture, second, ..here(SpotRejection::NoPlane) });
        };
        // an error along the plane moves the place along it; beside it the heights have errors of their own
        let slope = [0, 1].map(|k| 0.5 * (own.slope[k] + other.slope[k]));
        let along = Matrix3x2::new(1.0, 0.0, 0.0, 1.0, slope[0], slope[1]);
        let mut covariance_m2 = along * of_shift_m2 * along.transpose();
        covariance_m2[(2, 2)] += own.sigma_m.powi(2) + other.sigma_m.powi(2);
        let of_ground = self.free(&of_shift_m2);
        let rejection = match &of_ground {
            Err(rejection) => Some(*rejection),
            Ok(free) => {
                let free = free.as_ref();
                let is_unique = |alike: &[Vector2<f64>], within_m| is_unique(alike, within_m, free, a.cell_m);
                // a thing at the end of a row in one sighting may be one within the row in the other
                if !is_unique(self.alike_m, confused_m) || !is_unique(&alike_m(b, there_m, self.options), confused_m) {
                    Some(SpotRejection::Repeated)
                } else if !is_unique(&rivals_m, f64::INFINITY) {
                    Some(SpotRejection::Ambiguous)
                } else {
                    self.comes_back((cell, half, shift), &refined, free)
                }
            }
        };
        let free = of_ground.ok().flatten().map(|free| (along * free).normalize());
        Some(SpotTie {
            spot,
            ends: [self.end(place_m, &own, self.first.source), self.end(there_m, &other, self.second.source)],
            covariance_m2,
            free,
            correlation: refined.correlation,
            second,
            rejection,
            picture,
        })
    }

    /// The direction of the plane that is not known well enough, if there is one; a reason where neither is.
    fn free(&self, covariance_m2: &Matrix2<f64>) -> Result<Option<Vector2<f64>>, SpotRejection> {
        let axes = covariance_m2.symmetric_eigen();
        let (worse, better) = if axes.eigenvalues[0] > axes.eigenvalues[1] { (0, 1) } else { (1, 0) };
        let (point_m2, line_m2) = (self.options.most_sigma_m.powi(2), self.options.most_line_sigma_m.powi(2));
        match (axes.eigenvalues[worse] > point_m2, axes.eigenvalues[better] > line_m2) {
            (false, _) => Ok(None),
            (true, false) => Ok(Some(axes.eigenvectors.column(worse).into_owned())),
            (true, true) => Err(SpotRejection::Imprecise),
        }
    }

    /// Covariance of a shift \[m²\]: what the residuals show varies along edges, what the gaps between points leave open a whole edge has in common.
    /// Both are added up: points that lie anyhow show in both, and sigmas are too careful there (docs/xyz.md).
    fn covariance_m2(&self, refined: &Refined) -> Matrix2<f64> {
        let raster = self.rasters[0];
        let edges = Edges::new(&refined.cells, raster.cell_m);
        let of = |view: &View, shift_m: &Vector2<f64>| {
            edges.scatter((&view.points, &view.plan), shift_m, raster.smoothing_m)
        };
        let scatter = of(self.first, &Vector2::zeros()) + of(self.second, &refined.shift_m);

        refined.covariance_m2 + refined.inverse * scatter * refined.inverse
    }

    /// The highest peak, or why there is none, with the shift where there was one.
    fn peak(
        &self,
        cell: (usize, usize),
        half: usize,
        surface: &Surface,
    ) -> Result<Peak, (SpotRejection, Option<[i64; 2]>)> {
        let peaks = surface.peaks();
        let Some((highest, shift)) = likeliest(&peaks, surface.reach) else {
            return Err((SpotRejection::Support, None));
        };
        if f64::from(highest) < self.options.least_correlation {
            return Err((SpotRejection::NoneFound, Some(shift)));
        }
        if shift.iter().any(|s| s.unsigned_abs() >= surface.reach as u64) {
            return Err((SpotRejection::SearchRim, Some(shift)));
        }
        let from_m = |p: [i64; 2]| metres([p[0] - shift[0], p[1] - shift[1]], self.rasters[0]);
        let others = peaks.iter().map(|p| (f64::from(p.0), from_m(p.1)));
        let others: Vec<_> = others.filter(|p| p.1.norm() >= self.options.rival_m).collect();
        let least = self.options.most_alike * f64::from(highest);
        let there = [cell.0 as i64 + shift[0], cell.1 as i64 + shift[1]];
        let there = there.map(|v| usize::try_from(v).unwrap_or(0));
        if !is_supported(self.rasters[1], (there[0], there[1]), half) {
            return Err((SpotRejection::Support, Some(shift)));
        }
        Ok(Peak {
            shift,
            second: others.first().map_or(0.0, |p| p.0.max(0.0)),
            rivals_m: others.iter().filter(|p| p.0 > least).map(|p| p.1).collect(),
        })
    }

    /// Looks for the place of the second view in the first.
    fn comes_back(
        &self,
        (cell, half, shift): ((usize, usize), usize, [i64; 2]),
        refined: &Refined,
        free: Option<&Vector2<f64>>,
    ) -> Option<SpotRejection> {
        /// Beside three sigmas \[m\].
        const BACK_M: f64 = 0.01;
        let [a, b] = self.rasters;
        let there = [cell.0 as i64 + shift[0], cell.1 as i64 + shift[1]].map(|v| usize::try_from(v).unwrap_or(0));
        let back = refine(b, (there[0], there[1]), a, half, [-shift[0], -shift[1]]);
        let differs = back.is_none_or(|back| {
            let off_m = back.shift_m + refined.shift_m;
            let across = free.map(|f| Vector2::new(-f.y, f.x));
            let (off_m, sigma_m) = match across {
                None => (off_m.norm(), largest_sigma_m(&refined.covariance_m2)),
                Some(h) => (h.dot(&off_m).abs(), h.dot(&(refined.covariance_m2 * h)).sqrt()),
            };
            off_m > BACK_M + 3.0 * sigma_m
        });
        differs.then_some(SpotRejection::NotReciprocal)
    }

    fn end(&self, place_m: [f64; 2], foot: &Foot, source: SourceKey) -> SpotEnd {
        let corner = corner_m(self.tile, TILE_M);
        SpotEnd {
            source,
            time_s: foot.time_s,
            place_m: Vector3::new(place_m[0] + corner[0], place_m[1] + corner[1], foot.height_m),
            points: foot.points,
            intensity: foot.intensity,
        }
    }

    /// Whether the second view sees anything at a place of the first.
    pub(super) fn reaches(&self, place_m: [f64; 2]) -> bool {
        let raster = self.rasters[1];
        raster.cell_at(place_m).is_some_and(|(x, y)| raster.at(x, y).is_finite())
    }

    /// A spot without a tie.
    pub(super) fn untied(&self, spot: u32, place_m: [f64; 2], rejection: SpotRejection) -> SpotTie {
        let none = Foot { height_m: 0.0, slope: [0.0; 2], sigma_m: 0.0, time_s: 0.0, points: 0, intensity: 0.0 };
        let end = |view: &View| {
            let foot = foot(&view.points, &view.plan, place_m, self.options.height_floor_m).unwrap_or(none);
            self.end(place_m, &foot, view.source)
        };
        SpotTie {
            spot,
            ends: [end(self.first), end(self.second)],
            covariance_m2: Matrix3::zeros(),
            free: None,
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
            cell_m: self.rasters[0].cell_m,
            windows: [window(self.rasters[0], here), window(self.rasters[1], [here[0] + shift[0], here[1] + shift[1]])],
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
