//! The adjustment of strips against dense normal equations with every surface kept as an unknown.

use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};
use tieline_filter::Pose;
use tieline_graph::{
    AdjustOptions, CalibrationSigmas, CalibrationTerms, EndPart, Line, LineEnd, Model, PointMap, StripSpec, TimeModel,
    adjust,
};

const SIGMA_M: f64 = 0.02;

/// Numbers in [-1, 1) of a fixed sequence.
struct Sequence(u64);

impl Sequence {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        #[allow(clippy::cast_precision_loss)]
        let unit = (self.0 >> 11) as f64 / (1_u64 << 53) as f64;
        2.0 * unit - 1.0
    }
}

fn model() -> Model {
    let strip = |start_s: f64| StripSpec {
        start_s,
        end_s: start_s + 40.0,
        fixed: false,
        position_sigma_m: Vector3::new(0.1, 0.1, 0.15),
        rotation_sigma_rad: Vector3::repeat(3e-4),
    };
    let sigmas = CalibrationSigmas { boresight_rad: 1e-3, lever_arm_m: 0.05, range_offset_m: 0.02, range_scale: 1e-4 };
    let models = [Some(TimeModel::Constant), Some(TimeModel::Spline { knot_spacing_s: 10.0 }), Some(TimeModel::Linear)];
    let strips = [strip(0.0), strip(100.0), strip(200.0)];
    Model::new(&strips, &models, 2, CalibrationTerms { lever_arm: false, ..CalibrationTerms::default() }, &sigmas)
}

fn lines(count: usize) -> Vec<Line> {
    let mut random = Sequence(7);
    (0..count)
        .map(|i| {
            let normal = Vector3::new(0.4 * random.next(), 0.4 * random.next(), 1.0).normalize();
            let place = Vector3::new(300.0 * random.next(), 300.0 * random.next(), 800.0);
            let ends = (0..2 + i % 4)
                .map(|k| LineEnd {
                    strip: (k < 3).then_some((i + k) % 3), // a fourth end is control
                    calibration: (i + k) % 2,
                    time_s: 100.0 * ((i + k) % 3) as f64 + 20.0 + 19.0 * random.next(),
                    pose: Pose {
                        time_s: 0.0,
                        position: Vector3::new(
                            place.x + 200.0 * random.next(),
                            place.y + 200.0 * random.next(),
                            place.z + 800.0,
                        ),
                        ned_from_body: UnitQuaternion::from_euler_angles(
                            0.02 * random.next(),
                            0.0,
                            3.0 * random.next(),
                        ),
                        map_from_ned: Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0),
                    },
                    lever_arm_m: Vector3::new(0.1, -0.2, 0.3),
                    point_m: place,
                    offset_m: SIGMA_M * 1.7 * random.next(),
                    sigma_m: SIGMA_M,
                    parts: Vec::new(),
                })
                .collect();
            Line { normal, class: 0, held_out: i % 7 == 3, judges_only: false, tie: None, ends }
        })
        .collect()
}

/// One least-squares step, nothing robust.
const PLAIN: AdjustOptions = AdjustOptions {
    huber_k: 2.0,
    tukey_c: 5.0,
    outlier_k: 1e6,
    huber_iterations: 0,
    tukey_iterations: 0,
    variance_rounds: 1,
};

/// Normal equations with the surfaces as unknowns after those of the model.
fn dense(model: &Model, lines: &[Line]) -> (DMatrix<f64>, DVector<f64>) {
    let n = model.count();
    let size = n + lines.len();
    let mut normal = DMatrix::zeros(size, size);
    let mut right = DVector::zeros(size);
    for (i, p) in model.parameters().iter().enumerate() {
        normal[(i, i)] = p.prior_sigma.powi(-2);
    }
    for (i, line) in lines.iter().enumerate() {
        for end in &line.ends {
            let mut row = DVector::zeros(size);
            for (c, v) in model.row(end, &line.normal) {
                row[c] += v;
            }
            row[n + i] = -1.0;
            normal += &row * row.transpose() / end.sigma_m.powi(2);
            right -= row * end.offset_m / end.sigma_m.powi(2);
        }
    }
    (normal, right)
}

#[test]
fn one_step_is_that_of_the_dense_equations() {
    let lines = lines(120);
    let mut model = model();
    let (normal, right) = dense(&model, &lines.iter().filter(|l| !l.held_out).cloned().collect::<Vec<_>>());
    let inverse = normal.clone().cholesky().expect("regular").inverse();
    let expected = &inverse * right;
    let n = model.count();
    let found = adjust(&mut model, &lines, &[], &PLAIN).expect("solvable");
    let off = (0..n).map(|i| (model.state()[i] - expected[i]).abs() / inverse[(i, i)].sqrt()).fold(0.0, f64::max);
    assert!(off < 1e-9, "{off} sigmas");
    // common-mode errors weaken the covariance; without them it is the inverse
    if found.common_mode_factor <= 1.0 {
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let scale = (inverse[(i, i)] * inverse[(j, j)]).sqrt();
            assert!((found.covariance[(i, j)] - inverse[(i, j)]).abs() < 1e-9 * scale, "{i} {j}");
        }
    }
    let used: Vec<usize> = (0..lines.len()).filter(|i| !lines[*i].held_out).collect();
    let fresh = self::model();
    for (k, i) in used.iter().enumerate() {
        for (end, result) in lines[*i].ends.iter().zip(&found.ends[*i]) {
            let mut row = DVector::zeros(n + used.len());
            fresh.row(end, &lines[*i].normal).into_iter().for_each(|(c, v)| row[c] += v);
            row[n + k] = -1.0;
            let redundancy = 1.0 - (row.transpose() * &inverse * &row)[0] / end.sigma_m.powi(2);
            assert!((result.redundancy - redundancy.max(1e-3)).abs() < 1e-9, "{redundancy} {result:?}");
            let residual = end.offset_m + row.dot(&expected);
            assert!((result.residual_m - residual).abs() < 1e-10);
        }
    }
    // a held-out end: the variance of its deviation from its own mean exceeds that of noise alone
    let held = lines.iter().zip(&found.ends).filter(|(l, _)| l.held_out && l.ends.len() == 2);
    for (_, ends) in held {
        assert!(ends.iter().all(|e| e.redundancy > 0.5), "{ends:?}");
    }
}

#[test]
fn a_false_line_stays_out_whatever_the_number_of_rounds() {
    for variance_rounds in [2, 3, 4, 5] {
        let mut list = lines(150);
        let false_line = list.iter().position(|l| !l.held_out && l.ends.len() == 2).expect("a line of two ends");
        list[false_line].ends[0].offset_m = 3.0;
        let options = AdjustOptions { variance_rounds, ..AdjustOptions::default() };
        let found = adjust(&mut model(), &list, &[], &options).expect("solvable");
        assert!(found.ends[false_line].iter().all(|e| e.outlier), "{variance_rounds} rounds");
        let scale = found.class_scale[0] * found.sigma0;
        assert!(scale < 1.3, "{variance_rounds} rounds: the false line is in the variance: {scale}");
    }
}

/// An end whose offset is a sum over three places of its strip, seen one after the other.
fn end_of_parts(random: &mut Sequence) -> LineEnd {
    let parts: Vec<EndPart> = (0..3)
        .map(|k| {
            let place = Vector3::new(300.0 * random.next(), 300.0 * random.next(), 20.0 * random.next());
            let time_s = 112.0 + f64::from(k) * 3.0;
            EndPart {
                time_s,
                pose: Pose {
                    time_s,
                    position: place + Vector3::new(150.0 * random.next(), 150.0 * random.next(), 800.0),
                    ned_from_body: UnitQuaternion::from_euler_angles(0.05 * random.next(), 0.02, 3.0 * random.next()),
                    map_from_ned: Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0),
                },
                point_m: place,
                along: Vector3::new(random.next(), random.next(), random.next()),
            }
        })
        .collect();
    LineEnd {
        strip: Some(1),
        calibration: 1,
        time_s: 115.0,
        pose: parts[1].pose,
        lever_arm_m: Vector3::new(0.4, -0.2, 0.7),
        point_m: parts[1].point_m,
        offset_m: 0.0,
        sigma_m: SIGMA_M,
        parts,
    }
}

#[test]
fn the_row_of_an_end_of_several_places_is_that_of_central_differences() {
    let mut random = Sequence(11);
    let end = end_of_parts(&mut random);
    let mut model = model();
    let state = DVector::from_iterator(model.count(), model.parameters().iter().map(|p| 0.3 * p.prior_sigma));
    model.set_state(state.clone());
    let offset = |model: &Model| -> f64 {
        let of_part = |p: &EndPart| {
            let correction = model.pose_correction(1, p.time_s);
            let map = PointMap::new(&p.pose, &end.lever_arm_m, &correction, &model.calibration(1));
            p.along.dot(&map.delta_m(&p.point_m))
        };
        end.parts.iter().map(of_part).sum()
    };
    let row = model.row(&end, &Vector3::z());
    let columns: Vec<usize> = row.iter().map(|(c, _)| *c).collect();
    let mut distinct = columns.clone();
    distinct.dedup();
    assert_eq!(columns, distinct, "every unknown once");
    assert!(row.len() >= 24 + 5, "the knots that the three times touch, and the calibration: {}", row.len());
    for i in 0..model.count() {
        let step = 0.05 * model.parameters()[i].prior_sigma;
        let at = |sign: f64| {
            let mut moved = model.clone();
            let mut changed = state.clone();
            changed[i] += sign * step;
            moved.set_state(changed);
            offset(&moved)
        };
        let numeric = (at(1.0) - at(-1.0)) / (2.0 * step);
        let analytic = row.iter().find(|(c, _)| *c == i).map_or(0.0, |(_, v)| *v);
        // rotation vectors are added here and multiplied there: they differ by the size of the corrections
        let tolerance = 1e-3 * numeric.abs().max(analytic.abs()) + 1e-6;
        assert!((numeric - analytic).abs() < tolerance, "{}: {numeric} {analytic}", model.parameters()[i].name);
    }
}

#[test]
fn a_tie_of_several_directions_stays_or_goes_as_a_whole() {
    let mut list = lines(150);
    // lines of two ends next to each other become ties of two directions
    let pairs: Vec<usize> = (0..149).filter(|i| list[*i].ends.len() == 2 && !list[*i].held_out).take(10).collect();
    for (number, first) in pairs.iter().enumerate() {
        let mut other = list[*first].clone();
        other.normal = Vector3::new(0.8, 0.1, 0.6).normalize();
        other.ends.iter_mut().for_each(|e| e.offset_m = 0.0);
        list[*first].tie = Some(number);
        other.tie = Some(number);
        list.push(other);
    }
    list.sort_by_key(|l| l.tie);
    let first = list.iter().position(|l| l.tie == Some(3)).expect("a tie");
    list[first].ends[0].offset_m = 3.0;
    let found = adjust(&mut model(), &list, &[], &AdjustOptions::default()).expect("solvable");
    let out = |i: usize| found.ends[i].iter().all(|e| e.outlier);
    assert!(out(first) && out(first + 1), "both directions of the false tie");
    assert!(list[first + 1].tie == Some(3) && found.ends[first + 1][0].residual_m.abs() < 5.0 * SIGMA_M);
    let others = (0..list.len()).filter(|i| list[*i].tie.is_some_and(|t| t != 3) && !out(*i)).count();
    assert!(others >= 16, "{others} of 18 other directions stay");
}
