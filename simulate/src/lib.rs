//! Simulated surveys with known truth: flights, and [drives](drive).
//!
//! A [`Scenario`] (TOML) says what is flown over what and with which errors; [`simulate`] writes the survey as a user
//! would receive it (strips, trajectory, accuracies, project file) and, apart in `truth/`, what a user never has.
//!
//! The model is the equation of the design, with `s` a scanner and `C` the rotation from body to north-east-down:
//!
//! ```text
//! x = p + C [ a_s + R(b_s) R0_s d (rho + f_s(rho)) ],    f_s(rho) = offset + scale · rho
//! ```
//!
//! The **true** point is where the ray of the true trajectory and the true calibration meets the world; the scanner
//! measures `rho` with `true range = rho + f(rho)`, plus noise; the **delivered** point is the equation with the
//! delivered (erroneous) trajectory, the nominal calibration, no range correction, and the measured range.
//!
//! | module | holds |
//! |---|---|
//! | [`scenario`] | the TOML file: units in every key, defaults for everything |
//! | [`world`] | terrain, buildings, trees, vehicles; ray casting |
//! | [`flight`] | flight lines and the true motion |
//! | [`scanner`] | beams over time |
//! | [`truth`] | what is wrong with the delivered survey |
//! | [`survey`] | echoes: true and delivered point, block by block, the same for any number of threads |
//! | [`output`] | the files |
//! | [`drive`] | drives of a mobile mapping system through streets |
//! | [`block`] | blocks of strips with ties, for scale tests |
//! | [`net`] | geodetic nets, false loop edges |
//! | [`survey_vehicle`] | a vehicle with odometer, drifting gyro and a misaligned sensor that sights landmarks |
//! | [`navigation`] | GNSS/INS data of a moving platform, with ties |
//!
//! No estimator depends on this crate: truth cannot leak.
//!
//! ```
//! use tieline_simulate::{Scenario, Survey};
//! let survey = Survey::new(&Scenario::airborne_sample())?;
//! let echo = survey.block(0, 40)[0];
//! assert!((echo.delivered_m - echo.true_m).norm() < 0.5); // wrong, but not by much
//! # Ok::<(), tieline_simulate::SimulateError>(())
//! ```

mod any;
pub mod block;
pub mod drive;
mod error;
pub mod flight;
pub mod navigation;
pub mod net;
pub mod output;
mod presets;
mod random;
pub mod scanner;
pub mod scenario;
pub mod survey;
pub mod survey_vehicle;
pub mod truth;
pub mod world;

pub use any::AnyScenario;
pub use drive::{DriveReport, DriveScenario, DriveSurvey, simulate_drive};
pub use error::SimulateError;
pub use output::{SimulationReport, StripReport, simulate};
pub use scenario::Scenario;
pub use survey::{Echo, Survey};
pub use truth::{ScannerTruth, StripError, Truth};
