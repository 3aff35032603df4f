//! Points picked by hand in the cloud, as CSV: what a person saw at several times, and known points where there are some.
//!
//! A header names the columns `point, gps_time_s, x_m, y_m, z_m` and, where there are any, `sigma_plan_m, sigma_height_m, scanner`, in any order. The rows of one
//! point make one tie: each with a time is a sighting, one without is where the point is known to be.
//!
//! ```
//! use tieline_io::ties::picked::read_from;
//! let text = "point,gps_time_s,x_m,y_m,z_m,scanner\n\
//!             cover 7,209043.21,601024.52,5340563.88,200.91,0\n\
//!             cover 7,209098.64,601024.57,5340563.80,200.93,1\n";
//! let points = read_from(text.as_bytes(), "points.csv".as_ref())?;
//! assert_eq!((points[0].name.as_str(), points[0].sightings.len()), ("cover 7", 2));
//! # Ok::<(), tieline_io::ties::picked::PickedError>(())
//! ```

mod error;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use nalgebra::Vector3;

pub use error::{PickedError, PickedFault};

use crate::delimited::{Delimiter, LineError, Lines, plain_name, unpacked};

/// Sigmas of a sighting whose row gives none: of each direction in plan, and of the height \[m\]. So well a person picks a point of a cloud with a few centimetres between its points.
pub const PICKED_SIGMA_M: [f64; 2] = [0.02, 0.01];
/// The same of a known point \[m\].
pub const KNOWN_SIGMA_M: [f64; 2] = [0.01, 0.01];
/// Sigmas that make sense \[m\].
const SIGMAS_M: std::ops::RangeInclusive<f64> = 1e-4..=10.0;
/// Largest coordinate \[m\].
const FARTHEST_M: f64 = 1e8;
/// Characters of a name.
const LONGEST_NAME: usize = 80;

/// Where a row has a point.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedRow {
    /// Line of the file, 1-based.
    pub line: u64,
    /// Place in the map: east, north, up \[m\].
    pub place_m: Vector3<f64>,
    /// Standard deviation of east and of north, and of the height \[m\].
    pub sigma_m: [f64; 2],
}

/// What was seen at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedSighting {
    /// Where.
    pub row: PickedRow,
    /// GPS time as the points of the strips have it \[s\].
    pub gps_time_s: f64,
    /// Scanner, 0-based, where the row names it.
    pub scanner: Option<u16>,
}

/// A point with all its rows.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedPoint {
    /// Its name.
    pub name: String,
    /// Sightings, in order of time: two or more, or one and more where the point is known.
    pub sightings: Vec<PickedSighting>,
    /// Where it is known to be.
    pub known: Option<PickedRow>,
}

/// Reads picked points, plain or gzipped, in the order in which they are first named.
///
/// # Errors
/// [`PickedError`] names file, line, value and remedy.
pub fn read_picked(path: &Path) -> Result<Vec<PickedPoint>, PickedError> {
    let file = File::open(path).map_err(|source| PickedError::Io { path: path.to_path_buf(), source })?;
    read_from(BufReader::new(file), path)
}

/// Reads picked points from any source; `path` is for messages only.
///
/// # Errors
/// As [`read_picked`].
pub fn read_from(source: impl BufRead, path: &Path) -> Result<Vec<PickedPoint>, PickedError> {
    let source = unpacked(source).map_err(|source| PickedError::Io { path: path.to_path_buf(), source })?;
    let mut lines = Lines::new(source, path);
    let mut header: Option<Header> = None;
    let mut points: Vec<PickedPoint> = Vec::new();
    let mut numbers: BTreeMap<String, usize> = BTreeMap::new();
    while let Some(line) = lines.next().map_err(refused)? {
        if line.is_comment() {
            continue;
        }
        let Some(header) = &header else {
            header = Some(Header::of(line.text, path)?);
            continue;
        };
        let at = |fault| PickedError::Row { path: path.to_path_buf(), line: line.number, fault };
        let (name, entry) = header.row(line.text, line.number).map_err(at)?;
        let number = *numbers.entry(name.clone()).or_insert(points.len());
        if number == points.len() {
            points.push(PickedPoint { name, sightings: Vec::new(), known: None });
        }
        points[number].take(entry).map_err(at)?;
    }
    if header.is_none() {
        return Err(PickedError::Empty { path: path.to_path_buf() });
    }
    for point in &mut points {
        point.sightings.sort_by(|a, b| a.gps_time_s.total_cmp(&b.gps_time_s));
        let due = if point.known.is_some() { 1 } else { 2 };
        if point.sightings.len() < due {
            let line = point.sightings.first().map(|s| s.row.line).or(point.known.as_ref().map(|k| k.line));
            let (path, line, point) = (path.to_path_buf(), line.unwrap_or(0), point.name.clone());
            return Err(PickedError::Row { path, line, fault: PickedFault::TooFew { point } });
        }
    }
    Ok(points)
}

/// A row as it stands: a sighting, or where the point is known to be.
enum Entry {
    Seen(PickedSighting),
    Known(PickedRow),
}

impl PickedPoint {
    fn take(&mut self, entry: Entry) -> Result<(), PickedFault> {
        match entry {
            Entry::Known(row) => {
                if let Some(before) = self.known.replace(row) {
                    return Err(PickedFault::KnownTwice { point: self.name.clone(), line: before.line });
                }
            }
            Entry::Seen(sighting) => {
                let is_same = |s: &&PickedSighting| {
                    s.gps_time_s.total_cmp(&sighting.gps_time_s).is_eq() && s.scanner == sighting.scanner
                };
                if let Some(before) = self.sightings.iter().find(is_same) {
                    return Err(PickedFault::SeenTwice { point: self.name.clone(), line: before.row.line });
                }
                self.sightings.push(sighting);
            }
        }
        Ok(())
    }
}

fn refused(error: LineError) -> PickedError {
    match error {
        LineError::Io { path, source, .. } => PickedError::Io { path, source },
        LineError::TooLong { path, line, limit } => PickedError::LongLine { path, line, limit },
    }
}

/// The start of a text, for messages.
fn shown(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Columns: how messages name them, what else they may be called, and whether they must be there.
const COLUMNS: [(&str, &[&str], bool); 8] = [
    ("point", &["point", "id", "point_id", "name"], true),
    ("gps_time_s", &["gps_time_s", "gps_time", "time_s", "time"], true),
    ("x_m", &["x_m", "x", "easting", "easting_m"], true),
    ("y_m", &["y_m", "y", "northing", "northing_m"], true),
    ("z_m", &["z_m", "z", "height", "height_m"], true),
    ("sigma_plan_m", &["sigma_plan_m", "sigma_plan"], false),
    ("sigma_height_m", &["sigma_height_m", "sigma_height"], false),
    ("scanner", &["scanner"], false),
];

/// Which field holds what.
struct Header {
    delimiter: Delimiter,
    fields: usize,
    places: [Option<usize>; COLUMNS.len()],
}

impl Header {
    fn of(text: &str, path: &Path) -> Result<Self, PickedError> {
        let delimiter = Delimiter::of(text);
        let names: Vec<String> = delimiter.split(text).map(plain_name).collect();
        let mut places = [None; COLUMNS.len()];
        for (field, name) in names.iter().enumerate() {
            let known = COLUMNS.iter().position(|(_, names, _)| names.contains(&name.as_str()));
            let Some(column) = known.filter(|column| places[*column].is_none()) else {
                return Err(PickedError::Column { path: path.to_path_buf(), found: shown(name) });
            };
            places[column] = Some(field);
        }
        match COLUMNS.iter().zip(&places).find(|((_, _, is_due), place)| *is_due && place.is_none()) {
            Some(((name, _, _), _)) => Err(PickedError::MissingColumn { path: path.to_path_buf(), column: name }),
            None => Ok(Self { delimiter, fields: names.len(), places }),
        }
    }

    /// A row with the name of its point.
    fn row(&self, text: &str, line: u64) -> Result<(String, Entry), PickedFault> {
        let texts: Vec<&str> = self.delimiter.split(text).collect();
        if texts.len() != self.fields {
            return Err(PickedFault::FieldCount { found: texts.len(), expected: self.fields });
        }
        let field = |column: usize| self.places[column].map_or("", |place| texts[place]);
        let wrong = |column: usize, expected| PickedFault::Field {
            column: COLUMNS[column].0,
            text: shown(field(column)),
            expected,
        };
        let number = |column: usize, is_good: &dyn Fn(f64) -> bool, expected| {
            let value = field(column).parse().ok().filter(|v: &f64| v.is_finite() && is_good(*v));
            value.ok_or_else(|| wrong(column, expected))
        };
        // empty where nothing is given
        let optional = |column: usize, is_good: &dyn Fn(f64) -> bool, expected| {
            (!field(column).is_empty()).then(|| number(column, is_good, expected)).transpose()
        };
        let name = field(0).trim_matches('"');
        if name.is_empty() || name.chars().count() > LONGEST_NAME {
            return Err(wrong(0, "a name of 1 to 80 characters"));
        }
        let gps_time_s = optional(1, &|t: f64| t.abs() < 1e10, "GPS time as the strips have it, or nothing,")?;
        let coordinate = |column| number(column, &|v| v.abs() <= FARTHEST_M, "a coordinate in the map, metres,");
        let place_m = Vector3::new(coordinate(2)?, coordinate(3)?, coordinate(4)?);
        let sigma = |column| optional(column, &|v| SIGMAS_M.contains(&v), "0.0001 to 10 m, or nothing,");
        let given = [sigma(5)?, sigma(6)?];
        let or_else = if gps_time_s.is_some() { PICKED_SIGMA_M } else { KNOWN_SIGMA_M };
        let sigma_m = std::array::from_fn(|k| given[k].unwrap_or(or_else[k]));
        let scanner = match field(7) {
            "" => None,
            text => Some(text.parse().map_err(|_| wrong(7, "the number of a scanner, from 0, or nothing,"))?),
        };
        let row = PickedRow { line, place_m, sigma_m };
        let entry = match gps_time_s {
            Some(gps_time_s) => Entry::Seen(PickedSighting { row, gps_time_s, scanner }),
            None => Entry::Known(row),
        };
        Ok((name.to_string(), entry))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<PickedPoint>, String> {
        read_from(text.as_bytes(), Path::new("points.csv")).map_err(|e| e.to_string())
    }

    #[test]
    fn rows_of_a_point_are_put_together_in_order_of_time() {
        let text = "# picked by hand\nscanner;Point;X [m];Y [m];Z [m];gps_time_s;sigma_plan_m;sigma_height_m\n\
                    1;a;1.5;2;3;200.5;;0.03\n0;b;7;8;9;100;;\n0;a;1.6;2;3;100.25;0.05;\n;b;7;8;9;;;\n";
        let points = read(text).expect("points");
        assert_eq!(points.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        let [first, second] = &points[0].sightings[..] else { panic!("two") };
        assert_eq!((first.gps_time_s, first.scanner, first.row.line), (100.25, Some(0), 5));
        assert_eq!((first.row.sigma_m, second.row.sigma_m), ([0.05, 0.01], [0.02, 0.03]));
        assert_eq!(second.row.place_m, Vector3::new(1.5, 2.0, 3.0));
        let known = points[1].known.as_ref().expect("known");
        assert_eq!((known.line, known.sigma_m, points[1].sightings.len()), (6, KNOWN_SIGMA_M, 1));
    }

    #[test]
    fn what_cannot_be_right_is_named_with_its_line() {
        const HEADER: &str = "point,gps_time_s,x_m,y_m,z_m,sigma_plan_m,scanner\n";
        let refuse = |rows: &str, words: &[&str]| {
            let error = read(&format!("{HEADER}{rows}")).expect_err("refused");
            assert!(error.contains("points.csv") && words.iter().all(|w| error.contains(w)), "{error}");
        };
        refuse("a,1,2,3\n", &["line 2", "4 fields", "7 were due"]);
        refuse("a,1,2,3,north,,\n", &["line 2", "z_m", "\"north\""]);
        refuse("a,1,2,3,nan,,\n", &["line 2", "z_m", "\"nan\""]);
        refuse("a,soon,2,3,4,,\n", &["line 2", "gps_time_s", "\"soon\""]);
        refuse("a,1,2,3,4,-0.1,\n", &["line 2", "sigma_plan_m", "\"-0.1\""]);
        refuse("a,1,2,3,4,,left\n", &["line 2", "scanner", "\"left\""]);
        refuse(",1,2,3,4,,\n", &["line 2", "point"]);
        refuse("b,1,2,3,4,,\nb,2,2,3,4,,\na,1,2,3,4,,\n", &["line 4", "\"a\"", "one row"]);
        refuse("a,,2,3,4,,\n", &["line 2", "\"a\"", "one row"]);
        refuse("a,1,2,3,4,,\na,,2,3,4,,\na,,2,3,4,,\n", &["line 4", "\"a\"", "line 3"]);
        refuse("a,1,2,3,4,,0\na,1,2,3,4,,0\n", &["line 3", "\"a\"", "line 2"]);
        let error = read("point,gps_time_s,x_m,y_m\n").expect_err("refused");
        assert!(error.contains("z_m"), "{error}");
        let error = read("point,gps_time_s,x_m,y_m,z_m,x_m\n").expect_err("refused");
        assert!(error.contains("\"x_m\""), "{error}");
        assert!(read("").expect_err("refused").contains("nothing"));
        assert_eq!(read(HEADER), Ok(Vec::new()));
    }
}
