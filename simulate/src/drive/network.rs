//! Streets as a surface: how far a point is from the curb, and how high the ground is.

use std::f64::consts::TAU;

use nalgebra::Vector2;

use super::axis::Axis;
use super::scenario::{DriveScenario, Sides, Street};
use super::scene_options::SceneOptions;
use crate::random::Random;

/// Half width of road over which it slopes to the gutter \[m\]; beyond, it is level across.
const CROWN_M: f64 = 4.5;
/// Slope of the pavement towards the curb.
const PAVEMENT_SLOPE: f64 = 0.02;
/// Waves of the hills.
const WAVES: usize = 4;

/// A street with its axis.
#[derive(Debug, Clone)]
pub(super) struct Way {
    pub(super) axis: Axis,
    pub(super) half_width_m: f64,
    pub(super) pavement_m: f64,
    pub(super) facades: Sides,
    pub(super) walled: bool,
}

/// A wave of the hills: direction and wave number \[1/m\], phase, amplitude \[m\].
#[derive(Debug, Clone, Copy)]
struct Wave {
    number: Vector2<f64>,
    phase: f64,
    amplitude_m: f64,
}

/// All streets.
#[derive(Debug, Clone)]
pub(super) struct Network {
    pub(super) ways: Vec<Way>,
    waves: [Wave; WAVES],
    options: SceneOptions,
}

/// Where a point lies across the streets.
#[derive(Debug, Clone, Copy)]
pub(super) struct Across {
    /// Distance from the curb \[m\], negative on the road.
    pub(super) from_curb_m: f64,
    /// Width of the pavement there \[m\].
    pub(super) pavement_m: f64,
}

/// Two roads as one, with rounded corners: signed distances to their curbs, radius of the corners.
fn joined(a: f64, b: f64, radius_m: f64) -> f64 {
    let (u, v) = ((radius_m - a).max(0.0), (radius_m - b).max(0.0));
    radius_m.max(a.min(b)) - u.hypot(v)
}

impl Network {
    /// The streets of a scenario that was checked.
    pub(super) fn new(scenario: &DriveScenario) -> Self {
        let options = scenario.scene.clone();
        let way = |street: &Street| Way {
            axis: Axis::new(&scenario.points(&street.nodes), scenario.drive.turn_radius_m),
            half_width_m: street.half_width_m,
            pavement_m: street.pavement_m,
            facades: street.facades,
            walled: street.walled,
        };
        let mut random = Random::new(scenario.scene_seed, &[60]);
        let mut share = 0.0;
        let waves = std::array::from_fn(|k| {
            #[allow(clippy::cast_precision_loss)]
            let length_m = options.hill_length_m * (1.0 + 0.6 * k as f64);
            let (sin, cos) = random.between(0.0, TAU).sin_cos();
            share += 1.0;
            Wave {
                number: Vector2::new(cos, sin) * (TAU / length_m),
                phase: random.between(0.0, TAU),
                amplitude_m: options.hill_m * 0.3 * (0.6 + 0.2 * share),
            }
        });
        Self { ways: scenario.streets.iter().map(way).collect(), waves, options }
    }

    /// Height of the hills \[m\].
    fn hills_m(&self, point: &Vector2<f64>) -> f64 {
        self.waves.iter().map(|w| w.amplitude_m * (w.number.dot(point) + w.phase).sin()).sum()
    }

    /// Where a point lies across the streets.
    pub(super) fn across(&self, point: &Vector2<f64>) -> Across {
        self.across_but(point, usize::MAX)
    }

    /// The same without one of the streets.
    pub(super) fn across_but(&self, point: &Vector2<f64>, left_out: usize) -> Across {
        let mut across = Across { from_curb_m: f64::INFINITY, pavement_m: 0.0 };
        let mut nearest_m = f64::INFINITY;
        for (number, way) in self.ways.iter().enumerate() {
            if number == left_out {
                continue;
            }
            let from_curb_m = way.axis.distance_m(point) - way.half_width_m;
            if from_curb_m < nearest_m {
                nearest_m = from_curb_m;
                across.pavement_m = way.pavement_m;
            }
            across.from_curb_m = match across.from_curb_m.is_finite() {
                true => joined(across.from_curb_m, from_curb_m, self.options.corner_radius_m),
                false => from_curb_m,
            };
        }
        across
    }

    /// Height of road, or of the road's surface gone on beyond the curb \[m\].
    pub(super) fn road_height_m(&self, point: &Vector2<f64>) -> f64 {
        self.road_at_m(point, self.across(point).from_curb_m)
    }

    /// The same where the distance from the curb is known.
    pub(super) fn road_at_m(&self, point: &Vector2<f64>, from_curb_m: f64) -> f64 {
        let s = (-from_curb_m / CROWN_M).clamp(0.0, 1.0);
        self.hills_m(point) + self.options.cross_slope * CROWN_M * s * (1.0 - 0.5 * s)
    }

    /// Height of pavement and verge \[m\].
    pub(super) fn pavement_at_m(&self, point: &Vector2<f64>, from_curb_m: f64) -> f64 {
        self.hills_m(point) + self.options.curb_m + PAVEMENT_SLOPE * from_curb_m.clamp(0.0, 4.0)
    }

    /// Height of the ground, whatever it is \[m\].
    pub(super) fn ground_m(&self, point: &Vector2<f64>) -> f64 {
        let from_curb_m = self.across(point).from_curb_m;
        match from_curb_m < 0.0 {
            true => self.road_at_m(point, from_curb_m),
            false => self.pavement_at_m(point, from_curb_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::joined;

    #[test]
    fn where_two_roads_meet_the_corner_is_an_arc() {
        // two roads along the axes, curbs at 5 m: the corner's circle has its centre at 13 m, 13 m
        for angle in [0.1_f64, 0.5, 0.8, 1.2] {
            let (x, y) = (13.0 - 8.0 * angle.cos(), 13.0 - 8.0 * angle.sin());
            assert!(joined(x - 5.0, y - 5.0, 8.0).abs() < 1e-12);
        }
        assert!((joined(-3.0, 60.0, 8.0) + 3.0).abs() < 1e-12, "away from the other, a road is itself");
    }
}
