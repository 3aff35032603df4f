//! Registration of submaps on scenes whose truth is known.

mod common;

use common::Draws;
use nalgebra::{DVector, Isometry3, Translation3, UnitQuaternion, Vector3};
use tieline_matching::mix;
use tieline_matching::xyz::{
    Cloud, NotRegistered, Registration, SubmapOptions, SubmapRejection, SubmapTie, TileOptions, register, tie_submaps,
};

/// Heights of the scenes above x, y \[m\].
type Surface = fn(f64, f64) -> f64;

/// Rows of houses 20 m apart: gable roofs, ridges along x and y in turn, slopes of 27°.
fn village(x: f64, y: f64) -> f64 {
    let (house_x, house_y) = ((x / 20.0).floor(), (y / 20.0).floor());
    let (in_x, in_y) = (x - 20.0 * house_x - 10.0, y - 20.0 * house_y - 10.0);
    if in_x.abs() > 5.0 || in_y.abs() > 5.0 {
        return 0.0;
    }
    let across = if (house_x + house_y).rem_euclid(2.0) < 0.5 { in_y } else { in_x };
    5.0 - 0.5 * across.abs()
}

fn car_park(x: f64, y: f64) -> f64 {
    0.02 * x + 0.01 * y
}

const NOISE_M: f64 = 0.01;

/// Points of a surface over a square, 12 a square metre, noise along z.
fn seen(surface: Surface, side_m: f64, seed: u64) -> Vec<Vector3<f64>> {
    let mut draws = Draws(seed << 32);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let count = (12.0 * side_m * side_m) as usize;
    (0..count)
        .map(|_| {
            let (x, y) = (side_m * draws.uniform(), side_m * draws.uniform());
            Vector3::new(x, y, surface(x, y) + NOISE_M * draws.normal())
        })
        .collect()
}

/// A street along x: a road and two façades of 6 m.
fn street(seed: u64) -> Vec<Vector3<f64>> {
    let mut draws = Draws(seed << 32);
    (0..30_000)
        .map(|k| {
            let (x, across, noise) = (60.0 * draws.uniform(), draws.uniform(), NOISE_M * draws.normal());
            match k % 3 {
                0 => Vector3::new(x, 12.3 * across, noise),
                1 => Vector3::new(x, noise - 0.2, 6.0 * across),
                _ => Vector3::new(x, noise + 12.5, 6.0 * across),
            }
        })
        .collect()
}

/// The first cloud on which the second one, moved away, is put back.
fn put_back(
    fixed: &[Vector3<f64>],
    moving: &[Vector3<f64>],
    options: &SubmapOptions,
) -> Result<Registration, NotRegistered> {
    let times_s = [vec![100.0; fixed.len()], vec![500.0; moving.len()]];
    let fixed = Cloud { points_m: fixed, time_s: &times_s[0] };
    let moving = Cloud { points_m: moving, time_s: &times_s[1] };
    register(&fixed, &moving, options)
}

fn shifted(points: &[Vector3<f64>], shift_m: &Vector3<f64>) -> Vec<Vector3<f64>> {
    points.iter().map(|p| p + shift_m).collect()
}

const SHIFT_M: Vector3<f64> = Vector3::new(0.31, -0.42, 0.23);

#[test]
fn a_known_shift_comes_back_within_its_sigma() {
    let seeds = 30;
    let (mut sum, mut square_m2) = (0.0, Vector3::zeros());
    for seed in 0..seeds {
        let fixed = seen(village, 60.0, 2 * seed);
        let moving = shifted(&seen(village, 60.0, 2 * seed + 1), &-SHIFT_M);
        let found = put_back(&fixed, &moving, &SubmapOptions::default()).expect("registered");
        assert!(found.held.rank() == 3 && found.converged, "{:?} {}", found.held, found.rounds);
        let error_m = found.shift_m - SHIFT_M;
        sum += found.held.normalised_square(&DVector::from_column_slice(error_m.as_slice()));
        square_m2 += error_m.component_mul(&error_m);
        assert!((found.time_s[0] - 100.0).abs() < 1e-6 && (found.time_s[1] - 500.0).abs() < 1e-6);
    }
    #[allow(clippy::cast_precision_loss)]
    let (average, rms_m) = (sum / seeds as f64, (square_m2 / seeds as f64).map(f64::sqrt));
    assert!((average - 3.0).abs() < 0.5, "eᵀΣ⁻¹e averages {average}, rms {rms_m:?}");
    assert!(rms_m.max() < 0.001, "{rms_m:?}");
}

#[test]
fn errors_that_neighbours_share_are_not_counted_as_independent() {
    // every roof lies elsewhere the second time, by 1 cm in each direction: no noise of points says so
    let seeds = 20;
    let (mut sum, mut effective) = (0.0, 0.0);
    for seed in 0..seeds {
        let house = |v: f64| f64::floor(v / 20.0).to_bits();
        let moved = |p: Vector3<f64>| {
            if p.z < 1.0 {
                return p - SHIFT_M;
            }
            let mut draws = Draws(mix(house(p.x) ^ house(p.y).rotate_left(20) ^ (seed << 7)));
            p + Vector3::new(draws.normal(), draws.normal(), draws.normal()) * 0.01 - SHIFT_M
        };
        let fixed = seen(village, 100.0, 2 * seed);
        let moving: Vec<Vector3<f64>> = seen(village, 100.0, 2 * seed + 1).into_iter().map(moved).collect();
        let found = put_back(&fixed, &moving, &SubmapOptions::default()).expect("registered");
        let error_m = found.shift_m - SHIFT_M;
        sum += found.held.normalised_square(&DVector::from_column_slice(error_m.as_slice()));
        #[allow(clippy::cast_precision_loss)]
        let share = found.effective_facets / found.used.len() as f64;
        effective += share;
    }
    #[allow(clippy::cast_precision_loss)]
    let (average, effective) = (sum / seeds as f64, effective / seeds as f64);
    assert!(average > 1.5 && average < 4.5, "eᵀΣ⁻¹e averages {average}");
    assert!(effective < 0.5, "{effective} of the facets count");
}

#[test]
fn a_plane_alone_holds_one_direction() {
    for seed in 0..10 {
        let moving = shifted(&seen(car_park, 60.0, 2 * seed + 1), &-SHIFT_M);
        let found = put_back(&seen(car_park, 60.0, 2 * seed), &moving, &SubmapOptions::default()).expect("registered");
        let normal = Vector3::new(-0.02, -0.01, 1.0).normalize();
        assert_eq!(found.held.rank(), 1, "{:?}", found.held);
        let along = found.held.directions.column(0).into_owned();
        assert!((Vector3::new(along[0], along[1], along[2]).dot(&normal).abs() - 1.0).abs() < 1e-4);
        let told_m = normal * normal.dot(&SHIFT_M);
        assert!((found.shift_m - told_m).norm() < 0.002, "nothing is guessed: {}", found.shift_m);
    }
}

#[test]
fn a_street_holds_two_directions_and_leaves_the_third_as_it_was() {
    for seed in 0..10 {
        let moving = shifted(&street(2 * seed + 1), &-SHIFT_M);
        let found = put_back(&street(2 * seed), &moving, &SubmapOptions::default()).expect("registered");
        assert_eq!(found.held.rank(), 2, "{:?}", found.held);
        assert!(found.held.directions.row(0).norm() < 0.01, "none along the street");
        let told_m = Vector3::new(0.0, SHIFT_M.y, SHIFT_M.z);
        assert!((found.shift_m - told_m).norm() < 0.003, "{}", found.shift_m);
    }
}

#[test]
fn a_known_turn_comes_back_with_the_shift() {
    let options = SubmapOptions { rotation: true, ..SubmapOptions::default() };
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.002, -0.003, 0.004));
    let truth = Isometry3::from_parts(Translation3::from(SHIFT_M), turn);
    let (seeds, mut sum) = (20, 0.0);
    for seed in 0..seeds {
        let away = |p: Vector3<f64>| truth.inverse_transform_point(&p.into()).coords;
        let moving: Vec<Vector3<f64>> = seen(village, 60.0, 2 * seed + 1).into_iter().map(away).collect();
        let found = put_back(&seen(village, 60.0, 2 * seed), &moving, &options).expect("registered");
        assert_eq!(found.held.rank(), 6, "{:?}", found.held);
        let off = found.fixed_from_moving * truth.inverse();
        let shift_m = off.transform_point(&found.origin_m.into()).coords - found.origin_m;
        let turn_m = off.rotation.scaled_axis() * found.gyration_m;
        sum += found.held.normalised_square(&DVector::from_iterator(6, shift_m.iter().chain(turn_m.iter()).copied()));
    }
    #[allow(clippy::cast_precision_loss)]
    let average = sum / seeds as f64;
    assert!(average > 3.5 && average < 7.5, "eᵀΣ⁻¹e averages {average}");
}

#[test]
fn neither_threads_nor_the_order_of_points_change_a_bit() {
    let (fixed, moving) = (seen(village, 60.0, 1), shifted(&seen(village, 60.0, 2), &-SHIFT_M));
    let options = SubmapOptions { rotation: true, ..SubmapOptions::default() };
    let a = put_back(&fixed, &moving, &options).expect("registered");
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let reversed: Vec<Vector3<f64>> = moving.iter().rev().copied().collect();
    let b = one.install(|| put_back(&fixed, &reversed, &options)).expect("registered");
    assert_eq!(a.fixed_from_moving, b.fixed_from_moving);
    assert_eq!((a.held, a.facets), (b.held, b.facets));
}

#[test]
fn map_coordinates_change_less_than_a_share_of_the_sigma() {
    let far = Vector3::new(4_000_000.0, 5_000_000.0, 500.0);
    let (fixed, moving) = (seen(village, 60.0, 1), shifted(&seen(village, 60.0, 2), &-SHIFT_M));
    let near = put_back(&fixed, &moving, &SubmapOptions::default()).expect("registered");
    let away =
        put_back(&shifted(&fixed, &far), &shifted(&moving, &far), &SubmapOptions::default()).expect("registered");
    assert!((near.shift_m - away.shift_m).norm() < 2e-4, "{} {}", near.shift_m, away.shift_m);
}

#[test]
fn what_cannot_be_registered_is_refused_with_its_reason() {
    let ground = seen(village, 40.0, 1);
    let none = put_back(&ground, &[], &SubmapOptions::default());
    assert_eq!(none.err(), Some(NotRegistered::NoPoints));
    let nowhere = vec![Vector3::repeat(f64::NAN); 50];
    assert!(matches!(put_back(&nowhere, &ground, &SubmapOptions::default()).err(), Some(NotRegistered::NoPoints)));
    let elsewhere = shifted(&ground, &Vector3::new(500.0, 0.0, 0.0));
    let apart = put_back(&ground, &elsewhere, &SubmapOptions::default()).err();
    assert_eq!(apart, Some(NotRegistered::TooFewFacets { found: 0, needed: 20 }));
    let mut wide = ground.clone();
    wide.push(Vector3::new(1e7, 0.0, 0.0));
    assert!(matches!(put_back(&wide, &ground, &SubmapOptions::default()).err(), Some(NotRegistered::TooWide { .. })));
    let uneven = Cloud { points_m: &ground, time_s: &[1.0] };
    let whole = vec![0.0; ground.len()];
    let even = Cloud { points_m: &ground, time_s: &whole };
    let columns = register(&uneven, &even, &SubmapOptions::default()).err();
    assert_eq!(columns, Some(NotRegistered::Columns { points: ground.len(), times: 1 }));
}

#[test]
fn points_that_are_no_numbers_are_left_out() {
    let (fixed, mut moving) = (seen(village, 60.0, 1), shifted(&seen(village, 58.0, 2), &-SHIFT_M));
    let clean = put_back(&fixed, &moving, &SubmapOptions::default()).expect("registered");
    moving.extend([Vector3::new(f64::NAN, 0.0, 0.0), Vector3::new(0.0, f64::INFINITY, 0.0)]);
    let dirty = put_back(&fixed, &moving, &SubmapOptions::default()).expect("registered");
    assert_eq!(clean.fixed_from_moving, dirty.fixed_from_moving);
}

fn tied(fixed: &[Vector3<f64>], moving: &[Vector3<f64>]) -> Vec<SubmapTie> {
    let times_s = [vec![100.0; fixed.len()], vec![500.0; moving.len()]];
    let fixed = Cloud { points_m: fixed, time_s: &times_s[0] };
    let moving = Cloud { points_m: moving, time_s: &times_s[1] };
    tie_submaps(&fixed, &moving, &TileOptions { tile_m: 40.0, ..TileOptions::default() })
}

#[test]
fn tiles_of_two_strips_are_tied_within_their_sigmas() {
    let (mut count, mut sum) = (0, 0.0);
    for seed in 0..4 {
        let moving = shifted(&seen(village, 120.0, 2 * seed + 1), &-SHIFT_M);
        for tie in tied(&seen(village, 120.0, 2 * seed), &moving).iter().filter(|t| t.rejection.is_none()) {
            let found = tie.registration.as_ref().expect("a tie");
            let error_m = found.shift_m - SHIFT_M;
            sum += found.held.normalised_square(&DVector::from_column_slice(error_m.as_slice()));
            count += found.held.rank();
        }
    }
    assert!(count >= 80, "{count} of 108 directions");
    #[allow(clippy::cast_precision_loss)]
    let average = sum / count as f64;
    assert!(average > 0.6 && average < 1.3, "eᵀΣ⁻¹e averages {average} of each direction held");
}

#[test]
fn a_tile_that_was_moved_is_told_from_the_others() {
    let off = |p: Vector3<f64>| if p.x < 40.0 && p.y < 40.0 { p + Vector3::new(0.1, 0.0, 0.0) } else { p } - SHIFT_M;
    let moving: Vec<Vector3<f64>> = seen(village, 120.0, 7).into_iter().map(off).collect();
    let found = tied(&seen(village, 120.0, 8), &moving);
    assert!(found[0].centre_m.iter().all(|c| (c - 20.0).abs() < 1e-9), "the tile that was moved");
    assert_eq!(found[0].rejection, Some(SubmapRejection::Neighbours));
    let others = found.iter().skip(1).filter(|t| t.rejection.is_none()).count();
    assert!(others >= 6, "{others} of eight whole tiles");
}

#[test]
fn a_tile_that_nobody_can_judge_is_no_tie() {
    let found = tied(&seen(village, 40.0, 1), &shifted(&seen(village, 40.0, 2), &-SHIFT_M));
    assert!(found.iter().all(|t| t.rejection.is_some()));
    assert!(found.iter().any(|t| t.rejection == Some(SubmapRejection::Alone)), "{:?}", found[0].rejection);
}

#[test]
fn carriers_tell_what_a_tilt_does_to_the_shift() {
    // a tilt about x and a turn about z of 0.2 mrad, beside a shift: displacements that differ by 2 cm over the scene
    let turn = Vector3::new(2e-4, 0.0, -1.5e-4);
    let displacement = |p: &Vector3<f64>| SHIFT_M * 0.1 + turn.cross(p);
    let fixed = seen(village, 100.0, 70);
    let straight = seen(village, 100.0, 71);
    let moving: Vec<Vector3<f64>> = straight.iter().map(|p| p + displacement(p)).collect();
    let before = put_back(&fixed, &straight, &SubmapOptions::default()).expect("registered");
    let after = put_back(&fixed, &moving, &SubmapOptions::default()).expect("registered");
    assert_eq!(after.held.rank(), 3);
    assert_eq!(after.carriers.len(), 3);
    for (e, carriers) in after.held.directions.column_iter().zip(&after.carriers) {
        let e = Vector3::new(e[0], e[1], e[2]);
        let sum: Vector3<f64> = carriers.iter().map(|c| c.along).sum();
        assert!((sum - e).norm() < 1e-9, "a shift alone is the shift");
        assert!(carriers.iter().all(|c| (c.time_s[0] - 100.0).abs() < 1e-3 && (c.time_s[1] - 500.0).abs() < 1e-3));
        let change_m = e.dot(&(after.shift_m - before.shift_m));
        let told_m: f64 = -carriers.iter().map(|c| c.along.dot(&displacement(&c.centre_m))).sum::<f64>();
        assert!((change_m - told_m).abs() < 1.5e-3, "{change_m} m, carriers say {told_m} m");
    }
}
