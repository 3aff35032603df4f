#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(net) = tieline_io::network::gama::parse(text) {
        let _ = tieline::net::geodetic::GeodeticNet::new(net);
    }
});
