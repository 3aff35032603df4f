//! Ridges of gable roofs, found and matched between two sightings whose truth is known.

mod common;

use std::collections::BTreeMap;

use common::Draws;
use nalgebra::Vector3;
use tieline_matching::xyz::{CornerOptions, NotTied, RidgeTie, match_ridges, ridges};
use tieline_matching::{Moments, Patch, Sighting};

const NOISE_M: f64 = 0.015;
const STEPS_PER_METRE: f64 = 16_384.0;
const SHIFT_M: Vector3<f64> = Vector3::new(0.21, -0.17, 0.12);

/// A house: its place, and whether its ridge runs along x.
type House = (Vector3<f64>, bool);

/// Patches of a metre of gable roofs of 12 × 8 m, slopes of 35°, and of the ground about them.
#[allow(clippy::cast_possible_truncation)]
fn patches(houses: &[House], strip: u32, seed: u64, shift_m: &Vector3<f64>) -> Vec<Patch> {
    let mut draws = Draws(seed << 32);
    let mut cells: BTreeMap<[i32; 3], Moments> = BTreeMap::new();
    for (house_m, along_x) in houses {
        for _ in 0..6_000 {
            let (u, v) = (18.0 * draws.uniform() - 9.0, 14.0 * draws.uniform() - 7.0);
            let z = if u.abs() < 6.0 && v.abs() < 4.0 { 8.0 - 0.7 * v.abs() } else { 0.0 };
            let (x, y) = if *along_x { (u, v) } else { (-v, u) };
            let point = house_m + Vector3::new(x, y, z + NOISE_M * draws.normal()) - shift_m;
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

/// Houses on a grid of 30 m, ridges along x and y in turn, none at a place of whole metres.
fn village() -> Vec<House> {
    let place = |k: i32| Vector3::new(30.37 * f64::from(k % 4), 29.71 * f64::from(k / 4), 0.21 * f64::from(k));
    (0..12).map(|k| (place(k), (k % 4 + k / 4) % 2 == 0)).collect()
}

fn matched(first: &[House], second: &[House], seed: u64) -> Vec<RidgeTie> {
    let options = CornerOptions::default();
    let a = ridges(&patches(first, 0, 2 * seed + 1, &Vector3::zeros()), &options);
    let b = ridges(&patches(second, 1, 2 * seed + 2, &SHIFT_M), &options);
    match_ridges(&a, &b, &options)
}

fn ties(found: &[RidgeTie]) -> Vec<&RidgeTie> {
    found.iter().filter(|t| t.rejection.is_none()).collect()
}

#[test]
fn each_gable_has_its_ridge_and_no_more() {
    let options = CornerOptions::default();
    let (mut count, mut sum) = (0.0, 0.0);
    for seed in 0..10 {
        let found = ridges(&patches(&village(), 0, seed + 100, &Vector3::zeros()), &options);
        assert!((11..=12).contains(&found.len()), "{} ridges of 12", found.len());
        for ridge in &found {
            let above = |h: &&House| (h.0 - ridge.edge.point_m).xy().norm() < 8.0;
            let house = village().into_iter().find(|h| above(&h)).expect("a house");
            let along = if house.1 { Vector3::x() } else { Vector3::y() };
            assert!(ridge.edge.direction.dot(&along).abs() > 0.999, "{}", ridge.edge.direction);
            assert!((3.5..8.5).contains(&ridge.half_length_m), "{} m", ridge.half_length_m);
            let off_m = ridge.edge.point_m - (house.0 + 8.0 * Vector3::z());
            let error_m = off_m - along * along.dot(&off_m);
            // the covariance is of rank 2: its own axes, but the one along the ridge
            let eigen = ridge.edge.covariance_m2.symmetric_eigen();
            let mut axes: Vec<usize> = vec![0, 1, 2];
            axes.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
            sum += axes[..2]
                .iter()
                .map(|k| eigen.eigenvectors.column(*k).dot(&error_m).powi(2) / eigen.eigenvalues[*k])
                .sum::<f64>();
            count += 1.0;
        }
    }
    let average = sum / count;
    assert!(average > 1.4 && average < 2.7, "eᵀΣ⁻¹e averages {average}");
}

#[test]
fn ridges_of_two_sightings_are_tied_within_their_sigmas() {
    let (mut count, mut sum, mut squares) = (0.0, 0.0, Vector3::zeros());
    for seed in 0..15 {
        let found = matched(&village(), &village(), seed);
        for tie in ties(&found) {
            assert_eq!(tie.held.len(), 2);
            let error_m = tie.difference_m().expect("a tie")
                - tie.held.iter().map(|(d, _)| d * d.dot(&-SHIFT_M)).sum::<Vector3<f64>>();
            sum += tie.held.iter().map(|(d, sigma)| (d.dot(&error_m) / sigma).powi(2)).sum::<f64>();
            squares += error_m.component_mul(&error_m);
            count += 1.0;
        }
        assert!(ties(&found).len() >= 9, "{} ties", ties(&found).len());
    }
    let (average, rms_m): (f64, Vector3<f64>) = (sum / count, (squares / count).map(f64::sqrt));

    assert!((average - 2.0).abs() < 0.35, "eᵀΣ⁻¹e averages {average}");
    assert!(rms_m.max() < 0.01, "{rms_m}");
}

#[test]
fn directions_of_a_tie_are_independent() {
    let found = matched(&village(), &village(), 3);
    for tie in ties(&found) {
        let second = tie.second.as_ref().expect("a tie");
        let sum = tie.first.covariance_m2 + second.covariance_m2;
        let [(a, sa), (b, sb)] = tie.held[..] else { panic!("two directions") };
        assert!(a.dot(&b).abs() < 1e-12 && a.dot(&tie.first.direction).abs() < 0.02);
        assert!(a.dot(&(sum * b)).abs() < 1e-6 * sa * sb, "whitened: nothing across");
        assert!((a.dot(&(sum * a)).sqrt() - sa).abs() < 1e-9 && (b.dot(&(sum * b)).sqrt() - sb).abs() < 1e-9);
    }
}

#[test]
fn a_house_that_stands_elsewhere_is_told_from_its_neighbours() {
    let mut moved = village();
    moved[5].0 += Vector3::new(0.2, 0.2, 0.1);
    let found = matched(&village(), &moved, 3);
    let of_house = |t: &&RidgeTie| (t.first.point_m - village()[5].0).xy().norm() < 8.0;
    let about: Vec<&RidgeTie> = found.iter().filter(of_house).collect();
    assert!(!about.is_empty() && about.iter().all(|t| t.rejection.is_some()));
    assert!(about.iter().any(|t| t.rejection == Some(NotTied::Neighbours)), "{:?}", about[0].rejection);
    assert!(ties(&found).len() >= 8, "the others are ties: {}", ties(&found).len());
}

#[test]
fn a_ridge_without_neighbours_is_not_trusted() {
    let one = &village()[..1];
    let found = matched(one, one, 4);
    assert!(!found.is_empty() && found.iter().all(|t| t.rejection == Some(NotTied::Alone)));
}

#[test]
fn level_ground_has_no_ridge() {
    let ground: Vec<Patch> =
        patches(&village(), 0, 9, &Vector3::zeros()).into_iter().filter(|p| p.centroid_m.z < 3.0).collect();
    assert!(ground.len() > 500 && ridges(&ground, &CornerOptions::default()).is_empty());
}
