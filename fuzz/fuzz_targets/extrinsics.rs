//! Tables of extrinsics of any bytes: what is read is a rotation and a place.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::extrinsics::read_from;

fuzz_target!(|data: &[u8]| {
    if let Ok(scanners) = read_from(Cursor::new(data), Path::new("fuzz")) {
        assert!(!scanners.is_empty());
        for scanner in &scanners {
            assert!((scanner.reference_from_scanner.norm() - 1.0).abs() < 1e-6, "{scanner:?}");
            assert!(scanner.position_m.iter().all(|v| v.is_finite()), "{scanner:?}");
        }
    }
});
