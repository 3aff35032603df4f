//! Ties measured again on the corrected cloud, without another look at its points.
//!
//! A patch is of a moment, and a correction changes slowly: it moves its points like a rigid body. So the patches of the first measurement are moved
//! by the difference of the trajectories and the calibration of their scanner, paired anew where they come to lie, and tested for
//! agreement as before. Where the trajectory that the strips were made with was wrong by more than patches are searched for, lines appear
//! that were not seen before; where it was wrong by a part of a patch, ends that are not of one place part, and features come to lie where
//! footprints do overlap.
//!
//! For the smoother a feature goes back along the motion of its patch, to where the cloud as delivered has it: its body vector is that of
//! the points as they were measured, and holds nothing of either trajectory.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tieline_filter::Trajectory;
use tieline_matching::{End, Patch, RowEnd, Sighting, SurfaceLine, is_held_out, line_of, pair_rows};

use super::constants::Constants;
use super::correction::DriveCorrection;
use super::motion::Motion;
use super::ties::beam_of;
use crate::job::Matched;
use crate::stage::ties::{CONTROL_STRIP, Ties, reject_and_select};

/// What it changed to measure again.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Gain {
    /// How often ties were measured again.
    pub times: usize,
    /// Pairs of patches in selected lines, before and after.
    pub pairs_before: usize,
    /// After.
    pub pairs_after: usize,
    /// Pairs after that were none before.
    pub pairs_gained: usize,
    /// Pairs before that are none after.
    pub pairs_lost: usize,
    /// Farthest that a patch moved \[m\].
    pub largest_motion_m: f64,
    /// Farthest that the sightings of a pair moved against each other \[m\].
    pub largest_parting_m: f64,
}

impl Gain {
    /// What there is to say.
    #[must_use]
    pub fn note(&self) -> String {
        format!(
            "ties measured again on the corrected cloud{}: {} pairs of patches instead of {}, {} gained and {} lost; patches moved by up to {:.3} m, those of a pair against each other by up to {:.3} m",
            if self.times > 1 { format!(", {} times", self.times) } else { String::new() },
            self.pairs_after,
            self.pairs_before,
            self.pairs_gained,
            self.pairs_lost,
            self.largest_motion_m,
            self.largest_parting_m
        )
    }
}

/// Ties of the corrected cloud.
#[derive(Debug)]
pub struct MeasuredAgain {
    /// Lines of patches as the cloud was delivered, paired as the corrected one says.
    pub ties: Ties,
    /// How the patch of each end of each line moves.
    pub motions: Vec<Vec<Motion>>,
    /// What changed against the first measurement.
    pub gain: Gain,
    /// Pairs of used patches of the selected lines of the first measurement and of this one, as rows of all patches.
    pairs: [Pairs; 2],
}

impl MeasuredAgain {
    /// Pairs that came or went since the measurement before, over all; the first where there is none before.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn changed(&self, before: Option<&Self>) -> f64 {
        let [first, now] = &self.pairs;
        let before = before.map_or(first, |b| &b.pairs[1]);
        now.symmetric_difference(before).count() as f64 / now.len().max(1) as f64
    }
}

/// What tells a patch from all others: who saw it, and the bits of time and place.
type Key = (Sighting, u64, [u64; 3]);

fn key(patch: &Patch) -> Key {
    let [x, y, z] = [patch.centroid_m.x, patch.centroid_m.y, patch.centroid_m.z].map(f64::to_bits);
    (patch.sighting, patch.time_s.to_bits(), [x, y, z])
}

/// Pairs of rows of patches.
type Pairs = BTreeSet<(usize, usize)>;

/// Pairs of used patches of selected lines, given as rows of their patches.
fn pairs<'a>(lines: impl Iterator<Item = &'a Vec<RowEnd>>) -> Pairs {
    let mut pairs = Vec::new();
    for ends in lines {
        let rows: Vec<usize> = ends.iter().filter(|end| end.1.is_none()).map(|end| end.0).collect();
        for (k, a) in rows.iter().enumerate() {
            pairs.extend(rows[k + 1..].iter().map(|b| (*a.min(b), *a.max(b))));
        }
    }
    pairs.into_iter().collect()
}

/// Patches of a first measurement, and its lines as rows of them.
struct Patches<'a> {
    all: Vec<&'a Patch>,
    lines: Vec<Vec<RowEnd>>,
}

impl<'a> Patches<'a> {
    fn of(ties: &'a Ties) -> Self {
        let mut row_of: HashMap<Key, usize> = HashMap::new();
        let mut all = Vec::new();
        let mut row = |patch: &'a Patch| {
            *row_of.entry(key(patch)).or_insert_with(|| {
                all.push(patch);
                all.len() - 1
            })
        };
        let lines = ties.lines.iter().map(|l| l.ends.iter().map(|e| (row(&e.patch), e.rejection)).collect()).collect();
        ties.lone.iter().for_each(|patch| {
            row(patch);
        });
        Self { all, lines }
    }
}

/// Measures the ties of a survey again as a correction moves its patches. `trajectory` is that which the strips were made with; of `constants`
/// the mountings of the scanners are taken.
#[must_use]
pub fn measure_again(
    matched: &Matched,
    trajectory: &Trajectory,
    constants: &Constants,
    correction: &DriveCorrection,
) -> MeasuredAgain {
    let origin_m = matched.survey.origin();
    let first = &matched.ties;
    let patches = Patches::of(first);
    let motion_of = |patch: &&Patch| -> Option<Motion> {
        if patch.sighting.strip == CONTROL_STRIP {
            return Some(Motion::NONE);
        }
        let centroid_m = patch.centroid_m + origin_m;
        let (pose, beam) = beam_of(trajectory, constants, patch, &centroid_m, &centroid_m)?;
        let moved = correction.moved(&pose, &beam)?;
        let longer_m = |ray_m: &Vector3<f64>, range_m: f64| correction.longer_m(&beam, ray_m, range_m);
        Motion::new(patch, &moved, &beam.patch.rays_m, &origin_m, longer_m)
    };
    let motions: Vec<Option<Motion>> = patches.all.par_iter().map(motion_of).collect();
    // rows of patches that can be moved, and the patches where they come to lie
    let (rows, mut moved): (Vec<usize>, Vec<Patch>) = motions
        .iter()
        .enumerate()
        .filter_map(|(row, motion)| Some((row, motion.as_ref()?.patch(patches.all[row]))))
        .unzip();
    let tiles = tiles(&mut moved, matched.grouping.tile_m);
    let found: Vec<(Vec<RowEnd>, SurfaceLine)> = tiles
        .par_iter()
        .flat_map(|of_tile| {
            let mine: Vec<Patch> = of_tile.iter().map(|k| moved[*k].clone()).collect();
            let lines = pair_rows(&mine, &matched.grouping.pairing);
            let line = |ends: Vec<RowEnd>| {
                let line = line_of(&mine, &ends);
                (ends.into_iter().map(|(k, why)| (rows[of_tile[k]], why)).collect(), line)
            };
            lines.into_iter().map(line).collect::<Vec<_>>()
        })
        .collect();
    let (mut ends, mut lines): (Vec<Vec<RowEnd>>, Vec<SurfaceLine>) = found.into_iter().unzip();
    let selected = reject_and_select(&mut lines, &matched.strips, &matched.grouping);
    for (ends, line) in ends.iter_mut().zip(&lines) {
        ends.iter_mut().zip(&line.ends).for_each(|(end, judged)| end.1 = judged.rejection);
    }
    let end = |(row, rejection): &RowEnd| End { patch: patches.all[*row].clone(), rejection: *rejection };
    let mut ties = Ties {
        lines: ends.iter().map(|ends| SurfaceLine { ends: ends.iter().map(end).collect() }).collect(),
        patches: first.patches,
        found: lines.iter().filter(|l| l.is_tie()).count() as u64,
        ..Ties::default()
    };
    for reason in ties.lines.iter().flat_map(|l| &l.ends).filter_map(|e| e.rejection) {
        *ties.rejected.entry(reason.as_str().to_string()).or_default() += 1;
    }
    let parts = parts(first, &patches);
    for row in selected {
        if let Some(held_out) = holds(&ties.lines[row], &ends[row], &parts, matched) {
            ties.selected.push(row);
            ties.held_out.push(held_out);
        }
    }
    let before = pairs(first.selected.iter().map(|row| &patches.lines[*row]));
    let after = pairs(ties.selected.iter().map(|row| &ends[*row]));
    let gain = gain(&before, &after, &motions);
    let of_line = |ends: &Vec<RowEnd>| ends.iter().map(|(row, _)| motions[*row].unwrap_or(Motion::NONE)).collect();
    MeasuredAgain { motions: ends.iter().map(of_line).collect(), ties, gain, pairs: [before, after] }
}

fn gain(before: &Pairs, after: &Pairs, motions: &[Option<Motion>]) -> Gain {
    let shift = |row: &usize| motions[*row].map_or_else(Vector3::zeros, |m| m.shift_m());
    Gain {
        times: 1,
        pairs_before: before.len(),
        pairs_after: after.len(),
        pairs_gained: after.difference(before).count(),
        pairs_lost: before.difference(after).count(),
        largest_motion_m: motions.iter().flatten().map(|m| m.shift_m().norm()).fold(0.0, f64::max),
        largest_parting_m: after.iter().map(|(a, b)| (shift(a) - shift(b)).norm()).fold(0.0, f64::max),
    }
}

/// Rows of the patches of each tile, in order of tile and row. Visits are numbered anew within each: two patches that one scanner saw more than a
/// moment apart are two sightings, whatever their cells counted before.
#[allow(clippy::cast_possible_truncation)] // tiles of a survey, visits of a tile
fn tiles(moved: &mut [Patch], tile_m: f64) -> Vec<Vec<usize>> {
    /// Without sight of a tile for so long, the next is another visit \[s\].
    const GAP_S: f64 = 1.5;
    let mut tiles: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (row, patch) in moved.iter().enumerate() {
        let place = [patch.centroid_m.x, patch.centroid_m.y].map(|v| (v / tile_m.max(1.0)).floor() as i64);
        tiles.entry(place).or_default().push(row);
    }
    for rows in tiles.values() {
        let mut by_source: BTreeMap<(u32, u16), Vec<usize>> = BTreeMap::new();
        for row in rows {
            let sighting = moved[*row].sighting;
            by_source.entry((sighting.strip, sighting.scanner)).or_default().push(*row);
        }
        for mut of_source in by_source.into_values() {
            of_source.sort_by(|a, b| moved[*a].time_s.total_cmp(&moved[*b].time_s).then(a.cmp(b)));
            let (mut pass, mut last_s) = (0, f64::INFINITY);
            for row in of_source {
                let patch = &mut moved[row];
                pass += u16::from(patch.time_s - last_s > GAP_S);
                last_s = patch.time_s;
                patch.sighting.pass = pass;
            }
        }
    }
    tiles.into_values().collect()
}

/// What a patch did in the first adjustment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    /// Nothing.
    None,
    /// It made it.
    Used,
    /// It judged it.
    HeldOut,
}

/// What each patch did.
fn parts(first: &Ties, patches: &Patches<'_>) -> Vec<Part> {
    let mut parts = vec![Part::None; patches.all.len()];
    for (line, held_out) in first.selected.iter().zip(&first.held_out) {
        for (row, _) in patches.lines[*line].iter().filter(|end| end.1.is_none()) {
            parts[*row] = if *held_out { Part::HeldOut } else { Part::Used };
        }
    }
    parts
}

/// Whether a line is held out: as its patches were, else by its place. None where some made the adjustment and others judged it: such a line can
/// do neither.
fn holds(line: &SurfaceLine, ends: &[RowEnd], parts: &[Part], matched: &Matched) -> Option<bool> {
    let any = |part: Part| ends.iter().any(|end| end.1.is_none() && parts[end.0] == part);
    match (any(Part::HeldOut), any(Part::Used)) {
        (true, true) => None,
        (true, false) => Some(true),
        (false, true) => Some(false),
        (false, false) => {
            let grouping = &matched.grouping;
            let known = line.used().any(|(_, p)| p.sighting.strip == CONTROL_STRIP);
            Some(!known && is_held_out(line, grouping.seed, grouping.hold_out, grouping.place_m))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::motion::tests::patch;
    use super::*;

    #[test]
    fn visits_of_a_tile_are_told_apart_by_time_whatever_their_cells_counted() {
        let mut moved =
            vec![patch(0, 10.0, [1.0, 1.0, 0.0]), patch(0, 70.0, [3.0, 1.0, 0.0]), patch(0, 10.9, [5.0, 1.0, 0.0])];
        moved.push(patch(1, 10.2, [1.0, 1.0, 0.0]));
        moved.push(patch(0, 70.0, [33.0, 1.0, 0.0]));
        assert_eq!(tiles(&mut moved, 16.0), [vec![0, 1, 2, 3], vec![4]]);
        let passes: Vec<u16> = moved.iter().map(|p| p.sighting.pass).collect();
        assert_eq!(passes, [0, 1, 0, 0, 0]);
    }

    #[test]
    fn gains_and_losses_are_counted_by_pairs() {
        let motion = |x: f64| Some(Motion::shifted(Vector3::new(x, 0.0, 0.0)));
        let motions = [motion(0.0), motion(0.3), motion(-0.1), None];
        let set = |of: &[(usize, usize)]| of.iter().copied().collect::<BTreeSet<_>>();
        let found = gain(&set(&[(0, 1), (0, 3)]), &set(&[(0, 1), (1, 2)]), &motions);
        assert_eq!((found.pairs_before, found.pairs_after, found.pairs_gained, found.pairs_lost), (2, 2, 1, 1));
        assert!((found.largest_motion_m - 0.3).abs() < 1e-12 && (found.largest_parting_m - 0.4).abs() < 1e-12);
        assert!(found.note().contains("1 gained and 1 lost"), "{}", found.note());
    }
}
