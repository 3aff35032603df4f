//! Picked points of any bytes, by themselves and below a good header.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::ties::picked::read_from;

const HEADER: &[u8] = b"point,gps_time_s,x_m,y_m,z_m,sigma_plan_m,sigma_height_m,scanner\n";

fuzz_target!(|data: &[u8]| {
    let below = [HEADER, data].concat();
    for text in [data, &below[..]] {
        let Ok(points) = read_from(Cursor::new(text), Path::new("fuzz")) else { continue };
        for point in &points {
            assert!(point.sightings.len() + usize::from(point.known.is_some()) >= 2, "{point:?}");
            assert!(point.sightings.windows(2).all(|w| w[0].gps_time_s <= w[1].gps_time_s), "{point:?}");
            for row in point.sightings.iter().map(|s| &s.row).chain(&point.known) {
                assert!(row.place_m.iter().all(|v| v.is_finite()) && row.sigma_m.iter().all(|s| *s > 0.0), "{row:?}");
            }
        }
    }
});
