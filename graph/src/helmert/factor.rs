//! Factorisation of the normal equations up the tree, in memory, and solution down the tree.

use super::block::{Equations, Pool, Singular, Update};
use super::front;
use super::tree::Tree;

/// A factorisation in memory.
#[derive(Debug, Default)]
pub struct Factorisation {
    panels: Vec<f64>,
    /// Multiplications of each subtree, for sharing work.
    subtree_flops: Vec<f64>,
}

/// Subtrees with fewer multiplications than this are not shared.
const SHARE_FLOPS: f64 = 2e6;
/// Levels of the tree that are shared at most.
const SHARE_DEPTH: usize = 64;

impl Factorisation {
    /// Factorises and carries the right-hand side along: `right` becomes `L⁻¹ right`.
    ///
    /// # Errors
    /// [`Singular`].
    pub fn factorise(&mut self, equations: &Equations<'_>, right: &mut [f64]) -> Result<(), Singular> {
        let tree = equations.tree;
        self.panels.clear();
        self.panels.resize(tree.panel_numbers(), 0.0);
        self.subtree_flops = subtree_flops(tree);
        let roots: Vec<usize> = tree.roots().collect();
        let (mut panels, mut right) = (self.panels.as_mut_slice(), right);
        let shared = rayon::current_num_threads() > 1;
        let mut pool = Pool::default();
        for root in roots {
            let (numbers, scalars) = extent(tree, root);
            let (p, p_rest) = panels.split_at_mut(numbers);
            let (r, r_rest) = right.split_at_mut(scalars);
            (panels, right) = (p_rest, r_rest);
            if shared {
                share(equations, &self.subtree_flops, root, p, r, 0)?;
            } else {
                in_turn(equations, root, p, r, &mut pool)?;
            }
        }
        Ok(())
    }

    /// Panel of a block.
    #[must_use]
    pub fn panel(&self, tree: &Tree, block: usize) -> &[f64] {
        let b = &tree.blocks[block];
        &self.panels[b.panel_start..b.panel_start + b.panel_len()]
    }

    /// `L⁻ᵀ right`, in place.
    pub fn backward(&self, tree: &Tree, right: &mut [f64]) {
        let mut boundary = Vec::new();
        for index in (0..tree.blocks.len()).rev() {
            backward_block(tree, index, self.panel(tree, index), right, &mut boundary);
        }
    }

    /// Solves for one right-hand side, in place.
    pub fn solve(&self, tree: &Tree, right: &mut [f64]) {
        let mut below = Vec::new();
        for (index, block) in tree.blocks.iter().enumerate() {
            let first = tree.scalar_start[block.first as usize] as usize;
            below.clear();
            below.resize(block.boundary_scalars, 0.0);
            let own = &mut right[first..first + block.own_scalars];
            front::forward(self.panel(tree, index), block.own_scalars, block.boundary_scalars, own, &mut below);
            let mut next = below.iter();
            for q in tree.boundary(index) {
                let start = tree.scalar_start[*q as usize] as usize;
                let count = tree.dimension(*q) as usize;
                right[start..start + count].iter_mut().zip(next.by_ref()).for_each(|(r, b)| *r += b);
            }
        }
        self.backward(tree, right);
    }
}

/// Backward substitution of one block; `boundary` is scratch.
pub fn backward_block(tree: &Tree, index: usize, panel: &[f64], right: &mut [f64], boundary: &mut Vec<f64>) {
    let block = &tree.blocks[index];
    boundary.clear();
    for q in tree.boundary(index) {
        let start = tree.scalar_start[*q as usize] as usize;
        boundary.extend_from_slice(&right[start..start + tree.dimension(*q) as usize]);
    }
    let first = tree.scalar_start[block.first as usize] as usize;
    let own = &mut right[first..first + block.own_scalars];
    front::backward(panel, block.own_scalars, block.boundary_scalars, own, boundary);
}

/// Multiplications of each subtree.
#[allow(clippy::cast_precision_loss)]
fn subtree_flops(tree: &Tree) -> Vec<f64> {
    let mut flops = vec![0.0; tree.blocks.len()];
    for (index, block) in tree.blocks.iter().enumerate() {
        let (k, m) = (block.own_scalars as f64, block.boundary_scalars as f64);
        let below: f64 = tree.children(index).iter().map(|c| flops[*c as usize]).sum();
        flops[index] = below + k * k * k / 3.0 + k * k * m + k * m * m;
    }
    flops
}

/// Numbers of the panels and scalars of a subtree.
fn extent(tree: &Tree, block: usize) -> (usize, usize) {
    let (first, last) = (&tree.blocks[tree.blocks[block].subtree as usize], &tree.blocks[block]);
    let numbers = last.panel_start + last.panel_len() - first.panel_start;
    let scalars = tree.scalar_start[last.end as usize] - tree.scalar_start[first.first as usize];
    (numbers, scalars as usize)
}

/// A subtree on this thread, block after block.
fn in_turn(
    equations: &Equations<'_>,
    root: usize,
    mut panels: &mut [f64],
    mut right: &mut [f64],
    pool: &mut Pool,
) -> Result<Update, Singular> {
    let tree = equations.tree;
    let mut open: Vec<(u32, Update)> = Vec::new();
    for index in tree.blocks[root].subtree as usize..=root {
        let block = &tree.blocks[index];
        let (panel, p_rest) = std::mem::take(&mut panels).split_at_mut(block.panel_len());
        let (own, r_rest) = std::mem::take(&mut right).split_at_mut(block.own_scalars);
        (panels, right) = (p_rest, r_rest);
        let children = open.split_off(open.len() - tree.children(index).len());
        let update = equations.eliminate_block(index, panel, own, &children, pool)?;
        children.into_iter().for_each(|(_, buffer)| pool.give(buffer));
        open.push((u32::try_from(index).unwrap_or(u32::MAX), update));
    }
    Ok(open.pop().map(|o| o.1).unwrap_or_default())
}

/// A subtree, its branches shared among threads.
fn share(
    equations: &Equations<'_>,
    flops: &[f64],
    root: usize,
    panels: &mut [f64],
    right: &mut [f64],
    depth: usize,
) -> Result<Update, Singular> {
    let tree = equations.tree;
    if flops[root] < SHARE_FLOPS || depth > SHARE_DEPTH || tree.children(root).is_empty() {
        return in_turn(equations, root, panels, right, &mut Pool::default());
    }
    let block = &tree.blocks[root];
    let (below, panel) = panels.split_at_mut(panels.len() - block.panel_len());
    let (right_below, own) = right.split_at_mut(right.len() - block.own_scalars);
    let children = share_all(equations, flops, tree.children(root), below, right_below, depth + 1)?;
    equations.eliminate_block(root, panel, own, &children, &mut Pool::default())
}

/// Branches side by side.
fn share_all(
    equations: &Equations<'_>,
    flops: &[f64],
    blocks: &[u32],
    panels: &mut [f64],
    right: &mut [f64],
    depth: usize,
) -> Result<Vec<(u32, Update)>, Singular> {
    if let [block] = blocks {
        return Ok(vec![(*block, share(equations, flops, *block as usize, panels, right, depth)?)]);
    }
    let (first, second) = blocks.split_at(blocks.len() / 2);
    let (mut numbers, mut scalars) = (0, 0);
    for block in first {
        let (n, s) = extent(equations.tree, *block as usize);
        numbers += n;
        scalars += s;
    }
    let (p1, p2) = panels.split_at_mut(numbers);
    let (r1, r2) = right.split_at_mut(scalars);
    let (a, b) = rayon::join(
        || share_all(equations, flops, first, p1, r1, depth),
        || share_all(equations, flops, second, p2, r2, depth),
    );
    // the first failure in the order of elimination, whichever thread was quicker
    let mut all = a?;
    all.extend(b?);
    Ok(all)
}
