//! Trajectory files: SBET with its accuracy file (SMRMSG), `TerraScan` `.trj`, and text of any column order.
//!
//! | module | holds |
//! |---|---|
//! | [`sbet`] | 17 × f64 per epoch, radians, wander frame |
//! | [`smrmsg`] | 10 × f64 per epoch: accuracies, joined to a trajectory by time |
//! | [`trj`] | `TerraScan`'s 64-byte records, degrees, map coordinates |
//! | [`text`] | delimited text by column names with units, plain or gzipped |
//! | [`csv`] | tieline's own `trajectory.csv` (written here, read by [`text`]) |
//!
//! [`read`] recognises the format and answers with a [`TrajectoryFile`]; the floor below it mirrors the bytes.
//!
//! ```no_run
//! use tieline_io::trajectory::{ReadOptions, read};
//! let file = read("flight.sbet".as_ref(), &ReadOptions::default())?;
//! println!("{} epochs, {:?}", file.trajectory.len(), file.trajectory.span_s());
//! # Ok::<(), tieline_io::trajectory::TrajectoryFileError>(())
//! ```

mod column;
pub mod csv;
mod error;
mod file;
mod records;
pub mod sbet;
pub mod smrmsg;
pub mod text;
pub mod trj;
mod writer;

pub use csv::write_csv;
pub use error::{Place, TrajectoryFileError};
pub use file::{HeadingReference, ReadOptions, TrajectoryFile, TrajectoryFormat, read};
pub(crate) use records::{LATEST_ADJUSTED_S, LONGEST_WEEK_TIME_S};
pub use sbet::write_sbet;
pub use smrmsg::write_smrmsg;
pub use trj::write_trj;
pub use writer::{PieceFormat, PieceWriter};
