//! Reading `ties.txt`, line by line: one tie is in memory at a time.

use std::collections::HashSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};
use tieline_filter::{TieClass, TieKind};

use super::error::{RowFault, TieTextError};
use super::{FIXED_COLUMNS, FRAMES, MAGIC, TextSighting, TextTie, TieTextHeader, VERSION, columns_of};
use crate::delimited::{Delimiter, LineError, Lines, unpacked};

/// Length of a direction and cosine between two may be off by so much.
const ROUNDED: f64 = 1e-6;
/// Variances that make sense \[m²\].
const VARIANCE_M2: std::ops::RangeInclusive<f64> = 1e-12..=1e6;
/// Smallest weight of a sighting in use.
const LEAST_WEIGHT: f64 = 1e-6;
/// Farthest feature \[m\].
const FARTHEST_M: f64 = 1e5;
/// Latest time: ten weeks \[s\].
const LATEST_S: f64 = 6_048_000.0;
/// Latest week.
const LATEST_WEEK: u32 = 9999;
/// Characters of a datum that are kept.
const LONGEST_DATUM: usize = 200;
/// Kinds that there are in text.
const KINDS: [TieKind; 4] = [TieKind::SurfaceLine, TieKind::Increment, TieKind::Line, TieKind::XyzPoint];

/// The ties of a file, one after the other; plain or gzipped. After an error it ends.
pub struct TieTextReader<'a> {
    lines: Lines<'a>,
    path: PathBuf,
    header: TieTextHeader,
    /// First row of the next tie.
    next: Option<Row>,
    ids: HashSet<u64>,
    ended: bool,
}

impl std::fmt::Debug for TieTextReader<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TieTextReader").field("path", &self.path).field("header", &self.header).finish_non_exhaustive()
    }
}

/// A row with the tie that it is of.
struct Row {
    line: u64,
    tie: TextTie,
}

impl TieTextReader<'static> {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// [`TieTextError`] names file, line, value and remedy.
    pub fn open(path: &Path) -> Result<Self, TieTextError> {
        let file = File::open(path).map_err(|source| TieTextError::Io { path: path.to_path_buf(), source })?;
        Self::new(BufReader::new(file), path)
    }
}

impl<'a> TieTextReader<'a> {
    /// Reads the header of any source; `path` is for messages only.
    ///
    /// # Errors
    /// As [`TieTextReader::open`].
    pub fn new(source: impl BufRead + 'a, path: &Path) -> Result<Self, TieTextError> {
        let io = |source| TieTextError::Io { path: path.to_path_buf(), source };
        let lines = Lines::new(unpacked(source).map_err(io)?, path);
        let (path, header) = (path.to_path_buf(), TieTextHeader::default());
        let mut reader = Self { lines, path, header, next: None, ids: HashSet::new(), ended: false };
        reader.read_header()?;
        Ok(reader)
    }

    /// What the header says.
    #[must_use]
    pub fn header(&self) -> &TieTextHeader {
        &self.header
    }

    /// Everything up to the first row.
    fn read_header(&mut self) -> Result<(), TieTextError> {
        let path = self.path.clone();
        match self.lines.next().map_err(refused)? {
            Some(line) => version(line.text, line.number, &path)?,
            None => return Err(TieTextError::NotTies { path, found: String::new() }),
        }
        let mut said: HashSet<&'static str> = HashSet::new();
        while let Some(line) = self.lines.next().map_err(refused)? {
            if !line.is_comment() {
                self.next = Some(row(line.text, line.number).map_err(|fault| at(&path, line.number, fault))?);
                break;
            }
            if let Some((key, value)) = line.text[1..].split_once(':') {
                said.extend(entry(&mut self.header, key.trim(), value.trim(), (&path, line.number))?);
            }
        }
        let due = FRAMES.iter().map(|(key, word, _)| (*key, *word)).chain([("week", "2330, or unknown")]);
        match due.into_iter().find(|(key, _)| !said.contains(key)) {
            Some((key, expected)) => Err(TieTextError::MissingKey { path, key, expected }),
            None => Ok(()),
        }
    }

    /// The next row; `None` at the end.
    fn next_row(&mut self) -> Result<Option<Row>, TieTextError> {
        loop {
            let Some(line) = self.lines.next().map_err(refused)? else { return Ok(None) };
            if line.text.starts_with(MAGIC) {
                return Err(at(&self.path, line.number, RowFault::SecondHeader));
            }
            if !line.is_comment() {
                let number = line.number;
                return row(line.text, number).map(Some).map_err(|fault| at(&self.path, number, fault));
            }
        }
    }

    /// The tie that begins with a row, and the first row of the one after it.
    fn tie(&mut self, first: Row) -> Result<TextTie, TieTextError> {
        let Row { line, mut tie } = first;
        if !self.ids.insert(tie.id) {
            return Err(at(&self.path, line, RowFault::Apart { tie: tie.id }));
        }
        while let Some(mut row) = self.next_row()? {
            if row.tie.id != tie.id {
                self.next = Some(row);
                break;
            }
            joins(&tie, &row.tie).map_err(|fault| at(&self.path, row.line, fault))?;
            tie.sightings.append(&mut row.tie.sightings);
        }
        match tie.sightings.len() {
            1 => Err(at(&self.path, line, RowFault::TooFew { tie: tie.id })),
            _ => Ok(tie),
        }
    }
}

impl Iterator for TieTextReader<'_> {
    type Item = Result<TextTie, TieTextError>;

    fn next(&mut self) -> Option<Self::Item> {
        let first = self.next.take().filter(|_| !self.ended)?;
        let tie = self.tie(first);
        self.ended = tie.is_err();
        Some(tie)
    }
}

fn refused(error: LineError) -> TieTextError {
    match error {
        LineError::Io { path, source, .. } => TieTextError::Io { path, source },
        LineError::TooLong { path, line, limit } => TieTextError::LongLine { path, line, limit },
    }
}

fn at(path: &Path, line: u64, fault: RowFault) -> TieTextError {
    TieTextError::Row { path: path.to_path_buf(), line, fault }
}

/// The start of a text, for messages.
fn shown(text: &str) -> String {
    text.chars().take(40).collect()
}

/// The first line.
fn version(text: &str, line: u64, path: &Path) -> Result<(), TieTextError> {
    let Some(version) = text.strip_prefix(MAGIC) else {
        return Err(TieTextError::NotTies { path: path.to_path_buf(), found: shown(text) });
    };
    match version.trim().parse() {
        Ok(VERSION) => Ok(()),
        _ => Err(TieTextError::Version { path: path.to_path_buf(), line, found: shown(version.trim()) }),
    }
}

/// A line `# key: value` of the header; the key where it is one of those that count.
fn entry(
    header: &mut TieTextHeader,
    key: &str,
    value: &str,
    (path, line): (&Path, u64),
) -> Result<Option<&'static str>, TieTextError> {
    let word = value.split_whitespace().next().unwrap_or("");
    let bad = |key, expected| {
        Err(TieTextError::BadKey { path: path.to_path_buf(), line, key, found: shown(value), expected })
    };
    if key.eq_ignore_ascii_case("week") {
        header.week = match word.parse::<u32>() {
            Ok(week) if week <= LATEST_WEEK => Some(week),
            _ if word.eq_ignore_ascii_case("unknown") => None,
            _ => return bad("week", "a GPS week without rollover, or unknown,"),
        };
        return Ok(Some("week"));
    }
    if key.eq_ignore_ascii_case("datum") {
        let words: Vec<&str> = value.split_whitespace().collect();
        let short: String = words.join(" ").chars().take(LONGEST_DATUM).collect();
        header.datum = Some(short.trim_end().to_string());
    }
    match FRAMES.iter().find(|(known, _, _)| key.eq_ignore_ascii_case(known)) {
        Some((known, expected, _)) if !word.eq_ignore_ascii_case(expected) => bad(known, expected),
        Some((known, _, _)) => Ok(Some(known)),
        None => Ok(None),
    }
}

/// Fields of a row, one after the other.
struct Fields<'a> {
    texts: std::vec::IntoIter<&'a str>,
}

impl<'a> Fields<'a> {
    fn take<T>(
        &mut self,
        column: &'static str,
        expected: &'static str,
        of: impl FnOnce(&'a str) -> Option<T>,
    ) -> Result<T, RowFault> {
        let text = self.texts.next().unwrap_or("");
        of(text).ok_or_else(|| RowFault::Field { column, text: shown(text), expected })
    }

    /// A finite number.
    fn number(&mut self, column: &'static str) -> Result<f64, RowFault> {
        self.take(column, "a finite number", |t| t.parse().ok().filter(|v: &f64| v.is_finite()))
    }

    fn vector(&mut self, columns: [&'static str; 3]) -> Result<Vector3<f64>, RowFault> {
        Ok(Vector3::new(self.number(columns[0])?, self.number(columns[1])?, self.number(columns[2])?))
    }
}

/// A row, checked by itself.
fn row(text: &str, line: u64) -> Result<Row, RowFault> {
    let texts: Vec<&str> = Delimiter::of(text).split(text).collect();
    let found = texts.len();
    if found < FIXED_COLUMNS {
        return Err(RowFault::FieldCount { found, expected: columns_of(1), rank: 1 });
    }
    let mut fields = Fields { texts: texts.into_iter() };
    let id = fields.take("tie_id", "a whole number", |t| t.parse().ok())?;
    let class = fields.take("class", "pass_to_pass, scanner_to_scanner or strip_to_strip", |t| {
        TieClass::ALL.into_iter().find(|c| c.word() == t)
    })?;
    let kind = fields
        .take("kind", "surface_line, increment, line or xyz_point", |t| KINDS.into_iter().find(|k| k.as_str() == t))?;
    let rank = fields.take("rank", "1, 2 or 3", |t| t.parse().ok().filter(|r| (1..=3).contains(r)))?;
    if let Some(expected) = kind.rank().filter(|r| *r != rank) {
        return Err(RowFault::Rank { kind: kind.as_str(), rank, expected });
    }
    let expected = columns_of(rank);
    if found != expected {
        return Err(RowFault::FieldCount { found, expected, rank });
    }
    let time_s = fields.take("time_s", "seconds of the header's week, 0 to 6048000,", |t| {
        t.parse().ok().filter(|v| (0.0..LATEST_S).contains(v))
    })?;
    let scanner = fields.take("scanner", "a number from 0 to 65535", |t| t.parse().ok())?;
    let body_vector_m = fields.vector(["body_x_m", "body_y_m", "body_z_m"])?;
    if body_vector_m.amax() > FARTHEST_M {
        let text = shown(&body_vector_m.amax().to_string());
        return Err(RowFault::Field { column: "body vector", text, expected: "no more than 100 km" });
    }
    let used = fields.take("used", "0 or 1", |t| match t {
        "0" => Some(false),
        "1" => Some(true),
        _ => None,
    })?;
    let weight =
        fields.take("weight", "a weight from 0 to 1", |t| t.parse().ok().filter(|w| (0.0..=1.0).contains(w)))?;
    if used && weight < LEAST_WEIGHT {
        return Err(RowFault::Weight { weight });
    }
    let directions = directions(&mut fields, rank)?;
    let covariance_m2 = covariance(&mut fields, rank)?;
    let sightings = vec![TextSighting { time_s, scanner, body_vector_m, covariance_m2, used, weight }];
    Ok(Row { line, tie: TextTie { id, class, kind, directions, sightings } })
}

/// Unit vectors at right angles.
fn directions(fields: &mut Fields<'_>, rank: usize) -> Result<Vec<Vector3<f64>>, RowFault> {
    let mut directions: Vec<Vector3<f64>> = Vec::with_capacity(rank);
    for number in 1..=rank {
        let u = fields.vector(["u_x", "u_y", "u_z"])?;
        let length = u.norm();
        if (length - 1.0).abs() > ROUNDED {
            return Err(RowFault::NotUnit { number, length });
        }
        for (k, other) in directions.iter().enumerate() {
            let cosine = other.dot(&u);
            if cosine.abs() > ROUNDED {
                return Err(RowFault::NotOrthogonal { first: k + 1, second: number, cosine });
            }
        }
        directions.push(u);
    }
    Ok(directions)
}

/// Upper triangle, row by row.
fn covariance(fields: &mut Fields<'_>, rank: usize) -> Result<Matrix3<f64>, RowFault> {
    let mut covariance_m2 = Matrix3::zeros();
    for i in 0..rank {
        for j in i..rank {
            let value = fields.number("covariance_m2")?;
            if i == j && !VARIANCE_M2.contains(&value) {
                return Err(RowFault::Variance { number: i + 1, value });
            }
            covariance_m2[(i, j)] = value;
            covariance_m2[(j, i)] = value;
        }
    }
    // correlations: definite with room for what the filter adds up
    let sd = |i: usize| covariance_m2[(i, i)].sqrt();
    let correlation = Matrix3::from_fn(|i, j| match i == j {
        true => 1.0 - 1e-9,
        false if i < rank && j < rank => covariance_m2[(i, j)] / (sd(i) * sd(j)),
        false => 0.0,
    });
    correlation.cholesky().map(|_| covariance_m2).ok_or(RowFault::Covariance)
}

/// Whether a row goes on with a tie.
fn joins(tie: &TextTie, row: &TextTie) -> Result<(), RowFault> {
    let differs = |column| Err(RowFault::Differs { tie: tie.id, column });
    if row.kind != tie.kind {
        return differs("kind");
    }
    if row.class != tie.class {
        return differs("class");
    }
    if tie.directions.iter().zip(&row.directions).any(|(a, b)| (a - b).amax() > ROUNDED) {
        return differs("direction");
    }
    let last_s = |t: &TextTie| t.sightings.last().map_or(f64::NEG_INFINITY, |s| s.time_s);
    let (time_s, previous_s) = (last_s(row), last_s(tie));
    if time_s < previous_s {
        return Err(RowFault::Unsorted { tie: tie.id, time_s, previous_s });
    }
    Ok(())
}
