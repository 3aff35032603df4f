//! Ties: what a scanner on the platform sees of planes, several times.

use nalgebra::{Matrix3, Vector3};
use tieline_filter::earth::{geodetic_from_ecef, ned_from_ecef};
use tieline_filter::{FilterTie, Sighting, TieKind};

use super::inertial::count;
use super::motion::Motion;
use crate::random::Random;

/// Loop ties: planes that are seen again when the platform passes by again.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopScenario {
    /// Stretch that is looked at from, and the spans of time in which it is passed again: the planes lie along the
    /// first span.
    pub first_s: (f64, f64),
    /// Spans of time in which the stretch is passed again.
    pub again_s: Vec<(f64, f64)>,
    /// Interval between places with planes, in time of the first pass \[s\].
    pub interval_s: f64,
    /// How near the platform must come to its own path \[m\].
    pub near_m: f64,
    /// Noise of a sighting along the normal \[m\].
    pub sigma_m: f64,
    /// Share of ties of which one sighting is false, and by how much \[m\].
    pub blunders: (f64, f64),
}

/// Height increments: the same patch of road seen twice, a moment apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IncrementScenario {
    /// Span of time \[s\].
    pub span_s: (f64, f64),
    /// Interval between increments \[s\].
    pub interval_s: f64,
    /// Time between the two sightings \[s\].
    pub apart_s: f64,
    /// Noise of an increment \[m\].
    pub sigma_m: f64,
    /// Error that all increments share \[m\]; nobody is told.
    pub bias_m: f64,
    /// Share of increments that are false, and by how much \[m\].
    pub blunders: (f64, f64),
}

/// Whether a tie is a false one: of as many as the share says, one is, at a place of chance.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn is_false(share: f64, number: u64, seed: u64) -> bool {
    if share <= 0.0 {
        return false;
    }
    let block = (1.0 / share).round().max(1.0) as u64;
    Random::new(seed, &[71, number / block]).below(block) == number % block
}

/// A sighting of a plane from the motion at a time: `hit` is where the beam ends, `error_m` what is measured too far along
/// the normal.
fn sighting(
    motion: &Motion,
    time_s: f64,
    hit: &Vector3<f64>,
    normal: &Vector3<f64>,
    error_m: f64,
    sigma_m: f64,
) -> Sighting {
    let body_from_ecef = motion.ecef_from_body(time_s).transpose();
    Sighting {
        time_s,
        body_vector_m: body_from_ecef * (hit + normal * error_m - motion.ecef_m(time_s)),
        covariance_m2: Matrix3::identity() * (sigma_m * sigma_m),
        by_constant: Vec::new(),
    }
}

/// A point of a plane near another one.
fn on_plane(point: &Vector3<f64>, normal: &Vector3<f64>, random: &mut Random) -> Vector3<f64> {
    let away = Vector3::new(random.normal(), random.normal(), random.normal()) * 0.5;
    point + away - normal * normal.dot(&away)
}

/// North, east, down of a place in earth-centred axes, as columns.
fn ecef_from_ned(ecef_m: &Vector3<f64>) -> Matrix3<f64> {
    let geodetic = geodetic_from_ecef(ecef_m);
    ned_from_ecef(geodetic.x, geodetic.y).transpose()
}

impl LoopScenario {
    /// The ties of a motion: at every place the road and two walls.
    #[must_use]
    pub fn ties(&self, motion: &Motion, first_id: u64, seed: u64) -> Vec<FilterTie> {
        let mut random = Random::new(seed, &[51]);
        let mut ties = Vec::new();
        for k in 0..=count(self.first_s.1 - self.first_s.0, self.interval_s) {
            let seen_s = self.first_s.0 + f64::from(k) * self.interval_s + 0.3 * random.uniform();
            let place = motion.ecef_m(seen_s);
            let mut times = vec![seen_s];
            times.extend(self.again_s.iter().filter_map(|span| nearest(motion, &place, *span, self.near_m)));
            if times.len() < 2 {
                continue;
            }
            let heading = random.between(0.0, std::f64::consts::TAU);
            let (s, c) = heading.sin_cos();
            // the road with its cross fall, a wall, and another almost across it
            let planes = [
                (Vector3::new(0.03 * random.normal(), 0.03 * random.normal(), -1.0), Vector3::new(0.0, 0.0, 2.0)),
                (Vector3::new(c, s, 0.01 * random.normal()), Vector3::new(-12.0 * c, -12.0 * s, -2.0)),
                (Vector3::new(-s, c, 0.2 * random.normal()), Vector3::new(9.0 * s, -9.0 * c, -4.0)),
            ];
            let axes = ecef_from_ned(&place);
            for (normal, away) in planes {
                let normal = (axes * normal).normalize();
                let point = place + axes * away;
                let is_false = is_false(self.blunders.0, ties.len() as u64, seed);
                let wrong = usize::try_from(random.below(times.len() as u64)).unwrap_or(0);
                let size = if random.uniform() < 0.5 { self.blunders.1 } else { -self.blunders.1 };
                let mut sightings: Vec<Sighting> = times
                    .iter()
                    .enumerate()
                    .map(|(k, time_s)| {
                        // one plane after the other comes into view
                        let time_s = time_s + random.between(-0.4, 0.4);
                        let hit = on_plane(&point, &normal, &mut random);
                        let mut error_m = self.sigma_m * random.normal();
                        if is_false && k == wrong {
                            error_m += size;
                        }
                        sighting(motion, time_s, &hit, &normal, error_m, self.sigma_m)
                    })
                    .collect();
                sightings.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
                ties.push(FilterTie {
                    id: first_id + ties.len() as u64,
                    kind: TieKind::SurfaceLine,
                    directions: vec![normal],
                    sightings,
                    known_m: None,
                });
            }
        }
        ties
    }
}

/// When a motion passes a place within a span of time, if it comes near.
fn nearest(motion: &Motion, place: &Vector3<f64>, (from_s, to_s): (f64, f64), near_m: f64) -> Option<f64> {
    let distance = |time_s: f64| (motion.ecef_m(time_s) - place).norm();
    (0..=count(to_s - from_s, 0.1))
        .map(|k| from_s + 0.1 * f64::from(k))
        .map(|time_s| (distance(time_s), time_s))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(d, _)| *d <= near_m)
        .map(|(_, time_s)| time_s)
}

impl IncrementScenario {
    /// The ties of a motion.
    #[must_use]
    pub fn ties(&self, motion: &Motion, first_id: u64, seed: u64) -> Vec<FilterTie> {
        let mut random = Random::new(seed, &[61]);
        let of_end = self.sigma_m / 2.0_f64.sqrt();
        (0..count(self.span_s.1 - self.span_s.0 - self.apart_s, self.interval_s))
            .map(|k| {
                let from_s = self.span_s.0 + f64::from(k) * self.interval_s;
                let middle = motion.ecef_m(from_s + 0.5 * self.apart_s);
                let axes = ecef_from_ned(&middle);
                let up = -axes.column(2).into_owned();
                let point = middle - up * 2.0;
                let is_false = is_false(self.blunders.0, u64::from(k), seed);
                let size = if random.uniform() < 0.5 { self.blunders.1 } else { -self.blunders.1 };
                let beyond = self.bias_m + if is_false { size } else { 0.0 };
                let sightings = [(from_s, 0.0), (from_s + self.apart_s, -beyond)]
                    .map(|(time_s, error_m)| {
                        let hit = on_plane(&point, &up, &mut random);
                        sighting(motion, time_s, &hit, &up, error_m + of_end * random.normal(), of_end)
                    })
                    .to_vec();
                FilterTie {
                    id: first_id + u64::from(k),
                    kind: TieKind::Increment,
                    directions: vec![up],
                    sightings,
                    known_m: None,
                }
            })
            .collect()
    }
}
