//! Lines that are commands of their own.

use std::process::Command;

use anyhow::Result;

use super::Row;
use super::real::root;

fn succeeds(arguments: &[&str]) -> Result<bool> {
    Ok(Command::new("cargo").args(arguments).current_dir(root()).status()?.success())
}

/// Line 5: the bench prints its own figures.
pub(crate) fn speed() -> Result<Vec<Row>> {
    let good = succeeds(&["bench", "--quiet", "--bench", "throughput", "--", "--large"])?;
    Ok(vec![Row::at_most("throughput bench: lines beyond their bound", f64::from(u8::from(!good)), 0.0, "")])
}

/// Line 7: each mistake has a test that reads the message and looks for half-written files.
pub(crate) fn mistakes() -> Result<Vec<Row>> {
    let good = succeeds(&["test", "--quiet", "--release", "--test", "bad_input"])?;
    Ok(vec![Row::at_most("mistakes without a readable message", f64::from(u8::from(!good)), 0.0, "")])
}
