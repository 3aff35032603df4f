//! Every trajectory format: there and back, conventions, and what is refused.

use std::path::Path;

use nalgebra::Vector3;
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{PoseSigma, PositionFrame, SurveyClock, TimeEncoding, Trajectory, ned_from_body};
use tieline_io::trajectory::{
    HeadingReference, ReadOptions, TrajectoryFile, TrajectoryFileError, TrajectoryFormat, read, sbet, smrmsg, trj,
    write_csv, write_sbet, write_smrmsg, write_trj,
};

fn sigma(size: f64) -> PoseSigma {
    PoseSigma {
        position_ned_m: Vector3::new(0.01, 0.02, 0.03) * size,
        velocity_ned_mps: Vector3::new(0.001, 0.002, 0.003) * size,
        attitude_rph_rad: Vector3::new(1e-4, 2e-4, 3e-4) * size,
    }
}

/// Four minutes of flight at 5 Hz.
fn flight(frame: PositionFrame) -> Trajectory {
    let n = 1200;
    let time_s: Vec<f64> = (0..n).map(|i| 388_800.123_456_789 + 0.2 * f64::from(i)).collect();
    let position = (0..n).map(|i| match frame {
        PositionFrame::Geodetic => Vector3::new(0.81 + 1e-6 * f64::from(i), -2.1 + 2e-6 * f64::from(i), 912.25),
        PositionFrame::Map => Vector3::new(500_000.0 + 3.0 * f64::from(i), 5_200_000.0 + f64::from(i), 912.25),
    });
    let attitude = (0..n).map(|i| ned_from_body(0.02, -0.03, -3.0 + 0.005 * f64::from(i)));
    let velocity = (0..n).map(|i| Vector3::new(60.0, 12.0 + 0.01 * f64::from(i), -0.7));
    Trajectory::new(frame, time_s, position.collect(), attitude.collect(), velocity.collect())
        .expect("a good trajectory")
        .with_sigma((0..n).map(|i| sigma(1.0 + f64::from(i) / 1000.0)).collect())
        .expect("one each")
}

fn assert_close(a: &Trajectory, b: &Trajectory, position: f64, angle_rad: f64) {
    assert_eq!((a.len(), a.frame()), (b.len(), b.frame()));
    for i in 0..a.len() {
        assert!((a.time_s()[i] - b.time_s()[i]).abs() < 1e-9, "time of {i}");
        assert!((a.position()[i] - b.position()[i]).norm() < position, "position of {i}");
        assert!(a.ned_from_body()[i].angle_to(&b.ned_from_body()[i]) < angle_rad, "attitude of {i}");
    }
}

fn records<const N: usize>(rows: &[[f64; N]]) -> Vec<u8> {
    rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

fn sbet_of(rows: &[[f64; 17]]) -> Result<TrajectoryFile, TrajectoryFileError> {
    sbet::read_from(records(rows).as_slice(), Path::new("flight.sbet"))
}

fn sbet_row(time_s: f64) -> [f64; 17] {
    let mut row = [0.0; 17];
    row[..4].copy_from_slice(&[time_s, 0.66, -2.07, 6991.0]);
    row
}

#[test]
fn an_sbet_with_its_accuracy_file_goes_there_and_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, accuracy) = (folder.path().join("trajectory.sbet"), folder.path().join("trajectory_rms.out"));
    let start = flight(PositionFrame::Geodetic);
    write_sbet(&path, &start).expect("written");
    write_smrmsg(&accuracy, &start).expect("written");
    let options = ReadOptions { accuracy: Some(accuracy), ..ReadOptions::default() };
    let file = read(&path, &options).expect("read");
    assert_eq!(file.format, TrajectoryFormat::Sbet);
    assert_eq!((file.time_encoding, file.week), (TimeEncoding::SecondsOfWeek, None));
    assert!(file.notes.is_empty(), "{:?}", file.notes);
    assert_close(&file.trajectory, &start, 1e-12, 1e-12);
    for i in 0..start.len() {
        assert!((file.trajectory.velocity_ned_mps()[i] - start.velocity_ned_mps()[i]).norm() < 1e-12);
        let (a, b) = (file.trajectory.sigma()[i], start.sigma()[i]);
        assert!((a.position_ned_m - b.position_ned_m).norm() < 1e-12);
        assert!((a.attitude_rph_rad - b.attitude_rph_rad).norm() < 1e-15);
    }
}

#[test]
fn velocity_and_heading_are_turned_out_of_the_wander_frame() {
    // A real SBET over California: north -102.627, east 40.676 m/s, wander angle 1.0216 deg, stored x -103.33 and
    // y -38.84 m/s; platform heading 164.98 deg.
    let mut row = sbet_row(400_825.0);
    row[4..7].copy_from_slice(&[-103.334, -38.841, -0.01]);
    row[9..11].copy_from_slice(&[164.98_f64.to_radians(), 1.0216_f64.to_radians()]);
    let mut next = row;
    next[0] += 0.005;
    let file = sbet_of(&[row, next]).expect("two good records");
    let velocity = file.trajectory.velocity_ned_mps()[0];
    assert!((velocity - Vector3::new(-102.627, 40.676, 0.01)).norm() < 0.01, "{velocity}");
    let (_, _, heading) = roll_pitch_heading_rad(&file.trajectory.ned_from_body()[0]);
    assert!((heading.to_degrees() - (164.98 - 1.0216)).abs() < 1e-9);
    assert_eq!(file.heading, HeadingReference::TrueNorth);
}

#[test]
fn accuracies_are_joined_by_time_and_not_by_index() {
    let rows: Vec<[f64; 10]> = (0..5)
        .map(|i| {
            let s = f64::from(i);
            [388_780.0 + 100.0 * s, 0.01 * s, 0.02, 0.03, 0.0, 0.0, 0.0, 1.0, 2.0, 6.0 * s]
        })
        .collect();
    let accuracy = smrmsg::read_from(records(&rows).as_slice(), Path::new("rms.out")).expect("good");
    let trajectory = flight(PositionFrame::Geodetic);
    let (joined, notes) = accuracy.join(trajectory).expect("they overlap");
    assert!(notes.is_empty(), "{notes:?}");
    let sigma = joined.sigma()[299]; // at 388 859.923 456 789 s, 0.799 of the way from the first to the second
    assert!((sigma.position_ned_m.x - 0.007_992_345_679).abs() < 1e-9, "{sigma:?}");
    assert!((sigma.attitude_rph_rad.z.to_degrees() * 60.0 - 4.795_407_407).abs() < 1e-6, "{sigma:?}");
    assert!((sigma.attitude_rph_rad.y.to_degrees() * 60.0 - 2.0).abs() < 1e-9);
}

#[test]
fn accuracies_of_another_day_are_refused_and_of_another_week_count_are_taken() {
    let trajectory = flight(PositionFrame::Geodetic);
    let of = |start: f64| {
        let rows = [0.0, 500.0].map(|t| [start + t, 0.01, 0.01, 0.01, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        smrmsg::read_from(records(&rows).as_slice(), Path::new("rms.out")).expect("good").join(trajectory.clone())
    };
    assert!(matches!(of(302_400.0), Err(TrajectoryFileError::AccuracyApart { .. })));
    assert!(of(388_700.0 + 604_800.0).is_ok());
    assert_eq!(of(388_900.0).expect("overlaps in part").1.len(), 1, "the missing part is told");
}

#[test]
fn a_trj_goes_there_and_back_with_its_heading_from_grid_north() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("line1.trj");
    let start = flight(PositionFrame::Map);
    let start = start.clone().with_grid(vec![(0.02, 0.9997); start.len()]).expect("one each");
    write_trj(&path, &start).expect("written");
    assert_eq!(std::fs::metadata(&path).expect("there").len(), 1376 + 64 * 1200);
    let file = read(&path, &ReadOptions::default()).expect("read");
    assert_eq!((file.format, file.heading), (TrajectoryFormat::Trj, HeadingReference::GridNorth));
    assert_eq!(file.trajectory.position(), start.position());
    let (_, _, grid_heading) = roll_pitch_heading_rad(&file.trajectory.ned_from_body()[7]);
    let (_, _, true_heading) = roll_pitch_heading_rad(&start.ned_from_body()[7]);
    assert!((true_heading - grid_heading - 0.02).abs() < 1e-12);
}

#[test]
fn codes_marks_and_flags_of_a_trj_are_kept_raw() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("line1.trj");
    let record = trj::TrjRecord {
        time_s: 5.0,
        position_m: [1.0, 2.0, 3.0],
        heading_deg: 359.0,
        roll_deg: -1.0,
        pitch_deg: 2.0,
        accuracy_code: [7, 8, 9, 10],
        mark: -3,
        flags: 12,
    };
    let file = trj::TrjFile {
        description: "north of the river".into(),
        system_id: 2,
        quality: 4,
        original_number: 11,
        line_number: 12,
        records: vec![record, trj::TrjRecord { time_s: 5.5, ..record }],
    };
    file.write(&path).expect("written");
    assert_eq!(trj::read_trj(&path).expect("read"), file);
}

#[test]
fn our_own_csv_goes_there_and_back_over_the_end_of_the_week() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("trajectory.csv");
    let start = flight(PositionFrame::Geodetic).shifted_in_time(604_800.0 - 388_900.0);
    write_csv(&path, &start, &SurveyClock { reference_week: Some(2330) }).expect("written");
    let file = read(&path, &ReadOptions::default()).expect("read");
    assert_eq!((file.format, file.week), (TrajectoryFormat::Text, Some(2330)));
    assert_close(&file.trajectory, &start, 1e-9, 1e-12);
    assert_eq!(file.trajectory.velocity_ned_mps(), start.velocity_ned_mps());
    assert!((file.trajectory.sigma()[900].attitude_rph_rad - start.sigma()[900].attitude_rph_rad).norm() < 1e-15);
    write_csv(&path, &start, &SurveyClock { reference_week: None }).expect("written");
    assert_eq!(read(&path, &ReadOptions::default()).expect("read").week, None);
}

#[test]
fn seconds_of_week_that_fall_back_go_on_counting() {
    let file = sbet_of(&[604_799.5, 604_799.75, 0.0, 0.25].map(sbet_row)).expect("over the week's end");
    assert_eq!(file.trajectory.time_s(), [604_799.5, 604_799.75, 604_800.0, 604_800.25]);
    assert_eq!(file.notes.len(), 1);
    let file = sbet_of(&[604_799.5, 604_800.5, 604_801.5].map(sbet_row)).expect("an SBET that counts on by itself");
    assert!(file.notes.is_empty());
}

#[test]
fn epochs_of_one_time_are_dropped_and_told() {
    let file = sbet_of(&[5.0, 5.1, 5.1, 5.1, 5.2].map(sbet_row)).expect("good otherwise");
    assert_eq!(file.trajectory.len(), 3);
    assert!(file.notes[0].contains("2 epochs") && file.notes[0].contains("record 2"), "{:?}", file.notes);
}

#[test]
fn the_size_of_the_times_tells_their_encoding() {
    let encoding = |t: f64| sbet_of(&[t, t + 1.0].map(sbet_row)).expect("good").time_encoding;
    assert_eq!(encoding(388_800.0), TimeEncoding::SecondsOfWeek);
    assert_eq!(encoding(650_000.0), TimeEncoding::SecondsOfWeek);
    assert_eq!(encoding(306_235_306.0), TimeEncoding::AdjustedStandard);
    assert_eq!(encoding(-5e7), TimeEncoding::AdjustedStandard);
    let error = sbet_of(&[1.4e9, 1.4e9 + 1.0].map(sbet_row)).expect_err("GPS seconds");
    assert!(matches!(error, TrajectoryFileError::TimeUnknown { .. }), "{error}");
}

#[test]
fn a_bad_sbet_is_refused_with_record_value_and_remedy() {
    let mut degrees = sbet_row(5.0);
    degrees[1] = 46.8;
    let error = sbet_of(&[degrees]).expect_err("degrees").to_string();
    assert!(error.contains("flight.sbet") && error.contains("46.8") && error.contains("degrees"), "{error}");

    let mut nan = sbet_row(6.0);
    nan[8] = f64::NAN;
    let error = sbet_of(&[sbet_row(5.0), nan]).expect_err("NaN").to_string();
    assert!(error.contains("record 1") && error.contains("attitude"), "{error}");

    let mut high = sbet_row(6.0);
    high[3] = 1e9;
    assert!(matches!(sbet_of(&[sbet_row(5.0), high]), Err(TrajectoryFileError::Absurd { column: "height", .. })));

    let error = sbet_of(&[5.0, 7.0, 6.0].map(sbet_row)).expect_err("backwards").to_string();
    assert!(error.contains("record 2") && error.contains("sort"), "{error}");

    let cut = &records(&[sbet_row(5.0), sbet_row(6.0)])[..200];
    let error = sbet::read_from(cut, Path::new("flight.sbet")).expect_err("cut").to_string();
    assert!(error.contains("record 1 is cut short: 64 bytes"), "{error}");

    let swapped: Vec<u8> =
        [sbet_row(388_800.0), sbet_row(388_801.0)].iter().flatten().flat_map(|v| v.to_be_bytes()).collect();
    let error = sbet::read_from(swapped.as_slice(), Path::new("flight.sbet")).expect_err("swapped");
    assert!(matches!(error, TrajectoryFileError::ByteOrder { .. }), "{error}");

    assert!(matches!(sbet_of(&[]), Err(TrajectoryFileError::Empty { .. })));
    assert!(matches!(sbet_of(&[sbet_row(5.0)]), Err(TrajectoryFileError::Trajectory { .. })), "one epoch");
}

#[test]
fn a_bad_trj_is_refused_with_what_was_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("line1.trj");
    write_trj(&path, &flight(PositionFrame::Map)).expect("written");
    let good = std::fs::read(&path).expect("read");
    let read = |bytes: &[u8]| trj::read_from(bytes, Path::new("line1.trj")).expect_err("bad").to_string();
    assert!(read(&good[..good.len() - 1]).contains("record 1199 is cut short"));
    assert!(read(&good[..1000]).contains("1376"));
    assert!(read(b"TSCANLAS").contains("TSCANTRJ"));
    assert!(read(b"").contains("empty"));
    for (at, word) in [(8, "version"), (20, "record size"), (19, "number of records")] {
        let mut bad = good.clone();
        bad[at] = 0xff;
        assert!(read(&bad).contains(word), "{word}: {}", read(&bad));
    }
    let error = write_trj(&path, &flight(PositionFrame::Geodetic)).expect_err("degrees").to_string();
    assert!(error.contains("Map"), "{error}");
}

#[test]
fn a_file_that_cannot_be_written_leaves_nothing_behind() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("no/such/folder.sbet");
    assert!(matches!(write_sbet(&path, &flight(PositionFrame::Geodetic)), Err(TrajectoryFileError::Io { .. })));
    assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 0);
}

#[test]
fn a_file_of_no_known_format_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("x.bin");
    std::fs::write(&path, [0_u8, 1, 2, 3]).expect("written");
    assert!(matches!(read(&path, &ReadOptions::default()), Err(TrajectoryFileError::UnknownFormat { .. })));
    std::fs::write(&path, "").expect("written");
    assert!(matches!(read(&path, &ReadOptions::default()), Err(TrajectoryFileError::Empty { .. })));
    assert!(matches!(read(&folder.path().join("none"), &ReadOptions::default()), Err(TrajectoryFileError::Io { .. })));
}
