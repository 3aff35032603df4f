//! Ties of submaps: two strips registered tile by tile, each tile judged by the way back and by the others.

use std::collections::BTreeMap;

use nalgebra::{DVector, Matrix3, Vector3};
use rayon::prelude::*;

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

/// Sigmas allowed beyond the limits.
const SIGMAS: f64 = 4.0;
/// Largest sigma \[m\] of what the others say along a direction, for them to be judges of it.
const JUDGES_SIGMA_M: f64 = 0.1;

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
    let mut ties: Vec<SubmapTie> = tiles.par_iter().map(|(place, tile)| tie_of(*place, tile, options)).collect();
    judge(&mut ties, options);
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

#[allow(clippy::cast_precision_loss)]
fn tie_of(place: [i64; 2], tile: &Tile, options: &TileOptions) -> SubmapTie {
    let centre_m = place.map(|i| (i as f64 + 0.5) * options.tile_m);
    let submap = SubmapOptions { rotation: false, ..options.submap.clone() };
    let (registration, rejection) = match register(&tile.cloud(0), &tile.cloud(1), &submap) {
        Err(reason) => (None, Some(SubmapRejection::NotRegistered(reason))),
        Ok(found) if !found.converged => (Some(found), Some(SubmapRejection::NotConverged)),
        Ok(found) => {
            let back = register(&tile.cloud(1), &tile.cloud(0), &submap);
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

/// Information matrix, and the same times the shift, of a tie.
fn information(tie: &SubmapTie) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let found = tie.registration.as_ref().filter(|_| tie.rejection.is_none())?;
    let mut n = Matrix3::zeros();
    for (e, sigma) in found.held.directions.column_iter().zip(found.held.sigma_m.iter()) {
        let e = Vector3::new(e[0], e[1], e[2]);
        n += e * e.transpose() / (sigma * sigma);
    }
    Some((n, n * found.shift_m))
}

/// Takes out the tie that disagrees most with what the others about it say together, until none does.
fn judge(ties: &mut [SubmapTie], options: &TileOptions) {
    loop {
        let said: Vec<_> = ties.iter().map(information).collect();
        let verdicts = (0..ties.len()).filter_map(|row| Some((row, verdict(ties, &said, row, options)?)));
        let worst = verdicts.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
        match worst {
            Some((row, value)) if value > 1.0 => {
                let reason = if value.is_infinite() { SubmapRejection::Alone } else { SubmapRejection::Neighbours };
                ties[row].rejection = Some(reason);
            }
            _ => break,
        }
    }
}

/// The difference of a tie from the others over what is allowed, along its worst direction; infinite when nobody can tell.
fn verdict(
    ties: &[SubmapTie],
    said: &[Option<(Matrix3<f64>, Vector3<f64>)>],
    row: usize,
    options: &TileOptions,
) -> Option<f64> {
    let found = ties[row].registration.as_ref().filter(|_| ties[row].rejection.is_none())?;
    let distance_m = |other: &SubmapTie| {
        (other.centre_m[0] - ties[row].centre_m[0]).hypot(other.centre_m[1] - ties[row].centre_m[1])
    };
    // a metre of prior sigma, so that what nobody says is no division by nothing
    let (mut n, mut b) = (Matrix3::identity(), Vector3::zeros());
    for (other, said) in ties.iter().zip(said).enumerate().filter(|(k, _)| *k != row).map(|(_, o)| o) {
        if let Some((of_n, of_b)) = said
            && distance_m(other) <= options.neighbourhood_m
        {
            n += of_n;
            b += of_b;
        }
    }
    let covariance_m2 = n.try_inverse()?;
    let difference_m = found.shift_m - covariance_m2 * b;
    let values = found.held.directions.column_iter().zip(found.held.sigma_m.iter()).map(|(e, sigma)| {
        let e = Vector3::new(e[0], e[1], e[2]);
        let of_others_m = e.dot(&(covariance_m2 * e)).sqrt();
        if of_others_m > JUDGES_SIGMA_M {
            return f64::INFINITY;
        }
        e.dot(&difference_m).abs() / (options.drift_m + SIGMAS * sigma.hypot(of_others_m))
    });
    Some(values.fold(0.0, f64::max))
}
