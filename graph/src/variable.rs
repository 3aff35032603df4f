//! Variables of a graph and their values.
//!
//! A variable has a kind; the kind says how many numbers store it and how many it is corrected by (its tangent).
//! Poses are corrected in their own frame: `t ← t + R δt`, `R ← R exp(δθ)`.

use std::sync::Arc;

use nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};

/// Name of a variable inside a [`crate::Problem`]: its index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VariableId(pub u32);

impl VariableId {
    /// As an index.
    #[must_use]
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// What a variable is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Pose in the plane: x, y \[m\], heading \[rad\].
    Pose2,
    /// Pose in space: x, y, z \[m\], unit quaternion x, y, z, w; tangent: translation, rotation vector.
    Pose3,
    /// Point in the plane \[m\].
    Point2,
    /// Point in space \[m\].
    Point3,
    /// Height \[m\].
    Height,
    /// One number: bias, drift rate, orientation unknown, switch.
    Scalar,
    /// Several numbers, such as the coefficients of a spline knot.
    Vector(u8),
}

impl Kind {
    /// Numbers that store it.
    #[must_use]
    pub fn storage(self) -> usize {
        if self == Self::Pose3 { 7 } else { self.dimension() }
    }
    /// Numbers that correct it.
    #[must_use]
    pub fn dimension(self) -> usize {
        match self {
            Self::Pose2 | Self::Point3 => 3,
            Self::Pose3 => 6,
            Self::Point2 => 2,
            Self::Height | Self::Scalar => 1,
            Self::Vector(n) => n as usize,
        }
    }
}

/// Values of all variables. Copies share what does not change.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Values {
    kinds: Arc<Vec<Kind>>,
    starts: Arc<Vec<u32>>,
    numbers: Vec<f64>,
}

impl Values {
    /// Number of variables.
    #[must_use]
    pub fn len(&self) -> usize {
        self.kinds.len()
    }
    /// Whether there is no variable.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.kinds.is_empty()
    }
    /// Adds a variable with its first value.
    ///
    /// # Panics
    /// When the value has not the kind's length, or beyond 2³² numbers.
    pub fn push(&mut self, kind: Kind, value: &[f64]) -> VariableId {
        assert_eq!(value.len(), kind.storage(), "numbers of a {kind:?}");
        let index = u32::try_from(self.kinds.len()).expect("fewer than 2^32 variables");
        Arc::make_mut(&mut self.starts).push(u32::try_from(self.numbers.len()).expect("fewer than 2^32 numbers"));
        Arc::make_mut(&mut self.kinds).push(kind);
        self.numbers.extend_from_slice(value);
        VariableId(index)
    }
    /// Kind of a variable.
    #[must_use]
    pub fn kind(&self, id: VariableId) -> Kind {
        self.kinds[id.index()]
    }
    /// Numbers of a variable.
    #[must_use]
    #[inline]
    pub fn get(&self, id: VariableId) -> &[f64] {
        let start = self.starts[id.index()] as usize;
        &self.numbers[start..start + self.kinds[id.index()].storage()]
    }
    /// Numbers of a variable, to be changed.
    pub fn get_mut(&mut self, id: VariableId) -> &mut [f64] {
        let start = self.starts[id.index()] as usize;
        &mut self.numbers[start..start + self.kinds[id.index()].storage()]
    }
    /// The first number of a variable.
    #[must_use]
    #[inline]
    pub fn scalar(&self, id: VariableId) -> f64 {
        self.numbers[self.starts[id.index()] as usize]
    }
    /// The first two numbers: a point in the plane, or the place of a pose in the plane.
    #[must_use]
    #[inline]
    pub fn xy(&self, id: VariableId) -> Vector2<f64> {
        let v = self.get(id);
        Vector2::new(v[0], v[1])
    }
    /// The first three numbers: a point in space, or the place of a pose in space.
    #[must_use]
    #[inline]
    pub fn xyz(&self, id: VariableId) -> Vector3<f64> {
        let v = self.get(id);
        Vector3::new(v[0], v[1], v[2])
    }
    /// Rotation of a pose in space.
    #[must_use]
    #[inline]
    pub fn rotation(&self, id: VariableId) -> UnitQuaternion<f64> {
        let v = self.get(id);
        UnitQuaternion::new_unchecked(Quaternion::new(v[6], v[3], v[4], v[5]))
    }
    /// Corrects a variable by a tangent vector.
    pub fn retract(&mut self, id: VariableId, step: &[f64]) {
        let kind = self.kind(id);
        match kind {
            Kind::Pose2 => {
                let v = self.get_mut(id);
                let (sin, cos) = v[2].sin_cos();
                v[0] += cos * step[0] - sin * step[1];
                v[1] += sin * step[0] + cos * step[1];
                v[2] = wrap(v[2] + step[2]);
            }
            Kind::Pose3 => {
                let rotation = self.rotation(id);
                let t = rotation * Vector3::new(step[0], step[1], step[2]);
                let turned = rotation * UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
                let q = UnitQuaternion::new_normalize(turned.into_inner()).into_inner();
                let v = self.get_mut(id);
                for k in 0..3 {
                    v[k] += t[k];
                }
                v[3..7].copy_from_slice(&[q.i, q.j, q.k, q.w]);
            }
            _ => self.get_mut(id).iter_mut().zip(step).for_each(|(v, d)| *v += d),
        }
    }

    /// The tangent vector that leads a variable to its value in `other`: what [`Values::retract`] undoes.
    #[must_use]
    pub fn tangent_to(&self, id: VariableId, other: &Self) -> Vec<f64> {
        let (v, o) = (self.get(id), other.get(id));
        match self.kind(id) {
            Kind::Pose2 => {
                let (sin, cos) = v[2].sin_cos();
                let (dx, dy) = (o[0] - v[0], o[1] - v[1]);
                vec![cos * dx + sin * dy, cos * dy - sin * dx, wrap(o[2] - v[2])]
            }
            Kind::Pose3 => {
                let back = self.rotation(id).inverse();
                let t = back * (other.xyz(id) - self.xyz(id));
                let r = (back * other.rotation(id)).scaled_axis();
                vec![t.x, t.y, t.z, r.x, r.y, r.z]
            }
            _ => o.iter().zip(v).map(|(o, v)| o - v).collect(),
        }
    }
}

/// An angle in (-π, π].
#[must_use]
#[inline]
pub fn wrap(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle_rad.abs() <= PI {
        return angle_rad;
    }
    let turned = angle_rad - TAU * (angle_rad / TAU).round();
    if turned <= -PI { turned + TAU } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tangent_between_two_values_leads_from_one_to_the_other() {
        let mut from = Values::default();
        let turned = UnitQuaternion::from_euler_angles(0.3, -0.2, 2.5);
        let pose2 = from.push(Kind::Pose2, &[1.0, -2.0, 3.0]);
        let pose3 = from.push(Kind::Pose3, &[1.0, 2.0, 3.0, turned.i, turned.j, turned.k, turned.w]);
        let vector = from.push(Kind::Vector(2), &[0.5, 0.6]);
        let mut to = from.clone();
        to.retract(pose2, &[0.4, 0.3, 0.9]);
        to.retract(pose3, &[0.1, 0.2, -0.3, 0.5, -0.7, 0.2]);
        to.retract(vector, &[1.0, -1.0]);
        let expected: [(VariableId, &[f64]); 3] =
            [(pose2, &[0.4, 0.3, 0.9]), (pose3, &[0.1, 0.2, -0.3, 0.5, -0.7, 0.2]), (vector, &[1.0, -1.0])];
        for (id, step) in expected {
            let found = from.tangent_to(id, &to);
            assert!(found.iter().zip(step).all(|(f, s)| (f - s).abs() < 1e-12), "{found:?}");
        }
    }
}
