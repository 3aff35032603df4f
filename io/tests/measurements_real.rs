//! The readers on real navigation files: drive0708, whu-sim27, whu-routes.

use std::path::{Path, PathBuf};
use std::time::Instant;

use nalgebra::Vector3;
use tieline_filter::{FixQuality, TimeEncoding};
use tieline_io::measurements::{
    GnssFormat, GnssReadOptions, ImuFormat, ImuReadOptions, read_gnss, read_imu, read_odometer,
};

/// A file of a real data set; `None`, and so a skipped test, where the data are not there (never in CI).
#[allow(clippy::print_stderr)]
fn real(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(name);
    assert!(path.exists() || std::env::var_os("CI").is_none(), "{} is missing", path.display());
    if !path.exists() {
        eprintln!("skipped: {} is not there", path.display());
    }
    path.exists().then_some(path)
}

#[test]
fn the_solution_of_a_real_drive_is_read_with_its_velocities() {
    let Some(path) = real("drive0708/gnss_1934_sf.pos") else { return };
    let file = read_gnss(&path, &GnssReadOptions::default()).expect("RTKLIB");
    assert_eq!((file.format, file.week), (GnssFormat::RtklibPos, Some(2374)));
    assert_eq!(file.fixes.len(), 2197);
    let count = |quality| file.fixes.iter().filter(|fix| fix.quality == quality).count();
    assert_eq!((count(FixQuality::Fixed), count(FixQuality::Float)), (2189, 8));
    assert!(file.fixes.iter().all(|fix| fix.velocity.is_some()));
    let (first, last) = (file.fixes[0], file.fixes[2196]);
    assert!((first.time_s - 243_258.499).abs() < 1e-9 && (last.time_s - 243_807.499).abs() < 1e-9);
    let velocity = first.velocity.expect("a velocity");
    assert_eq!(velocity.ned_mps, Vector3::new(0.01, -0.002, -0.009));
    assert!((velocity.covariance_m2ps2[(0, 0)].sqrt() - 0.058_689_9).abs() < 1e-9);
    assert!((first.covariance_ned_m2[(0, 0)].sqrt() - 0.009_899_5).abs() < 1e-9);
    assert!(file.notes.is_empty(), "{:?}", file.notes);
    // the velocity is that of the positions, but for the lag that the data's README tells of
    let mut differences: Vec<f64> = file
        .fixes
        .windows(3)
        .filter_map(|w| {
            let north_m = (w[2].geodetic.x - w[0].geodetic.x) * 6.36e6;
            Some((north_m / (w[2].time_s - w[0].time_s) - w[1].velocity?.ned_mps.x).abs())
        })
        .collect();
    differences.sort_by(f64::total_cmp);
    assert!(differences[differences.len() / 2] < 0.2, "{}", differences[differences.len() / 2]);
}

#[test]
fn kf_gins_text_of_the_same_drive_agrees_with_its_solution() {
    let (Some(pos), Some(text), Some(reference)) =
        (real("drive0708/gnss_1934_sf.pos"), real("drive0708/gnss.txt.gz"), real("drive0708/gnss_ref.txt.gz"))
    else {
        return;
    };
    let options = GnssReadOptions::default();
    let (pos, text) = (read_gnss(&pos, &options).expect("RTKLIB"), read_gnss(&text, &options).expect("KF-GINS"));
    assert_eq!((text.format, text.fixes.len()), (GnssFormat::KfGins, 2197));
    for (a, b) in pos.fixes.iter().zip(&text.fixes) {
        assert!((a.time_s - b.time_s).abs() < 1e-6);
        assert!((a.geodetic - b.geodetic).norm() < 1e-9 + 1e-4 * 1e-9);
        assert!((a.covariance_ned_m2 - b.covariance_ned_m2).norm() < 2e-3);
    }
    let reference = read_gnss(&reference, &options).expect("ten columns");
    assert_eq!(reference.fixes.len(), 2189);
    assert!(reference.notes[0].contains("velocities are left out"), "{:?}", reference.notes);
}

#[test]
fn real_inertial_measurements_show_gravity_at_rest() {
    let Some(path) = real("drive0708/imu.txt.gz") else { return };
    let file = read_imu(&path, &ImuReadOptions::default()).expect("KF-GINS");
    assert_eq!((file.format, file.imu.samples().len()), (ImuFormat::KfGins, 54_858));
    assert!((file.imu.interval_s() - 1.0 / 99.971).abs() < 1e-5);
    // X-Val: README of drive0708: |f| 9.924 m/s² in the first 30 s
    let rest: Vec<_> = file.imu.samples().iter().take(3000).collect();
    let velocity: Vector3<f64> = rest.iter().skip(1).map(|s| s.velocity_mps).sum();
    let force = velocity.norm() / (rest[rest.len() - 1].time_s - rest[0].time_s);
    assert!((force - 9.924).abs() < 0.005, "{force}");
}

#[test]
#[allow(clippy::print_stderr)]
fn a_simulated_drive_is_read_whole_and_fast() {
    let (Some(imu), Some(gnss), Some(odometer)) =
        (real("whu-sim27/imu.txt.gz"), real("whu-sim27/gnss.txt.gz"), real("whu-sim27/odo.txt.gz"))
    else {
        return;
    };
    let start = Instant::now();
    let imu = read_imu(&imu, &ImuReadOptions::default()).expect("KF-GINS");
    let numbers = 7.0 * 161_395.0;
    eprintln!("{:.3} µs a number", start.elapsed().as_secs_f64() / numbers * 1e6);
    assert_eq!(imu.imu.samples().len(), 161_395);
    assert!(imu.notes.is_empty() && !imu.is_slow(), "{:?}", imu.notes);
    assert_eq!(imu.time_encoding, TimeEncoding::SecondsOfWeek);
    let gnss = read_gnss(&gnss, &GnssReadOptions::default()).expect("KF-GINS");
    assert_eq!((gnss.fixes.len(), gnss.week), (1612, None));
    let odometer = read_odometer(&odometer, None).expect("two columns");
    assert_eq!(odometer.samples.len(), 16_139);
    assert!((odometer.samples[0].speed_mps + 0.0694).abs() < 1e-12 && odometer.notes.is_empty());
}

#[test]
fn real_fixes_of_two_drives_are_read_whatever_their_name() {
    for (name, count) in [("whu-routes/kf-gins_GNSS-RTK.txt.gz", 3413), ("whu-routes/ob_gins_GNSS_RTK.pos.gz", 1616)] {
        let Some(path) = real(name) else { return };
        let file = read_gnss(&path, &GnssReadOptions::default()).expect(name);
        assert_eq!((file.format, file.fixes.len()), (GnssFormat::KfGins, count), "{name}");
        assert!(file.notes.is_empty(), "{:?}", file.notes);
        assert!((file.fixes[0].geodetic.x.to_degrees() - 30.45).abs() < 0.1);
        assert!(file.fixes.iter().all(|fix| fix.covariance_ned_m2[(0, 0)] < 0.5_f64.powi(2)));
    }
}
