//! The partition tree from places: recursive bisection at the median, separators by minimum vertex cover.

use super::cover::Cut;
use super::tree::Draft;
use crate::linear::nodes::NodeGraph;

/// How a graph is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PartitionOptions {
    /// Most nodes of a block that is not cut further.
    pub leaf_nodes: usize,
    /// Most levels of cuts.
    pub depth: usize,
}

impl Default for PartitionOptions {
    fn default() -> Self {
        Self { leaf_nodes: 8, depth: usize::MAX }
    }
}

/// Sets with more nodes than this are cut along both of their longest axes, and the smaller separator is taken.
const TRY_BOTH: usize = 48;

struct Partition<'a> {
    graph: &'a NodeGraph,
    places: &'a [[f64; 3]],
    options: PartitionOptions,
    /// Path of the set a node is in, times two, plus the side.
    label: Vec<u32>,
    local: Vec<u32>,
    cut: Cut,
    drafts: Vec<Draft>,
}

/// A separator with its axis.
struct Separator {
    nodes: Vec<u32>,
    axis: usize,
}

/// Blocks, children before parents; the last one is the root.
#[must_use]
pub fn partition(graph: &NodeGraph, places: &[[f64; 3]], options: PartitionOptions) -> Vec<Draft> {
    let count = graph.len();
    let mut nodes: Vec<u32> = (0..u32::try_from(count).unwrap_or(u32::MAX)).collect();
    let globals: Vec<u32> = nodes.iter().copied().filter(|n| graph.global[*n as usize]).collect();
    nodes.retain(|n| !graph.global[*n as usize]);
    let mut work = Partition {
        graph,
        places,
        options,
        label: vec![0; count],
        local: vec![0; count],
        cut: Cut::default(),
        drafts: Vec::new(),
    };
    let root = work.split(&mut nodes, 1, 0);
    work.drafts[root].own.extend(globals);
    work.drafts
}

impl Partition<'_> {
    /// Cuts a set; returns the index of its block.
    fn split(&mut self, nodes: &mut [u32], path: u32, level: usize) -> usize {
        if nodes.len() <= self.options.leaf_nodes.max(1) || level >= self.options.depth || path >= 1 << 29 {
            return self.emit(nodes.to_vec(), &[]);
        }
        let axes = self.axes(nodes);
        let mut separator = self.separate(nodes, axes[0], path);
        if nodes.len() > TRY_BOTH {
            let other = self.separate(nodes, axes[1], path);
            if other.nodes.len() < separator.nodes.len() {
                separator = other;
            } else {
                self.bisect(nodes, axes[0], path);
            }
        }
        for node in &separator.nodes {
            self.label[*node as usize] = 0;
        }
        let mut left: Vec<u32> = Vec::with_capacity(nodes.len() / 2 + 1);
        let mut right: Vec<u32> = Vec::with_capacity(nodes.len() / 2 + 1);
        for node in nodes.iter() {
            match self.label[*node as usize] {
                0 => {}
                l if l & 1 == 0 => left.push(*node),
                _ => right.push(*node),
            }
        }
        // along the separator, so that boundaries below it are runs
        let across = if separator.axis == axes[0] { axes[1] } else { axes[0] };
        let places = self.places;
        separator.nodes.sort_unstable_by(|a, b| {
            places[*a as usize][across].total_cmp(&places[*b as usize][across]).then(a.cmp(b))
        });
        let mut children = Vec::with_capacity(2);
        for (side, mut set) in [(0, left), (1, right)] {
            if !set.is_empty() {
                children.push(self.split(&mut set, 2 * path + side, level + 1));
            }
        }
        self.emit(separator.nodes, &children)
    }

    fn emit(&mut self, own: Vec<u32>, children: &[usize]) -> usize {
        let index = self.drafts.len();
        for child in children {
            self.drafts[*child].parent = Some(index);
        }
        self.drafts.push(Draft { own, parent: None });
        index
    }

    /// Axes by falling extent.
    fn axes(&self, nodes: &[u32]) -> [usize; 3] {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for node in nodes {
            let place = &self.places[*node as usize];
            for k in 0..3 {
                low[k] = low[k].min(place[k]);
                high[k] = high[k].max(place[k]);
            }
        }
        let mut axes = [0, 1, 2];
        axes.sort_by(|a, b| (high[*b] - low[*b]).total_cmp(&(high[*a] - low[*a])));
        axes
    }

    /// Labels the two halves of a set; the first `half` nodes are the lower ones.
    fn bisect(&mut self, nodes: &mut [u32], axis: usize, path: u32) -> usize {
        let half = nodes.len() / 2;
        let places = self.places;
        nodes.select_nth_unstable_by(half, |a, b| {
            places[*a as usize][axis].total_cmp(&places[*b as usize][axis]).then(a.cmp(b))
        });
        for (k, node) in nodes.iter().enumerate() {
            self.label[*node as usize] = 2 * path + u32::from(k >= half);
        }
        half
    }

    #[allow(clippy::cast_possible_truncation)] // nodes are counted in u32
    fn separate(&mut self, nodes: &mut [u32], axis: usize, path: u32) -> Separator {
        let half = self.bisect(nodes, axis, path);
        let other = 2 * path + 1;
        let (mut lefts, mut rights, mut edges) = (Vec::new(), Vec::new(), Vec::new());
        for node in &nodes[half..] {
            self.local[*node as usize] = u32::MAX;
        }
        for node in &nodes[..half] {
            let mut touches = false;
            for neighbour in self.graph.of(*node) {
                if self.label[*neighbour as usize] == other {
                    if !touches {
                        touches = true;
                        lefts.push(*node);
                    }
                    let local = &mut self.local[*neighbour as usize];
                    if *local == u32::MAX {
                        *local = rights.len() as u32;
                        rights.push(*neighbour);
                    }
                    edges.push((lefts.len() as u32 - 1, *local));
                }
            }
        }
        let (in_left, in_right) = self.cut.cover(lefts.len(), rights.len(), &edges);
        let mut separator: Vec<u32> = Vec::new();
        separator.extend(lefts.iter().zip(&in_left).filter(|(_, c)| **c).map(|(n, _)| *n));
        separator.extend(rights.iter().zip(&in_right).filter(|(_, c)| **c).map(|(n, _)| *n));
        Separator { nodes: separator, axis }
    }
}
