//! Minimum vertex cover of the edges of a cut: the smallest separator that the cut allows.

use std::collections::VecDeque;

const FREE: u32 = u32::MAX;

/// A bipartite graph; the left side's edges as lists.
#[derive(Debug, Default)]
pub struct Cut {
    starts: Vec<u32>,
    right_of: Vec<u32>,
    match_left: Vec<u32>,
    match_right: Vec<u32>,
    level: Vec<u32>,
    next: Vec<u32>,
    queue: VecDeque<u32>,
    stack: Vec<u32>,
    seen_right: Vec<bool>,
}

impl Cut {
    /// Which left and which right vertices form a minimum vertex cover.
    ///
    /// `edges`: pairs (left, right), sorted by left, all left vertices from 0 to `left - 1`.
    #[allow(clippy::cast_possible_truncation)] // vertices are counted in u32
    pub fn cover(&mut self, left: usize, right: usize, edges: &[(u32, u32)]) -> (Vec<bool>, Vec<bool>) {
        self.starts.clear();
        self.starts.resize(left + 1, 0);
        for (a, _) in edges {
            self.starts[*a as usize + 1] += 1;
        }
        for k in 0..left {
            self.starts[k + 1] += self.starts[k];
        }
        self.right_of.clear();
        self.right_of.extend(edges.iter().map(|e| e.1));
        self.match_left.clear();
        self.match_left.resize(left, FREE);
        self.match_right.clear();
        self.match_right.resize(right, FREE);
        for a in 0..left as u32 {
            let free = self.edges(a).find(|e| self.match_right[self.right_of[*e] as usize] == FREE);
            if let Some(edge) = free {
                self.pair(a, self.right_of[edge]);
            }
        }
        while self.levels() {
            self.next.clear();
            self.next.extend_from_slice(&self.starts[..left]);
            for a in 0..left as u32 {
                if self.match_left[a as usize] == FREE {
                    self.augment(a);
                }
            }
        }
        // König: what alternating paths reach from free left vertices
        self.seen_right.clear();
        self.seen_right.resize(right, false);
        let mut seen_left = vec![false; left];
        self.stack.clear();
        self.stack.extend((0..left as u32).filter(|a| self.match_left[*a as usize] == FREE));
        for a in &self.stack {
            seen_left[*a as usize] = true;
        }
        while let Some(a) = self.stack.pop() {
            for e in self.edges(a) {
                let b = self.right_of[e] as usize;
                if !self.seen_right[b] {
                    self.seen_right[b] = true;
                    let back = self.match_right[b];
                    if back != FREE && !seen_left[back as usize] {
                        seen_left[back as usize] = true;
                        self.stack.push(back);
                    }
                }
            }
        }
        (seen_left.iter().map(|s| !s).collect(), self.seen_right.clone())
    }

    fn edges(&self, a: u32) -> std::ops::Range<usize> {
        self.starts[a as usize] as usize..self.starts[a as usize + 1] as usize
    }
    fn pair(&mut self, a: u32, b: u32) {
        self.match_left[a as usize] = b;
        self.match_right[b as usize] = a;
    }

    /// Levels of left vertices by alternating paths from free ones; whether a free right vertex is reached.
    #[allow(clippy::cast_possible_truncation)]
    fn levels(&mut self) -> bool {
        let left = self.match_left.len();
        self.level.clear();
        self.level.resize(left, FREE);
        self.queue.clear();
        for a in 0..left as u32 {
            if self.match_left[a as usize] == FREE {
                self.level[a as usize] = 0;
                self.queue.push_back(a);
            }
        }
        let mut found = false;
        while let Some(a) = self.queue.pop_front() {
            for e in self.edges(a) {
                let back = self.match_right[self.right_of[e] as usize];
                if back == FREE {
                    found = true;
                } else if self.level[back as usize] == FREE {
                    self.level[back as usize] = self.level[a as usize] + 1;
                    self.queue.push_back(back);
                }
            }
        }
        found
    }

    /// One augmenting path from a free left vertex along the levels, without recursion.
    fn augment(&mut self, start: u32) {
        self.stack.clear();
        self.stack.push(start);
        while let Some(&a) = self.stack.last() {
            let end = self.starts[a as usize + 1];
            let edge = self.next[a as usize];
            if edge == end {
                self.level[a as usize] = FREE;
                self.stack.pop();
                continue;
            }
            let b = self.right_of[edge as usize];
            let back = self.match_right[b as usize];
            if back == FREE {
                // every vertex of the path takes the edge it stands at
                while let Some(v) = self.stack.pop() {
                    let b = self.right_of[self.next[v as usize] as usize];
                    self.pair(v, b);
                }
                return;
            }
            if self.level[back as usize] == self.level[a as usize].wrapping_add(1) && self.level[a as usize] != FREE {
                self.stack.push(back);
            } else {
                self.next[a as usize] += 1;
            }
        }
    }
}
