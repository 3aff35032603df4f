//! Writing `ties.txt`.

use std::borrow::Borrow;
use std::io::{self, Write};
use std::path::Path;

use super::error::TieTextError;
use super::{COLUMNS, FRAMES, MAGIC, TextTie, TieTextHeader, VERSION};
use crate::output::WholeFile;

/// Writes `ties.txt`, whole or not at all. Numbers have the digits that lead back to the same f64.
///
/// # Errors
/// [`TieTextError::Io`] when the disk refuses.
pub fn write_tie_text(
    path: &Path,
    header: &TieTextHeader,
    ties: impl IntoIterator<Item = impl Borrow<TextTie>>,
) -> Result<(), TieTextError> {
    let write = || -> io::Result<()> {
        let mut file = WholeFile::create(path)?;
        write_to(file.writer(), header, ties)?;
        file.finish()
    };
    write().map_err(|source| TieTextError::Io { path: path.to_path_buf(), source })
}

/// Writes ties as text to anywhere.
///
/// # Errors
/// Those of the writer.
pub fn write_to(
    out: &mut impl Write,
    header: &TieTextHeader,
    ties: impl IntoIterator<Item = impl Borrow<TextTie>>,
) -> io::Result<()> {
    writeln!(out, "{MAGIC} {VERSION}")?;
    writeln!(
        out,
        "# One row a sighting. For all sightings of a tie u . (p + C l) is the same but for its noise: p, C position and"
    )?;
    writeln!(
        out,
        "# attitude of the IMU, l the body vector, u the direction. Rank 2 and 3: 2 or 3 directions, then the upper triangle"
    )?;
    writeln!(
        out,
        "# of the covariance along them, row by row. Where used is 1 the covariance counted as divided by the weight."
    )?;
    match header.week {
        Some(week) => writeln!(out, "# week: {week} (GPS, counted from 1980 without rollover)")?,
        None => writeln!(out, "# week: unknown")?,
    }
    for (key, word, remark) in FRAMES {
        writeln!(out, "# {key}: {word} ({remark})")?;
    }
    if let Some(datum) = &header.datum {
        writeln!(out, "# datum: {}", datum.replace(['\n', '\r'], " "))?;
    }
    writeln!(out, "# {COLUMNS}")?;
    for tie in ties {
        rows(out, tie.borrow())?;
    }
    Ok(())
}

fn rows(out: &mut impl Write, tie: &TextTie) -> io::Result<()> {
    let rank = tie.directions.len();
    for s in &tie.sightings {
        let l = &s.body_vector_m;
        write!(out, "{} {} {} {rank} {} {}", tie.id, tie.class.word(), tie.kind.as_str(), s.time_s, s.scanner)?;
        write!(out, " {} {} {} {} {}", l.x, l.y, l.z, u8::from(s.used), s.weight)?;
        for u in &tie.directions {
            write!(out, " {} {} {}", u.x, u.y, u.z)?;
        }
        for i in 0..rank {
            for j in i..rank {
                write!(out, " {:e}", s.covariance_m2[(i, j)])?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}
