//! The motion of a vehicle in the plane, by its odometer and a rate gyro whose error drifts.

use nalgebra::Vector2;

use super::Factor;
use crate::rotation::{perpendicular, turn};
use crate::variable::{Values, VariableId, wrap};

/// What a vehicle measured of its motion between two poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArcReading {
    /// Way by the odometer \[m\].
    pub way_m: f64,
    /// Turn by the gyro \[rad\].
    pub turn_rad: f64,
    /// Time between the poses \[s\].
    pub duration_s: f64,
}

/// How good an [`ArcReading`] is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArcSigmas {
    /// Of the way \[m\].
    pub along_m: f64,
    /// Of the slip to the side: wheels roll, they do not slide \[m\].
    pub across_m: f64,
    /// Of the turn, the drifting error apart \[rad\].
    pub turn_rad: f64,
}

/// Motion along an arc between two poses, with the error of the heading rate as an unknown.
///
/// Poses i and j in the plane (x forward, heading to the left), rate error `b` \[rad/s\]: what the gyro shows beyond the
/// truth. With the turn `Δ = ψⱼ - ψᵢ`, the middle heading `ψᵢ + Δ/2` and `d = R(ψᵢ + Δ/2)ᵀ (pⱼ - pᵢ)`, the chord,
///
/// ```text
/// e = [ d_x - s sin(Δ/2) / (Δ/2),   d_y,   Δ + b T - u ]      s way, u turn by the gyro, T duration
/// ```
///
/// The chord is laid by the turn of the poses, not by the measured one: so the error of the gyro stands in the
/// third row alone and the rows are uncorrelated.
#[derive(Debug, Clone)]
pub struct ArcMotion {
    ids: [VariableId; 3],
    reading: ArcReading,
    weights: [f64; 3],
}

impl ArcMotion {
    /// `ids`: first pose, rate error ([`crate::Kind::Scalar`]) over the interval, second pose.
    #[must_use]
    pub fn new(ids: [VariableId; 3], reading: ArcReading, sigmas: ArcSigmas) -> Self {
        Self { ids, reading, weights: [sigmas.along_m, sigmas.across_m, sigmas.turn_rad].map(|s| 1.0 / s) }
    }
    /// What was measured.
    #[must_use]
    pub fn reading(&self) -> ArcReading {
        self.reading
    }
}

/// Pose that an arc leads to: dead reckoning.
#[must_use]
pub fn along_arc(from: [f64; 3], way_m: f64, turn_rad: f64) -> [f64; 3] {
    let chord = way_m * sine_ratio(0.5 * turn_rad).0;
    let (sin, cos) = (from[2] + 0.5 * turn_rad).sin_cos();
    [from[0] + chord * cos, from[1] + chord * sin, wrap(from[2] + turn_rad)]
}

/// `sin h / h` and its derivative.
fn sine_ratio(h: f64) -> (f64, f64) {
    if h.abs() < 1e-3 {
        (1.0 - h * h / 6.0, -h / 3.0 + h.powi(3) / 30.0)
    } else {
        (h.sin() / h, (h * h.cos() - h.sin()) / (h * h))
    }
}

impl Factor for ArcMotion {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        3
    }
    fn label(&self) -> &'static str {
        "motion along an arc"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let (a, b) = (values.get(self.ids[0]), values.get(self.ids[2]));
        let ArcReading { way_m, turn_rad, duration_s } = self.reading;
        let drift = duration_s * values.scalar(self.ids[1]);
        let left = wrap(b[2] - a[2] + drift - turn_rad);
        // the turn of the poses, on the branch of the measured one
        let half = 0.5 * (left + turn_rad - drift);
        let d = turn(-a[2] - half) * Vector2::new(b[0] - a[0], b[1] - a[1]);
        let (ratio, by_half) = sine_ratio(half);
        let [along, across, turned] = self.weights;
        residual.copy_from_slice(&[along * (d.x - way_m * ratio), across * d.y, turned * left]);
        if let Some(jacobian) = jacobian {
            let to_a = turn(-half);
            let to_b = turn(half);
            let by_heading = -0.5 * perpendicular(&d);
            let chord = 0.5 * way_m * by_half;
            let rows = [
                [-to_a[(0, 0)], -to_a[(0, 1)], by_heading.x + chord, 0.0],
                [-to_a[(1, 0)], -to_a[(1, 1)], by_heading.y, 0.0],
                [0.0, 0.0, -1.0, duration_s],
            ];
            let second = [
                [to_b[(0, 0)], to_b[(0, 1)], by_heading.x - chord],
                [to_b[(1, 0)], to_b[(1, 1)], by_heading.y],
                [0.0, 0.0, 1.0],
            ];
            for (r, out) in jacobian.chunks_exact_mut(7).enumerate() {
                out[..4].iter_mut().zip(rows[r]).for_each(|(o, v)| *o = self.weights[r] * v);
                out[4..].iter_mut().zip(second[r]).for_each(|(o, v)| *o = self.weights[r] * v);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;

    #[test]
    fn a_quarter_of_a_circle_leads_round_the_corner() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let end = along_arc([1.0, 2.0, quarter], 10.0 * quarter, quarter);
        assert!((end[0] + 9.0).abs() < 1e-12 && (end[1] - 12.0).abs() < 1e-12, "{end:?}");
    }

    #[test]
    fn a_motion_without_errors_leaves_no_residual_whatever_the_gyro_adds() {
        let mut values = Values::default();
        let from = [3.0, -1.0, 3.0];
        let a = values.push(Kind::Pose2, &from);
        let rate = values.push(Kind::Scalar, &[0.01]);
        let b = values.push(Kind::Pose2, &along_arc(from, 4.0, 0.4));
        let reading = ArcReading { way_m: 4.0, turn_rad: 0.4 + 0.5 * 0.01, duration_s: 0.5 };
        let sigmas = ArcSigmas { along_m: 0.01, across_m: 0.01, turn_rad: 0.001 };
        let mut residual = [0.0; 3];
        ArcMotion::new([a, rate, b], reading, sigmas).evaluate(&values, &mut residual, None);
        assert!(residual.iter().all(|r| r.abs() < 1e-10), "{residual:?}");
    }
}
