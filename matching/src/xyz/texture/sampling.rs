//! What the places of the points make of a shift: between two of them an edge may lie anywhere.
//!
//! A profile scanner that takes its beams at the same angles in every turn sees a road in rows along the way. An edge along the way is drawn by the
//! raster in the middle between the two rows that it lies between, wherever between them it is: all of it is off by up to half a row. The rows of the other sighting are
//! elsewhere. Residuals do not show it, for rows that lie 4 cm off fit the other raster at 4 cm.
//!
//! So it is tried: an edge is laid at the offset u from where the raster has it, the points about a cell say 0 on this side and 1 on that, and the raster
//! of these, less the ideal edge Φ, weighed by the slope γ of Φ, is what the edge seems to be off by: `e(u) = Σ γ (Φ - R)/Σ γ²`. In Σ g r an edge that is off by e
//! counts Σ g |g| e. Edges of one orientation and sign have one u (of one straight edge, or of the rows of one lattice), others another: with the mean of e over the
//! cells of an orientation, `Σ g |g|` of it, and the mean square over u, Σ s sᵀ over all. Rows that cross an edge aslant take it up by themselves.

use std::sync::LazyLock;

use nalgebra::{Matrix2, Vector2};

use super::keep::TexturePoint;
use super::plan::Plan;
use super::raster::LEAST_WEIGHT;

/// Cells so near to each other tell the normal of an edge together \[m\].
const NORMAL_M: f64 = 0.25;
/// Orientations with sign.
const ORIENTATIONS: usize = 8;
/// Cells with a smaller gradient than this share of the largest are no edge.
const LEAST_GRADIENT: f64 = 0.15;
/// Offsets that are tried, to both sides, and from one to the next \[m\]: a row of points and more.
const OFFSETS: i32 = 6;
const OFFSET_M: f64 = 0.02;
/// One ridge of so many is tried: neighbours lie under one bell.
const EVERY: usize = 2;
/// Values of the bell in one sigma, and sigmas at which it ends.
const OF_SIGMA: usize = 64;
const BELL_ENDS: usize = 4;
/// The bell over the distance from its middle: an exponential for each point would be most of the work.
static BELL: LazyLock<Vec<f64>> = LazyLock::new(|| {
    #[allow(clippy::cast_precision_loss)] // a few hundred
    (0..OF_SIGMA * BELL_ENDS).map(|k| (-0.5 * ((k as f64 + 0.5) / OF_SIGMA as f64).powi(2)).exp()).collect()
});
/// Φ at steps of half a sigma from the edge on, to both sides.
const STEP: [f64; 6] = [0.5, 0.691_462, 0.841_345, 0.933_193, 0.977_250, 0.993_790];

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

/// A place where an edge is steepest.
#[derive(Debug)]
struct Ridge {
    place_m: Vector2<f64>,
    /// The way the brightness rises.
    normal: Vector2<f64>,
    /// Square of the gradient.
    weight: f64,
    orientation: usize,
}

/// The edges of a window.
#[derive(Debug)]
pub(super) struct Edges {
    ridges: Vec<Ridge>,
    /// Σ g |g| of the cells of an orientation.
    sums: [Vector2<f64>; ORIENTATIONS],
}

#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)] // eight
fn orientation(direction: &Vector2<f64>) -> usize {
    let turn = direction.y.atan2(direction.x) / std::f64::consts::TAU * ORIENTATIONS as f64;
    turn.round().rem_euclid(ORIENTATIONS as f64) as usize % ORIENTATIONS
}

impl Edges {
    /// The edges of a window.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)] // a window
    pub(super) fn new(cells: &[EdgeCell], cell_m: f64) -> Self {
        let most = cells.iter().map(|c| c.gradient.norm_squared()).fold(0.0, f64::max).sqrt();
        let on_edge: Vec<EdgeCell> =
            cells.iter().filter(|c| c.gradient.norm() > LEAST_GRADIENT * most).copied().collect();
        let side = cells.iter().flat_map(|c| c.at).max().map_or(0, |most| most + 1);
        let mut window = vec![Vector2::<f64>::zeros(); side * side];
        cells.iter().for_each(|c| window[c.at[1] * side + c.at[0]] = c.gradient);
        let mut sums = [Vector2::zeros(); ORIENTATIONS];
        on_edge.iter().for_each(|c| sums[orientation(&c.gradient)] += c.gradient * c.gradient.norm());
        // how steep it is a cell further on, the same way
        let beside = |cell: &EdgeCell, to: &Vector2<f64>| {
            let at = [cell.at[0] as f64 + to.x, cell.at[1] as f64 + to.y];
            let within = at.iter().all(|k| (0.0..side as f64).contains(k));
            if within { window[at[1] as usize * side + at[0] as usize].dot(&cell.gradient.normalize()) } else { 0.0 }
        };
        let normal = |cell: &EdgeCell| {
            let near = on_edge.iter().filter(|o| (o.place_m - cell.place_m).norm_squared() < NORMAL_M * NORMAL_M);
            let alike = near.filter(|o| o.gradient.dot(&cell.gradient) > 0.0);
            let sum: Vector2<f64> = alike.map(|o| o.gradient).sum();
            sum.try_normalize(1e-12).unwrap_or_else(|| cell.gradient.normalize())
        };
        let ridges = on_edge.iter().filter_map(|c| {
            let to = c.gradient.normalize().map(f64::round);
            let (here, ahead, behind) = (c.gradient.norm(), beside(c, &to), beside(c, &-to));
            // of a parabola through the three
            let top = 0.5 * (ahead - behind) / (2.0 * here - ahead - behind).max(1e-12);
            (here >= ahead && here > behind).then(|| Ridge {
                place_m: c.place_m + to * (top * cell_m),
                normal: normal(c),
                weight: here * here,
                orientation: orientation(&c.gradient),
            })
        });
        Self { ridges: ridges.collect(), sums }
    }

    /// Scatter of Σ g r by where the points of a sighting are, `shift_m` from the first raster to its own, seen through a bell of `smoothing_m` \[m²/cell²\].
    pub(super) fn scatter(
        &self,
        (points, plan): (&[TexturePoint], &Plan),
        shift_m: &Vector2<f64>,
        smoothing_m: f64,
    ) -> Matrix2<f64> {
        let squares = self.squares((points, plan), shift_m, smoothing_m);
        let largest = squares.iter().flatten().copied().fold(0.0, f64::max);
        self.sums.iter().zip(squares).map(|(s, square)| s * s.transpose() * square.unwrap_or(largest)).sum()
    }

    /// Mean squares over all offsets of what the edges of an orientation are off by.
    fn squares(
        &self,
        (points, plan): (&[TexturePoint], &Plan),
        shift_m: &Vector2<f64>,
        smoothing_m: f64,
    ) -> [Option<f64>; ORIENTATIONS] {
        let mut off_m = [[0.0; ORIENTATIONS]; 2 * OFFSETS as usize + 1];
        let mut weights = [[0.0; ORIENTATIONS]; 2 * OFFSETS as usize + 1];
        let mut near = Vec::new();
        for ridge in self.ridges.iter().step_by(EVERY) {
            let place_m = ridge.place_m + shift_m;
            let normal = ridge.normal;
            let reach_m = f64::from(OFFSETS) * OFFSET_M + 5.0 * smoothing_m;
            near.clear();
            for k in plan.about([place_m.x, place_m.y], reach_m) {
                let [x, y, _] = points[k].place_m.map(f64::from);
                let off = Vector2::new(x, y) - place_m;
                let (across, along) = (off.dot(&normal), off.perp(&normal));
                if along.abs() < 3.0 * smoothing_m && across.abs() < reach_m {
                    near.push((across / smoothing_m, bell(along / smoothing_m)));
                }
            }
            for ((u, off_m), weights) in (-OFFSETS..=OFFSETS).zip(&mut off_m).zip(&mut weights) {
                if let Some(off) = seems_off(&near, f64::from(u) * OFFSET_M / smoothing_m) {
                    off_m[ridge.orientation] += ridge.weight * off * smoothing_m;
                    weights[ridge.orientation] += ridge.weight;
                }
            }
        }
        std::array::from_fn(|k| {
            let offs = off_m.iter().zip(&weights).filter(|(_, w)| w[k] > 0.0).map(|(o, w)| (o[k] / w[k]).powi(2));
            let (sum, count) = offs.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
            (count > 0.0).then(|| sum / count)
        })
    }
}

/// The bell at so many sigmas from its middle.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)] // not negative, bounded
fn bell(sigmas: f64) -> f64 {
    BELL.get((sigmas.abs() * OF_SIGMA as f64) as usize).copied().unwrap_or(0.0)
}

/// By how much an edge at an offset seems to lie further on than it does, from points across it and their weights along it; all in sigmas of the bell. Nothing in a
/// gap.
fn seems_off(points: &[(f64, f64)], offset: f64) -> Option<f64> {
    let (mut off, mut slopes) = (0.0, 0.0);
    for k in -5..=5_i32 {
        let from_edge = 0.5 * f64::from(k);
        let (mut above, mut all) = (0.0, 0.0);
        for (across, weight) in points {
            let w = weight * bell(across - offset - from_edge);
            all += w;
            above += if *across > offset { w } else { 0.0 };
        }
        if all < f64::from(LEAST_WEIGHT) {
            continue;
        }
        let ideal = STEP[k.unsigned_abs() as usize];
        let ideal = if k < 0 { 1.0 - ideal } else { ideal };
        let slope = (-0.5 * from_edge * from_edge).exp() / std::f64::consts::TAU.sqrt();
        off += slope * (ideal - above / all);
        slopes += slope * slope;
    }
    (slopes > 0.0).then(|| off / slopes)
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

    /// Standard deviation of a straight edge through the middle with this normal, so many cells of 4 cm long, as a bell of 5 cm shows it.
    fn sigma_of_m(points: &[TexturePoint], angle_deg: f64, count: usize) -> f64 {
        let angle = angle_deg.to_radians();
        let normal = Vector2::new(angle.cos(), angle.sin());
        let half_m = 0.02 * count as f64;
        let cells: Vec<EdgeCell> = (0..41 * 41)
            .filter_map(|k| {
                let at = [k % 41, k / 41];
                let place_m = Vector2::new(at[0] as f64 - 20.0, at[1] as f64 - 20.0) * 0.04;
                let (across, along) = (place_m.dot(&normal), place_m.perp(&normal));
                let gradient = normal * (-0.5 * (across / 0.05_f64).powi(2)).exp();
                (along.abs() < half_m).then_some(EdgeCell { at, place_m, gradient })
            })
            .collect();
        let scatter =
            Edges::new(&cells, 0.04).scatter((points, &Plan::new(points, -1.0, 2.0)), &Vector2::zeros(), 0.05);
        let of_all: f64 = cells.iter().map(|c| c.gradient.norm_squared()).sum();
        (normal.dot(&(scatter * normal))).sqrt() / of_all
    }

    fn sigma_m(points: &[TexturePoint], angle_deg: f64) -> f64 {
        sigma_of_m(points, angle_deg, 21)
    }

    #[test]
    fn an_edge_along_the_rows_is_known_to_a_row_and_one_across_them_well() {
        let points = rows(0.06, 0.08, 0.023);
        let (along, of_row) = (sigma_m(&points, 90.0), 0.06 / 12_f64.sqrt());
        assert!((0.9..1.2).contains(&(along / of_row)), "{along}");
        let across = sigma_m(&points, 10.0);
        assert!(across < 0.25 * of_row, "{across}");
        // every second row: twice the gap
        let twice = sigma_m(&rows(0.12, 0.04, 0.023), 90.0) / (0.12 / 12_f64.sqrt());
        assert!((0.9..1.2).contains(&twice), "{twice}");
    }

    #[test]
    fn points_that_lie_anyhow_know_an_edge_better_than_rows_do() {
        let mut state = 1_u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 24)
        };
        let source = SourceKey::new(1, 0, 0);
        #[allow(clippy::cast_possible_truncation)]
        let anyhow: Vec<TexturePoint> = (0..1000)
            .map(|_| [(2.0 * draw() - 1.0) as f32, (2.0 * draw() - 1.0) as f32, 0.0])
            .map(|place_m| TexturePoint { time_s: 0.0, source, place_m, intensity: 1, range_cm: 1 })
            .collect();
        let in_rows = rows(0.06, 0.08, 0.023); // not as many in a square metre
        assert!(sigma_m(&anyhow, 90.0) < 0.7 * sigma_m(&in_rows, 90.0));
    }
}
