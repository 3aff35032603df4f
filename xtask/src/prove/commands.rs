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

/// The mechanisation and the Jacobians.
pub(crate) fn mechanisation() -> Result<Vec<Row>> {
    let good = succeeds(&["test", "--quiet", "--release", "-p", "tieline-simulate", "--test", "navigation"])?;
    Ok(vec![Row::at_most("mechanisation and Jacobians: tests that fail", f64::from(u8::from(!good)), 0.0, "")])
}

/// The bench of the smoother prints its own figures.
pub(crate) fn smoother_speed() -> Result<Vec<Row>> {
    let good = succeeds(&["bench", "--quiet", "--bench", "smoother"])?;
    Ok(vec![Row::at_most("smoother bench: lines beyond their bound", f64::from(u8::from(!good)), 0.0, "")])
}

/// Each mistake with navigation data has a test.
pub(crate) fn navigation_mistakes() -> Result<Vec<Row>> {
    let good = succeeds(&["test", "--quiet", "--release", "--test", "bad_navigation"])?;
    Ok(vec![Row::at_most("mistakes without a readable message", f64::from(u8::from(!good)), 0.0, "")])
}

/// Each mistake with graphs has a test, and damaged files of every kind are read and adjusted without a panic.
pub(crate) fn graph_mistakes() -> Result<Vec<Row>> {
    let message = succeeds(&["test", "--quiet", "--release", "--test", "bad_graphs"])?;
    let damaged = succeeds(&["test", "--quiet", "--release", "--test", "graph_mutations"])?;
    Ok(vec![
        Row::at_most("mistakes without a readable message", f64::from(u8::from(!message)), 0.0, ""),
        Row::at_most("damaged graphs and nets: tests that fail", f64::from(u8::from(!damaged)), 0.0, ""),
    ])
}
