//! The adjustment of strips as a problem of the graph: nodes of unknowns, priors, surface lines.

use nalgebra::{DMatrix, DVector};

use super::AdjustmentError;
use super::judge::{Deviation, has_mean, is_used, weights};
use crate::covariance::{visit_factors, whole};
use crate::factor::common_surface::{CommonSurface, SparseRow};
use crate::factor::vector::VectorPrior;
use crate::helmert::partition::PartitionOptions;
use crate::linear::blocks::Normal;
use crate::model::{Model, ParameterBlock};
use crate::observation::Line;
use crate::problem::Problem;
use crate::robust::Kernel;
use crate::system::{Method, Order, System};
use crate::variable::{Kind, VariableId};

/// Variables are the changes of the unknowns since the lines were measured: one for every knot of a strip and for every
/// scanner's calibration, which goes into the last block.
pub(super) struct StripSystem<'a> {
    lines: &'a [Line],
    problem: Problem,
    system: System,
    normal: Normal,
    /// Variable and first unknown of each node.
    nodes: Vec<(VariableId, usize)>,
    /// Place of each line among the factors of its type; `None` where it depends on no unknown.
    place: Vec<Option<usize>>,
}

impl<'a> StripSystem<'a> {
    /// The problem of a model with lines that were measured at its present state.
    pub(super) fn new(model: &Model, lines: &'a [Line]) -> Result<Self, AdjustmentError> {
        let mut problem = Problem::new();
        let mut nodes = Vec::new();
        let mut node_of = vec![0_usize; model.count()];
        for range in model.nodes() {
            let size = u8::try_from(range.len()).unwrap_or(u8::MAX);
            let id = problem.add_variable(Kind::Vector(size), &vec![0.0; range.len()]);
            let parameters = &model.parameters()[range.clone()];
            problem.set_name(id, parameters[0].name.clone());
            if matches!(parameters[0].block, ParameterBlock::Calibration(_)) {
                problem.set_global(id);
            }
            let prior: Vec<f64> = range.clone().map(|i| -model.state()[i]).collect();
            let sigmas: Vec<f64> = parameters.iter().map(|p| p.prior_sigma).collect();
            problem.add(VectorPrior::new(id, &prior, &sigmas));
            node_of[range.clone()].fill(nodes.len());
            nodes.push((id, range.start));
        }
        let mut place = Vec::with_capacity(lines.len());
        for line in lines {
            let rows: Vec<_> = line.ends.iter().map(|end| model.row(end, &line.normal)).collect();
            let factor = common_surface(line, &rows, &node_of, &nodes, &problem);
            place.push(factor.map(|factor| {
                problem.add(factor);
                problem.factors_of::<CommonSurface>().len() - 1
            }));
        }
        let system = System::new(&problem, Order::Automatic, PartitionOptions::default(), Method::Helmert)?;
        Ok(Self { lines, problem, system, normal: Normal::default(), nodes, place })
    }

    /// Solves with the given factors on the weights of the ends; the step is kept until the next one.
    pub(super) fn solve(&mut self, factors: &[Vec<f64>], scales: &[f64]) -> Result<(), AdjustmentError> {
        let list = self.problem.factors_of_mut::<CommonSurface>();
        for ((line, place), factors) in self.lines.iter().zip(&self.place).zip(factors) {
            let Some(place) = place else { continue };
            let of_ends =
                if is_used(line, factors) { weights(line, factors, scales) } else { vec![0.0; factors.len()] };
            list[*place].set_weights(&of_ends);
        }
        for (id, _) in &self.nodes {
            self.problem.values.get_mut(*id).fill(0.0);
        }
        let values = std::mem::take(&mut self.problem.values);
        self.system.pattern.assemble(&self.problem, &values, &Kernel::None, &mut self.normal);
        self.problem.values = values;
        let mut step = std::mem::take(&mut self.normal.right);
        self.system.solve(&self.problem, &self.normal.numbers, &mut step)?;
        let mut values = std::mem::take(&mut self.problem.values);
        self.system.retract(&self.problem, &mut values, &step, 1.0);
        self.problem.values = values;
        Ok(())
    }

    /// Changes of the unknowns by the last step.
    pub(super) fn step(&self) -> DVector<f64> {
        DVector::from_iterator(
            self.nodes.iter().map(|(id, _)| self.problem.values.get(*id).len()).sum(),
            self.nodes.iter().flat_map(|(id, _)| self.problem.values.get(*id).iter().copied()),
        )
    }

    /// Covariance of the unknowns by the last factorisation.
    pub(super) fn covariance(&self) -> Result<DMatrix<f64>, AdjustmentError> {
        let inverse = whole(&self.system)?;
        let scalar: Vec<usize> = self
            .nodes
            .iter()
            .flat_map(|(id, _)| {
                let first = self.system.pattern.scalar[id.index()] as usize;
                first..first + self.problem.values.get(*id).len()
            })
            .collect();
        Ok(DMatrix::from_fn(scalar.len(), scalar.len(), |i, j| inverse[(scalar[i], scalar[j])]))
    }

    /// Weights that make the mean a line's ends are compared with: those of the solution, or of all its ends where it is
    /// not in it and none is left.
    fn mean_weights(line: &Line, factors: &[f64], scales: &[f64]) -> Vec<f64> {
        if has_mean(factors) {
            weights(line, factors, scales)
        } else {
            weights(line, &vec![1.0; factors.len()], scales)
        }
    }

    fn deviations_m(&self, i: usize, weights: &[f64]) -> Vec<f64> {
        if let Some(place) = self.place[i] {
            return self.problem.factors_of::<CommonSurface>()[place].deviations_m(&self.problem.values, weights);
        }
        let total: f64 = weights.iter().sum();
        let mean = self.lines[i].ends.iter().zip(weights).map(|(e, w)| e.offset_m * w).sum::<f64>() / total;
        self.lines[i].ends.iter().map(|e| e.offset_m - mean).collect()
    }

    /// Deviations after the last step, with the redundancy that the surface alone leaves.
    pub(super) fn deviations(&self, factors: &[Vec<f64>], scales: &[f64]) -> Vec<Vec<Deviation>> {
        let of_line = |(i, line): (usize, &Line)| {
            let used = Self::mean_weights(line, &factors[i], scales);
            let own = weights(line, &vec![1.0; line.ends.len()], scales);
            let total: f64 = used.iter().sum();
            let redundancy = |(u, w): (&f64, &f64)| if *u > 0.0 { 1.0 - w / total.max(*w) } else { 1.0 };
            self.deviations_m(i, &used).into_iter().zip(used.iter().zip(&own).map(redundancy)).collect()
        };
        self.lines.iter().enumerate().map(of_line).collect()
    }

    /// Deviations after the last step with full redundancy numbers, by the last factorisation.
    pub(super) fn exact_deviations(
        &self,
        factors: &[Vec<f64>],
        scales: &[f64],
    ) -> Result<Vec<Vec<Deviation>>, AdjustmentError> {
        let mut list = self.deviations(factors, scales);
        let line_of: Vec<usize> = (0..self.lines.len()).filter(|i| self.place[*i].is_some()).collect();
        let first = self.nodes.len();
        let surfaces = self.problem.factors_of::<CommonSurface>();
        visit_factors(&self.problem, &self.system, |number, joint| {
            let Some(place) = number.checked_sub(first) else { return };
            let i = line_of[place];
            let line = &self.lines[i];
            let used = Self::mean_weights(line, &factors[i], scales);
            let own = weights(line, &vec![1.0; line.ends.len()], scales);
            let total: f64 = used.iter().sum();
            let in_solution = is_used(line, &factors[i]);
            let variances = surfaces[place].variances_m2(joint, &used);
            for (k, (deviation, variance)) in list[i].iter_mut().zip(variances).enumerate() {
                let model = own[k] * variance;
                deviation.1 = if used[k] <= 0.0 {
                    1.0 + own[k] / total + model
                } else {
                    let sign = if in_solution { -1.0 } else { 1.0 };
                    (1.0 - own[k] / total.max(own[k]) + sign * model).max(1e-3)
                };
            }
        })?;
        Ok(list)
    }
}

/// A line as a factor; `None` when it depends on no unknown.
#[allow(clippy::cast_possible_truncation)] // columns of a line are few
fn common_surface(
    line: &Line,
    rows: &[Vec<(usize, f64)>],
    node_of: &[usize],
    nodes: &[(VariableId, usize)],
    problem: &Problem,
) -> Option<CommonSurface> {
    let mut used: Vec<usize> = rows.iter().flatten().map(|(parameter, _)| node_of[*parameter]).collect();
    used.sort_unstable();
    used.dedup();
    if used.is_empty() {
        return None;
    }
    let mut columns = 0;
    let first: Vec<usize> = used
        .iter()
        .map(|node| {
            let start = columns;
            columns += problem.values.kind(nodes[*node].0).dimension();
            start
        })
        .collect();
    let sparse = |row: &Vec<(usize, f64)>| -> SparseRow {
        let place = |parameter: usize| {
            let node = node_of[parameter];
            first[used.partition_point(|n| *n < node)] + parameter - nodes[node].1
        };
        row.iter().map(|(parameter, value)| (place(*parameter) as u32, *value)).collect()
    };
    let offsets = line.ends.iter().map(|e| e.offset_m).collect();
    let ids = used.iter().map(|node| nodes[*node].0).collect();
    Some(CommonSurface::new(ids, columns, rows.iter().map(sparse).collect(), offsets, vec![0.0; line.ends.len()]))
}
