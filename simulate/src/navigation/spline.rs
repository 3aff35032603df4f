//! Uniform quintic B-splines: four times continuously differentiable, at rest where their control points are.

use nalgebra::Vector3;

/// Polynomials of the six basis functions that live on a knot interval, ascending powers, times 120.
const BASIS: [[f64; 6]; 6] = [
    [1.0, -5.0, 10.0, -10.0, 5.0, -1.0],
    [26.0, -50.0, 20.0, 20.0, -20.0, 5.0],
    [66.0, 0.0, -60.0, 0.0, 30.0, -10.0],
    [26.0, 50.0, 20.0, -20.0, -20.0, 10.0],
    [1.0, 5.0, 10.0, 10.0, 5.0, -5.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
];

/// A function of time with three components.
#[derive(Debug, Clone, PartialEq)]
pub struct Spline {
    start_s: f64,
    knot_s: f64,
    control: Vec<Vector3<f64>>,
}

/// Value, first and second derivative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jet {
    /// Value.
    pub value: Vector3<f64>,
    /// First derivative by time.
    pub first: Vector3<f64>,
    /// Second derivative by time.
    pub second: Vector3<f64>,
}

impl Spline {
    /// A spline of control points a knot interval apart, the first at `start_s`. It follows them smoothly and does not
    /// pass through them.
    #[must_use]
    pub fn new(start_s: f64, knot_s: f64, control: Vec<Vector3<f64>>) -> Self {
        Self { start_s, knot_s, control }
    }

    /// Value and derivatives at a time; beyond the ends the outermost control points go on.
    #[must_use]
    #[allow(clippy::cast_possible_truncation)]
    pub fn at(&self, time_s: f64) -> Jet {
        let x = (time_s - self.start_s) / self.knot_s;
        let (cell, u) = (x.floor(), x - x.floor());
        let last = self.control.len() as i64 - 1;
        let mut jet = Jet { value: Vector3::zeros(), first: Vector3::zeros(), second: Vector3::zeros() };
        for (k, p) in (-2_i64..).zip(&BASIS) {
            let index = usize::try_from((cell as i64 + k).clamp(0, last)).unwrap_or(0);
            let c = &self.control[index];
            let value = p[0] + u * (p[1] + u * (p[2] + u * (p[3] + u * (p[4] + u * p[5]))));
            let first = p[1] + u * (2.0 * p[2] + u * (3.0 * p[3] + u * (4.0 * p[4] + u * 5.0 * p[5])));
            let second = 2.0 * p[2] + u * (6.0 * p[3] + u * (12.0 * p[4] + u * 20.0 * p[5]));
            jet.value += c * (value / 120.0);
            jet.first += c * (first / (120.0 * self.knot_s));
            jet.second += c * (second / (120.0 * self.knot_s * self.knot_s));
        }
        jet
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_the_value_also_across_knots() {
        let control = (0..20).map(|k| Vector3::new(f64::from(k * k % 7), f64::from(k % 5), f64::from(k * k))).collect();
        let spline = Spline::new(10.0, 0.25, control);
        for time_s in [11.03, 11.25, 12.0, 12.4] {
            let h = 1e-5;
            let (a, b, c) = (spline.at(time_s - h), spline.at(time_s), spline.at(time_s + h));
            assert!(((c.value - a.value) / (2.0 * h) - b.first).norm() < 1e-6, "{time_s}");
            assert!(((c.first - a.first) / (2.0 * h) - b.second).norm() < 1e-4, "{time_s}");
        }
    }

    #[test]
    fn equal_control_points_are_rest() {
        let jet = Spline::new(0.0, 0.25, vec![Vector3::new(1.0, 2.0, 3.0); 12]).at(1.6);
        assert!((jet.value - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-14);
        assert!(jet.first.norm() < 1e-12 && jet.second.norm() < 1e-11);
    }
}
