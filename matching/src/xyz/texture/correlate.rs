//! Normalised correlation of a window of one raster with another about a place, gaps left out.

use std::cmp::Ordering;

use super::raster::Raster;

/// Cells from one that is compared to the next: the smoothing leaves nothing finer.
const STRIDE: usize = 2;
/// Of a window, so much must be seen: at the peak, and on either side of it.
const LEAST_SEEN: f64 = 0.7;
const LEAST_SEEN_BESIDE: f64 = 0.5;

/// Correlations over shifts: a square about none, `reach` steps to each side.
#[derive(Debug, Clone)]
pub(super) struct Surface {
    /// Cells from one shift to the next.
    pub(super) step: usize,
    pub(super) reach: usize,
    /// Row by row; not a number where too little is seen.
    pub(super) values: Vec<f32>,
}

impl Surface {
    fn side(&self) -> usize {
        2 * self.reach + 1
    }

    fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y * self.side() + x]
    }

    /// Peaks, the highest first: correlation and shift in cells.
    #[allow(clippy::cast_possible_wrap)] // small
    pub(super) fn peaks(&self) -> Vec<(f32, [i64; 2])> {
        let (side, reach, step) = (self.side(), self.reach as i64, self.step as i64);
        let mut peaks = Vec::new();
        for y in 0..side {
            for x in 0..side {
                let value = self.at(x, y);
                let about = (y.saturating_sub(1)..=(y + 1).min(side - 1))
                    .flat_map(|r| (x.saturating_sub(1)..=(x + 1).min(side - 1)).map(move |c| (c, r)));
                if value.is_finite()
                    && about.filter(|at| *at != (x, y)).all(|(c, r)| {
                        let other = self.at(c, r);
                        // of equal neighbours the first
                        match other.partial_cmp(&value) {
                            Some(Ordering::Greater) => false,
                            Some(Ordering::Equal) => (r, c) > (y, x),
                            Some(Ordering::Less) | None => true,
                        }
                    })
                {
                    peaks.push((value, [(x as i64 - reach) * step, (y as i64 - reach) * step]));
                }
            }
        }
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        peaks
    }
}

/// The window of `half` cells to each side of a cell, as differences of place and values; gaps left out.
#[allow(clippy::cast_possible_wrap, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn window(raster: &Raster, (column, row): (usize, usize), half: usize) -> Vec<(i64, i64, f32)> {
    let half = half as i64;
    let mut cells = Vec::new();
    for dy in (-half..=half).step_by(STRIDE) {
        for dx in (-half..=half).step_by(STRIDE) {
            let (x, y) = (column as i64 + dx, row as i64 + dy);
            if x >= 0 && y >= 0 && x < raster.columns as i64 && y < raster.rows as i64 {
                let value = raster.at(x as usize, y as usize);
                if value.is_finite() {
                    cells.push((dx, dy, value));
                }
            }
        }
    }
    cells
}

/// Correlates the window about a cell of `a` with `b`, shifted by up to `reach` cells in steps of `step`.
#[allow(
    clippy::cast_possible_wrap,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss
)]
pub(super) fn correlate(
    a: &Raster,
    cell: (usize, usize),
    b: &Raster,
    half: usize,
    (reach, step): (usize, usize),
) -> Surface {
    let cells = window(a, cell, half);
    let whole = ((2 * half) / STRIDE + 1).pow(2) as f64;
    let reach = reach / step;
    let side = 2 * reach + 1;
    let mut surface = Surface { reach, step, values: vec![f32::NAN; side * side] };
    if (cells.len() as f64) < LEAST_SEEN * whole {
        return surface;
    }
    let first = (reach * step) as i64;
    let origin = [cell.0 as i64 - first, cell.1 as i64 - first];
    for (k, value) in surface.values.iter_mut().enumerate() {
        let (x, y) = (origin[0] + (step * (k % side)) as i64, origin[1] + (step * (k / side)) as i64);
        let (mut n, mut sa, mut sb, mut saa, mut sbb, mut sab) = (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
        for (dx, dy, va) in &cells {
            let (column, row) = (x + dx, y + dy);
            if column < 0 || row < 0 || column >= b.columns as i64 || row >= b.rows as i64 {
                continue;
            }
            let vb = b.at(column as usize, row as usize);
            if vb.is_finite() {
                n += 1.0;
                sa += va;
                sb += vb;
                saa += va * va;
                sbb += vb * vb;
                sab += va * vb;
            }
        }
        if f64::from(n) < LEAST_SEEN * whole {
            continue;
        }
        let (va, vb) = (saa - sa * sa / n, sbb - sb * sb / n);
        if va > 1e-6 * n && vb > 1e-6 * n {
            *value = (sab - sa * sb / n) / (va * vb).sqrt();
        }
    }
    surface
}

/// Whether the window about a cell is seen on all four sides of it.
pub(super) fn is_supported(raster: &Raster, cell: (usize, usize), half: usize) -> bool {
    let cells = window(raster, cell, half);
    #[allow(clippy::cast_precision_loss)]
    let whole = ((2 * half) / STRIDE + 1).pow(2) as f64;
    let sides: [fn(i64, i64) -> bool; 4] = [|x, _| x > 0, |x, _| x < 0, |_, y| y > 0, |_, y| y < 0];
    #[allow(clippy::cast_precision_loss)]
    sides.iter().all(|on| {
        let seen = cells.iter().filter(|(x, y, _)| on(*x, *y)).count() as f64;
        seen >= LEAST_SEEN_BESIDE * 0.5 * whole
    })
}
