//! A trajectory: poses of the IMU over time, with their sigmas where they are known.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::frames::map_from_ned;

/// What the three numbers of a position are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PositionFrame {
    /// Latitude \[rad\], longitude \[rad\], ellipsoidal height \[m\].
    Geodetic,
    /// Easting, northing, height \[m\] of the strips' coordinate reference system.
    Map,
}

/// One-sigma accuracy of a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSigma {
    /// North, east, down \[m\].
    pub position_ned_m: Vector3<f64>,
    /// North, east, down \[m/s\].
    pub velocity_ned_mps: Vector3<f64>,
    /// Roll, pitch, heading \[rad\].
    pub attitude_rph_rad: Vector3<f64>,
}

/// A pose in the map frame at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Easting, northing, height \[m\] (or geodetic, as the trajectory's [`PositionFrame`] says).
    pub position: Vector3<f64>,
    /// Rotation from body to north-east-down.
    pub ned_from_body: UnitQuaternion<f64>,
    /// Turns short north-east-down vectors into map axes: convergence and scale of the projection.
    pub map_from_ned: Matrix3<f64>,
}

impl Pose {
    /// The body vector \[m\] from the IMU to a point given in the map frame: `l = Cᵀ (x - p)`.
    #[must_use]
    pub fn body_vector_m(&self, point_map_m: &Vector3<f64>) -> Vector3<f64> {
        self.ned_from_body.inverse_transform_vector(&self.ned_vector_m(point_map_m))
    }

    /// The north-east-down vector \[m\] from the IMU to a point given in the map frame.
    #[must_use]
    pub fn ned_vector_m(&self, point_map_m: &Vector3<f64>) -> Vector3<f64> {
        let d = point_map_m - self.position;
        // map_from_ned is a similarity in the plane: its inverse is its transpose over the squared scale.
        let k2 = self.map_from_ned[(0, 0)].powi(2) + self.map_from_ned[(0, 1)].powi(2);
        let t = self.map_from_ned.transpose() * d;
        Vector3::new(t.x / k2, t.y / k2, t.z)
    }
}

/// Why a trajectory cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrajectoryError {
    /// Fewer than two epochs.
    #[error("a trajectory needs at least two epochs, this one has {found}")]
    TooShort {
        /// Epochs found.
        found: usize,
    },
    /// Times do not increase.
    #[error(
        "time stands still or runs backwards at record {record}: {time_s} s after {previous_s} s; sort the file or remove the duplicate"
    )]
    TimeNotIncreasing {
        /// 0-based record.
        record: usize,
        /// Its time.
        time_s: f64,
        /// The time before.
        previous_s: f64,
    },
    /// A number is not finite.
    #[error("record {record} holds a value that is not a number ({column})")]
    NotFinite {
        /// 0-based record.
        record: usize,
        /// Which column.
        column: &'static str,
    },
    /// Columns of different length.
    #[error("column {column} has {found} rows where {expected} were due")]
    ColumnLength {
        /// Which column.
        column: &'static str,
        /// Rows found.
        found: usize,
        /// Rows due.
        expected: usize,
    },
}

/// Poses over time, in columns. Construct with [`Trajectory::new`], which checks it.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    frame: PositionFrame,
    time_s: Vec<f64>,
    position: Vec<Vector3<f64>>,
    ned_from_body: Vec<UnitQuaternion<f64>>,
    velocity_ned_mps: Vec<Vector3<f64>>,
    sigma: Vec<PoseSigma>,
    grid: Vec<(f64, f64)>,
}

impl Trajectory {
    /// A trajectory of columns of equal length, time strictly increasing.
    ///
    /// `velocity_ned_mps` may be empty: it is then differenced from the positions when they are in the map frame.
    ///
    /// # Errors
    /// [`TrajectoryError`] names the first record that is wrong.
    pub fn new(
        frame: PositionFrame,
        time_s: Vec<f64>,
        position: Vec<Vector3<f64>>,
        ned_from_body: Vec<UnitQuaternion<f64>>,
        velocity_ned_mps: Vec<Vector3<f64>>,
    ) -> Result<Self, TrajectoryError> {
        let n = time_s.len();
        if n < 2 {
            return Err(TrajectoryError::TooShort { found: n });
        }
        for (column, found) in [
            ("position", position.len()),
            ("attitude", ned_from_body.len()),
            ("velocity", if velocity_ned_mps.is_empty() { n } else { velocity_ned_mps.len() }),
        ] {
            if found != n {
                return Err(TrajectoryError::ColumnLength { column, found, expected: n });
            }
        }
        for record in 0..n {
            if !time_s[record].is_finite() {
                return Err(TrajectoryError::NotFinite { record, column: "time" });
            }
            if !position[record].iter().all(|v| v.is_finite()) {
                return Err(TrajectoryError::NotFinite { record, column: "position" });
            }
            if !ned_from_body[record].coords.iter().all(|v| v.is_finite()) {
                return Err(TrajectoryError::NotFinite { record, column: "attitude" });
            }
            if record > 0 && time_s[record] <= time_s[record - 1] {
                return Err(TrajectoryError::TimeNotIncreasing {
                    record,
                    time_s: time_s[record],
                    previous_s: time_s[record - 1],
                });
            }
        }
        Ok(Self { frame, time_s, position, ned_from_body, velocity_ned_mps, sigma: Vec::new(), grid: Vec::new() })
    }

    /// The same trajectory with one sigma per epoch.
    ///
    /// # Errors
    /// [`TrajectoryError::ColumnLength`] when there is not one for each epoch.
    pub fn with_sigma(mut self, sigma: Vec<PoseSigma>) -> Result<Self, TrajectoryError> {
        if sigma.len() != self.len() {
            return Err(TrajectoryError::ColumnLength { column: "sigma", found: sigma.len(), expected: self.len() });
        }
        self.sigma = sigma;
        Ok(self)
    }

    /// The same trajectory with convergence \[rad\] and scale of the map projection at each epoch.
    ///
    /// # Errors
    /// [`TrajectoryError::ColumnLength`] when there is not one for each epoch.
    pub fn with_grid(mut self, grid: Vec<(f64, f64)>) -> Result<Self, TrajectoryError> {
        if grid.len() != self.len() {
            return Err(TrajectoryError::ColumnLength { column: "grid", found: grid.len(), expected: self.len() });
        }
        self.grid = grid;
        Ok(self)
    }

    /// Number of epochs; never below two.
    #[must_use]
    #[allow(clippy::len_without_is_empty)] // never empty by construction
    pub fn len(&self) -> usize {
        self.time_s.len()
    }
    /// What the positions are.
    #[must_use]
    pub fn frame(&self) -> PositionFrame {
        self.frame
    }
    /// Survey times \[s\], strictly increasing.
    #[must_use]
    pub fn time_s(&self) -> &[f64] {
        &self.time_s
    }
    /// Positions, see [`PositionFrame`].
    #[must_use]
    pub fn position(&self) -> &[Vector3<f64>] {
        &self.position
    }
    /// Attitudes.
    #[must_use]
    pub fn ned_from_body(&self) -> &[UnitQuaternion<f64>] {
        &self.ned_from_body
    }
    /// Velocities north, east, down \[m/s\]; empty when the source had none.
    #[must_use]
    pub fn velocity_ned_mps(&self) -> &[Vector3<f64>] {
        &self.velocity_ned_mps
    }
    /// Sigmas; empty when unknown.
    #[must_use]
    pub fn sigma(&self) -> &[PoseSigma] {
        &self.sigma
    }
    /// Convergence \[rad\] and scale at each epoch; empty when they are 0 and 1.
    #[must_use]
    pub fn grid(&self) -> &[(f64, f64)] {
        &self.grid
    }
    /// First and last time \[s\].
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        (self.time_s[0], self.time_s[self.len() - 1])
    }

    /// Index of the epoch that starts the interval holding `time_s`, kept inside `0..len - 1`.
    #[must_use]
    pub fn interval(&self, time_s: f64) -> usize {
        self.time_s.partition_point(|&t| t <= time_s).clamp(1, self.len() - 1) - 1
    }

    /// Pose of epoch `index`.
    #[must_use]
    pub fn epoch(&self, index: usize) -> Pose {
        let (convergence_rad, scale) = self.grid.get(index).copied().unwrap_or((0.0, 1.0));
        Pose {
            time_s: self.time_s[index],
            position: self.position[index],
            ned_from_body: self.ned_from_body[index],
            map_from_ned: map_from_ned(convergence_rad, scale),
        }
    }

    /// Pose at a time \[s\]: positions linear, attitude by the shortest arc; `None` outside the time span
    /// (a millisecond of extrapolation is allowed for rounded stamps).
    #[must_use]
    pub fn pose_at(&self, time_s: f64) -> Option<Pose> {
        let (first, last) = self.span_s();
        if !(time_s >= first - 1e-3 && time_s <= last + 1e-3) {
            return None;
        }
        let i = self.interval(time_s);
        let (a, b) = (self.epoch(i), self.epoch(i + 1));
        let u = (time_s - a.time_s) / (b.time_s - a.time_s);
        let angle = a.ned_from_body.angle_to(&b.ned_from_body);
        let ned_from_body = if angle < 1e-12 {
            a.ned_from_body
        } else {
            a.ned_from_body.try_slerp(&b.ned_from_body, u, 1e-9).unwrap_or(a.ned_from_body)
        };
        Some(Pose {
            time_s,
            position: a.position + (b.position - a.position) * u,
            ned_from_body,
            map_from_ned: a.map_from_ned + (b.map_from_ned - a.map_from_ned) * u,
        })
    }

    /// Sigma at a time \[s\], linear between epochs; `None` when the trajectory has none.
    #[must_use]
    pub fn sigma_at(&self, time_s: f64) -> Option<PoseSigma> {
        if self.sigma.is_empty() {
            return None;
        }
        let i = self.interval(time_s);
        let u = ((time_s - self.time_s[i]) / (self.time_s[i + 1] - self.time_s[i])).clamp(0.0, 1.0);
        let (a, b) = (&self.sigma[i], &self.sigma[i + 1]);
        let mix = |x: &Vector3<f64>, y: &Vector3<f64>| x + (y - x) * u;
        Some(PoseSigma {
            position_ned_m: mix(&a.position_ned_m, &b.position_ned_m),
            velocity_ned_mps: mix(&a.velocity_ned_mps, &b.velocity_ned_mps),
            attitude_rph_rad: mix(&a.attitude_rph_rad, &b.attitude_rph_rad),
        })
    }

    /// The same trajectory with every time shifted by `shift_s` \[s\].
    #[must_use]
    pub fn shifted_in_time(mut self, shift_s: f64) -> Self {
        for t in &mut self.time_s {
            *t += shift_s;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::ned_from_body;

    fn two_epochs() -> Trajectory {
        Trajectory::new(
            PositionFrame::Map,
            vec![10.0, 11.0],
            vec![Vector3::new(500_000.0, 5_000_000.0, 900.0), Vector3::new(500_060.0, 5_000_000.0, 902.0)],
            vec![ned_from_body(0.0, 0.0, 0.0), ned_from_body(0.0, 0.0, 0.2)],
            Vec::new(),
        )
        .expect("two good epochs")
    }

    #[test]
    fn a_pose_between_two_epochs_lies_between_them() {
        let pose = two_epochs().pose_at(10.5).expect("inside");
        assert!((pose.position - Vector3::new(500_030.0, 5_000_000.0, 901.0)).norm() < 1e-9);
        assert!((pose.ned_from_body.euler_angles().2 - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_time_outside_the_trajectory_has_no_pose() {
        assert!(two_epochs().pose_at(11.5).is_none());
        assert!(two_epochs().pose_at(f64::NAN).is_none());
    }

    #[test]
    fn the_body_vector_of_a_point_leads_back_to_the_point() {
        let trajectory = two_epochs().with_grid(vec![(0.02, 0.9996), (0.021, 0.9997)]).expect("two rows");
        let pose = trajectory.pose_at(10.3).expect("inside");
        let point = Vector3::new(500_300.0, 4_999_800.0, 12.0);
        let l = pose.body_vector_m(&point);
        let back = pose.position + pose.map_from_ned * (pose.ned_from_body * l);
        assert!((back - point).norm() < 1e-6);
    }

    #[test]
    fn time_that_runs_backwards_is_named_with_its_record() {
        let error = Trajectory::new(
            PositionFrame::Map,
            vec![1.0, 1.0],
            vec![Vector3::zeros(); 2],
            vec![UnitQuaternion::identity(); 2],
            Vec::new(),
        )
        .expect_err("a duplicate time");
        assert!(matches!(error, TrajectoryError::TimeNotIncreasing { record: 1, .. }));
    }
}
