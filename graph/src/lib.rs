//! The batch adjustment of strips: corrections of the trajectory over time and of the mounting, from ties.
//!
//! | module | holds |
//! |---|---|
//! | [`georeference`] | the georeferencing equation: how a correction moves a point, and its derivatives |
//! | [`basis`] | corrections over time: constant, linear, cubic spline |
//! | [`model`] | unknowns, their priors, their order |
//! | [`observation`] | a surface line as the adjustment sees it |
//! | [`normal`] | normal equations, sparse Cholesky, covariance |
//! | [`adjust`] | robust weights, outlier test, variance components |
//! | [`observability`] | what the geometry cannot separate |
//!
//! This crate never sees a point cloud and never opens a file.

pub mod adjust;
pub mod basis;
pub mod georeference;
pub mod model;
pub mod normal;
pub mod observability;
pub mod observation;

pub use adjust::{AdjustOptions, Adjustment, AdjustmentError, EndResult, adjust};
pub use basis::{Basis, TimeModel};
pub use georeference::{Calibration, PointMap, PoseCorrection};
pub use model::{CalibrationSigmas, CalibrationTerms, Model, Parameter, ParameterBlock, StripSpec};
pub use observability::{Observability, Unobservable};
pub use observation::{Line, LineEnd};
