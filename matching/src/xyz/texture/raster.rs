//! Brightness on a raster in plan: a mean of the points about each cell, weighed by a Gaussian bell.

/// A cell whose weights sum up to less has no point near it and is a gap: one point at one and a half sigmas.
pub(super) const LEAST_WEIGHT: f32 = 0.325;
/// The bell ends at so many sigmas.
const REACH: f64 = 2.5;
/// Cells in one sigma of the bell.
const CELLS_PER_SIGMA: f64 = 1.25;

/// A raster; gaps are not a number.
#[derive(Debug, Clone)]
pub(super) struct Raster {
    /// South-west corner of the first cell \[m\].
    pub(super) low_m: [f64; 2],
    /// Edge of a cell \[m\].
    pub(super) cell_m: f64,
    /// Sigma of the bell \[m\].
    pub(super) smoothing_m: f64,
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) values: Vec<f32>,
}

impl Raster {
    /// The raster over a square; points are place and value.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_possible_wrap)]
    pub(super) fn new(
        points: impl Iterator<Item = ([f64; 2], f64)>,
        (low_m, width_m): ([f64; 2], f64),
        smoothing_m: f64,
    ) -> Self {
        let cell_m = smoothing_m / CELLS_PER_SIGMA;
        let columns = (width_m / cell_m).ceil().max(1.0) as usize;
        let (mut sums, mut weights) = (vec![0.0_f32; columns * columns], vec![0.0_f32; columns * columns]);
        let reach = (REACH * CELLS_PER_SIGMA).floor() as i64;
        let bell = |off: f64| (-0.5 * (off / CELLS_PER_SIGMA).powi(2)).exp() as f32;
        let mut across = [0.0_f32; 16];
        for (place_m, value) in points {
            let at = [0, 1].map(|k| (place_m[k] - low_m[k]) / cell_m - 0.5);
            let (x, y) = (at[0].round() as i64, at[1].round() as i64);
            if x < 0 || y < 0 || x >= columns as i64 || y >= columns as i64 {
                continue;
            }
            let (from, to) = ((x - reach).max(0), (x + reach).min(columns as i64 - 1));
            for (w, column) in across.iter_mut().zip(from..=to) {
                *w = bell(column as f64 - at[0]);
            }
            for row in (y - reach).max(0)..=(y + reach).min(columns as i64 - 1) {
                let along = bell(row as f64 - at[1]);
                let begin = row as usize * columns;
                let span = begin + from as usize..=begin + to as usize;
                let cells = sums[span.clone()].iter_mut().zip(&mut weights[span]);
                for ((sum, weight), w) in cells.zip(&across) {
                    let w = w * along;
                    *sum += w * value as f32;
                    *weight += w;
                }
            }
        }
        let value = |(s, w): (f32, f32)| if w < LEAST_WEIGHT { f32::NAN } else { s / w };
        let values = sums.into_iter().zip(weights).map(value).collect();
        Self { low_m, cell_m, smoothing_m, columns, rows: columns, values }
    }

    /// Middle of a cell \[m\].
    #[allow(clippy::cast_precision_loss)]
    pub(super) fn place_m(&self, column: usize, row: usize) -> [f64; 2] {
        [self.low_m[0] + (column as f64 + 0.5) * self.cell_m, self.low_m[1] + (row as f64 + 0.5) * self.cell_m]
    }

    /// The cell that holds a place.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub(super) fn cell_at(&self, place_m: [f64; 2]) -> Option<(usize, usize)> {
        let at = [0, 1].map(|k| ((place_m[k] - self.low_m[k]) / self.cell_m).floor());
        let within = at[0] >= 0.0 && at[1] >= 0.0 && at[0] < self.columns as f64 && at[1] < self.rows as f64;
        within.then(|| (at[0] as usize, at[1] as usize))
    }

    /// Value of a cell.
    #[inline]
    pub(super) fn at(&self, column: usize, row: usize) -> f32 {
        self.values[row * self.columns + column]
    }

    /// Central differences at a cell \[1/cell\]; not a number beside a gap.
    #[inline]
    pub(super) fn gradient(&self, column: usize, row: usize) -> [f32; 2] {
        if column == 0 || row == 0 || column + 1 >= self.columns || row + 1 >= self.rows {
            return [f32::NAN; 2];
        }
        [
            0.5 * (self.at(column + 1, row) - self.at(column - 1, row)),
            0.5 * (self.at(column, row + 1) - self.at(column, row - 1)),
        ]
    }

    /// Value and gradient \[1/cell\] between cells, linear; `None` beside a gap.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    pub(super) fn between(&self, column: f64, row: f64) -> Option<(f64, [f64; 2])> {
        let (x, y) = (column.floor(), row.floor());
        if x < 1.0 || y < 1.0 || x + 2.0 >= self.columns as f64 || y + 2.0 >= self.rows as f64 {
            return None;
        }
        let (fx, fy) = (column - x, row - y);
        let (x, y) = (x as usize, y as usize);
        let (mut value, mut gradient) = (0.0, [0.0; 2]);
        for (dx, dy, w) in
            [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
        {
            value += w * f64::from(self.at(x + dx, y + dy));
            let g = self.gradient(x + dx, y + dy);
            gradient[0] += w * f64::from(g[0]);
            gradient[1] += w * f64::from(g[1]);
        }
        (value + gradient[0] + gradient[1]).is_finite().then_some((value, gradient))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_raster_shows_its_points_and_its_gaps() {
        let wave = |p: [f64; 2]| (3.0 * p[0]).sin() + 0.5 * (2.0 * p[1]).cos();
        let points = (0..40_000_u32).filter_map(|k| {
            let p = [f64::from(k % 200) * 0.01 + 0.003, f64::from(k / 200) * 0.01 + 0.004];
            let gap = (0.8..1.2).contains(&p[0]) && (0.8..1.2).contains(&p[1]);
            (!gap).then(|| (p, wave(p)))
        });
        let raster = Raster::new(points, ([0.0, 0.0], 2.0), 0.03);
        let (column, row) = raster.cell_at([0.5, 1.5]).expect("inside");
        let p = raster.place_m(column, row);
        assert!((f64::from(raster.at(column, row)) - wave(p)).abs() < 0.01);
        let slope = f64::from(raster.gradient(column, row)[0]) / raster.cell_m;
        assert!((slope - 3.0 * (3.0 * p[0]).cos()).abs() < 0.03, "{slope}");
        let (column, row) = raster.cell_at([1.0, 1.0]).expect("inside");
        assert!(raster.at(column, row).is_nan());
        #[allow(clippy::cast_precision_loss)]
        let none = raster.between(column as f64 + 0.3, row as f64);
        assert!(none.is_none());
    }
}
