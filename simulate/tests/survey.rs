//! The simulated survey obeys its own equation, and its files say what it says.

use nalgebra::{Matrix3, Vector3};
use tieline_filter::time::{ADJUSTED_OFFSET_S, SECONDS_PER_WEEK};
use tieline_filter::{Pose, frames};
use tieline_io::crs::Crs;
use tieline_io::las::{Columns, LasFile};
use tieline_io::trajectory::{ReadOptions, read};
use tieline_simulate::scenario::{LineGroup, ScannerKind, ScannerOptions, TrajectoryErrors};
use tieline_simulate::{Echo, Scenario, Survey, simulate};

const GROUND: u8 = 2;
const VEGETATION: u8 = 5;
const BUILDING: u8 = 6;
const ROAD: u8 = 11;

/// Two scanners, two crossing lines, everything wrong but no noise.
fn without_noise() -> Scenario {
    let mut scenario = Scenario::airborne_sample();
    let first = ScannerOptions {
        range_noise_m: 0.0,
        angular_noise_deg: 0.0,
        pulse_rate_hz: 9_000.0,
        boresight_deg: [0.1, -0.2, 0.3],
        range_scale_ppm: 400.0,
        ..scenario.scanners[0].clone()
    };
    let second = ScannerOptions {
        kind: ScannerKind::Oscillating,
        mounting_deg: [3.0, 12.0, -20.0],
        lever_arm_m: [-0.4, 0.3, 0.1],
        pulse_rate_hz: 7_000.0,
        ..first.clone()
    };
    scenario.scanners = vec![first, second];
    scenario.world.ground_roughness_m = 0.0;
    scenario.flight.groups = vec![
        LineGroup { direction_deg: 20.0, height_m: 350.0, lines: 2, spacing_m: 60.0, offset_m: 0.0 },
        LineGroup { direction_deg: 110.0, height_m: 500.0, lines: 1, ..LineGroup::default() },
    ];
    scenario
}

fn without_errors() -> Scenario {
    let mut scenario = without_noise();
    for scanner in &mut scenario.scanners {
        scanner.boresight_error_deg = [0.0; 3];
        scanner.lever_arm_error_m = [0.0; 3];
        scanner.range_offset_m = 0.0;
        scanner.range_scale_ppm = 0.0;
    }
    scenario.errors = TrajectoryErrors {
        position_constant_sd_m: 0.0,
        position_linear_sd_m: 0.0,
        attitude_constant_sd_deg: 0.0,
        attitude_linear_sd_deg: 0.0,
    };
    scenario
}

fn echoes(survey: &Survey, strip: usize) -> Vec<Echo> {
    (0..survey.blocks(strip)).flat_map(|block| survey.block(strip, block)).collect()
}

fn map_from_body(pose: &Pose) -> Matrix3<f64> {
    pose.map_from_ned * pose.ned_from_body.to_rotation_matrix().into_inner()
}

#[test]
fn without_errors_and_noise_the_delivered_points_lie_on_the_world() {
    let survey = Survey::new(&without_errors()).expect("a good scenario");
    let mut classes = [0; 12];
    for strip in 0..survey.lines().len() {
        for echo in echoes(&survey, strip) {
            classes[usize::from(echo.class)] += 1;
            assert!((echo.delivered_m - echo.true_m).norm() < 1e-6, "{echo:?}");
            if echo.class != VEGETATION {
                assert!(survey.world().distance_to_surface_m(&echo.delivered_m) < 1e-3, "{echo:?}");
            }
        }
    }
    for class in [GROUND, VEGETATION, BUILDING, ROAD] {
        assert!(classes[usize::from(class)] > 300, "class {class}: {classes:?}");
    }
}

#[test]
fn the_true_corrections_bring_every_point_back_to_where_it_was() {
    let survey = Survey::new(&without_noise()).expect("a good scenario");
    let mut largest_m = 0.0_f64;
    for strip in 0..survey.lines().len() {
        let error = survey.truth().strips[strip];
        for echo in echoes(&survey, strip) {
            largest_m = largest_m.max((echo.delivered_m - echo.true_m).norm());
            let scanner = &survey.scanners()[usize::from(echo.scanner)];
            // What a user has: the delivered pose, the nominal calibration, the delivered point.
            let pose = survey.delivered_trajectory().pose_at(echo.time_s).expect("inside");
            let from_scanner_m = pose.body_vector_m(&echo.delivered_m) - scanner.nominal_lever_arm_m;
            let range_m = from_scanner_m.norm();
            assert!((range_m - echo.range_m).abs() < 1e-6);
            // What an estimator has to find, put into the equation.
            let truth = &scanner.truth;
            let beam = scanner.true_body_from_scanner
                * scanner.nominal_body_from_scanner.transpose()
                * (from_scanner_m / range_m);
            let true_range_m = range_m + truth.range_offset_m + truth.range_scale * range_m;
            let ned = error.position_ned_m(echo.time_s);
            let position = pose.position - Vector3::new(ned.y, ned.x, -ned.z);
            let turn = frames::rotation_from_vector(&-error.rotation_ned_rad(echo.time_s));
            let map_from_body = pose.map_from_ned * turn * pose.ned_from_body.to_rotation_matrix().into_inner();
            let back = position + map_from_body * (truth.lever_arm_m + beam * true_range_m);
            assert!((back - echo.true_m).norm() < 1e-5, "{}", (back - echo.true_m).norm());
        }
    }
    assert!(largest_m > 0.1, "the errors were there: {largest_m}");
}

#[test]
fn the_rays_of_two_returns_meet_in_the_scanner() {
    let survey = Survey::new(&without_noise()).expect("a good scenario");
    let mut pairs = 0;
    for pair in echoes(&survey, 0).windows(2) {
        let [first, last] = [pair[0], pair[1]];
        if first.number_of_returns == 2 && last.return_number == 2 && (first.time_s - last.time_s).abs() < 1e-9 {
            pairs += 1;
            let pose = survey.delivered_trajectory().pose_at(first.time_s).expect("inside");
            let scanner = &survey.scanners()[usize::from(first.scanner)];
            let origin = pose.position + map_from_body(&pose) * scanner.nominal_lever_arm_m;
            let along = (first.delivered_m - last.delivered_m).normalize();
            let aside = (origin - last.delivered_m).cross(&along).norm();
            assert!(aside < 1e-4 && first.range_m < last.range_m, "{aside}");
        }
    }
    assert!(pairs > 50, "{pairs} pairs");
}

#[test]
fn a_moving_object_is_there_in_one_strip_only() {
    let mut scenario = without_errors();
    scenario.world.buildings = 0;
    scenario.world.moving_objects = 80;
    let survey = Survey::new(&scenario).expect("a good scenario");
    let cars = |strip| echoes(&survey, strip).into_iter().filter(|e| e.class == BUILDING).map(|e| e.true_m);
    let (first, second): (Vec<_>, Vec<_>) = (cars(0).collect(), cars(1).collect());
    assert!(first.len() > 50 && second.len() > 50, "{} {}", first.len(), second.len());
    let near = |a: &Vector3<f64>| second.iter().any(|b| (a - b).norm() < 0.5);
    assert!(first.iter().filter(|a| near(a)).count() * 5 < first.len(), "cars of one strip are gone in the next");
}

#[test]
fn the_files_hold_what_was_simulated_for_any_number_of_threads() {
    let scenario = without_noise();
    let folder = tempfile::tempdir().expect("a folder");
    let run = |threads: usize| {
        let out = folder.path().join(threads.to_string());
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| simulate(&scenario, &out)).expect("simulated")
    };
    let (one, two) = (run(1), run(2));
    assert_eq!(one.strips.len(), 3);
    for (a, b) in one.strips.iter().zip(&two.strips) {
        assert_eq!(std::fs::read(&a.path).expect("read"), std::fs::read(&b.path).expect("read"));
    }
    for name in ["trajectory.sbet", "trajectory_rms.out", "project.toml", "truth/strip_errors.csv"] {
        let of = |out: &str| std::fs::read(folder.path().join(out).join(name)).expect(name);
        assert_eq!(of("1"), of("2"), "{name}");
    }

    let survey = Survey::new(&scenario).expect("a good scenario");
    let local = scenario.local_crs().expect("a place");
    let options = ReadOptions { accuracy: Some(folder.path().join("1/trajectory_rms.out")), ..ReadOptions::default() };
    let file = read(&folder.path().join("1/trajectory.sbet"), &options).expect("read");
    assert!(file.notes.is_empty(), "{:?}", file.notes);
    let map = file.to_map(&local).expect("converted");
    assert_eq!(map.len(), survey.delivered_trajectory().len());
    for i in (0..map.len()).step_by(13) {
        assert!((map.position()[i] - survey.delivered_trajectory().position()[i]).norm() < 1e-7);
        assert!(map.ned_from_body()[i].angle_to(&survey.delivered_trajectory().ned_from_body()[i]) < 1e-11);
    }
    let rms = (0.05_f64.powi(2) + 0.02_f64.powi(2) / 3.0).sqrt();
    assert!((map.sigma()[20].position_ned_m.x - rms).abs() < 1e-12);

    let las = LasFile::open(&one.strips[1].path).expect("open");
    let header = las.header();
    let mut columns = Columns::default();
    las.read_columns(0, &mut Vec::new(), &mut columns).expect("read");
    let expected = echoes(&survey, 1);
    assert_eq!(header.point_count, one.strips[1].points);
    assert_eq!(header.point_count, expected.len() as u64);
    let shift_s = f64::from(scenario.week) * SECONDS_PER_WEEK - ADJUSTED_OFFSET_S;
    for (i, echo) in expected.iter().take(columns.len()).enumerate() {
        let stored = Vector3::new(f64::from(columns.x[i]), f64::from(columns.y[i]), f64::from(columns.z[i])) * 0.001;
        assert!((stored - echo.delivered_m).amax() < 5.1e-4);
        assert!((columns.gps_time[i] - shift_s - echo.time_s).abs() < 1e-7);
        assert_eq!((columns.scanner_channel[i], columns.point_source_id[i]), (echo.scanner, 2));
        assert_eq!((columns.return_number[i], columns.classification[i]), (echo.return_number, echo.class));
    }
}

#[test]
fn strips_in_a_map_projection_are_the_local_ones_projected() {
    let folder = tempfile::tempdir().expect("a folder");
    let scenario = Scenario { crs: "EPSG:32632".into(), ..without_noise() };
    let report = simulate(&scenario, folder.path()).expect("simulated");
    let (utm, local) = (Crs::parse("EPSG:32632").expect("a code"), scenario.local_crs().expect("a place"));
    let las = LasFile::open(&report.strips[0].path).expect("open");
    let (scale, offset) = (las.header().scale, las.header().offset);
    let mut columns = Columns::default();
    las.read_columns(0, &mut Vec::new(), &mut columns).expect("read");
    let survey = Survey::new(&scenario).expect("a good scenario");
    for (i, echo) in echoes(&survey, 0).iter().enumerate().take(columns.len()).step_by(101) {
        let stored = Vector3::new(
            f64::from(columns.x[i]) * scale[0] + offset[0],
            f64::from(columns.y[i]) * scale[1] + offset[1],
            f64::from(columns.z[i]) * scale[2] + offset[2],
        );
        let expected = utm.map_from_geodetic(&local.geodetic_from_map(&echo.delivered_m).expect("near")).expect("near");
        assert!((stored - expected).amax() < 6e-4, "{}", stored - expected);
    }
}
