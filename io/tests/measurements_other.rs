//! Odometer and known points.

use std::io::Cursor;
use std::path::Path;

use nalgebra::Vector3;
use tieline_filter::TimeEncoding;
use tieline_io::measurements::{MeasurementFileError, OdometerFile, PointsFile, odometer, points};

fn names(columns: &[&str]) -> Vec<String> {
    columns.iter().map(ToString::to_string).collect()
}

fn odometer(text: &str, columns: Option<&[&str]>) -> Result<OdometerFile, MeasurementFileError> {
    odometer::read_from(Cursor::new(text), Path::new("odo.txt"), columns.map(names).as_deref())
}

fn points(text: &str, columns: Option<&[&str]>) -> Result<PointsFile, MeasurementFileError> {
    points::read_from(Cursor::new(text), Path::new("points.csv"), columns.map(names).as_deref())
}

#[test]
fn two_bare_columns_are_time_and_speed() {
    let file = odometer("357474.1 -0.07\n357474.2 3.5\n", None).expect("two columns");
    let found: Vec<(f64, f64)> = file.samples.iter().map(|s| (s.time_s, s.speed_mps)).collect();
    assert_eq!(found, [(357_474.1, -0.07), (357_474.2, 3.5)]);
    assert_eq!((file.time_encoding, file.week), (TimeEncoding::SecondsOfWeek, None));
}

#[test]
fn a_speed_in_kilometres_per_hour_is_turned_into_metres_per_second() {
    let by_header = odometer("gps_week;time_s;speed_kmph\n2300;10;36\n2300;11;72\n", None).expect("a header");
    assert_eq!(by_header.week, Some(2300));
    let by_pattern = odometer("x 10 36\nx 11 72\n", Some(&["-", "time_s", "speed_kmph"])).expect("a pattern");
    assert_eq!(by_header.samples, by_pattern.samples);
    assert!((by_header.samples[1].speed_mps - 20.0).abs() < 1e-12);
}

#[test]
fn an_odometer_without_order_is_sorted() {
    let file = odometer("12 1\n10 2\n11 3\n11 4\n", None).expect("sorted");
    assert_eq!(file.samples.iter().map(|s| s.speed_mps).collect::<Vec<_>>(), [2.0, 3.0, 1.0]);
    assert_eq!(file.notes.len(), 2, "{:?}", file.notes);
}

#[test]
fn a_wrong_odometer_is_named_with_its_line() {
    for (text, part) in [
        ("1 2\n2 x\n", "line 2, column 2 (speed_mps): \"x\" is not a number"),
        ("1 2\n2\n", "line 2 has 1 fields where 2 were due"),
        ("1 2\n2 nan\n", "speed_mps at line 2 is not a finite number"),
        ("1 2\n2 5000\n", "speed is 5000.0 at line 2, at most 1000 m/s was due"),
        ("1 2 3\n", "columns = [\"time_s\", \"speed_mps\"]"),
        ("time_s,speed\n1,2\n", "\"speed\" has no unit"),
        ("time_s,distance_m\n1,2\n", "lack a speed"),
        ("", "no measurements"),
    ] {
        let message = odometer(text, None).expect_err(part).to_string();
        assert!(message.starts_with("odo.txt: ") && message.contains(part), "{message}");
    }
}

#[test]
fn known_points_may_lie_beside_the_imu() {
    let text = "gps_time_s,lat_deg,lon_deg,h_m,sigma_n_m,sigma_e_m,sigma_d_m,body_x_m,body_y_m,body_z_m,name\n\
                20,45,190,100,0.01,0.02,0.03,1,2,3,kerb\n\
                10,-45,9,100,0.01,0.02,0.03,1,2,4,kerb\n\
                10,-45,9,100,0,0.02,-1,0,0,0,kerb\n";
    let file = points(text, None).expect("three points");
    assert_eq!(file.points.iter().map(|p| p.time_s).collect::<Vec<_>>(), [10.0, 10.0, 20.0]);
    let last = file.points[2];
    assert!((last.geodetic - Vector3::new(45_f64.to_radians(), (-170_f64).to_radians(), 100.0)).norm() < 1e-12);
    assert_eq!(last.body_vector_m, Vector3::new(1.0, 2.0, 3.0));
    assert!((last.covariance_ned_m2.diagonal() - Vector3::new(1e-4, 4e-4, 9e-4)).norm() < 1e-15);
    let raised = file.points[1].covariance_ned_m2.diagonal();
    assert!((raised - Vector3::new(1e-6, 4e-4, 1e-6)).norm() < 1e-15);
    assert_eq!(file.notes.len(), 3, "{:?}", file.notes); // unused name, sigma, order
    assert!(file.notes[1].contains("1 points had a sigma below 0.001 m"), "{:?}", file.notes);
}

#[test]
fn known_points_of_the_imu_itself_need_no_body_vector() {
    let bare = points("10 45 9 100 0.01 0.02 0.03\n", None).expect("seven columns");
    assert_eq!(bare.points[0].body_vector_m, Vector3::zeros());
    let bare = points("10 45 9 100 0.01 0.02 0.03 1 2 3\n", None).expect("ten columns");
    assert_eq!(bare.points[0].body_vector_m, Vector3::new(1.0, 2.0, 3.0));
    let columns = ["adjusted_s", "lat_rad", "lon_rad", "h_m", "sigma_n_mm", "sigma_e_mm", "sigma_u_mm"];
    let file = points("300 0.5 0.1 100 10 10 10\n", Some(&columns)).expect("a pattern");
    assert_eq!(file.time_encoding, TimeEncoding::AdjustedStandard);
    assert!((file.points[0].covariance_ned_m2[(0, 0)] - 1e-4).abs() < 1e-15);
}

#[test]
fn a_wrong_point_is_named_with_its_line() {
    for (text, part) in [
        ("10 95 9 100 0.01 0.02 0.03\n", "latitude [deg] is 95"),
        ("10 45 9 1e9 0.01 0.02 0.03\n", "height [m] is 1000000000.0 at line 1"),
        ("10 45 9 100 0.01 0.02\n", "columns = ["),
        ("time_s,lat_deg,lon_deg,h_m\n10,45,9,100\n", "lack accuracies"),
        (
            "time_s,lat_deg,lon_deg,h_m,sigma_n_m,sigma_e_m,sigma_d_m,body_x_m\n10,45,9,100,1,1,1,1\n",
            "lack all three of body_x_m",
        ),
    ] {
        let message = points(text, None).expect_err(part).to_string();
        assert!(message.starts_with("points.csv: ") && message.contains(part), "{message}");
    }
}
