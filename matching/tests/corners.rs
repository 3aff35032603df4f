//! Corners of hipped roofs, found and matched between two sightings whose truth is known.

mod common;

use std::collections::BTreeMap;

use common::Draws;
use nalgebra::Vector3;
use tieline_matching::xyz::{CornerOptions, CornerTie, NotTied, corners, match_corners};
use tieline_matching::{Moments, Patch, Sighting};

const NOISE_M: f64 = 0.015;
const STEPS_PER_METRE: f64 = 16_384.0;
const SHIFT_M: Vector3<f64> = Vector3::new(0.21, -0.17, 0.12);

/// A hipped roof of 12 × 8 m about 0, 0, slopes of 35°: its ridge ends, where three planes meet, are at x = ± 2.
fn hipped(x: f64, y: f64) -> f64 {
    8.0 - 0.7 * y.abs().max(x.abs() - 2.0)
}

const RIDGE_ENDS_M: [Vector3<f64>; 2] = [Vector3::new(-2.0, 0.0, 8.0), Vector3::new(2.0, 0.0, 8.0)];

/// Patches of a metre of the roofs of houses at some places, and of the ground about them.
#[allow(clippy::cast_possible_truncation)]
fn patches(houses_m: &[Vector3<f64>], strip: u32, seed: u64, shift_m: &Vector3<f64>) -> Vec<Patch> {
    let mut draws = Draws(seed << 32);
    let mut cells: BTreeMap<[i32; 3], Moments> = BTreeMap::new();
    for house in houses_m {
        for _ in 0..8_000 {
            let (x, y) = (20.0 * draws.uniform() - 10.0, 16.0 * draws.uniform() - 8.0);
            let z = if x.abs() < 6.0 && y.abs() < 4.0 { hipped(x, y) } else { 0.0 };
            let point = house + Vector3::new(x, y, z + NOISE_M * draws.normal()) - shift_m;
            let layer = i32::from(z > 1.0);
            let cell = [point.x.floor() as i32, point.y.floor() as i32, layer];
            let corner = [f64::from(cell[0]), f64::from(cell[1]), 0.0];
            let steps = std::array::from_fn(|k| ((point[k] - corner[k]) * STEPS_PER_METRE).round() as i64);
            cells.entry(cell).or_default().add(steps, 0, 0);
        }
    }
    let sighting = Sighting { strip, pass: 0, scanner: 0 };
    cells
        .iter()
        .filter(|(_, m)| m.n >= 8)
        .filter_map(|(c, m)| Patch::from_moments(m, [f64::from(c[0]), f64::from(c[1]), 0.0], 7.0, sighting))
        .filter(|p| p.roughness_m < 0.03 && p.spread_m[1] > 0.1)
        .collect()
}

/// Houses on a grid of 30 m, none at a place of whole metres.
fn village() -> Vec<Vector3<f64>> {
    (0..12).map(|k| Vector3::new(30.37 * f64::from(k % 4), 29.71 * f64::from(k / 4), 0.21 * f64::from(k))).collect()
}

fn matched(first_m: &[Vector3<f64>], second_m: &[Vector3<f64>], seed: u64) -> Vec<CornerTie> {
    let options = CornerOptions::default();
    let first = corners(&patches(first_m, 0, 2 * seed + 1, &Vector3::zeros()), &options);
    let second = corners(&patches(second_m, 1, 2 * seed + 2, &SHIFT_M), &options);
    match_corners(&first, &second, &options)
}

fn ties(found: &[CornerTie]) -> Vec<&CornerTie> {
    found.iter().filter(|t| t.rejection.is_none()).collect()
}

#[test]
fn ridge_ends_are_found_where_they_are() {
    let options = CornerOptions::default();
    let (mut count, mut sum) = (0.0, 0.0);
    for seed in 0..10 {
        let found = corners(&patches(&village(), 0, seed + 100, &Vector3::zeros()), &options);
        for corner in &found {
            let truth = village().into_iter().flat_map(|h| RIDGE_ENDS_M.map(|r| h + r));
            let error_m = truth.map(|t| corner.point_m - t).min_by(|a, b| a.norm().total_cmp(&b.norm()));
            let error_m = error_m.expect("there are houses");
            let weight = corner.covariance_m2.try_inverse().expect("of rank 3");
            assert!(error_m.norm() < 0.08, "no such corner: {}", corner.point_m);
            sum += error_m.dot(&(weight * error_m));
            count += 1.0;
        }
        assert!(found.len() >= 20, "{} of 24 ridge ends", found.len());
    }
    let average = sum / count;
    assert!(average > 2.0 && average < 4.0, "eᵀΣ⁻¹e averages {average}");
}

#[test]
fn corners_of_two_sightings_are_tied_within_their_sigmas() {
    let (mut count, mut sum, mut squares) = (0.0, 0.0, Vector3::zeros());
    for seed in 0..10 {
        let found = matched(&village(), &village(), seed);
        for tie in ties(&found) {
            let (difference_m, covariance_m2) = tie.difference().expect("a tie");
            let error_m = difference_m + SHIFT_M;
            sum += error_m.dot(&(covariance_m2.try_inverse().expect("of rank 3") * error_m));
            squares += error_m.component_mul(&error_m);
            count += 1.0;
        }
        assert!(ties(&found).len() >= 18, "{} ties", ties(&found).len());
    }
    let (average, rms_m): (f64, Vector3<f64>) = (sum / count, (squares / count).map(f64::sqrt));
    assert!((average - 3.0).abs() < 0.7, "eᵀΣ⁻¹e averages {average}");
    assert!(rms_m.max() < 0.02, "{rms_m}");
}

#[test]
fn a_house_that_stands_elsewhere_is_told_from_its_neighbours() {
    let mut moved = village();
    moved[5] += Vector3::new(0.2, 0.1, 0.0);
    let found = matched(&village(), &moved, 3);
    let of_house = |t: &&CornerTie| (t.first.point_m - village()[5]).xy().norm() < 5.0;
    let about: Vec<&CornerTie> = found.iter().filter(of_house).collect();
    assert!(!about.is_empty() && about.iter().all(|t| t.rejection.is_some()));
    assert!(about.iter().any(|t| t.rejection == Some(NotTied::Neighbours)), "{:?}", about[0].rejection);
    assert!(ties(&found).len() >= 14, "the others are ties");
}

#[test]
fn a_corner_without_neighbours_is_not_trusted() {
    let one = &village()[..1];
    let found = matched(one, one, 4);
    assert!(ties(&found).is_empty() && found.iter().any(|t| t.rejection == Some(NotTied::Alone)), "{found:?}");
}

#[test]
fn where_two_corners_might_be_meant_none_is_tied() {
    // the second time every house is seen twice, half a metre apart: as two roofs of one kind are, or a double trajectory
    let options = CornerOptions { search_m: 0.8, ..CornerOptions::default() };
    let first = corners(&patches(&village(), 0, 1, &Vector3::zeros()), &options);
    let mut second = corners(&patches(&village(), 1, 2, &Vector3::new(0.25, 0.0, 0.0)), &options);
    second.extend(corners(&patches(&village(), 1, 3, &Vector3::new(-0.25, 0.0, 0.0)), &options));
    let found = match_corners(&first, &second, &options);
    let ambiguous = found.iter().filter(|t| t.rejection == Some(NotTied::Ambiguous)).count();
    assert!(ties(&found).is_empty() && ambiguous >= 18, "{ambiguous} of {}", found.len());
}
