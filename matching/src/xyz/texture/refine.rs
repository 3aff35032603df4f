//! The shift between two rasters below a cell, and its covariance.
//!
//! Least squares of `B(x + d) - (α A(x) + β)` over the window: its minimum is the peak of the normalised correlation. With gradients g (α and
//! β eliminated), N = Σ g gᵀ is the curvature of the peak, and the covariance of d is N⁻¹ M N⁻¹ with M that of Σ g r. Residuals r are largest on
//! edges, where sampling shows, and cells under one bell share points: noise seen through a bell of s cells is alike over 4 π s² cells,
//! M = 4 π s² Σ g gᵀ r². (Sums over blocks of cells, which assume no such area, come from the few blocks with edges: over seeds e'Σ⁻¹e was 8.6 with
//! them, where 3 is due.)

use nalgebra::{Matrix2, Matrix4, Matrix4x2, Matrix6, Vector2, Vector4, Vector6};

use super::raster::Raster;
use super::sampling::EdgeCell;

/// Most rounds.
const ROUNDS: usize = 20;
/// Gains beyond these are of other things: they are ratios of contrasts.
const GAIN: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// A shift.
#[derive(Debug, Clone)]
pub(super) struct Refined {
    /// From the place in the first raster to that in the second \[m\].
    pub(super) shift_m: Vector2<f64>,
    /// By what the residuals show.
    pub(super) covariance_m2: Matrix2<f64>,
    /// Inverse of the curvature \[cell²\].
    pub(super) inverse: Matrix2<f64>,
    /// The cells that were compared.
    pub(super) cells: Vec<EdgeCell>,
    pub(super) correlation: f64,
}

/// One cell of the window at the present shift.
struct Row {
    /// Column and row within the window.
    at: [usize; 2],
    place_m: Vector2<f64>,
    a: f64,
    b: f64,
    /// Gradient \[1/cell\].
    g: Vector2<f64>,
}

impl Row {
    /// Place within the window, half its width counted as one.
    #[allow(clippy::cast_precision_loss)] // a window
    fn off(&self, half: usize) -> [f64; 2] {
        self.at.map(|k| k as f64 / half as f64 - 1.0)
    }

    /// What gain, offset and trend change the brightness by.
    fn of_light(&self, half: usize) -> Vector4<f64> {
        let [east, north] = self.off(half);
        Vector4::new(self.a, 1.0, east, north)
    }
}

#[allow(
    clippy::cast_possible_wrap,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss
)]
fn rows(
    a: &Raster,
    (column, row): (usize, usize),
    b: &Raster,
    half: usize,
    shift: &Vector2<f64>,
    gain: f64,
) -> Vec<Row> {
    let half = half as i64;
    let mut rows = Vec::new();
    for dy in -half..=half {
        for dx in -half..=half {
            let (x, y) = (column as i64 + dx, row as i64 + dy);
            if x < 1 || y < 1 || x + 1 >= a.columns as i64 || y + 1 >= a.rows as i64 {
                continue;
            }
            let value = f64::from(a.at(x as usize, y as usize));
            let ga = a.gradient(x as usize, y as usize).map(f64::from);
            let Some((vb, gb)) = b.between(x as f64 + shift.x, y as f64 + shift.y) else { continue };
            if (value + ga[0] + ga[1]).is_finite() {
                // of both rasters: the noise of one does not pretend curvature
                let g = Vector2::new(gb[0] + gain * ga[0], gb[1] + gain * ga[1]) * 0.5;
                let at = [dx, dy].map(|v| (v + half) as usize);
                let place_m = Vector2::from(a.place_m(x as usize, y as usize));
                rows.push(Row { at, place_m, a: value, b: vb, g });
            }
        }
    }
    rows
}

/// Least squares, without a step along a direction of the shift that next to nothing holds: the window of a straight edge may slide along it.
fn solved(n: &Matrix6<f64>, v: &Vector6<f64>) -> Option<Vector6<f64>> {
    /// Curvature along the edge over that across it.
    const SLIDES: f64 = 0.03;
    let (of_shift, of_both) = (n.fixed_view::<2, 2>(0, 0), n.fixed_view::<4, 2>(2, 0));
    let of_light = n.fixed_view::<4, 4>(2, 2).into_owned().try_inverse()?;
    let held = of_shift - of_both.transpose() * of_light * of_both;
    let axes = held.symmetric_eigen();
    let (low, high) = if axes.eigenvalues[0] < axes.eigenvalues[1] { (0, 1) } else { (1, 0) };
    if axes.eigenvalues[low] > SLIDES * axes.eigenvalues[high] {
        return Some(n.try_inverse()? * v);
    }
    let across = axes.eigenvectors.column(high).into_owned();
    let light = v.fixed_view::<4, 1>(2, 0).into_owned();
    let pull = v.fixed_view::<2, 1>(0, 0) - of_both.transpose() * of_light * light;
    let step = across * (across.dot(&pull) / axes.eigenvalues[high]);
    let light = of_light * (light - of_both * step);
    Some(Vector6::new(step.x, step.y, light[0], light[1], light[2], light[3]))
}

/// Finds the shift near one in whole cells.
#[allow(clippy::cast_precision_loss)]
pub(super) fn refine(a: &Raster, cell: (usize, usize), b: &Raster, half: usize, start: [i64; 2]) -> Option<Refined> {
    let start = Vector2::new(start[0] as f64, start[1] as f64);
    let (mut shift, mut gain) = (start, 1.0);
    for _ in 0..ROUNDS {
        let rows = rows(a, cell, b, half, &shift, gain);
        if rows.len() < 50 {
            return None;
        }
        let (mut n, mut v) = (Matrix6::zeros(), Vector6::zeros());
        for r in &rows {
            let [east, north] = r.off(half);
            let j = Vector6::new(r.g.x, r.g.y, -r.a, -1.0, -east, -north);
            n += j * j.transpose();
            v -= j * r.b;
        }
        let x = solved(&n, &v)?; // step of the shift, gain, offset, trend
        let step = Vector2::new(x[0], x[1]);
        shift += step;
        gain = x[2];
        if (shift - start).norm() > 2.5 || !GAIN.contains(&gain) {
            return None;
        }
        if step.norm() < 1e-4 {
            return judged(&rows, &shift, &Vector4::new(gain, x[3], x[4], x[5]), half, (a.smoothing_m, a.cell_m));
        }
    }
    None
}

/// Covariance and correlation at the minimum.
#[allow(clippy::cast_precision_loss)]
fn judged(
    rows: &[Row],
    shift: &Vector2<f64>,
    light: &Vector4<f64>,
    half: usize,
    (smoothing_m, cell_m): (f64, f64),
) -> Option<Refined> {
    let count = rows.len() as f64;
    let mean = |of: fn(&Row) -> f64| rows.iter().map(of).sum::<f64>() / count;
    let (ma, mb) = (mean(|r| r.a), mean(|r| r.b));
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    let (mut ll, mut lg) = (Matrix4::zeros(), Matrix4x2::zeros());
    for r in rows {
        aa += (r.a - ma).powi(2);
        bb += (r.b - mb).powi(2);
        ab += (r.a - ma) * (r.b - mb);
        let of_light = r.of_light(half);
        ll += of_light * of_light.transpose();
        lg += of_light * r.g.transpose();
    }
    // gradients without what gain, offset and trend take up
    let taken_up = ll.try_inverse()? * lg;
    let (mut n, mut scattered) = (Matrix2::zeros(), Matrix2::zeros());
    let mut cells = Vec::with_capacity(rows.len());
    for r in rows {
        let of_light = r.of_light(half);
        let g = r.g - taken_up.transpose() * of_light;
        let off = r.b - light.dot(&of_light);
        n += g * g.transpose();
        scattered += g * g.transpose() * (off * off);
        cells.push(EdgeCell { at: r.at, place_m: r.place_m, gradient: g });
    }
    let inverse = n.try_inverse()?;
    let alike = 4.0 * std::f64::consts::PI * (smoothing_m / cell_m).powi(2);
    let m = scattered * alike;
    let covariance = inverse * m * inverse * cell_m.powi(2);
    Some(Refined {
        shift_m: shift * cell_m,
        covariance_m2: (covariance + covariance.transpose()) * 0.5,
        inverse,
        cells,
        correlation: ab / (aa * bb).sqrt(),
    })
}
