//! Things whose place is known: for judges.

use nalgebra::Vector3;

/// A point of a thing.
#[derive(Debug, Clone, PartialEq)]
pub struct Feature {
    /// What it is of: `zebra`, `dash`, `arrow`, `manhole`, `pole`, `facade`.
    pub kind: &'static str,
    /// Number of the thing and, after dots, of its parts and corners.
    pub name: String,
    /// East, north, up \[m\].
    pub point_m: Vector3<f64>,
}

/// All of them.
#[derive(Debug, Default)]
pub(super) struct Features {
    pub(super) list: Vec<Feature>,
    counts: Vec<(&'static str, u32)>,
}

impl Features {
    /// Number of the next thing of a kind.
    pub(super) fn next(&mut self, kind: &'static str) -> u32 {
        if let Some(count) = self.counts.iter_mut().find(|c| c.0 == kind) {
            count.1 += 1;
            return count.1;
        }
        self.counts.push((kind, 0));
        0
    }
}
