//! Text of an IMU, any bytes: by its header, as KF-GINS, and by a pattern that the first line may hold.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::measurements::imu::read_from;
use tieline_io::measurements::{ImuFormat, ImuKind, ImuReadOptions};

fuzz_target!(|data: &[u8]| {
    let read = |data: &[u8], options: &ImuReadOptions| {
        if let Ok(file) = read_from(Cursor::new(data), Path::new("fuzz"), options) {
            let samples = file.imu.samples();
            assert!(samples.windows(2).all(|w| w[0].time_s < w[1].time_s));
            assert!(samples.iter().all(|s| s.angle_rad.amax().is_finite() && s.velocity_mps.amax().is_finite()));
        }
    };
    let format = Some(ImuFormat::Text);
    read(data, &ImuReadOptions { format, ..Default::default() });
    let (format, kind) = (Some(ImuFormat::KfGins), Some(ImuKind::Rates));
    read(data, &ImuReadOptions { format, kind, ..Default::default() });
    let end = data.iter().position(|b| *b == b'\n').unwrap_or(0);
    let columns = Some(String::from_utf8_lossy(&data[..end]).split(',').map(str::to_string).collect());
    read(&data[end..], &ImuReadOptions { columns, ..Default::default() });
});
