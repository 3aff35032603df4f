//! The batch adjustment of strips: corrections of the trajectory over time and of the mounting, from ties.
//!
//! | module | holds |
//! |---|---|
//! | [`georeference`] | the georeferencing equation: how a correction moves a point, and its derivatives |
//! | [`basis`] | corrections over time: constant, linear, cubic spline |
//! | [`model`] | unknowns, their priors, their order |
//! | [`observation`] | a surface line as the adjustment sees it |
//! | [`mod@adjust`] | robust weights, outlier test, variance components; solved as a [`Problem`] by Helmert blocking |
//! | [`observability`] | what the geometry cannot separate |
//!
//! Graphs of any variables and factors, and their solution (pose graphs, geodetic nets, whole blocks of strips):
//!
//! | module | holds |
//! |---|---|
//! | [`problem`], [`variable`], [`factor`] | the graph: variables, factors, one trait for types of one's own |
//! | [`linear`] | nodes, block normal equations, the reference solver |
//! | [`helmert`] | Helmert blocking: partition, elimination in memory and on disk, selected inverse |
//! | [`system`], [`nonlinear`] | from a problem to its solution |
//! | [`free_net`] | small nets, datum defect, inner constraints |
//! | [`undetermined`] | what the observations leave undetermined, named |
//! | [`registration`] | relative pose of two submaps by common points |
//! | [`bowie`] | junctions and sections |
//! | [`covariance`] | covariances, redundancies, reliability |
//! | [`initialise`] | first values: chordal rotations, linear translations |
//! | [`robust`], [`snooping`] | kernels of ties; tests by redundancy |
//! | [`rotation`] | Jacobians of rotations and rigid motions |
//!
//! This crate never sees a point cloud and never opens a file.

pub mod adjust;
pub mod basis;
pub mod bowie;
pub mod covariance;
pub mod factor;
pub mod free_net;
pub mod georeference;
pub mod helmert;
pub mod incremental;
pub mod initialise;
pub mod linear;
pub mod model;
pub mod nonlinear;
pub mod observability;
pub mod observation;
pub mod problem;
pub mod registration;
pub mod robust;
pub mod rotation;
pub mod snooping;
pub mod system;
pub mod undetermined;
pub mod variable;

pub use adjust::{AdjustOptions, Adjustment, AdjustmentError, EndResult, adjust};
pub use basis::{Basis, TimeModel};
pub use georeference::{Calibration, PointMap, PoseCorrection};
pub use model::{CalibrationSigmas, CalibrationTerms, Model, Parameter, ParameterBlock, StripSpec};
pub use observability::{Observability, Unobservable};
pub use observation::{EndPart, Line, LineEnd};
pub use problem::Problem;
pub use variable::{Kind, Values, VariableId};
