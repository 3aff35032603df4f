//! Binary of an IMU, any bytes: recognised, and as increments and rates along turned axes.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::measurements::imu::read_from;
use tieline_io::measurements::{ImuFormat, ImuKind, ImuReadOptions};

fuzz_target!(|data: &[u8]| {
    let path = Path::new("fuzz");
    let _ = read_from(Cursor::new(data), path, &ImuReadOptions::default());
    for kind in [ImuKind::Increments, ImuKind::Rates] {
        let axes = "RFU".parse().expect("right-handed");
        let options = ImuReadOptions { format: Some(ImuFormat::Binary), kind: Some(kind), axes, ..Default::default() };
        if let Ok(file) = read_from(Cursor::new(data), path, &options) {
            let samples = file.imu.samples();
            assert!(samples.windows(2).all(|w| w[0].time_s < w[1].time_s));
            assert!(samples.iter().all(|s| s.angle_rad.amax().is_finite() && s.velocity_mps.amax().is_finite()));
        }
    }
});
