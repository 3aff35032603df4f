//! Odometer files of any bytes, by themselves and by a pattern that the first line may hold.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::measurements::odometer::read_from;

fuzz_target!(|data: &[u8]| {
    let path = Path::new("fuzz");
    if let Ok(file) = read_from(Cursor::new(data), path, None) {
        assert!(file.samples.windows(2).all(|w| w[0].time_s < w[1].time_s));
        assert!(file.samples.iter().all(|s| s.speed_mps.is_finite()));
    }
    let end = data.iter().position(|b| *b == b'\n').unwrap_or(0);
    let columns: Vec<String> = String::from_utf8_lossy(&data[..end]).split(',').map(str::to_string).collect();
    let _ = read_from(Cursor::new(&data[end..]), path, Some(&columns));
});
