//! Nodes: variables that are eliminated together, and which of them share a factor.

use crate::problem::Problem;
use crate::variable::VariableId;

/// No node: the variable is held.
pub const NO_NODE: u32 = u32::MAX;

/// The graph of nodes of a problem.
#[derive(Debug, Clone)]
pub struct NodeGraph {
    /// Node of each variable, [`NO_NODE`] for held ones.
    pub node_of: Vec<u32>,
    /// Place of a variable's first scalar inside its node.
    pub offset_of: Vec<u16>,
    /// Scalars of each node.
    pub dimensions: Vec<u16>,
    /// First variable of each node.
    pub first_variable: Vec<u32>,
    /// Whether the node goes into the last block.
    pub global: Vec<bool>,
    /// Start of each node's neighbours; one more at the end.
    pub starts: Vec<u32>,
    /// Neighbours, sorted.
    pub neighbours: Vec<u32>,
}

impl NodeGraph {
    /// The graph of a problem's variables that are not held.
    #[must_use]
    #[allow(clippy::cast_possible_truncation)] // variables are counted in u32, and a node has few scalars
    pub fn new(problem: &Problem) -> Self {
        let count = problem.values.len();
        let (mut node_of, mut offset_of) = (vec![NO_NODE; count], vec![0_u16; count]);
        let (mut dimensions, mut first_variable, mut global) = (Vec::<u16>::new(), Vec::new(), Vec::new());
        let mut node_of_host = vec![NO_NODE; count];
        for id in problem.variables().filter(|id| !problem.is_fixed(*id)) {
            let host = problem.host(id).index();
            if node_of_host[host] == NO_NODE {
                node_of_host[host] = dimensions.len() as u32;
                dimensions.push(0);
                first_variable.push(id.0);
                global.push(problem.is_global(id));
            }
            let node = node_of_host[host] as usize;
            node_of[id.index()] = node as u32;
            offset_of[id.index()] = dimensions[node];
            dimensions[node] += problem.values.kind(id).dimension() as u16;
        }
        let pairs = pairs(problem, &node_of);
        let (starts, neighbours) = neighbours(&pairs, dimensions.len());
        Self { node_of, offset_of, dimensions, first_variable, global, starts, neighbours }
    }

    /// A graph of given nodes and pairs (a, b).
    #[must_use]
    #[allow(clippy::cast_possible_truncation)]
    pub fn from_pairs(dimensions: Vec<u16>, pairs: impl IntoIterator<Item = (u32, u32)>) -> Self {
        let count = dimensions.len();
        let mut packed: Vec<u64> = pairs.into_iter().filter(|(a, b)| a != b).map(|(a, b)| pack(a, b)).collect();
        packed.sort_unstable();
        packed.dedup();
        let (starts, neighbours) = neighbours(&packed, count);
        Self {
            node_of: (0..count as u32).collect(),
            offset_of: vec![0; count],
            first_variable: (0..count as u32).collect(),
            global: vec![false; count],
            dimensions,
            starts,
            neighbours,
        }
    }

    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.dimensions.len()
    }
    /// Whether there is no node.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.dimensions.is_empty()
    }
    /// Neighbours of a node.
    #[must_use]
    #[inline]
    pub fn of(&self, node: u32) -> &[u32] {
        &self.neighbours[self.starts[node as usize] as usize..self.starts[node as usize + 1] as usize]
    }
    /// Node of a variable, when it is not held.
    #[must_use]
    pub fn node(&self, id: VariableId) -> Option<u32> {
        Some(self.node_of[id.index()]).filter(|n| *n != NO_NODE)
    }

    /// Component of each node, counted from 0, and the number of components.
    #[must_use]
    pub fn components(&self) -> (Vec<u32>, u32) {
        let mut component = vec![NO_NODE; self.len()];
        let (mut next, mut stack) = (0, Vec::new());
        for start in 0..u32::try_from(self.len()).unwrap_or(u32::MAX) {
            if component[start as usize] != NO_NODE {
                continue;
            }
            stack.push(start);
            component[start as usize] = next;
            while let Some(node) = stack.pop() {
                for other in self.of(node) {
                    if component[*other as usize] == NO_NODE {
                        component[*other as usize] = next;
                        stack.push(*other);
                    }
                }
            }
            next += 1;
        }
        (component, next)
    }
}

fn pack(a: u32, b: u32) -> u64 {
    (u64::from(a.min(b)) << 32) | u64::from(a.max(b))
}

/// Sorted pairs of nodes that share a factor.
fn pairs(problem: &Problem, node_of: &[u32]) -> Vec<u64> {
    let mut pairs = Vec::new();
    let mut limit = 1 << 22;
    let mut nodes: Vec<u32> = Vec::new();
    for group in problem.groups() {
        let mut last = u64::MAX;
        for index in (0..group.len()).filter(|i| !group.is_left_out(*i)) {
            let variables = group.factor(index).variables();
            nodes.clear();
            nodes.extend(variables.iter().map(|v| node_of[v.index()]).filter(|n| *n != NO_NODE));
            nodes.sort_unstable();
            nodes.dedup();
            for (k, a) in nodes.iter().enumerate() {
                for b in &nodes[k + 1..] {
                    let pair = pack(*a, *b);
                    if pair != last {
                        pairs.push(pair);
                        last = pair;
                    }
                }
            }
            if pairs.len() > limit {
                pairs.sort_unstable();
                pairs.dedup();
                limit = limit.max(2 * pairs.len());
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

#[allow(clippy::cast_possible_truncation)]
fn neighbours(pairs: &[u64], count: usize) -> (Vec<u32>, Vec<u32>) {
    let split = |pair: u64| ((pair >> 32) as u32, pair as u32);
    let mut starts = vec![0_u32; count + 1];
    for pair in pairs {
        let (a, b) = split(*pair);
        starts[a as usize + 1] += 1;
        starts[b as usize + 1] += 1;
    }
    for k in 0..count {
        starts[k + 1] += starts[k];
    }
    let mut next = starts.clone();
    let mut list = vec![0; 2 * pairs.len()];
    // Pairs are sorted, so every node's list comes out sorted when the smaller partners are written first.
    for pair in pairs {
        let (a, b) = split(*pair);
        list[next[b as usize] as usize] = a;
        next[b as usize] += 1;
    }
    for pair in pairs {
        let (a, b) = split(*pair);
        list[next[a as usize] as usize] = b;
        next[a as usize] += 1;
    }
    (starts, list)
}
