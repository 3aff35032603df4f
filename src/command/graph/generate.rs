//! `graph generate`: nets of any size.

use std::io::Write;

use anyhow::Result;

use crate::cli::{Common, GraphGenerateArgs};

/// Makes a net, and adjusts it when asked to.
///
/// # Errors
/// When the folder cannot be written, or the net cannot be adjusted.
pub fn run(_args: &GraphGenerateArgs, _common: &Common, _out: &mut impl Write) -> Result<()> {
    anyhow::bail!("not yet")
}
