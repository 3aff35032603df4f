//! What a sensor measures whose place on the vehicle is an unknown: one pose variable, `vehicle_from_sensor`, linked to
//! every pose of the vehicle. All in the plane.

use nalgebra::{Matrix2, Matrix3, Vector2};

use super::pose2::Relation;
use super::{Convention, Factor, NotPositiveDefinite, put, square_root};
use crate::rotation::{perpendicular, turn};
use crate::variable::{Values, VariableId, wrap};

/// A point seen by a mounted sensor, Cartesian in the frame of the sensor.
#[derive(Debug, Clone)]
pub struct MountedSighting2 {
    ids: [VariableId; 3],
    measured: Vector2<f64>,
    root: Matrix2<f64>,
    tie: bool,
}

impl MountedSighting2 {
    /// `ids`: pose of the vehicle, place of the sensor on it, point.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        ids: [VariableId; 3],
        measured: Vector2<f64>,
        information: &Matrix2<f64>,
    ) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { ids, measured, root: square_root(information)?, tie: false })
    }
    /// The same as a tie, which robust kernels may weight down.
    #[must_use]
    pub fn as_tie(mut self, tie: bool) -> Self {
        self.tie = tie;
        self
    }
}

impl Factor for MountedSighting2 {
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
        "sighting by a mounted sensor"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let (pose, mount) = (values.get(self.ids[0]), values.get(self.ids[1]));
        let vehicle_from_map = turn(-pose[2]);
        let sensor_from_vehicle = turn(-mount[2]);
        let in_vehicle = vehicle_from_map * (values.xy(self.ids[2]) - Vector2::new(pose[0], pose[1]));
        let in_sensor = sensor_from_vehicle * (in_vehicle - Vector2::new(mount[0], mount[1]));
        residual.copy_from_slice((self.root * (in_sensor - self.measured)).as_slice());
        if let Some(jacobian) = jacobian {
            let turned = self.root * sensor_from_vehicle;
            put(jacobian, 8, 0, &-turned);
            put(jacobian, 8, 2, &(-turned * perpendicular(&in_vehicle)));
            put(jacobian, 8, 3, &-self.root);
            put(jacobian, 8, 5, &(-self.root * perpendicular(&in_sensor)));
            put(jacobian, 8, 6, &(turned * vehicle_from_map));
        }
    }
}

/// Relative pose of a mounted sensor at two poses of the vehicle: a link of submaps, by their registration.
///
/// `Z = (Xᵢ M)⁻¹ Xⱼ M`, `M` the place of the sensor on the vehicle: the hand-eye equation. Turns of the vehicle tell
/// the offset of `M`, straight motion its rotation.
#[derive(Debug, Clone)]
pub struct MountedBetween2 {
    ids: [VariableId; 3],
    measured: [f64; 3],
    root: Matrix3<f64>,
    convention: Convention,
    tie: bool,
}

impl MountedBetween2 {
    /// `ids`: first and second pose of the vehicle, place of the sensor on it. `measured`: x, y \[m\], angle \[rad\] of
    /// the sensor at the second pose in its frame at the first.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        ids: [VariableId; 3],
        measured: [f64; 3],
        information: &Matrix3<f64>,
        convention: Convention,
    ) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { ids, measured, root: square_root(information)?, convention, tie: false })
    }
    /// The same as a tie, which robust kernels may weight down.
    #[must_use]
    pub fn as_tie(mut self, tie: bool) -> Self {
        self.tie = tie;
        self
    }
    /// The two poses of the vehicle.
    #[must_use]
    pub fn poses(&self) -> [VariableId; 2] {
        [self.ids[0], self.ids[1]]
    }
}

/// Product of two poses.
fn compose(a: &[f64], b: &[f64]) -> [f64; 3] {
    let t = turn(a[2]) * Vector2::new(b[0], b[1]);
    [a[0] + t.x, a[1] + t.y, wrap(a[2] + b[2])]
}

impl Factor for MountedBetween2 {
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
        "link of submaps"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let mount = values.get(self.ids[2]);
        let a = compose(values.get(self.ids[0]), mount);
        let b = compose(values.get(self.ids[1]), mount);
        let relation = Relation::new(&a, &b, &self.measured, self.convention);
        residual.copy_from_slice((self.root * relation.error).as_slice());
        if let Some(jacobian) = jacobian {
            let [by_a, by_b] = relation.derivatives();
            // what a move of the vehicle, in its frame, is of the sensor, in its own: Ad(M⁻¹)
            let back = turn(-mount[2]);
            let swing = back * perpendicular(&Vector2::new(mount[0], mount[1]));
            let of_vehicle =
                Matrix3::new(back[(0, 0)], back[(0, 1)], swing.x, back[(1, 0)], back[(1, 1)], swing.y, 0.0, 0.0, 1.0);
            put(jacobian, 9, 0, &(self.root * by_a * of_vehicle));
            put(jacobian, 9, 3, &(self.root * by_b * of_vehicle));
            put(jacobian, 9, 6, &(self.root * (by_a + by_b)));
        }
    }
}
