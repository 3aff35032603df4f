//! Measurements of a navigation box: inertial increments or rates, GNSS fixes, odometer, known points.
//!
//! | module | holds |
//! |---|---|
//! | [`imu`] | inertial measurements: KF-GINS text, text with a column pattern, binary |
//! | [`gnss`] | GNSS fixes: RTKLIB `.pos`, KF-GINS text, CSV |
//! | [`odometer`] | speed over time |
//! | [`points`] | known points: coordinate updates |
//!
//! Every reader goes through its file once, line by line or record by record, plain or gzipped, and answers with the
//! measurements in the units of the workspace, how their times are to be read, and notes on everything it changed.
//!
//! ```no_run
//! use tieline_io::measurements::{GnssReadOptions, ImuReadOptions, read_gnss, read_imu};
//! let imu = read_imu("imu.txt.gz".as_ref(), &ImuReadOptions::default())?;
//! let gnss = read_gnss("rover.pos".as_ref(), &GnssReadOptions::default())?;
//! println!("{} samples, {} fixes", imu.imu.samples().len(), gnss.fixes.len());
//! # Ok::<(), tieline_io::measurements::MeasurementFileError>(())
//! ```

mod column;
mod error;
mod geodetic;
pub mod gnss;
pub mod imu;
pub mod odometer;
pub mod points;
mod table;
mod timeline;

pub use crate::trajectory::Place;
pub use error::MeasurementFileError;
pub use gnss::{GnssFile, GnssFormat, GnssReadOptions, read_gnss};
pub use imu::{Axes, AxesError, ImuFile, ImuFormat, ImuKind, ImuReadOptions, read_imu};
pub use odometer::{OdometerFile, read_odometer};
pub use points::{PointsFile, read_points};
