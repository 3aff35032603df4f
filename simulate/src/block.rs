//! Blocks of parallel strips with cross strips: ties between neighbours, corrections as splines over time, one
//! calibration; truth drawn from the priors.

use nalgebra::{Rotation3, Vector3};

use crate::random::Random;

const BLOCK: u64 = 0x626c_6f63;

/// What a block is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockOptions {
    /// Parallel strips.
    pub strips: usize,
    /// Cross strips.
    pub cross_strips: usize,
    /// Knots of a strip's corrections.
    pub knots: usize,
    /// Ties in all, about.
    pub ties: usize,
    /// Seed.
    pub seed: u64,
}

/// Prior sigmas of a knot: position \[m\], rotation \[rad\].
pub const KNOT_SIGMAS: [f64; 6] = [0.05, 0.05, 0.08, 1.0e-4, 1.0e-4, 2.0e-4];
/// Prior sigmas of the calibration: boresight \[rad\], lever arm \[m\].
pub const CALIBRATION_SIGMAS: [f64; 6] = [2.0e-3, 2.0e-3, 2.0e-3, 0.05, 0.05, 0.05];
/// Sigma of a tie \[m\].
pub const TIE_SIGMA_M: f64 = 0.01;
/// Distance of strips, of knots, and height above ground \[m\].
pub const SPACING_M: f64 = 300.0;
const KNOT_M: f64 = 150.0;
const HEIGHT_M: f64 = 800.0;

/// One end of a simulated tie.
#[derive(Debug, Clone, Copy)]
pub struct BlockEnd {
    /// Strip; cross strips after the parallel ones.
    pub strip: usize,
    /// First of four knots.
    pub knot: usize,
    /// Values of the spline's functions.
    pub weights: [f64; 4],
    /// Heading \[rad\].
    pub heading_rad: f64,
    /// The surface from the sensor, in the body \[m\].
    pub body_m: Vector3<f64>,
}

/// A simulated tie.
#[derive(Debug, Clone, Copy)]
pub struct BlockTie {
    /// Its ends.
    pub ends: [BlockEnd; 2],
    /// Normal of the surface.
    pub normal: Vector3<f64>,
    /// Offset along the normal \[m\].
    pub offset_m: f64,
}

/// What a user has of a block.
#[derive(Debug, Clone)]
pub struct Block {
    /// Place of each knot, strip by strip \[m\].
    pub places_m: Vec<[f64; 3]>,
    /// Ties.
    pub ties: Vec<BlockTie>,
}

/// What a user never has.
#[derive(Debug, Clone)]
pub struct BlockTruth {
    /// Corrections of each knot.
    pub knots: Vec<[f64; 6]>,
    /// Boresight and lever arm.
    pub calibration: [f64; 6],
}

/// Values of the four cubic B-splines over a span.
fn spline(u: f64) -> [f64; 4] {
    let v = 1.0 - u;
    [
        v * v * v / 6.0,
        (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
        (3.0 * v * v * v - 6.0 * v * v + 4.0) / 6.0,
        u * u * u / 6.0,
    ]
}

struct Strip {
    from: [f64; 2],
    heading_rad: f64,
    knot_m: f64,
}

/// Simulates a block.
#[must_use]
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub fn simulate_block(options: &BlockOptions) -> (Block, BlockTruth) {
    let spans = (options.knots - 3) as f64;
    let length = KNOT_M * spans;
    let width = SPACING_M * (options.strips - 1) as f64;
    let mut strips = Vec::new();
    for k in 0..options.strips {
        let y = SPACING_M * k as f64;
        // flown there and back, which tells boresight from position
        let (x, heading_rad) = if k % 2 == 0 { (0.0, 0.0) } else { (length, std::f64::consts::PI) };
        strips.push(Strip { from: [x, y], heading_rad, knot_m: KNOT_M });
    }
    for k in 0..options.cross_strips {
        let x = length * (k as f64 + 0.5) / options.cross_strips as f64;
        let heading_rad = std::f64::consts::FRAC_PI_2;
        strips.push(Strip { from: [x, 0.0], heading_rad, knot_m: (width / spans).max(1.0) });
    }
    let mut random = Random::new(options.seed, &[BLOCK]);
    let mut draw = |sigmas: &[f64; 6]| sigmas.map(|s| s * random.normal());
    let calibration = draw(&CALIBRATION_SIGMAS);
    let knots: Vec<[f64; 6]> = (0..strips.len() * options.knots).map(|_| draw(&KNOT_SIGMAS)).collect();
    let truth = BlockTruth { knots, calibration };
    let places_m = strips
        .iter()
        .flat_map(|s| {
            let (sin, cos) = s.heading_rad.sin_cos();
            (0..options.knots).map(move |k| {
                let d = (k as f64 - 1.0) * s.knot_m;
                [s.from[0] + cos * d, s.from[1] + sin * d, 0.0]
            })
        })
        .collect();
    let end = |strip: usize, point: &Vector3<f64>| -> BlockEnd {
        let s = &strips[strip];
        let (sin, cos) = s.heading_rad.sin_cos();
        let along = cos * (point.x - s.from[0]) + sin * (point.y - s.from[1]);
        let at = (along / s.knot_m).clamp(0.0, spans - 1e-9);
        let sensor = Vector3::new(s.from[0] + cos * along, s.from[1] + sin * along, HEIGHT_M);
        let body_m = Rotation3::from_axis_angle(&Vector3::z_axis(), -s.heading_rad) * (point - sensor);
        BlockEnd { strip, knot: at as usize, weights: spline(at.fract()), heading_rad: s.heading_rad, body_m }
    };
    let mut ties = Vec::with_capacity(options.ties);
    let mut random = Random::new(options.seed, &[BLOCK, 1]);
    let crossing = options.strips * options.cross_strips * 4;
    let pairs = options.strips - 1;
    let per_pair = options.ties.saturating_sub(crossing) / pairs.max(1);
    let mut push = |a: usize, b: usize, point: Vector3<f64>, random: &mut Random| {
        let ends = [end(a, &point), end(b, &point)];
        let tilt = if random.uniform() < 0.5 { 0.05 } else { 0.7 };
        let normal = Vector3::new(tilt * random.normal(), tilt * random.normal(), 1.0).normalize();
        let shift = displacement(&ends[0], &truth, options.knots) - displacement(&ends[1], &truth, options.knots);
        // corrections undo what is seen: offset + corrections = noise
        let offset_m = -normal.dot(&shift) + TIE_SIGMA_M * random.normal();
        ties.push(BlockTie { ends, normal, offset_m });
    };
    for k in 0..pairs {
        for _ in 0..per_pair {
            let x = random.between(0.0, length);
            let y = SPACING_M * (k as f64 + random.between(0.2, 0.8));
            let z = random.between(0.0, 60.0);
            push(k, k + 1, Vector3::new(x, y, z), &mut random);
        }
    }
    for c in 0..options.cross_strips {
        for k in 0..options.strips {
            for _ in 0..4 {
                let x = strips[options.strips + c].from[0] + random.between(-200.0, 200.0);
                let y = (SPACING_M * k as f64 + random.between(-200.0, 200.0)).clamp(0.0, width);
                push(k, options.strips + c, Vector3::new(x, y, random.between(0.0, 60.0)), &mut random);
            }
        }
    }
    (Block { places_m, ties }, truth)
}

/// What the true corrections move an end by.
fn displacement(end: &BlockEnd, truth: &BlockTruth, knots: usize) -> Vector3<f64> {
    let (mut position, mut rotation) = (Vector3::zeros(), Vector3::zeros());
    for (k, w) in end.weights.iter().enumerate() {
        let knot = &truth.knots[end.strip * knots + end.knot + k];
        position += *w * Vector3::new(knot[0], knot[1], knot[2]);
        rotation += *w * Vector3::new(knot[3], knot[4], knot[5]);
    }
    let [bx, by, bz, ax, ay, az] = truth.calibration;
    let c = Rotation3::from_axis_angle(&Vector3::z_axis(), end.heading_rad);
    let body = Rotation3::from_scaled_axis(Vector3::new(bx, by, bz)) * end.body_m + Vector3::new(ax, ay, az);
    position + Rotation3::from_scaled_axis(rotation) * (c * body) - c * end.body_m
}
