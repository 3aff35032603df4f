//! A graph: variables and factors.

use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::ops::Range;

use crate::factor::Factor;
use crate::robust::Kernel;
use crate::variable::{Kind, Values, VariableId};

/// What evaluates factors hand over: residuals and derivatives, already weighted.
pub(crate) trait Sink {
    /// Takes one factor: its variables, residuals and derivatives (row by row, `columns` wide).
    fn take(&mut self, variables: &[VariableId], residual: &[f64], jacobian: &[f64], columns: usize);
}

/// Factors of one type, evaluated without a virtual call for each.
pub(crate) trait Group: Send + Sync + std::fmt::Debug {
    fn any_mut(&mut self) -> &mut dyn Any;
    fn any(&self) -> &dyn Any;
    fn len(&self) -> usize;
    fn factor(&self, index: usize) -> &dyn Factor;
    fn linearise(&self, range: Range<usize>, values: &Values, kernel: &Kernel, sink: &mut dyn BatchSink);
    fn cost(&self, range: Range<usize>, values: &Values, kernel: &Kernel) -> f64;
    fn shrink(&mut self);
    fn leave_out(&mut self, left_out: Vec<bool>);
    fn is_left_out(&self, index: usize) -> bool;
}

/// A sink behind a pointer.
pub(crate) trait BatchSink {
    fn take(&mut self, variables: &[VariableId], residual: &[f64], jacobian: &[f64], columns: usize);
}

impl<T: Sink> BatchSink for T {
    fn take(&mut self, variables: &[VariableId], residual: &[f64], jacobian: &[f64], columns: usize) {
        Sink::take(self, variables, residual, jacobian, columns);
    }
}

#[derive(Debug)]
struct Typed<F> {
    factors: Vec<F>,
    /// Factors that are left out; empty when none is.
    left_out: Vec<bool>,
}

impl<F: Factor> Group for Typed<F> {
    fn any_mut(&mut self) -> &mut dyn Any {
        &mut self.factors
    }
    fn any(&self) -> &dyn Any {
        &self.factors
    }
    fn leave_out(&mut self, left_out: Vec<bool>) {
        self.left_out = left_out;
    }
    #[inline]
    fn is_left_out(&self, index: usize) -> bool {
        self.left_out.get(index).copied().unwrap_or(false)
    }
    fn shrink(&mut self) {
        self.factors.shrink_to_fit();
    }
    fn len(&self) -> usize {
        self.factors.len()
    }
    fn factor(&self, index: usize) -> &dyn Factor {
        &self.factors[index]
    }
    fn linearise(&self, range: Range<usize>, values: &Values, kernel: &Kernel, sink: &mut dyn BatchSink) {
        let (mut residual, mut jacobian) = (Vec::new(), Vec::new());
        for index in range {
            if self.is_left_out(index) {
                continue;
            }
            let factor = &self.factors[index];
            let variables = factor.variables();
            let rows = factor.rows();
            let columns: usize = variables.iter().map(|v| values.kind(*v).dimension()).sum();
            zeros(&mut residual, rows);
            zeros(&mut jacobian, rows * columns);
            factor.evaluate(values, &mut residual, Some(&mut jacobian));
            if factor.is_tie() && *kernel != Kernel::None {
                let weight = kernel.weight(residual.iter().map(|r| r * r).sum()).sqrt();
                residual.iter_mut().chain(jacobian.iter_mut()).for_each(|v| *v *= weight);
            }
            sink.take(variables, &residual, &jacobian, columns);
        }
    }
    fn cost(&self, range: Range<usize>, values: &Values, kernel: &Kernel) -> f64 {
        let mut residual = Vec::new();
        let mut sum = 0.0;
        for index in range {
            if self.is_left_out(index) {
                continue;
            }
            let factor = &self.factors[index];
            zeros(&mut residual, factor.rows());
            factor.evaluate(values, &mut residual, None);
            let square: f64 = residual.iter().map(|r| r * r).sum();
            sum += if factor.is_tie() { kernel.cost(square) } else { square };
        }
        sum
    }
}

/// As many zeros.
#[inline]
fn zeros(buffer: &mut Vec<f64>, count: usize) {
    buffer.clear();
    buffer.resize(count, 0.0);
}

/// Variables and factors.
#[derive(Debug, Default)]
pub struct Problem {
    /// Values of the variables.
    pub values: Values,
    fixed: Vec<bool>,
    global: Vec<bool>,
    host: Vec<u32>,
    /// Given places, NaN where none is; empty when no variable has one.
    places: Vec<[f64; 3]>,
    names: HashMap<u32, String>,
    groups: Vec<Box<dyn Group>>,
    group_of: HashMap<TypeId, usize>,
}

impl Problem {
    /// A graph without anything.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }
    /// Adds a variable.
    pub fn add_variable(&mut self, kind: Kind, value: &[f64]) -> VariableId {
        let id = self.values.push(kind, value);
        self.fixed.push(false);
        self.global.push(false);
        self.host.push(id.0);
        id
    }
    /// Adds a variable that is eliminated together with another one, such as an orientation unknown with its station.
    pub fn add_attached(&mut self, host: VariableId, kind: Kind, value: &[f64]) -> VariableId {
        let id = self.add_variable(kind, value);
        self.host[id.index()] = self.host[host.index()];
        id
    }
    /// Holds a variable at its value.
    pub fn fix(&mut self, id: VariableId) {
        self.fixed[id.index()] = true;
    }
    /// Sets whether a variable is held.
    pub fn set_fixed(&mut self, id: VariableId, fixed: bool) {
        self.fixed[id.index()] = fixed;
    }
    /// Whether a variable is held.
    #[must_use]
    pub fn is_fixed(&self, id: VariableId) -> bool {
        self.fixed[id.index()]
    }
    /// Marks a variable that many others depend on (calibration): it goes into the last block.
    pub fn set_global(&mut self, id: VariableId) {
        self.global[id.index()] = true;
    }
    /// Whether a variable goes into the last block.
    #[must_use]
    pub fn is_global(&self, id: VariableId) -> bool {
        self.global[id.index()]
    }
    /// Gives a variable without coordinates a place, for the partition.
    pub fn set_place(&mut self, id: VariableId, place_m: [f64; 3]) {
        if self.places.len() < self.values.len() {
            self.places.resize(self.values.len(), [f64::NAN; 3]);
        }
        self.places[id.index()] = place_m;
    }
    /// Where a variable is; `None` when it has neither coordinates nor a given place.
    #[must_use]
    pub fn place(&self, id: VariableId) -> Option<[f64; 3]> {
        if let Some(place) = self.places.get(id.index()).filter(|p| !p[0].is_nan()) {
            return Some(*place);
        }
        let v = self.values.get(id);
        match self.values.kind(id) {
            Kind::Pose2 | Kind::Point2 => Some([v[0], v[1], 0.0]),
            Kind::Pose3 | Kind::Point3 => Some([v[0], v[1], v[2]]),
            _ => None,
        }
    }
    /// The variable that another is eliminated together with (itself, mostly).
    #[must_use]
    pub fn host(&self, id: VariableId) -> VariableId {
        VariableId(self.host[id.index()])
    }
    /// Gives a variable a name for messages.
    pub fn set_name(&mut self, id: VariableId, name: impl Into<String>) {
        self.names.insert(id.0, name.into());
    }
    /// Name of a variable, its number when it has none.
    #[must_use]
    pub fn name(&self, id: VariableId) -> String {
        self.names.get(&id.0).cloned().unwrap_or_else(|| id.0.to_string())
    }
    /// All variables.
    pub fn variables(&self) -> impl Iterator<Item = VariableId> + use<> {
        (0..u32::try_from(self.fixed.len()).unwrap_or(u32::MAX)).map(VariableId)
    }

    /// Adds a factor.
    ///
    /// # Panics
    /// Never: a group holds factors of its own type.
    pub fn add<F: Factor>(&mut self, factor: F) {
        let next = self.groups.len();
        let index = *self.group_of.entry(TypeId::of::<F>()).or_insert(next);
        if index == next {
            self.groups.push(Box::new(Typed::<F> { factors: Vec::new(), left_out: Vec::new() }));
        }
        let typed = self.groups[index].any_mut().downcast_mut::<Vec<F>>().expect("the group of this type");
        typed.push(factor);
    }
    /// Factors of one type.
    #[must_use]
    pub fn factors_of<F: Factor>(&self) -> &[F] {
        let group = self.group_of.get(&TypeId::of::<F>()).map(|g| &self.groups[*g]);
        group.and_then(|g| g.any().downcast_ref::<Vec<F>>()).map_or(&[], Vec::as_slice)
    }
    /// Factors of one type, to be changed.
    ///
    /// # Panics
    /// Never: a group holds factors of its own type.
    pub fn factors_of_mut<F: Factor>(&mut self) -> &mut Vec<F> {
        let next = self.groups.len();
        let index = *self.group_of.entry(TypeId::of::<F>()).or_insert(next);
        if index == next {
            self.groups.push(Box::new(Typed::<F> { factors: Vec::new(), left_out: Vec::new() }));
        }
        self.groups[index].any_mut().downcast_mut::<Vec<F>>().expect("the group of this type")
    }
    /// Leaves factors out, by their numbers: outliers, or ties that a section does without. An empty slice takes all
    /// of them in again.
    pub fn leave_out(&mut self, left_out: &[bool]) {
        let mut next = left_out.iter().copied();
        for group in &mut self.groups {
            let count = if left_out.is_empty() { 0 } else { group.len() };
            group.leave_out(next.by_ref().take(count).collect());
        }
    }
    /// Gives back memory that was set aside for more factors.
    pub fn shrink(&mut self) {
        self.groups.iter_mut().for_each(|g| g.shrink());
    }
    /// Number of factors.
    #[must_use]
    pub fn factor_count(&self) -> usize {
        self.groups.iter().map(|g| g.len()).sum()
    }
    /// All factors, in the order of their numbers.
    pub fn factors(&self) -> impl Iterator<Item = &dyn Factor> {
        self.groups.iter().flat_map(|g| (0..g.len()).map(move |i| g.factor(i)))
    }
    pub(crate) fn groups(&self) -> &[Box<dyn Group>] {
        &self.groups
    }
    /// Number of residuals.
    #[must_use]
    pub fn residual_count(&self) -> usize {
        let rows =
            |g: &dyn Group| (0..g.len()).filter(|i| !g.is_left_out(*i)).map(|i| g.factor(i).rows()).sum::<usize>();
        self.groups.iter().map(|g| rows(g.as_ref())).sum()
    }
    /// Number of unknowns.
    #[must_use]
    pub fn unknown_count(&self) -> usize {
        self.variables().filter(|v| !self.is_fixed(*v)).map(|v| self.values.kind(v).dimension()).sum()
    }

    /// Sum of squares of the whitened residuals (chi²), ties through the kernel; the same for any number of threads.
    #[must_use]
    pub fn cost(&self, values: &Values, kernel: &Kernel) -> f64 {
        use rayon::prelude::*;
        const CHUNK: usize = 4096;
        let mut sum = 0.0;
        for group in &self.groups {
            let chunks = group.len().div_ceil(CHUNK);
            let part = |c: usize| group.cost(c * CHUNK..((c + 1) * CHUNK).min(group.len()), values, kernel);
            sum += if chunks > 1 {
                (0..chunks).into_par_iter().map(part).collect::<Vec<_>>().iter().sum()
            } else {
                (0..chunks).map(part).sum::<f64>()
            };
        }
        sum
    }
}
