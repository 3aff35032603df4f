//! `ties.csv`: the columns of [`TieTable`] with a header; unknown numbers are empty, texts are quoted where they must.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;

use super::columns::{Column, ColumnMut};
use super::error::TieFileError;
use super::table::TieTable;
use crate::output::WholeFile;

/// Writes `ties.csv`, whole or not at all. Numbers have the digits that lead back to the same f64; a line's end inside
/// a text becomes a space.
///
/// # Errors
/// [`TieFileError::Io`] when the disk refuses.
pub fn write_csv(path: &Path, table: &TieTable) -> Result<(), TieFileError> {
    let write = || -> io::Result<()> {
        let mut file = WholeFile::create(path)?;
        rows(file.writer(), table)?;
        file.finish()
    };
    write().map_err(|source| TieFileError::Io { path: path.to_path_buf(), source })
}

fn rows(out: &mut impl Write, table: &TieTable) -> io::Result<()> {
    let columns = table.columns();
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    writeln!(out, "{}", names.join(","))?;
    for row in 0..table.len() {
        for (index, (_, column)) in columns.iter().enumerate() {
            if index > 0 {
                out.write_all(b",")?;
            }
            match column {
                Column::Long(values) => write!(out, "{}", values[row])?,
                Column::Int(values) => write!(out, "{}", values[row])?,
                Column::Flag(values) => write!(out, "{}", values[row])?,
                Column::Double(values) if values[row].is_nan() => {}
                Column::Double(values) => write!(out, "{}", values[row])?,
                Column::Text(texts) => out.write_all(quoted(texts.get(row)).as_bytes())?,
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// A text as a field: in quotes when it holds a comma or a quote, or begins or ends with a space.
fn quoted(text: &str) -> String {
    let line = text.replace(['\n', '\r'], " ");
    match line.contains([',', '"']) || line.trim() != line {
        true => format!("\"{}\"", line.replace('"', "\"\"")),
        false => line,
    }
}

/// The fields of a line; quotes may hold commas, a doubled quote is one.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let (mut quoted, mut chars) = (false, line.chars().peekable());
    while let Some(c) = chars.next() {
        match c {
            '"' if quoted && chars.peek() == Some(&'"') => {
                chars.next();
                append(&mut fields, '"');
            }
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            _ => append(&mut fields, c),
        }
    }
    fields
}

fn append(fields: &mut [String], c: char) {
    if let Some(last) = fields.last_mut() {
        last.push(c);
    }
}

/// Reads `ties.csv`; columns may stand in any order, unknown ones are passed over.
///
/// # Errors
/// [`TieFileError`] names file, line and column.
pub(super) fn read_csv(path: &Path) -> Result<TieTable, TieFileError> {
    let file = File::open(path).map_err(|source| TieFileError::Io { path: path.to_path_buf(), source })?;
    read_from(BufReader::new(file), path)
}

fn read_from(source: impl BufRead, path: &Path) -> Result<TieTable, TieFileError> {
    let mut table = TieTable::default();
    let mut header: Option<(usize, Vec<usize>)> = None;
    for (number, line) in (1..).zip(source.lines()) {
        let line = line.map_err(|source| TieFileError::Io { path: path.to_path_buf(), source })?;
        let line = line.trim_start_matches('\u{feff}').trim_end_matches('\r');
        if line.trim().is_empty() {
            continue;
        }
        let fields = fields(line);
        match &header {
            None => header = Some((fields.len(), places(&table, &fields, path)?)),
            Some((expected, _)) if fields.len() != *expected => {
                let (found, expected) = (fields.len(), *expected);
                return Err(TieFileError::FieldCount { path: path.to_path_buf(), line: number, found, expected });
            }
            Some((_, places)) => {
                for ((name, column), place) in table.columns_mut().into_iter().zip(places) {
                    parse(&fields[*place], column).map_err(|expected| TieFileError::BadField {
                        path: path.to_path_buf(),
                        line: number,
                        column: name,
                        text: fields[*place].chars().take(40).collect(),
                        expected,
                    })?;
                }
            }
        }
    }
    match header {
        Some(_) => Ok(table),
        None => Err(TieFileError::MissingColumn { path: path.to_path_buf(), column: "tie_id" }),
    }
}

/// Where each column of the table stands in the file.
fn places(table: &TieTable, header: &[String], path: &Path) -> Result<Vec<usize>, TieFileError> {
    let place = |column: &'static str| {
        let found = header.iter().position(|name| name.trim() == column);
        found.ok_or(TieFileError::MissingColumn { path: path.to_path_buf(), column })
    };
    table.columns().into_iter().map(|(name, _)| place(name)).collect()
}

fn parse(field: &str, column: ColumnMut<'_>) -> Result<(), &'static str> {
    let text = field.trim();
    match column {
        ColumnMut::Long(out) => out.push(text.parse().map_err(|_| "a whole number")?),
        ColumnMut::Int(out) => out.push(text.parse().map_err(|_| "a whole number")?),
        ColumnMut::Double(out) if text.is_empty() => out.push(f64::NAN),
        ColumnMut::Double(out) => out.push(text.parse().map_err(|_| "a number")?),
        ColumnMut::Flag(out) => out.push(match text.to_ascii_lowercase().as_str() {
            "true" | "1" => true,
            "false" | "0" => false,
            _ => return Err("true or false"),
        }),
        ColumnMut::Text(out) => out.push(field),
    }
    Ok(())
}
