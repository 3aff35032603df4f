//! Which things stand in which square of the ground.

use nalgebra::{Vector2, Vector3};

/// Side of a square \[m\].
const CELL_M: f64 = 8.0;

/// Squares over a rectangle about the origin, each with the numbers of the things whose circle touches it.
#[derive(Debug, Clone)]
pub(super) struct Index {
    half_m: Vector2<f64>,
    columns: usize,
    rows: usize,
    cells: Vec<Vec<u32>>,
}

impl Index {
    pub(super) fn new(half_m: Vector2<f64>) -> Self {
        let count = |half: f64| cell_number(2.0 * half) + 1;
        let (columns, rows) = (count(half_m.x), count(half_m.y));
        Self { half_m, columns, rows, cells: vec![Vec::new(); columns * rows] }
    }

    /// Adds a thing to every square that its circle touches.
    pub(super) fn add(&mut self, number: u32, centre: Vector2<f64>, radius_m: f64) {
        let at = |offset: f64| {
            let p = centre + self.half_m + Vector2::repeat(offset);
            (cell_number(p.x).min(self.columns - 1), cell_number(p.y).min(self.rows - 1))
        };
        let ((x0, y0), (x1, y1)) = (at(-radius_m), at(radius_m));
        for y in y0..=y1 {
            for x in x0..=x1 {
                self.cells[y * self.columns + x].push(number);
            }
        }
    }

    /// Calls `visit` with the things of every square under a ray between two distances; a thing may come twice.
    pub(super) fn along(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        (start, end): (f64, f64),
        mut visit: impl FnMut(u32),
    ) {
        let (a, b) = (origin + direction * start, origin + direction * end);
        let (a, b) = (a.xy() + self.half_m, b.xy() + self.half_m);
        // Half a cell a step, and the circle of every thing was given a cell's width to spare: nothing is missed.
        let steps = ((b - a).amax() / (0.5 * CELL_M)).ceil().max(1.0);
        let step = (b - a) / steps;
        let mut last = usize::MAX;
        let mut at = a;
        for _ in 0..=cell_number(steps * CELL_M) {
            if at.x >= 0.0 && at.y >= 0.0 {
                let (x, y) = (cell_number(at.x), cell_number(at.y));
                let cell = y * self.columns + x;
                if x < self.columns && y < self.rows && cell != last {
                    last = cell;
                    self.cells[cell].iter().for_each(|&number| visit(number));
                }
            }
            at += step;
        }
    }

    /// What to add to a circle so that [`Index::along`] cannot step over its edge.
    pub(super) const MARGIN_M: f64 = 0.5 * CELL_M;
}

/// Number of the cell of a distance \[m\], from 0.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative, and far below 2^32
fn cell_number(distance_m: f64) -> usize {
    (distance_m.max(0.0) / CELL_M) as usize
}
