//! Earth, frames, time, trajectories, and the observation types that tieline's estimators consume.
//!
//! This crate stands on the ground floor: it never sees a point cloud and never opens a file.
//!
//! | module | holds |
//! |---|---|
//! | [`earth`] | the ellipsoid: radii of curvature, geodetic and Cartesian coordinates |
//! | [`frames`] | body, navigation and map frames; rotations between them |
//! | [`time`] | GPS time, the two encodings of LAS files, the survey clock |
//! | [`trajectory`] | [`Trajectory`]: poses over time with their sigmas |
//! | [`correction`] | [`Correction`]: the difference of two trajectories over time |
//! | [`observation`] | [`TieObservation`]: everything an estimator needs to use a tie |

pub mod correction;
pub mod earth;
pub mod frames;
pub mod observation;
pub mod time;
pub mod trajectory;

pub use correction::{Correction, CorrectionRow};
pub use frames::{map_from_ned, ned_from_body};
pub use observation::{TieEnd, TieKind, TieObservation};
pub use time::{GpsTime, SurveyClock, TimeEncoding};
pub use trajectory::{Pose, PoseSigma, PositionFrame, Trajectory, TrajectoryError};
