//! Tie observations in files: `ties.parquet` and `ties.csv`, one row per tie **end**, the same columns in both.
//!
//! A tie of two ends is two rows with one `tie_id`. What is not known is NaN in memory, null in Parquet and empty in
//! CSV. [`TieTable`] holds the columns, [`TieRow`] names and explains them. [`text`] is for other smoothers: only what they need. [`picked`] reads points picked by hand.
//!
//! ```
//! use tieline_io::ties::{TieRow, TieTable, read_ties, write_csv};
//! let mut table = TieTable::default();
//! table.push(&TieRow { tie_id: 7, kind: "surface_line", strip: "12", gps_time_s: 388_800.25, ..TieRow::default() });
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("ties.csv");
//! write_csv(&path, &table)?;
//! assert_eq!(read_ties(&path)?, table);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod columns;
mod csv;
mod error;
mod parquet;
pub mod picked;
mod table;
pub mod text;

pub use columns::TextColumn;
pub use csv::write_csv;
pub use error::TieFileError;
pub use parquet::write_parquet;
pub use table::{TieRow, TieTable};

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Reads `ties.parquet` or `ties.csv`, told apart by the first bytes.
///
/// # Errors
/// [`TieFileError`] names file, column and, for CSV, the line.
pub fn read_ties(path: &Path) -> Result<TieTable, TieFileError> {
    let io = |source| TieFileError::Io { path: path.to_path_buf(), source };
    let mut file = File::open(path).map_err(io)?;
    let mut magic = Vec::new();
    file.by_ref().take(4).read_to_end(&mut magic).map_err(io)?;
    match magic == b"PAR1" {
        true => parquet::read_parquet(path),
        false => csv::read_csv(path),
    }
}
