//! Poses and points in the plane.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::{Convention, Factor, NotPositiveDefinite, put, square_root};
use crate::rotation::{log_se2_matrix, perpendicular, turn};
use crate::variable::{Values, VariableId, wrap};

/// Relative pose of two poses: odometry, loop closure, submap link.
#[derive(Debug, Clone)]
pub struct Between2 {
    ids: [VariableId; 2],
    measured: [f64; 3],
    root: Matrix3<f64>,
    convention: Convention,
    tie: bool,
}

impl Between2 {
    /// `measured`: x, y \[m\], angle \[rad\] of the second pose in the frame of the first.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        ids: [VariableId; 2],
        measured: [f64; 3],
        information: &Matrix3<f64>,
        convention: Convention,
    ) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { ids, measured, root: square_root(information)?, convention, tie: false })
    }
    /// The same as a tie or loop edge, which robust kernels may weight down.
    #[must_use]
    pub fn as_tie(mut self, tie: bool) -> Self {
        self.tie = tie;
        self
    }
    /// What was measured: x, y \[m\], angle \[rad\].
    #[must_use]
    pub fn measured(&self) -> [f64; 3] {
        self.measured
    }
    /// Information of translation and angle.
    #[must_use]
    pub fn information(&self) -> Matrix3<f64> {
        self.root.transpose() * self.root
    }
}

impl Factor for Between2 {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        3
    }
    fn is_tie(&self) -> bool {
        self.tie
    }
    fn label(&self) -> &'static str {
        "relation of poses"
    }
    #[inline]
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let (a, b) = (values.get(self.ids[0]), values.get(self.ids[1]));
        let relation = Relation::new(a, b, &self.measured, self.convention);
        residual.copy_from_slice((self.root * relation.error).as_slice());
        if let Some(jacobian) = jacobian {
            let [first, second] = relation.derivatives();
            put(jacobian, 6, 0, &(self.root * first));
            put(jacobian, 6, 3, &(self.root * second));
        }
    }
}

/// What is left of a measured relation of two poses.
#[derive(Debug)]
pub(super) struct Relation {
    /// Error in the convention's units, not whitened.
    pub(super) error: Vector3<f64>,
    in_first: Vector2<f64>,
    turn_rad: f64,
    left: Matrix2<f64>,
    by_angle: Vector2<f64>,
}

impl Relation {
    #[inline]
    pub(super) fn new(a: &[f64], b: &[f64], measured: &[f64; 3], convention: Convention) -> Self {
        let in_first = turn(-a[2]) * Vector2::new(b[0] - a[0], b[1] - a[1]);
        let (turn_rad, angle) = (b[2] - a[2], wrap(b[2] - a[2] - measured[2]));
        // to the frame of the measured pose; then the matrix of the logarithm
        let mut left = turn(-measured[2]);
        let mut by_angle = Vector2::zeros();
        let mut t = left * (in_first - Vector2::new(measured[0], measured[1]));
        if convention == Convention::Log {
            let (v, dv) = log_se2_matrix(angle);
            by_angle = dv * t;
            left = v * left;
            t = v * t;
        }
        Self { error: Vector3::new(t.x, t.y, angle), in_first, turn_rad, left, by_angle }
    }
    /// Derivatives of the error by the tangents of the first and of the second pose.
    #[inline]
    pub(super) fn derivatives(&self) -> [Matrix3<f64>; 2] {
        let Self { left, by_angle, .. } = self;
        let ja = -left;
        let ta = -(left * perpendicular(&self.in_first)) - by_angle;
        let jb = left * turn(self.turn_rad);
        [
            Matrix3::new(ja[(0, 0)], ja[(0, 1)], ta.x, ja[(1, 0)], ja[(1, 1)], ta.y, 0.0, 0.0, -1.0),
            Matrix3::new(jb[(0, 0)], jb[(0, 1)], by_angle.x, jb[(1, 0)], jb[(1, 1)], by_angle.y, 0.0, 0.0, 1.0),
        ]
    }
}

/// A pose known beforehand: x, y in the map, angle.
#[derive(Debug, Clone)]
pub struct Prior2 {
    id: [VariableId; 1],
    measured: [f64; 3],
    root: Matrix3<f64>,
}

impl Prior2 {
    /// The error is (map translation, wrapped angle).
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(id: VariableId, measured: [f64; 3], information: &Matrix3<f64>) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { id: [id], measured, root: square_root(information)? })
    }
}

impl Factor for Prior2 {
    fn variables(&self) -> &[VariableId] {
        &self.id
    }
    fn rows(&self) -> usize {
        3
    }
    fn label(&self) -> &'static str {
        "known pose"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let v = values.get(self.id[0]);
        let m = self.measured;
        let e = self.root * Vector3::new(v[0] - m[0], v[1] - m[1], wrap(v[2] - m[2]));
        residual.copy_from_slice(e.as_slice());
        if let Some(jacobian) = jacobian {
            let r = turn(v[2]);
            let j = Matrix3::new(r[(0, 0)], r[(0, 1)], 0.0, r[(1, 0)], r[(1, 1)], 0.0, 0.0, 0.0, 1.0);
            put(jacobian, 3, 0, &(self.root * j));
        }
    }
}

/// A point seen from a pose, Cartesian in the frame of the pose.
#[derive(Debug, Clone)]
pub struct Sighting2 {
    ids: [VariableId; 2],
    measured: Vector2<f64>,
    root: Matrix2<f64>,
    tie: bool,
}

impl Sighting2 {
    /// `ids`: pose, point.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        ids: [VariableId; 2],
        measured: Vector2<f64>,
        information: &Matrix2<f64>,
    ) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { ids, measured, root: square_root(information)?, tie: false })
    }
    /// The same from range \[m\] and bearing \[rad\], with the sigmas along and across the beam \[m\].
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] when a sigma is not positive.
    pub fn from_range_bearing(
        ids: [VariableId; 2],
        range_m: f64,
        bearing_rad: f64,
        along_sigma_m: f64,
        across_sigma_m: f64,
    ) -> Result<Self, NotPositiveDefinite> {
        let weights = Matrix2::new(along_sigma_m.powi(-2), 0.0, 0.0, across_sigma_m.powi(-2));
        let r = turn(bearing_rad);
        Self::new(ids, r * Vector2::new(range_m, 0.0), &(r * weights * r.transpose()))
    }
    /// The same as a tie, which robust kernels may weight down.
    #[must_use]
    pub fn as_tie(mut self, tie: bool) -> Self {
        self.tie = tie;
        self
    }
    /// What was measured \[m\].
    #[must_use]
    pub fn measured(&self) -> Vector2<f64> {
        self.measured
    }
}

impl Factor for Sighting2 {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        2
    }
    fn is_tie(&self) -> bool {
        self.tie
    }
    fn label(&self) -> &'static str {
        "sighting of a point"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let pose = values.get(self.ids[0]);
        let back = turn(-pose[2]);
        let d = back * (values.xy(self.ids[1]) - Vector2::new(pose[0], pose[1]));
        residual.copy_from_slice((self.root * (d - self.measured)).as_slice());
        if let Some(jacobian) = jacobian {
            put(jacobian, 5, 0, &-self.root);
            put(jacobian, 5, 2, &(-self.root * perpendicular(&d)));
            put(jacobian, 5, 3, &(self.root * back));
        }
    }
}

/// Range and bearing of a point from a pose, each with its sigma.
#[derive(Debug, Clone)]
pub struct RangeBearing {
    ids: [VariableId; 2],
    range_m: f64,
    bearing_rad: f64,
    weights: [f64; 2],
}

impl RangeBearing {
    /// `ids`: pose, point.
    #[must_use]
    pub fn new(
        ids: [VariableId; 2],
        range_m: f64,
        bearing_rad: f64,
        range_sigma_m: f64,
        bearing_sigma_rad: f64,
    ) -> Self {
        Self { ids, range_m, bearing_rad, weights: [1.0 / range_sigma_m, 1.0 / bearing_sigma_rad] }
    }
}

impl Factor for RangeBearing {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        2
    }
    fn label(&self) -> &'static str {
        "range and bearing"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let pose = values.get(self.ids[0]);
        let back = turn(-pose[2]);
        let d = back * (values.xy(self.ids[1]) - Vector2::new(pose[0], pose[1]));
        let range = d.norm().max(1e-9);
        residual[0] = self.weights[0] * (range - self.range_m);
        residual[1] = self.weights[1] * wrap(d.y.atan2(d.x) - self.bearing_rad);
        if let Some(jacobian) = jacobian {
            let by_d = Matrix2::new(
                self.weights[0] * d.x / range,
                self.weights[0] * d.y / range,
                -self.weights[1] * d.y / (range * range),
                self.weights[1] * d.x / (range * range),
            );
            put(jacobian, 5, 0, &-by_d);
            put(jacobian, 5, 2, &(-by_d * perpendicular(&d)));
            put(jacobian, 5, 3, &(by_d * back));
        }
    }
}
