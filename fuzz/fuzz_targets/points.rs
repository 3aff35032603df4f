//! Known points of any bytes, by themselves and by a pattern that the first line may hold.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::measurements::points::read_from;

fuzz_target!(|data: &[u8]| {
    let path = Path::new("fuzz");
    if let Ok(file) = read_from(Cursor::new(data), path, None) {
        assert!(file.points.windows(2).all(|w| w[0].time_s <= w[1].time_s));
        for point in &file.points {
            assert!(point.geodetic.iter().chain(&point.body_vector_m).all(|v| v.is_finite()), "{point:?}");
            assert!(point.covariance_ned_m2.diagonal().min() > 0.0, "{point:?}");
        }
    }
    let end = data.iter().position(|b| *b == b'\n').unwrap_or(0);
    let columns: Vec<String> = String::from_utf8_lossy(&data[..end]).split(',').map(str::to_string).collect();
    let _ = read_from(Cursor::new(&data[end..]), path, Some(&columns));
});
