//! Selection of ties to a budget by what they tell, and the choice of those held out.
//!
//! Ties are sorted into strata: direction of the normal, pair of sightings, time in the strip, side of the strip.
//! Strata are served in turn, each giving its most informative tie first: information (Σ 1/σ²) times leverage
//! (how much a tie adds to the shifts and turns that all of them together determine, Glira 2015). So the few
//! oblique roofs that carry planimetry, and the rare pairs, are never crowded out by a car park.

use std::collections::BTreeMap;

use nalgebra::{Matrix6, Vector3, Vector6};
use rstar::{RTree, primitives::GeomWithData};

use crate::patch::Patch;
use crate::sketch::mix;
use crate::surface_line::SurfaceLine;

/// Direction of a normal in 1 + 3 × 8 bins: level, then slope by azimuth.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub fn normal_bin(normal: &Vector3<f64>) -> u8 {
    let slope_deg = normal.z.abs().min(1.0).acos().to_degrees();
    if slope_deg < 8.0 {
        return 0;
    }
    let steepness = if slope_deg < 30.0 {
        0
    } else if slope_deg < 65.0 {
        1
    } else {
        2
    };
    let azimuth = normal.x.atan2(normal.y).rem_euclid(std::f64::consts::TAU);
    1 + steepness * 8 + ((azimuth / std::f64::consts::TAU * 8.0) as u8).min(7)
}

/// Least spacing of ties that are kept.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Spacing {
    /// In space \[m\]; 0: none.
    pub distance_m: f64,
    /// In time, between ties of one strip \[s\]; 0: none.
    pub time_s: f64,
}

fn information(line: &SurfaceLine) -> f64 {
    line.used().map(|(_, p)| 1.0 / (p.roughness_m.powi(2) / f64::from(p.points) + 1e-6)).sum()
}

fn seed(line: &SurfaceLine) -> Option<&Patch> {
    line.used().map(|(_, p)| p).max_by_key(|p| p.points)
}

/// Indices of the ties kept, in their order. Lines that are no tie are never kept.
///
/// `span_of` gives first and last time of a strip \[s\].
#[must_use]
pub fn select(
    lines: &[SurfaceLine],
    budget: usize,
    spacing: Spacing,
    span_of: impl Fn(u32) -> (f64, f64),
) -> Vec<usize> {
    let ties: Vec<(usize, &Patch)> =
        lines.iter().enumerate().filter(|(_, l)| l.is_tie()).filter_map(|(i, l)| Some((i, seed(l)?))).collect();
    let scores = scores(lines, &ties);
    let mut strata: BTreeMap<Stratum, Vec<(f64, usize)>> = BTreeMap::new();
    for ((i, patch), score) in ties.iter().zip(scores) {
        strata.entry(stratum(&lines[*i], patch, &span_of)).or_default().push((score, *i));
    }
    for rows in strata.values_mut() {
        rows.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    }
    let deepest = strata.values().map(Vec::len).max().unwrap_or(0);
    let mut kept = Kept { spacing, places: RTree::new(), times: BTreeMap::new(), lines: Vec::new() };
    for rank in 0..deepest {
        for rows in strata.values() {
            if kept.lines.len() >= budget {
                break;
            }
            if let Some((_, i)) = rows.get(rank) {
                kept.offer(*i, &lines[*i]);
            }
        }
    }
    kept.lines.sort_unstable();
    kept.lines
}

type Stratum = (u8, Vec<(u32, u16)>, u8, u8);

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn stratum(line: &SurfaceLine, patch: &Patch, span_of: &impl Fn(u32) -> (f64, f64)) -> Stratum {
    let mut sightings: Vec<(u32, u16)> = line.used().map(|(_, p)| (p.sighting.strip, p.sighting.scanner)).collect();
    sightings.sort_unstable();
    // a pair, not the whole set: sets are too many in blocks of many strips
    sightings.truncate(2);
    let (start_s, end_s) = span_of(patch.sighting.strip);
    let in_time = ((patch.time_s - start_s) / (end_s - start_s).max(1e-3) * 10.0).clamp(0.0, 9.0) as u8;
    let checker = |v: f64| (v / 50.0).floor().rem_euclid(4.0) as u8;
    (normal_bin(&patch.normal), sightings, in_time, checker(patch.centroid_m.x) * 4 + checker(patch.centroid_m.y))
}

/// Information times leverage of each tie.
fn scores(lines: &[SurfaceLine], ties: &[(usize, &Patch)]) -> Vec<f64> {
    #[allow(clippy::cast_precision_loss)]
    let centre = ties.iter().map(|(_, p)| p.centroid_m).sum::<Vector3<f64>>() / ties.len().max(1) as f64;
    let reach = ties.iter().map(|(_, p)| (p.centroid_m - centre).norm()).fold(1.0, f64::max);
    let row = |p: &Patch| {
        let turn = (p.centroid_m - centre).cross(&p.normal) / reach;
        Vector6::new(p.normal.x, p.normal.y, p.normal.z, turn.x, turn.y, turn.z)
    };
    let mut normal = Matrix6::identity() * 1e-6;
    for (_, p) in ties {
        let a = row(p);
        normal += a * a.transpose();
    }
    let inverse = normal.try_inverse().unwrap_or_else(Matrix6::identity);
    ties.iter()
        .map(|(i, p)| {
            let a = row(p);
            information(&lines[*i]) * (a.transpose() * inverse * a)[(0, 0)]
        })
        .collect()
}

struct Kept {
    spacing: Spacing,
    places: RTree<GeomWithData<[f64; 3], usize>>,
    times: BTreeMap<u32, Vec<f64>>,
    lines: Vec<usize>,
}

impl Kept {
    fn offer(&mut self, i: usize, line: &SurfaceLine) {
        let Some(patch) = seed(line) else { return };
        let place: [f64; 3] = patch.centroid_m.into();
        if self.spacing.distance_m > 0.0 {
            let near = self.places.nearest_neighbor(place);
            let square = |a: &[f64; 3]| (0..3).map(|k| (a[k] - place[k]).powi(2)).sum::<f64>();
            if near.is_some_and(|n| square(n.geom()) < self.spacing.distance_m.powi(2)) {
                return;
            }
        }
        if self.spacing.time_s > 0.0 {
            let times = self.times.entry(patch.sighting.strip).or_default();
            let at = times.partition_point(|t| *t < patch.time_s);
            let close = |k: Option<usize>| {
                k.and_then(|k| times.get(k)).is_some_and(|t| (t - patch.time_s).abs() < self.spacing.time_s)
            };
            if close(Some(at)) || close(at.checked_sub(1)) {
                return;
            }
            times.insert(at, patch.time_s);
        }
        self.places.insert(GeomWithData::new(place, i));
        self.lines.push(i);
    }
}

/// Whether a tie is held out: by its place, in squares of `place_m`, by a seeded hash. Neighbours share their fate,
/// so that held-out ties judge the solution where it has no ties of its own.
#[must_use]
pub fn is_held_out(line: &SurfaceLine, seed_number: u64, share: f64, place_m: f64) -> bool {
    seed(line).is_some_and(|p| is_place_held_out([p.centroid_m.x, p.centroid_m.y], seed_number, share, place_m))
}

/// Whether the square of a place \[m\] is one of those held out.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss, clippy::cast_sign_loss)]
pub fn is_place_held_out(plan_m: [f64; 2], seed_number: u64, share: f64, place_m: f64) -> bool {
    let square = |v: f64| (v / place_m).floor() as i64 as u64;
    let hash = mix(mix(square(plan_m[0]) ^ seed_number.rotate_left(32)) ^ square(plan_m[1]));
    (hash as f64 / u64::MAX as f64) < share
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patch::Sighting;
    use crate::surface_line::End;

    fn line(x: f64, normal: [f64; 3], points: u32) -> SurfaceLine {
        let patch = |strip| Patch {
            sighting: Sighting { strip, pass: 0, scanner: 0 },
            time_s: x,
            centroid_m: Vector3::new(x, 0.0, 0.0),
            normal: Vector3::from(normal).normalize(),
            long_axis: Vector3::y(),
            spread_m: [0.5, 0.5],
            roughness_m: 0.02,
            points,
            intensity: 0.0,
        };
        SurfaceLine { ends: vec![End { patch: patch(0), rejection: None }, End { patch: patch(1), rejection: None }] }
    }

    #[test]
    fn a_lonely_roof_is_kept_among_many_level_patches() {
        let mut lines: Vec<SurfaceLine> = (0..500).map(|k| line(f64::from(k) * 0.1, [0.0, 0.0, 1.0], 90)).collect();
        lines.push(line(3.0, [0.7, 0.0, 0.7], 9));
        let kept = select(&lines, 20, Spacing::default(), |_| (0.0, 100.0));
        assert_eq!(kept.len(), 20);
        assert!(kept.contains(&500));
    }

    #[test]
    fn least_spacing_is_kept_in_space_and_time() {
        let lines: Vec<SurfaceLine> = (0..100).map(|k| line(f64::from(k), [0.0, 0.0, 1.0], 90)).collect();
        let far = Spacing { distance_m: 9.5, time_s: 0.0 };
        assert!(select(&lines, 1000, far, |_| (0.0, 100.0)).windows(2).all(|w| w[1] - w[0] >= 10));
        let late = Spacing { distance_m: 0.0, time_s: 4.5 };
        assert!(select(&lines, 1000, late, |_| (0.0, 100.0)).windows(2).all(|w| w[1] - w[0] >= 5));
    }

    #[test]
    fn about_the_share_asked_for_is_held_out_and_by_place() {
        let held = |x: f64| is_held_out(&line(x, [0.0, 0.0, 1.0], 9), 1, 0.2, 10.0);
        let count = (0..1000).filter(|k| held(f64::from(*k) * 10.0)).count();
        assert!((150..250).contains(&count), "{count}");
        assert_eq!(held(12.0), held(17.0));
    }
}
