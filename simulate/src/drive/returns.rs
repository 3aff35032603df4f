//! Light that comes back from a beam, and what of it the receiver notices.

use super::scene::Material;
use crate::random::Random;

/// How steeply the chance of an echo falls with its strength.
const DETECTION_POWER: i32 = 4;

/// Light that came back.
#[derive(Debug, Clone, Copy)]
pub(super) struct Return {
    /// Way to it \[m\].
    pub(super) distance_m: f64,
    /// In that at which half the echoes are noticed.
    pub(super) strength: f64,
    /// What it came from.
    pub(super) material: Material,
    /// Brightness.
    pub(super) intensity: f64,
    /// Cosine of the angle between the beam and the normal of the surface.
    pub(super) cosine: f64,
}

const NOTHING: Return =
    Return { distance_m: 0.0, strength: 0.0, material: Material::Asphalt, intensity: 0.0, cosine: 1.0 };

/// Returns of a pulse.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) list: [Return; 3],
    pub(super) count: usize,
}

impl Found {
    /// None yet.
    pub(super) fn new() -> Self {
        Self { list: [NOTHING; 3], count: 0 }
    }

    pub(super) fn add(&mut self, found: Return) {
        self.list[self.count] = found;
        self.count += 1;
    }

    /// Those that the receiver notices.
    pub(super) fn detect(mut self, random: &mut Random) -> ([Return; 3], usize) {
        let mut kept = 0;
        for k in 0..self.count {
            let power = self.list[k].strength.powi(DETECTION_POWER);
            if random.uniform() < power / (1.0 + power) {
                self.list[kept] = self.list[k];
                kept += 1;
            }
        }
        (self.list, kept)
    }
}

/// Two surfaces that are taken for one: somewhere between them.
pub(super) fn mixed(near: &Return, far: &Return) -> Return {
    let share = near.strength / (near.strength + far.strength).max(1e-12);
    Return {
        distance_m: far.distance_m + (near.distance_m - far.distance_m) * share,
        strength: near.strength + far.strength,
        material: if share > 0.5 { near.material } else { far.material },
        intensity: near.intensity + far.intensity,
        cosine: if share > 0.5 { near.cosine } else { far.cosine },
    }
}
