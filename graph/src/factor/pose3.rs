//! Poses and points in space.

use nalgebra::{Matrix3, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector6};

use super::{Convention, Factor, NotPositiveDefinite, put, square_root};
use crate::rotation::{cross, log_se3, right_jacobian_inverse, right_jacobian_inverse_se3};
use crate::variable::{Values, VariableId};

/// A rigid motion in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Translation \[m\].
    pub translation: Vector3<f64>,
    /// Rotation.
    pub rotation: UnitQuaternion<f64>,
}

/// Relative pose of two poses: odometry, loop closure, submap link.
#[derive(Debug, Clone)]
pub struct Between3 {
    ids: [VariableId; 2],
    measured: Motion,
    root: Matrix6<f64>,
    convention: Convention,
    tie: bool,
}

impl Between3 {
    /// `measured`: the second pose in the frame of the first; information of translation, then rotation.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        ids: [VariableId; 2],
        measured: Motion,
        information: &Matrix6<f64>,
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
    /// What was measured.
    #[must_use]
    pub fn measured(&self) -> Motion {
        self.measured
    }
    /// Information of translation and rotation.
    #[must_use]
    pub fn information(&self) -> Matrix6<f64> {
        self.root.transpose() * self.root
    }
}

/// Residual of the rotation that is left, and its right Jacobian.
fn rotation_error(left: &UnitQuaternion<f64>, convention: Convention) -> (Vector3<f64>, Matrix3<f64>) {
    if convention == Convention::G2o {
        let q = left.quaternion();
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        let v = sign * q.imag();
        (v, 0.5 * (sign * q.w * Matrix3::identity() + cross(&v)))
    } else {
        let phi = left.scaled_axis();
        (phi, right_jacobian_inverse(&phi))
    }
}

impl Factor for Between3 {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        6
    }
    fn is_tie(&self) -> bool {
        self.tie
    }
    fn label(&self) -> &'static str {
        "relation of poses"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let (ra, rb) = (values.rotation(self.ids[0]), values.rotation(self.ids[1]));
        let d = ra.inverse() * (values.xyz(self.ids[1]) - values.xyz(self.ids[0]));
        let relative = ra.inverse() * rb;
        let (measured, back) = (self.measured, self.measured.rotation.inverse());
        let left = back * relative;
        let (phi, jr) = rotation_error(&left, self.convention);
        let rel = *relative.to_rotation_matrix().matrix();
        let frame = *back.to_rotation_matrix().matrix();
        let t = frame * (d - measured.translation);
        let mut first = Matrix6::zeros();
        let mut second = Matrix6::zeros();
        let wants = jacobian.is_some();
        if wants {
            first.fixed_view_mut::<3, 3>(0, 0).copy_from(&-frame);
            first.fixed_view_mut::<3, 3>(0, 3).copy_from(&(frame * cross(&d)));
            first.fixed_view_mut::<3, 3>(3, 3).copy_from(&(-jr * rel.transpose()));
            second.fixed_view_mut::<3, 3>(0, 0).copy_from(&(frame * rel));
            second.fixed_view_mut::<3, 3>(3, 3).copy_from(&jr);
        }
        let error = if self.convention == Convention::Log {
            let xi = log_se3(&t, &phi);
            if wants {
                // In the tangent of the motion that is left the derivatives are the adjoint's and the identity's.
                let jr6 = right_jacobian_inverse_se3(&xi);
                let mut adjoint = Matrix6::zeros();
                let turned = rel.transpose();
                adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&turned);
                adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned);
                adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(turned * cross(&d)));
                first = -jr6 * adjoint;
                second = jr6;
            }
            xi
        } else {
            Vector6::new(t.x, t.y, t.z, phi.x, phi.y, phi.z)
        };
        residual.copy_from_slice((self.root * error).as_slice());
        if let Some(jacobian) = jacobian {
            put(jacobian, 12, 0, &(self.root * first));
            put(jacobian, 12, 6, &(self.root * second));
        }
    }
}

/// A pose known beforehand: place in the map, rotation.
#[derive(Debug, Clone)]
pub struct Prior3 {
    id: [VariableId; 1],
    measured: Motion,
    root: Matrix6<f64>,
}

impl Prior3 {
    /// The error is (map translation, rotation vector in the frame of the known pose).
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(id: VariableId, measured: Motion, information: &Matrix6<f64>) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { id: [id], measured, root: square_root(information)? })
    }
}

impl Factor for Prior3 {
    fn variables(&self) -> &[VariableId] {
        &self.id
    }
    fn rows(&self) -> usize {
        6
    }
    fn label(&self) -> &'static str {
        "known pose"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let rotation = values.rotation(self.id[0]);
        let t = values.xyz(self.id[0]) - self.measured.translation;
        let phi = (self.measured.rotation.inverse() * rotation).scaled_axis();
        let e = self.root * Vector6::new(t.x, t.y, t.z, phi.x, phi.y, phi.z);
        residual.copy_from_slice(e.as_slice());
        if let Some(jacobian) = jacobian {
            let mut j = Matrix6::zeros();
            j.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.to_rotation_matrix().matrix());
            j.fixed_view_mut::<3, 3>(3, 3).copy_from(&right_jacobian_inverse(&phi));
            put(jacobian, 6, 0, &(self.root * j));
        }
    }
}

/// A point seen from a pose: an XYZ tie, in the frame of the pose.
#[derive(Debug, Clone)]
pub struct Sighting3 {
    ids: [VariableId; 2],
    measured: Vector3<f64>,
    root: Matrix3<f64>,
    tie: bool,
}

impl Sighting3 {
    /// `ids`: pose, point.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        ids: [VariableId; 2],
        measured: Vector3<f64>,
        information: &Matrix3<f64>,
    ) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { ids, measured, root: square_root(information)?, tie: false })
    }
    /// The same as a tie, which robust kernels may weight down.
    #[must_use]
    pub fn as_tie(mut self, tie: bool) -> Self {
        self.tie = tie;
        self
    }
    /// What was measured \[m\].
    #[must_use]
    pub fn measured(&self) -> Vector3<f64> {
        self.measured
    }
}

impl Factor for Sighting3 {
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
        "sighting of a point"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let rotation = values.rotation(self.ids[0]);
        let d = rotation.inverse() * (values.xyz(self.ids[1]) - values.xyz(self.ids[0]));
        residual.copy_from_slice((self.root * (d - self.measured)).as_slice());
        if let Some(jacobian) = jacobian {
            put(jacobian, 9, 0, &-self.root);
            put(jacobian, 9, 3, &(self.root * cross(&d)));
            put(jacobian, 9, 6, &(self.root * rotation.to_rotation_matrix().matrix().transpose()));
        }
    }
}

/// The same point in two poses' frames, without the point as unknown: an XYZ point tie.
#[derive(Debug, Clone)]
pub struct PointTie {
    ids: [VariableId; 2],
    body_m: [Vector3<f64>; 2],
    root: Matrix3<f64>,
}

impl PointTie {
    /// `body_m`: the point in the frames of both poses; information of the difference in the map.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        ids: [VariableId; 2],
        body_m: [Vector3<f64>; 2],
        information: &Matrix3<f64>,
    ) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { ids, body_m, root: square_root(information)? })
    }
}

impl Factor for PointTie {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        3
    }
    fn is_tie(&self) -> bool {
        true
    }
    fn label(&self) -> &'static str {
        "XYZ point"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let place = |k: usize| values.rotation(self.ids[k]) * self.body_m[k] + values.xyz(self.ids[k]);
        residual.copy_from_slice((self.root * (place(0) - place(1))).as_slice());
        if let Some(jacobian) = jacobian {
            for (k, sign) in [(0, 1.0), (1, -1.0)] {
                let r = sign * self.root * values.rotation(self.ids[k]).to_rotation_matrix().matrix();
                put(jacobian, 12, 6 * k, &r);
                put(jacobian, 12, 6 * k + 3, &(-r * cross(&self.body_m[k])));
            }
        }
    }
}

/// The same plane seen from two poses: a surface line, one row along the plane's normal.
#[derive(Debug, Clone)]
pub struct SurfaceLine {
    ids: [VariableId; 2],
    body_m: [Vector3<f64>; 2],
    normal: Vector3<f64>,
    weight: f64,
}

impl SurfaceLine {
    /// `body_m`: a point of the plane in the frames of both poses; `normal`: the plane's, in the map.
    #[must_use]
    pub fn new(ids: [VariableId; 2], body_m: [Vector3<f64>; 2], normal: Vector3<f64>, sigma_m: f64) -> Self {
        Self { ids, body_m, normal, weight: 1.0 / sigma_m }
    }
}

impl Factor for SurfaceLine {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        1
    }
    fn is_tie(&self) -> bool {
        true
    }
    fn label(&self) -> &'static str {
        "surface line"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let place = |k: usize| values.rotation(self.ids[k]) * self.body_m[k] + values.xyz(self.ids[k]);
        residual[0] = self.weight * self.normal.dot(&(place(0) - place(1)));
        if let Some(jacobian) = jacobian {
            for (k, sign) in [(0, 1.0), (1, -1.0)] {
                let row: SMatrix<f64, 1, 3> = sign
                    * self.weight
                    * self.normal.transpose()
                    * values.rotation(self.ids[k]).to_rotation_matrix().matrix();
                put(jacobian, 12, 6 * k, &row);
                put(jacobian, 12, 6 * k + 3, &(-row * cross(&self.body_m[k])));
            }
        }
    }
}
