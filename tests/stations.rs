//! Calibration of scanners from stations without a trajectory: known extrinsics come back, and what cannot be seen is said.
#![allow(clippy::expect_used, clippy::cast_precision_loss)]

mod street;

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use street::{Moving, Random, heads, plain, rough, street, survey};
use tieline::report::stations::data::discrepancies;
use tieline::stage::stations::sight::Grade;
use tieline::stage::stations::{Mounts, StationOptions, StationsSolution, calibrate};

/// Estimate minus truth of every unknown, over its sigma.
fn errors(mounts: &Mounts, solution: &StationsSolution) -> Vec<(f64, f64)> {
    let truth = heads();
    let mut errors = Vec::new();
    for (i, head) in mounts.heads.iter().enumerate().filter(|(i, _)| *i != mounts.reference) {
        let c = &solution.corrections[i];
        let found = UnitQuaternion::from(Rotation3::new(c.boresight_rad)) * head.body_from_scanner;
        let turn = (found * truth[i].body_from_scanner.inverse()).scaled_axis();
        let shift: Vector3<f64> = head.lever_arm_m + c.lever_arm_m - truth[i].lever_arm_m;
        errors.extend(turn.iter().chain(shift.iter()).copied());
    }
    errors.into_iter().enumerate().map(|(i, e)| (e, solution.covariance[(i, i)].sqrt())).collect()
}

fn run(seed: u64, moving: Moving) -> (Mounts, StationsSolution) {
    let mut random = Random::new(seed);
    let stations = survey(&street(), moving, 0.015, &mut random);
    let mounts = rough(&mut random, 1.5, 0.15);
    let solution = calibrate(&stations, &mounts, &StationOptions::default()).expect("calibrated");
    (mounts, solution)
}

#[test]
fn known_extrinsics_come_back_within_their_sigmas() {
    const SEEDS: u64 = 24;
    let moving = |seed| match seed % 3 {
        0 => Moving::default(),
        1 => Moving { forward_mps: 0.4, yaw_rate_radps: 0.05 },
        _ => Moving { forward_mps: -0.2, yaw_rate_radps: -0.08 },
    };
    let all: Vec<(f64, f64)> = (1..=SEEDS)
        .into_par_iter()
        .map(|seed| {
            let (mounts, solution) = run(seed, moving(seed));
            errors(&mounts, &solution)
        })
        .collect::<Vec<_>>()
        .concat();
    let inside = all.iter().filter(|(e, s)| e.abs() <= 1.96 * s).count() as f64 / all.len() as f64;
    let worst = all.iter().map(|(e, s)| e.abs() / s).fold(0.0, f64::max);
    let worst_deg =
        all.iter().enumerate().filter(|(i, _)| i % 6 < 3).map(|(_, e)| e.0.abs().to_degrees()).fold(0.0, f64::max);
    assert!((0.90..=0.99).contains(&inside), "{inside} of {} values, worst {worst} sigma, {worst_deg} deg", all.len());
    assert!(worst < 5.0 && worst_deg < 0.15, "{worst} sigma, {worst_deg} deg");
}

#[test]
fn held_out_planes_agree_as_well_as_those_in_use() {
    let (_, solution) = run(7, Moving::default());
    let d = discrepancies(&solution.planes.iter());
    assert!(d.before.sigma_mad_m > 0.05 && d.after.sigma_mad_m < 0.012, "{d:?}");
    assert!(d.held_out_after.sigma_mad_m < 1.5 * d.after.sigma_mad_m && d.held_out_after.n > 20, "{d:?}");
    let share = d.held_out_after.n as f64 / (d.held_out_after.n + d.after.n) as f64;
    assert!((0.12..0.28).contains(&share), "{share}");
    assert!(solution.motion_test.is_some_and(|t| t < 1.0), "at rest: {:?}", solution.motion_test);
}

#[test]
fn level_ground_alone_does_not_see_yaw_nor_horizontal_offsets() {
    let mut random = Random::new(3);
    let stations = survey(&plain(), Moving::default(), 0.015, &mut random);
    let mounts = rough(&mut random, 0.5, 0.1);
    let solution = calibrate(&stations, &mounts, &StationOptions::default()).expect("calibrated");
    for (i, name) in ["roll", "pitch", "yaw", "forward", "right", "down"].iter().enumerate() {
        for scanner in 0..2 {
            let share = solution.sight.share[6 * scanner + i];
            let seen = ["roll", "pitch", "down"].contains(name);
            assert_eq!(share > 0.5, seen, "{name} of scanner {}: {share}", scanner + 1);
        }
    }
    assert_eq!(solution.sight.directions.iter().filter(|d| d.grade == Grade::NotSeen).count(), 6);
    let words = solution.sight.words(&mounts, &solution.parameters).join("\n");
    for word in
        ["not seen: left", "not seen: right", "boresight yaw", "lever arm forward", "lever arm right", "in common"]
    {
        assert!(words.contains(word), "{word}: {words}");
    }
    // what is not seen stays near the rough value, and its sigma says so
    assert!(errors(&mounts, &solution).iter().all(|(e, s)| e.abs() < 4.0 * s));
}

#[test]
fn the_same_result_for_any_number_of_threads() {
    let solve = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| run(5, Moving::default()).1)
    };
    let (a, b) = (solve(1), solve(2));
    assert!(a.values.iter().zip(&b.values).all(|(x, y)| x.to_bits() == y.to_bits()) && a.planes == b.planes);
}

#[test]
fn scanners_that_see_nothing_in_common_are_named() {
    let mut random = Random::new(1);
    let mut stations = survey(&plain(), Moving::default(), 0.015, &mut random);
    for station in &mut stations {
        // the right scanner looks at the sky
        station.spins[2].points_m.iter_mut().for_each(|p| *p *= -1.0);
    }
    let mounts = rough(&mut random, 0.5, 0.1);
    let message = calibrate(&stations, &mounts, &StationOptions::default()).expect_err("refused").to_string();
    for word in ["scanner 2 (right)", "no plane in common", "overlap", "boresight_sigma_deg"] {
        assert!(message.contains(word), "{word}: {message}");
    }
}
