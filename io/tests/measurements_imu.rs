//! Inertial measurements: every format, unit and axis, and what is wrong with a file.

use std::f64::consts::PI;
use std::io::{Cursor, Write};
use std::path::Path;

use nalgebra::Vector3;
use tieline_filter::TimeEncoding;
use tieline_io::measurements::imu::read_from;
use tieline_io::measurements::{ImuFile, ImuFormat, ImuKind, ImuReadOptions, MeasurementFileError};

fn read_bytes(bytes: &[u8], options: &ImuReadOptions) -> Result<ImuFile, MeasurementFileError> {
    read_from(Cursor::new(bytes), Path::new("imu.txt"), options)
}

fn read(text: &str) -> Result<ImuFile, MeasurementFileError> {
    read_bytes(text.as_bytes(), &ImuReadOptions::default())
}

fn read_with(text: &str, columns: &[&str]) -> Result<ImuFile, MeasurementFileError> {
    let columns = Some(columns.iter().map(ToString::to_string).collect());
    read_bytes(text.as_bytes(), &ImuReadOptions { columns, ..Default::default() })
}

/// Rows of KF-GINS at these times.
fn rows(times_s: &[f64]) -> String {
    times_s.iter().map(|t| format!("{t} 0.001 0.002 0.003 0.1 0.2 -0.3\n")).collect()
}

fn times_s(file: &ImuFile) -> Vec<f64> {
    file.imu.samples().iter().map(|s| s.time_s).collect()
}

#[test]
fn seven_bare_columns_are_the_increments_of_kf_gins() {
    for delimiter in [" ", ",", ", ", "\t", ";"] {
        let row = |t: &str| [t, "0.001", "-2e-3", "0.003", "0.1", "0.2", "-0.3"].join(delimiter);
        let text = format!("# sensor 5\n{}\r\n\n{}\n", row("100.00"), row("100.01"));
        let file = read(&text).expect(delimiter);
        assert_eq!((file.format, file.kind), (ImuFormat::KfGins, ImuKind::Increments));
        let sample = file.imu.samples()[0];
        assert_eq!(times_s(&file), [100.0, 100.01]);
        assert_eq!(sample.angle_rad, Vector3::new(0.001, -0.002, 0.003));
        assert_eq!(sample.velocity_mps, Vector3::new(0.1, 0.2, -0.3));
        assert!(file.notes.is_empty(), "{:?}", file.notes);
        assert_eq!((file.time_encoding, file.week), (TimeEncoding::SecondsOfWeek, None));
    }
}

#[test]
fn units_are_taken_from_the_names_of_the_columns() {
    let text = "Time[s],Gyro X [deg/s],gyro_y_degph,gyro_z_radps,accel_x_g,accel_y_mps2,accel_z_mg,temperature\n\
                10.00,1,3600,0.5,1,2,-1000,25\n10.01,1,3600,0.5,1,2,-1000,25\n";
    let file = read(text).expect("every unit is known");
    assert_eq!((file.format, file.kind), (ImuFormat::Text, ImuKind::Rates));
    let sample = file.imu.samples()[1];
    let angle = Vector3::new(PI / 180.0, PI / 180.0, 0.5) * 0.01;
    let velocity = Vector3::new(9.806_65, 2.0, -9.806_65) * 0.01;
    assert!((sample.angle_rad - angle).norm() < 1e-12, "{sample:?}");
    assert!((sample.velocity_mps - velocity).norm() < 1e-12, "{sample:?}");
    assert_eq!(file.notes, ["imu.txt: columns left unused: temperature"]);

    let columns = [
        "-",
        "gps_week",
        "time_s",
        "dvel_x_mps",
        "dvel_y_mps",
        "dvel_z_mps",
        "dtheta_x_deg",
        "dtheta_y_rad",
        "dtheta_z_arcsec",
    ];
    let text = "A 2374 604799.99 1 2 3 180 0.5 3600\nB 2375 0.00 1 2 3 180 0.5 3600\n";
    let file = read_with(text, &columns).expect("a pattern");
    assert_eq!((file.kind, file.week), (ImuKind::Increments, Some(2374)));
    assert_eq!(times_s(&file), [604_799.99, 604_800.0]);
    let sample = file.imu.samples()[1];
    assert!((sample.angle_rad - Vector3::new(PI, 0.5, PI / 180.0)).norm() < 1e-12);
    assert_eq!(sample.velocity_mps, Vector3::new(1.0, 2.0, 3.0));
}

#[test]
fn times_are_seconds_of_week_adjusted_or_since_1980() {
    let columns = |time: &'static str| {
        [time, "dtheta_x_rad", "dtheta_y_rad", "dtheta_z_rad", "dvel_x_mps", "dvel_y_mps", "dvel_z_mps"]
    };
    let text = rows(&[406_000_000.0, 406_000_000.01]);
    for name in ["time_s", "adjusted_s"] {
        let file = read_with(&text, &columns(name)).expect(name);
        assert_eq!(file.time_encoding, TimeEncoding::AdjustedStandard, "{name}");
    }
    let file = read_with(&rows(&[1_406_000_000.0, 1_406_000_000.25]), &columns("gps_s")).expect("since 1980");
    assert_eq!(times_s(&file), [406_000_000.0, 406_000_000.25]);
    let error = read(&rows(&[1_751_999_658.5, 1_751_999_658.51])).expect_err("Unix time");
    assert!(error.to_string().contains("Unix time must be converted"), "{error}");
}

#[test]
fn the_axes_of_the_sensor_are_turned_into_the_body() {
    let options = ImuReadOptions { axes: "RFU".parse().expect("right-handed"), ..Default::default() };
    let file = read_bytes(rows(&[1.0, 1.01]).as_bytes(), &options).expect("good rows");
    assert_eq!(file.imu.samples()[0].angle_rad, Vector3::new(0.002, 0.001, -0.003));
    assert_eq!(file.imu.samples()[0].velocity_mps, Vector3::new(0.2, 0.1, 0.3));
}

#[test]
fn binary_records_hold_the_same_numbers_plain_or_gzipped() {
    let values = [[50.0, 0.001, 0.002, 0.003, 0.1, 0.2, -0.3], [50.01, 0.001, 0.002, 0.003, 0.1, 0.2, -0.3]];
    let bytes: Vec<u8> = values.iter().flatten().flat_map(|v: &f64| v.to_le_bytes()).collect();
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(&bytes).expect("memory");
    for bytes in [bytes.clone(), packed.finish().expect("memory")] {
        let file = read_bytes(&bytes, &ImuReadOptions::default()).expect("two records");
        assert_eq!(file.format, ImuFormat::Binary);
        assert_eq!(file.imu, read(&rows(&[50.0, 50.01])).expect("the same as text").imu);
    }
    let error = read_bytes(&bytes[..100], &ImuReadOptions::default()).expect_err("cut");
    assert!(matches!(error, MeasurementFileError::TruncatedRecord { record: 1, found: 44, .. }), "{error}");
    let swapped: Vec<u8> = values.iter().flatten().flat_map(|v: &f64| v.to_be_bytes()).collect();
    let error = read_bytes(&swapped, &ImuReadOptions::default()).expect_err("swapped");
    assert!(matches!(error, MeasurementFileError::ByteOrder { .. }), "{error}");
    let options = ImuReadOptions { kind: Some(ImuKind::Rates), ..Default::default() };
    let file = read_bytes(&bytes, &options).expect("rates");
    assert!((file.imu.samples()[1].velocity_mps.x - 0.1 * 0.01).abs() < 1e-12);
}

#[test]
fn samples_out_of_order_are_sorted_and_repeated_ones_dropped() {
    let file = read(&rows(&[10.0, 10.01, 10.03, 10.02, 10.04, 10.04, 10.05])).expect("a little disorder");
    assert_eq!(times_s(&file), [10.0, 10.01, 10.02, 10.03, 10.04, 10.05]);
    assert!(file.notes[0].contains("1 epochs came after later ones, the first at line 4"), "{:?}", file.notes);
    assert!(file.notes[1].contains("1 epochs had the time of the one before them"), "{:?}", file.notes);
    let error = read(&rows(&[10.0, 10.01, 8.0, 8.01])).expect_err("two seconds back");
    let message = error.to_string();
    assert!(message.contains("line 3: 8.0 s after 10.01 s; sort the file"), "{message}");
}

#[test]
fn of_two_samples_at_a_time_the_earlier_line_stays() {
    let text = "1.0 1 0 0 0 0 9\n1.1 2 0 0 0 0 9\n1.1 3 0 0 0 0 9\n1.2 4 0 0 0 0 9\n";
    let file = read(text).expect("one duplicate");
    let angles: Vec<f64> = file.imu.samples().iter().map(|s| s.angle_rad.x).collect();
    assert_eq!(angles, [1.0, 2.0, 4.0]);
}

#[test]
fn seconds_of_week_run_on_past_the_end_of_the_week() {
    // the third sample of the new week comes before the last one of the old
    let file = read(&rows(&[604_799.97, 604_799.98, 0.0, 604_799.99, 0.01, 0.02])).expect("a rollover");
    let expected = [604_799.97, 604_799.98, 604_799.99, 604_800.0, 604_800.01, 604_800.02];
    for (found, expected) in times_s(&file).iter().zip(expected) {
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
    assert!(file.notes.iter().any(|note| note.contains("counted on past 604800 s")), "{:?}", file.notes);
    let error = read(&rows(&[400_000.0, 400_000.01, 0.0, 0.01])).expect_err("a clock that was set anew");
    assert!(matches!(error, MeasurementFileError::TimeBackwards { .. }), "{error}");
}

#[test]
fn gaps_and_a_slow_imu_are_told() {
    let file = read(&rows(&[1.0, 1.01, 1.02, 1.03, 3.53, 3.54, 3.60, 3.61])).expect("two gaps");
    assert_eq!(file.notes, ["imu.txt: 2 gaps; the longest is 2.500 s, from 1.03 to 3.53 s"]);
    assert!(!file.is_slow());
    let file = read(&rows(&[1.0, 2.0, 3.0])).expect("1 Hz");
    assert!(file.is_slow() && file.notes[0].contains("slow: the usual interval between samples is 1.000 s"));
    assert!(!read(&rows(&[357_474.1, 357_474.2, 357_474.3])).expect("10 Hz").is_slow());
}

#[test]
fn what_is_wrong_is_named_with_its_line_and_the_way_out() {
    let good = rows(&[1.0, 1.01]);
    let expect = |text: &str, parts: &[&str]| {
        let message = read(text).expect_err(text).to_string();
        assert!(message.starts_with("imu.txt: "), "{message}");
        for part in parts {
            assert!(message.contains(part), "{part} is not in: {message}");
        }
    };
    expect("", &["no measurements"]);
    expect("# only\n\n# remarks\n", &["no measurements"]);
    expect("1.0 0 0 0 0 0 9.8\n", &["at least two samples"]);
    expect(&format!("{good}1.02 0.1 nan 0 0 0 0\n"), &["dtheta_y_rad at line 3 is not a finite number", "remove"]);
    expect(&format!("{good}1.02 0.1 -inf 0 0 0 0\n"), &["dtheta_y_rad at line 3"]);
    expect(&format!("{good}1.02 0.1 0,5 0 0 0 0\n"), &["line 3, column 3 (dtheta_y_rad): \"0,5\" is not a number"]);
    expect(&format!("{good}1.02 0.1 0.2\n"), &["line 3 has 3 fields where 7 were due"]);
    expect(&format!("{good}1.02 5000 0 0 0 0 0\n"), &["5000.0 at line 3", "at most 1e3", "units"]);
    expect("1 0 0 0 0 0 0\n1.01 0 0 0 0 0 0\n", &["every angle and velocity is zero", "gravity"]);
    expect("1 2 3\n4 5 6\n", &["nothing says what the columns are (line 1: 1 2 3)", "columns = ["]);
    expect("when wx wy wz fx fy fz\n1 0 0 0 0 0 9.8\n", &["line 1: when wx wy wz fx fy fz", "columns = ["]);
    expect("t gx gy gz ax ay az\n1 0 0 0 0 0 9.8\n", &["lack dtheta_x_rad".replace("dtheta", "gyro").as_str()]);
    expect("time_s,gyro_x,gyro_y,gyro_z,a,b,c\n1,0,0,0,0,0,9\n", &["\"gyro_x\" has no unit", "columns = ["]);
    expect(&"1".repeat(70_000), &["line 1 is longer than 65536 bytes"]);
    expect("LASF0000", &["point cloud", "strips"]);
}

#[test]
fn columns_that_do_not_fit_together_are_refused() {
    let expect = |columns: &[&str], part: &str| {
        let message = read_with(&rows(&[1.0, 1.01]), columns).expect_err(part).to_string();
        assert!(message.contains(part), "{part} is not in: {message}");
    };
    expect(
        &["time_s", "dtheta_x_rad", "dtheta_y_rad", "dtheta_z_rad", "accel_x_g", "accel_y_g", "accel_z_g"],
        "mix rates",
    );
    expect(&["time_s", "dtheta_x_rad", "dtheta_y_rad", "dtheta_z_rad"], "lack dvel_x_mps");
    expect(&["time_s", "time_s"], "\"time_s\" and \"time_s\" hold the same quantity");
    expect(&["dtheta_x_rad"], "lack a time (time_s)");
    expect(&["time_s", "roll_deg"], "\"roll_deg\" is unknown; known are time_s");
    expect(&["time_s", "gyro_x_mps"], "\"gyro_x_mps\" has no unit");
    expect(&[], "lack a time");
    let options = ImuReadOptions {
        kind: Some(ImuKind::Increments),
        columns: Some(
            ["time_s", "gyro_x_radps", "gyro_y_radps", "gyro_z_radps", "accel_x_g", "accel_y_g", "accel_z_g"]
                .map(str::to_string)
                .to_vec(),
        ),
        ..Default::default()
    };
    let error = read_bytes(rows(&[1.0, 1.01]).as_bytes(), &options).expect_err("rates are no increments");
    assert!(error.to_string().contains("the columns hold rates, and kind says increments"), "{error}");
}

#[test]
fn a_gzipped_file_that_ends_early_is_told_from_a_good_one() {
    let text: String = rows(&(0..5000).map(|i| f64::from(i) * 0.01).collect::<Vec<_>>());
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(text.as_bytes()).expect("memory");
    let bytes = packed.finish().expect("memory");
    let file = read_bytes(&bytes, &ImuReadOptions::default()).expect("whole");
    assert_eq!(file.imu.samples().len(), 5000);
    let error = read_bytes(&bytes[..bytes.len() / 2], &ImuReadOptions::default()).expect_err("half");
    assert!(matches!(error, MeasurementFileError::Damaged { .. }), "{error}");
    assert!(error.to_string().contains("the file is damaged, copy it again"), "{error}");
}
