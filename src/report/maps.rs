//! Maps of the ties and of their differences in height, as pictures and as rasters.

use std::io::Cursor;

use image::{ExtendedColorType, ImageEncoder, ImageResult, codecs::png};

use super::colour::{HELD_OUT, NOTHING, OUTLIER, Rgba, USED, diverging};
use super::data::TiePoint;
use super::grid::{Grid, Raster, extent};
use super::number::round_up;

/// A colour and the ties that are drawn in it.
type Class = (Rgba, fn(&TiePoint) -> bool);

/// Surfaces steeper than this say little about heights: least upward component of the unit normal.
const LEAST_NORMAL_UP: f64 = 0.5;
/// Pixels on the long side of the map of ties.
const TIE_PIXELS: f64 = 1000.0;
/// Share of the cells that the colour scale covers.
const SCALE_SHARE: f64 = 0.98;

/// A picture and its place on the map.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The PNG file.
    pub png: Vec<u8>,
    /// Its place.
    pub grid: Grid,
    /// Value \[m\] at the end of the colour scale, for maps of values.
    pub limit_m: Option<f64>,
}

/// The pictures of a report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pictures {
    /// Ties by class.
    pub ties: Option<Picture>,
    /// Differences in height before.
    pub dz_before: Option<Picture>,
    /// After, in the colours of the map before.
    pub dz_after: Option<Picture>,
    /// After, with a colour scale of its own where that shows more.
    pub dz_after_fine: Option<Picture>,
}

/// Pictures, and the rasters they were drawn from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Maps {
    /// For people.
    pub pictures: Pictures,
    /// Differences in height before \[m\].
    pub dz_before: Option<Raster>,
    /// Differences in height after \[m\].
    pub dz_after: Option<Raster>,
}

/// Difference in height \[m\] that a difference along the normal amounts to; NaN on steep surfaces.
#[must_use]
pub fn dz_m(along_normal_m: f64, normal_up: f64) -> f64 {
    if normal_up.abs() > LEAST_NORMAL_UP { along_normal_m / normal_up } else { f64::NAN }
}

/// Draws all maps of ties.
///
/// # Errors
/// When a picture cannot be encoded.
pub fn draw(points: &[TiePoint]) -> ImageResult<Maps> {
    let ties = ties(points)?;
    let level: Vec<&TiePoint> = points.iter().filter(|p| !p.outlier && p.normal_up.abs() > LEAST_NORMAL_UP).collect();
    let places: Vec<[f64; 2]> = level.iter().map(|p| place(p)).collect();
    let Some(grid) = Grid::for_values(&places) else {
        return Ok(Maps { pictures: Pictures { ties, ..Pictures::default() }, ..Maps::default() });
    };
    let raster = |value: fn(&TiePoint) -> f64| {
        let raster = Raster::medians(grid, level.iter().map(|p| (place(p), dz_m(value(p), p.normal_up))));
        (!raster.is_blank()).then_some(raster)
    };
    let (before, after) = (raster(|p| p.before_m), raster(|p| p.after_m));
    let limit = |raster: &Option<Raster>| raster.as_ref().map(|r| round_up(r.quantile_of_size(SCALE_SHARE).max(1e-3)));
    let (before_limit, after_limit) = (limit(&before), limit(&after));
    let common_m = before_limit.or(after_limit).unwrap_or(0.01);
    let fine_m = after_limit.filter(|fine| *fine < 0.5 * common_m);
    let painted = |raster: &Option<Raster>, limit_m: Option<f64>| match (raster, limit_m) {
        (Some(raster), Some(limit_m)) => paint(raster, limit_m).map(Some),
        _ => Ok(None),
    };
    let pictures = Pictures {
        ties,
        dz_before: painted(&before, Some(common_m))?,
        dz_after: painted(&after, Some(common_m))?,
        dz_after_fine: painted(&after, fine_m)?,
    };
    Ok(Maps { pictures, dz_before: before, dz_after: after })
}

/// Easting and northing \[m\].
fn place(point: &TiePoint) -> [f64; 2] {
    [point.map_m[0], point.map_m[1]]
}

/// Colours of the cells of a raster.
fn paint(raster: &Raster, limit_m: f64) -> ImageResult<Picture> {
    let colour = |v: &f32| if v.is_nan() { NOTHING } else { diverging(f64::from(*v), limit_m) };
    let pixels: Vec<u8> = raster.values.iter().flat_map(colour).collect();
    Ok(Picture { png: encode(&raster.grid, &pixels)?, grid: raster.grid, limit_m: Some(limit_m) })
}

/// A dot for each tie: used below, held out above, outliers on top.
fn ties(points: &[TiePoint]) -> ImageResult<Option<Picture>> {
    let places: Vec<[f64; 2]> = points.iter().map(place).collect();
    let Some((low, high)) = extent(&places) else { return Ok(None) };
    let long_m = (high[0] - low[0]).max(high[1] - low[1]).max(1.0);
    let cell_m = round_up(long_m / TIE_PIXELS);
    let spacing_m = Grid::for_values(&places).map_or(cell_m, |grid| grid.cell_m);
    let radius = (0.35 * spacing_m / cell_m).clamp(1.0, 5.0);
    let Some(grid) = Grid::around(&places, cell_m, radius + 1.0) else { return Ok(None) };
    let mut canvas = vec![NOTHING; grid.len()];
    let classes: [Class; 3] =
        [(USED, |p| !p.held_out && !p.outlier), (HELD_OUT, |p| p.held_out && !p.outlier), (OUTLIER, |p| p.outlier)];
    for (colour, is_member) in classes {
        for point in points.iter().filter(|p| is_member(p)) {
            dot(&mut canvas, &grid, grid.pixel(place(point)), radius, colour);
        }
    }
    let pixels = canvas.concat();
    Ok(Some(Picture { png: encode(&grid, &pixels)?, grid, limit_m: None }))
}

/// Paints the pixels whose centre lies within `radius` of a place, and the pixel of the place itself.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clipped to the canvas
fn dot(canvas: &mut [Rgba], grid: &Grid, [x, y]: [f64; 2], radius: f64, colour: Rgba) {
    if !(x.is_finite() && y.is_finite()) {
        return;
    }
    let range = |at: f64, end: u32| {
        let first = (at - radius).floor().clamp(0.0, f64::from(end)) as u32;
        first..((at + radius).ceil().clamp(0.0, f64::from(end)) as u32)
    };
    for row in range(y, grid.rows) {
        for column in range(x, grid.columns) {
            let (dx, dy) = (f64::from(column) + 0.5 - x, f64::from(row) + 0.5 - y);
            if dx * dx + dy * dy <= radius * radius || dx.abs().max(dy.abs()) <= 0.5 {
                canvas[row as usize * grid.columns as usize + column as usize] = colour;
            }
        }
    }
}

/// Pixels as a PNG file.
fn encode(grid: &Grid, pixels: &[u8]) -> ImageResult<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    png::PngEncoder::new_with_quality(&mut bytes, png::CompressionType::Best, png::FilterType::NoFilter).write_image(
        pixels,
        grid.columns,
        grid.rows,
        ExtendedColorType::Rgba8,
    )?;
    Ok(bytes.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(east: f64, before_m: f64) -> TiePoint {
        TiePoint {
            map_m: [east, 0.0, 400.0],
            pair: 0,
            normal_up: 0.8,
            before_m,
            after_m: before_m * 0.1,
            held_out: east > 50.0,
            outlier: false,
        }
    }

    #[test]
    fn heights_follow_from_the_slope_and_walls_are_left_out() {
        assert!((dz_m(0.04, 0.8) - 0.05).abs() < 1e-12);
        assert!((dz_m(0.04, -0.8) + 0.05).abs() < 1e-12);
        assert!(dz_m(0.04, 0.1).is_nan());
    }

    #[test]
    fn a_map_after_much_improvement_gets_a_finer_scale_too() {
        let points: Vec<TiePoint> = (0..100).map(|i| point(f64::from(i), 0.05)).collect();
        let maps = draw(&points).expect("drawn");
        let before = maps.pictures.dz_before.expect("before");
        assert_eq!(before.limit_m, maps.pictures.dz_after.expect("after").limit_m);
        assert!(maps.pictures.dz_after_fine.expect("fine").limit_m < before.limit_m);
        assert!(before.png.starts_with(b"\x89PNG"));
        let raster = maps.dz_before.expect("raster");
        assert!(raster.values.iter().any(|v| (v - 0.0625).abs() < 1e-6));
    }

    #[test]
    fn no_ties_or_only_walls_give_no_map_of_heights() {
        assert_eq!(draw(&[]).expect("drawn"), Maps::default());
        let wall = TiePoint { normal_up: 0.0, ..point(1.0, 0.05) };
        let maps = draw(&[wall]).expect("drawn");
        assert!(maps.pictures.ties.is_some() && maps.pictures.dz_before.is_none());
    }
}
