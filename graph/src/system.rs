//! A problem made ready to be solved: order of elimination, pattern, factorisation.

use std::time::Instant;

use crate::helmert::block::{Equations, Singular};
use crate::helmert::elimination::minimum_degree;
use crate::helmert::factor::Factorisation;
use crate::helmert::out_of_core::{Disk, DiskError, DiskFactorisation};
use crate::helmert::partition::{PartitionOptions, partition};
use crate::helmert::tree::Tree;
use crate::linear::blocks::{Normal, Pattern, TooLarge};
use crate::linear::nodes::NodeGraph;
use crate::linear::reference::Reference;
use crate::problem::Problem;
use crate::variable::{Values, VariableId};

/// Where the order of elimination comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// From the places; for small graphs minimum degree where that needs fewer operations or places are missing.
    #[default]
    Automatic,
    /// Partition by places.
    Places,
    /// Minimum degree.
    MinimumDegree,
}

/// How the normal equations are solved.
#[derive(Debug, Clone, Default)]
pub enum Method {
    /// Helmert blocking in memory.
    #[default]
    Helmert,
    /// Helmert blocking with the panels on disk.
    HelmertOnDisk(Disk),
    /// The library's sparse Cholesky on the same order.
    Cholesky,
}

/// Why the normal equations cannot be solved.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SystemError {
    /// A variable without enough observations.
    #[error("`{name}` is not determined by the observations; add observations, a known value, or leave it out")]
    NotDetermined {
        /// Name of the variable.
        name: String,
    },
    /// Parts of the graph that nothing ties to a datum.
    #[error(
        "the graph has {components} parts without connection, and nothing holds the one of `{name}` in place; \
         connect it, fix one of its variables, or give a known value"
    )]
    Disconnected {
        /// Number of parts.
        components: u32,
        /// A variable of the part.
        name: String,
    },
    /// Nothing to solve for.
    #[error("nothing to adjust: no variable is free")]
    Empty,
    /// An observation that gives no number.
    #[error(
        "the equations hold values that are not numbers, first at `{name}`; look at its coordinates and observations"
    )]
    NotFinite {
        /// Name of the variable.
        name: String,
    },
    /// Too many numbers.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
    /// The disk.
    #[error(transparent)]
    Disk(#[from] DiskError),
}

/// Nodes up to which minimum degree is tried beside the partition.
const TRY_MINIMUM_DEGREE: usize = 20_000;

/// A problem made ready to be solved.
#[derive(Debug)]
pub struct System {
    /// Nodes and their neighbours.
    pub graph: NodeGraph,
    /// Blocks.
    pub tree: Tree,
    /// Pattern of the normal equations.
    pub pattern: Pattern,
    /// Seconds for order and pattern.
    pub order_s: f64,
    method: Method,
    factor: Factorisation,
    disk: Option<DiskFactorisation>,
    reference: Option<Reference>,
    variable_of: Vec<(u32, u32)>,
}

impl System {
    /// Orders the unknowns and finds the pattern.
    ///
    /// # Errors
    /// [`SystemError`].
    pub fn new(
        problem: &Problem,
        order: Order,
        options: PartitionOptions,
        method: Method,
    ) -> Result<Self, SystemError> {
        let begin = Instant::now();
        let graph = NodeGraph::new(problem);
        if graph.is_empty() {
            return Err(SystemError::Empty);
        }
        let tree = tree(problem, &graph, order, options);
        let pattern = Pattern::new(problem, &graph, &tree)?;
        let reference = if matches!(method, Method::Cholesky) { Some(Reference::new(&tree, &pattern)) } else { None };
        let mut variable_of: Vec<(u32, u32)> =
            problem.variables().filter(|v| !problem.is_fixed(*v)).map(|v| (pattern.scalar[v.index()], v.0)).collect();
        variable_of.sort_unstable();
        let mut system = Self {
            graph,
            tree,
            pattern,
            order_s: 0.0,
            method,
            factor: Factorisation::default(),
            disk: None,
            reference: None,
            variable_of,
        };
        if let Some(reference) = reference {
            system.reference = Some(reference.map_err(|s| system.not_determined(problem, s))?);
        }
        // from here on the pattern says it all
        system.graph.starts = Vec::new();
        system.graph.neighbours = Vec::new();
        system.order_s = begin.elapsed().as_secs_f64();
        Ok(system)
    }

    /// Keeps the panels on disk from now on.
    pub fn use_disk(&mut self, disk: Disk) {
        self.method = Method::HelmertOnDisk(disk);
    }
    /// The factorisation on disk, when there is one.
    #[must_use]
    pub fn on_disk(&self) -> Option<&DiskFactorisation> {
        self.disk.as_ref()
    }

    /// Unknowns.
    #[must_use]
    pub fn scalars(&self) -> usize {
        self.pattern.scalars()
    }
    /// The factorisation in memory; empty before [`System::solve`] and with other methods.
    #[must_use]
    pub fn factorisation(&self) -> &Factorisation {
        &self.factor
    }
    /// Variable of a scalar in the order of elimination.
    #[must_use]
    pub fn variable_at(&self, scalar: usize) -> VariableId {
        let next = self.variable_of.partition_point(|(first, _)| *first as usize <= scalar);
        VariableId(self.variable_of[next.saturating_sub(1)].1)
    }
    fn not_determined(&self, problem: &Problem, singular: Singular) -> SystemError {
        let id = self.variable_at(singular.scalar);
        SystemError::NotDetermined { name: problem.name(problem.host(id)) }
    }

    /// Factorises and solves; `normal.right` becomes the step, in the order of elimination. Returns the seconds of
    /// the factorisation and of the solution.
    ///
    /// # Errors
    /// [`SystemError`].
    pub fn solve(&mut self, problem: &Problem, numbers: &[f64], right: &mut [f64]) -> Result<(f64, f64), SystemError> {
        if let Some(scalar) = right.iter().position(|v| !v.is_finite()) {
            return Err(SystemError::NotFinite { name: problem.name(self.variable_at(scalar)) });
        }
        let begin = Instant::now();
        let equations = Equations { tree: &self.tree, pattern: &self.pattern, numbers };
        let factored = match (&self.method, &self.reference) {
            (Method::Cholesky, Some(reference)) => {
                let solved = reference.solve(numbers, right);
                return solved
                    .map(|()| (begin.elapsed().as_secs_f64(), 0.0))
                    .map_err(|s| self.not_determined(problem, s));
            }
            (Method::HelmertOnDisk(disk), _) => match DiskFactorisation::factorise(disk, &equations, right)? {
                Ok(on_disk) => {
                    self.disk = Some(on_disk);
                    Ok(())
                }
                Err(singular) => Err(singular),
            },
            _ => self.factor.factorise(&equations, right),
        };
        factored.map_err(|s| self.not_determined(problem, s))?;
        let factor_s = begin.elapsed().as_secs_f64();
        let begin = Instant::now();
        if let Some(disk) = &self.disk {
            disk.backward(&self.tree, right)?;
        } else {
            self.factor.backward(&self.tree, right);
        }
        Ok((factor_s, begin.elapsed().as_secs_f64()))
    }

    /// Solves again with the last factorisation in memory, in place.
    pub fn solve_again(&self, right: &mut [f64]) {
        self.factor.solve(&self.tree, right);
    }

    /// Improves a step by one round of refinement: misclosures in twice the precision, solved with the same numbers
    /// again. `right` is the right-hand side of the step.
    ///
    /// # Errors
    /// [`SystemError`].
    pub fn refine(
        &mut self,
        problem: &Problem,
        numbers: &[f64],
        right: &[f64],
        step: &mut [f64],
    ) -> Result<(), SystemError> {
        let mut left = self.pattern.misclosure(numbers, right, step);
        self.solve(problem, numbers, &mut left)?;
        step.iter_mut().zip(&left).for_each(|(s, l)| *s += l);
        Ok(())
    }

    /// Panel of a block of the last factorisation.
    ///
    /// # Errors
    /// [`DiskError`].
    pub fn panel(&self, block: usize) -> Result<std::borrow::Cow<'_, [f64]>, DiskError> {
        match &self.disk {
            Some(disk) => Ok(std::borrow::Cow::Owned(disk.panel(&self.tree, block)?)),
            None => Ok(std::borrow::Cow::Borrowed(self.factor.panel(&self.tree, block))),
        }
    }

    /// Corrects all free variables by a share of a step.
    pub fn retract(&self, problem: &Problem, values: &mut Values, step: &[f64], share: f64) {
        let mut own = [0.0; 256];
        for id in problem.variables().filter(|v| !problem.is_fixed(*v)) {
            let first = self.pattern.scalar[id.index()] as usize;
            let count = values.kind(id).dimension();
            own[..count].iter_mut().zip(&step[first..first + count]).for_each(|(o, s)| *o = share * s);
            values.retract(id, &own[..count]);
        }
    }

    /// Normal equations with nothing in them.
    #[must_use]
    pub fn normal(&self) -> Normal {
        Normal::default()
    }
}

fn tree(problem: &Problem, graph: &NodeGraph, order: Order, options: PartitionOptions) -> Tree {
    let places = if order == Order::MinimumDegree { None } else { places(problem, graph) };
    let by_places = places.map(|places| Tree::new(graph, &partition(graph, &places, options)));
    match by_places {
        Some(tree) if order == Order::Places || graph.len() > TRY_MINIMUM_DEGREE => tree,
        Some(tree) => {
            let other = Tree::new(graph, &minimum_degree(graph));
            if other.flops() < tree.flops() { other } else { tree }
        }
        None => Tree::new(graph, &minimum_degree(graph)),
    }
}

/// Places of all nodes; `None` when one has none.
fn places(problem: &Problem, graph: &NodeGraph) -> Option<Vec<[f64; 3]>> {
    graph
        .first_variable
        .iter()
        .zip(&graph.global)
        .map(|(v, global)| {
            let place = problem.place(problem.host(VariableId(*v))).or_else(|| problem.place(VariableId(*v)));
            place.filter(|p| p.iter().all(|v| v.is_finite())).or(if *global { Some([0.0; 3]) } else { None })
        })
        .collect()
}
