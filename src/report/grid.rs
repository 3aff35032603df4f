//! A raster over the map: its place, its cells, and values taken as medians of what falls into each cell.

use super::number::round_up;

/// Most cells on the long side of a map of values.
const MOST_CELLS: f64 = 600.0;
/// Fewest cells on the long side, however sparse the ties are.
const FEWEST_CELLS: f64 = 24.0;
/// Places a cell should hold on average: about one, so that cells are as wide as the ties are apart.
const PLACES_PER_CELL: f64 = 1.5;

/// Square cells, rows from north to south, edges on multiples of the cell width.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Western edge \[m\].
    pub west_m: f64,
    /// Northern edge \[m\].
    pub north_m: f64,
    /// Width of a cell \[m\].
    pub cell_m: f64,
    /// Columns.
    pub columns: u32,
    /// Rows.
    pub rows: u32,
}

/// Smallest and largest easting and northing of what is finite, or `None` for nothing.
pub(crate) fn extent(places_m: &[[f64; 2]]) -> Option<([f64; 2], [f64; 2])> {
    let mut finite = places_m.iter().filter(|p| p.iter().all(|v| v.is_finite()));
    let first = *finite.next()?;
    Some(finite.fold((first, first), |(low, high), p| {
        ([low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])])
    }))
}

impl Grid {
    /// The grid of cells of the given width around places, with a margin on each side.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
    pub fn around(places_m: &[[f64; 2]], cell_m: f64, margin_cells: f64) -> Option<Self> {
        let (low, high) = extent(places_m)?;
        let margin_m = margin_cells * cell_m;
        let west = ((low[0] - margin_m) / cell_m).floor();
        let east = ((high[0] + margin_m) / cell_m).floor() + 1.0;
        // Rows count from the north: a place on an edge belongs to the row south of it.
        let south = ((low[1] - margin_m) / cell_m).ceil() - 1.0;
        let north = ((high[1] + margin_m) / cell_m).ceil();
        let cells = |n: f64| n.clamp(1.0, 4096.0) as u32;
        Some(Self {
            west_m: west * cell_m,
            north_m: north * cell_m,
            cell_m,
            columns: cells(east - west),
            rows: cells(north - south),
        })
    }

    /// The grid for a map of values: cells about as wide as the places are apart, at most 600 on the long side.
    #[must_use]
    pub fn for_values(places_m: &[[f64; 2]]) -> Option<Self> {
        let (low, high) = extent(places_m)?;
        let long_m = (high[0] - low[0]).max(high[1] - low[1]).max(1.0);
        let mut cell_m = round_up(long_m / MOST_CELLS);
        let distinct = occupied(places_m, low, long_m / 4096.0);
        loop {
            let wider_m = round_up(cell_m * 1.01);
            #[allow(clippy::cast_precision_loss)]
            let enough = distinct as f64 >= PLACES_PER_CELL * occupied(places_m, low, cell_m) as f64;
            if enough || long_m / wider_m < FEWEST_CELLS {
                return Self::around(places_m, cell_m, 0.0);
            }
            cell_m = wider_m;
        }
    }

    /// Number of cells.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns as usize * self.rows as usize
    }

    /// Whether the grid has no cell: never, grids hold at least one.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Column and row of a place, as numbers with fractions from the upper left corner.
    #[must_use]
    pub fn pixel(&self, place_m: [f64; 2]) -> [f64; 2] {
        [(place_m[0] - self.west_m) / self.cell_m, (self.north_m - place_m[1]) / self.cell_m]
    }

    /// Index of the cell of a place; `None` outside.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the grid
    pub fn cell(&self, place_m: [f64; 2]) -> Option<usize> {
        let [column, row] = self.pixel(place_m);
        let inside = column >= 0.0 && row >= 0.0 && column < f64::from(self.columns) && row < f64::from(self.rows);
        inside.then(|| row as usize * self.columns as usize + column as usize)
    }

    /// Width and height \[m\].
    #[must_use]
    pub fn size_m(&self) -> [f64; 2] {
        [f64::from(self.columns) * self.cell_m, f64::from(self.rows) * self.cell_m]
    }

    /// The six lines of a world file: cell width, two rotations, minus cell height, centre of the upper left cell.
    #[must_use]
    pub fn world_file(&self) -> String {
        let (east, north) = (self.west_m + 0.5 * self.cell_m, self.north_m - 0.5 * self.cell_m);
        format!("{0}\n0\n0\n-{0}\n{east}\n{north}\n", self.cell_m)
    }
}

/// Number of cells that hold a place.
#[allow(clippy::cast_possible_truncation)] // cells of an extent
fn occupied(places_m: &[[f64; 2]], low: [f64; 2], cell_m: f64) -> usize {
    let key = |p: &[f64; 2]| (((p[0] - low[0]) / cell_m) as i64, ((p[1] - low[1]) / cell_m) as i64);
    let mut cells: Vec<_> = places_m.iter().filter(|p| p.iter().all(|v| v.is_finite())).map(key).collect();
    cells.sort_unstable();
    cells.dedup();
    cells.len()
}

/// A grid with a value in each cell; NaN where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// Its place.
    pub grid: Grid,
    /// Values \[m\], row by row from the north.
    pub values: Vec<f32>,
}

impl Raster {
    /// The median of the values in each cell; what is not finite is left out.
    #[must_use]
    #[allow(clippy::cast_possible_truncation)] // differences of centimetres
    pub fn medians(grid: Grid, values: impl Iterator<Item = ([f64; 2], f64)>) -> Self {
        let mut placed: Vec<(usize, f64)> =
            values.filter(|(_, v)| v.is_finite()).filter_map(|(place_m, v)| Some((grid.cell(place_m)?, v))).collect();
        placed.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut raster = vec![f32::NAN; grid.len()];
        for cell in placed.chunk_by(|a, b| a.0 == b.0) {
            let n = cell.len();
            raster[cell[0].0] = (0.5 * (cell[(n - 1) / 2].1 + cell[n / 2].1)) as f32;
        }
        Self { grid, values: raster }
    }

    /// Whether no cell has a value.
    #[must_use]
    pub fn is_blank(&self) -> bool {
        self.values.iter().all(|v| v.is_nan())
    }

    /// The size that a share of the cells stays below, 0 for none.
    #[must_use]
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn quantile_of_size(&self, share: f64) -> f64 {
        let mut sizes: Vec<f32> = self.values.iter().filter(|v| !v.is_nan()).map(|v| v.abs()).collect();
        sizes.sort_unstable_by(f32::total_cmp);
        let rank = (share * sizes.len() as f64) as usize;
        sizes.get(rank.min(sizes.len().saturating_sub(1))).map_or(0.0, |v| f64::from(*v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_holds_the_median_of_what_falls_into_it() {
        let places = [[0.5, 0.5], [0.6, 0.4], [0.7, 0.5], [2.5, 1.5]];
        let edges = [[0.0, 0.0], [2.0, 2.0]];
        let around = Grid::around(&edges, 1.0, 0.0).expect("a grid");
        assert!(edges.iter().all(|place| around.cell(*place).is_some()));
        let grid = Grid::around(&places, 1.0, 0.0).expect("a grid");
        assert_eq!((grid.columns, grid.rows), (3, 2));
        let values = [0.01, 0.05, 0.02, -0.03, f64::NAN];
        let raster = Raster::medians(grid, places.into_iter().chain([[0.5, 0.5]]).zip(values));
        assert!((raster.values[3] - 0.02).abs() < 1e-9 && (raster.values[2] + 0.03).abs() < 1e-9);
        assert!(raster.values[0].is_nan() && !raster.is_blank());
    }

    #[test]
    fn the_world_file_gives_the_centre_of_the_upper_left_cell() {
        let grid = Grid { west_m: 465_000.0, north_m: 5_247_000.0, cell_m: 2.5, columns: 4, rows: 3 };
        assert_eq!(grid.world_file(), "2.5\n0\n0\n-2.5\n465001.25\n5246998.75\n");
    }

    #[test]
    fn cells_are_about_as_wide_as_the_ties_are_apart() {
        let places: Vec<[f64; 2]> =
            (0..10_000).map(|i| [f64::from(i % 100) * 10.0, f64::from(i / 100) * 10.0]).collect();
        let grid = Grid::for_values(&places).expect("a grid");
        assert!((10.0..=20.0).contains(&grid.cell_m), "{}", grid.cell_m);
        let dense: Vec<[f64; 2]> = (0..250_000).map(|i| [f64::from(i % 500), f64::from(i / 500)]).collect();
        let grid = Grid::for_values(&dense).expect("a grid");
        assert!(grid.columns <= 601 && grid.columns >= 200, "{}", grid.columns);
    }

    #[test]
    fn one_place_or_none_is_an_ordinary_input() {
        assert!(Grid::for_values(&[]).is_none() && Grid::for_values(&[[f64::NAN, 1.0]]).is_none());
        let grid = Grid::for_values(&[[500_000.0, 5_000_000.0]]).expect("a grid");
        assert!(!grid.is_empty() && grid.cell([500_000.0, 5_000_000.0]).is_some());
    }
}
