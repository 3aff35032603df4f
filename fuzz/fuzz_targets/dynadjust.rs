#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let (stations, measurements) = text.split_once("\n--\n").unwrap_or((text, ""));
    if let Ok(mut net) = tieline_io::network::dynadjust::parse_stations(stations) {
        if tieline_io::network::dynadjust::parse_measurements(measurements, &mut net).is_ok() {
            let _ = tieline::net::geodetic::GeodeticNet::new(net);
        }
    }
});
