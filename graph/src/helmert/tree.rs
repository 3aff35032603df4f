//! The tree of blocks: order of elimination, own nodes, boundaries.

use crate::linear::nodes::NodeGraph;

/// A block before it has its place in the order.
#[derive(Debug, Clone, Default)]
pub struct Draft {
    /// Nodes that it eliminates.
    pub own: Vec<u32>,
    /// The block above.
    pub parent: Option<usize>,
}

/// One block of the tree.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    /// First position of its own nodes.
    pub first: u32,
    /// Position after its own nodes.
    pub end: u32,
    /// The block above, [`NONE`] for a root.
    pub parent: u32,
    /// First block of its subtree.
    pub subtree: u32,
    /// Range of its boundary in [`Tree::boundary`].
    boundary: (usize, usize),
    /// Its own scalars.
    pub own_scalars: usize,
    /// Scalars of its boundary.
    pub boundary_scalars: usize,
    /// Start of its panel, in numbers.
    pub panel_start: usize,
}

/// No block.
pub const NONE: u32 = u32::MAX;

impl Block {
    /// Scalars in the front: own and boundary.
    #[must_use]
    pub fn scalars(&self) -> usize {
        self.own_scalars + self.boundary_scalars
    }
    /// Numbers in the panel: packed triangle, and what is below.
    #[must_use]
    pub fn panel_len(&self) -> usize {
        self.own_scalars * (self.own_scalars + 1) / 2 + self.own_scalars * self.boundary_scalars
    }
}

/// The tree of blocks, children before parents.
#[derive(Debug, Clone)]
pub struct Tree {
    /// Node at each position of the elimination.
    pub order: Vec<u32>,
    /// Position of each node.
    pub position: Vec<u32>,
    /// First scalar of each position; one more at the end.
    pub scalar_start: Vec<u32>,
    /// Blocks, children before parents.
    pub blocks: Vec<Block>,
    boundary: Vec<u32>,
    child_starts: Vec<u32>,
    children: Vec<u32>,
}

impl Tree {
    /// Puts blocks in order and finds their boundaries.
    #[must_use]
    #[allow(clippy::cast_possible_truncation)] // nodes and scalars are counted in u32
    pub fn new(graph: &NodeGraph, drafts: &[Draft]) -> Self {
        let sequence = post_order(drafts);
        let mut place = vec![NONE; drafts.len()];
        for (new, old) in sequence.iter().enumerate() {
            place[*old] = new as u32;
        }
        let count = graph.len();
        let mut order = Vec::with_capacity(count);
        let mut position = vec![NONE; count];
        let mut scalar_start = Vec::with_capacity(count + 1);
        let mut scalars = 0_u32;
        let mut blocks: Vec<Block> = Vec::with_capacity(drafts.len());
        for (new, old) in sequence.iter().enumerate() {
            let draft = &drafts[*old];
            let (first, start) = (order.len() as u32, scalars);
            for node in &draft.own {
                position[*node as usize] = order.len() as u32;
                order.push(*node);
                scalar_start.push(scalars);
                scalars += u32::from(graph.dimensions[*node as usize]);
            }
            blocks.push(Block {
                first,
                end: order.len() as u32,
                parent: draft.parent.map_or(NONE, |p| place[p]),
                subtree: new as u32,
                boundary: (0, 0),
                own_scalars: (scalars - start) as usize,
                boundary_scalars: 0,
                panel_start: 0,
            });
        }
        scalar_start.push(scalars);
        let (child_starts, children) = children(&blocks);
        let mut tree = Self { order, position, scalar_start, blocks, boundary: Vec::new(), child_starts, children };
        tree.find_boundaries(graph);
        tree
    }

    #[allow(clippy::cast_possible_truncation)]
    fn find_boundaries(&mut self, graph: &NodeGraph) {
        let mut mark = vec![NONE; self.order.len()];
        let mut panel = 0;
        for index in 0..self.blocks.len() {
            let (first, end) = (self.blocks[index].first, self.blocks[index].end);
            let start = self.boundary.len();
            let mut subtree = index as u32;
            for p in first..end {
                for other in graph.of(self.order[p as usize]) {
                    let q = self.position[*other as usize];
                    if q >= end && mark[q as usize] != index as u32 {
                        mark[q as usize] = index as u32;
                        self.boundary.push(q);
                    }
                }
            }
            for c in self.child_starts[index]..self.child_starts[index + 1] {
                let child = self.blocks[self.children[c as usize] as usize];
                subtree = subtree.min(child.subtree);
                for k in child.boundary.0..child.boundary.1 {
                    let q = self.boundary[k];
                    if q >= end && mark[q as usize] != index as u32 {
                        mark[q as usize] = index as u32;
                        self.boundary.push(q);
                    }
                }
            }
            self.boundary[start..].sort_unstable();
            let scalars: u32 = self.boundary[start..].iter().map(|q| self.dimension(*q)).sum();
            let block = &mut self.blocks[index];
            block.subtree = subtree;
            block.boundary = (start, self.boundary.len());
            block.boundary_scalars = scalars as usize;
            block.panel_start = panel;
            panel += block.panel_len();
        }
        self.boundary.shrink_to_fit();
    }

    /// Scalars of the node at a position.
    #[must_use]
    #[inline]
    pub fn dimension(&self, position: u32) -> u32 {
        self.scalar_start[position as usize + 1] - self.scalar_start[position as usize]
    }
    /// Scalars in all.
    #[must_use]
    pub fn scalars(&self) -> usize {
        self.scalar_start.last().map_or(0, |s| *s as usize)
    }
    /// Positions on the boundary of a block, sorted.
    #[must_use]
    pub fn boundary(&self, block: usize) -> &[u32] {
        let (start, end) = self.blocks[block].boundary;
        &self.boundary[start..end]
    }
    /// Blocks right below a block.
    #[must_use]
    pub fn children(&self, block: usize) -> &[u32] {
        &self.children[self.child_starts[block] as usize..self.child_starts[block + 1] as usize]
    }
    /// Roots of the forest.
    pub fn roots(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.blocks.len()).filter(|b| self.blocks[*b].parent == NONE)
    }
    /// Numbers in all panels.
    #[must_use]
    pub fn panel_numbers(&self) -> usize {
        self.blocks.last().map_or(0, |b| b.panel_start + b.panel_len())
    }
    /// Multiplications and additions of the factorisation.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn flops(&self) -> f64 {
        self.blocks
            .iter()
            .map(|b| {
                let (k, m) = (b.own_scalars as f64, b.boundary_scalars as f64);
                k * k * k / 3.0 + k * k * m + k * m * m
            })
            .sum()
    }
    /// Block that eliminates the node at a position.
    #[must_use]
    pub fn block_of(&self, position: u32) -> usize {
        self.blocks.partition_point(|b| b.end <= position)
    }
    /// First scalar of a position on the boundary of a block, counted from the first of its own.
    #[must_use]
    pub fn boundary_offsets(&self, block: usize) -> Vec<u32> {
        let mut next = u32::try_from(self.blocks[block].own_scalars).unwrap_or(u32::MAX);
        self.boundary(block)
            .iter()
            .map(|q| {
                let here = next;
                next += self.dimension(*q);
                here
            })
            .collect()
    }
}

#[allow(clippy::cast_possible_truncation)]
fn children(blocks: &[Block]) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0_u32; blocks.len() + 1];
    for block in blocks.iter().filter(|b| b.parent != NONE) {
        starts[block.parent as usize + 1] += 1;
    }
    for k in 0..blocks.len() {
        starts[k + 1] += starts[k];
    }
    let mut next = starts.clone();
    let mut list = vec![0; starts[blocks.len()] as usize];
    for (index, block) in blocks.iter().enumerate().filter(|(_, b)| b.parent != NONE) {
        let slot = &mut next[block.parent as usize];
        list[*slot as usize] = index as u32;
        *slot += 1;
    }
    (starts, list)
}

/// Blocks with children before parents and every subtree in one piece.
fn post_order(drafts: &[Draft]) -> Vec<usize> {
    let mut below: Vec<Vec<usize>> = vec![Vec::new(); drafts.len()];
    let mut stack: Vec<(usize, usize)> = Vec::new();
    for (index, draft) in drafts.iter().enumerate() {
        if let Some(parent) = draft.parent {
            below[parent].push(index);
        }
    }
    let mut sequence = Vec::with_capacity(drafts.len());
    for root in (0..drafts.len()).filter(|d| drafts[*d].parent.is_none()) {
        stack.push((root, 0));
        while let Some((block, next)) = stack.pop() {
            if let Some(child) = below[block].get(next) {
                stack.push((block, next + 1));
                stack.push((*child, 0));
            } else {
                sequence.push(block);
            }
        }
    }
    sequence
}
