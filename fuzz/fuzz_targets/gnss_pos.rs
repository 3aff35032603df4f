//! RTKLIB solutions of any bytes: every fix is a place on earth with a covariance that can be inverted.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::measurements::gnss::read_from;
use tieline_io::measurements::{GnssFormat, GnssReadOptions};

fuzz_target!(|data: &[u8]| {
    let options = GnssReadOptions { format: Some(GnssFormat::RtklibPos), columns: None };
    if let Ok(file) = read_from(Cursor::new(data), Path::new("fuzz"), &options) {
        assert!(file.fixes.windows(2).all(|w| w[0].time_s < w[1].time_s));
        for fix in &file.fixes {
            assert!(fix.geodetic.iter().all(|v| v.is_finite()), "{fix:?}");
            assert!(fix.covariance_ned_m2.iter().all(|v| v.is_finite()), "{fix:?}");
            assert!(fix.covariance_ned_m2.diagonal().min() > 0.0, "{fix:?}");
        }
    }
});
