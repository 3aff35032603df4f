//! Text trajectories of any bytes, by their header and by a pattern: the first line may be a list of column names.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::trajectory::text;

fuzz_target!(|data: &[u8]| {
    let path = Path::new("fuzz");
    let _ = text::read_from(|| Ok(Cursor::new(data)), path, None);
    let end = data.iter().position(|b| *b == b'\n').unwrap_or(0);
    let columns: Vec<String> = String::from_utf8_lossy(&data[..end]).split(',').map(str::to_string).collect();
    let _ = text::read_from(|| Ok(Cursor::new(&data[end..])), path, Some(&columns));
    let fixed = ["time_s", "lat_deg", "lon_deg", "h_m", "roll_deg", "pitch_deg", "yaw_deg"].map(str::to_string);
    let _ = text::read_from(|| Ok(Cursor::new(data)), path, Some(&fixed));
});
