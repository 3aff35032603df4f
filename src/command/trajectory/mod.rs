//! `trajectory diff A B` and `trajectory at TRAJECTORY TIMES.csv`.

use std::io::Write;

use anyhow::Result;

use crate::cli::{Common, TrajectoryCommand};

mod at;
mod diff;
mod plot;

/// Compares or interpolates trajectories.
///
/// # Errors
/// When a file cannot be read, the trajectories do not fit together, or the disk refuses.
pub fn run(command: &TrajectoryCommand, common: &Common, out: &mut impl Write) -> Result<()> {
    match command {
        TrajectoryCommand::Diff { a, b, out: folder, crs, columns } => {
            let options = diff::Options { crs: crs.as_deref(), columns: columns.as_deref(), folder: folder.as_deref() };
            diff::run(a, b, &options, common, out)
        }
        TrajectoryCommand::At { trajectory, times, accuracy, columns, out: file } => {
            let options =
                at::Options { columns: columns.as_deref(), accuracy: accuracy.as_deref(), file: file.as_deref() };
            at::run(trajectory, times, &options, common, out)
        }
    }
}
