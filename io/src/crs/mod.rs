//! Coordinate reference systems: geodetic trajectories into the map frame of the strips, and back.
//!
//! A [`Crs`] is projected (EPSG code, WKT or proj string, evaluated by `proj4rs`), local (east-north-up about an
//! origin) or geographic (degrees: named, and refused with a remedy). Rules:
//!
//! - **Heights stay as they are.** Ellipsoidal heights go in and come out; no geoid model is ever applied silently.
//!   Where the strips have other heights than the trajectory, [`Crs::with_geoid_undulation_m`] takes a constant off.
//! - The vertical part of a compound CRS is kept as a name, nothing more.
//! - Map axes are always easting, northing, up in metres, whatever axis order the definition prefers.
//! - Seven-parameter shifts (`towgs84`) of the definition are applied; shift grids are not.
//!
//! ```
//! use nalgebra::Vector3;
//! use tieline_io::crs::Crs;
//! let utm = Crs::parse("EPSG:25832")?;
//! let map = utm.map_from_geodetic(&Vector3::new(55_f64.to_radians(), 12_f64.to_radians(), 40.0))?;
//! assert!((map - Vector3::new(691_875.632, 6_098_907.825, 40.0)).norm() < 1e-3);
//! # Ok::<(), tieline_io::crs::CrsError>(())
//! ```

mod error;
mod grid;
mod parse;
mod projection;
mod trajectory;
mod wkt;

pub use error::CrsError;
pub use grid::GridPoint;
pub use projection::{Crs, CrsKind};
