//! What the places of the points make of a shift: an edge lies somewhere between two of them.
//!
//! A profile scanner that takes its beams at the same angles in every turn sees a road in rows along the way. An edge along the way lies between two rows of
//! distance a, all of it: however many points there are, its place is not known better than a/√12, and the rows of the other sighting are
//! elsewhere. Residuals do not show it, for a raster of rows that lie 4 cm off fits the other one at 4 cm.
//!
//! Projected on the normal of an edge, the points about it leave gaps h; the edge lies in one of them with the probability h/Σh and is
//! there uniform: σ² = Σ h³/(12 Σ h). In Σ g r an edge that is off by δ counts Σ g |g| δ. Edges of one orientation and sign are off by the
//! same (of one straight edge, or of the rows of one lattice), others not: s = Σ g |g| σ over each orientation, Σ s sᵀ over all.

use nalgebra::{Matrix2, Vector2};

use super::keep::TexturePoint;
use super::plan::Plan;

/// An edge is straight so far to both sides at most \[m\].
const ALONG_M: f64 = 0.3;
/// Further on an edge is another one, past a gap of so much \[m\].
const GAP_M: f64 = 0.1;
/// Points so far to both sides of an edge say where it is \[m\].
const ACROSS_M: f64 = 0.25;
/// Cells so near to each other tell the normal of an edge together \[m\].
const NORMAL_M: f64 = 0.12;
/// Orientations with sign.
const ORIENTATIONS: usize = 16;
/// Cells with a smaller gradient than this share of the largest are no edge.
const LEAST_GRADIENT: f64 = 0.15;
/// Of so many cells along either side one is looked at: the smoothing leaves nothing finer.
const STRIDE: usize = 2;

/// A cell of a window.
#[derive(Debug, Clone, Copy)]
pub(super) struct EdgeCell {
    /// Column and row within the window.
    pub(super) at: [usize; 2],
    /// In the first raster \[m\].
    pub(super) place_m: Vector2<f64>,
    /// Gradient, without what a gain and an offset take up \[1/cell\].
    pub(super) gradient: Vector2<f64>,
}

/// A cell on an edge.
#[derive(Debug)]
struct OnEdge {
    cell: EdgeCell,
    normal: Vector2<f64>,
    /// How far the edge goes on to either side \[m\].
    reach_m: [f64; 2],
}

/// Cells on edges.
#[derive(Debug)]
pub(super) struct Edges {
    cells: Vec<OnEdge>,
}

impl Edges {
    /// The edges of a window.
    pub(super) fn new(cells: &[EdgeCell]) -> Self {
        let most = cells.iter().map(|c| c.gradient.norm_squared()).fold(0.0, f64::max).sqrt();
        let on_edge: Vec<EdgeCell> = cells
            .iter()
            .filter(|c| c.at.iter().all(|k| k % STRIDE == 0) && c.gradient.norm() > LEAST_GRADIENT * most)
            .copied()
            .collect();
        let normal = |cell: &EdgeCell| {
            let near = on_edge.iter().filter(|o| (o.place_m - cell.place_m).norm_squared() < NORMAL_M * NORMAL_M);
            let sum: Vector2<f64> = near.map(|o| o.gradient * o.gradient.dot(&cell.gradient).signum()).sum();
            sum.try_normalize(1e-12).unwrap_or_else(|| cell.gradient.normalize())
        };
        let of = |cell: &EdgeCell| {
            let normal = normal(cell);
            OnEdge { reach_m: reach_m(&on_edge, cell, &normal), cell: *cell, normal }
        };
        Self { cells: on_edge.iter().map(of).collect() }
    }

    /// Scatter of Σ g r by where the points of a sighting are, `shift_m` from the first raster to its own \[m²/cell²\].
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub(super) fn scatter(&self, points: &[TexturePoint], plan: &Plan, shift_m: &Vector2<f64>) -> Matrix2<f64> {
        let mut sums = [Vector2::<f64>::zeros(); ORIENTATIONS];
        let mut offs_m = Vec::new();
        for OnEdge { cell, normal, reach_m } in &self.cells {
            let place_m = cell.place_m + shift_m;
            offs_m.clear();
            offs_m.push(-ACROSS_M);
            for k in plan.about([place_m.x, place_m.y], ALONG_M.hypot(ACROSS_M)) {
                let [x, y, _] = points[k].place_m.map(f64::from);
                let off = Vector2::new(x, y) - place_m;
                let (across, along) = (off.dot(normal), off.perp(normal));
                if (-reach_m[0]..reach_m[1]).contains(&along) && across.abs() < ACROSS_M {
                    offs_m.push(across);
                }
            }
            offs_m.push(ACROSS_M);
            offs_m.sort_unstable_by(f64::total_cmp);
            let cubes: f64 = offs_m.windows(2).map(|w| (w[1] - w[0]).powi(3)).sum();
            let sigma_m = (cubes / (12.0 * 2.0 * ACROSS_M)).sqrt();
            let turn = cell.gradient.y.atan2(cell.gradient.x) / std::f64::consts::TAU * ORIENTATIONS as f64;
            let bin = turn.round().rem_euclid(ORIENTATIONS as f64) as usize % ORIENTATIONS;
            sums[bin] += cell.gradient * (cell.gradient.norm() * sigma_m);
        }
        let of_all = (STRIDE * STRIDE) as f64;
        sums.iter().map(|s| s * of_all).map(|s| s * s.transpose()).sum()
    }
}

/// How far the edge through a cell goes on to either side \[m\]: as long as cells ahead rise the same way, half as steeply at least. Smoothing halves
/// the gradient where an edge ends.
fn reach_m(on_edge: &[EdgeCell], cell: &EdgeCell, normal: &Vector2<f64>) -> [f64; 2] {
    let least = 0.5 * cell.gradient.dot(normal).abs();
    let sign = cell.gradient.dot(normal).signum();
    let mut ahead_m: [Vec<f64>; 2] = Default::default();
    for other in on_edge {
        let off = other.place_m - cell.place_m;
        let (across, along) = (off.dot(normal), off.perp(normal));
        if across.abs() < 0.5 * NORMAL_M && along.abs() < ALONG_M && other.gradient.dot(normal) * sign > least {
            ahead_m[usize::from(along > 0.0)].push(along.abs());
        }
    }
    ahead_m.map(|mut steps_m| {
        steps_m.sort_unstable_by(f64::total_cmp);
        let end = steps_m.iter().try_fold(0.0, |last: f64, s| if s - last > GAP_M { Err(last) } else { Ok(*s) });
        let (Ok(end_m) | Err(end_m)) = end;
        // half of what lies between two cells that were looked at, and of the last one itself
        end_m + 0.02
    })
}

/// A covariance that is in each direction that of the larger: with a = L Lᵀ and the eigenvalues λ of L⁻¹ b L⁻ᵀ, L V max(1, λ) Vᵀ Lᵀ.
pub(super) fn larger(a: &Matrix2<f64>, b: &Matrix2<f64>) -> Matrix2<f64> {
    let Some((l, inverse)) = a.cholesky().and_then(|c| Some((c.l(), c.l().try_inverse()?))) else { return *b };
    let whitened = inverse * b * inverse.transpose();
    let axes = ((whitened + whitened.transpose()) * 0.5).symmetric_eigen();
    let root = l * axes.eigenvectors;
    root * Matrix2::from_diagonal(&axes.eigenvalues.map(|v| v.max(1.0))) * root.transpose()
}

#[cfg(test)]
#[allow(clippy::cast_precision_loss)]
mod tests {
    use super::*;
    use crate::block::SourceKey;

    /// Rows along x, `row_m` apart, points `step_m` apart along them, each row begins `skew_m` later.
    fn rows(row_m: f64, step_m: f64, skew_m: f64) -> Vec<TexturePoint> {
        let mut points = Vec::new();
        for r in -20..=20_i32 {
            for k in -60..=60_i32 {
                let y = f64::from(r) * row_m + 0.011;
                let x = f64::from(k) * step_m + f64::from(r) * skew_m;
                #[allow(clippy::cast_possible_truncation)]
                let place_m = [x as f32, y as f32, 0.0];
                let source = SourceKey::new(1, 0, 0);
                points.push(TexturePoint { time_s: 0.0, source, place_m, intensity: 1, range_cm: 1 });
            }
        }
        points.retain(|p| p.place_m.iter().all(|v| v.abs() < 1.0));
        points
    }

    /// Standard deviation of a straight edge through the middle with this normal, so many cells of 5 cm long.
    fn sigma_of_m(points: &[TexturePoint], angle_deg: f64, count: usize) -> f64 {
        let angle = angle_deg.to_radians();
        let normal = Vector2::new(angle.cos(), angle.sin());
        let middle = (count as f64 - 1.0) / 2.0;
        let cells: Vec<EdgeCell> = (0..count)
            .map(|k| EdgeCell {
                at: [k * STRIDE, 0],
                place_m: Vector2::new(-normal.y, normal.x) * ((k as f64 - middle) * 0.05),
                gradient: normal,
            })
            .collect();
        let scatter = Edges::new(&cells).scatter(points, &Plan::new(points, -1.0, 2.0), &Vector2::zeros());
        // N is n nᵀ times the cells; of all cells one in four was looked at
        (normal.dot(&(scatter * normal))).sqrt() / (cells.len() * STRIDE * STRIDE) as f64
    }

    fn sigma_m(points: &[TexturePoint], angle_deg: f64) -> f64 {
        sigma_of_m(points, angle_deg, 21)
    }

    #[test]
    fn a_short_edge_across_the_rows_is_known_by_the_rows_that_cross_it() {
        // one row or two of points 8 cm apart
        let points = rows(0.06, 0.08, 0.04);
        let short = sigma_of_m(&points, 0.0, 2);
        assert!((0.008..0.024).contains(&short), "{short}");
        assert!(sigma_of_m(&points, 10.0, 13) < 0.3 * short);
    }

    #[test]
    fn an_edge_along_the_rows_is_known_to_a_row_and_one_across_them_well() {
        let points = rows(0.06, 0.08, 0.023);
        let along = sigma_m(&points, 90.0);
        assert!((along - 0.06 / 12_f64.sqrt()).abs() < 0.001, "{along}");
        let across = sigma_m(&points, 10.0);
        assert!(across < 0.004, "{across}");
        // every second row: twice the gap
        let points = rows(0.12, 0.04, 0.023);
        assert!((sigma_m(&points, 90.0) - 0.12 / 12_f64.sqrt()).abs() < 0.003);
    }

    #[test]
    fn in_each_direction_the_larger_counts() {
        let (a, b) = (Matrix2::new(4.0, 0.0, 0.0, 1.0), Matrix2::new(1.0, 0.0, 0.0, 9.0));
        assert!((larger(&a, &b) - Matrix2::new(4.0, 0.0, 0.0, 9.0)).norm() < 1e-12);
        let b = Matrix2::new(3.0, 1.2, 1.2, 2.0);
        let both = larger(&a, &b);
        assert!((both - a).symmetric_eigenvalues().min() > -1e-12 && (both - b).symmetric_eigenvalues().min() > -1e-12);
        assert!((larger(&b, &a) - both).norm() < 1e-12);
        assert!((larger(&a, &(a * 0.5)) - a).norm() < 1e-12);
    }
}
