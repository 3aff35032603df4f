//! What the columns of a text trajectory are: from the project file or from the header.

use std::path::Path;

use tieline_filter::PositionFrame;

use super::{Column, EXAMPLE, HeadingReference, QUANTITIES, Quantity, Row, TrajectoryFileError};
use crate::delimited::{Delimiter, Line, Lines};

/// A header is over by this line, or it is none.
const LONGEST_HEADER: usize = 500;

/// How a line becomes a row.
#[derive(Debug)]
pub(super) struct Layout {
    /// The columns; `None` for those left out.
    columns: Vec<Option<Column>>,
    delimiter: Delimiter,
    /// First line of numbers, 1-based.
    pub(super) first_line: u64,
    pub(super) frame: PositionFrame,
    pub(super) heading: HeadingReference,
    pub(super) has_velocity: bool,
    pub(super) has_sigma: bool,
    /// What a user should be told.
    pub(super) notes: Vec<String>,
}

/// Finds the columns and the first line of numbers.
pub(super) fn find(
    lines: &mut Lines<'_>,
    path: &Path,
    names: Option<&[String]>,
) -> Result<Layout, TrajectoryFileError> {
    let pattern = names.map(|names| Column::pattern(path, names)).transpose()?;
    let mut headers: Vec<(u64, String)> = Vec::new();
    let mut first_failure = None;
    while let Some(line) = lines.next()? {
        let delimiter = Delimiter::of(line.text);
        let is_data = match &pattern {
            _ if line.is_comment() => false,
            Some(columns) => match numbers(columns, delimiter, &line, path) {
                Ok(_) => true,
                Err(error) => {
                    first_failure.get_or_insert(error);
                    false
                }
            },
            None => is_numeric(delimiter, line.text),
        };
        if is_data {
            let (first_line, text) = (line.number, line.text.to_string());
            let columns = match pattern {
                Some(columns) => columns,
                None => by_header(path, &headers, delimiter, &text)?,
            };
            return Layout::new(path, columns, delimiter, first_line, names.is_none());
        }
        headers.push((line.number, line.text.to_string()));
        if headers.len() > LONGEST_HEADER {
            break;
        }
    }
    match (first_failure, headers.first()) {
        (Some(error), _) => Err(error),
        (None, Some((_, found))) => Err(no_columns(path, found)),
        (None, None) => Err(TrajectoryFileError::Empty { path: path.to_path_buf() }),
    }
}

/// Whether a line without a pattern holds numbers: its first field and at least seven in all.
fn is_numeric(delimiter: Delimiter, text: &str) -> bool {
    let mut fields = delimiter.split(text);
    let number = |field: &str| field.parse::<f64>().is_ok();
    let first_two = fields.by_ref().take(2).any(number);
    first_two && fields.filter(|field| number(field)).count() >= 3
}

/// The columns by the header line with the same number of fields and the most known names.
fn by_header(
    path: &Path,
    headers: &[(u64, String)],
    delimiter: Delimiter,
    data: &str,
) -> Result<Vec<Option<Column>>, TrajectoryFileError> {
    let count = delimiter.split(data).filter(|field| !field.is_empty()).count();
    let known = |text: &String| -> Vec<Option<Column>> {
        let text = text.trim_start_matches(['#', '%', ' ']);
        Delimiter::of(text).split(text).map(Column::parse).collect()
    };
    let best = headers
        .iter()
        .map(|(_, text)| known(text))
        .filter(|columns| columns.len().abs_diff(count) <= 1)
        .max_by_key(|columns| columns.iter().flatten().count());
    match best {
        Some(columns) if columns.iter().flatten().count() >= 3 => Ok(columns),
        _ => Err(no_columns(path, headers.first().map_or(data, |(_, text)| text))),
    }
}

fn no_columns(path: &Path, found: &str) -> TrajectoryFileError {
    let found = found.chars().take(200).collect();
    TrajectoryFileError::NoColumns { path: path.to_path_buf(), found, example: EXAMPLE }
}

/// The numbers of a line at the places of their quantities, in the units of the workspace.
fn numbers(
    columns: &[Option<Column>],
    delimiter: Delimiter,
    line: &Line<'_>,
    path: &Path,
) -> Result<Row, TrajectoryFileError> {
    let mut row = [f64::NAN; QUANTITIES];
    let mut found = 0;
    let due = columns.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
    for (index, field) in delimiter.split(line.text).take(due).enumerate() {
        found += 1;
        let Some(column) = &columns[index] else { continue };
        let text = field.trim_matches('"');
        let value = match text.parse::<f64>() {
            Ok(value) => value,
            Err(_) if column.quantity == Quantity::Week && text.is_empty() => f64::NAN,
            Err(_) => {
                return Err(TrajectoryFileError::NotANumber {
                    path: path.to_path_buf(),
                    line: line.number,
                    column: index + 1,
                    name: column.name.clone(),
                    text: text.chars().take(40).collect(),
                });
            }
        };
        row[column.quantity as usize] = value * column.factor.unwrap_or(1.0) + column.offset;
    }
    match found < due {
        true => {
            Err(TrajectoryFileError::FieldCount { path: path.to_path_buf(), line: line.number, found, expected: due })
        }
        false => Ok(row),
    }
}

impl Layout {
    fn new(
        path: &Path,
        columns: Vec<Option<Column>>,
        delimiter: Delimiter,
        first_line: u64,
        from_header: bool,
    ) -> Result<Self, TrajectoryFileError> {
        let count = |quantity: Quantity| columns.iter().flatten().filter(|c| c.quantity == quantity).count();
        for column in columns.iter().flatten() {
            if count(column.quantity) > 1 {
                let quantity = column.quantity.name();
                return Err(TrajectoryFileError::TwiceGiven { path: path.to_path_buf(), quantity });
            }
        }
        let has = |quantities: &[Quantity]| quantities.iter().all(|&q| count(q) == 1);
        let map = has(&[Quantity::East, Quantity::North, Quantity::Up]);
        let geodetic = has(&[Quantity::Latitude, Quantity::Longitude, Quantity::Up]);
        let missing = if !has(&[Quantity::Time]) {
            "a time (time_s)"
        } else if !map && !geodetic {
            "a position (east_m, north_m, height_m or lat_deg, lon_deg, h_m)"
        } else if !has(&[Quantity::Roll]) {
            "roll (roll_deg)"
        } else if !has(&[Quantity::Pitch]) {
            "pitch (pitch_deg)"
        } else if !has(&[Quantity::Heading]) && !has(&[Quantity::GridHeading]) {
            "heading (heading_deg)"
        } else {
            ""
        };
        if !missing.is_empty() {
            let found = columns.iter().map(|c| c.as_ref().map_or("-", |c| c.name.as_str())).collect::<Vec<_>>();
            let (path, found) = (path.to_path_buf(), found.join(", "));
            return Err(TrajectoryFileError::MissingColumn { path, found, missing, example: EXAMPLE });
        }
        let sigma = [Quantity::SigmaNorth, Quantity::SigmaEast, Quantity::SigmaDown].into_iter().chain([
            Quantity::SigmaRoll,
            Quantity::SigmaPitch,
            Quantity::SigmaHeading,
        ]);
        let sigma_count = sigma.map(count).sum::<usize>();
        let mut notes = Vec::new();
        if sigma_count > 0 && sigma_count < 6 {
            notes.push(format!(
                "{}: accuracies are used only when all six of position and attitude are given; {sigma_count} are",
                path.display()
            ));
        }
        if from_header && map && geodetic {
            notes.push(format!("{}: both map and geodetic positions are given; geodetic is used", path.display()));
        }
        Ok(Self {
            // Geodetic first: it needs no CRS to be understood.
            frame: if geodetic { PositionFrame::Geodetic } else { PositionFrame::Map },
            heading: match has(&[Quantity::Heading]) {
                true => HeadingReference::TrueNorth,
                false => HeadingReference::GridNorth,
            },
            has_velocity: has(&[Quantity::VelocityNorth, Quantity::VelocityEast, Quantity::VelocityDown]),
            has_sigma: sigma_count == 6,
            columns,
            delimiter,
            first_line,
            notes,
        })
    }

    /// Whether a column holds this quantity.
    pub(super) fn has(&self, quantity: Quantity) -> bool {
        self.columns.iter().flatten().any(|c| c.quantity == quantity)
    }

    /// The row of a line.
    pub(super) fn row(&self, line: &Line<'_>, path: &Path) -> Result<Row, TrajectoryFileError> {
        numbers(&self.columns, self.delimiter, line, path)
    }

    /// Units that the header leaves out, by the values: what exceeds a full turn in radians is degrees.
    pub(super) fn settle_units(&mut self, lines: &mut Lines<'_>, path: &Path) -> Result<(), TrajectoryFileError> {
        let open = |c: &&Column| c.factor.is_none();
        if !self.columns.iter().flatten().any(|c| open(&c)) {
            return Ok(());
        }
        let mut largest = [0.0_f64; QUANTITIES];
        while let Some(line) = lines.next()? {
            if line.number < self.first_line || line.is_comment() {
                continue;
            }
            for (most, value) in largest.iter_mut().zip(self.row(&line, path)?) {
                *most = most.max(value.abs());
            }
        }
        let angles = || self.columns.iter().flatten().filter(|c| c.is_angle() && c.factor.is_none());
        let most = angles().map(|c| largest[c.quantity as usize]).fold(0.0, f64::max);
        if let Some(first) = angles().next()
            && most <= 2.0 * std::f64::consts::TAU
        {
            let (path, quantity) = (path.to_path_buf(), first.quantity.name());
            return Err(TrajectoryFileError::NoUnit { path, quantity, example: EXAMPLE });
        }
        let mut taken = Vec::new();
        for column in self.columns.iter_mut().flatten().filter(|c| c.factor.is_none()) {
            let (factor, unit) = match column.is_angle() {
                true => (std::f64::consts::PI / 180.0, "deg"),
                false => (1.0, "SI"),
            };
            column.factor = Some(factor);
            taken.push(format!("{} [{unit}]", column.name));
        }
        self.notes.push(format!(
            "{}: the header gives no units; taken by the size of the values: {}",
            path.display(),
            taken.join(", ")
        ));
        Ok(())
    }
}
