//! Corners of houses on a street, found and matched between two drives whose truth is known.

mod common;

use std::collections::BTreeMap;

use common::Draws;
use nalgebra::Vector3;
use tieline_matching::xyz::{
    AgreeOptions, FeatureTie, NotTied, StreetCorner, StreetCornerOptions, agree, match_street_corners, street_corners,
};
use tieline_matching::{Moments, Patch, Sighting};

const NOISE_M: f64 = 0.005;
const COMMON_M: f64 = 0.0003;
const STEPS_PER_METRE: f64 = 16_384.0;
const CELL_M: f64 = 0.5;
const SHIFT_M: Vector3<f64> = Vector3::new(0.21, -0.17, 0.04);

/// A piece of a plane: origin and two edges.
type Piece = [Vector3<f64>; 3];

/// A house whose front faces south and whose side faces west, with the ground before them. `with_side` is how deep the side is seen \[m\].
fn house(at: &Vector3<f64>, side_m: f64) -> Vec<Piece> {
    let (east, north, up) = (Vector3::x() * 6.0, Vector3::y() * side_m, Vector3::z() * 6.0);
    // the ground rises a little to the east and to the north
    vec![
        [*at, east, up],
        [*at, north, up],
        [*at + Vector3::new(0.0, -3.0, -0.06), Vector3::new(6.0, 0.0, 0.06), Vector3::new(0.0, 3.0, 0.06)],
        [*at + Vector3::new(-4.0, -3.0, -0.1), Vector3::new(4.0, 0.0, 0.04), Vector3::new(0.0, 6.0, 0.12)],
    ]
}

/// Patches of half a metre of all pieces, as a vehicle south-west of them has them.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn patches(pieces: &[Piece], strip: u32, seed: u64, shift_m: &Vector3<f64>) -> Vec<Patch> {
    let mut draws = Draws(seed << 32);
    let sighting = Sighting { strip, pass: 0, scanner: 0 };
    // what lies in one cell is one patch, whatever it is of: at an edge it is rough, and none
    let mut cells: BTreeMap<[i32; 3], Moments> = BTreeMap::new();
    for piece in pieces {
        let normal = piece[1].cross(&piece[2]);
        // what all points of a plane have in common, as sigmas count it
        let common_m = normal.normalize() * (COMMON_M * draws.normal());
        for _ in 0..(60.0 * normal.norm()) as u32 {
            let noise = normal.normalize() * (NOISE_M * draws.normal());
            let point = piece[0] + piece[1] * draws.uniform() + piece[2] * draws.uniform() + noise + common_m - shift_m;
            let cell = [0, 1, 2].map(|k| (point[k] / CELL_M).floor() as i32);
            let steps =
                std::array::from_fn(|k| ((point[k] - CELL_M * f64::from(cell[k])) * STEPS_PER_METRE).round() as i64);
            cells.entry(cell).or_default().add(steps, 0, 0);
        }
    }
    let patch = |(c, m): (&[i32; 3], &Moments)| {
        let time_s = 100.0 * f64::from(strip) + f64::from(c[0]) * CELL_M / 10.0;
        Patch::from_moments(m, c.map(|v| CELL_M * f64::from(v)), time_s, sighting)
    };
    let mut all: Vec<Patch> = cells.iter().filter(|(_, m)| m.n >= 6).filter_map(patch).collect();
    all.retain(|p| p.roughness_m < 0.015 && p.spread_m[1] > 0.05);
    let towards = Vector3::new(-1.0, -1.0, 0.0);
    for patch in all.iter_mut().filter(|p| p.normal.z.abs() < 0.7 && p.normal.dot(&towards) < 0.0) {
        patch.normal = -patch.normal;
    }
    all
}

/// Houses along a street, none on the lines of cells.
fn street() -> Vec<Vector3<f64>> {
    (0..8).map(|k| Vector3::new(14.37 * f64::from(k), 0.23 * f64::from(k) + 0.11, 0.03 * f64::from(k))).collect()
}

fn pieces(places: &[Vector3<f64>], side_m: f64) -> Vec<Piece> {
    places.iter().flat_map(|at| house(at, side_m)).collect()
}

fn matched(first: &[Piece], second: &[Piece], seed: u64) -> Vec<FeatureTie> {
    let options = StreetCornerOptions::default();
    let mut all: Vec<StreetCorner> = street_corners(&patches(first, 0, 2 * seed + 1, &Vector3::zeros()), &options);
    all.extend(street_corners(&patches(second, 1, 2 * seed + 2, &SHIFT_M), &options));
    let (mut ties, rows) = match_street_corners(&mut all, &|_, _| 0.6, 0.6, &options);
    assert_eq!(ties.len(), rows.len());
    agree(&mut ties, &AgreeOptions::default());
    ties
}

fn accepted(ties: &[FeatureTie]) -> Vec<&FeatureTie> {
    ties.iter().filter(|t| t.rejection.is_none()).collect()
}

#[test]
fn corners_of_houses_are_tied_within_their_sigmas() {
    let (mut sums, mut counts, mut squares, mut blunders) = ([0.0; 2], [0.0; 2], 0.0, 0);
    for seed in 0..12 {
        let street = pieces(&street(), 4.0);
        let ties = matched(&street, &street, seed);
        for tie in accepted(&ties) {
            let held = tie.held();
            let error: Vec<f64> = held.iter().map(|h| h.dot(&(tie.shift_m() + SHIFT_M))).collect();
            let c = tie.covariance_m2();
            let variance = nalgebra::DMatrix::from_fn(held.len(), held.len(), |i, k| held[i].dot(&(c * held[k])));
            let e = nalgebra::DVector::from_vec(error);
            let square = e.dot(&(variance.try_inverse().expect("of its rank") * &e));
            blunders += usize::from(e.amax() > 0.01);
            sums[held.len() - 2] += square;
            counts[held.len() - 2] += 1.0;
            squares += e.norm_squared() / e.len() as f64;
        }
        let corners = accepted(&ties).iter().filter(|t| t.free.is_none()).count();
        assert!(corners >= 6, "{corners} of 8 houses have a corner, seed {seed}");
    }
    let rms_m = f64::sqrt(squares / (counts[0] + counts[1]));
    let [of_edges, of_corners] = [sums[0] / counts[0], sums[1] / counts[1]];
    assert!(
        blunders == 0 && rms_m < 0.003,
        "{blunders} beyond a centimetre, rms {rms_m}, {of_edges} {of_corners} {counts:?}"
    );
    assert!((1.65..2.35).contains(&of_edges), "{of_edges} over {} edges, rms {rms_m}", counts[0]);
    assert!((2.5..3.5).contains(&of_corners), "{of_corners} over {} corners, rms {rms_m}", counts[1]);
}

#[test]
fn a_house_that_stands_elsewhere_is_refused() {
    let mut moved = street();
    moved[3] += Vector3::new(0.12, 0.08, 0.0);
    let ties = matched(&pieces(&street(), 4.0), &pieces(&moved, 4.0), 5);
    let at = |tie: &FeatureTie| (tie.ends[0].place_m - street()[3]).xy().norm() < 1.0;
    assert!(ties.iter().filter(|t| at(t)).all(|t| t.rejection == Some(NotTied::Neighbours)));
    assert!(ties.iter().any(at) && accepted(&ties).len() >= 10);
}

#[test]
fn a_corner_that_might_be_either_of_two_is_refused() {
    // a second front 0.3 m before the first, a little to the east: two edges of the same walls within the search
    let mut twice = pieces(&street(), 4.0);
    for at in street() {
        twice.extend(house(&(at + Vector3::new(0.35, -0.3, 0.0)), 4.0));
    }
    let ties = matched(&twice, &twice, 7);
    let wrong = |tie: &&&FeatureTie| (tie.shift_m() + SHIFT_M).xy().norm() > 0.05;
    assert_eq!(accepted(&ties).iter().filter(wrong).count(), 0);
}

#[test]
fn a_front_alone_has_no_corner() {
    let front: Vec<Piece> = street().iter().map(|at| [*at, Vector3::x() * 6.0, Vector3::z() * 6.0]).collect();
    let found = street_corners(&patches(&front, 0, 3, &Vector3::zeros()), &StreetCornerOptions::default());
    assert!(found.is_empty(), "{found:?}");
}
