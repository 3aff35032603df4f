//! `TerraScan` trajectories of any bytes.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::trajectory::trj;

fuzz_target!(|data: &[u8]| {
    let path = Path::new("fuzz");
    if let Ok(file) = trj::read_from(data, path) {
        let _ = file.into_trajectory(path);
    }
});
