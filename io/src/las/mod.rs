//! LAS 1.0 to 1.4, LAZ and COPC: read in chunks and columns, rewritten with every byte of a record kept.
//!
//! | type | is |
//! |---|---|
//! | [`LasFile`] | an input file, checked on opening, read chunk by chunk by any thread |
//! | [`LasHeader`], [`RecordLayout`] | what it says about itself; where the fields of a record lie |
//! | [`Columns`] | the attributes of a block of points |
//! | [`guess_time`] | which GPS time a file holds |
//! | [`rewrite`] | a file again with other coordinates, everything else as it was |
//! | [`LasWriter`] | new files |

mod bytes;
mod chunks;
mod codec;
mod columns;
mod crs_records;
mod error;
mod file;
mod header;
mod input;
mod layout;
mod new_file;
mod quantise;
mod rewrite;
mod sink;
mod time;
mod vlr;
mod write;

pub use columns::{Columns, FLAG_KEY_POINT, FLAG_OVERLAP, FLAG_SYNTHETIC, FLAG_WITHHELD};
pub use crs_records::GeoKeys;
pub use error::LasError;
pub use file::LasFile;
pub use header::LasHeader;
pub use layout::RecordLayout;
pub use new_file::{ExtraBytes, LasWriterOptions, VariableRecord};
pub use quantise::{output_offset, output_scale};
pub use rewrite::{EditError, RewriteOptions, RewriteReport, rewrite};
pub use time::{TimeGuess, guess_from_times, guess_time};
pub use vlr::VlrSummary;
pub use write::LasWriter;
