//! Text trajectories: patterns, headers, delimiters, and messages with line and column.

use std::io::{Cursor, Write};
use std::path::Path;

use nalgebra::Vector3;
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{PositionFrame, TimeEncoding};
use tieline_io::trajectory::{HeadingReference, TrajectoryFile, TrajectoryFileError, text};

fn read(content: &str, columns: Option<&[&str]>) -> Result<TrajectoryFile, TrajectoryFileError> {
    let columns: Option<Vec<String>> = columns.map(|names| names.iter().map(ToString::to_string).collect());
    let bytes = content.as_bytes().to_vec();
    text::read_from(|| Ok(Cursor::new(bytes.clone())), Path::new("flight.txt"), columns.as_deref())
}

const PATTERN: &[&str] = &["time_s", "east_m", "north_m", "height_m", "roll_deg", "pitch_deg", "heading_deg", "-"];

fn angles_deg(file: &TrajectoryFile, epoch: usize) -> Vector3<f64> {
    let (r, p, h) = roll_pitch_heading_rad(&file.trajectory.ned_from_body()[epoch]);
    Vector3::new(r, p, h).map(f64::to_degrees)
}

#[test]
fn the_header_of_a_surveying_drone_says_what_its_columns_are() {
    // The first lines of als/uav data published by B. Brede, GFZ Potsdam.
    let file = read(
        "Time[s],Roll[deg],Pitch[deg],Yaw[deg],Easting[m],Northing[m],Height[m]\n\
         216089.127262,-1.216987240439,-13.651066817636,15.513150101748,682256.3644,5763609.5492,74.8281\n\
         216089.132262,-1.223298396878,-13.647541703563,15.505255462443,682256.3668,5763609.5583,74.8272\n",
        None,
    )
    .expect("every column is known");
    assert_eq!(file.trajectory.frame(), PositionFrame::Map);
    assert_eq!(file.time_encoding, TimeEncoding::SecondsOfWeek);
    assert_eq!(file.trajectory.position()[1], Vector3::new(682_256.366_8, 5_763_609.558_3, 74.827_2));
    assert!(
        (angles_deg(&file, 0) - Vector3::new(-1.216_987_240_439, -13.651_066_817_636, 15.513_150_101_748)).norm()
            < 1e-9
    );
    assert!(file.notes.is_empty(), "{:?}", file.notes);
}

#[test]
fn any_delimiter_and_any_header_is_read_with_a_pattern() {
    for (delimiter, head) in
        [(",", ""), (";", "exported by\nsomebody; somewhere\n"), (" ", "# a comment\n"), ("\t", "\n\n")]
    {
        let row = |t: &str| [t, "500.5", "600.25", "70", "1", "2", "-170", "good"].join(delimiter);
        let content = format!("{head}{}\n# in between\n\n{}\r\n", row("5.0"), row("6.5"));
        let file = read(&content, Some(PATTERN)).expect(delimiter);
        assert_eq!(file.trajectory.time_s(), [5.0, 6.5]);
        assert_eq!(file.trajectory.position()[0], Vector3::new(500.5, 600.25, 70.0));
        assert!((angles_deg(&file, 1) - Vector3::new(1.0, 2.0, -170.0)).norm() < 1e-9);
    }
}

#[test]
fn degrees_radians_velocities_and_accuracies_are_taken_by_their_units() {
    let columns = [
        "gps_week",
        "time_of_week_s",
        "lat_deg",
        "lon_rad",
        "h_m",
        "roll_rad",
        "pitch_arcmin",
        "grid_heading_deg",
        "vn_mps",
        "ve_mps",
        "vu_mps",
        "sigma_n_m",
        "sigma_e_m",
        "sigma_u_m",
        "sigma_roll_arcmin",
        "sigma_pitch_deg",
        "sigma_heading_rad",
    ];
    let file = read(
        "2200 604799 46.5 0.15 900 0.01 60 90 1 2 3 0.01 0.02 0.03 60 1 0.5\n\
         2201 0 46.5 0.15 900 0.01 60 90 1 2 3 0.01 0.02 0.03 60 1 0.5\n",
        Some(&columns),
    )
    .expect("good");
    assert_eq!((file.week, file.heading), (Some(2200), HeadingReference::GridNorth));
    assert_eq!(file.trajectory.time_s(), [604_799.0, 604_800.0]);
    assert!((file.trajectory.position()[0] - Vector3::new(46.5_f64.to_radians(), 0.15, 900.0)).norm() < 1e-12);
    assert!((angles_deg(&file, 0) - Vector3::new(0.01_f64.to_degrees(), 1.0, 90.0)).norm() < 1e-9);
    assert_eq!(file.trajectory.velocity_ned_mps()[0], Vector3::new(1.0, 2.0, -3.0));
    let sigma = file.trajectory.sigma()[0];
    assert_eq!(sigma.position_ned_m, Vector3::new(0.01, 0.02, 0.03));
    let degree = 1_f64.to_radians();
    assert!((sigma.attitude_rph_rad - Vector3::new(degree, degree, 0.5)).norm() < 1e-12);
}

#[test]
fn gps_seconds_since_1980_become_adjusted_time() {
    let mut columns = PATTERN.to_vec();
    columns[0] = "gps_s";
    let file = read("1306235306.25 1 2 3 0 0 0 0\n1306235307.25 1 2 3 0 0 0 0\n", Some(&columns)).expect("good");
    assert_eq!(file.time_encoding, TimeEncoding::AdjustedStandard);
    assert_eq!(file.trajectory.time_s(), [306_235_306.25, 306_235_307.25]);
}

#[test]
fn a_header_without_units_is_taken_when_the_values_leave_no_choice() {
    // The first lines of a public SBET export (PDAL/data, trajectory/).
    let file = read(
        "\"GpsTime\",\"Y\",\"X\",\"Z\",\"Roll\",\"Pitch\",\"Azimuth\"\n\
         407106.003323,3289429.723912,276318.006408,538.873527,-1.806850,2.087757,-90.494178\n\
         407106.008323,3289429.724757,276317.671054,538.881446,-1.813094,2.085228,-90.497589\n",
        None,
    )
    .expect("degrees: no angle has 90 radians");
    assert!((angles_deg(&file, 0) - Vector3::new(-1.806_850, 2.087_757, -90.494_178)).norm() < 1e-9);
    assert!((file.trajectory.position()[0].x - 276_318.006_408).abs() < 1e-9);
    assert!(file.notes[0].contains("Azimuth [deg]"), "{:?}", file.notes);
    let error = read("t,x,y,z,roll,pitch,yaw\n1,2,3,4,0.1,0.2,0.3\n2,2,3,4,0.1,0.2,0.3\n", None).expect_err("either");
    assert!(matches!(error, TrajectoryFileError::NoUnit { quantity: "roll", .. }), "{error}");
}

#[test]
fn a_gzipped_file_is_read_as_it_is() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("flight.txt.gz");
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder
        .write_all(b"time_s east_m north_m height_m roll_deg pitch_deg heading_deg\n1 2 3 4 5 6 7\n2 2 3 4 5 6 7\n")
        .expect("packed");
    std::fs::write(&path, encoder.finish().expect("packed")).expect("written");
    let file = tieline_io::trajectory::read(&path, &tieline_io::trajectory::ReadOptions::default()).expect("read");
    assert_eq!(file.trajectory.len(), 2);
}

#[test]
fn mistakes_are_named_with_line_column_and_remedy() {
    let row = "5 1 2 3 0 0 0 0\n";
    for (content, columns, words) in [
        (format!("{row}6 1 2 x3 0 0 0 0\n"), Some(PATTERN), &["line 2", "column 4", "height_m", "x3"][..]),
        (format!("{row}6 1 2\n"), Some(PATTERN), &["line 2", "3 fields", "7"]),
        (format!("{row}6 1 2 NaN 0 0 0 0\n"), Some(PATTERN), &["line 2", "position", "finite"]),
        (format!("{row}6 1 2 3 0 0 7e3 0\n"), Some(PATTERN), &["line 2", "heading", "122"]),
        (format!("{row}4 1 2 3 0 0 0 0\n"), Some(PATTERN), &["line 2", "backwards", "sort"]),
        (row.into(), Some(&["time_s", "eastt_m"]), &["eastt_m", "east_m", "heading_deg"]),
        (
            row.into(),
            Some(&["time_s", "east_m", "north_m", "height_m", "roll", "pitch_deg", "yaw_deg"]),
            &["\"roll\"", "roll_deg"],
        ),
        (row.into(), Some(&["time_s", "east_m", "north_m", "height_m", "roll_deg", "pitch_deg"]), &["heading_deg"]),
        (row.into(), Some(&["time_s", "time_s", "north_m"]), &["time", "two columns"]),
        (row.into(), None, &["nothing says", "5 1 2 3", "columns = "]),
        ("no numbers at all\n".into(), None, &["no numbers at all", "columns = "]),
        ("no numbers at all\n".into(), Some(PATTERN), &["line 1", "column 1", "time_s", "no"]),
        ("time,x,y,z,pitch,yaw\n5,1,2,3,4,5\n".into(), None, &["lack roll"]),
        (String::new(), None, &["empty"]),
        ("x".repeat(70_000), None, &["longer than"]),
    ] {
        let error = read(&content, columns).expect_err(&content).to_string();
        for word in ["flight.txt"].iter().chain(words) {
            assert!(error.contains(word), "\"{word}\" is not in: {error}");
        }
    }
}

#[test]
fn a_header_of_our_own_words_over_white_space_is_read() {
    let file =
        read("# time_s east_m north_m height_m roll_deg pitch_deg heading_deg\n1 2 3 4 5 6 7\n2 2 3 4 5 6 7\n", None);
    assert_eq!(file.expect("good").trajectory.len(), 2);
}
