//! CRS texts: EPSG, WKT and proj strings; what is understood must not panic on a position either.
#![no_main]

use libfuzzer_sys::fuzz_target;
use nalgebra::Vector3;
use tieline_io::crs::Crs;

fuzz_target!(|text: &str| {
    if let Ok(crs) = Crs::parse(text) {
        let place = Vector3::new(0.82, 0.15, 500.0);
        if let Ok(map) = crs.map_from_geodetic(&place) {
            let _ = crs.geodetic_from_map(&map);
            let _ = crs.grid_at(&place);
        }
    }
});
