//! The simulator of GNSS/INS data against the mechanisation, and the filter's derivatives against differences.

use tieline_filter::state::nav_minus;
use tieline_filter::strapdown::{ImuErrors, Increment, Locality, advance};
use tieline_filter::{ImuGrade, NavState, Options, Smoother};
use tieline_simulate::navigation::{
    IncrementScenario, LoopScenario, Motion, NavigationScenario, Vehicle, ideal_increments,
};

/// Runs the mechanisation over ideal increments from the exact state.
fn mechanised(motion: &Motion, (start_s, end_s): (f64, f64), rate_hz: f64) -> NavState {
    let samples = ideal_increments(motion, (start_s - 1.0 / rate_hz, end_s), rate_hz);
    let mut nav = motion.nav_at(samples[0].time_s);
    let mut locality = Locality::at(&nav.geodetic);
    for pair in samples.windows(2) {
        let increment = Increment::new(&pair[1], Some(&pair[0]), 1.0 / rate_hz, &ImuErrors::default());
        advance(&mut nav, &increment, &mut locality);
        nav.time_s = pair[1].time_s;
    }
    nav
}

#[test]
fn error_free_increments_from_the_exact_state_stay_on_the_truth() {
    for (vehicle, name) in [(Vehicle::car(), "car"), (Vehicle::aircraft(), "aircraft")] {
        for seed in 1..4 {
            let motion = vehicle.motion((0.0, 400.0), seed);
            for rate_hz in [100.0, 200.0] {
                let end = mechanised(&motion, (200.0, 313.0), rate_hz);
                let (position, _, attitude) = nav_minus(&motion.nav_at(end.time_s), &end);
                let (horizontal_m, turned_deg) = (position.x.hypot(position.y), attitude.norm().to_degrees());
                assert!(horizontal_m < 0.005, "{name} {rate_hz} Hz: {horizontal_m} m");
                assert!(turned_deg < 1e-4, "{name} {rate_hz} Hz: {turned_deg} deg");
            }
        }
    }
}

#[test]
fn false_ties_within_an_outage_are_found_and_no_others() {
    let grade = ImuGrade::LeadorA15;
    let mut scenario = NavigationScenario::car(grade.noise(), 450.0, 3);
    scenario.imu.rate_hz = 50.0;
    scenario.gnss.outages_s = vec![(1300.0, 1413.0)];
    scenario.loops = vec![LoopScenario {
        first_s: (1338.0, 1375.0),
        again_s: vec![(1062.0, 1252.0)],
        interval_s: 2.5,
        near_m: 2.0,
        sigma_m: 0.01,
        blunders: (0.0, 0.5),
    }];
    let clean = scenario.simulate().expect("a drive").inputs;
    scenario.loops[0].blunders.0 = 0.05;
    let inputs = scenario.simulate().expect("the same drive").inputs;
    let mut options = Options::new(grade.noise());
    options.gnss.lever_arm_m = scenario.gnss.lever_arm_m;
    options.gnss.correlated_share = scenario.gnss.correlated_share;
    let solution = Smoother::run(&inputs, &options).expect("a solution");
    let is_false: Vec<bool> = inputs.ties.iter().zip(&clean.ties).map(|(a, b)| a != b).collect();
    let left_out: Vec<bool> = solution.ties.iter().map(|t| t.weights[1] < 0.5).collect();
    assert!(is_false.iter().filter(|f| **f).count() >= 2);
    assert_eq!(left_out, is_false);
}

#[test]
fn fits_of_ties_tell_their_variance() {
    let grade = ImuGrade::LeadorA15;
    let mut scenario = NavigationScenario::car(grade.noise(), 400.0, 5);
    scenario.imu.rate_hz = 50.0;
    scenario.increments = vec![IncrementScenario {
        span_s: (1020.0, 1390.0),
        interval_s: 0.5,
        apart_s: 1.0,
        sigma_m: 0.003,
        bias_m: 0.0,
        blunders: (0.0, 0.0),
    }];
    let mut inputs = scenario.simulate().expect("a drive").inputs;
    let mut options = Options::new(grade.noise());
    options.gnss.lever_arm_m = scenario.gnss.lever_arm_m;
    options.gnss.correlated_share = scenario.gnss.correlated_share;
    let mut factor = 1.0;
    let mut rescale = |by: f64| {
        inputs.ties.iter_mut().flat_map(|t| &mut t.sightings).for_each(|s| s.covariance_m2 *= by);
        let fits = Smoother::run(&inputs, &options).expect("a solution").tie_fits;
        assert!(fits.len() > 600, "{}", fits.len());
        fits.iter().map(|f| f.squared).sum::<f64>() / fits.iter().map(|f| f.redundancy).sum::<f64>()
    };
    let of_true_sigmas = rescale(1.0);
    assert!((of_true_sigmas - 1.0).abs() < 0.15, "{of_true_sigmas}");
    // told variances four times too large, the factors lead back
    let mut found = rescale(4.0);
    for _ in 0..4 {
        factor *= found;
        found = rescale(found);
    }
    assert!((4.0 * factor - 1.0).abs() < 0.2, "{factor}");
}
