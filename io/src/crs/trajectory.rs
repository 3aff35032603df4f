//! Trajectories into the map frame and back.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use tieline_filter::earth::ned_from_ecef;
use tieline_filter::{PositionFrame, Trajectory};

use super::error::CrsError;
use super::projection::{Crs, CrsKind};

/// Convergence and scale are evaluated anew after this way \[m\]; the first-order expansion between is good to
/// (way / earth radius)² = 2.5e-10.
const GRID_SPACING_M: f64 = 100.0;

impl Crs {
    /// A trajectory in map coordinates, with convergence and scale at each epoch.
    ///
    /// Geodetic positions are converted; heights stay ellipsoidal (less the undulation, where one was given). For a
    /// projected system attitude and velocity keep counting from true north, and convergence and scale (at the
    /// place's height) go into [`Trajectory::grid`]. For a local system they are turned into the axes at the origin: there
    /// the grid is empty. Map positions stay, and are given their grid where it is missing.
    ///
    /// # Errors
    /// [`CrsError`] when the system is geographic, has no origin, or cannot hold a position.
    pub fn to_map(&self, trajectory: &Trajectory) -> Result<Trajectory, CrsError> {
        match (trajectory.frame(), self.kind) {
            (_, CrsKind::Geographic) => Err(self.geographic()),
            (PositionFrame::Map, CrsKind::Local) => Ok(trajectory.clone()),
            (PositionFrame::Map, CrsKind::Projected) => {
                if !trajectory.grid().is_empty() {
                    return Ok(trajectory.clone());
                }
                let map = trajectory.position();
                let grid = self.grid_along(map, |index| self.geodetic_from_map(&map[index]))?;
                Ok(trajectory.clone().with_grid(grid)?)
            }
            (PositionFrame::Geodetic, CrsKind::Projected) => {
                let geodetic = trajectory.position();
                let map = geodetic.iter().map(|g| self.map_from_geodetic(g)).collect::<Result<Vec<_>, _>>()?;
                let grid = self.grid_along(&map, |index| Ok(geodetic[index]))?;
                Ok(rebuild(trajectory, PositionFrame::Map, map, None)?.with_grid(grid)?)
            }
            (PositionFrame::Geodetic, CrsKind::Local) => {
                let origin = self.origin.ok_or(CrsError::NoOrigin)?;
                let map = trajectory.position().iter().map(|g| self.map_from_geodetic(g));
                let map = map.collect::<Result<Vec<_>, _>>()?;
                let turn = |index: usize| {
                    let g = trajectory.position()[index];
                    origin.ned_from_ecef * ned_from_ecef(g.x, g.y).transpose()
                };
                rebuild(trajectory, PositionFrame::Map, map, Some(&turn))
            }
        }
    }

    /// As [`Crs::to_map`] for a map trajectory whose headings count from grid north: the convergence is added to them.
    ///
    /// # Errors
    /// As [`Crs::to_map`].
    pub fn to_map_from_grid_heading(&self, trajectory: &Trajectory) -> Result<Trajectory, CrsError> {
        let map = self.to_map(trajectory)?;
        if map.grid().is_empty() {
            return Ok(map);
        }
        let grid = map.grid().to_vec();
        let turn = |index: usize| *Rotation3::from_axis_angle(&Vector3::z_axis(), grid[index].0).matrix();
        let turned = rebuild(&map, PositionFrame::Map, map.position().to_vec(), Some(&turn))?;
        Ok(turned.with_grid(grid)?)
    }

    /// The geodetic trajectory of a map trajectory; the inverse of [`Crs::to_map`].
    ///
    /// # Errors
    /// As [`Crs::to_map`].
    pub fn to_geodetic(&self, trajectory: &Trajectory) -> Result<Trajectory, CrsError> {
        if trajectory.frame() == PositionFrame::Geodetic {
            return Ok(trajectory.clone());
        }
        let geodetic = trajectory.position().iter().map(|map| self.geodetic_from_map(map));
        let geodetic = geodetic.collect::<Result<Vec<_>, _>>()?;
        let Some(origin) = self.origin else { return rebuild(trajectory, PositionFrame::Geodetic, geodetic, None) };
        let turn = |index: usize| {
            let g = &geodetic[index];
            ned_from_ecef(g.x, g.y) * origin.ned_from_ecef.transpose()
        };
        rebuild(trajectory, PositionFrame::Geodetic, geodetic.clone(), Some(&turn))
    }

    /// Convergence \[rad\] and scale at each map position; `geodetic` of an index is asked where they are evaluated.
    fn grid_along(
        &self,
        map: &[Vector3<f64>],
        geodetic: impl Fn(usize) -> Result<Vector3<f64>, CrsError>,
    ) -> Result<Vec<(f64, f64)>, CrsError> {
        let mut node: Option<GridNode> = None;
        let mut grid = Vec::with_capacity(map.len());
        for (index, position) in map.iter().enumerate() {
            let near = node.as_ref().filter(|node| (position - node.position).xy().norm() < GRID_SPACING_M);
            let value = match near {
                Some(node) => node.at(position),
                None => {
                    let fresh = GridNode::new(self, *position, &geodetic(index)?)?;
                    let value = fresh.at(position);
                    node = Some(fresh);
                    value
                }
            };
            grid.push(value);
        }
        Ok(grid)
    }
}

/// Convergence and scale about a place, to first order in the map coordinates and the height.
struct GridNode {
    position: Vector3<f64>,
    convergence_rad: f64,
    scale: f64,
    convergence_gradient: Vector3<f64>,
    scale_gradient: Vector3<f64>,
}

impl GridNode {
    fn new(crs: &Crs, position: Vector3<f64>, geodetic: &Vector3<f64>) -> Result<Self, CrsError> {
        let centre = crs.grid_at(geodetic)?;
        let step_m = GRID_SPACING_M;
        let mut node = Self {
            position,
            convergence_rad: centre.convergence_rad,
            scale: centre.scale,
            convergence_gradient: Vector3::zeros(),
            scale_gradient: Vector3::zeros(),
        };
        for axis in 0..3 {
            let mut aside = position;
            aside[axis] += step_m;
            let grid = crs.grid_at(&crs.geodetic_from_map(&aside)?)?;
            node.convergence_gradient[axis] = (grid.convergence_rad - centre.convergence_rad) / step_m;
            node.scale_gradient[axis] = (grid.scale - centre.scale) / step_m;
        }
        Ok(node)
    }

    fn at(&self, position: &Vector3<f64>) -> (f64, f64) {
        let aside = position - self.position;
        (self.convergence_rad + self.convergence_gradient.dot(&aside), self.scale + self.scale_gradient.dot(&aside))
    }
}

/// Turns the navigation frame of epoch `index` of the old trajectory into that of the new one.
type Turn<'a> = &'a dyn Fn(usize) -> nalgebra::Matrix3<f64>;

/// The trajectory with other positions, attitude and velocity turned where asked; sigmas and times stay.
fn rebuild(
    trajectory: &Trajectory,
    frame: PositionFrame,
    position: Vec<Vector3<f64>>,
    turn: Option<Turn<'_>>,
) -> Result<Trajectory, CrsError> {
    let mut attitude = trajectory.ned_from_body().to_vec();
    let mut velocity = trajectory.velocity_ned_mps().to_vec();
    if let Some(turn) = turn {
        for (index, q) in attitude.iter_mut().enumerate() {
            let matrix = turn(index);
            *q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)) * *q;
            if let Some(v) = velocity.get_mut(index) {
                *v = matrix * *v;
            }
        }
    }
    let rebuilt = Trajectory::new(frame, trajectory.time_s().to_vec(), position, attitude, velocity)?;
    match trajectory.sigma().is_empty() {
        true => Ok(rebuilt),
        false => Ok(rebuilt.with_sigma(trajectory.sigma().to_vec())?),
    }
}
