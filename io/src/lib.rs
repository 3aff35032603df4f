//! Every file format of tieline: bytes in, columns and structs out; no matching, no estimation.
//!
//! | module | formats |
//! |---|---|
//! | [`las`] | LAS 1.0–1.4, LAZ, COPC (read): streaming, chunk-parallel, every byte of a record kept |
//! | [`trajectory`] | SBET, SMRMSG, TerraScan `.trj`, text with a column pattern |
//! | [`measurements`] | inertial measurements, GNSS, odometer, known points |
//! | [`crs`] | coordinate reference systems: geographic, projected, local |
//! | [`ties`] | `ties.parquet` and `ties.csv` |
//! | [`correction`] | `correction.csv` |
//! | [`network`] | geodetic nets: GNU Gama, `DynAdjust` |
//! | [`pose_graph`] | pose graphs: g2o, TORO |
//! | [`output`] | files that appear whole or not at all |

pub mod correction;
pub mod crs;
mod delimited;
pub mod extrinsics;
pub mod las;
pub mod measurements;
pub mod network;
pub mod output;
pub mod pose_graph;
pub mod ties;
pub mod trajectory;
