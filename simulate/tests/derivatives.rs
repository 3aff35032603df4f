//! The filter's derivatives against central differences of what it really computes.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tieline_filter::kalman::Measurement;
use tieline_filter::options::{ConstraintModel, GnssModel, OdometerModel};
use tieline_filter::state::{
    ACCELEROMETER_BIAS, ACCELEROMETER_SCALE, ATTITUDE, CORE, GYRO_BIAS, GYRO_SCALE, Layout, NAV, Nominal, Optional,
    POSITION, Parameters, VELOCITY,
};
use tieline_filter::strapdown::{ImuErrors, Increment, Locality, advance};
use tieline_filter::transition::{StepSums, Transition};
use tieline_filter::update::{Motion as MotionNow, gnss, standstill, tie, vehicle};
use tieline_filter::{
    FilterTie, FixQuality, GnssFix, GnssVelocity, KnownPoint, NavState, Sighting, TieKind, ned_from_body,
};
use tieline_simulate::navigation::{Vehicle, ideal_increments};

const EVENT_DELAY_S: f64 = 0.02;

fn layout() -> Layout {
    Layout::new(&Optional {
        gnss_lever_arm: true,
        gnss_error: true,
        gnss_delay: true,
        velocity_delay: true,
        odometer_scale: true,
        mounting: true,
        slip: true,
        calibration: 3,
    })
}

fn nominal() -> Nominal {
    Nominal {
        nav: NavState {
            time_s: 100.0,
            geodetic: Vector3::new(0.83, 0.2, 400.0),
            velocity_ned_mps: Vector3::new(12.0, -7.0, 0.6),
            ned_from_body: ned_from_body(0.06, -0.04, -0.5),
        },
        parameters: Parameters {
            imu: ImuErrors::default(),
            gnss_lever_arm_m: Vector3::new(0.8, -0.4, -1.6),
            gnss_error_ned: Vector3::new(0.4, -0.8, 1.1),
            gnss_delay_s: EVENT_DELAY_S,
            velocity_delay_s: EVENT_DELAY_S,
            odometer_scale: 0.004,
            mounting_rad: [0.01, -0.015],
            slip_mps: [0.03, -0.02],
        },
    }
}

fn motion() -> MotionNow {
    MotionNow { rate_body_radps: Vector3::new(0.05, -0.03, 0.3), acceleration_ned_mps2: Vector3::new(1.2, -0.7, 0.2) }
}

/// Compares rows with differences of the residual; states that a residual does not depend on must have no entry.
fn compare(name: &str, of: impl Fn(&Nominal, &MotionNow) -> Measurement, tolerance: f64) {
    let layout = layout();
    let rows = of(&nominal(), &motion()).rows;
    for state in 0..layout.base {
        let step = 1e-4;
        let at = |sign: f64| {
            let mut error = vec![0.0; layout.base];
            error[state] = sign * step;
            let mut moved = nominal();
            moved.shift(&layout, &error);
            // a gyro bias greater by δ makes the rate smaller by δ
            let mut motion = motion();
            motion.rate_body_radps -= moved.parameters.imu.gyro_bias_radps;
            of(&moved, &motion).residual
        };
        let (plus, minus) = (at(1.0), at(-1.0));
        for (i, row) in rows.iter().enumerate() {
            let analytic: f64 = row.iter().filter(|e| e.0 == state).map(|e| e.1).sum();
            let numeric = -(plus[i] - minus[i]) / (2.0 * step);
            assert!(
                (analytic - numeric).abs() < tolerance * numeric.abs().max(1.0),
                "{name}, row {i}, {}: {analytic} and {numeric}",
                layout.names()[state]
            );
        }
    }
}

fn fix() -> GnssFix {
    GnssFix {
        time_s: 100.0,
        geodetic: nominal().nav.geodetic + Vector3::new(2e-7, -1e-7, 1.0),
        covariance_ned_m2: Matrix3::from_diagonal(&Vector3::new(0.01, 0.02, 0.04)),
        velocity: None,
        quality: FixQuality::Fixed,
    }
}

#[test]
fn rows_of_gnss_and_known_points_equal_central_differences() {
    let model = GnssModel::default();
    let measured =
        GnssVelocity { ned_mps: Vector3::new(11.0, -7.5, 0.5), covariance_m2ps2: Matrix3::identity() * 0.01 };
    let point = KnownPoint {
        time_s: 100.0,
        geodetic: fix().geodetic,
        covariance_ned_m2: Matrix3::identity() * 1e-4,
        body_vector_m: Vector3::new(4.0, -2.0, 1.5),
    };
    let sigma_m = Vector3::new(0.01, 0.02, 0.03);
    compare("position", |n, m| gnss::position(n, &layout(), &fix(), &model, &sigma_m, m, EVENT_DELAY_S), 1e-5);
    compare("velocity", |n, m| gnss::velocity(n, &layout(), &measured, &model, m, EVENT_DELAY_S), 1e-5);
    compare("known point", |n, _| gnss::known_point(n, &point), 1e-5);
}

#[test]
fn rows_of_odometer_constraint_and_rest_equal_central_differences() {
    let odometer = OdometerModel { lever_arm_m: Vector3::new(-1.2, 0.7, 0.9), noise_mps: 0.02, scale_sigma: 0.01 };
    let constraint = ConstraintModel { lever_arm_m: Vector3::new(-1.2, 0.0, 0.9), ..ConstraintModel::default() };
    compare("odometer", |n, m| vehicle::odometer(n, &layout(), 13.0, &odometer, m, 4e-4), 1e-5);
    compare("constraint", |n, m| vehicle::constraint(n, &layout(), &constraint, m), 1e-5);
    compare("zero velocity", |n, _| standstill::velocity(n, 0.005), 1e-7);
    let base = layout().base;
    let clone = [base, base + 1, base + 2];
    let then = nominal().nav.ned_from_body;
    compare("zero rotation, now", |n, _| standstill::rotation(n, &then, clone, 1e-4), 1e-6);
    // the clone is the attitude then: turning it turns the residual the other way
    let rows = standstill::rotation(&nominal(), &then, clone, 1e-4).rows;
    for (k, at) in clone.iter().enumerate() {
        let turned = |sign: f64| {
            let error = UnitQuaternion::from_scaled_axis(Vector3::ith(k, sign * 1e-4));
            standstill::rotation(&nominal(), &(error * then), clone, 1e-4).residual
        };
        let (plus, minus) = (turned(1.0), turned(-1.0));
        for (i, row) in rows.iter().enumerate() {
            let analytic: f64 = row.iter().filter(|e| e.0 == *at).map(|e| e.1).sum();
            let numeric = -(plus[i] - minus[i]) / 2e-4;
            assert!((analytic - numeric).abs() < 1e-6, "clone {k}, row {i}: {analytic} and {numeric}");
        }
    }
}

#[test]
fn rows_of_ties_equal_central_differences() {
    let sighting = Sighting {
        time_s: 100.0,
        body_vector_m: Vector3::new(25.0, -14.0, 3.0),
        covariance_m2: Matrix3::new(4e-4, 1e-4, 0.0, 1e-4, 9e-4, 0.0, 0.0, 0.0, 1e-4),
        by_constant: vec![(1, Vector3::new(0.3, -0.2, 0.9)), (2, Vector3::new(-0.5, 0.1, 0.4))],
    };
    let directions = vec![
        Vector3::new(0.3, -0.5, 0.8).normalize(),
        Vector3::new(0.8, 0.6, 0.1).normalize(),
        Vector3::new(-0.2, 0.5, 0.4).normalize(),
    ];
    let tie = FilterTie {
        id: 0,
        kind: TieKind::XyzPoint,
        directions,
        sightings: vec![sighting.clone(), sighting.clone(), sighting.clone()],
        known_m: None,
    };
    let origin = tieline_filter::earth::ecef_from_geodetic(&(nominal().nav.geodetic + Vector3::new(1e-5, 1e-5, 3.0)));
    let base = layout().base;
    let values_now = tie::coordinates(&nominal(), &tie, &sighting, &origin, (0.0, None)).0;
    let noise = tie::noise(&tie, &sighting);
    let landmark = |n: &Nominal| {
        let (values, rows) = tie::coordinates(n, &tie, &sighting, &origin, (0.0, None));
        tie::against_landmark(&values, &rows, &noise, &[base, base + 1, base + 2], &values_now)
    };
    compare("landmark", |n, _| landmark(n), 2e-5);
    let clones = [
        (0, vec![base, base + 1, base + 2], values_now.clone()),
        (1, vec![base + 3, base + 4, base + 5], values_now.clone()),
    ];
    let all = |n: &Nominal| {
        let (values, rows) = tie::coordinates(n, &tie, &sighting, &origin, (0.0, None));
        tie::all_at_once(&tie, 2, &values, &rows, &clones)
    };
    compare("delayed", |n, _| all(n), 2e-5);
    // landmark and clones are coordinates themselves: what they grow by, the residual grows by
    for (row, slot) in landmark(&nominal()).rows.iter().zip([base, base + 1, base + 2]) {
        assert_eq!(row.last(), Some(&(slot, -1.0)));
    }
    for (row, slot) in all(&nominal()).rows.iter().zip(base..base + 6) {
        assert_eq!(row.last(), Some(&(slot, -1.0)));
    }
}

/// A unit of each core state that matters about as much as that of any other, over a second.
fn unit_of(state: usize) -> f64 {
    match state {
        POSITION..VELOCITY => 10.0,
        VELOCITY..ATTITUDE => 1.0,
        ATTITUDE..GYRO_BIAS => 1e-3,
        GYRO_BIAS..ACCELEROMETER_BIAS => 1e-3,
        ACCELEROMETER_BIAS..GYRO_SCALE => 1e-2,
        GYRO_SCALE..ACCELEROMETER_SCALE => 1e-2,
        _ => 1e-3,
    }
}

#[test]
fn the_transition_equals_central_differences_of_the_mechanisation() {
    for vehicle in [Vehicle::car(), Vehicle::aircraft()] {
        let truth = vehicle.motion((0.0, 200.0), 1);
        for start_s in [80.0, 100.0, 131.0] {
            let samples = ideal_increments(&truth, (start_s - 0.005, start_s + 0.05), 200.0);
            let layout = Layout::new(&Optional::default());
            let begin = Nominal { nav: truth.nav_at(start_s), parameters: Parameters::default() };
            let mut sums = StepSums::default();
            let run = |nominal: &Nominal, sums: &mut StepSums| {
                let mut end = *nominal;
                let mut locality = Locality::at(&end.nav.geodetic);
                for pair in samples.windows(2) {
                    let increment = Increment::new(&pair[1], Some(&pair[0]), 0.005, &end.parameters.imu);
                    let trace = advance(&mut end.nav, &increment, &mut locality);
                    sums.add(&increment, &trace);
                }
                end
            };
            let end = run(&begin, &mut sums);
            let transition = Transition::of(&sums, &end.nav, &Locality::at(&end.nav.geodetic), layout.base);
            for state in 0..CORE {
                let step = unit_of(state);
                let at = |sign: f64| {
                    let mut error = vec![0.0; layout.base];
                    error[state] = sign * step;
                    let mut moved = begin;
                    moved.shift(&layout, &error);
                    run(&moved, &mut StepSums::default()).minus(&end, &layout)
                };
                let (plus, minus) = (at(1.0), at(-1.0));
                for row in 0..NAV {
                    let numeric = (plus[row] - minus[row]) / 2.0;
                    let analytic = transition.nav[row][state] * step;
                    // per cent of the change, or what no filter notices over 0.05 s: micrometres, 10 µm/s, 1e-9 rad
                    let floor = [1e-6, 1e-5, 1e-9][row / 3];
                    assert!(
                        (analytic - numeric).abs() < 0.01 * numeric.abs() + floor,
                        "{start_s} s, row {row}, {}: {analytic:e} and {numeric:e}",
                        layout.names()[state]
                    );
                }
            }
        }
    }
}
