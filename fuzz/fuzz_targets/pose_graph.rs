#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(graph) = tieline_io::pose_graph::parse(text) {
        // what was read can be written and read again, and made a problem or refused
        if let Ok(text) = tieline_io::pose_graph::format(&graph, tieline_io::pose_graph::Format::G2o) {
            assert!(tieline_io::pose_graph::parse(&text).is_ok());
        }
        let _ = tieline::net::pose_graph::problem(&graph, tieline_graph::factor::Convention::Plain);
    }
});
