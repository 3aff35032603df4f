#![no_main]
//! `calibration.toml` as a known calibration: no panic, and what is taken moves a beam to a place that is a number.

use libfuzzer_sys::fuzz_target;
use nalgebra::Vector3;
use tieline::project::parse_str;
use tieline::stage::drive::constants::{Beam, Spread};
use tieline::stage::drive::known::parse;

const PROJECT: &str = "[[strips]]\npath = \"*.laz\"\n[imu]\npath = \"imu.txt\"\ngrade = \"ap60\"\n[platform]\n[[platform.scanner]]\nid = 0\n\
                       lever_arm_m = [1.0, 0.2, -0.3]\nmounting_deg = [0.0, 20.0, 135.0]\n[calibrate]\nknown = \"c.toml\"\n";

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let project = parse_str(PROJECT).expect("a project");
    let Ok(known) = parse(text, "c.toml".as_ref(), &project) else { return };
    let beam = Beam {
        scanner: 0,
        body_vector_m: Vector3::new(4.0, -3.0, 2.0),
        velocity_body_mps: Vector3::new(10.0, 0.0, 0.0),
        rate_body_radps: Vector3::new(0.0, 0.0, 0.2),
        target: tieline::stage::drive::over::Target::default(),
        patch: Spread::default(),
    };
    for one in &known {
        let moved = one.applied(&beam, &Vector3::new(1.0, 0.2, -0.3)).body_vector_m;
        assert!(moved.iter().all(|v| v.is_finite()), "{one:?}");
    }
});
