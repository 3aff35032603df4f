//! `info FILE...`: what is in a file, for people and as JSON.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow};
use serde_json::{Value, json};

use crate::cli::Common;

pub mod kind;
mod measurement;
mod path;
mod strip;
mod table;

use kind::{FileKind, kind_of};

/// What is known of a file.
#[derive(Debug, Clone)]
pub(crate) struct Description {
    /// Label and value, in the order of printing.
    lines: Vec<(&'static str, String)>,
    /// The same for machines: an object.
    json: Value,
}

/// Prints what is in each file; with `--json` an array of objects.
///
/// # Errors
/// When a file is of no known kind, or damaged. The others are printed before.
pub fn run(files: &[PathBuf], common: &Common, out: &mut impl Write) -> Result<()> {
    let (mut objects, mut errors) = (Vec::new(), Vec::new());
    let mut is_first = true;
    for path in files {
        match describe(path) {
            Ok((kind, description)) if common.json => objects.push(object(path, kind, description)),
            Ok((kind, description)) => {
                if !std::mem::take(&mut is_first) {
                    writeln!(out)?;
                }
                write_text(path, kind, &description, out)?;
            }
            Err(error) => errors.push(format!("{error:#}")),
        }
    }
    if common.json {
        serde_json::to_writer_pretty(&mut *out, &objects)?;
        writeln!(out)?;
    }
    if errors.is_empty() { Ok(()) } else { Err(anyhow!(errors.join("\n"))) }
}

fn describe(path: &Path) -> Result<(FileKind, Description)> {
    let kind = match kind_of(path) {
        Ok(kind) => kind,
        Err(error) => return measurement::describe(path).ok_or(error),
    };
    let description = match kind {
        FileKind::Strip => strip::describe(path)?,
        // tables without the columns of a trajectory may be measurements
        FileKind::Trajectory | FileKind::Imu | FileKind::Gnss | FileKind::Odometer => match path::describe(path) {
            Ok(description) => description,
            Err(error) => return measurement::describe(path).ok_or(error),
        },
        FileKind::Accuracy => path::describe_accuracy(path)?,
        FileKind::TiesParquet | FileKind::TiesCsv => table::describe_ties(path)?,
        FileKind::TiesText => table::describe_tie_text(path)?,
        FileKind::Correction => table::describe_correction(path)?,
    };
    Ok((kind, description))
}

fn object(path: &Path, kind: FileKind, description: Description) -> Value {
    let mut object = json!({ "file": path, "kind": kind.word() });
    if let (Value::Object(all), Value::Object(more)) = (&mut object, description.json) {
        all.extend(more);
    }
    object
}

fn write_text(path: &Path, kind: FileKind, description: &Description, out: &mut impl Write) -> std::io::Result<()> {
    writeln!(out, "{}: {}", path.display(), kind.name())?;
    let width = description.lines.iter().map(|(label, _)| label.len()).max().unwrap_or(0);
    for (label, value) in &description.lines {
        writeln!(out, "  {label:<width$}  {value}")?;
    }
    Ok(())
}

/// A number of things with thousands apart.
fn count(n: u64) -> String {
    let digits = n.to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().filter_map(|group| std::str::from_utf8(group).ok()).collect();
    groups.join(" ")
}

#[cfg(test)]
mod tests {
    use super::count;

    #[test]
    fn thousands_stand_apart() {
        assert_eq!((count(7).as_str(), count(1234).as_str(), count(20_000_000).as_str()), ("7", "1 234", "20 000 000"));
    }
}
