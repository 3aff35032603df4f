//! Earth, frames, time, trajectories, and the observation types that tieline's estimators consume.
//!
//! This crate stands on the ground floor: it never sees a point cloud and opens no file but an unnamed temporary one.
//!
//! | module | holds |
//! |---|---|
//! | [`earth`] | the ellipsoid: radii of curvature, geodetic and Cartesian coordinates |
//! | [`frames`] | body, navigation and map frames; rotations between them |
//! | [`time`] | GPS time, the two encodings of LAS files, the survey clock |
//! | [`trajectory`] | [`Trajectory`]: poses over time with their sigmas |
//! | [`correction`] | [`Correction`]: the difference of two trajectories over time |
//! | [`observation`] | [`TieObservation`]: everything an estimator needs to use a tie |
//! | [`imu`], [`aiding`], [`grade`] | what the smoother takes: inertial measurements, GNSS, odometer, known points |
//! | [`strapdown`] | the mechanisation |
//! | [`state`], [`transition`] | the error states and how they pass from one moment to the next |
//! | [`update`] | what each measurement predicts |
//! | [`kalman`], [`adjoint`] | the linear algebra of the filter, and of the backward pass |
//! | [`align`], [`rest`] | where the trajectory begins, when the platform stands |
//! | [`smoother`], [`solution`] | [`Smoother::run`] and what it gives |

pub mod adjoint;
pub mod aiding;
pub mod align;
pub mod backward;
pub mod correction;
mod doubt;
pub mod earth;
pub mod events;
pub mod forward;
pub mod frames;
pub mod grade;
pub mod imu;
pub mod innovation;
pub mod kalman;
mod lanes;
pub mod observation;
pub mod options;
mod propagate;
pub mod rest;
pub mod smoother;
pub mod solution;
pub mod state;
pub mod strapdown;
pub mod tape;
mod tie_plan;
pub mod time;
pub mod trajectory;
pub mod transition;
pub mod update;

pub use aiding::{FixQuality, GnssFix, GnssVelocity, KnownPoint, OdometerSample};
pub use correction::{Correction, CorrectionRow};
pub use doubt::TieFit;
pub use events::Inputs;
pub use frames::{map_from_ned, ned_from_body};
pub use grade::{ImuGrade, ImuNoise};
pub use imu::{Imu, ImuError, ImuSample};
pub use observation::{TieClass, TieEnd, TieKind, TieObservation};
pub use options::{InitialState, Options};
pub use smoother::{Smoother, SmootherError};
pub use solution::{CalibrationEstimate, Solution};
pub use strapdown::NavState;
pub use time::{GpsTime, SurveyClock, TimeEncoding};
pub use trajectory::{Pose, PoseSigma, PositionFrame, Trajectory, TrajectoryError};
pub use update::tie::{FilterTie, Sighting};
