//! Poles matched between sightings.
//!
//! Both sightings see one radius. With places c₁, c₂ in plan, radii r₁, r₂ and their covariances C₁, C₂, that r₁ = r₂ (but for what a trunk is out of round) moves the difference by
//! `g (r₁ - r₂)/s²` and takes `g gᵀ/s²` off its covariance, g being the sum of both covariances of place and radius, s² the sum of the variances of the radii. Seen from one side g is large, from opposite sides nothing.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::feature::FeatureTie;
use super::pairs::{Item, pairs};
use super::point::{XyzEnd, XyzKind};
use super::pole::Pole;
use crate::block::SourceKey;

/// What the radius of one pole differs by between heights and sides \[m\].
const OUT_OF_ROUND_M: f64 = 0.0005;
/// Radii differ by so many standard deviations at most.
const SIGMAS: f64 = 4.0;
/// Sightings of one source further apart than this are of several visits \[s\].
const VISIT_S: f64 = 8.0;
/// Largest difference of the heights at which a pole was seen \[m\].
const MOST_UP_M: f64 = 2.0;

/// Strip, scanner and eighths of a minute: sightings that are not matched with each other.
type Whose = (u32, u16, i64);

/// Matches poles between all sightings; `whose` gives strip and scanner of a source at a time, `search_m` how far sightings of two times may lie apart \[m\], `most_search_m` its bound; worse known ties than
/// `most_sigma_m` are left out. Ties of one pole share its first sighting. Neighbours have not judged them yet.
#[must_use]
#[allow(clippy::cast_possible_truncation)] // numbers of poles, seconds
pub fn match_poles(
    poles: &[Pole],
    whose: &dyn Fn(SourceKey, f64) -> Option<(u32, u16)>,
    search_m: &dyn Fn(f64, f64) -> f64,
    most_search_m: f64,
    most_sigma_m: f64,
) -> Vec<FeatureTie> {
    let seen = |p: &'_ Pole| -> Option<Whose> {
        let (strip, scanner) = whose(p.source, p.time_s)?;
        Some((strip, scanner, (p.time_s / VISIT_S).floor() as i64))
    };
    let mut order: Vec<(Whose, &Pole)> = poles.iter().filter_map(|p| Some((seen(p)?, p))).collect();
    order.sort_by(|(a, p), (b, q)| {
        let plan = |k: usize| p.point_m[k].total_cmp(&q.point_m[k]);
        a.cmp(b).then(plan(0)).then(plan(1))
    });
    let item = |(sighting, p): &(Whose, &Pole)| Item { sighting: *sighting, place_m: p.point_m.xy(), time_s: p.time_s };
    let items: Vec<Item<Whose>> = order.iter().map(item).collect();
    let fits = |a: usize, b: usize| {
        let ((s, p), (t, q)) = (order[a], order[b]);
        let differ_m = (p.radius_m - q.radius_m).abs();
        let sigma_m = (p.covariance[(4, 4)] + q.covariance[(4, 4)] + OUT_OF_ROUND_M * OUT_OF_ROUND_M).sqrt();
        // one source in one visit, though it may fall into two parts of it
        let is_one = (s.0, s.1) == (t.0, t.1) && (p.time_s - q.time_s).abs() < VISIT_S;
        !is_one && differ_m <= SIGMAS * sigma_m && (p.point_m.z - q.point_m.z).abs() <= MOST_UP_M
    };
    let mut ties = Vec::new();
    for ([first, second], rejection) in pairs(&items, search_m, most_search_m, &fits) {
        let (ends, free, worst_m) = ends([order[first], order[second]]);
        if worst_m <= most_sigma_m {
            ties.push(FeatureTie { kind: XyzKind::Pole, feature: first as u32, ends, free: Some(free), rejection });
        }
    }
    ties
}

/// Both ends at the height between them, with half the covariance of their difference each; the axis; the largest sigma of the difference \[m\].
fn ends(of: [(Whose, &Pole); 2]) -> ([XyzEnd; 2], Vector3<f64>, f64) {
    let poles = of.map(|(_, p)| p);
    let height_m = 0.5 * (poles[0].point_m.z + poles[1].point_m.z);
    let at = poles.map(|p| p.at(height_m));
    let joint = joint(&at, poles[0].radius_m - poles[1].radius_m);
    let lean = (poles[0].lean + poles[1].lean) * 0.5;
    let end = |k: usize| {
        let (place, pole) = (joint.places_m[k], poles[k]);
        let mut covariance_m2 = Matrix3::zeros();
        covariance_m2.fixed_view_mut::<2, 2>(0, 0).copy_from(&(joint.covariance_m2 * 0.5));
        XyzEnd {
            strip: of[k].0.0,
            scanner: of[k].0.1,
            time_s: pole.time_s,
            place_m: Vector3::new(place.x, place.y, height_m),
            covariance_m2,
            normal: Vector3::new(-pole.away.x, -pole.away.y, 0.0),
            points: pole.points,
            intensity: pole.intensity,
        }
    };
    let worst_m = joint.covariance_m2.symmetric_eigenvalues().max().max(0.0).sqrt();
    ([end(0), end(1)], Vector3::new(lean.x, lean.y, 1.0).normalize(), worst_m)
}

/// Two places with one radius.
struct Joint {
    places_m: [Vector2<f64>; 2],
    /// Of the second less the first.
    covariance_m2: Matrix2<f64>,
}

/// Places as they are when both radii, which differ by first less second \[m\], are one.
fn joint(at: &[(Vector2<f64>, Matrix3<f64>); 2], differ_m: f64) -> Joint {
    let with_radius = at.each_ref().map(|(_, c)| Vector2::new(c[(0, 2)], c[(1, 2)]));
    let of_place = at.each_ref().map(|(_, c)| c.fixed_view::<2, 2>(0, 0).into_owned());
    let variance_m2 = at[0].1[(2, 2)] + at[1].1[(2, 2)] + OUT_OF_ROUND_M * OUT_OF_ROUND_M;
    let gain = with_radius[0] + with_radius[1];
    Joint {
        places_m: [
            at[0].0 - with_radius[0] * (differ_m / variance_m2),
            at[1].0 + with_radius[1] * (differ_m / variance_m2),
        ],
        covariance_m2: of_place[0] + of_place[1] - gain * gain.transpose() / variance_m2,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_radius_helps_where_both_see_one_side() {
        // the axis lies behind the arc by the radius: both errors are one
        let of = |side: f64| Matrix3::new(25e-6, 0.0, side * 20e-6, 0.0, 1e-6, 0.0, side * 20e-6, 0.0, 20e-6);
        let place = Vector2::new(3.0, 4.0);
        let same = joint(&[(place, of(1.0)), (place, of(1.0))], 0.004);
        let apart = joint(&[(place, of(1.0)), (place, of(-1.0))], 0.004);
        assert!(same.covariance_m2[(0, 0)] < 20e-6 && (apart.covariance_m2[(0, 0)] - 50e-6).abs() < 1e-12);
        // the first radius was too large and its axis too far behind, and the other way round
        assert!(same.places_m[0].x < 3.0 && same.places_m[1].x > 3.0);
        assert!((apart.places_m[1] - apart.places_m[0]).norm() < 1e-12);
    }
}
