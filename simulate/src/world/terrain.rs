//! Rolling ground: a sum of waves, smooth and known everywhere.

use nalgebra::Vector3;

use crate::random::Random;

/// A wave: height `amplitude · sin(kx x + ky y + phase)`.
#[derive(Debug, Clone, Copy)]
struct Wave {
    amplitude_m: f64,
    kx: f64,
    ky: f64,
    phase: f64,
}

/// The ground.
#[derive(Debug, Clone)]
pub struct Terrain {
    waves: Vec<Wave>,
}

/// Wave lengths \[m\] and their share of the relief.
const WAVES: [(f64, f64); 5] = [(620.0, 0.45), (410.0, 0.3), (270.0, 0.16), (170.0, 0.06), (110.0, 0.03)];
/// Newton steps of a ray cast; three suffice for the slopes that there are.
const STEPS: usize = 12;

impl Terrain {
    pub(super) fn new(seed: u64, relief_m: f64) -> Self {
        let mut random = Random::new(seed, &[1]);
        let waves = WAVES.iter().map(|(length_m, share)| {
            let (direction, phase) = (random.between(0.0, std::f64::consts::TAU), random.between(0.0, 6.2));
            let k = std::f64::consts::TAU / length_m;
            Wave { amplitude_m: relief_m * share, kx: k * direction.cos(), ky: k * direction.sin(), phase }
        });
        Self { waves: waves.collect() }
    }

    /// Height \[m\] and its derivatives to the east and north.
    #[must_use]
    pub fn height(&self, east_m: f64, north_m: f64) -> (f64, f64, f64) {
        let (mut z, mut dx, mut dy) = (0.0, 0.0, 0.0);
        for wave in &self.waves {
            let (sin, cos) = (wave.kx * east_m + wave.ky * north_m + wave.phase).sin_cos();
            z += wave.amplitude_m * sin;
            dx += wave.amplitude_m * cos * wave.kx;
            dy += wave.amplitude_m * cos * wave.ky;
        }
        (z, dx, dy)
    }

    /// Highest ground there can be \[m\].
    #[must_use]
    pub fn highest_m(&self) -> f64 {
        self.waves.iter().map(|wave| wave.amplitude_m).sum()
    }

    /// Distance \[m\] along a downward ray to the ground, and the unit normal there; to a nanometre. `None` when the
    /// ray does not come down.
    pub(super) fn hit(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
        if direction.z > -0.05 {
            return None;
        }
        let mut t = -origin.z / direction.z;
        for _ in 0..STEPS {
            let p = origin + direction * t;
            let (z, dx, dy) = self.height(p.x, p.y);
            let closing = direction.z - dx * direction.x - dy * direction.y;
            let step = (z - p.z) / closing;
            t += step;
            if step.abs() < 1e-9 {
                return Some((t, Vector3::new(-dx, -dy, 1.0).normalize()));
            }
        }
        None
    }
}
