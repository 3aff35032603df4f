//! Which patches judge the calibration: chosen by place before anything is adjusted.
//!
//! Space is cut into squares, each either used or held out, so that all patches of a place share their fate, whichever
//! scanner saw them: no point of a held-out plane takes part in the adjustment. Ground and walls are dealt out apart,
//! so that a fifth of each is held out.

use std::collections::BTreeMap;

use tieline_matching::{Patch, mix};

use super::StationOptions;
use super::pairs::Slope;

/// Width of the squares \[m\]: of ground, and of what stands (walls are long).
const SQUARE_M: [f64; 2] = [5.0, 10.0];

/// Place of a patch: station, ground or not, square.
type Square = (usize, usize, i64, i64);

#[allow(clippy::cast_possible_truncation)]
fn square(station: usize, patch: &Patch) -> Square {
    let kind = usize::from(Slope::of(&patch.normal) != Slope::Level);
    let index = |v: f64| (v / SQUARE_M[kind]).floor() as i64;
    (station, kind, index(patch.centroid_m.x), index(patch.centroid_m.y))
}

#[allow(clippy::cast_sign_loss)]
fn hash(square: &Square, seed: u64) -> u64 {
    let part = |h: u64, v: u64| mix(h ^ v.wrapping_add(0x9e37_79b9_7f4a_7c15));
    let (station, kind, x, y) = *square;
    part(part(part(part(seed, station as u64), kind as u64), x as u64), y as u64)
}

/// For every station, scanner and patch (body frame, rough mounting): whether it is held out.
///
/// Squares are taken in the order of a seeded hash until they hold the asked share of the patches of the calibrated
/// scanners, level ones and others apart.
#[must_use]
#[allow(clippy::cast_precision_loss)]
pub fn held_out(patches: &[Vec<Vec<Patch>>], reference: usize, options: &StationOptions) -> Vec<Vec<Vec<bool>>> {
    let mut counts: BTreeMap<Square, usize> = BTreeMap::new();
    for (station, heads) in patches.iter().enumerate() {
        for (_, of_head) in heads.iter().enumerate().filter(|(head, _)| *head != reference) {
            for patch in of_head {
                *counts.entry(square(station, patch)).or_default() += 1;
            }
        }
    }
    let mut held = std::collections::BTreeSet::new();
    for kind in 0..2 {
        let mut squares: Vec<(u64, Square, usize)> =
            counts.iter().filter(|(s, _)| s.1 == kind).map(|(s, n)| (hash(s, options.seed), *s, *n)).collect();
        squares.sort_unstable();
        let wanted = options.hold_out * squares.iter().map(|s| s.2).sum::<usize>() as f64;
        let mut taken = 0.0;
        for (_, square, n) in squares {
            // a square is taken when that comes nearer to the share than leaving it
            if taken + 0.5 * n as f64 <= wanted {
                taken += n as f64;
                held.insert(square);
            }
        }
    }
    let fate = |station: usize, patch: &Patch| held.contains(&square(station, patch));
    patches
        .iter()
        .enumerate()
        .map(|(station, heads)| {
            heads.iter().map(|of_head| of_head.iter().map(|patch| fate(station, patch)).collect()).collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use tieline_matching::Sighting;

    use super::*;

    fn patch(x: f64, y: f64, wall: bool) -> Patch {
        Patch {
            sighting: Sighting { strip: 0, pass: 0, scanner: 0 },
            time_s: 0.0,
            centroid_m: Vector3::new(x, y, 0.0),
            normal: if wall { Vector3::x() } else { Vector3::z() },
            long_axis: Vector3::y(),
            spread_m: [0.3, 0.3],
            roughness_m: 0.01,
            points: 20,
            intensity: 0.0,
        }
    }

    #[test]
    fn a_fifth_of_ground_and_of_walls_is_held_out_by_place() {
        let ground = (0..900).map(|k| patch(f64::from(k % 30) + 0.1, f64::from(k / 30) + 0.1, false));
        let walls = (0..400).map(|k| patch(f64::from(k % 20) * 5.0, f64::from(k / 20) * 5.0, true));
        let all: Vec<Patch> = ground.chain(walls).collect();
        let patches = vec![vec![all.clone(), all.clone()]];
        let held = held_out(&patches, 0, &StationOptions::default());
        for wall in [false, true] {
            let fates: Vec<bool> =
                (0..all.len()).filter(|i| (all[*i].normal.x > 0.5) == wall).map(|i| held[0][1][i]).collect();
            let share = fates.iter().filter(|h| **h).count() as f64 / fates.len() as f64;
            assert!((share - 0.2).abs() < 0.03, "{share}");
        }
        assert_eq!(held[0][0], held[0][1], "the same place has the same fate for every scanner");
        let other = held_out(&patches, 0, &StationOptions { seed: 2, ..StationOptions::default() });
        assert_ne!(held, other);
    }
}
