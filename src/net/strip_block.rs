//! A simulated block of strips as a problem.

use tieline_graph::factor::strip_tie::{StripEnd, StripTie};
use tieline_graph::factor::vector::VectorPrior;
use tieline_graph::{Kind, Problem, VariableId};
use tieline_simulate::block::{Block, BlockEnd, CALIBRATION_SIGMAS, KNOT_SIGMAS, TIE_SIGMA_M};

/// The problem of a block: knots in their order, then the calibration, which goes into the last block.
#[must_use]
pub fn problem(block: &Block, knots: usize) -> Problem {
    let mut problem = Problem::new();
    for place in &block.places_m {
        let id = problem.add_variable(Kind::Vector(6), &[0.0; 6]);
        problem.set_place(id, *place);
        problem.add(VectorPrior::new(id, &[0.0; 6], &KNOT_SIGMAS));
    }
    let calibration = problem.add_variable(Kind::Vector(6), &[0.0; 6]);
    problem.set_global(calibration);
    problem.set_name(calibration, "calibration");
    problem.add(VectorPrior::new(calibration, &[0.0; 6], &CALIBRATION_SIGMAS));
    let end = |e: &BlockEnd| StripEnd {
        first_knot: VariableId(u32::try_from(e.strip * knots + e.knot).unwrap_or(u32::MAX)),
        weights: e.weights,
        heading_rad: e.heading_rad,
        body_m: e.body_m,
    };
    for tie in &block.ties {
        let ends = [end(&tie.ends[0]), end(&tie.ends[1])];
        problem.add(StripTie::new(ends, calibration, tie.normal, tie.offset_m, TIE_SIGMA_M));
    }
    problem.shrink();
    problem
}
