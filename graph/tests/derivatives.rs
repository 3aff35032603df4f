//! Derivatives of every factor against central differences, at random poses and near no turn and half a turn.

#![allow(clippy::unwrap_used)] // a test may

use nalgebra::{DMatrix, Matrix2, Matrix3, Matrix6, Rotation3, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;
use tieline_graph::factor::baseline::{Baseline, Cluster};
use tieline_graph::factor::check::derivative_error;
use tieline_graph::factor::motion::{ArcMotion, ArcReading, ArcSigmas};
use tieline_graph::factor::mounted::{MountedBetween2, MountedSighting2};
use tieline_graph::factor::pose2::{Between2, Prior2, RangeBearing, Sighting2};
use tieline_graph::factor::pose3::{Between3, Motion, PointTie, Prior3, Sighting3, SurfaceLine};
use tieline_graph::factor::strip_tie::{StripEnd, StripTie};
use tieline_graph::factor::terrestrial::{Angle, Azimuth, Direction, Distance, HeightDifference, Known};
use tieline_graph::factor::vector::{Linear, RandomWalk, ScalarPrior, VectorPrior};
use tieline_graph::factor::{Convention, Factor};
use tieline_graph::{Kind, Values, VariableId};

const CONVENTIONS: [Convention; 3] = [Convention::Plain, Convention::Log, Convention::G2o];

fn positive<const N: usize>(seed: &[f64]) -> nalgebra::SMatrix<f64, N, N> {
    let a = nalgebra::SMatrix::<f64, N, N>::from_fn(|r, c| seed[(r * N + c) % seed.len()]);
    a * a.transpose() + nalgebra::SMatrix::<f64, N, N>::identity()
}

fn pose3(values: &mut Values, v: &[f64]) -> VariableId {
    let q = UnitQuaternion::from_scaled_axis(Vector3::new(v[3], v[4], v[5]));
    values.push(Kind::Pose3, &[v[0], v[1], v[2], q.i, q.j, q.k, q.w])
}

fn check(factor: &dyn Factor, values: &Values) {
    let error = derivative_error(factor, values);
    assert!(error < 1e-7, "{} {factor:?}: {error}", factor.label());
}

/// Turns of every size, the ends of the range among them.
fn turns() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), Just(1e-9), Just(1e-4), Just(9e-3), Just(0.06), Just(std::f64::consts::PI - 1e-3), -3.0..3.0]
}

proptest! {
    #[test]
    fn in_the_plane(v in prop::collection::vec(-3.0..3.0, 24), turn in turns()) {
        let mut values = Values::default();
        let a = values.push(Kind::Pose2, &v[0..3]);
        let measured = [v[3], v[4], v[5]];
        // the angle that is left is `turn`
        let b = values.push(Kind::Pose2, &[v[6], v[7], v[2] + v[5] + turn]);
        let p = values.push(Kind::Point2, &[v[0] + 4.0 + v[8], v[1] + v[9]]);
        for convention in CONVENTIONS {
            check(&Between2::new([a, b], measured, &positive::<3>(&v[10..19]), convention).unwrap(), &values);
        }
        let at = values.get(a).to_vec();
        check(&Prior2::new(a, [v[3], v[4], at[2] + turn.clamp(-3.0, 3.0)], &positive::<3>(&v[10..19])).unwrap(), &values);
        check(&Sighting2::new([a, p], Vector2::new(v[3], v[4]), &positive::<2>(&v[10..14])).unwrap(), &values);
        check(&Sighting2::from_range_bearing([a, p], 4.0, v[5], 0.3, 0.8).unwrap(), &values);
        let d = values.xy(p) - values.xy(a);
        check(&RangeBearing::new([a, p], 3.0, d.y.atan2(d.x) - at[2] + 0.3, 0.5, 0.7), &values);
        check(&Known::<2>::new(a, [v[3], v[4]], &Matrix2::identity()).unwrap(), &values);
    }

    #[test]
    fn of_a_vehicle(v in prop::collection::vec(-3.0..3.0, 28), turn in turns(), short in -1e-3..1e-3) {
        let mut values = Values::default();
        let a = values.push(Kind::Pose2, &v[0..3]);
        let rate = values.push(Kind::Scalar, &[v[3]]);
        let mount = values.push(Kind::Pose2, &v[4..7]);
        let p = values.push(Kind::Point2, &v[7..9]);
        let sigmas = ArcSigmas { along_m: 0.3, across_m: 0.4, turn_rad: 0.5 };
        // turns of the poses small and large, what is left of the turn near zero and near half a turn
        for turned in [v[9], short, 0.0] {
            let reading = ArcReading { way_m: v[10], turn_rad: turned + turn, duration_s: 0.7 };
            let heading = v[2] + turned - 0.7 * v[3];
            let b = values.push(Kind::Pose2, &[v[11], v[12], heading]);
            check(&ArcMotion::new([a, rate, b], reading, sigmas), &values);
        }
        let b = values.push(Kind::Pose2, &[v[11], v[12], v[2] + v[15] + turn]);
        for convention in CONVENTIONS {
            let measured = [v[13], v[14], v[15]];
            let link = MountedBetween2::new([a, b, mount], measured, &positive::<3>(&v[16..25]), convention).unwrap();
            check(&link, &values);
        }
        let information = positive::<2>(&v[20..24]);
        check(&MountedSighting2::new([a, mount, p], Vector2::new(v[25], v[26]), &information).unwrap(), &values);
    }

    #[test]
    fn in_space(v in prop::collection::vec(-2.0..2.0, 60), turn in turns()) {
        let mut values = Values::default();
        let a = pose3(&mut values, &v[0..6]);
        let measured = Motion {
            translation: Vector3::new(v[6], v[7], v[8]),
            rotation: UnitQuaternion::from_scaled_axis(Vector3::new(v[9], v[10], v[11])),
        };
        let axis = Vector3::new(v[12], v[13], v[14] + 2.5).normalize();
        let left = UnitQuaternion::from_scaled_axis(axis * turn);
        let rotation = (values.rotation(a) * measured.rotation * left).scaled_axis();
        let b = pose3(&mut values, &[v[15], v[16], v[17], rotation.x, rotation.y, rotation.z]);
        let p = values.push(Kind::Point3, &v[18..21]);
        let information: Matrix6<f64> = positive::<6>(&v[21..57]);
        for convention in CONVENTIONS {
            check(&Between3::new([a, b], measured, &information, convention).unwrap(), &values);
        }
        let known = Motion { translation: measured.translation, rotation: values.rotation(a) * left };
        check(&Prior3::new(a, known, &information).unwrap(), &values);
        let w: Matrix3<f64> = positive::<3>(&v[21..30]);
        let bodies = [Vector3::new(v[30], v[31], v[32]), Vector3::new(v[33], v[34], v[35])];
        check(&Sighting3::new([a, p], bodies[0], &w).unwrap(), &values);
        check(&PointTie::new([a, b], bodies, &w).unwrap(), &values);
        check(&SurfaceLine::new([a, b], bodies, axis, 0.3), &values);
        check(&Known::<3>::new(a, [v[3], v[4], v[5]], &Matrix3::identity()).unwrap(), &values);
        let _ = Rotation3::<f64>::identity();
    }

    #[test]
    fn of_strips(v in prop::collection::vec(-0.03..0.03, 64)) {
        let mut values = Values::default();
        for k in 0..8 {
            values.push(Kind::Vector(6), &v[6 * k..6 * k + 6]);
        }
        let calibration = values.push(Kind::Vector(6), &v[48..54]);
        let end = |knot: u32, heading_rad: f64, x: f64| StripEnd {
            first_knot: VariableId(knot),
            weights: [0.1, 0.5, 0.3, 0.1],
            heading_rad,
            body_m: Vector3::new(x, 3.0, -8.0),
        };
        let normal = Vector3::new(v[60], v[61], 1.0).normalize();
        check(&StripTie::new([end(0, 0.3, 1.0), end(4, 3.0, -2.0)], calibration, normal, 0.1, 0.5), &values);
    }

    #[test]
    fn of_nets(v in prop::collection::vec(-1.0..1.0, 20)) {
        let mut values = Values::default();
        let s = values.push(Kind::Point2, &[v[0], v[1]]);
        let t = values.push(Kind::Point2, &[5.0 + v[2], v[3]]);
        let u = values.push(Kind::Point2, &[v[4], 5.0 + v[5]]);
        let o = values.push(Kind::Scalar, &[v[6]]);
        check(&Distance::new([s, t], 4.0, 0.2), &values);
        check(&Direction::new([s, t, o], -v[6], 0.3), &values);
        check(&Azimuth::new([s, u], 1.4, 0.3), &values);
        check(&Angle::new([s, t, u], 1.5, 0.4), &values);
        let h = values.push(Kind::Height, &[v[7]]);
        let i = values.push(Kind::Height, &[v[8]]);
        check(&HeightDifference::new([h, i], 0.3, 0.1), &values);
        check(&ScalarPrior::new(t, 1, 0.3, 0.1), &values);
        let p = values.push(Kind::Point3, &v[9..12]);
        let q = values.push(Kind::Point3, &v[12..15]);
        check(&Baseline::new([p, q], Vector3::new(v[0], v[1], v[2]), &positive::<3>(&v[0..9])).unwrap(), &values);
        let seed = positive::<9>(&v);
        let covariance = DMatrix::from_fn(9, 9, |r, c| seed[(r, c)]);
        let r = values.push(Kind::Point3, &v[3..6]);
        let m = Vector3::new(v[6], v[7], v[8]);
        check(&Cluster::new(&[(Some(p), q, m), (None, r, m), (Some(r), p, m)], &covariance).unwrap(), &values);
        check(&RandomWalk::new([p, q], &[0.1, 0.2, 0.3]), &values);
        check(&VectorPrior::new(p, &v[0..3], &[0.1, 0.2, 0.3]), &values);
        check(&Linear::new(vec![p, o], v[0..8].to_vec(), v[8..10].to_vec()), &values);
    }
}
