//! `--method bowie`: junctions and sections, and how far from the exact solution they end.

use std::fmt;

use anyhow::Result;
use serde::Serialize;
use tieline_graph::bowie::length::solve_by_length;
use tieline_graph::bowie::{BowieOptions, solve};
use tieline_graph::nonlinear::{self, SolveOptions, Solved};
use tieline_graph::robust::Kernel;
use tieline_graph::{Kind, Problem};

use super::solve::{Outcome, Setup};
use crate::cli::GraphSections;

/// Junctions and sections of a graph.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Sections {
    /// What a section counts as.
    sections_by: &'static str,
    /// Nodes where sections meet or end.
    junctions: usize,
    /// Chains between them.
    sections: usize,
    /// Factors that take no part in the first pass.
    left_out: usize,
    /// Passes over the junction net.
    passes: usize,
    /// chi2 of the exact solution.
    exact_chi2: f64,
    /// Rms of the positions off the exact solution \[m\].
    off_exact_m: f64,
}

impl fmt::Display for Sections {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} junctions, {} sections by {}; positions {:.3e} m (rms) off the exact solution, whose chi2 is {:.9}",
            self.junctions, self.sections, self.sections_by, self.off_exact_m, self.exact_chi2
        )
    }
}

/// Adjusts by junctions and sections.
///
/// # Errors
/// As the solver's.
pub(super) fn adjust(problem: &mut Problem, setup: &Setup, kernel: Kernel) -> Result<Outcome> {
    let unknown = (f64::NAN, f64::NAN);
    let (solved, sections) = match setup.sections {
        GraphSections::Schur => {
            let (solved, step) = solve(problem, &kernel, &BowieOptions::default(), setup.iterations)?;
            let sections = Sections {
                sections_by: "schur",
                junctions: step.junctions,
                sections: step.sections,
                left_out: step.left_out,
                passes: step.misclosure.len(),
                exact_chi2: unknown.0,
                off_exact_m: unknown.1,
            };
            (solved, sections)
        }
        GraphSections::Length => {
            let done = solve_by_length(problem)?;
            let sections = Sections {
                sections_by: "length",
                junctions: done.junctions,
                sections: done.sections,
                left_out: 0,
                passes: done.passes,
                exact_chi2: unknown.0,
                off_exact_m: unknown.1,
            };
            let freedom = problem.residual_count() as i64 - problem.unknown_count() as i64;
            let solved = Solved {
                first_cost: done.first_cost,
                cost: done.cost,
                iterations: done.passes,
                converged: true,
                degrees_of_freedom: freedom,
                ..Solved::default()
            };
            (solved, sections)
        }
    };
    Ok(Outcome { solved, bowie: Some(sections), ..Outcome::default() })
}

/// Solves exactly from there, notes the distance, and puts the values back.
///
/// # Errors
/// As the solver's.
pub(super) fn compare(problem: &mut Problem, options: &SolveOptions, outcome: &mut Outcome) -> Result<()> {
    let Some(sections) = &mut outcome.bowie else { return Ok(()) };
    let values = problem.values.clone();
    let exact = nonlinear::solve(problem, options)?;
    let exact_values = std::mem::replace(&mut problem.values, values);
    let (mut sum, mut count) = (0.0, 0_u32);
    for id in problem.variables().filter(|id| !problem.is_fixed(*id)) {
        let dimension = match problem.values.kind(id) {
            Kind::Pose2 | Kind::Point2 => 2,
            Kind::Pose3 | Kind::Point3 => 3,
            _ => continue,
        };
        let pairs = problem.values.get(id)[..dimension].iter().zip(&exact_values.get(id)[..dimension]);
        sum += pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        count += 1;
    }
    sections.exact_chi2 = exact.cost;
    sections.off_exact_m = (sum / f64::from(count.max(1))).sqrt();
    Ok(())
}
