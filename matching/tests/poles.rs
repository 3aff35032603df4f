//! Posts and trunks, found and matched between sightings whose truth is known.

mod common;

use common::Draws;
use nalgebra::{Vector2, Vector3};
use tieline_matching::SourceKey;
use tieline_matching::xyz::{
    AgreeOptions, FeatureTie, NotTied, Pole, PoleOptions, PostKeeper, PostPoints, agree, match_poles, poles,
};

const NOISE_M: f64 = 0.005;
const SHIFT_M: Vector3<f64> = Vector3::new(0.21, -0.17, 0.04);

/// A post: foot, lean, radius \[m\].
#[derive(Clone, Copy)]
struct Post {
    foot_m: Vector3<f64>,
    lean: Vector2<f64>,
    radius_m: f64,
}

/// A street of posts 6 m apart, some lean a little.
fn street() -> Vec<Post> {
    (0..14)
        .map(|k| Post {
            foot_m: Vector3::new(6.13 * f64::from(k) + 0.7, 0.31 * f64::from(k % 5), 0.02 * f64::from(k)),
            lean: Vector2::new(0.004 * f64::from(k % 4), -0.003 * f64::from(k % 3)),
            radius_m: 0.05 + 0.01 * f64::from(k % 9),
        })
        .collect()
}

/// What a scanner that passes at `way_m` in y sees of posts: some 60 points on the near side of each, from 0.6 m to 3.4 m.
fn seen(keeper: &mut PostKeeper, posts: &[Post], strip: u16, way_m: f64, seed: u64, shift_m: &Vector3<f64>) {
    let mut draws = Draws(seed << 32);
    for post in posts {
        // seen obliquely: the plane of the scanner stands at 45° to the way
        let away = Vector2::new(1.0, if way_m < 0.0 { 1.0 } else { -1.0 }).normalize();
        let across = Vector2::new(-away.y, away.x);
        // out of round, and what all points have in common, as sigmas count them
        let radius_m = post.radius_m + 0.0005 * draws.normal();
        let common_m = away * (0.00025 * draws.normal()) + across * (0.00025 * draws.normal());
        for _ in 0..60 {
            let up_m = 0.6 + 2.8 * draws.uniform();
            let u = (2.0 * draws.uniform() - 1.0) * radius_m;
            let depth_m = -(radius_m.powi(2) - u * u).max(0.0).sqrt() + NOISE_M * draws.normal();
            let plan = post.foot_m.xy() + post.lean * up_m + away * depth_m + across * u + common_m;
            let point = Vector3::new(plan.x, plan.y, post.foot_m.z + up_m) - shift_m;
            let time_s = 100.0 * f64::from(strip) + (post.foot_m.x + 0.3 * up_m) / 10.0;
            let whose = (time_s, SourceKey::new(0, strip, 0));
            keeper.keep(point.into(), whose, away.x.atan2(away.y), 900).expect("kept");
        }
    }
}

fn found(keeper: PostKeeper) -> Vec<Pole> {
    poles(&PostPoints::new(vec![keeper]), &PoleOptions::default()).expect("read")
}

fn tied(poles: &[Pole]) -> Vec<FeatureTie> {
    let whose = |source: SourceKey, _: f64| Some((u32::from(source.point_source_id()), 0));
    let mut ties = match_poles(poles, &whose, &|_, _| 0.6, 0.6, 0.012);
    agree(&mut ties, &AgreeOptions::default());
    ties
}

fn matched(first: &[Post], second: &[Post], ways_m: [f64; 2], seed: u64) -> Vec<FeatureTie> {
    let mut keeper = PostKeeper::new(500);
    seen(&mut keeper, first, 1, ways_m[0], 2 * seed + 1, &Vector3::zeros());
    seen(&mut keeper, second, 2, ways_m[1], 2 * seed + 2, &SHIFT_M);
    tied(&found(keeper))
}

fn accepted(ties: &[FeatureTie]) -> Vec<&FeatureTie> {
    ties.iter().filter(|t| t.rejection.is_none()).collect()
}

#[test]
fn posts_come_back_with_their_axis_and_radius() {
    let mut keeper = PostKeeper::new(1000);
    seen(&mut keeper, &street(), 1, -5.0, 3, &Vector3::zeros());
    let mut found = found(keeper);
    found.sort_by(|a, b| a.point_m.x.total_cmp(&b.point_m.x));
    assert_eq!(found.len(), street().len());
    for (pole, post) in found.iter().zip(street()) {
        let at = post.foot_m.xy() + post.lean * (pole.point_m.z - post.foot_m.z);
        let off_m = (pole.point_m.xy() - at).norm();
        assert!(off_m < 0.01, "{off_m} {pole:?}");
        assert!((pole.radius_m - post.radius_m).abs() < 5.0 * pole.covariance[(4, 4)].sqrt(), "{pole:?}");
        assert!((pole.lean - post.lean).norm() < 0.01, "{pole:?}");
    }
}

/// Mean of eᵀΣ⁻¹e and rms of a component \[m\] over seeds.
fn statistics(ways_m: [f64; 2]) -> (f64, f64, usize) {
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0);
    for seed in 0..8 {
        let ties = matched(&street(), &street(), ways_m, seed);
        for tie in accepted(&ties) {
            let held = tie.held();
            let e = nalgebra::Vector2::new(
                held[0].dot(&(tie.shift_m() + SHIFT_M)),
                held[1].dot(&(tie.shift_m() + SHIFT_M)),
            );
            // the heights at which places are given are the second's, moved by the shift: posts lean by 15 mm a metre at most
            let c = tie.covariance_m2();
            let c = nalgebra::Matrix2::from_fn(|i, k| held[i].dot(&(c * held[k])));
            sum += e.dot(&(c.try_inverse().expect("of rank 2") * e));
            squares += 0.5 * e.norm_squared();
            count += 1;
        }
    }
    (sum / count as f64, (squares / count as f64).sqrt(), count)
}

#[test]
fn posts_are_tied_within_their_sigmas_from_one_side_and_from_both() {
    for ways_m in [[-5.0, -4.0], [-5.0, 5.0]] {
        let (square, rms_m, count) = statistics(ways_m);
        assert!((1.65..2.35).contains(&square), "{ways_m:?}: {square} over {count}, rms {rms_m}");
        assert!(rms_m < 0.004 && count > 80, "{ways_m:?}: rms {rms_m} over {count}");
    }
}

#[test]
fn a_post_that_was_put_elsewhere_is_refused() {
    let mut moved = street();
    moved[5].foot_m += Vector3::new(0.15, 0.1, 0.0);
    let ties = matched(&street(), &moved, [-5.0, -5.0], 4);
    let at = |tie: &&FeatureTie| (tie.ends[0].place_m - street()[5].foot_m).xy().norm() < 0.5;
    let of_it: Vec<_> = ties.iter().filter(at).map(|t| t.rejection).collect();
    assert_eq!(of_it, [Some(NotTied::Neighbours)]);
    assert!(accepted(&ties).len() >= 11);
}

#[test]
fn two_posts_within_the_search_are_told_apart_or_refused() {
    let mut twins = street();
    twins.extend(street().iter().map(|p| Post { foot_m: p.foot_m + Vector3::new(1.0, 0.2, 0.0), ..*p }));
    let ties = matched(&twins, &twins, [-5.0, -5.0], 6);
    let wrong = accepted(&ties).iter().filter(|t| (t.shift_m() + SHIFT_M).xy().norm() > 0.05).count();
    assert_eq!(wrong, 0);
}

#[test]
fn walls_hedges_and_cars_are_no_poles() {
    let mut draws = Draws(77 << 32);
    let mut keeper = PostKeeper::new(100_000);
    let mut put = |x: f64, y: f64, z: f64, k: u32| {
        let whose = (f64::from(k) * 1e-4, SourceKey::new(0, 1, 0));
        keeper.keep([x, y, z], whose, 0.8, 500).expect("kept");
    };
    for k in 0..40_000_u32 {
        let (u, v, w) = (draws.uniform(), draws.uniform(), draws.uniform());
        match k % 4 {
            0 => put(20.0 * u, 5.0 + NOISE_M * draws.normal(), 4.0 * v, k),
            1 => put(2.0 + 3.0 * u, 1.0 + 0.8 * v, 1.2 * w, k),
            2 => put(9.0 + 1.8 * u, 1.0, 0.4 + 1.0 * v, k),
            // the reveal of a door
            _ => put(15.0, 5.0 + 0.2 * u, 2.2 * v, k),
        }
    }
    let found = found(keeper);
    assert!(found.is_empty(), "{found:?}");
}
