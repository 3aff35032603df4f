//! The tree of blocks from a minimum-degree order, for graphs without places.
//!
//! Approximate minimum degree on the graph of nodes (Amestoy, Davis and Duff), elimination tree (Liu), columns of one
//! structure taken together, small blocks merged into the block above where that adds few zeros.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

use super::tree::Draft;
use crate::linear::nodes::NodeGraph;

/// Blocks with fewer own scalars than this are merged whatever it costs.
const SMALL: usize = 24;
/// Share of zeros in a merged panel that is accepted.
const ZEROS: f64 = 0.15;

/// Blocks of a minimum-degree order; global nodes in the last one.
#[must_use]
pub fn minimum_degree(graph: &NodeGraph) -> Vec<Draft> {
    let order = order(graph);
    blocks(graph, &order)
}

/// Minimum-degree order of the nodes that are not global, then the global ones.
fn order(graph: &NodeGraph) -> Vec<u32> {
    let count = graph.len();
    let locals: Vec<u32> =
        (0..u32::try_from(count).unwrap_or(u32::MAX)).filter(|n| !graph.global[*n as usize]).collect();
    let mut local_of = vec![usize::MAX; count];
    for (k, node) in locals.iter().enumerate() {
        local_of[*node as usize] = k;
    }
    let mut starts = vec![0_usize];
    let mut rows: Vec<usize> = Vec::new();
    for node in &locals {
        let begin = rows.len();
        rows.extend(graph.of(*node).iter().map(|n| local_of[*n as usize]).filter(|k| *k != usize::MAX));
        rows[begin..].sort_unstable();
        starts.push(rows.len());
    }
    let n = locals.len();
    let (mut permutation, mut inverse) = (vec![0_usize; n], vec![0_usize; n]);
    let pattern = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
    let mut memory = MemBuffer::new(amd::order_scratch::<usize>(n, rows.len()));
    let stack = MemStack::new(&mut memory);
    let ordered = amd::order(&mut permutation, &mut inverse, pattern, amd::Control::default(), stack);
    let mut order: Vec<u32> = match ordered {
        Ok(_) => permutation.iter().map(|k| locals[*k]).collect(),
        Err(_) => locals, // out of memory for the order alone: what follows would not fit either
    };
    order.extend((0..u32::try_from(count).unwrap_or(u32::MAX)).filter(|v| graph.global[*v as usize]));
    order
}

/// A block while structures are merged.
struct Super {
    own: Vec<u32>,
    own_scalars: usize,
    boundary_scalars: usize,
    parent: Option<usize>,
    merged_into: Option<usize>,
}

#[allow(clippy::cast_possible_truncation)]
fn blocks(graph: &NodeGraph, order: &[u32]) -> Vec<Draft> {
    let count = order.len();
    let mut position = vec![0_u32; count];
    for (p, node) in order.iter().enumerate() {
        position[*node as usize] = p as u32;
    }
    // structures of columns, each merged from its children's and dropped as soon as its parent has it
    let mut structure: Vec<Vec<u32>> = vec![Vec::new(); count];
    let mut below: Vec<Vec<u32>> = vec![Vec::new(); count];
    let mut mark = vec![u32::MAX; count];
    let mut block_of: Vec<usize> = vec![usize::MAX; count];
    let mut supers: Vec<Super> = Vec::new();
    for p in 0..count {
        let mut mine: Vec<u32> = Vec::new();
        for other in graph.of(order[p]) {
            let q = position[*other as usize];
            if q > p as u32 && mark[q as usize] != p as u32 {
                mark[q as usize] = p as u32;
                mine.push(q);
            }
        }
        let children = std::mem::take(&mut below[p]);
        for child in &children {
            for q in std::mem::take(&mut structure[*child as usize]) {
                if q > p as u32 && mark[q as usize] != p as u32 {
                    mark[q as usize] = p as u32;
                    mine.push(q);
                }
            }
        }
        mine.sort_unstable();
        let dimension = |q: u32| usize::from(graph.dimensions[order[q as usize] as usize]);
        let boundary: usize = mine.iter().map(|q| dimension(*q)).sum();
        let own = dimension(p as u32);
        // one child whose structure is this column and nothing else than this column's: the same block
        let same =
            children.iter().map(|c| block_of[*c as usize]).find(|b| supers[*b].boundary_scalars == boundary + own);
        if let Some(block) = same {
            let s = &mut supers[block];
            s.own.push(order[p]);
            s.own_scalars += own;
            s.boundary_scalars = boundary;
            block_of[p] = block;
        } else {
            block_of[p] = supers.len();
            supers.push(Super {
                own: vec![order[p]],
                own_scalars: own,
                boundary_scalars: boundary,
                parent: None,
                merged_into: None,
            });
        }
        for child in &children {
            let block = block_of[*child as usize];
            if block != block_of[p] {
                supers[block].parent = Some(block_of[p]);
            }
        }
        if let Some(parent) = mine.first() {
            below[*parent as usize].push(p as u32);
        }
        structure[p] = mine;
    }
    merge(supers)
}

/// Merges blocks into the one above where few zeros are added.
#[allow(clippy::cast_precision_loss)]
fn merge(mut supers: Vec<Super>) -> Vec<Draft> {
    // A block may have got a later number than its parent only by joining; go by the height in the tree.
    let depth = depths(&supers);
    let mut sequence: Vec<usize> = (0..supers.len()).collect();
    sequence.sort_by_key(|b| std::cmp::Reverse(depth[*b]));
    for b in sequence {
        let Some(parent) = supers[b].parent else { continue };
        let (own, boundary) = (supers[b].own_scalars, supers[b].boundary_scalars);
        let above = &supers[parent];
        let (own_sum, boundary_sum) = (own + above.own_scalars, above.boundary_scalars);
        let zeros = own * (above.own_scalars + above.boundary_scalars).saturating_sub(boundary);
        let panel = own_sum * (own_sum + boundary_sum);
        if own_sum <= SMALL || zeros as f64 <= ZEROS * panel as f64 && own <= 4 * SMALL {
            let nodes = std::mem::take(&mut supers[b].own);
            supers[b].merged_into = Some(parent);
            let above = &mut supers[parent];
            above.own_scalars = own_sum;
            above.own.splice(0..0, nodes);
        }
    }
    let mut index = vec![usize::MAX; supers.len()];
    let kept: Vec<usize> = (0..supers.len()).filter(|b| supers[*b].merged_into.is_none()).collect();
    for (new, old) in kept.iter().enumerate() {
        index[*old] = new;
    }
    let find = |mut b: usize| {
        while let Some(parent) = supers[b].merged_into {
            b = parent;
        }
        b
    };
    kept.iter()
        .map(|b| Draft { own: supers[*b].own.clone(), parent: supers[*b].parent.map(|p| index[find(p)]) })
        .collect()
}

fn depths(supers: &[Super]) -> Vec<u32> {
    let mut depth = vec![u32::MAX; supers.len()];
    let mut path = Vec::new();
    for start in 0..supers.len() {
        let mut at = start;
        while depth[at] == u32::MAX {
            path.push(at);
            match supers[at].parent {
                Some(parent) => at = parent,
                None => break,
            }
        }
        let mut value = if depth[at] == u32::MAX { 0 } else { depth[at] + 1 };
        while let Some(b) = path.pop() {
            depth[b] = value;
            value += 1;
        }
    }
    depth
}
