//! Rejection of ties by their distances: robust per pair of sightings, and against their neighbours.

use std::collections::BTreeMap;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix6, Vector3, Vector6};
use rayon::prelude::*;

use crate::patch::{Patch, Sighting};
use crate::surface_line::{Rejection, SurfaceLine, measure};

/// How far a distance may lie from what the pair, or its neighbours, say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RejectOptions {
    /// Limit in robust sigmas (1.4826 MAD) of the pair.
    pub pair_k: f64,
    /// A pair's limit is never below this \[m\].
    pub pair_floor_m: f64,
    /// Neighbours that a tie is compared with.
    pub neighbours: usize,
    /// Limit against the median of the neighbours, in robust sigmas of the pair.
    pub neighbour_k: f64,
    /// Floor of the sigma of an end \[m\], see [`measure`].
    pub sigma_floor_m: f64,
}

impl Default for RejectOptions {
    fn default() -> Self {
        Self { pair_k: 5.0, pair_floor_m: 0.03, neighbours: 8, neighbour_k: 4.0, sigma_floor_m: 0.001 }
    }
}

/// One distance between two sightings of a surface.
struct Distance {
    line: usize,
    ends: (usize, usize),
    normal: Vector3<f64>,
    point_m: Vector3<f64>,
    distance_m: f64,
}

/// Rejects ends whose distances to most of the others do not fit: first robustly per pair of sightings, about a
/// rigid motion between the two; then against the nearest ties of the same pair, which finds surfaces that changed.
///
/// `patch_of` gives the patch as it lies now (after present corrections). Returns the number of ends rejected.
pub fn reject_by_distance(
    lines: &mut [SurfaceLine],
    patch_of: impl Fn(&Patch) -> Patch + Sync,
    options: &RejectOptions,
) -> usize {
    let mut pairs: BTreeMap<(Sighting, Sighting), Vec<Distance>> = BTreeMap::new();
    let measured: Vec<_> = lines
        .par_iter()
        .map(|line| {
            let (rows, patches): (Vec<usize>, Vec<Patch>) = line.used().map(|(i, p)| (i, patch_of(p))).unzip();
            let references: Vec<&Patch> = patches.iter().collect();
            (rows, measure(&references, options.sigma_floor_m))
        })
        .collect();
    for (line, (rows, measurement)) in measured.iter().enumerate() {
        let Some(m) = measurement else { continue };
        for a in 0..rows.len() {
            for b in a + 1..rows.len() {
                let of = |k: usize| Sighting { pass: 0, ..lines[line].ends[rows[k]].patch.sighting };
                let (a, b) = if of(a) <= of(b) { (a, b) } else { (b, a) };
                pairs.entry((of(a), of(b))).or_default().push(Distance {
                    line,
                    ends: (rows[a], rows[b]),
                    normal: m.normal,
                    point_m: m.point_m,
                    distance_m: m.offsets[b].0 - m.offsets[a].0,
                });
            }
        }
    }
    let verdicts: Vec<Vec<Option<Rejection>>> = pairs.par_iter().map(|(_, d)| judge(d, options)).collect();
    // An end goes when it disagrees with more than half of those it is compared with.
    let mut votes: BTreeMap<(usize, usize), (usize, usize, Option<Rejection>)> = BTreeMap::new();
    for (distances, verdicts) in pairs.values().zip(verdicts) {
        for (d, verdict) in distances.iter().zip(verdicts) {
            for end in [d.ends.0, d.ends.1] {
                let vote = votes.entry((d.line, end)).or_insert((0, 0, None));
                vote.0 += 1;
                vote.1 += usize::from(verdict.is_some());
                vote.2 = vote.2.or(verdict);
            }
        }
    }
    let mut rejected = 0;
    for ((line, end), (compared, against, reason)) in votes {
        if 2 * against > compared {
            lines[line].ends[end].rejection = reason;
            rejected += 1;
        }
    }
    rejected
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// A verdict for each distance of one pair of sightings.
fn judge(distances: &[Distance], options: &RejectOptions) -> Vec<Option<Rejection>> {
    if distances.len() < 12 {
        return distances.iter().map(|_| None).collect();
    }
    let residuals = residuals_about_a_rigid_motion(distances);
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    let sigma_m = 1.4826 * median(&mut sizes);
    let limit_m = (options.pair_k * sigma_m).max(options.pair_floor_m);
    let points: Vec<[f64; 3]> = distances.iter().map(|d| d.point_m.into()).collect();
    let around = neighbourhoods(&points, &residuals, options.neighbours);
    residuals
        .iter()
        .zip(around)
        .map(|(r, around)| {
            let Some((centre, spread)) = around else {
                return (r.abs() > limit_m).then_some(Rejection::PairOutlier);
            };
            // Neighbours that deviate together may be an error of the trajectory over time: that is for the
            // adjustment to judge. What deviates alone is a blunder or a surface that changed.
            let local_m = options.neighbour_k * spread.max(sigma_m).max(0.1 * options.pair_floor_m);
            if (r - centre).abs() <= local_m {
                None
            } else if r.abs() > limit_m {
                Some(Rejection::PairOutlier)
            } else {
                Some(Rejection::ChangeOfSurface)
            }
        })
        .collect()
}

/// Median and robust sigma of the values at the nearest neighbours of each point, itself left out; `None` where there
/// are too few to judge by.
fn neighbourhoods(points: &[[f64; 3]], values: &[f64], neighbours: usize) -> Vec<Option<(f64, f64)>> {
    let Some(count) = NonZero::new(neighbours + 1).filter(|n| points.len() > 2 * n.get()) else {
        return vec![None; points.len()];
    };
    let Ok(tree) = ImmutableKdTree::<f64, 3>::new_from_slice(points) else { return vec![None; points.len()] };
    points
        .iter()
        .enumerate()
        .map(|(k, point)| {
            let nearest = tree.query(point).nearest_n::<SquaredEuclidean<f64>>(count).execute();
            let mut around: Vec<f64> = nearest
                .iter()
                .filter_map(|n| usize::try_from(n.item).ok())
                .filter(|item| *item != k)
                .map(|item| values[item])
                .collect();
            if around.len() < neighbours / 2 {
                return None;
            }
            let centre = median(&mut around);
            let mut spread: Vec<f64> = around.iter().map(|r| (r - centre).abs()).collect();
            Some((centre, 1.4826 * median(&mut spread)))
        })
        .collect()
}

/// Residuals of the distances after a small rigid motion between the two sightings (three shifts, three turns),
/// robust (Huber), lightly held at zero where the surfaces do not determine it.
fn residuals_about_a_rigid_motion(distances: &[Distance]) -> Vec<f64> {
    #[allow(clippy::cast_precision_loss)]
    let centre = distances.iter().map(|d| d.point_m).sum::<Vector3<f64>>() / distances.len() as f64;
    let reach = distances.iter().map(|d| (d.point_m - centre).norm()).fold(1.0, f64::max);
    let row = |d: &Distance| {
        let turn = (d.point_m - centre).cross(&d.normal) / reach;
        Vector6::new(d.normal.x, d.normal.y, d.normal.z, turn.x, turn.y, turn.z)
    };
    let mut residuals: Vec<f64> = distances.iter().map(|d| d.distance_m).collect();
    for _ in 0..10 {
        let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
        let sigma = (1.4826 * median(&mut sizes)).max(1e-4);
        let (mut normal, mut right) = (Matrix6::identity() * 1e-3, Vector6::zeros());
        for (d, r) in distances.iter().zip(&residuals) {
            let t = r.abs() / sigma;
            let weight = if t > 8.0 { 0.0 } else { (1.5 / t.max(1e-9)).min(1.0) };
            let a = row(d);
            normal += a * a.transpose() * weight;
            right += a * (d.distance_m * weight);
        }
        let Some(motion) = normal.cholesky().map(|c| c.solve(&right)) else { break };
        for (d, r) in distances.iter().zip(&mut residuals) {
            *r = d.distance_m - row(d).dot(&motion);
        }
    }
    residuals
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface_line::End;

    fn end(strip: u32, place: [f64; 2], height_m: f64) -> End {
        let patch = Patch {
            sighting: Sighting { strip, pass: 0, scanner: 0 },
            time_s: 0.0,
            centroid_m: Vector3::new(place[0], place[1], height_m),
            normal: Vector3::z(),
            long_axis: Vector3::x(),
            spread_m: [0.5, 0.5],
            roughness_m: 0.01,
            points: 30,
            intensity: 0.0,
        };
        End { patch, rejection: None }
    }

    fn field(raised: impl Fn(i32, i32) -> f64) -> Vec<SurfaceLine> {
        (0..20)
            .flat_map(|i| (0..20).map(move |j| (i, j)))
            .map(|(i, j)| {
                let place = [f64::from(i) * 2.0, f64::from(j) * 2.0];
                // 5 cm apart and tilted by 1 mm a metre, a millimetre of noise
                let apart = 0.05 + 0.001 * place[0] + 0.001 * f64::from((i * 7 + j * 13) % 5 - 2);
                SurfaceLine { ends: vec![end(0, place, 0.0), end(1, place, apart + raised(i, j))] }
            })
            .collect()
    }

    #[test]
    fn a_tilted_pair_keeps_its_ties_and_loses_the_one_that_does_not_fit() {
        let mut lines = field(|i, j| if (i, j) == (3, 4) { 0.3 } else { 0.0 });
        reject_by_distance(&mut lines, Clone::clone, &RejectOptions::default());
        let lost: Vec<usize> = (0..lines.len()).filter(|k| !lines[*k].is_tie()).collect();
        assert_eq!(lost, vec![3 * 20 + 4]);
    }

    #[test]
    fn neighbours_that_deviate_together_are_left_to_the_adjustment() {
        let mut lines = field(|i, j| if i < 4 && j < 4 { 0.13 } else { 0.0 });
        reject_by_distance(&mut lines, Clone::clone, &RejectOptions::default());
        assert!(lines[20 + 1].is_tie());
    }

    #[test]
    fn a_change_within_the_pair_limit_is_found_by_the_neighbours() {
        let mut lines = field(|i, j| if (i, j) == (9, 9) { 0.025 } else { 0.0 });
        reject_by_distance(&mut lines, Clone::clone, &RejectOptions::default());
        assert_eq!(lines[9 * 20 + 9].ends[1].rejection, Some(Rejection::ChangeOfSurface));
    }
}
