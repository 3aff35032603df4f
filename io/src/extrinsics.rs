//! Mounting of several scanners against one of them: text with one row a scanner.
//!
//! Columns by name, in any order, unknown ones passed over: `scanner_channel` (or `scanner`, `scanner_id`, `id`); the
//! rotation `reference_from_scanner` as a matrix `r11` … `r33` (row, column), as `roll_deg, pitch_deg, yaw_deg`
//! (`Rz(yaw) Ry(pitch) Rx(roll)`; `_rad` is understood too) or as a quaternion `qw, qx, qy, qz`; and the place of the
//! scanner in the frame of the reference, `tx, ty, tz` (or `x_m, y_m, z_m`), in metres. An optional `name`.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use crate::delimited::{Delimiter, LineError, Lines, unpacked};

/// The mounting of one scanner.
#[derive(Debug, Clone, PartialEq)]
pub struct ScannerExtrinsics {
    /// Number of the scanner, as in the points.
    pub scanner: u16,
    /// Its name; empty where the file gives none.
    pub name: String,
    /// Turns directions of the scanner's frame into that of the reference.
    pub reference_from_scanner: UnitQuaternion<f64>,
    /// The scanner's origin in the frame of the reference \[m\].
    pub position_m: Vector3<f64>,
    /// Roll, pitch and yaw as written under names in degrees; `None` where the rotation is given otherwise.
    pub angles_deg: Option<[f64; 3]>,
}

/// Why a file of extrinsics cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExtrinsicsError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// A line without end.
    #[error("{}: line {line} is longer than {limit} bytes; this is no table of scanners", path.display())]
    LongLine {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// Bytes taken.
        limit: usize,
    },
    /// No rows.
    #[error("{}: the file holds no scanner; give a header and one row for each scanner", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A column that is needed.
    #[error("{}: column {column} is missing (found: {found}); needed are {}", path.display(), NEEDED)]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// Its name.
        column: String,
        /// The header.
        found: String,
    },
    /// A field that is no number.
    #[error("{}: line {line}: {column} is \"{text}\" where {expected} was due", path.display())]
    BadField {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// Its name.
        column: String,
        /// What was found.
        text: String,
        /// What was due.
        expected: &'static str,
    },
    /// A matrix that does not turn.
    #[error(
        "{}: line {line}: r11 … r33 of scanner {scanner} are no rotation (off by {error:.2e}, determinant {determinant:.3}); \
         give reference_from_scanner row by row, without scale or mirror",
        path.display()
    )]
    NoRotation {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// The scanner.
        scanner: u16,
        /// Largest element of `RᵀR - I`.
        error: f64,
        /// Determinant.
        determinant: f64,
    },
    /// Angles in the wrong unit.
    #[error("{}: {message}", path.display())]
    Unit {
        /// The file.
        path: PathBuf,
        /// What it looks like and the way out.
        message: String,
    },
    /// A scanner twice.
    #[error("{}: line {line}: scanner {scanner} has a row already; give each scanner once", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: u64,
        /// The scanner.
        scanner: u16,
    },
}

const NEEDED: &str = "scanner_channel; r11 … r33, or roll_deg, pitch_deg, yaw_deg, or qw, qx, qy, qz; tx, ty, tz [m]";
const ID: [&str; 4] = ["scanner_channel", "scanner", "scanner_id", "id"];
const MATRIX: [&str; 9] = ["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"];
const DEGREES: [&str; 3] = ["roll_deg", "pitch_deg", "yaw_deg"];
const RADIANS: [&str; 3] = ["roll_rad", "pitch_rad", "yaw_rad"];
const QUATERNION: [&str; 4] = ["qw", "qx", "qy", "qz"];
const POSITION: [[&str; 3]; 3] =
    [["tx", "ty", "tz"], ["x_m", "y_m", "z_m"], ["lever_arm_x_m", "lever_arm_y_m", "lever_arm_z_m"]];
/// Largest element of `RᵀR - I` of a matrix with rounded digits.
const ROUNDED: f64 = 0.02;
/// Scanners of one platform stand no further apart than this \[m\].
const FURTHEST_M: f64 = 50.0;
/// No angle is given beyond two turns \[rad\].
const MOST_RADIANS: f64 = 12.6;

/// How a file gives its rotations.
#[derive(Debug, Clone, Copy)]
enum Turn {
    Matrix,
    Degrees,
    Radians,
    Quaternion,
}

/// The header, and where its columns stand.
struct Header {
    names: Vec<String>,
    delimiter: Delimiter,
    turn: Turn,
    id: String,
    position: [&'static str; 3],
}

/// Reads a file of extrinsics.
///
/// # Errors
/// [`ExtrinsicsError`] names file, line, column and remedy.
pub fn read_extrinsics(path: &Path) -> Result<Vec<ScannerExtrinsics>, ExtrinsicsError> {
    let file = File::open(path).map_err(|source| ExtrinsicsError::Io { path: path.to_path_buf(), source })?;
    read_from(BufReader::new(file), path)
}

/// Reads extrinsics from any source; `path` is for messages only.
///
/// # Errors
/// As [`read_extrinsics`].
pub fn read_from(source: impl BufRead, path: &Path) -> Result<Vec<ScannerExtrinsics>, ExtrinsicsError> {
    let io = |source| ExtrinsicsError::Io { path: path.to_path_buf(), source };
    let mut lines = Lines::new(unpacked(source).map_err(io)?, path);
    let mut header: Option<Header> = None;
    let mut scanners: Vec<ScannerExtrinsics> = Vec::new();
    while let Some(line) = lines.next().map_err(line_error)? {
        if line.is_comment() {
            continue;
        }
        let Some(header) = &header else {
            header = Some(Header::of(line.text, path)?);
            continue;
        };
        let scanner = header.scanner(line.number, line.text, path)?;
        if scanners.iter().any(|s| s.scanner == scanner.scanner) {
            let (line, scanner) = (line.number, scanner.scanner);
            return Err(ExtrinsicsError::Twice { path: path.to_path_buf(), line, scanner });
        }
        scanners.push(scanner);
    }
    if scanners.is_empty() {
        return Err(ExtrinsicsError::Empty { path: path.to_path_buf() });
    }
    check_lengths(&scanners, path)?;
    Ok(scanners)
}

fn line_error(error: LineError) -> ExtrinsicsError {
    match error {
        LineError::Io { path, source, .. } => ExtrinsicsError::Io { path, source },
        LineError::TooLong { path, line, limit } => ExtrinsicsError::LongLine { path, line, limit },
    }
}

impl Header {
    fn of(text: &str, path: &Path) -> Result<Self, ExtrinsicsError> {
        let text = text.trim_start_matches('\u{feff}');
        let delimiter = Delimiter::of(text);
        let names: Vec<String> =
            delimiter.split(text).map(|n| n.trim_matches('"').trim().to_ascii_lowercase()).collect();
        let has = |name: &str| names.iter().any(|n| n == name);
        let missing = |column: &str| ExtrinsicsError::MissingColumn {
            path: path.to_path_buf(),
            column: column.to_string(),
            found: names.join(", ").chars().take(300).collect(),
        };
        let id = ID.into_iter().find(|n| has(n)).ok_or_else(|| missing(ID[0]))?;
        let ways: [(Turn, &[&str]); 4] = [
            (Turn::Matrix, &MATRIX),
            (Turn::Degrees, &DEGREES),
            (Turn::Radians, &RADIANS),
            (Turn::Quaternion, &QUATERNION),
        ];
        // the way that has most of its columns, so that the message names what its author forgot
        let share = |columns: &[&str]| 36 * columns.iter().filter(|c| has(c)).count() / columns.len();
        let (turn, columns) = ways.into_iter().rev().max_by_key(|(_, columns)| share(columns)).unwrap_or(ways[0]);
        if let Some(column) = columns.iter().find(|c| !has(c)) {
            let bare = ["roll", "pitch", "yaw"].iter().any(|n| has(n));
            return Err(missing(if bare { "roll_deg (roll, pitch and yaw need their unit)" } else { column }));
        }
        let count = |columns: &[&str; 3]| columns.iter().filter(|c| has(c)).count();
        let position = POSITION.into_iter().rev().max_by_key(count).unwrap_or(POSITION[0]);
        if let Some(column) = position.iter().find(|c| !has(c)) {
            return Err(missing(column));
        }
        Ok(Self { delimiter, turn, id: id.to_string(), position, names })
    }

    fn scanner(&self, line: u64, text: &str, path: &Path) -> Result<ScannerExtrinsics, ExtrinsicsError> {
        let fields: Vec<&str> = self.delimiter.split(text).collect();
        let field = |column: &str| {
            self.names.iter().position(|n| n == column).and_then(|i| fields.get(i)).copied().unwrap_or_default()
        };
        let bad = |column: &str, expected| ExtrinsicsError::BadField {
            path: path.to_path_buf(),
            line,
            column: column.to_string(),
            text: field(column).chars().take(40).collect(),
            expected,
        };
        let number = |column: &str| {
            let value = field(column).parse::<f64>().ok().filter(|v| v.is_finite());
            value.ok_or_else(|| bad(column, "a number"))
        };
        let scanner = field(&self.id).parse().map_err(|_| bad(&self.id, "the number of a scanner"))?;
        let mut position_m = Vector3::zeros();
        for (value, column) in position_m.iter_mut().zip(self.position) {
            *value = number(column)?;
        }
        let mut angles_deg = None;
        let reference_from_scanner = match self.turn {
            Turn::Matrix => {
                let mut values = [0.0; 9];
                for (value, column) in values.iter_mut().zip(MATRIX) {
                    *value = number(column)?;
                }
                rotation(&Matrix3::from_row_slice(&values)).map_err(|(error, determinant)| {
                    ExtrinsicsError::NoRotation { path: path.to_path_buf(), line, scanner, error, determinant }
                })?
            }
            Turn::Degrees | Turn::Radians => {
                let degrees = matches!(self.turn, Turn::Degrees);
                let names = if degrees { DEGREES } else { RADIANS };
                let factor = if degrees { std::f64::consts::PI / 180.0 } else { 1.0 };
                let angles = [number(names[0])?, number(names[1])?, number(names[2])?];
                if let Some((value, name)) = angles.iter().zip(names).find(|(v, _)| !degrees && v.abs() > MOST_RADIANS)
                {
                    let message = format!(
                        "line {line}: {name} = {value} of scanner {scanner} can only be degrees; name the columns roll_deg, pitch_deg, yaw_deg"
                    );
                    return Err(ExtrinsicsError::Unit { path: path.to_path_buf(), message });
                }
                angles_deg = degrees.then_some(angles);
                let [roll, pitch, yaw] = angles;
                UnitQuaternion::from_euler_angles(roll * factor, pitch * factor, yaw * factor)
            }
            Turn::Quaternion => {
                let [w, x, y, z] = QUATERNION.map(number);
                let q = Quaternion::new(w?, x?, y?, z?);
                if (q.norm() - 1.0).abs() > ROUNDED {
                    return Err(bad("qw", "a quaternion of length 1 (qw, qx, qy, qz)"));
                }
                UnitQuaternion::from_quaternion(q)
            }
        };
        let name = field("name").to_string();
        Ok(ScannerExtrinsics { scanner, name, reference_from_scanner, position_m, angles_deg })
    }
}

/// The rotation next to a matrix with rounded digits; else how far it is from one, and its determinant.
fn rotation(matrix: &Matrix3<f64>) -> Result<UnitQuaternion<f64>, (f64, f64)> {
    let error = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    let determinant = matrix.determinant();
    if !(error < ROUNDED && determinant > 0.0) {
        return Err((error, determinant));
    }
    let svd = matrix.svd(true, true);
    match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v_t))),
        _ => Err((error, determinant)),
    }
}

/// Lengths that cannot be metres.
fn check_lengths(scanners: &[ScannerExtrinsics], path: &Path) -> Result<(), ExtrinsicsError> {
    match scanners.iter().find(|s| s.position_m.norm() > FURTHEST_M) {
        None => Ok(()),
        Some(s) => {
            let (scanner, length_m) = (s.scanner, s.position_m.norm());
            let message = format!(
                "scanner {scanner} stands {length_m:.1} m from the reference; positions are in metres, not in millimetres"
            );
            Err(ExtrinsicsError::Unit { path: path.to_path_buf(), message })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<ScannerExtrinsics>, ExtrinsicsError> {
        read_from(text.as_bytes(), Path::new("rough.csv"))
    }

    fn refused(text: &str, words: &[&str]) {
        let message = read(text).expect_err("refused").to_string();
        for word in words {
            assert!(message.contains(word), "\"{word}\" is not in: {message}");
        }
    }

    const HEADER: &str = "scanner_channel,name,r11,r12,r13,r21,r22,r23,r31,r32,r33,tx,ty,tz\n";

    #[test]
    fn a_matrix_turns_the_scanner_into_the_reference() {
        // a scanner turned left by 90°: its x axis is the reference's y axis
        let text = format!("{HEADER}0,top,1,0,0,0,1,0,0,0,1,0,0,0\n2,left,0,-1,0,1,0,0,0,0,1,0.1,0.6,-0.4\n");
        let scanners = read(&text).expect("two scanners");
        assert_eq!(scanners.iter().map(|s| s.scanner).collect::<Vec<_>>(), [0, 2]);
        assert_eq!(scanners[1].name, "left");
        assert!((scanners[1].reference_from_scanner * Vector3::x() - Vector3::y()).norm() < 1e-12);
        assert!((scanners[1].position_m - Vector3::new(0.1, 0.6, -0.4)).norm() < 1e-12);
    }

    #[test]
    fn angles_and_quaternions_say_the_same() {
        let degrees = read("id roll_deg pitch_deg yaw_deg x_m y_m z_m\n1 0 0 90 0 0 0\n").expect("degrees");
        let radians =
            read("id roll_rad pitch_rad yaw_rad x_m y_m z_m\n1 0 0 1.5707963267948966 0 0 0\n").expect("radians");
        let h = 0.5_f64.sqrt();
        let quaternion = read(&format!("id,qw,qx,qy,qz,tx,ty,tz\n1,{h},0,0,{h},0,0,0\n")).expect("a quaternion");
        for other in [&radians, &quaternion] {
            assert!(degrees[0].reference_from_scanner.angle_to(&other[0].reference_from_scanner) < 1e-9);
        }
        assert!(degrees[0].angles_deg.is_some() && radians[0].angles_deg.is_none());
    }

    #[test]
    fn a_missing_column_is_named() {
        refused(&HEADER.replace("r22,", ""), &["rough.csv", "r22", "missing", "scanner_channel"]);
        refused(&HEADER.replace(",tz", ""), &["tz", "missing"]);
        refused("name,r11\n", &["scanner_channel", "missing"]);
        refused("id,roll,pitch,yaw,tx,ty,tz\n", &["roll_deg", "unit"]);
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        refused(&format!("{HEADER}1,a,1,0,0,0,1,0,0,0,-1,0,0,0\n"), &["line 2", "scanner 1", "no rotation"]);
        refused(&format!("{HEADER}1,a,2,0,0,0,2,0,0,0,2,0,0,0\n"), &["no rotation", "scale"]);
        refused("id,qw,qx,qy,qz,tx,ty,tz\n1,3,0,0,1,0,0,0\n", &["qw", "length 1"]);
    }

    #[test]
    fn degrees_under_a_name_in_radians_are_told() {
        refused("id,roll_rad,pitch_rad,yaw_rad,tx,ty,tz\n1,0,0,90,0,0,0\n", &["yaw_rad", "90", "degrees"]);
    }

    #[test]
    fn fields_rows_and_lengths_that_cannot_be_are_told() {
        refused(&format!("{HEADER}1,a,x,0,0,0,1,0,0,0,1,0,0,0\n"), &["line 2", "r11", "\"x\"", "a number"]);
        refused(&format!("{HEADER}top,a,1,0,0,0,1,0,0,0,1,0,0,0\n"), &["scanner_channel", "\"top\""]);
        let row = "1,a,1,0,0,0,1,0,0,0,1,0,0,0\n";
        refused(&format!("{HEADER}{row}{row}"), &["line 3", "scanner 1", "already"]);
        refused(&format!("{HEADER}1,a,1,0,0,0,1,0,0,0,1,0,625.8,0\n"), &["625.8 m", "millimetres"]);
        refused(HEADER, &["no scanner"]);
        refused("", &["no scanner"]);
    }
}
