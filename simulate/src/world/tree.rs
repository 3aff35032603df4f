//! Trees: an ellipsoid full of leaves over a trunk too thin to be seen.

use nalgebra::{Vector2, Vector3};

use crate::random::Random;

/// Share of the beam that is lost per metre of crown \[1/m\].
const DENSITY_PER_M: f64 = 0.55;

/// The crown of a tree.
#[derive(Debug, Clone, Copy)]
pub struct Tree {
    pub(super) centre: Vector3<f64>,
    pub(super) radius_m: f64,
    pub(super) half_height_m: f64,
}

impl Tree {
    /// A crown about a point.
    pub(crate) fn new(centre: Vector3<f64>, radius_m: f64, half_height_m: f64) -> Self {
        Self { centre, radius_m, half_height_m }
    }

    /// Middle of the crown.
    pub(crate) fn centre_m(&self) -> Vector3<f64> {
        self.centre
    }

    /// Where a ray enters and leaves the crown \[m\].
    pub(crate) fn span(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<(f64, f64)> {
        let squeeze =
            |v: Vector3<f64>| Vector3::new(v.x / self.radius_m, v.y / self.radius_m, v.z / self.half_height_m);
        let (o, d) = (squeeze(origin - self.centre), squeeze(*direction));
        let (a, b, c) = (d.norm_squared(), o.dot(&d), o.norm_squared() - 1.0);
        let root = b * b - a * c;
        (root > 0.0).then(|| ((-b - root.sqrt()) / a, (-b + root.sqrt()) / a))
    }

    /// Depth \[m\] at which a beam meets a leaf: exponential.
    pub(crate) fn depth_m(random: &mut Random) -> f64 {
        -(1.0 - random.uniform()).ln() / DENSITY_PER_M
    }

    /// Middle of the tree on the ground.
    pub(super) fn foot(&self) -> Vector2<f64> {
        self.centre.xy()
    }
}
