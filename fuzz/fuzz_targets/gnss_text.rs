//! GNSS fixes in columns, any bytes: recognised, as KF-GINS, and by a pattern that the first line may hold.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::measurements::gnss::read_from;
use tieline_io::measurements::{GnssFormat, GnssReadOptions};

fuzz_target!(|data: &[u8]| {
    let read = |data: &[u8], options: &GnssReadOptions| {
        if let Ok(file) = read_from(Cursor::new(data), Path::new("fuzz"), options) {
            assert!(file.fixes.windows(2).all(|w| w[0].time_s < w[1].time_s));
            for fix in &file.fixes {
                assert!(fix.geodetic.iter().all(|v| v.is_finite()), "{fix:?}");
                assert!(fix.covariance_ned_m2.diagonal().min() > 0.0, "{fix:?}");
            }
        }
    };
    read(data, &GnssReadOptions::default());
    read(data, &GnssReadOptions { format: Some(GnssFormat::KfGins), columns: None });
    let end = data.iter().position(|b| *b == b'\n').unwrap_or(0);
    let columns = Some(String::from_utf8_lossy(&data[..end]).split(',').map(str::to_string).collect());
    read(&data[end..], &GnssReadOptions { format: None, columns });
});
