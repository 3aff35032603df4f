//! `TerraScan` trajectories (`.trj`): a head of 1376 bytes, then 64 bytes per epoch, little-endian.
//!
//! | record | meaning |
//! |---|---|
//! | f64 × 4 | time \[s\], easting, northing, height \[m\] |
//! | f64 × 3 | heading, roll, pitch \[**degrees**\] |
//! | u8 × 4 | accuracy codes of xy, z, heading, roll and pitch (kept raw: their steps are not published) |
//! | i16 × 2 | mark, flags |
//!
//! Neither the CRS nor the time system is in the file. Coordinates are those of the project (map), and so is the
//! heading here: **clockwise from grid north**, [`HeadingReference::GridNorth`]; the convergence of the CRS makes it
//! true. Roll is positive with the right side down, pitch with the nose up.

use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;

use bytemuck::{Pod, Zeroable};
use nalgebra::Vector3;
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{PositionFrame, Trajectory};

use super::error::{Place, TrajectoryFileError};
use super::file::{HeadingReference, TrajectoryFile, TrajectoryFormat};
use super::records::{Epoch, Records};
use super::sbet::need_frame;
use crate::output::WholeFile;

/// First bytes of the file.
pub const MAGIC: &[u8] = b"TSCANTRJ";
/// The version that everybody writes.
pub const VERSION: i32 = 20_010_715;
/// Bytes of the head.
pub const HEADER_BYTES: usize = 1376;
/// Bytes of a record.
pub const RECORD_BYTES: usize = 64;

/// One epoch, as in the file.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TrjRecord {
    /// Time \[s\].
    pub time_s: f64,
    /// Easting, northing, height \[m\].
    pub position_m: [f64; 3],
    /// Clockwise from grid north \[deg\].
    pub heading_deg: f64,
    /// Right side down \[deg\].
    pub roll_deg: f64,
    /// Nose up \[deg\].
    pub pitch_deg: f64,
    /// Accuracy codes of xy, z, heading, roll and pitch; raw.
    pub accuracy_code: [u8; 4],
    /// Mark; raw.
    pub mark: i16,
    /// Flags; raw.
    pub flags: i16,
}

/// A `.trj` file, as its bytes say it.
#[derive(Debug, Clone, PartialEq)]
pub struct TrjFile {
    /// Text of up to 78 bytes.
    pub description: String,
    /// Number of the scanner system.
    pub system_id: u8,
    /// 1 (best) to 5.
    pub quality: u8,
    /// Number of the trajectory before editing.
    pub original_number: i32,
    /// Flight line number.
    pub line_number: i32,
    /// The epochs.
    pub records: Vec<TrjRecord>,
}

/// Reads a `.trj`.
///
/// # Errors
/// [`TrajectoryFileError`] names file, record, value and remedy.
pub fn read_trj(path: &Path) -> Result<TrjFile, TrajectoryFileError> {
    let file = File::open(path).map_err(TrajectoryFileError::io(path))?;
    read_from(BufReader::with_capacity(1 << 20, file), path)
}

/// Reads a `.trj` from any source of bytes; `path` is for messages only.
///
/// # Errors
/// As [`read_trj`].
pub fn read_from(mut source: impl Read, path: &Path) -> Result<TrjFile, TrajectoryFileError> {
    let mut head = [0_u8; HEADER_BYTES];
    let found = fill(&mut source, &mut head, path)?;
    if found == 0 {
        return Err(TrajectoryFileError::Empty { path: path.to_path_buf() });
    }
    let header = |what: &'static str, found: String, expected: String| {
        Err(TrajectoryFileError::BadHeader { path: path.to_path_buf(), what, found, expected })
    };
    if !head.starts_with(MAGIC) {
        return header("the recognition string", printable(&head[..8]), printable(MAGIC));
    }
    if found < HEADER_BYTES {
        return header("the length of the head", found.to_string(), HEADER_BYTES.to_string());
    }
    let number = |at: usize| i32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    for (what, at, expected) in [("the version", 8, VERSION), ("the head size", 12, 1376), ("the record size", 20, 64)]
    {
        if number(at) != expected {
            return header(what, number(at).to_string(), expected.to_string());
        }
    }
    let Ok(count) = u64::try_from(number(16)) else {
        return header("the number of records", number(16).to_string(), "zero or more".into());
    };
    let mut records = Vec::new(); // grows with the bytes that are there, not with the count that is claimed
    for record in 0..count {
        let mut bytes = [0_u8; RECORD_BYTES];
        let found = fill(&mut source, &mut bytes, path)?;
        if found < RECORD_BYTES {
            let expected = RECORD_BYTES;
            return Err(TrajectoryFileError::TruncatedRecord { path: path.to_path_buf(), record, found, expected });
        }
        records.push(little_endian(bytemuck::pod_read_unaligned(&bytes)));
    }
    Ok(TrjFile {
        description: printable(&head[24..102]),
        system_id: head[102],
        quality: head[103],
        original_number: number(120),
        line_number: number(124),
        records,
    })
}

/// Reads until `buffer` is full or the file ends; bytes read.
fn fill(source: &mut impl Read, buffer: &mut [u8], path: &Path) -> Result<usize, TrajectoryFileError> {
    let mut found = 0;
    while found < buffer.len() {
        match source.read(&mut buffer[found..]) {
            Ok(0) => break,
            Ok(more) => found += more,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(TrajectoryFileError::io(path)(error)),
        }
    }
    Ok(found)
}

/// Text up to the first zero byte.
fn printable(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim_end().to_string()
}

/// Swaps the bytes of a record on a big-endian machine; its own inverse.
fn little_endian(record: TrjRecord) -> TrjRecord {
    let swap = |v: f64| f64::from_bits(u64::from_le(v.to_bits()));
    TrjRecord {
        time_s: swap(record.time_s),
        position_m: record.position_m.map(swap),
        heading_deg: swap(record.heading_deg),
        roll_deg: swap(record.roll_deg),
        pitch_deg: swap(record.pitch_deg),
        accuracy_code: record.accuracy_code,
        mark: i16::from_le(record.mark),
        flags: i16::from_le(record.flags),
    }
}

impl TrjFile {
    /// The trajectory in map coordinates, heading from grid north; `path` is for messages only.
    ///
    /// # Errors
    /// [`TrajectoryFileError`] when a value, or the order of time, makes no sense.
    pub fn into_trajectory(self, path: &Path) -> Result<TrajectoryFile, TrajectoryFileError> {
        let mut records = Records::new(path, PositionFrame::Map);
        for (number, record) in (0..).zip(&self.records) {
            let angle_deg = Vector3::new(record.roll_deg, record.pitch_deg, record.heading_deg);
            let epoch = Epoch {
                time_s: record.time_s,
                position: Vector3::from(record.position_m),
                roll_pitch_heading_rad: angle_deg.map(f64::to_radians),
                velocity_ned_mps: None,
                sigma: None,
            };
            records.push(Place::Record(number), &epoch)?;
        }
        let (trajectory, time_encoding, notes) = records.finish()?;
        Ok(TrajectoryFile {
            trajectory,
            format: TrajectoryFormat::Trj,
            heading: HeadingReference::GridNorth,
            time_encoding,
            week: None,
            notes,
        })
    }

    /// A file of a map trajectory whose attitude counts from true north (its convergence is taken off the heading);
    /// codes, mark and flags are zero.
    ///
    /// # Errors
    /// [`TrajectoryFileError::WrongFrame`] for geodetic positions.
    pub fn from_trajectory(path: &Path, trajectory: &Trajectory) -> Result<Self, TrajectoryFileError> {
        need_frame(path, trajectory, PositionFrame::Map)?;
        let records = (0..trajectory.len()).map(|index| {
            let (roll, pitch, heading) = roll_pitch_heading_rad(&trajectory.ned_from_body()[index]);
            let convergence_rad = trajectory.grid().get(index).map_or(0.0, |grid| grid.0);
            TrjRecord {
                time_s: trajectory.time_s()[index],
                position_m: trajectory.position()[index].into(),
                heading_deg: (heading - convergence_rad).to_degrees().rem_euclid(360.0),
                roll_deg: roll.to_degrees(),
                pitch_deg: pitch.to_degrees(),
                accuracy_code: [0; 4],
                mark: 0,
                flags: 0,
            }
        });
        Ok(Self {
            description: String::new(),
            system_id: 0,
            quality: 1,
            original_number: 1,
            line_number: 1,
            records: records.collect(),
        })
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// [`TrajectoryFileError::BadHeader`] for more records than the head can count; [`TrajectoryFileError::Io`].
    pub fn write(&self, path: &Path) -> Result<(), TrajectoryFileError> {
        let Ok(count) = i32::try_from(self.records.len()) else {
            let (what, found) = ("the number of records", self.records.len().to_string());
            return Err(TrajectoryFileError::BadHeader {
                path: path.to_path_buf(),
                what,
                found,
                expected: format!("at most {}", i32::MAX),
            });
        };
        let mut file = WholeFile::create(path).map_err(TrajectoryFileError::io(path))?;
        file.writer().write_all(&self.head(count)).map_err(TrajectoryFileError::io(path))?;
        for record in &self.records {
            let bytes = little_endian(*record);
            file.writer().write_all(bytemuck::bytes_of(&bytes)).map_err(TrajectoryFileError::io(path))?;
        }
        file.finish().map_err(TrajectoryFileError::io(path))
    }

    fn head(&self, count: i32) -> [u8; HEADER_BYTES] {
        let mut head = [0_u8; HEADER_BYTES];
        let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, MAGIC);
        for (at, value) in [(8, VERSION), (12, 1376), (16, count), (20, 64)] {
            put(at, &value.to_le_bytes());
        }
        let description = self.description.as_bytes();
        put(24, &description[..description.len().min(77)]);
        put(102, &[self.system_id, self.quality]);
        let (begin, end) = match (self.records.first(), self.records.last()) {
            (Some(first), Some(last)) => (first.time_s, last.time_s),
            _ => (0.0, 0.0),
        };
        put(104, &begin.to_le_bytes());
        put(112, &end.to_le_bytes());
        put(120, &self.original_number.to_le_bytes());
        put(124, &self.line_number.to_le_bytes());
        head
    }
}

/// Writes a map trajectory as `.trj`: heading from grid north, whole or not at all.
///
/// # Errors
/// As [`TrjFile::from_trajectory`] and [`TrjFile::write`].
pub fn write_trj(path: &Path, trajectory: &Trajectory) -> Result<(), TrajectoryFileError> {
    TrjFile::from_trajectory(path, trajectory)?.write(path)
}
