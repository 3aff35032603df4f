//! A text file as rows of numbers: columns by a pattern, by the header, or by their count.

use std::io::BufRead;
use std::path::{Path, PathBuf};

use super::column::{Column, Named, Spec};
use super::error::MeasurementFileError;
use crate::delimited::{Delimiter, Line, Lines};
use crate::trajectory::Place;

/// A header is over by this line, or it is none.
const LONGEST_HEADER: usize = 500;

/// What said what the columns are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    Pattern,
    Header,
    /// The number of fields: the pattern of the program's own.
    Count,
}

/// The rows of a file: `N` numbers each, in the units of the workspace, NaN where no column holds one.
pub(super) struct Table<'a, const N: usize> {
    lines: Lines<'a>,
    path: PathBuf,
    layout: Layout,
    first: Option<(Place, [f64; N])>,
    /// What said what the columns are.
    pub(super) source: Source,
    /// What a user should be told.
    pub(super) notes: Vec<String>,
}

/// How a line becomes a row.
struct Layout {
    columns: Vec<Option<Column>>,
    /// Fields that a line must have.
    due: usize,
    delimiter: Delimiter,
    blanks: bool,
}

impl<'a, const N: usize> Table<'a, N> {
    /// Finds the columns and the first row: `names` is the pattern of the user, `defaults` are the patterns for a file
    /// without header, told apart by their count.
    pub(super) fn open(
        source: Box<dyn BufRead + 'a>,
        path: &Path,
        spec: &Spec<N>,
        names: Option<&[String]>,
        defaults: &[&[&str]],
    ) -> Result<Self, MeasurementFileError> {
        let pattern = names.map(|names| spec.pattern(path, names)).transpose()?;
        let mut lines = Lines::new(source, path);
        let mut headers: Vec<(u64, String)> = Vec::new();
        while let Some(line) = lines.next()? {
            let delimiter = Delimiter::of(line.text);
            if line.is_comment() || !is_data(&line, delimiter, pattern.as_deref()) {
                headers.push((line.number, line.text.to_string()));
                if headers.len() > LONGEST_HEADER {
                    break;
                }
                continue;
            }
            let mut notes = Vec::new();
            let (columns, source) = match pattern {
                Some(columns) => (columns, Source::Pattern),
                None => find_columns(path, spec, &headers, &line, defaults, &mut notes)?,
            };
            let due = columns.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
            let layout = Layout { columns, due, delimiter, blanks: spec.blanks };
            layout.check_twice(path)?;
            let first = Some((Place::Line(line.number), layout.row(&line, path)?));
            return Ok(Self { lines, path: path.to_path_buf(), layout, first, source, notes });
        }
        match headers.iter().find(|(_, text)| !text.starts_with(['#', '%'])) {
            Some((line, found)) => Err(no_columns(path, *line, found, spec.example)),
            None => Err(MeasurementFileError::Empty { path: path.to_path_buf() }),
        }
    }

    /// The next row; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<(Place, [f64; N])>, MeasurementFileError> {
        if let Some(first) = self.first.take() {
            return Ok(Some(first));
        }
        while let Some(line) = self.lines.next()? {
            if !line.is_comment() {
                return Ok(Some((Place::Line(line.number), self.layout.row(&line, &self.path)?)));
            }
        }
        Ok(None)
    }

    /// Whether columns hold all these places of a row.
    pub(super) fn has(&self, slots: impl IntoIterator<Item = usize>) -> bool {
        slots.into_iter().all(|slot| self.layout.columns.iter().flatten().any(|c| c.slot == slot))
    }

    /// Whether a column holds one of these places of a row.
    pub(super) fn has_any(&self, slots: impl IntoIterator<Item = usize>) -> bool {
        slots.into_iter().any(|slot| self.has([slot]))
    }

    /// Whether the name of the time says that it is adjusted standard time.
    pub(super) fn is_adjusted(&self) -> bool {
        self.layout.columns.iter().flatten().any(|c| c.adjusted)
    }

    /// The error of columns that lack something.
    pub(super) fn missing(&self, missing: &'static str, spec: &Spec<N>) -> MeasurementFileError {
        let (path, found) = (self.path.clone(), self.names());
        MeasurementFileError::MissingColumn { path, found, missing, example: spec.example }
    }

    /// The columns for a message.
    pub(super) fn names(&self) -> String {
        let name = |c: &Option<Column>| c.as_ref().map_or("-", |c| c.name.as_str()).to_string();
        self.layout.columns.iter().map(name).collect::<Vec<_>>().join(", ")
    }
}

/// Whether a line holds numbers: the first column of the pattern, else one of the first two fields.
fn is_data(line: &Line<'_>, delimiter: Delimiter, pattern: Option<&[Option<Column>]>) -> bool {
    let number = |field: &str| field.trim_matches('"').parse::<f64>().is_ok();
    match pattern {
        Some(columns) => {
            let first = columns.iter().position(Option::is_some).unwrap_or(0);
            delimiter.split(line.text).nth(first).is_none_or(number)
        }
        None => delimiter.split(line.text).take(2).any(number),
    }
}

/// Columns and what said so, for a file without a pattern.
type Columns = (Vec<Option<Column>>, Source);

fn find_columns<const N: usize>(
    path: &Path,
    spec: &Spec<N>,
    headers: &[(u64, String)],
    line: &Line<'_>,
    defaults: &[&[&str]],
    notes: &mut Vec<String>,
) -> Result<Columns, MeasurementFileError> {
    let count = |text: &str| {
        let delimiter = Delimiter::of(text);
        delimiter.split(text.trim_end_matches([',', ';'])).count()
    };
    let fields = count(line.text);
    let known = |text: &str| {
        let text = text.trim_start_matches(['#', '%', ' ']);
        Delimiter::of(text).split(text).filter(|name| !matches!(spec.parse(name), Named::Unknown)).count()
    };
    let best = headers
        .iter()
        .filter(|(_, text)| count(text.trim_start_matches(['#', '%', ' '])).abs_diff(fields) <= 1)
        .max_by_key(|(_, text)| known(text))
        .filter(|(_, text)| known(text) > 0);
    if let Some((_, header)) = best {
        return by_header(path, spec, header, notes).map(|columns| (columns, Source::Header));
    }
    let (number, found) = match headers.iter().find(|(_, text)| !text.starts_with(['#', '%'])) {
        Some((number, text)) => (*number, text.as_str()),
        None => match defaults.iter().find(|names| names.len() == fields) {
            Some(names) => return Ok((spec.own_pattern(names), Source::Count)),
            None => (line.number, line.text),
        },
    };
    Err(no_columns(path, number, found, spec.example))
}

/// The columns of a header line; unknown names are left out, and a note says so.
fn by_header<const N: usize>(
    path: &Path,
    spec: &Spec<N>,
    header: &str,
    notes: &mut Vec<String>,
) -> Result<Vec<Option<Column>>, MeasurementFileError> {
    let header = header.trim_start_matches(['#', '%', ' ']);
    let (mut columns, mut unused) = (Vec::new(), Vec::new());
    for name in Delimiter::of(header).split(header) {
        columns.push(match spec.parse(name) {
            Named::Column(column) => Some(column),
            Named::NoUnit => return Err(spec.no_unit(path, name)),
            Named::Unknown => {
                if !matches!(name, "" | "-") {
                    unused.push(name);
                }
                None
            }
        });
    }
    if !unused.is_empty() {
        notes.push(format!("{}: columns left unused: {}", path.display(), unused.join(", ")));
    }
    Ok(columns)
}

fn no_columns(path: &Path, line: u64, found: &str, example: &'static str) -> MeasurementFileError {
    let found = found.chars().take(120).collect();
    MeasurementFileError::NoColumns { path: path.to_path_buf(), line, found, example }
}

impl Layout {
    fn check_twice(&self, path: &Path) -> Result<(), MeasurementFileError> {
        let mut seen: Vec<&Column> = Vec::new();
        for column in self.columns.iter().flatten() {
            if let Some(other) = seen.iter().find(|other| other.slot == column.slot) {
                let (first, second) = (other.name.clone(), column.name.clone());
                return Err(MeasurementFileError::TwiceGiven { path: path.to_path_buf(), first, second });
            }
            seen.push(column);
        }
        Ok(())
    }

    fn row<const N: usize>(&self, line: &Line<'_>, path: &Path) -> Result<[f64; N], MeasurementFileError> {
        match self.delimiter {
            Delimiter::Comma => self.numbers(line.text.split(',').map(str::trim), line, path),
            Delimiter::Semicolon => self.numbers(line.text.split(';').map(str::trim), line, path),
            Delimiter::WhiteSpace => self.numbers(line.text.split_ascii_whitespace(), line, path),
        }
    }

    /// The hot path: no allocation.
    fn numbers<'t, const N: usize>(
        &self,
        fields: impl Iterator<Item = &'t str>,
        line: &Line<'_>,
        path: &Path,
    ) -> Result<[f64; N], MeasurementFileError> {
        let mut row = [f64::NAN; N];
        let mut found = 0;
        for (index, (field, column)) in fields.zip(&self.columns[..self.due]).enumerate() {
            found += 1;
            let Some(column) = column else { continue };
            let value = match field.parse::<f64>() {
                Ok(value) => value,
                Err(_) => self.odd_number(field, column, line, index, path)?,
            };
            if !(value.is_finite() || self.may_be_blank(column)) {
                let (path, place) = (path.to_path_buf(), Place::Line(line.number));
                return Err(MeasurementFileError::NotFinite { path, place, column: column.name.clone() });
            }
            row[column.slot] = value * column.factor + column.offset;
        }
        match found < self.due {
            true => {
                let (path, expected) = (path.to_path_buf(), self.due);
                Err(MeasurementFileError::FieldCount { path, line: line.number, found, expected })
            }
            false => Ok(row),
        }
    }

    fn may_be_blank(&self, column: &Column) -> bool {
        self.blanks || column.slot == super::column::WEEK
    }

    /// What is no plain number: quoted, empty, or NaN as C programs print it.
    #[cold]
    fn odd_number(
        &self,
        field: &str,
        column: &Column,
        line: &Line<'_>,
        index: usize,
        path: &Path,
    ) -> Result<f64, MeasurementFileError> {
        let text = field.trim_matches(['"', '\'', ' ']);
        match text.parse::<f64>() {
            Ok(value) => Ok(value),
            Err(_) if text.is_empty() && self.may_be_blank(column) => Ok(f64::NAN),
            Err(_) if is_nan(text) => Ok(f64::NAN),
            Err(_) => Err(MeasurementFileError::NotANumber {
                path: path.to_path_buf(),
                line: line.number,
                column: index + 1,
                name: column.name.clone(),
                text: text.chars().take(40).collect(),
            }),
        }
    }
}

/// NaN as C programs print it: `-nan`, `nan(ind)`, `1.#QNAN`, `-1.#IND`.
pub(super) fn is_nan(text: &str) -> bool {
    let text = text.trim_start_matches(['-', '+']).to_ascii_lowercase();
    text.starts_with("nan") || text.starts_with("1.#")
}
