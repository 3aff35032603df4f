//! A platform at rest: zero velocity, and an attitude that does not change.
//!
//! Zero rotation compares the attitude now with a clone of that at the start of the rest. Reading the gyros' mean as their
//! bias instead would use the same noise twice: once in the mechanisation, once as a measurement.

use nalgebra::UnitQuaternion;

use crate::kalman::Measurement;
use crate::state::{ATTITUDE, Nominal, VELOCITY};

/// Zero velocity.
#[must_use]
pub fn velocity(nominal: &Nominal, sigma_mps: f64) -> Measurement {
    let v = nominal.nav.velocity_ned_mps;
    let mut noise = vec![0.0; 9];
    for k in 0..3 {
        noise[4 * k] = sigma_mps * sigma_mps;
    }
    Measurement {
        residual: v.iter().map(|v| -v).collect(),
        rows: (0..3).map(|k| vec![(VELOCITY + k, 1.0)]).collect(),
        noise,
    }
}

/// Zero rotation since a clone of the attitude error was taken at index `clone`, when the nominal was `then`.
#[must_use]
pub fn rotation(nominal: &Nominal, then: &UnitQuaternion<f64>, clone: [usize; 3], sigma_rad: f64) -> Measurement {
    let turned = (nominal.nav.ned_from_body * then.inverse()).scaled_axis();
    let mut noise = vec![0.0; 9];
    for k in 0..3 {
        noise[4 * k] = sigma_rad * sigma_rad;
    }
    Measurement {
        residual: turned.iter().map(|v| -v).collect(),
        rows: (0..3).map(|k| vec![(ATTITUDE + k, 1.0), (clone[k], -1.0)]).collect(),
        noise,
    }
}
