//! `graph solve` and `graph generate`.

mod generate;
mod geodetic;
mod output;
mod robust;
mod sections;
mod solve;

use std::io::Write;

use anyhow::Result;

use crate::cli::{Common, GraphArgs, GraphCommand};

/// Runs a command on graphs.
///
/// # Errors
/// As its parts.
pub fn run(args: &GraphArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    match (&args.command, &args.solve) {
        (Some(GraphCommand::Generate(args)), _) => generate::run(args, common, out),
        (Some(GraphCommand::Solve(args)), _) | (None, Some(args)) => solve::run(args, common, out),
        (None, None) => anyhow::bail!("name a file, or one of `solve`, `generate`"),
    }
}
