//! Range corrections of single points, along their rays.

use nalgebra::Vector3;

use crate::stage::drive::correction::ScannerCorrection;
use crate::stage::drive::curve::{RangeSpline, Spline};
use crate::stage::drive::over::Over;
use crate::stage::drive::surfaces::{Piece, Surfaces};

/// Range corrections of all scanners, to be added.
#[derive(Debug, Default)]
pub(super) struct Rays {
    scanners: Vec<OfScanner>,
    surfaces: Surfaces,
    /// Of the local frame that surfaces are in, map \[m\].
    origin_m: Vector3<f64>,
}

/// Curves and coefficients \[m\] of one scanner.
#[derive(Debug, Clone, Default)]
struct OfScanner {
    range: Vec<(RangeSpline, Vec<f64>)>,
    intensity: Vec<(Spline, Vec<f64>)>,
    incidence: Vec<(Spline, Vec<f64>)>,
}

impl Rays {
    /// No corrections of so many scanners.
    pub(super) fn none(scanners: usize) -> Self {
        Self { scanners: vec![OfScanner::default(); scanners], ..Self::default() }
    }

    /// Those of a drive, whose local frame has this origin \[m\]; what is over the incidence acts once surfaces are known.
    pub(super) fn new(scanners: &[ScannerCorrection], origin_m: Vector3<f64>) -> Self {
        let of_scanner = |s: &ScannerCorrection| {
            let over = |over: Over| {
                s.over.iter().filter(|c| c.over == over).map(|c| (c.spline, c.coefficients_m.clone())).collect()
            };
            OfScanner { range: s.ranges.clone(), intensity: over(Over::Intensity), incidence: over(Over::Incidence) }
        };
        Self { scanners: scanners.iter().map(of_scanner).collect(), surfaces: Surfaces::default(), origin_m }
    }

    /// Whether a correction is over the incidence, which takes surfaces.
    pub(super) fn is_over_incidence(&self) -> bool {
        self.scanners.iter().any(|s| !s.incidence.is_empty())
    }

    /// Takes surfaces as the correction moves them, their ranges but for the incidence included.
    pub(super) fn learn(&mut self, pieces: impl Iterator<Item = Piece>) {
        self.surfaces = Surfaces::new(pieces);
    }

    /// A point that was moved with the beam from its scanner \[m\], with its range corrected for range and intensity.
    #[inline]
    pub(super) fn lengthened(
        &self,
        scanner: usize,
        scanner_m: &Vector3<f64>,
        intensity: f64,
        moved_m: &Vector3<f64>,
    ) -> Vector3<f64> {
        let own = &self.scanners[scanner];
        if own.is_none() {
            return *moved_m;
        }
        let ray = moved_m - scanner_m;
        let range_m = ray.norm().max(1e-3);
        moved_m + ray * ((own.at_range_m(range_m) + own.at_intensity_m(intensity)) / range_m)
    }

    /// The same, then corrected for the incidence; and whether the surface is known for it, where it has to be.
    #[inline]
    pub(super) fn corrected(
        &self,
        scanner: usize,
        scanner_m: &Vector3<f64>,
        intensity: f64,
        moved_m: &Vector3<f64>,
    ) -> (Vector3<f64>, bool) {
        let there_m = self.lengthened(scanner, scanner_m, intensity, moved_m);
        let curves = &self.scanners[scanner].incidence;
        if curves.is_empty() {
            return (there_m, true);
        }
        let ray = there_m - scanner_m;
        let direction = ray / ray.norm().max(1e-3);
        let (longer_m, is_known) = self.surfaces.longer_m(curves, &(there_m - self.origin_m), &direction);
        (there_m + direction * longer_m, is_known)
    }

    /// The point that [`Self::corrected`] makes this one of.
    #[inline]
    pub(super) fn measured(
        &self,
        scanner: usize,
        scanner_m: &Vector3<f64>,
        intensity: f64,
        corrected_m: &Vector3<f64>,
    ) -> Vector3<f64> {
        let own = &self.scanners[scanner];
        let mut point_m = *corrected_m;
        if !own.incidence.is_empty() {
            let ray = point_m - scanner_m;
            let range_m = ray.norm().max(1e-3);
            let direction = ray / range_m;
            let from_m = scanner_m - self.origin_m;
            let longer_m = |r_m: f64| self.surfaces.longer_m(&own.incidence, &(from_m + direction * r_m), &direction).0;
            point_m = scanner_m + direction * solved_m(range_m, longer_m);
        }
        if own.is_none() {
            return point_m;
        }
        let ray = point_m - scanner_m;
        let range_m = ray.norm().max(1e-3);
        // of a point as measured and as corrected the intensity is the same
        let of_intensity_m = own.at_intensity_m(intensity);
        scanner_m + ray * (solved_m(range_m, |range_m| own.at_range_m(range_m) + of_intensity_m) / range_m)
    }
}

impl OfScanner {
    /// Whether there is no correction but over the incidence.
    fn is_none(&self) -> bool {
        self.range.is_empty() && self.intensity.is_empty()
    }

    #[inline]
    fn at_range_m(&self, range_m: f64) -> f64 {
        self.range.iter().map(|(spline, coefficients)| spline.at(coefficients, range_m)).sum()
    }

    #[inline]
    fn at_intensity_m(&self, intensity: f64) -> f64 {
        if self.intensity.is_empty() {
            return 0.0;
        }
        let place = Over::Intensity.on_scale(intensity);
        self.intensity.iter().map(|(spline, coefficients)| spline.at(coefficients, place)).sum()
    }
}

/// The range \[m\] that a correction `longer_m` makes a corrected one of: `ρ + f(ρ)` solved for ρ. Corrections change by a few
/// millimetres a metre, by some hundred where a surface ends: each step leaves that share of the error.
fn solved_m(corrected_m: f64, longer_m: impl Fn(f64) -> f64) -> f64 {
    let mut range_m = corrected_m;
    for _ in 0..40 {
        let next_m = corrected_m - longer_m(range_m);
        let step_m = (next_m - range_m).abs();
        range_m = next_m;
        if step_m < 1e-9 {
            break;
        }
    }
    range_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::drive::over::OverCurve;

    /// A scanner with curves over range, incidence and intensity, on ground with a wall.
    fn rays(origin_m: Vector3<f64>) -> Rays {
        let over = |over: Over, first: f64, last: f64| OverCurve {
            over,
            spline: over.spline_of(first, last, 9).expect("a span"),
            coefficients_m: (0..9).map(|k| 0.003 * (1.3 * f64::from(k)).cos()).collect(),
        };
        let ranges = vec![(RangeSpline::new(2.0, 40.0, 0.2), (0..20).map(|k| 0.004 * f64::from(k).sin()).collect())];
        let over = vec![over(Over::Incidence, 0.0, 90.0), over(Over::Intensity, 10.0, 9000.0)];
        let scanner = ScannerCorrection {
            lever_arm_m: Vector3::zeros(),
            calibration: tieline_graph::Calibration::default(),
            latency_s: 0.0,
            ranges,
            over,
        };
        let mut rays = Rays::new(&[scanner], origin_m);
        assert!(rays.is_over_incidence());
        let ground = (0..20).map(|k| (Vector3::new(0.5 * f64::from(k) + 0.25, 0.0, 0.0), Vector3::z()));
        let wall = (0..8).map(|k| (Vector3::new(10.0, 0.0, 0.5 * f64::from(k) + 0.25), Vector3::x()));
        rays.learn(ground.chain(wall).map(|(middle_m, normal)| Piece { middle_m, normal, points: 20 }));
        rays
    }

    #[test]
    fn what_is_corrected_is_taken_back_to_what_was_measured() {
        let origin_m = Vector3::new(463_000.0, 5_340_000.0, 200.0);
        let rays = rays(origin_m);
        let scanner_m = origin_m + Vector3::new(0.0, 0.1, 2.2);
        let (mut known, mut unknown) = (0, 0);
        for k in 0..4000 {
            // a fan of beams over ground, corner and wall, their ends up to 0.4 m before or behind a surface
            let down = -0.6 + 0.9 * f64::from(k) / 4000.0;
            let direction = Vector3::new(1.0, 0.02, down).normalize();
            let to_ground_m = if down < -0.01 { -2.2 / direction.z } else { f64::INFINITY };
            let range_m = to_ground_m.min(10.0 / direction.x) + 0.4 * f64::from(k % 41 - 20) / 20.0;
            let measured_m = scanner_m + direction * range_m;
            let intensity = f64::from(20 + 13 * (k % 600));
            let (corrected_m, is_known) = rays.corrected(0, &scanner_m, intensity, &measured_m);
            known += i32::from(is_known);
            unknown += i32::from(!is_known);
            let back_m = rays.measured(0, &scanner_m, intensity, &corrected_m);
            assert!((back_m - measured_m).norm() < 1e-7, "{k}: {}", (back_m - measured_m).norm());
        }
        assert!(known > 500 && unknown > 500, "{known} {unknown}");
    }

    #[test]
    fn each_curve_adds_what_it_says() {
        let rays = rays(Vector3::zeros());
        let scanner_m = Vector3::new(0.0, 0.0, 2.0);
        // 60° from the vertical
        let measured_m = Vector3::new(2.0 * 3.0_f64.sqrt(), 0.0, 0.0);
        let (corrected_m, is_known) = rays.corrected(0, &scanner_m, 300.0, &measured_m);
        let own = &rays.scanners[0];
        let at = |curves: &[(Spline, Vec<f64>)], place: f64| curves[0].0.at(&curves[0].1, place);
        let expected_m =
            own.range[0].0.at(&own.range[0].1, 4.0) + at(&own.intensity, 300_f64.ln()) + at(&own.incidence, 60.0);
        let longer_m = (corrected_m - scanner_m).norm() - 4.0;
        assert!(is_known && (longer_m - expected_m).abs() < 1e-9, "{longer_m} {expected_m}");
        let none = Rays::none(1);
        assert!(none.corrected(0, &scanner_m, 300.0, &measured_m) == (measured_m, true) && !none.is_over_incidence());
        assert_eq!(none.measured(0, &scanner_m, 300.0, &measured_m), measured_m);
    }
}
