//! First values of poses without a good guess: chordal rotations, then translations, each a linear problem
//! (Martinec and Pajdla 2007; Carlone et al. 2015).

use nalgebra::{Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector2, Vector3};

use crate::factor::pose2::{Between2, Sighting2};
use crate::factor::pose3::{Between3, Sighting3};
use crate::factor::vector::Linear;
use crate::factor::{Factor, square_root};
use crate::linear::blocks::Normal;
use crate::nonlinear::{SolveOptions, solve_system};
use crate::problem::Problem;
use crate::robust::Kernel;
use crate::rotation::turn;
use crate::system::{Order, System, SystemError};
use crate::variable::{Kind, Values, VariableId};

/// Values by chordal rotations and linear translations. Held variables keep their values; variables that no relation
/// of poses reaches keep their guess.
///
/// # Errors
/// [`SystemError`] when the relations do not determine the poses.
pub fn chordal(problem: &Problem) -> Result<Values, SystemError> {
    let mut values = problem.values.clone();
    if !problem.factors_of::<Between2>().is_empty() {
        rotations_in_plane(problem, &mut values)?;
        translations::<2>(problem, &mut values)?;
    }
    if !problem.factors_of::<Between3>().is_empty() {
        rotations_in_space(problem, &mut values)?;
        translations::<3>(problem, &mut values)?;
    }
    Ok(values)
}

/// Poses taken in piece by piece in the order of their numbers, each piece from the solution before it; for
/// trajectories with landmarks, where rotations alone close no loop.
///
/// # Errors
/// [`SystemError`].
pub fn incremental(problem: &mut Problem, options: &SolveOptions) -> Result<(), SystemError> {
    crate::incremental::start(problem, options)
}

/// A problem on the same variables, each as a plain vector of `count` numbers; others than `kinds` are held.
fn shadow(problem: &Problem, count: u8, kinds: &[Kind]) -> Problem {
    let mut shadow = Problem::new();
    let zeros = vec![0.0; usize::from(count)];
    for id in problem.variables() {
        let new = shadow.add_variable(Kind::Vector(count), &zeros);
        shadow.set_fixed(new, problem.is_fixed(id) || !kinds.contains(&problem.values.kind(id)));
        shadow.set_name(new, problem.name(id));
        if let Some(place) = problem.place(id) {
            shadow.set_place(new, place);
        }
    }
    shadow
}

/// Holds variables that no factor of the shadow touches.
fn hold_untouched(shadow: &mut Problem) {
    let mut touched = vec![false; shadow.values.len()];
    for factor in shadow.factors() {
        factor.variables().iter().for_each(|v| touched[v.index()] = true);
    }
    for id in shadow.variables() {
        if !touched[id.index()] {
            shadow.fix(id);
        }
    }
}

fn linear_options() -> SolveOptions {
    SolveOptions { iterations: 1, order: Order::MinimumDegree, ..SolveOptions::default() }
}

fn rotations_in_plane(problem: &Problem, values: &mut Values) -> Result<(), SystemError> {
    let mut shadow = shadow(problem, 2, &[Kind::Pose2]);
    for id in problem.variables().filter(|id| problem.values.kind(*id) == Kind::Pose2) {
        let (sin, cos) = problem.values.get(id)[2].sin_cos();
        shadow.values.get_mut(id).copy_from_slice(&[cos, sin]);
    }
    for between in problem.factors_of::<Between2>() {
        let w = between.information()[(2, 2)].sqrt();
        let (s, c) = between.measured()[2].sin_cos();
        let coefficients = vec![-w * c, w * s, w, 0.0, -w * s, -w * c, 0.0, w];
        shadow.add(Linear::new(between.variables().to_vec(), coefficients, vec![0.0; 2]));
    }
    hold_untouched(&mut shadow);
    crate::nonlinear::solve(&mut shadow, &linear_options())?;
    for id in problem.variables().filter(|id| problem.values.kind(*id) == Kind::Pose2 && !problem.is_fixed(*id)) {
        let v = shadow.values.xy(id);
        if v.norm() > 1e-6 {
            values.get_mut(id)[2] = v.y.atan2(v.x);
        }
    }
    Ok(())
}

fn rotations_in_space(problem: &Problem, values: &mut Values) -> Result<(), SystemError> {
    let mut shadow = shadow(problem, 3, &[Kind::Pose3]);
    for between in problem.factors_of::<Between3>() {
        let information = between.information();
        let w = (information.fixed_view::<3, 3>(3, 3).trace() / 3.0).sqrt();
        let r = *between.measured().rotation.to_rotation_matrix().matrix();
        // a row of the second rotation is the row of the first times the measured one
        let mut coefficients = vec![0.0; 18];
        for c in 0..3 {
            for k in 0..3 {
                coefficients[c * 6 + k] = -w * r[(k, c)];
            }
            coefficients[c * 6 + 3 + c] = w;
        }
        shadow.add(Linear::new(between.variables().to_vec(), coefficients, vec![0.0; 3]));
    }
    hold_untouched(&mut shadow);
    let options = linear_options();
    let mut system = System::new(&shadow, options.order, options.partition, options.method.clone())?;
    let matrices: Vec<Matrix3<f64>> = problem.variables().map(|id| rotation_or_identity(problem, id)).collect();
    let mut rows: Vec<Vec<[f64; 3]>> = Vec::new();
    let mut normal = Normal::default();
    for row in 0..3 {
        for id in shadow.variables().collect::<Vec<_>>() {
            let m = &matrices[id.index()];
            shadow.values.get_mut(id).copy_from_slice(&[m[(row, 0)], m[(row, 1)], m[(row, 2)]]);
        }
        let values = shadow.values.clone();
        system.pattern.assemble(&shadow, &values, &Kernel::None, &mut normal);
        let mut step = normal.right.clone();
        if row == 0 {
            system.solve(&shadow, &normal.numbers, &mut step)?;
        } else {
            system.solve_again(&mut step);
        }
        let mut moved = shadow.values.clone();
        system.retract(&shadow, &mut moved, &step, 1.0);
        shadow.values = moved;
        rows.push(shadow.variables().map(|id| shadow.values.xyz(id).into()).collect());
    }
    for id in problem.variables().filter(|id| problem.values.kind(*id) == Kind::Pose3 && !problem.is_fixed(*id)) {
        let k = id.index();
        let m = Matrix3::from_fn(|r, c| rows[r][k][c]);
        if m.norm() > 1e-6 {
            let svd = m.svd(true, true);
            if let (Some(u), Some(vt)) = (svd.u, svd.v_t) {
                let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * vt).determinant().signum()));
                let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * sign * vt));
                values.get_mut(id)[3..7].copy_from_slice(&[q.i, q.j, q.k, q.w]);
            }
        }
    }
    Ok(())
}

fn rotation_or_identity(problem: &Problem, id: VariableId) -> Matrix3<f64> {
    if problem.values.kind(id) == Kind::Pose3 {
        *problem.values.rotation(id).to_rotation_matrix().matrix()
    } else {
        Matrix3::identity()
    }
}

/// One relation of places: from, to, whitened rows on the difference, whitened measured difference.
type Relation<const N: usize> = ([VariableId; 2], SMatrix<f64, N, N>, nalgebra::SVector<f64, N>);

fn translations<const N: usize>(problem: &Problem, values: &mut Values) -> Result<(), SystemError> {
    let kinds = if N == 2 { [Kind::Pose2, Kind::Point2] } else { [Kind::Pose3, Kind::Point3] };
    let mut shadow = shadow(problem, if N == 2 { 2 } else { 3 }, &kinds);
    for id in problem.variables().filter(|id| kinds.contains(&problem.values.kind(*id))) {
        shadow.values.get_mut(id).copy_from_slice(&problem.values.get(id)[..N]);
    }
    for (ids, rows, right) in relations::<N>(problem, values) {
        let mut coefficients = vec![0.0; 2 * N * N];
        for r in 0..N {
            for c in 0..N {
                coefficients[r * 2 * N + c] = -rows[(r, c)];
                coefficients[r * 2 * N + N + c] = rows[(r, c)];
            }
        }
        shadow.add(Linear::new(ids.to_vec(), coefficients, right.iter().copied().collect()));
    }
    hold_untouched(&mut shadow);
    let options = linear_options();
    let mut system = System::new(&shadow, options.order, options.partition, options.method.clone())?;
    solve_system(&mut shadow, &mut system, &options)?;
    for id in problem.variables().filter(|id| kinds.contains(&problem.values.kind(*id)) && !problem.is_fixed(*id)) {
        let new = shadow.values.get(id).to_vec();
        values.get_mut(id)[..N].copy_from_slice(&new);
    }
    Ok(())
}

/// All relations of places, with the rotations as they are.
fn relations<const N: usize>(problem: &Problem, values: &Values) -> Vec<Relation<N>> {
    let mut relations = Vec::new();
    let mut push = |ids: &[VariableId], information: SMatrix<f64, N, N>, back: SMatrix<f64, N, N>, measured| {
        let root = root(&information);
        relations.push(([ids[0], ids[1]], root * back, root * measured));
    };
    if N == 2 {
        let back = |id| {
            let r = turn(-values.get(id)[2]);
            SMatrix::<f64, N, N>::from_fn(|i, j| r[(i, j)])
        };
        let vector = |v: Vector2<f64>| nalgebra::SVector::<f64, N>::from_fn(|i, _| v[i]);
        for f in problem.factors_of::<Between2>() {
            let w = SMatrix::<f64, N, N>::from_fn(|i, j| f.information()[(i, j)]);
            let m = f.measured();
            push(f.variables(), w, back(f.variables()[0]), vector(Vector2::new(m[0], m[1])));
        }
        for f in problem.factors_of::<Sighting2>() {
            push(f.variables(), SMatrix::identity(), back(f.variables()[0]), vector(f.measured()));
        }
    } else {
        let back = |id| {
            let r = values.rotation(id).inverse().to_rotation_matrix();
            SMatrix::<f64, N, N>::from_fn(|i, j| r.matrix()[(i, j)])
        };
        let vector = |v: Vector3<f64>| nalgebra::SVector::<f64, N>::from_fn(|i, _| v[i]);
        for f in problem.factors_of::<Between3>() {
            let w = SMatrix::<f64, N, N>::from_fn(|i, j| f.information()[(i, j)]);
            push(f.variables(), w, back(f.variables()[0]), vector(f.measured().translation));
        }
        for f in problem.factors_of::<Sighting3>() {
            push(f.variables(), SMatrix::identity(), back(f.variables()[0]), vector(f.measured()));
        }
    }
    relations
}

fn root<const N: usize>(information: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let as_three =
        Matrix3::from_fn(|i, j| if i < N && j < N { information[(i, j)] } else { f64::from(u8::from(i == j)) });
    let root = square_root(&as_three).unwrap_or_else(|_| Matrix3::identity());
    SMatrix::from_fn(|i, j| root[(i, j)])
}
