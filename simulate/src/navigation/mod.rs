//! Simulated GNSS/INS data with known truth: what an IMU, a GNSS receiver, an odometer and a laser scanner on a moving
//! platform deliver, and, apart from it, where the platform was.
//!
//! | module | holds |
//! |---|---|
//! | [`spline`] | smooth functions of time |
//! | [`route`] | a closed road or flight path, and how fast it is driven |
//! | [`motion`] | the true motion over the ellipsoid, with the rates that an ideal IMU feels |
//! | [`inertial`] | increments of angle and velocity, ideal and with the errors of a grade |
//! | [`aiding`] | GNSS fixes and odometer readings |
//! | [`ties`] | sightings of planes: loop ties and height increments |
//! | [`scenario`] | [`NavigationScenario`]: all of it from one seed |
//!
//! The physics is written in earth-centred axes: attitude and position refer to a frame fixed to the earth, and earth
//! rate, Coriolis and gravity are all that is added. No transport rate occurs, nor any curvature: a mechanisation in
//! north-east-down that agrees has got both right.

pub mod aiding;
pub mod inertial;
pub mod motion;
pub(crate) mod process;
pub mod route;
pub mod scenario;
pub mod spline;
pub mod ties;

pub use aiding::{GnssScenario, OdometerScenario};
pub use inertial::{ImuScenario, ideal_increments};
pub use motion::Motion;
pub use route::Vehicle;
pub use scenario::{NavigationScenario, NavigationTruth, SimulatedNavigation};
pub use ties::{IncrementScenario, LoopScenario};
