//! First values of a long trajectory: taken in piece by piece.

use crate::factor::Factor;
use crate::factor::pose2::{Between2, Sighting2};
use crate::nonlinear::{SolveOptions, solve};
use crate::problem::Problem;
use crate::rotation::turn;
use crate::system::SystemError;
use crate::variable::{Kind, VariableId};

/// Poses taken in at a time.
const PIECE: usize = 50;

/// Puts poses of the plane and the points they see into place, piece by piece: new poses are chained by odometry from
/// the solution so far, new points placed by their first sighting, and all of it adjusted.
///
/// # Errors
/// [`SystemError`].
pub fn start(problem: &mut Problem, options: &SolveOptions) -> Result<(), SystemError> {
    let poses: Vec<VariableId> = problem.variables().filter(|v| problem.values.kind(*v) == Kind::Pose2).collect();
    let mut placed = vec![false; problem.values.len()];
    for id in problem.variables().filter(|v| problem.is_fixed(*v)) {
        placed[id.index()] = true;
    }
    let mut end = 0;
    while end < poses.len() {
        end = (end + PIECE).min(poses.len());
        let last = poses[end - 1];
        place(problem, &mut placed, last);
        let mut piece = part(problem, &placed);
        solve(&mut piece, options)?;
        problem.values = piece.values;
    }
    Ok(())
}

/// Places what relations and sightings reach up to a pose.
fn place(problem: &mut Problem, placed: &mut [bool], last: VariableId) {
    if placed.iter().all(|p| !p) {
        placed[0] = true;
    }
    let mut values = problem.values.clone();
    for between in problem.factors_of::<Between2>() {
        let [a, b] = [between.variables()[0], between.variables()[1]];
        if b <= last && placed[a.index()] && !placed[b.index()] {
            let m = between.measured();
            let from = values.get(a).to_vec();
            let t = turn(from[2]) * nalgebra::Vector2::new(m[0], m[1]);
            values.get_mut(b).copy_from_slice(&[from[0] + t.x, from[1] + t.y, from[2] + m[2]]);
            placed[b.index()] = true;
        }
    }
    for sighting in problem.factors_of::<Sighting2>() {
        let [pose, point] = [sighting.variables()[0], sighting.variables()[1]];
        if pose <= last && placed[pose.index()] && !placed[point.index()] {
            let from = values.get(pose).to_vec();
            let t = turn(from[2]) * sighting.measured();
            values.get_mut(point).copy_from_slice(&[from[0] + t.x, from[1] + t.y]);
            placed[point.index()] = true;
        }
    }
    problem.values = values;
}

/// The problem of what has been placed; everything else is held.
fn part(problem: &Problem, placed: &[bool]) -> Problem {
    let mut part = Problem::new();
    for id in problem.variables() {
        let new = part.add_variable(problem.values.kind(id), problem.values.get(id));
        part.set_fixed(new, problem.is_fixed(id) || !placed[id.index()]);
        part.set_name(new, problem.name(id));
    }
    let inside = |factor: &dyn Factor| factor.variables().iter().all(|v| placed[v.index()]);
    for factor in problem.factors_of::<Between2>().iter().filter(|f| inside(*f)) {
        part.add(factor.clone());
    }
    for factor in problem.factors_of::<Sighting2>().iter().filter(|f| inside(*f)) {
        part.add(factor.clone());
    }
    part
}
