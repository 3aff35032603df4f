//! What a file is, by its first bytes.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, bail};
use tieline_io::ties::text::MAGIC;

/// The kinds of files that tieline reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// LAS, LAZ, COPC.
    Strip,
    /// SBET, TRJ, text.
    Trajectory,
    /// SMRMSG.
    Accuracy,
    /// `ties.parquet`.
    TiesParquet,
    /// `ties.csv`.
    TiesCsv,
    /// `ties.txt`.
    TiesText,
    /// `correction.csv`.
    Correction,
    /// Inertial measurements.
    Imu,
    /// GNSS fixes.
    Gnss,
    /// Odometer.
    Odometer,
}

impl FileKind {
    /// For people.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Strip => "point cloud",
            Self::Trajectory => "trajectory",
            Self::Accuracy => "accuracies of a trajectory (SMRMSG)",
            Self::TiesParquet => "ties (Parquet)",
            Self::TiesCsv => "ties (CSV)",
            Self::TiesText => "ties (text)",
            Self::Correction => "correction over time",
            Self::Imu => "inertial measurements",
            Self::Gnss => "GNSS fixes",
            Self::Odometer => "odometer",
        }
    }

    /// For machines.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Strip => "strip",
            Self::Trajectory => "trajectory",
            Self::Accuracy => "accuracy",
            Self::TiesParquet | Self::TiesCsv | Self::TiesText => "ties",
            Self::Correction => "correction",
            Self::Imu => "imu",
            Self::Gnss => "gnss",
            Self::Odometer => "odometer",
        }
    }
}

/// Bytes that are looked at.
const HEAD_BYTES: u64 = 4096;

/// Tells what a file is.
///
/// # Errors
/// When it cannot be read, is empty, or is of no known kind.
pub fn kind_of(path: &Path) -> Result<FileKind> {
    let mut head = Vec::new();
    let file = File::open(path).with_context(|| format!("{}", path.display()))?;
    let length = file.metadata().with_context(|| format!("{}", path.display()))?.len();
    file.take(HEAD_BYTES).read_to_end(&mut head).with_context(|| format!("{}", path.display()))?;
    let starts = |magic: &[u8]| head.starts_with(magic);
    Ok(if head.is_empty() {
        bail!("{}: the file is empty", path.display());
    } else if starts(b"LASF") {
        FileKind::Strip
    } else if starts(b"PAR1") {
        FileKind::TiesParquet
    } else if starts(b"tie_id,") {
        FileKind::TiesCsv
    } else if starts(MAGIC.as_bytes()) {
        FileKind::TiesText
    } else if starts(b"gps_time_s,dE_m") {
        FileKind::Correction
    } else if starts(b"TSCANTRJ") || starts(&[0x1f, 0x8b]) || is_table(&head) || is_sbet(&head) {
        FileKind::Trajectory
    } else if is_smrmsg(&head) {
        FileKind::Accuracy
    } else if is_binary(&head) && length.is_multiple_of(17 * 8) {
        FileKind::Trajectory // a damaged SBET: its reader says what is wrong
    } else {
        bail!(
            "{}: not a file that tieline reads (LAS, LAZ, COPC; SBET, SMRMSG, TRJ, text trajectories; \
             IMU, GNSS, odometer; ties.parquet, ties.csv, ties.txt, correction.csv)",
            path.display()
        );
    })
}

fn is_binary(head: &[u8]) -> bool {
    head.contains(&0)
}

/// Text whose lines hold several numbers, or columns of names.
fn is_table(head: &[u8]) -> bool {
    let text = match std::str::from_utf8(head) {
        Ok(text) => text,
        Err(error) if error.error_len().is_none() => {
            std::str::from_utf8(&head[..error.valid_up_to()]).unwrap_or_default()
        }
        Err(_) => return false,
    };
    let separators = [',', ';', '\t', ' '];
    let numbers = |line: &str| line.split(separators).filter(|f| f.trim().parse::<f64>().is_ok()).count();
    !is_binary(head) && text.lines().take(60).any(|line| numbers(line) >= 4)
}

/// The numbers of record `number` of `N` little-endian f64 each; `None` beyond the head.
fn record<const N: usize>(head: &[u8], number: usize) -> Option<[f64; N]> {
    let bytes = head.get(number * N * 8..(number + 1) * N * 8)?;
    let mut values = [0.0; N];
    for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(8)) {
        *value = f64::from_le_bytes(bytes.try_into().ok()?);
    }
    Some(values)
}

fn is_sbet(head: &[u8]) -> bool {
    let good = |v: &[f64; 17]| {
        v[..17].iter().all(|x| x.is_finite())
            && v[1].abs() <= 7.0
            && v[2].abs() <= 7.0
            && v[3].abs() < 1e5
            && v[7].abs() < 7.0
            && v[8].abs() < 7.0
            && (v[0].abs() > 1e-6 || v[0] == 0.0)
            && v[0].abs() < 1e10
    };
    let follows = |a: &[f64; 17], b: &[f64; 17]| (b[0] - a[0]).abs() < 1e6 && (a[3] - b[3]).abs() < 1e4;
    match (record::<17>(head, 0), record::<17>(head, 1)) {
        (Some(a), Some(b)) => good(&a) && good(&b) && follows(&a, &b) && !is_smrmsg(head),
        _ => false,
    }
}

fn is_smrmsg(head: &[u8]) -> bool {
    let good = |v: &[f64; 10]| {
        v[1..].iter().all(|x| x.is_finite() && *x >= 0.0 && *x < 1e4 && (*x > 1e-12 || *x == 0.0))
            && v[0].is_finite()
            && v[0].abs() < 1e10
    };
    match (record::<10>(head, 0), record::<10>(head, 1)) {
        (Some(a), Some(b)) => good(&a) && good(&b) && b[0] > a[0] && b[0] - a[0] < 1e4,
        _ => false,
    }
}
