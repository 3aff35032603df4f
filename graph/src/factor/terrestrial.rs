//! Terrestrial observations: distance, direction, angle, azimuth, levelled height difference, known coordinates.
//!
//! Coordinates are plane: x, y. A direction or azimuth is counted from the x axis towards the y axis: with x north and
//! y east that is the bearing. Formulas: Ghilani, Adjustment Computations, ch. 14-16.

use nalgebra::{SMatrix, Vector2};

use super::{Factor, NotPositiveDefinite, put, square_root};
use crate::variable::{Values, VariableId, wrap};

/// Direction of a line and its derivatives by the end point (by the start point with the other sign).
fn bearing(values: &Values, from: VariableId, to: VariableId) -> (f64, Vector2<f64>) {
    let d = values.xy(to) - values.xy(from);
    let square = d.norm_squared().max(1e-12);
    (d.y.atan2(d.x), Vector2::new(-d.y / square, d.x / square))
}

/// Coordinates known beforehand: control, or the place of a pose.
#[derive(Debug, Clone)]
pub struct Known<const N: usize> {
    id: [VariableId; 1],
    measured: [f64; N],
    root: SMatrix<f64, N, N>,
}

impl<const N: usize> Known<N>
where
    nalgebra::Const<N>: nalgebra::DimMin<nalgebra::Const<N>, Output = nalgebra::Const<N>>,
{
    /// The first `N` numbers of the variable and their information.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn new(
        id: VariableId,
        measured: [f64; N],
        information: &SMatrix<f64, N, N>,
    ) -> Result<Self, NotPositiveDefinite> {
        Ok(Self { id: [id], measured, root: square_root(information)? })
    }
}

impl<const N: usize> Factor for Known<N> {
    fn variables(&self) -> &[VariableId] {
        &self.id
    }
    fn rows(&self) -> usize {
        N
    }
    fn label(&self) -> &'static str {
        "known coordinates"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let v = values.get(self.id[0]);
        let d = SMatrix::<f64, N, 1>::from_fn(|r, _| v[r] - self.measured[r]);
        residual.copy_from_slice((self.root * d).as_slice());
        if let Some(jacobian) = jacobian {
            let kind = values.kind(self.id[0]);
            let columns = kind.dimension();
            // the place of a pose is corrected in the pose's own frame
            let turned: SMatrix<f64, N, N> = match kind {
                crate::Kind::Pose2 => {
                    let t = crate::rotation::turn(v[2]);
                    SMatrix::from_fn(|r, c| t[(r, c)])
                }
                crate::Kind::Pose3 => {
                    let t = values.rotation(self.id[0]).to_rotation_matrix();
                    SMatrix::from_fn(|r, c| t.matrix()[(r, c)])
                }
                _ => SMatrix::identity(),
            };
            put(jacobian, columns, 0, &(self.root * turned));
        }
    }
}

/// Horizontal distance of two points.
#[derive(Debug, Clone)]
pub struct Distance {
    ids: [VariableId; 2],
    measured_m: f64,
    weight: f64,
}

impl Distance {
    /// `sigma_m`: standard deviation \[m\].
    #[must_use]
    pub fn new(ids: [VariableId; 2], measured_m: f64, sigma_m: f64) -> Self {
        Self { ids, measured_m, weight: 1.0 / sigma_m }
    }
}

impl Factor for Distance {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        1
    }
    fn label(&self) -> &'static str {
        "distance"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let d = values.xy(self.ids[1]) - values.xy(self.ids[0]);
        let length = d.norm().max(1e-9);
        residual[0] = self.weight * (length - self.measured_m);
        if let Some(jacobian) = jacobian {
            let u = d * (self.weight / length);
            jacobian.copy_from_slice(&[-u.x, -u.y, u.x, u.y]);
        }
    }
}

/// A direction of a set: bearing less the orientation unknown of the set.
#[derive(Debug, Clone)]
pub struct Direction {
    /// Station, target, orientation unknown.
    ids: [VariableId; 3],
    measured_rad: f64,
    weight: f64,
}

impl Direction {
    /// `ids`: station, target, orientation unknown (a scalar, the bearing of the circle's zero).
    #[must_use]
    pub fn new(ids: [VariableId; 3], measured_rad: f64, sigma_rad: f64) -> Self {
        Self { ids, measured_rad, weight: 1.0 / sigma_rad }
    }
    /// What was measured \[rad\].
    #[must_use]
    pub fn measured_rad(&self) -> f64 {
        self.measured_rad
    }
}

impl Factor for Direction {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        1
    }
    fn label(&self) -> &'static str {
        "direction"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let (angle, by_target) = bearing(values, self.ids[0], self.ids[1]);
        residual[0] = self.weight * wrap(angle - values.scalar(self.ids[2]) - self.measured_rad);
        if let Some(jacobian) = jacobian {
            let d = by_target * self.weight;
            jacobian.copy_from_slice(&[-d.x, -d.y, d.x, d.y, -self.weight]);
        }
    }
}

/// A bearing in the map.
#[derive(Debug, Clone)]
pub struct Azimuth {
    ids: [VariableId; 2],
    measured_rad: f64,
    weight: f64,
}

impl Azimuth {
    /// `ids`: station, target.
    #[must_use]
    pub fn new(ids: [VariableId; 2], measured_rad: f64, sigma_rad: f64) -> Self {
        Self { ids, measured_rad, weight: 1.0 / sigma_rad }
    }
}

impl Factor for Azimuth {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        1
    }
    fn label(&self) -> &'static str {
        "azimuth"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let (angle, by_target) = bearing(values, self.ids[0], self.ids[1]);
        residual[0] = self.weight * wrap(angle - self.measured_rad);
        if let Some(jacobian) = jacobian {
            let d = by_target * self.weight;
            jacobian.copy_from_slice(&[-d.x, -d.y, d.x, d.y]);
        }
    }
}

/// An angle at a station from a backsight to a foresight.
#[derive(Debug, Clone)]
pub struct Angle {
    /// Station, backsight, foresight.
    ids: [VariableId; 3],
    measured_rad: f64,
    weight: f64,
}

impl Angle {
    /// `ids`: station, backsight, foresight.
    #[must_use]
    pub fn new(ids: [VariableId; 3], measured_rad: f64, sigma_rad: f64) -> Self {
        Self { ids, measured_rad, weight: 1.0 / sigma_rad }
    }
}

impl Factor for Angle {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        1
    }
    fn label(&self) -> &'static str {
        "angle"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let (back, by_back) = bearing(values, self.ids[0], self.ids[1]);
        let (fore, by_fore) = bearing(values, self.ids[0], self.ids[2]);
        residual[0] = self.weight * wrap(fore - back - self.measured_rad);
        if let Some(jacobian) = jacobian {
            let (b, f) = (by_back * self.weight, by_fore * self.weight);
            jacobian.copy_from_slice(&[b.x - f.x, b.y - f.y, -b.x, -b.y, f.x, f.y]);
        }
    }
}

/// A levelled height difference of two heights.
#[derive(Debug, Clone)]
pub struct HeightDifference {
    ids: [VariableId; 2],
    measured_m: f64,
    weight: f64,
}

impl HeightDifference {
    /// `ids`: from, to.
    #[must_use]
    pub fn new(ids: [VariableId; 2], measured_m: f64, sigma_m: f64) -> Self {
        Self { ids, measured_m, weight: 1.0 / sigma_m }
    }
}

impl Factor for HeightDifference {
    fn variables(&self) -> &[VariableId] {
        &self.ids
    }
    fn rows(&self) -> usize {
        1
    }
    fn label(&self) -> &'static str {
        "height difference"
    }
    fn evaluate(&self, values: &Values, residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        residual[0] = self.weight * (values.scalar(self.ids[1]) - values.scalar(self.ids[0]) - self.measured_m);
        if let Some(jacobian) = jacobian {
            jacobian.copy_from_slice(&[-self.weight, self.weight]);
        }
    }
}
