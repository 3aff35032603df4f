//! Ties of submaps: two strips registered tile by tile, each tile judged by the way back and by the others.

use std::collections::BTreeMap;

use nalgebra::{DVector, Vector3};
use rayon::prelude::*;

use super::agreement::{Disagreement, Neighbourhood, Said, judge};
use super::submap::{Cloud, NotRegistered, Registration, SubmapOptions, register};

/// How strips are cut into submaps and their ties judged.
#[derive(Debug, Clone, PartialEq)]
pub struct TileOptions {
    /// Edge of a submap in plan \[m\].
    pub tile_m: f64,
    /// Reach in plan of the others that a tie is compared with \[m\].
    pub neighbourhood_m: f64,
    /// What the mismatch may drift over that reach \[m\].
    pub drift_m: f64,
    /// How each is registered; without turns: the frame of a tie is too small for them.
    pub submap: SubmapOptions,
}

impl Default for TileOptions {
    fn default() -> Self {
        Self { tile_m: 50.0, neighbourhood_m: 200.0, drift_m: 0.02, submap: SubmapOptions::default() }
    }
}

/// Why a submap is not tied.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum SubmapRejection {
    /// The clouds do not share what it takes.
    NotRegistered(NotRegistered),
    /// The moving cloud found no rest.
    NotConverged,
    /// Registered the other way round it comes out otherwise.
    NotReciprocal,
    /// It disagrees with the others about it.
    Neighbours,
    /// No other tie says anything about its directions.
    Alone,
}

impl SubmapRejection {
    /// The word used in files.
    #[must_use]
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::NotRegistered(_) => "not_registered",
            Self::NotConverged => "not_converged",
            Self::NotReciprocal => "not_reciprocal",
            Self::Neighbours => "neighbours",
            Self::Alone => "alone",
        }
    }
}

/// A submap and what became of it.
#[derive(Debug, Clone)]
pub struct SubmapTie {
    /// Centre of the tile in plan \[m\].
    pub centre_m: [f64; 2],
    /// How the moving cloud lies on the fixed one, when it could be registered.
    pub registration: Option<Registration>,
    /// Why it is not a tie.
    pub rejection: Option<SubmapRejection>,
}

/// Sigmas that the way back may differ by.
const SIGMAS: f64 = 4.0;

/// The points of each tile.
#[derive(Default)]
struct Tile {
    points_m: [Vec<Vector3<f64>>; 2],
    time_s: [Vec<f64>; 2],
}

impl Tile {
    fn cloud(&self, k: usize) -> Cloud<'_> {
        Cloud { points_m: &self.points_m[k], time_s: &self.time_s[k] }
    }
}

/// Registers two strips tile by tile.
///
/// Every tile in which both have points is in the result, in order of place, with a reason where it is not a tie.
#[must_use]
pub fn tie_submaps(fixed: &Cloud<'_>, moving: &Cloud<'_>, options: &TileOptions) -> Vec<SubmapTie> {
    let tiles: Vec<([i64; 2], Tile)> = tiles(fixed, moving, options).into_iter().collect();
    let of = |(place, tile): &([i64; 2], Tile)| {
        #[allow(clippy::cast_precision_loss)]
        let centre_m = place.map(|i| (i as f64 + 0.5) * options.tile_m);
        tie_submap(centre_m, &tile.cloud(0), &tile.cloud(1), options)
    };
    let mut ties: Vec<SubmapTie> = tiles.par_iter().map(of).collect();
    judge_submaps(&mut ties, options);
    ties
}

/// Points by tile; moving ones also go to tiles that they may belong to once they are put right.
fn tiles(fixed: &Cloud<'_>, moving: &Cloud<'_>, options: &TileOptions) -> BTreeMap<[i64; 2], Tile> {
    let mut tiles: BTreeMap<[i64; 2], Tile> = BTreeMap::new();
    for (k, cloud, margin_m) in [(0, fixed, 0.0), (1, moving, 2.0 * options.submap.search_m)] {
        for (point, time) in cloud.points_m.iter().zip(cloud.time_s).filter(|(p, _)| p.iter().all(|v| v.is_finite())) {
            #[allow(clippy::cast_possible_truncation)]
            let at = |axis: usize, shift_m: f64| ((point[axis] + shift_m) / options.tile_m).floor() as i64;
            for i in at(0, -margin_m)..=at(0, margin_m) {
                for j in at(1, -margin_m)..=at(1, margin_m) {
                    let tile = tiles.entry([i, j]).or_default();
                    tile.points_m[k].push(*point);
                    tile.time_s[k].push(*time);
                }
            }
        }
    }
    tiles.retain(|_, t| t.points_m.iter().all(|p| !p.is_empty()));
    tiles
}

/// Registers the clouds of one tile there and back; [`judge_submaps`] has the last word.
#[must_use]
pub fn tie_submap(centre_m: [f64; 2], fixed: &Cloud<'_>, moving: &Cloud<'_>, options: &TileOptions) -> SubmapTie {
    let submap = SubmapOptions { rotation: false, ..options.submap.clone() };
    let (registration, rejection) = match register(fixed, moving, &submap) {
        Err(reason) => (None, Some(SubmapRejection::NotRegistered(reason))),
        Ok(found) if !found.converged => (Some(found), Some(SubmapRejection::NotConverged)),
        Ok(found) => {
            let back = register(moving, fixed, &submap);
            let agrees = back.is_ok_and(|back| returns(&found, &back));
            (Some(found), (!agrees).then_some(SubmapRejection::NotReciprocal))
        }
    };
    SubmapTie { centre_m, registration, rejection }
}

/// Whether the way back undoes the way there, along what the way there holds and the way back holds too.
fn returns(found: &Registration, back: &Registration) -> bool {
    let left_m = found.shift_m + back.shift_m;
    let both = back.held.directions.transpose() * &found.held.directions;
    found.held.directions.column_iter().zip(found.held.sigma_m.iter()).enumerate().all(|(k, (e, sigma))| {
        // both clouds are the same: the two ways share their noise, and differ by how cells cut them
        let is_held = both.column(k).norm() > 0.9;
        is_held && e.dot(&DVector::from_column_slice(left_m.as_slice())).abs() < SIGMAS * sigma
    })
}

/// Takes out the tie that disagrees most with what the others about it say together, until none does. All are of the same two strips.
pub fn judge_submaps(ties: &mut [SubmapTie], options: &TileOptions) {
    let said: Vec<Option<Said>> = ties.iter().map(said).collect();
    let hood = Neighbourhood { from_m: 0.0, to_m: options.neighbourhood_m, drift_m: options.drift_m };
    for (tie, reason) in ties.iter_mut().zip(judge(&said, &hood)) {
        if let Some(reason) = reason {
            tie.rejection = Some(match reason {
                Disagreement::Neighbours => SubmapRejection::Neighbours,
                Disagreement::Alone => SubmapRejection::Alone,
            });
        }
    }
}

fn said(tie: &SubmapTie) -> Option<Said> {
    let found = tie.registration.as_ref().filter(|_| tie.rejection.is_none())?;
    let held = found.held.directions.column_iter().zip(found.held.sigma_m.iter());
    let held = held.map(|(e, sigma)| (Vector3::new(e[0], e[1], e[2]), *sigma)).collect();
    Some(Said { place_m: tie.centre_m, shift_m: found.shift_m, held })
}
