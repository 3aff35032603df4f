//! Block normal equations: the pattern once, then scatter by slot.
//!
//! A position of the elimination has a panel: its diagonal block and the blocks of later positions that share a
//! factor with it, side by side in one column-major piece. A factor's blocks go to slots found beforehand, in the
//! order of the factors, whatever the number of threads.

mod scatter;

use std::ops::Range;

use super::nodes::{NO_NODE, NodeGraph};
use crate::helmert::tree::Tree;
use crate::problem::Problem;
use crate::variable::VariableId;

/// Where factors' blocks go.
#[derive(Debug, Clone)]
pub struct Pattern {
    /// Position of each variable's node, [`NO_NODE`] when it is held.
    position: Vec<u32>,
    offset: Vec<u16>,
    dimension: Vec<u8>,
    /// First scalar of each variable in the order of elimination.
    pub scalar: Vec<u32>,
    /// Start of each position's panel in the numbers; one more at the end.
    start: Vec<usize>,
    /// Scalars of each position and of the later ones in its panel.
    height: Vec<u32>,
    /// Start of each position's later positions; one more at the end.
    later_start: Vec<u32>,
    /// Later positions of each panel, sorted.
    later: Vec<u32>,
    /// Slots of the blocks between different nodes, factor by factor.
    slots: Vec<u32>,
    /// Start of the slots of every group of factors, and of every chunk inside.
    chunk_slots: Vec<Vec<usize>>,
    scalars: usize,
}

/// Normal equations: numbers of the panels and right-hand side, in the order of elimination.
#[derive(Debug, Clone, Default)]
pub struct Normal {
    /// Panels.
    pub numbers: Vec<f64>,
    /// Minus the gradient's half: `-Jᵀ r`.
    pub right: Vec<f64>,
}

/// Too many numbers for the slots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the normal equations of {numbers} numbers are larger than 2^32; split the net")]
pub struct TooLarge {
    /// Numbers in the normal equations.
    pub numbers: usize,
}

/// Factors evaluated at once.
const CHUNK: usize = 512;

impl Pattern {
    /// The pattern of a problem in the order of a tree.
    ///
    /// # Errors
    /// [`TooLarge`].
    #[allow(clippy::cast_possible_truncation)] // counted in u32, checked at the end
    pub fn new(problem: &Problem, graph: &NodeGraph, tree: &Tree) -> Result<Self, TooLarge> {
        let mut pattern = Self::of_graph(graph, tree)?;
        pattern.dimension = problem.variables().map(|v| problem.values.kind(v).dimension() as u8).collect();
        let mut positions: Vec<u32> = Vec::new();
        for group in problem.groups() {
            let mut chunks = Vec::with_capacity(group.len() / CHUNK + 2);
            for index in 0..group.len() {
                if index % CHUNK == 0 {
                    chunks.push(pattern.slots.len());
                }
                if group.is_left_out(index) {
                    continue;
                }
                let variables = group.factor(index).variables();
                positions.clear();
                positions.extend(variables.iter().map(|v| pattern.position[v.index()]));
                for (i, u) in variables.iter().enumerate() {
                    for (j, v) in variables.iter().enumerate().take(i) {
                        let (p, q) = (positions[i], positions[j]);
                        if p == NO_NODE || q == NO_NODE || p == q {
                            continue;
                        }
                        let (column, row) = if p < q { (u, v) } else { (v, u) };
                        let slot = pattern.slot(*column, *row);
                        pattern.slots.push(slot);
                    }
                }
            }
            chunks.push(pattern.slots.len());
            pattern.chunk_slots.push(chunks);
        }
        Ok(pattern)
    }

    /// The pattern without slots.
    ///
    /// # Errors
    /// [`TooLarge`].
    #[allow(clippy::cast_possible_truncation)]
    pub fn of_graph(graph: &NodeGraph, tree: &Tree) -> Result<Self, TooLarge> {
        let count = tree.order.len();
        let (mut start, mut height) = (Vec::with_capacity(count + 1), Vec::with_capacity(count));
        let (mut later_start, mut later) = (vec![0_u32], Vec::with_capacity(graph.neighbours.len() / 2));
        let mut numbers = 0_usize;
        for (p, node) in tree.order.iter().enumerate() {
            let begin = later.len();
            later.extend(graph.of(*node).iter().map(|n| tree.position[*n as usize]).filter(|q| *q > p as u32));
            later[begin..].sort_unstable();
            let own = tree.dimension(p as u32);
            let rows = own + later[begin..].iter().map(|q| tree.dimension(*q)).sum::<u32>();
            later_start.push(later.len() as u32);
            start.push(numbers);
            height.push(rows);
            numbers += (rows * own) as usize;
        }
        start.push(numbers);
        if numbers >= u32::MAX as usize {
            return Err(TooLarge { numbers });
        }
        let position: Vec<u32> =
            graph.node_of.iter().map(|n| if *n == NO_NODE { NO_NODE } else { tree.position[*n as usize] }).collect();
        let scalar = position
            .iter()
            .zip(&graph.offset_of)
            .map(|(p, o)| if *p == NO_NODE { NO_NODE } else { tree.scalar_start[*p as usize] + u32::from(*o) })
            .collect();
        Ok(Self {
            position,
            offset: graph.offset_of.clone(),
            dimension: Vec::new(),
            scalar,
            start,
            height,
            later_start,
            later,
            slots: Vec::new(),
            chunk_slots: Vec::new(),
            scalars: tree.scalars(),
        })
    }

    /// Later positions that share a factor with a position.
    #[must_use]
    #[inline]
    pub fn later(&self, position: u32) -> &[u32] {
        &self.later[self.later_start[position as usize] as usize..self.later_start[position as usize + 1] as usize]
    }
    /// Panel of a position inside the numbers, and its height.
    #[must_use]
    #[inline]
    pub fn panel(&self, position: u32) -> (Range<usize>, usize) {
        let p = position as usize;
        (self.start[p]..self.start[p + 1], self.height[p] as usize)
    }
    /// Numbers in all panels.
    #[must_use]
    pub fn numbers(&self) -> usize {
        self.start.last().copied().unwrap_or(0)
    }
    /// Unknowns.
    #[must_use]
    pub fn scalars(&self) -> usize {
        self.scalars
    }
    /// Position of a variable's node, [`NO_NODE`] when it is held.
    #[must_use]
    pub fn position(&self, id: VariableId) -> u32 {
        self.position[id.index()]
    }

    /// Start of the block (row variable, column variable) of different nodes in the numbers.
    #[allow(clippy::cast_possible_truncation)]
    fn slot(&self, column: VariableId, row: VariableId) -> u32 {
        let (p, q) = (self.position[column.index()], self.position[row.index()]);
        let later = self.later(p);
        let k = later.partition_point(|other| *other < q);
        // scalars of the later positions up to this one
        let mut height = self.own(p);
        for other in &later[..k] {
            height += self.own(*other);
        }
        let rows = self.height[p as usize] as usize;
        let start = self.start[p as usize]
            + usize::from(self.offset[column.index()]) * rows
            + height as usize
            + usize::from(self.offset[row.index()]);
        start as u32
    }

    /// Scalars of a position.
    #[inline]
    fn own(&self, position: u32) -> u32 {
        let p = position as usize;
        let numbers = self.start[p + 1] - self.start[p];
        u32::try_from(numbers).unwrap_or(u32::MAX).checked_div(self.height[p]).unwrap_or(0)
    }

    /// Diagonal of the normal matrix.
    #[must_use]
    pub fn diagonal(&self, numbers: &[f64]) -> Vec<f64> {
        let mut diagonal = Vec::with_capacity(self.scalars);
        for p in 0..self.height.len() {
            let rows = self.height[p] as usize;
            let own = (self.start[p + 1] - self.start[p]) / rows.max(1);
            diagonal.extend((0..own).map(|k| numbers[self.start[p] + k * (rows + 1)]));
        }
        diagonal
    }
    /// Adds to the diagonal of the normal matrix.
    pub fn add_to_diagonal(&self, numbers: &mut [f64], addition: &[f64]) {
        let mut next = addition.iter();
        for p in 0..self.height.len() {
            let rows = self.height[p] as usize;
            let own = (self.start[p + 1] - self.start[p]) / rows.max(1);
            for (k, value) in (0..own).zip(next.by_ref()) {
                numbers[self.start[p] + k * (rows + 1)] += value;
            }
        }
    }

    /// Sets the diagonal of the normal matrix.
    pub fn set_diagonal(&self, numbers: &mut [f64], diagonal: &[f64]) {
        let mut next = diagonal.iter();
        for p in 0..self.height.len() {
            let rows = self.height[p] as usize;
            let own = (self.start[p + 1] - self.start[p]) / rows.max(1);
            for (k, value) in (0..own).zip(next.by_ref()) {
                numbers[self.start[p] + k * (rows + 1)] = *value;
            }
        }
    }

    /// Product of the normal matrix and a vector, both in the order of elimination.
    #[must_use]
    pub fn multiply(&self, numbers: &[f64], vector: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; self.scalars];
        self.each(numbers, |row, column, value| product[row] += value * vector[column]);
        product
    }

    /// `right` less the product of the normal matrix and a vector, summed in twice the precision (Dekker 1971).
    #[must_use]
    pub fn misclosure(&self, numbers: &[f64], right: &[f64], vector: &[f64]) -> Vec<f64> {
        let mut sums: Vec<(f64, f64)> = right.iter().map(|r| (*r, 0.0)).collect();
        self.each(numbers, |row, column, value| {
            let product = -value * vector[column];
            let product_error = (-value).mul_add(vector[column], -product);
            let (sum, small) = sums[row];
            let next = sum + product;
            let back = next - sum;
            let sum_error = (sum - (next - back)) + (product - back);
            sums[row] = (next, small + sum_error + product_error);
        });
        sums.iter().map(|(sum, small)| sum + small).collect()
    }

    /// Hands every number of the whole matrix over: row, column, value.
    pub(crate) fn each(&self, numbers: &[f64], mut take: impl FnMut(usize, usize, f64)) {
        let mut first = 0;
        let starts: Vec<usize> = (0..self.height.len())
            .map(|p| {
                let here = first;
                first += self.own(u32::try_from(p).unwrap_or(u32::MAX)) as usize;
                here
            })
            .collect();
        let mut rows_of = Vec::new();
        for p in 0..self.height.len() {
            let position = u32::try_from(p).unwrap_or(u32::MAX);
            let (range, rows) = self.panel(position);
            let own = self.own(position) as usize;
            rows_of.clear();
            rows_of.extend(starts[p]..starts[p] + own);
            for q in self.later(position) {
                rows_of.extend(starts[*q as usize]..starts[*q as usize] + self.own(*q) as usize);
            }
            for (c, column) in numbers[range].chunks_exact(rows).enumerate() {
                let at = starts[p] + c;
                for (r, value) in column.iter().enumerate().skip(c) {
                    take(rows_of[r], at, *value);
                    if r != c {
                        take(at, rows_of[r], *value);
                    }
                }
            }
        }
    }
}
