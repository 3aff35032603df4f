//! Geodetic nets of any size: a jittered grid of stations, triangulated, with direction sets and some distances or
//! with GNSS baselines; control stations in the corners and the middle.

use nalgebra::Vector3;

use crate::random::Random;

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NetKind {
    /// Direction sets both ways (1″) and some distances (1 cm + 1 ppm), in the plane.
    Directions,
    /// GNSS baselines in space.
    Baselines,
}

/// A measured quantity between stations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NetObservation {
    /// Direction of a set: station, target, reading \[rad\].
    Direction(u32, u32, f64),
    /// Distance: from, to, \[m\], sigma \[m\].
    Distance(u32, u32, f64, f64),
    /// Baseline: from, to, difference \[m\].
    Baseline(u32, u32, Vector3<f64>),
}

/// A net as a surveyor has it.
#[derive(Debug, Clone)]
pub struct SimulatedNet {
    /// What is measured.
    pub kind: NetKind,
    /// Approximate places, true for control stations: east, north, up \[m\].
    pub approximate_m: Vec<Vector3<f64>>,
    /// Control stations.
    pub control: Vec<u32>,
    /// Measurements, direction sets in one piece.
    pub observations: Vec<NetObservation>,
}

/// Standard deviation of a direction \[rad\]: one second.
pub const DIRECTION_SIGMA_RAD: f64 = std::f64::consts::PI / 648_000.0;
/// Stream of random numbers.
const NET: u64 = 0x6e65_7400;
/// Sides of the grid \[m\].
const SPACING_M: f64 = 10_000.0;

/// Covariance of every baseline \[m²\], rows x, y, z.
pub const BASELINE_COVARIANCE_M2: [[f64; 3]; 3] =
    [[1.0e-4, 2.5e-5, 2.0e-5], [2.5e-5, 1.25e-4, 3.0e-5], [2.0e-5, 3.0e-5, 2.25e-4]];

/// A net of at least `stations` stations, and the true places.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss, clippy::cast_sign_loss)]
pub fn simulate_net(stations: usize, kind: NetKind, seed: u64) -> (SimulatedNet, Vec<Vector3<f64>>) {
    let side = ((stations as f64).sqrt().ceil() as usize).max(3);
    let mut random = Random::new(seed, &[NET]);
    let index = |row: usize, column: usize| (row * side + column) as u32;
    let truth: Vec<Vector3<f64>> = (0..side * side)
        .map(|k| {
            let jitter = Vector3::new(random.between(-0.3, 0.3), random.between(-0.3, 0.3), 0.0);
            let height = if kind == NetKind::Baselines { random.between(0.0, 500.0) } else { 0.0 };
            let at = Vector3::new((k % side) as f64, (k / side) as f64, 0.0);
            (at + jitter) * SPACING_M + Vector3::z() * height
        })
        .collect();
    let last = side - 1;
    let control = vec![index(0, 0), index(0, last), index(last, 0), index(last, last), index(side / 2, side / 2)];
    let off = if kind == NetKind::Baselines { 0.3 } else { 0.0 };
    let mut approximate_m: Vec<Vector3<f64>> = truth
        .iter()
        .map(|t| t + Vector3::new(0.3 * random.normal(), 0.3 * random.normal(), off * random.normal()))
        .collect();
    for c in &control {
        approximate_m[*c as usize] = truth[*c as usize];
    }
    let lines = lines(side);
    let observations = match kind {
        NetKind::Directions => directions(&truth, &lines, &mut random),
        NetKind::Baselines => baselines(&truth, side, &mut random),
    };
    (SimulatedNet { kind, approximate_m, control, observations }, truth)
}

/// Sides of the triangles.
#[allow(clippy::cast_possible_truncation)]
fn lines(side: usize) -> Vec<(u32, u32)> {
    let index = |row: usize, column: usize| (row * side + column) as u32;
    let mut lines = Vec::with_capacity(3 * side * side);
    for row in 0..side {
        for column in 0..side {
            if column + 1 < side {
                lines.push((index(row, column), index(row, column + 1)));
            }
            if row + 1 < side {
                lines.push((index(row, column), index(row + 1, column)));
            }
            if row + 1 < side && column + 1 < side {
                lines.push((index(row, column), index(row + 1, column + 1)));
            }
        }
    }
    lines
}

fn directions(truth: &[Vector3<f64>], lines: &[(u32, u32)], random: &mut Random) -> Vec<NetObservation> {
    let mut starts = vec![0_usize; truth.len() + 1];
    for (a, b) in lines {
        starts[*a as usize + 1] += 1;
        starts[*b as usize + 1] += 1;
    }
    for k in 0..truth.len() {
        starts[k + 1] += starts[k];
    }
    let mut next = starts.clone();
    let mut targets = vec![0_u32; 2 * lines.len()];
    for (a, b) in lines {
        for (from, to) in [(*a, *b), (*b, *a)] {
            targets[next[from as usize]] = to;
            next[from as usize] += 1;
        }
    }
    let mut observations = Vec::with_capacity(2 * lines.len() + lines.len() / 4);
    for (station, window) in starts.windows(2).enumerate() {
        let zero = random.between(0.0, std::f64::consts::TAU);
        for to in &targets[window[0]..window[1]] {
            let d = truth[*to as usize] - truth[station];
            let reading = d.y.atan2(d.x) - zero + DIRECTION_SIGMA_RAD * random.normal();
            let station = u32::try_from(station).unwrap_or(u32::MAX);
            observations.push(NetObservation::Direction(station, *to, reading.rem_euclid(std::f64::consts::TAU)));
        }
    }
    for (k, (a, b)) in lines.iter().enumerate() {
        if k % 9 < 2 {
            let length = (truth[*b as usize] - truth[*a as usize]).norm();
            let sigma = 0.01 + 1e-6 * length;
            observations.push(NetObservation::Distance(*a, *b, length + sigma * random.normal(), sigma));
        }
    }
    observations
}

/// Sides of the grid and a fifth of the diagonals: 2.2 baselines a station.
#[allow(clippy::cast_possible_truncation)]
fn baselines(truth: &[Vector3<f64>], side: usize, random: &mut Random) -> Vec<NetObservation> {
    let rows = BASELINE_COVARIANCE_M2;
    let covariance = nalgebra::Matrix3::from_fn(|r, c| rows[r][c]);
    let lower = covariance.cholesky().map_or_else(nalgebra::Matrix3::zeros, |c| c.l());
    lines(side)
        .iter()
        .enumerate()
        .filter(|(k, (a, b))| {
            let diagonal = b - a == side as u32 + 1;
            !diagonal || k % 5 == 0
        })
        .map(|(_, (a, b))| {
            let noise = lower * Vector3::new(random.normal(), random.normal(), random.normal());
            NetObservation::Baseline(*a, *b, truth[*b as usize] - truth[*a as usize] + noise)
        })
        .collect()
}

/// Places of false loop edges: pairs of vertices, drawn evenly, no neighbours, with a relative pose that has nothing
/// to do with theirs.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss, clippy::cast_sign_loss)]
pub fn false_loops(vertices: usize, count: usize, seed: u64) -> Vec<(usize, usize, [f64; 3])> {
    let mut random = Random::new(seed, &[NET + 1]);
    let mut loops = Vec::with_capacity(count);
    while loops.len() < count {
        let a = (random.between(0.0, vertices as f64) as usize).min(vertices - 1);
        let b = (random.between(0.0, vertices as f64) as usize).min(vertices - 1);
        if a.abs_diff(b) > 10 {
            let m = [random.between(-1.0, 1.0), random.between(-1.0, 1.0), random.between(-3.1, 3.1)];
            loops.push((a.min(b), a.max(b), m));
        }
    }
    loops
}
