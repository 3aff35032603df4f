//! Factors evaluated and added to the normal equations, each to its slots, in their order.

use std::ops::Range;

use rayon::prelude::*;

use super::{CHUNK, Normal, Pattern};
use crate::linear::nodes::NO_NODE;
use crate::problem::{Problem, Sink};
use crate::robust::Kernel;
use crate::variable::{Values, VariableId};

impl Pattern {
    /// Normal equations at the given values.
    pub fn assemble(&self, problem: &Problem, values: &Values, kernel: &Kernel, normal: &mut Normal) {
        normal.numbers.clear();
        normal.numbers.resize(self.numbers(), 0.0);
        normal.right.clear();
        normal.right.resize(self.scalars, 0.0);
        if rayon::current_num_threads() > 1 && problem.factor_count() > 4 * CHUNK {
            return self.assemble_parallel(problem, values, kernel, normal);
        }
        for (group, chunks) in problem.groups().iter().zip(&self.chunk_slots) {
            let mut scatter = Scatter {
                pattern: self,
                numbers: &mut normal.numbers,
                right: &mut normal.right,
                slot: chunks[0],
                positions: 0..NO_NODE,
                first_number: 0,
                first_scalar: 0,
                firsts: Vec::new(),
            };
            group.linearise(0..group.len(), values, kernel, &mut scatter);
        }
    }

    /// Factors evaluated in parallel, then added by as many threads, each to its own positions, in their order.
    fn assemble_parallel(&self, problem: &Problem, values: &Values, kernel: &Kernel, normal: &mut Normal) {
        let parts = rayon::current_num_threads();
        let bounds = self.bounds(parts);
        for (group, chunks) in problem.groups().iter().zip(&self.chunk_slots) {
            let count = chunks.len().saturating_sub(1);
            for batch in (0..count).collect::<Vec<_>>().chunks(32 * parts) {
                let recorded: Vec<Record> = batch
                    .par_iter()
                    .map(|c| {
                        let mut record = Record { slot: chunks[*c], ..Record::default() };
                        let range = c * CHUNK..((c + 1) * CHUNK).min(group.len());
                        group.linearise(range, values, kernel, &mut record);
                        record
                    })
                    .collect();
                let mut pieces = Vec::with_capacity(parts);
                let (mut numbers, mut right) = (normal.numbers.as_mut_slice(), normal.right.as_mut_slice());
                for window in bounds.windows(2) {
                    let (a, b) = (window[0], window[1]);
                    let (n, n_rest) = numbers.split_at_mut(b.1 - a.1);
                    let (r, r_rest) = right.split_at_mut(b.2 - a.2);
                    (numbers, right) = (n_rest, r_rest);
                    pieces.push((a, b, n, r));
                }
                pieces.into_par_iter().for_each(|(a, b, numbers, right)| {
                    let mut scatter = Scatter {
                        pattern: self,
                        numbers,
                        right,
                        slot: 0,
                        positions: a.0..b.0,
                        first_number: a.1,
                        first_scalar: a.2,
                        firsts: Vec::new(),
                    };
                    for record in &recorded {
                        record.replay(&mut scatter);
                    }
                });
            }
        }
    }

    /// Bounds of about equal pieces: position, number, scalar.
    fn bounds(&self, parts: usize) -> Vec<(u32, usize, usize)> {
        let mut bounds = vec![(0, 0, 0)];
        let (mut scalar, total) = (0, self.numbers());
        for p in 0..self.height.len() {
            if bounds.len() < parts && self.start[p] >= bounds.len() * total / parts && p > 0 {
                bounds.push((u32::try_from(p).unwrap_or(u32::MAX), self.start[p], scalar));
            }
            scalar += self.own(u32::try_from(p).unwrap_or(u32::MAX)) as usize;
        }
        bounds.push((NO_NODE, total, self.scalars));
        bounds
    }
}

/// Adds factors to the panels of a range of positions.
struct Scatter<'a> {
    pattern: &'a Pattern,
    numbers: &'a mut [f64],
    right: &'a mut [f64],
    slot: usize,
    positions: Range<u32>,
    first_number: usize,
    first_scalar: usize,
    /// First column of each variable of the factor in hand.
    firsts: Vec<usize>,
}

impl Sink for Scatter<'_> {
    fn take(&mut self, variables: &[VariableId], residual: &[f64], jacobian: &[f64], columns: usize) {
        let pattern = self.pattern;
        let mut firsts = std::mem::take(&mut self.firsts);
        firsts.clear();
        firsts.push(0);
        for v in variables {
            firsts.push(firsts[firsts.len() - 1] + usize::from(pattern.dimension[v.index()]));
        }
        for (i, u) in variables.iter().enumerate() {
            let p = pattern.position[u.index()];
            if p == NO_NODE {
                continue;
            }
            let (cu, du) = (firsts[i], firsts[i + 1] - firsts[i]);
            if self.positions.contains(&p) {
                let first = pattern.scalar[u.index()] as usize - self.first_scalar;
                for c in 0..du {
                    let sum: f64 = residual.iter().enumerate().map(|(r, e)| e * jacobian[r * columns + cu + c]).sum();
                    self.right[first + c] -= sum;
                }
                let rows = pattern.height[p as usize] as usize;
                let corner = pattern.start[p as usize] + usize::from(pattern.offset[u.index()]) * (rows + 1);
                self.add(corner, rows, jacobian, columns, (cu, du), (cu, du));
            }
            for (j, v) in variables.iter().enumerate().take(i) {
                let q = pattern.position[v.index()];
                if q == NO_NODE {
                    continue;
                }
                let (cv, dv) = (firsts[j], firsts[j + 1] - firsts[j]);
                if p == q {
                    if !self.positions.contains(&p) {
                        continue;
                    }
                    let rows = pattern.height[p as usize] as usize;
                    let (ou, ov) = (usize::from(pattern.offset[u.index()]), usize::from(pattern.offset[v.index()]));
                    let (row, column, row_cols, column_cols) =
                        if ou > ov { (ou, ov, (cu, du), (cv, dv)) } else { (ov, ou, (cv, dv), (cu, du)) };
                    let start = pattern.start[p as usize] + column * rows + row;
                    self.add(start, rows, jacobian, columns, row_cols, column_cols);
                } else {
                    let slot = pattern.slots[self.slot] as usize;
                    self.slot += 1;
                    let column = p.min(q);
                    if !self.positions.contains(&column) {
                        continue;
                    }
                    let (row_cols, column_cols) = if p < q { ((cv, dv), (cu, du)) } else { ((cu, du), (cv, dv)) };
                    let rows = pattern.height[column as usize] as usize;
                    self.add(slot, rows, jacobian, columns, row_cols, column_cols);
                }
            }
        }
        self.firsts = firsts;
    }
}

impl Scatter<'_> {
    /// Adds `Jᵣᵀ J_c` at a place of the numbers.
    #[inline]
    fn add(
        &mut self,
        start: usize,
        height: usize,
        jacobian: &[f64],
        columns: usize,
        (row, row_count): (usize, usize),
        (column, column_count): (usize, usize),
    ) {
        let start = start - self.first_number;
        for c in 0..column_count {
            let target = &mut self.numbers[start + c * height..start + c * height + row_count];
            for line in jacobian.chunks_exact(columns) {
                let factor = line[column + c];
                target.iter_mut().zip(&line[row..row + row_count]).for_each(|(t, j)| *t += factor * j);
            }
        }
    }
}

/// Factors evaluated, for later.
#[derive(Debug, Default)]
struct Record {
    slot: usize,
    shapes: Vec<(u32, u32, u32)>,
    variables: Vec<VariableId>,
    numbers: Vec<f64>,
}

impl Sink for Record {
    #[allow(clippy::cast_possible_truncation)] // a factor is small
    fn take(&mut self, variables: &[VariableId], residual: &[f64], jacobian: &[f64], columns: usize) {
        self.shapes.push((variables.len() as u32, residual.len() as u32, columns as u32));
        self.variables.extend_from_slice(variables);
        self.numbers.extend_from_slice(residual);
        self.numbers.extend_from_slice(jacobian);
    }
}

impl Record {
    fn replay(&self, scatter: &mut Scatter<'_>) {
        scatter.slot = self.slot;
        let (mut variables, mut numbers) = (self.variables.as_slice(), self.numbers.as_slice());
        for (count, rows, columns) in &self.shapes {
            let (rows, columns) = (*rows as usize, *columns as usize);
            let (v, v_rest) = variables.split_at(*count as usize);
            let (residual, rest) = numbers.split_at(rows);
            let (jacobian, n_rest) = rest.split_at(rows * columns);
            (variables, numbers) = (v_rest, n_rest);
            scatter.take(v, residual, jacobian, columns);
        }
    }
}
