//! Simulated drives of a mobile mapping system with known truth.
//!
//! A [`DriveScenario`] (TOML with a table `[drive]`) says through which streets is driven and with which sensors;
//! [`simulate_drive`] writes the survey as a user would receive it, and apart from it, in `truth/`, what a user never has.
//!
//! With `s` a scanner, `C` the rotation from body to north-east-down, `d` the beam, and a pulse stamped `t`:
//!
//! ```text
//! true point       x = p(t + τ) + C(t + τ) [ a_s + R(b_s) R0_s d ρ ]        ρ the way to the first surface
//! delivered point  x = p'(t) + C'(t) [ a'_s + R0_s d (ρ + bias_s(ρ) + bias_s(incidence) + bias_s(intensity) + noise) ]
//! ```
//!
//! `p'`, `C'` are not invented: they are what [`tieline_filter::Smoother`] makes of the simulated IMU, GNSS and odometer.
//!
//! | module | holds |
//! |---|---|
//! | [`scenario`], [`scene_options`], [`sensor_options`], `check` | the TOML file, and whether it makes sense |
//! | `axis`, `network` | streets as lines, and as a surface with curbs |
//! | `motion` | how they are driven |
//! | [`scene`] | everything a laser meets there |
//! | [`sensor`] | a profile scanner and its errors |
//! | `navigation` | IMU, GNSS, odometer, and the smoother's trajectory |
//! | [`survey`], `returns` | echoes, block by block, the same for any number of threads |
//! | [`output`] | the files |

mod axis;
mod check;
mod errors;
mod motion;
mod navigation;
mod network;
pub mod output;
mod returns;
pub mod scenario;
pub mod scene;
pub mod scene_options;
pub mod sensor;
pub mod sensor_options;
pub mod survey;

pub use errors::errors_at;
pub use output::{DriveReport, simulate_drive};
pub use scenario::DriveScenario;
pub use survey::DriveSurvey;
