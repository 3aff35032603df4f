//! Scenarios that come with the crate.

use crate::random::Random;
use crate::scenario::{
    Area, Flight, LineGroup, OutputOptions, ScannerOptions, Scenario, TrajectoryErrors, WorldOptions,
};

fn group(direction_deg: f64, height_m: f64, lines: u32, spacing_m: f64) -> LineGroup {
    LineGroup { direction_deg, height_m, lines, spacing_m, offset_m: 0.0 }
}

impl Scenario {
    /// A block of twelve strips in three directions, both ways each, at two heights over a town of 500 m × 400 m, 3 to 4 points/m² a
    /// strip. The seed draws the world, the motion, the drifts, and the scanner's errors: boresight 0.02°, lever arm
    /// 2 cm, range offset 2 cm, range scale 30 ppm, one sigma each.
    #[must_use]
    pub fn airborne_block(seed: u64) -> Self {
        let mut random = Random::new(seed, &[7]);
        let mut vector = |sd: f64| [random.normal() * sd, random.normal() * sd, random.normal() * sd];
        let (boresight_error_deg, lever_arm_error_m) = (vector(0.02), vector(0.02));
        let range = vector(1.0);
        Self {
            name: format!("airborne block, seed {seed}"),
            seed,
            flight: Flight {
                groups: vec![
                    group(0.0, 500.0, 2, 180.0),
                    group(90.0, 500.0, 2, 180.0),
                    group(45.0, 500.0, 2, 180.0),
                    group(0.0, 1200.0, 2, 120.0),
                    group(90.0, 1200.0, 2, 120.0),
                    group(45.0, 1200.0, 2, 120.0),
                ],
                ..Flight::default()
            },
            scanners: vec![ScannerOptions {
                boresight_error_deg,
                lever_arm_error_m,
                range_offset_m: 0.02 * range[0],
                range_scale_ppm: 30.0 * range[1],
                ..ScannerOptions::default()
            }],
            ..Self::default()
        }
    }

    /// A village of 170 m × 170 m under five strips, small enough to be shipped (at most 3.5 MB of LAZ), with errors
    /// of 5 to 10 cm that can be seen.
    #[must_use]
    pub fn airborne_sample() -> Self {
        Self {
            name: "airborne sample".into(),
            seed: 7,
            area: Area { east_m: 170.0, north_m: 170.0 },
            world: WorldOptions {
                relief_m: 4.0,
                buildings: 36,
                trees: 25,
                moving_objects: 4,
                ground_roughness_m: 0.005,
            },
            flight: Flight {
                speed_mps: 50.0,
                lead_m: 15.0,
                groups: vec![group(20.0, 350.0, 2, 60.0), group(110.0, 350.0, 2, 60.0), group(65.0, 500.0, 1, 0.0)],
                ..Flight::default()
            },
            scanners: vec![ScannerOptions {
                field_of_view_deg: 34.0,
                pulse_rate_hz: 48_000.0,
                line_rate_hz: 106.0,
                boresight_error_deg: [0.008, -0.01, 0.02],
                lever_arm_error_m: [0.01, -0.02, 0.015],
                range_offset_m: 0.02,
                range_scale_ppm: 20.0,
                ..ScannerOptions::default()
            }],
            errors: TrajectoryErrors {
                position_constant_sd_m: 0.05,
                position_linear_sd_m: 0.02,
                attitude_constant_sd_deg: 0.005,
                attitude_linear_sd_deg: 0.002,
            },
            output: OutputOptions { trajectory_rate_hz: 50.0, ..OutputOptions::default() },
            ..Self::default()
        }
    }
}
