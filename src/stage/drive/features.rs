//! Corners as points for the smoother: all sightings of one are one tie.

use std::collections::BTreeMap;

use tieline_matching::xyz::{FeatureTie, XyzEnd, XyzKind, XyzPoint};

use super::decided::Decisions;
use super::points::PointTie;

/// The accepted features as points, variances times the factor of their kind. Ties of one feature share the first sighting: those that hold as many directions are one point, and of both ranks that
/// with more sightings stays, of as many that with all directions, for its sightings are the others' as well.
#[must_use]
pub fn points_of(features: &[FeatureTie], factor_of: &dyn Fn(XyzKind) -> f64) -> Vec<XyzPoint> {
    let mut by_feature: BTreeMap<(XyzKind, u32), [Vec<&FeatureTie>; 2]> = BTreeMap::new();
    for tie in features.iter().filter(|t| t.rejection.is_none()) {
        by_feature.entry((tie.kind, tie.feature)).or_default()[usize::from(tie.free.is_some())].push(tie);
    }
    let point = |((kind, _), [whole, free]): ((XyzKind, u32), [Vec<&FeatureTie>; 2])| {
        let of = if free.len() > whole.len() { free } else { whole };
        let first = of.first()?;
        let scaled = |end: &XyzEnd| XyzEnd { covariance_m2: end.covariance_m2 * factor_of(kind), ..end.clone() };
        let ends = std::iter::once(&first.ends[0]).chain(of.iter().map(|t| &t.ends[1])).map(scaled).collect();
        Some(XyzPoint { kind, name: None, free: first.free, ends, known: None })
    };
    by_feature.into_iter().filter_map(point).collect()
}

/// What there is to say of a kind of features, all and those for the smoother.
#[must_use]
pub fn note(
    (all, taken): (&[PointTie], &[PointTie]),
    kind: XyzKind,
    name: &str,
    decisions: &Decisions,
) -> Option<String> {
    let count = |of: &[PointTie]| of.iter().filter(|t| t.found == kind).count();
    (count(taken) > 0).then(|| {
        format!(
            "{} of {} {name} went to the smoother, {} of them without one direction; their sigmas, as they turned out over as measured: {:.2}",
            count(taken),
            count(all),
            taken.iter().filter(|t| t.found == kind && t.rank() == 2).count(),
            decisions.factor_of(kind).sqrt()
        )
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;

    #[test]
    fn sightings_of_a_corner_make_one_point() {
        let tie = |feature, strip, free: Option<Vector3<f64>>| {
            let end = |strip| XyzEnd {
                strip,
                scanner: 0,
                time_s: 10.0 * f64::from(strip),
                place_m: Vector3::zeros(),
                covariance_m2: Matrix3::identity(),
                normal: Vector3::x(),
                points: 1,
                intensity: 0.0,
            };
            FeatureTie { kind: XyzKind::Corner, feature, ends: [end(0), end(strip)], free, rejection: None }
        };
        let upright = Some(Vector3::z());
        let ties = [
            tie(0, 1, None),
            tie(0, 2, upright),
            tie(0, 3, None),
            tie(1, 1, None),
            tie(1, 2, upright),
            tie(2, 1, upright),
        ];
        let points = points_of(&ties, &|_| 2.0);
        let found: Vec<_> =
            points.iter().map(|p| (p.ends.iter().map(|e| e.strip).collect::<Vec<_>>(), p.held().len())).collect();
        assert_eq!(found, [(vec![0, 1, 3], 3), (vec![0, 1], 3), (vec![0, 1], 2)]);
        assert!((points[0].ends[0].covariance_m2[(0, 0)] - 2.0).abs() < 1e-12);
    }
}
