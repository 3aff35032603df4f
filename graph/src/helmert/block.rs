//! One block of the tree: its front gathered from the normal equations and from the blocks below, eliminated, and what
//! it hands up.

use super::front::{self, eliminate};
use super::tree::Tree;
use crate::linear::blocks::Pattern;

/// A pivot below this share of its diagonal says that the observations do not determine the unknown.
pub const WEAK_PIVOT: f64 = 1e-13;

/// An unknown that the observations do not determine: its place in the order of elimination.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
#[error("the normal equations are singular at unknown {scalar} of the elimination")]
pub struct Singular {
    /// Scalar in the order of elimination.
    pub scalar: usize,
}

/// What a block hands to the block above: square of the boundary (lower triangle, column by column; packed where it is
/// large), then its right-hand side.
pub type Update = Vec<f64>;

/// Boundaries with more scalars than this are handed up packed: many of them wait at a time.
pub(super) const PACKED_FROM: usize = 192;

/// Where column `c` of an update would begin with its row 0.
#[inline]
pub(super) fn column_base(count: usize, c: usize) -> usize {
    if count > PACKED_FROM { c * count - c * (c + 1) / 2 } else { c * count }
}
/// Where the right-hand side of an update begins.
#[inline]
pub(super) fn right_start(count: usize) -> usize {
    if count > PACKED_FROM { count * (count + 1) / 2 } else { count * count }
}

/// Longest buffer that is kept for use again.
const LARGEST_KEPT: usize = 1 << 15;

/// Buffers to be used again, by size.
#[derive(Debug, Default)]
pub struct Pool {
    by_size: Vec<Vec<Update>>,
}

impl Pool {
    fn class(len: usize) -> usize {
        // quarters of powers of two
        let power = usize::BITS - len.max(64).leading_zeros();
        let quarter = (len.max(64) >> (power - 3)) & 3;
        power as usize * 4 + quarter
    }
    /// Zeros of a length.
    pub fn take(&mut self, len: usize) -> Update {
        let class = Self::class(len);
        let mut buffer = self.by_size.get_mut(class).and_then(Vec::pop).unwrap_or_default();
        buffer.clear();
        buffer.resize(len, 0.0);
        buffer
    }
    /// Takes a buffer back.
    pub fn give(&mut self, buffer: Update) {
        // large ones go back to the system: kept, they would double the memory that is needed at once
        if buffer.is_empty() || buffer.len() > LARGEST_KEPT {
            return;
        }
        let class = Self::class(buffer.len());
        if self.by_size.len() <= class {
            self.by_size.resize_with(class + 1, Vec::new);
        }
        self.by_size[class].push(buffer);
    }
}

/// Normal equations, their pattern and tree: what every block is made from.
#[derive(Debug, Clone, Copy)]
pub struct Equations<'a> {
    /// Blocks.
    pub tree: &'a Tree,
    /// Pattern of the normal equations.
    pub pattern: &'a Pattern,
    /// Their numbers.
    pub numbers: &'a [f64],
}

impl Equations<'_> {
    /// Eliminates one block: fills its panel (zeros at first) and its own right-hand side, returns what goes up.
    ///
    /// # Errors
    /// [`Singular`].
    pub fn eliminate_block(
        &self,
        index: usize,
        panel: &mut [f64],
        own_right: &mut [f64],
        children: &[(u32, Update)],
        pool: &mut Pool,
    ) -> Result<Update, Singular> {
        let mut work = self.open_block(index, panel, own_right, pool);
        for (child, from) in children {
            self.add_child(&mut work, *child as usize, from);
        }
        self.close_block(work, pool)
    }

    /// A block's front with its own observations in it.
    pub(super) fn open_block<'w>(
        &self,
        index: usize,
        panel: &'w mut [f64],
        own_right: &'w mut [f64],
        pool: &mut Pool,
    ) -> Work<'w> {
        let block = &self.tree.blocks[index];
        let (own, boundary) = (block.own_scalars, block.boundary_scalars);
        let update = pool.take(right_start(boundary) + boundary);
        let top = pool.take(own * own);
        let offsets = self.tree.boundary_offsets(index);
        let mut work = Work { index, panel, own_right, update, top, offsets, own, boundary };
        self.gather(&mut work);
        work
    }

    /// Adds what a block below hands up.
    pub(super) fn add_child(&self, work: &mut Work<'_>, child: usize, from: &[f64]) {
        let runs = self.runs(child, work.index, &work.offsets);
        let count = self.tree.blocks[child].boundary_scalars;
        work.extend_add(from, count, &runs);
        let tail = &from[right_start(count)..];
        let right = &mut work.update[right_start(work.boundary)..];
        for (start, len, to) in &runs {
            for k in 0..*len {
                let (value, row) = (tail[start + k], to + k);
                if row < work.own { work.own_right[row] += value } else { right[row - work.own] += value }
            }
        }
    }

    /// Eliminates the own scalars of a front; what goes up.
    pub(super) fn close_block(&self, work: Work<'_>, pool: &mut Pool) -> Result<Update, Singular> {
        let Work { index, panel, own_right, mut update, mut top, own, boundary, .. } = work;
        let (packed, low) = panel.split_at_mut(front::triangle(own));
        let (square, right) = update.split_at_mut(right_start(boundary));
        let first = self.tree.scalar_start[self.tree.blocks[index].first as usize] as usize;
        eliminate(&mut top, low, square, own, boundary).map_err(|j| Singular { scalar: first + j })?;
        self.check_pivots(index, &top)?;
        front::pack(&top, own, packed);
        pool.give(top);
        front::forward(panel, own, boundary, own_right, right);
        Ok(update)
    }

    /// Brings the normal equations' panels of the own positions into the front.
    fn gather(&self, work: &mut Work<'_>) {
        let (tree, index) = (self.tree, work.index);
        let block = &tree.blocks[index];
        let first_scalar = tree.scalar_start[block.first as usize];
        let boundary = tree.boundary(index);
        let mut places: Vec<(u32, u32)> = Vec::new();
        for p in block.first..block.end {
            let own = tree.dimension(p) as usize;
            let at = (tree.scalar_start[p as usize] - first_scalar) as usize;
            let (range, height) = self.pattern.panel(p);
            let source = &self.numbers[range];
            places.clear();
            let mut cursor = 0;
            for q in self.pattern.later(p) {
                let local = if *q < block.end {
                    tree.scalar_start[*q as usize] - first_scalar
                } else {
                    cursor += boundary[cursor..].partition_point(|b| b < q);
                    work.offsets[cursor]
                };
                places.push((local, tree.dimension(*q)));
            }
            for c in 0..own {
                let from = &source[c * height..(c + 1) * height];
                let k = work.own;
                let (top, low) = work.own_column(at + c);
                top[at + c..at + own].copy_from_slice(&from[c..own]);
                let mut next = own;
                for (local, count) in &places {
                    let (local, count) = (*local as usize, *count as usize);
                    let to =
                        if local < k { &mut top[local..local + count] } else { &mut low[local - k..local - k + count] };
                    to.copy_from_slice(&from[next..next + count]);
                    next += count;
                }
            }
        }
    }

    /// Pieces of a child's boundary that are in one piece in the front above: start, length, local start.
    fn runs(&self, child: usize, parent: usize, offsets: &[u32]) -> Vec<(usize, usize, usize)> {
        let tree = self.tree;
        let block = &tree.blocks[parent];
        let first_scalar = tree.scalar_start[block.first as usize];
        let boundary = tree.boundary(parent);
        let (mut cursor, mut at) = (0, 0);
        let mut runs: Vec<(usize, usize, usize)> = Vec::new();
        for q in tree.boundary(child) {
            let local = if *q < block.end {
                tree.scalar_start[*q as usize] - first_scalar
            } else {
                while boundary[cursor] < *q {
                    cursor += 1;
                }
                offsets[cursor]
            } as usize;
            let count = tree.dimension(*q) as usize;
            match runs.last_mut() {
                Some((_, len, to)) if *to + *len == local && local != block.own_scalars => *len += count,
                _ => runs.push((at, count, local)),
            }
            at += count;
        }
        runs
    }

    /// Whether every pivot is worth something beside its diagonal.
    fn check_pivots(&self, index: usize, top: &[f64]) -> Result<(), Singular> {
        let block = &self.tree.blocks[index];
        let own = block.own_scalars;
        let first = self.tree.scalar_start[block.first as usize] as usize;
        let mut j = 0;
        for p in block.first..block.end {
            let (range, height) = self.pattern.panel(p);
            for c in 0..self.tree.dimension(p) as usize {
                let pivot = top[j * (own + 1)];
                if pivot * pivot <= WEAK_PIVOT * self.numbers[range.start + c * (height + 1)] {
                    return Err(Singular { scalar: first + j });
                }
                j += 1;
            }
        }
        Ok(())
    }
}

/// A front that is being worked on, see [`front`].
pub(super) struct Work<'a> {
    index: usize,
    panel: &'a mut [f64],
    own_right: &'a mut [f64],
    update: Update,
    top: Vec<f64>,
    offsets: Vec<u32>,
    own: usize,
    boundary: usize,
}

impl Work<'_> {
    /// An own column: its rows in the own square and below.
    fn own_column(&mut self, column: usize) -> (&mut [f64], &mut [f64]) {
        let (k, m) = (self.own, self.boundary);
        let low = &mut self.panel[front::triangle(k)..];
        (&mut self.top[column * k..(column + 1) * k], &mut low[column * m..(column + 1) * m])
    }

    /// Adds a child's square. No run goes over the end of the own scalars: nodes are in one piece.
    fn extend_add(&mut self, from: &[f64], count: usize, runs: &[(usize, usize, usize)]) {
        let (own, boundary) = (self.own, self.boundary);
        for (k, (start, len, to)) in runs.iter().enumerate() {
            for c in 0..*len {
                let column = to + c;
                let source = &from[column_base(count, start + c)..];
                if column < own {
                    let (top, low) = self.own_column(column);
                    for (s, n, t) in std::iter::once(&(start + c, len - c, to + c)).chain(&runs[k + 1..]) {
                        let target = if *t < own { &mut top[*t..t + n] } else { &mut low[t - own..t - own + n] };
                        target.iter_mut().zip(&source[*s..s + n]).for_each(|(a, b)| *a += b);
                    }
                } else {
                    let target = &mut self.update[column_base(boundary, column - own)..];
                    for (s, n, t) in std::iter::once(&(start + c, len - c, to + c)).chain(&runs[k + 1..]) {
                        let target = &mut target[t - own..t - own + n];
                        target.iter_mut().zip(&source[*s..s + n]).for_each(|(a, b)| *a += b);
                    }
                }
            }
        }
    }
}
