//! SBET and SMRMSG of any bytes: an error or a trajectory, and its way through a projection.
#![no_main]

use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use tieline_io::crs::Crs;
use tieline_io::trajectory::{sbet, smrmsg};

static UTM: LazyLock<Crs> = LazyLock::new(|| Crs::parse("EPSG:25832").expect("a known code"));

fuzz_target!(|data: &[u8]| {
    let path = Path::new("fuzz");
    let accuracy = smrmsg::read_from(data, path);
    if let Ok(file) = sbet::read_from(data, path) {
        let _ = file.to_map(&UTM);
        if let Ok(accuracy) = accuracy {
            let _ = accuracy.join(file.trajectory);
        }
    }
});
