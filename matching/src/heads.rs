//! Planes that two scanners of one platform have in common.

use std::collections::BTreeMap;

use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

use crate::patch::Patch;
use crate::surface_line::{PairingOptions, Rejection, bounds, compare};

/// How far two patches of one surface may lie apart, given how well the mounting is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    /// Along the normal \[m\].
    pub distance_m: f64,
    /// Between the normals, beyond what their sigmas explain \[rad\].
    pub angle_rad: f64,
}

/// Pairs of patches that two scanners have in common, and how many candidates were refused and why.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HeadPairs {
    /// Rows of the first and of the second scanner's patches.
    pub pairs: Vec<(usize, usize)>,
    /// Patches of the first scanner that overlap one of the second's and became no pair, by the reason of the nearest.
    pub refused: BTreeMap<Rejection, usize>,
}

/// Pairs the patches of two scanners, in one frame: each patch joins one pair at most, those that share the largest
/// area first. `gate` gives the limits of a candidate.
#[must_use]
pub fn pair_heads(a: &[Patch], b: &[Patch], reach_m: f64, gate: impl Fn(&Patch, &Patch) -> Gate) -> HeadPairs {
    let boxed = |(row, patch): (usize, &Patch)| {
        let (low, high) = bounds(patch, 0.0);
        GeomWithData::new(Rectangle::from_corners(low, high), row)
    };
    let tree = RTree::bulk_load(b.iter().enumerate().map(boxed).collect());
    let mut candidates: Vec<(f64, usize, usize)> = Vec::new();
    let mut nearest: BTreeMap<usize, (f64, Rejection)> = BTreeMap::new();
    for (i, patch) in a.iter().enumerate() {
        let (low, high) = bounds(patch, reach_m);
        for found in tree.locate_in_envelope_intersecting(AABB::from_corners(low, high)) {
            let other = &b[found.data];
            let limits = gate(patch, other);
            let options = PairingOptions {
                search_m: limits.distance_m,
                normal_angle_rad: limits.angle_rad,
                ..PairingOptions::default()
            };
            match compare(patch, other, &options) {
                Ok(overlap) => candidates.push((overlap * area_m2(patch).min(area_m2(other)), i, found.data)),
                Err(Rejection::Overlap) => {}
                Err(reason) => {
                    let distance = (other.centroid_m - patch.centroid_m).norm();
                    let entry = nearest.entry(i).or_insert((distance, reason));
                    if distance < entry.0 {
                        *entry = (distance, reason);
                    }
                }
            }
        }
    }
    candidates.sort_by(|p, q| q.0.total_cmp(&p.0).then((p.1, p.2).cmp(&(q.1, q.2))));
    let (mut of_a, mut of_b) = (vec![false; a.len()], vec![false; b.len()]);
    let mut result = HeadPairs::default();
    for (_, i, j) in candidates {
        if !of_a[i] && !of_b[j] {
            (of_a[i], of_b[j]) = (true, true);
            result.pairs.push((i, j));
        }
    }
    result.pairs.sort_unstable();
    for (_, reason) in nearest.iter().filter(|(i, _)| !of_a[**i]).map(|(_, v)| v) {
        *result.refused.entry(*reason).or_default() += 1;
    }
    result
}

fn area_m2(patch: &Patch) -> f64 {
    let [a, b] = patch.half_extent_m();
    4.0 * a * b
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::patch::Sighting;

    fn patch(scanner: u16, x: f64, z: f64, spread_m: f64) -> Patch {
        Patch {
            sighting: Sighting { strip: 0, pass: 0, scanner },
            time_s: 0.0,
            centroid_m: Vector3::new(x, 0.0, z),
            normal: Vector3::z(),
            long_axis: Vector3::x(),
            spread_m: [spread_m, spread_m],
            roughness_m: 0.01,
            points: 50,
            intensity: 0.0,
        }
    }

    fn gate(distance_m: f64) -> impl Fn(&Patch, &Patch) -> Gate {
        move |_, _| Gate { distance_m, angle_rad: 0.05 }
    }

    #[test]
    fn a_patch_joins_the_one_that_shares_most_with_it() {
        let a = [patch(0, 0.0, 0.0, 0.5)];
        let b = [patch(1, 0.6, 0.02, 0.5), patch(1, 0.1, 0.03, 0.5)];
        assert_eq!(pair_heads(&a, &b, 0.5, gate(0.1)).pairs, [(0, 1)]);
    }

    #[test]
    fn planes_further_apart_than_the_gate_are_counted_as_refused() {
        let (a, b) = ([patch(0, 0.0, 0.0, 0.5)], [patch(1, 0.0, 0.3, 0.5)]);
        let found = pair_heads(&a, &b, 0.5, gate(0.1));
        assert!(found.pairs.is_empty() && found.refused[&Rejection::Distance] == 1);
        assert_eq!(pair_heads(&a, &b, 0.5, gate(0.4)).pairs.len(), 1);
    }

    #[test]
    fn footprints_that_only_touch_are_not_common() {
        let (a, b) = ([patch(0, 0.0, 0.0, 0.3)], [patch(1, 1.0, 0.0, 0.3)]);
        assert!(pair_heads(&a, &b, 1.0, gate(1.0)).pairs.is_empty());
    }
}
