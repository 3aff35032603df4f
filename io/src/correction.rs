//! `correction.csv`: what is added to a trajectory over time.
//!
//! Columns, in this order and by this header:
//! `gps_time_s,dE_m,dN_m,dU_m,droll_deg,dpitch_deg,dheading_deg,sigma_E_m,sigma_N_m,sigma_U_m,sigma_roll_deg,`
//! `sigma_pitch_deg,sigma_heading_deg`. The sigmas may be left out. Times are those of the strips' clock, strictly
//! increasing: the time tells the strip. Numbers are printed with the digits that lead back to the same f64; a
//! correction and its negative therefore cancel exactly.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use nalgebra::{Vector3, Vector6};
use tieline_filter::{Correction, CorrectionRow, TrajectoryError};

use crate::output::WholeFile;

/// The header.
pub const HEADER: &str = "gps_time_s,dE_m,dN_m,dU_m,droll_deg,dpitch_deg,dheading_deg,\
                          sigma_E_m,sigma_N_m,sigma_U_m,sigma_roll_deg,sigma_pitch_deg,sigma_heading_deg";
/// Columns up to the sigmas.
const WITHOUT_SIGMA: usize = 7;
/// All columns.
const WITH_SIGMA: usize = 13;

/// Why a correction file cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CorrectionFileError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// The first line is not the header.
    #[error("{}: the first line is \"{found}\" where the header \"{HEADER}\" was due", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// What stands there.
        found: String,
    },
    /// A line with the wrong number of fields.
    #[error("{}: line {line} has {found} fields where {expected} were due", path.display())]
    FieldCount {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// Fields found.
        found: usize,
        /// Fields due.
        expected: usize,
    },
    /// A field that is no finite number.
    #[error("{}: line {line}, column {column}: \"{text}\" is not a finite number", path.display())]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// Name of the column.
        column: &'static str,
        /// What stands there.
        text: String,
    },
    /// Time stands still or runs backwards.
    #[error("{}: line {line}: time {time_s:?} s does not come after {previous_s:?} s; sort the file by time", path.display())]
    TimeNotIncreasing {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: u64,
        /// Its time \[s\].
        time_s: f64,
        /// The time before it \[s\].
        previous_s: f64,
    },
    /// A header and nothing else.
    #[error("{}: there is no correction in the file", path.display())]
    NoRows {
        /// The file.
        path: PathBuf,
    },
    /// The rows do not make a correction.
    #[error("{}: {source}", path.display())]
    Correction {
        /// The file.
        path: PathBuf,
        /// Why.
        source: TrajectoryError,
    },
}

/// Reads `correction.csv`.
///
/// # Errors
/// [`CorrectionFileError`] names file, line, column and remedy.
pub fn read_correction(path: &Path) -> Result<Correction, CorrectionFileError> {
    let io = |source| CorrectionFileError::Io { path: path.to_path_buf(), source };
    read_from(BufReader::new(File::open(path).map_err(io)?), path)
}

/// Reads `correction.csv` from any source; `path` is for messages only.
///
/// # Errors
/// As [`read_correction`].
pub fn read_from(source: impl BufRead, path: &Path) -> Result<Correction, CorrectionFileError> {
    let mut rows: Vec<CorrectionRow> = Vec::new();
    let mut columns = 0;
    for (line, text) in (1..).zip(source.lines()) {
        let text = text.map_err(|source| CorrectionFileError::Io { path: path.to_path_buf(), source })?;
        let text = text.trim_start_matches('\u{feff}').trim();
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        if columns == 0 {
            columns = header_columns(text, path)?;
            continue;
        }
        let row = row(text, columns, line, path)?;
        if let Some(previous_s) = rows.last().map(|previous| previous.time_s)
            && row.time_s <= previous_s
        {
            let (path, time_s) = (path.to_path_buf(), row.time_s);
            return Err(CorrectionFileError::TimeNotIncreasing { path, line, time_s, previous_s });
        }
        rows.push(row);
    }
    if rows.is_empty() {
        return Err(CorrectionFileError::NoRows { path: path.to_path_buf() });
    }
    Correction::new(rows).map_err(|source| CorrectionFileError::Correction { path: path.to_path_buf(), source })
}

/// Columns of the header: with sigmas or without.
fn header_columns(text: &str, path: &Path) -> Result<usize, CorrectionFileError> {
    let found: Vec<&str> = text.split(',').map(str::trim).collect();
    let due = HEADER.split(',').take(found.len());
    match (found.len() == WITHOUT_SIGMA || found.len() == WITH_SIGMA) && due.eq(found.iter().copied()) {
        true => Ok(found.len()),
        false => {
            let found = text.chars().take(200).collect();
            Err(CorrectionFileError::Header { path: path.to_path_buf(), found })
        }
    }
}

fn row(text: &str, columns: usize, line: u64, path: &Path) -> Result<CorrectionRow, CorrectionFileError> {
    let found = text.split(',').count();
    if found != columns {
        return Err(CorrectionFileError::FieldCount { path: path.to_path_buf(), line, found, expected: columns });
    }
    let mut value = [0.0; WITH_SIGMA];
    for ((value, field), column) in value.iter_mut().zip(text.split(',')).zip(HEADER.split(',')) {
        let field = field.trim();
        *value = field.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| CorrectionFileError::NotANumber {
            path: path.to_path_buf(),
            line,
            column,
            text: field.chars().take(40).collect(),
        })?;
    }
    Ok(CorrectionRow {
        time_s: value[0],
        position_enu_m: Vector3::new(value[1], value[2], value[3]),
        attitude_rph_rad: Vector3::new(value[4], value[5], value[6]).map(f64::to_radians),
        sigma: Vector6::new(
            value[7],
            value[8],
            value[9],
            value[10].to_radians(),
            value[11].to_radians(),
            value[12].to_radians(),
        ),
    })
}

/// Writes `correction.csv`, whole or not at all. The times of `correction` plus `shift_s` are written: give the
/// negative of [`tieline_filter::SurveyClock::shift_s`] to have the strips' own time, 0 for the survey's.
///
/// # Errors
/// [`CorrectionFileError::Io`] when the disk refuses.
pub fn write_correction(path: &Path, correction: &Correction, shift_s: f64) -> Result<(), CorrectionFileError> {
    let write = || -> io::Result<()> {
        let mut file = WholeFile::create(path)?;
        let out = file.writer();
        writeln!(out, "{HEADER}")?;
        for row in correction.rows() {
            write!(out, "{}", row.time_s + shift_s)?;
            for metres in &row.position_enu_m {
                write!(out, ",{metres}")?;
            }
            for radians in &row.attitude_rph_rad {
                write!(out, ",{}", degrees(*radians))?;
            }
            for metres in row.sigma.iter().take(3) {
                write!(out, ",{metres}")?;
            }
            for radians in row.sigma.iter().skip(3) {
                write!(out, ",{}", degrees(*radians))?;
            }
            writeln!(out)?;
        }
        file.finish()
    };
    write().map_err(|source| CorrectionFileError::Io { path: path.to_path_buf(), source })
}

/// The degrees that [`f64::to_radians`] turns back into exactly these radians, where there are such: the division
/// may miss them by one step of the last digit.
fn degrees(radians: f64) -> f64 {
    let near = radians.to_degrees();
    [near, near.next_up(), near.next_down()]
        .into_iter()
        .find(|degrees| degrees.to_radians().to_bits() == radians.to_bits())
        .unwrap_or(near)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str) -> Result<Correction, CorrectionFileError> {
        read_from(text.as_bytes(), Path::new("correction.csv"))
    }

    fn correction(size: f64) -> Correction {
        let row = |i: u32| {
            let x = size * (f64::from(i) / 7.0 + 0.013);
            CorrectionRow {
                time_s: 388_800.123_456_789 + f64::from(i) / 3.0,
                position_enu_m: Vector3::new(x, -x / 3.0, x / 11.0),
                attitude_rph_rad: Vector3::new(x / 700.0, -x / 900.0, x / 1100.0),
                sigma: Vector6::new(0.01, 0.02, 0.03, 1e-5 / 3.0, 2e-5 / 7.0, 1e-6),
            }
        };
        Correction::new((0..200).map(row).collect()).expect("good rows")
    }

    #[test]
    fn a_correction_comes_back_from_its_file_as_it_went() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("correction.csv");
        write_correction(&path, &correction(0.1), 0.0).expect("written");
        let back = read_correction(&path).expect("read");
        for (a, b) in correction(0.1).rows().iter().zip(back.rows()) {
            assert_eq!((a.time_s, a.position_enu_m), (b.time_s, b.position_enu_m));
            // Not every number of radians is a number of degrees in f64: one step of the last digit may be lost.
            assert!((a.attitude_rph_rad - b.attitude_rph_rad).amax() <= f64::EPSILON * a.attitude_rph_rad.amax());
            assert!((a.sigma - b.sigma).amax() <= f64::EPSILON * a.sigma.amax());
        }
    }

    #[test]
    fn a_correction_and_its_negative_cancel_exactly() {
        let folder = tempfile::tempdir().expect("a folder");
        let (there, back) = (folder.path().join("there.csv"), folder.path().join("back.csv"));
        write_correction(&there, &correction(0.1), 0.0).expect("written");
        write_correction(&back, &correction(-0.1), 0.0).expect("written");
        let (there, back) = (read_correction(&there).expect("read"), read_correction(&back).expect("read"));
        for i in 0..5000 {
            let time_s = 388_790.0 + f64::from(i) * 0.0173;
            let ((p, a), (q, b)) = (there.at(time_s), back.at(time_s));
            assert_eq!((p + q, a + b), (Vector3::zeros(), Vector3::zeros()), "at {time_s}");
        }
    }

    #[test]
    fn sigmas_may_be_left_out_and_a_single_row_is_a_constant() {
        let text = "gps_time_s,dE_m,dN_m,dU_m,droll_deg,dpitch_deg,dheading_deg\n5,0.1,0.2,0.3,0,0,180\n";
        let (position, attitude) = read(text).expect("good").at(99.0);
        assert_eq!(position, Vector3::new(0.1, 0.2, 0.3));
        assert!((attitude.z - std::f64::consts::PI).abs() < 1e-15);
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        let head = "gps_time_s,dE_m,dN_m,dU_m,droll_deg,dpitch_deg,dheading_deg\n";
        for (text, words) in [
            (format!("{head}1,0,0,0,0,0,0\n2,0,x,0,0,0,0\n"), &["line 3", "dN_m", "\"x\""][..]),
            (format!("{head}1,0,0,0,0,0,0\n2,0,inf,0,0,0,0\n"), &["line 3", "dN_m"]),
            (format!("{head}1,0,0\n"), &["line 2", "3 fields", "7"]),
            (format!("{head}2,0,0,0,0,0,0\n2,0,0,0,0,0,0\n"), &["line 3", "sort"]),
            ("time,dx\n1,2\n".into(), &["header", "gps_time_s"]),
            (head.into(), &["no correction"]),
            (String::new(), &["no correction"]),
        ] {
            let error = read(&text).expect_err(&text).to_string();
            for word in words {
                assert!(error.contains(word), "\"{word}\" is not in: {error}");
            }
        }
    }

    proptest! {
        #[test]
        fn any_text_never_panics(text in "(gps_time_s,dE_m,dN_m,dU_m,droll_deg,dpitch_deg,dheading_deg\n)?[-0-9e.,\n]{0,100}") {
            let _ = read(&text);
        }
    }
}
