//! Corners and ridges of a survey: found in the sloped and steep patches of each sighting, matched pair by pair.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rayon::prelude::*;
use tieline_matching::xyz::{
    Corner, CornerOptions, Edge, NotTied, Ridge, TileChoice, corners, match_corners, match_ridges, ridges,
};
use tieline_matching::{CONTROL_FILE, Patch, Sighting, StripIndex, normal_bin};

use super::{Direction, Part, PlaceKind, PlaceTie, Places};
use crate::project::XyzWord;
use crate::settings::Settings;

/// Tiles of the grid along one edge of the squares that patches are drawn in.
const SQUARE_TILES: f64 = 4.0;
/// Tiles whose patches are all looked at; of larger surveys squares are drawn.
const MOST_TILES: f64 = 2_000.0;
/// Most patches that are kept: some hundred bytes each.
const MOST_PATCHES: usize = 600_000;

/// Sloped and steep patches of a survey, all of them or those of squares drawn by a hash of their place.
#[derive(Debug)]
pub struct FacePatches {
    choice: TileChoice,
    patches: Vec<Patch>,
}

impl FacePatches {
    /// Room for the patches of a survey of so many tiles; `None` when corners are not asked for.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn new(settings: &Settings, tiles: usize) -> Option<Self> {
        if settings.is_drive || !settings.xyz.contains(&XyzWord::Corner) {
            return None;
        }
        let choice = TileChoice {
            tile_m: SQUARE_TILES * 32.0 * settings.grid.cell_m(),
            margin_m: 0.0,
            share: (MOST_TILES / tiles.max(1) as f64).min(1.0),
        };
        Some(Self { choice, patches: Vec::new() })
    }

    /// Whether patches at a place \[m\] are looked at.
    #[must_use]
    #[allow(clippy::cast_possible_truncation)] // squares of a survey
    pub fn takes(&self, [east_m, north_m]: [f64; 2]) -> bool {
        let square = |v: f64| (v / self.choice.tile_m).floor() as i32;
        self.choice.takes((square(east_m), square(north_m)))
    }

    /// Those of some patches that lie aslant, where they are looked at.
    #[must_use]
    pub fn of(&self, patches: &[Patch]) -> Vec<Patch> {
        let wanted = |p: &&Patch| normal_bin(&p.normal) != 0 && self.takes([p.centroid_m.x, p.centroid_m.y]);
        patches.iter().filter(wanted).cloned().collect()
    }

    /// Keeps patches; where they become too many, half of the squares go, whatever order they came in.
    pub fn keep(&mut self, patches: Vec<Patch>) {
        self.patches.extend(patches);
        while self.patches.len() > MOST_PATCHES {
            self.choice.share *= 0.5;
            let kept = std::mem::take(&mut self.patches);
            self.patches = kept.into_iter().filter(|p| self.takes([p.centroid_m.x, p.centroid_m.y])).collect();
        }
    }
}

/// What a sighting has.
struct Seen {
    sighting: Sighting,
    ridges: Vec<Ridge>,
    corners: Vec<Corner>,
}

/// A tie with the numbers of its features, to take only those that do not close a ring.
struct Candidate {
    tie: PlaceTie,
    rows: [(usize, usize); 2],
    variance_m2: f64,
}

/// How many were not tied, by kind and reason.
type Refused = BTreeMap<(PlaceKind, NotTied), u64>;

/// Finds, matches and appends.
pub(super) fn find(faces: FacePatches, strips: &StripIndex, places: &mut Places) {
    let mut by_sighting: BTreeMap<Sighting, Vec<Patch>> = BTreeMap::new();
    // control surfaces have no pose
    let is_strip =
        |p: &Patch| strips.strips().get(p.sighting.strip as usize).is_some_and(|s| s.source.file() < CONTROL_FILE);
    for patch in faces.patches.into_iter().filter(is_strip) {
        by_sighting.entry(patch.sighting).or_default().push(patch);
    }
    let options = CornerOptions::default();
    let groups: Vec<(Sighting, Vec<Patch>)> = by_sighting.into_iter().collect();
    let seen: Vec<Seen> = groups
        .into_par_iter()
        .map(|(sighting, patches)| Seen {
            sighting,
            ridges: ridges(&patches, &options),
            corners: corners(&patches, &options),
        })
        .collect();
    let pairs: Vec<(usize, usize)> = (0..seen.len()).flat_map(|i| (i + 1..seen.len()).map(move |j| (i, j))).collect();
    let found: Vec<(Vec<Candidate>, Refused)> =
        pairs.into_par_iter().map(|pair| of_pair(&seen, pair, &options)).collect();
    let mut candidates = Vec::new();
    for (of_pair, rejected) in found {
        candidates.extend(of_pair);
        for ((kind, why_not), count) in rejected {
            *places.rejected.entry(format!("{}_{}", kind.as_str(), why_not.as_str())).or_default() += count;
        }
    }
    without_rings(candidates, places);
}

fn of_pair(seen: &[Seen], (i, j): (usize, usize), options: &CornerOptions) -> (Vec<Candidate>, Refused) {
    let (a, b) = (&seen[i], &seen[j]);
    let (mut found, mut rejected) = (Vec::new(), Refused::new());
    let sightings = [a.sighting, b.sighting];
    for (row, tie) in match_ridges(&a.ridges, &b.ridges, options).into_iter().enumerate() {
        match (tie.rejection, &tie.second) {
            (None, Some(second)) => {
                // the edge was taken elsewhere along the ridge, of the same faces
                let other = b.ridges.iter().position(|r| r.edge.normals == second.normals).unwrap_or(0);
                let ends = |e: &Edge| (e.point_m, e.time_s);
                let tie = place_tie(PlaceKind::Ridge, sightings, [ends(&tie.first), ends(second)], &tie.held);
                found.push((tie, row, other));
            }
            // that a strip does not see a ridge at all is no rejection
            (Some(NotTied::NoneFound) | None, _) => {}
            (Some(why_not), _) => *rejected.entry((PlaceKind::Ridge, why_not)).or_default() += 1,
        }
    }
    let ridges = found.len();
    for (row, tie) in match_corners(&a.corners, &b.corners, options).into_iter().enumerate() {
        match (tie.rejection, &tie.second) {
            (None, Some(second)) => {
                let other = b.corners.iter().position(|c| c == second).unwrap_or(0);
                let held = axes(&(tie.first.covariance_m2 + second.covariance_m2));
                let ends = |c: &Corner| (c.point_m, c.time_s);
                let tie = place_tie(PlaceKind::Corner, sightings, [ends(&tie.first), ends(second)], &held);
                // numbers of corners follow those of ridges
                found.push((tie, a.ridges.len() + row, b.ridges.len() + other));
            }
            (Some(NotTied::NoneFound) | None, _) => {}
            (Some(why_not), _) => *rejected.entry((PlaceKind::Corner, why_not)).or_default() += 1,
        }
    }
    tracing::debug!(
        "{:?} {:?}: {} and {} ridges, {} and {} corners, {ridges} and {} ties",
        a.sighting,
        b.sighting,
        a.ridges.len(),
        b.ridges.len(),
        a.corners.len(),
        b.corners.len(),
        found.len() - ridges
    );
    let candidate = |(tie, row, other): (PlaceTie, usize, usize)| Candidate {
        variance_m2: tie.directions.iter().map(|d| d.sigma_m.powi(2)).sum::<f64>() / tie.directions.len() as f64,
        tie,
        rows: [(i, row), (j, other)],
    };
    (found.into_iter().map(candidate).collect(), rejected)
}

fn place_tie(
    kind: PlaceKind,
    sightings: [Sighting; 2],
    [(first_m, first_s), (second_m, second_s)]: [(Vector3<f64>, f64); 2],
    held: &[(Vector3<f64>, f64)],
) -> PlaceTie {
    let (points_m, time_s) = ([first_m, second_m], [first_s, second_s]);
    let direction = |(direction, sigma_m): &(Vector3<f64>, f64)| Direction {
        direction: *direction,
        distance_m: direction.dot(&(first_m - second_m)),
        sigma_m: *sigma_m,
        parts: vec![Part { along: *direction, points_m, time_s }],
    };
    let directions = held.iter().map(direction).collect();
    PlaceTie { kind, sightings, points_m, time_s, directions, held_out: false, why_not: None }
}

/// Eigenvectors of a covariance and the sigma along each, best known first.
fn axes(covariance_m2: &Matrix3<f64>) -> Vec<(Vector3<f64>, f64)> {
    let eigen = SymmetricEigen::new(*covariance_m2);
    let axis = |k: usize| (eigen.eigenvectors.column(k).into_owned(), eigen.eigenvalues[k].max(1e-12).sqrt());
    let mut axes: Vec<(Vector3<f64>, f64)> = (0..3).map(axis).collect();
    axes.sort_by(|a, b| a.1.total_cmp(&b.1));
    axes
}

/// Takes the best ties of each feature that join sightings not joined yet: more would tell the same noise twice.
fn without_rings(mut candidates: Vec<Candidate>, places: &mut Places) {
    candidates.sort_by(|a, b| a.variance_m2.total_cmp(&b.variance_m2).then(a.rows.cmp(&b.rows)));
    let mut number: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    let mut group: Vec<usize> = Vec::new();
    let mut kept = Vec::new();
    for candidate in candidates {
        let [a, b] = candidate.rows.map(|row| {
            *number.entry(row).or_insert_with(|| {
                group.push(group.len());
                group.len() - 1
            })
        });
        let (a, b) = (root(&mut group, a), root(&mut group, b));
        if a == b {
            places.reject(candidate.tie.kind, "ring");
        } else {
            group[b] = a;
            kept.push(candidate);
        }
    }
    // in order of sightings, as they were found
    kept.sort_by_key(|c| (c.tie.kind, c.rows));
    places.ties.extend(kept.into_iter().map(|c| c.tie));
}

fn root(group: &mut [usize], mut row: usize) -> usize {
    while group[row] != row {
        group[row] = group[group[row]];
        row = group[row];
    }
    row
}
