//! A simulated drive obeys its own equation, and its files say what it says.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};
use tieline_filter::frames;
use tieline_filter::state::nav_minus;
use tieline_filter::strapdown::{ImuErrors, Increment, Locality, advance};
use tieline_filter::time::{ADJUSTED_OFFSET_S, SECONDS_PER_WEEK};
use tieline_io::las::{Columns, LasFile};
use tieline_io::measurements::{GnssReadOptions, ImuReadOptions, read_gnss, read_imu, read_odometer};
use tieline_io::trajectory::{ReadOptions, read};
use tieline_simulate::drive::errors_at;
use tieline_simulate::navigation::ideal_increments;
use tieline_simulate::{DriveScenario, DriveSurvey, Echo, SimulateError, simulate_drive};

const ROAD: u8 = 2;
const FACADE: u8 = 6;
const MARKING: u8 = 65;
const MANHOLE: u8 = 66;
const PARKED: u8 = 67;

/// What spoils a scenario.
type Change<'a> = &'a dyn Fn(&mut DriveScenario);

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../samples/scenarios").join(name)
}

/// The small loop with all kinds of errors, and a few pulses only.
fn small() -> DriveScenario {
    let mut scenario = DriveScenario::read(&shipped("loop.toml")).expect("a good scenario");
    for (scanner, latency_s) in scenario.scanners.iter_mut().zip([0.001, -0.002]) {
        scanner.pulse_rate_hz = 1500.0;
        scanner.latency_s = latency_s;
        scanner.lever_arm_error_m = [0.004, -0.006, 0.005];
        scanner.bias_knots_m = vec![[3.0, 0.001], [30.0, -0.002]];
    }
    scenario.output.true_points = true;
    scenario
}

fn echoes(survey: &DriveSurvey, lap: usize) -> Vec<Echo> {
    (0..survey.blocks(lap)).flat_map(|block| survey.block(lap, block)).collect()
}

#[test]
fn the_true_corrections_bring_every_point_back_to_where_it_was() {
    let mut scenario = small();
    scenario.scanners.iter_mut().for_each(|s| s.range_noise_m = 0.0);
    let survey = DriveSurvey::new(&scenario).expect("a good scenario");
    let enu_from_ned = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
    let mut largest_m = 0.0_f64;
    for echo in echoes(&survey, 1).into_iter().step_by(7) {
        let scanner = &survey.scanners()[usize::from(echo.scanner)];
        let options = &scanner.options;
        // What a user has: the delivered pose at the stamp, the nominal calibration, the delivered point.
        let pose = survey.delivered_local().pose_at(echo.time_s).expect("inside");
        let from_scanner_m = pose.body_vector_m(&echo.delivered_m) - scanner.nominal_lever_arm_m;
        let range_m = from_scanner_m.norm();
        assert!((range_m - echo.range_m).abs() < 1e-6);
        let beam = scanner.nominal_body_from_scanner.transpose() * (from_scanner_m / range_m);
        assert!(beam.x.abs() < 1e-6, "the beam is across the rotation axis: {beam}");
        assert!((beam.y - echo.scan_angle_rad.sin()).abs() < 1e-6 && (beam.z - echo.scan_angle_rad.cos()).abs() < 1e-6);
        // What an estimator has to find: boresight on the left, lever arm, latency, and measured = true + bias(true).
        let boresight = frames::rotation_from_vector(&Vector3::from(options.boresight_error_deg).map(f64::to_radians));
        let true_range_m = (0..20).fold(range_m, |r, _| range_m - scanner.bias_m(r));
        let body_m = Vector3::from(options.lever_arm_m)
            + Vector3::from(options.lever_arm_error_m)
            + boresight * scanner.nominal_body_from_scanner * beam * true_range_m;
        let (ned, turn) = survey.motion().local_pose(echo.time_s + options.latency_s);
        let back = enu_from_ned * (ned + turn * body_m);
        assert!((back - echo.true_m).norm() < 2e-5, "{}", (back - echo.true_m).norm());
        largest_m = largest_m.max((echo.delivered_m - echo.true_m).norm());
    }
    assert!(largest_m > 0.03, "the errors were there: {largest_m}");
}

#[test]
fn an_ideal_imu_on_the_drive_integrates_to_the_truth() {
    let survey = DriveSurvey::new(&small()).expect("a good scenario");
    let (start_s, end_s) = (survey.span_s().0 + 5.0, survey.span_s().1 - 1.0);
    let samples = ideal_increments(survey.motion(), (start_s, end_s), 200.0);
    let mut nav = survey.motion().nav_at(samples[0].time_s);
    let mut locality = Locality::at(&nav.geodetic);
    for pair in samples.windows(2) {
        let increment = Increment::new(&pair[1], Some(&pair[0]), 0.005, &ImuErrors::default());
        advance(&mut nav, &increment, &mut locality);
        nav.time_s = pair[1].time_s;
    }
    let (position, velocity, attitude) = nav_minus(&survey.motion().nav_at(nav.time_s), &nav);
    assert!(position.norm() < 0.01, "{position}");
    assert!(velocity.norm() < 1e-3 && attitude.norm().to_degrees() < 2e-4, "{velocity} {attitude}");
}

#[test]
fn the_delivered_trajectory_is_as_good_as_it_says() {
    let survey = DriveSurvey::new(&small()).expect("a good scenario");
    let (delivered, truth) = (survey.delivered(), survey.truth());
    let (mut sum, mut count) = (0.0, 0.0);
    for k in 0..truth.len() {
        let error = errors_at(delivered, truth, k);
        let sigma = delivered.sigma()[k].position_ned_m;
        sum += (0..3).map(|axis| (error[axis] / sigma[axis]).powi(2)).sum::<f64>();
        count += 3.0;
    }
    let ratio: f64 = sum / count;
    assert!((0.05..4.0).contains(&ratio), "mean square of error over sigma: {ratio}");
}

#[test]
fn the_streets_hold_what_they_should_and_parked_cars_are_there_in_one_pass_only() {
    let mut scenario = small();
    scenario.scanners.iter_mut().for_each(|s| s.pulse_rate_hz = 12_000.0);
    let survey = DriveSurvey::new(&scenario).expect("a good scenario");
    let laps = [echoes(&survey, 0), echoes(&survey, 1)];
    for class in [ROAD, 5, FACADE, 64, MARKING, MANHOLE, PARKED, 70, 71] {
        let count = laps[0].iter().filter(|e| e.class == class).count();
        assert!(count > 20, "class {class}: {count} points");
    }
    let mean = |class: u8| {
        let all: Vec<f64> = laps[0].iter().filter(|e| e.class == class).map(|e| f64::from(e.intensity)).collect();
        all.iter().sum::<f64>() / f64::from(u32::try_from(all.len()).expect("few"))
    };
    assert!(mean(MARKING) > 2.0 * mean(ROAD), "markings are bright: {} {}", mean(MARKING), mean(ROAD));
    let covers: Vec<_> = survey.scene().features().iter().filter(|f| f.kind == "manhole").collect();
    for echo in laps[0].iter().filter(|e| e.class == MANHOLE && e.number_of_returns == 1) {
        let apart = |f: &&&tieline_simulate::drive::scene::Feature| (f.point_m - echo.true_m).xy().norm();
        let cover = covers.iter().min_by(|a, b| apart(a).total_cmp(&apart(b))).expect("one");
        assert!(apart(&cover) < 0.35 && (cover.point_m - echo.true_m).z.abs() < 0.05, "{cover:?} {echo:?}");
    }
    let cars = |lap: usize| laps[lap].iter().filter(|e| e.class == PARKED).map(|e| e.true_m);
    let second: Vec<Vector3<f64>> = cars(1).collect();
    let (mut again, mut all) = (0, 0);
    for point in cars(0).step_by(5) {
        all += 1;
        again += u32::from(second.iter().any(|b| (point - b).norm() < 0.3));
    }
    assert!(all > 50 && again * 3 < all, "{again} of {all} points of cars are there again");
}

#[test]
fn the_files_hold_what_was_simulated_for_any_number_of_threads() {
    let scenario = small();
    let folder = tempfile::tempdir().expect("a folder");
    let run = |threads: usize| {
        let out = folder.path().join(threads.to_string());
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| simulate_drive(&scenario, &out, &mut |_, _| ())).expect("simulated")
    };
    let (one, two) = (run(1), run(2));
    let at = |name: &str| folder.path().join("1").join(name);
    for name in [
        "project.toml",
        "calibration.toml",
        "imu.txt.gz",
        "gnss.pos",
        "odometer.csv",
        "trajectory.sbet",
        "trajectory_rms.out",
        "strips/pass1.laz",
        "strips/pass2.laz",
        "truth/truth.sbet",
        "truth/calibration_true.toml",
        "truth/bias_functions.csv",
        "truth/outages.csv",
        "truth/passes.csv",
        "truth/features.csv",
        "truth/range_hist.csv",
        "truth/manifest.json",
        "truth/scenario.toml",
        "truth/strips/pass1.laz",
        "truth/strips/pass2.laz",
    ] {
        let second = std::fs::read(folder.path().join("2").join(name)).expect(name);
        assert!(std::fs::read(at(name)).expect(name) == second, "{name} depends on the number of threads");
    }
    assert_eq!((one.points(), one.strips.len()), (two.points(), 2));

    let survey = DriveSurvey::new(&scenario).expect("a good scenario");
    let expected = echoes(&survey, 0);
    let map = scenario.strip_crs().expect("a code");
    let local = scenario.local_crs().expect("a place");
    let stored = |name: &str| {
        let las = LasFile::open(&at(name)).expect("open");
        assert_eq!(las.header().point_count, expected.len() as u64);
        let mut columns = Columns::default();
        las.read_columns(0, &mut Vec::new(), &mut columns).expect("read");
        (columns, las.header().scale, las.header().offset)
    };
    let (delivered, scale, offset) = stored("strips/pass1.laz");
    let (truth, ..) = stored("truth/strips/pass1.laz");
    let shift_s = f64::from(scenario.week) * SECONDS_PER_WEEK - ADJUSTED_OFFSET_S;
    for (i, echo) in expected.iter().enumerate().take(delivered.len()).step_by(37) {
        for (columns, point_m) in [(&delivered, echo.delivered_m), (&truth, echo.true_m)] {
            let at = Vector3::new(f64::from(columns.x[i]), f64::from(columns.y[i]), f64::from(columns.z[i]));
            let at = at.component_mul(&Vector3::from(scale)) + Vector3::from(offset);
            let exact = map.map_from_geodetic(&local.geodetic_from_map(&point_m).expect("near")).expect("near");
            assert!((at - exact).amax() < 5.1e-4, "{}", at - exact);
            assert!((columns.gps_time[i] - shift_s - echo.time_s).abs() < 1e-7);
            assert_eq!((columns.scanner_channel[i], columns.user_data[i]), (echo.scanner, echo.scanner));
            assert_eq!(columns.point_source_id[i], 1);
        }
        assert_eq!((delivered.classification[i], truth.classification[i]), (0, echo.class), "classes are truth");
    }

    let imu = read_imu(&at("imu.txt.gz"), &ImuReadOptions::default()).expect("read");
    assert_eq!(imu.imu.samples(), survey.inputs().imu.samples());
    let gnss = read_gnss(&at("gnss.pos"), &GnssReadOptions::default()).expect("read");
    assert_eq!((gnss.week, gnss.fixes.len()), (Some(scenario.week), survey.inputs().gnss.len()));
    for (a, b) in gnss.fixes.iter().zip(&survey.inputs().gnss) {
        assert!((a.time_s - b.time_s).abs() < 1e-6 && (a.geodetic - b.geodetic).amax() < 1e-12);
    }
    let odometer = read_odometer(&at("odometer.csv"), None).expect("read");
    assert_eq!(odometer.samples, survey.inputs().odometer);
    let options = ReadOptions { accuracy: Some(at("trajectory_rms.out")), ..ReadOptions::default() };
    let trajectory = read(&at("trajectory.sbet"), &options).expect("read").trajectory;
    for k in (0..trajectory.len()).step_by(17) {
        let error = errors_at(&trajectory, survey.delivered(), k);
        assert!(error.iter().all(|e| e.abs() < 1e-7), "{error:?}");
    }
}

#[test]
fn a_scenario_that_makes_no_sense_says_which_key_and_what_would() {
    let message = |change: Change<'_>| {
        let mut scenario = small();
        change(&mut scenario);
        match scenario.check() {
            Err(error @ SimulateError::Scenario { .. }) => error.to_string(),
            other => panic!("{other:?}"),
        }
    };
    let cases: [(&str, Change<'_>); 10] = [
        ("drive.speed_mps = -1", &|s| s.drive.speed_mps = -1.0),
        ("drive.lap.nodes = nowhere: no [[node]]", &|s| s.drive.laps[0].nodes[1] = "nowhere".into()),
        ("drive.lap.nodes = b: a lap begins", &|s| s.drive.laps[1].nodes = vec!["b".into(), "c".into()]),
        ("street.nodes = a: two nodes", &|s| s.streets[0].nodes = vec!["a".into()]),
        ("node.name = a: this name is taken", &|s| s.nodes[1].name = "a".into()),
        ("imu.grade = superb", &|s| s.imu.grade = "superb".into()),
        ("gnss.outage.start_s = 209087: seconds since", &|s| s.gnss.outages[0].start_s = 209_087.0),
        ("scanner.latency_s = 5", &|s| s.scanners[0].latency_s = 5.0),
        ("scanner.bias_knots_m", &|s| s.scanners[0].bias_knots_m = vec![[5.0, 0.0], [2.0, 0.0]]),
        ("crs = EPSG:4326: a projected system", &|s| s.crs = "EPSG:4326".into()),
    ];
    for (expected, change) in cases {
        let found = message(change);
        assert!(found.starts_with(expected), "{found}");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scenario.toml");
    std::fs::write(&path, "[drive]\nspeed = 9.0\n").expect("written");
    let error = DriveScenario::read(&path).expect_err("an unknown key").to_string();
    assert!(error.contains("unknown field `speed`") && error.contains("speed_mps"), "{error}");
}

#[test]
fn the_shipped_scenarios_make_sense_and_the_loop_is_small_enough_to_be_shipped() {
    for name in ["loop.toml", "loop113.toml", "tunnel175.toml", "downtown.toml"] {
        DriveScenario::read(&shipped(name)).expect(name);
    }
    let scenario = DriveScenario::read(&shipped("loop.toml")).expect("a good scenario");
    let folder = tempfile::tempdir().expect("a folder");
    simulate_drive(&scenario, folder.path(), &mut |_, _| ()).expect("simulated");
    let mut bytes = 0;
    let mut folders = vec![folder.path().to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let entry = entry.expect("an entry");
            match entry.file_type().expect("a type").is_dir() {
                true => folders.push(entry.path()),
                false => bytes += entry.metadata().expect("there").len(),
            }
        }
    }
    assert!(bytes <= 4_000_000, "{bytes} bytes");
}
