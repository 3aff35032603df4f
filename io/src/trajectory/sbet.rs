//! SBET: 17 little-endian f64 per epoch, angles in radians.
//!
//! | number | meaning |
//! |---|---|
//! | 0 | time \[s\], seconds of week (runs on past the week's end) |
//! | 1, 2, 3 | latitude, longitude \[rad\], ellipsoidal height \[m\] |
//! | 4, 5, 6 | velocity \[m/s\] along x, y, up of the wander frame: x is north and y **west** when the wander angle is 0 |
//! | 7, 8 | roll, pitch \[rad\] |
//! | 9, 10 | platform heading, wander angle \[rad\]: **true heading = platform heading - wander angle** |
//! | 11, 12, 13 | acceleration along the body axes, without gravity \[m/s²\] |
//! | 14, 15, 16 | angular rate about the body axes \[rad/s\] |
//!
//! The file has no head, no CRS and no week. Checked on a real one: with wander angle α,
//! `vx = vN cos α - vE sin α`, `vy = -vN sin α - vE cos α`, `vz = vU` to 1 cm/s.

use std::f64::consts::{PI, TAU};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use nalgebra::{UnitQuaternion, Vector3};
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{PositionFrame, Trajectory};

use super::error::{Place, TrajectoryFileError};
use super::file::{HeadingReference, TrajectoryFile, TrajectoryFormat};
use super::records::{Epoch, Records};
use super::writer::PieceFormat;

/// Bytes of a record.
pub const RECORD_BYTES: usize = 17 * 8;

/// Reads an SBET.
///
/// # Errors
/// [`TrajectoryFileError`] names file, record, value and remedy.
pub fn read_sbet(path: &Path) -> Result<TrajectoryFile, TrajectoryFileError> {
    let file = File::open(path).map_err(TrajectoryFileError::io(path))?;
    read_from(BufReader::with_capacity(1 << 20, file), path)
}

/// Reads an SBET from any source of bytes; `path` is for messages only.
///
/// # Errors
/// As [`read_sbet`].
pub fn read_from(mut source: impl Read, path: &Path) -> Result<TrajectoryFile, TrajectoryFileError> {
    let mut records = Records::new(path, PositionFrame::Geodetic);
    let mut number = 0;
    while let Some(values) = next_record::<17>(&mut source, path, number)? {
        check_first(&values, path, number)?;
        records.push(Place::Record(number), &epoch(&values))?;
        number += 1;
    }
    if number == 0 {
        return Err(TrajectoryFileError::Empty { path: path.to_path_buf() });
    }
    let (trajectory, time_encoding, notes) = records.finish()?;
    Ok(TrajectoryFile {
        trajectory,
        format: TrajectoryFormat::Sbet,
        heading: HeadingReference::TrueNorth,
        time_encoding,
        week: None,
        notes,
    })
}

/// The next `N` little-endian numbers; `None` at the end of the file.
pub(super) fn next_record<const N: usize>(
    source: &mut impl Read,
    path: &Path,
    record: u64,
) -> Result<Option<[f64; N]>, TrajectoryFileError> {
    let mut values = [0.0_f64; N];
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut values);
    let mut found = 0;
    while found < bytes.len() {
        match source.read(&mut bytes[found..]) {
            Ok(0) => break,
            Ok(more) => found += more,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(TrajectoryFileError::io(path)(error)),
        }
    }
    match found {
        0 => Ok(None),
        _ if found < N * 8 => {
            Err(TrajectoryFileError::TruncatedRecord { path: path.to_path_buf(), record, found, expected: N * 8 })
        }
        _ => Ok(Some(values.map(|v| f64::from_bits(u64::from_le(v.to_bits()))))),
    }
}

/// Tells swapped bytes and degrees from a good record, before the general checks.
fn check_first(values: &[f64; 17], path: &Path, record: u64) -> Result<(), TrajectoryFileError> {
    let good = |v: &[f64; 17]| {
        v[..11].iter().all(|x| x.is_finite())
            && v[1].abs() <= PI / 2.0
            && v[2].abs() <= TAU
            && v[3].abs() < 1e6
            && (v[0] == 0.0 || v[0].abs() > 1e-6)
            && v[0].abs() < 1e10
    };
    if record == 0 && !good(values) && good(&values.map(|v| f64::from_bits(v.to_bits().swap_bytes()))) {
        return Err(TrajectoryFileError::ByteOrder { path: path.to_path_buf() });
    }
    let latitude = values[1];
    if latitude.abs() > PI / 2.0 {
        return Err(TrajectoryFileError::NotRadians { path: path.to_path_buf(), record, latitude });
    }
    Ok(())
}

/// An epoch of a record: out of the wander frame, longitude within ±π.
fn epoch(values: &[f64; 17]) -> Epoch {
    let (sin, cos) = values[10].sin_cos();
    let (vx, vy, vz) = (values[4], values[5], values[6]);
    let longitude_rad = match values[2] {
        east if east > PI && east <= TAU => east - TAU,
        longitude => longitude,
    };
    Epoch {
        time_s: values[0],
        position: Vector3::new(values[1], longitude_rad, values[3]),
        roll_pitch_heading_rad: Vector3::new(values[7], values[8], values[9] - values[10]),
        velocity_ned_mps: Some(Vector3::new(vx * cos - vy * sin, -vx * sin - vy * cos, -vz)),
        sigma: None,
    }
}

/// Writes a geodetic trajectory as SBET, whole or not at all: wander angle 0, hence velocity north-west-up and
/// platform heading = true heading. Velocities that are missing, accelerations and rates are differences of the
/// neighbouring epochs. Times are written as they are: shift the trajectory to the encoding wanted before.
///
/// # Errors
/// [`TrajectoryFileError::WrongFrame`] for map positions; [`TrajectoryFileError::Io`] when the disk refuses.
pub fn write_sbet(path: &Path, trajectory: &Trajectory) -> Result<(), TrajectoryFileError> {
    super::writer::write_all(path, trajectory, PieceFormat::Sbet)
}

/// Refuses a trajectory in another frame than the format holds.
pub(super) fn need_frame(
    path: &Path,
    trajectory: &Trajectory,
    needed: PositionFrame,
) -> Result<(), TrajectoryFileError> {
    match trajectory.frame() == needed {
        true => Ok(()),
        false => Err(TrajectoryFileError::WrongFrame { path: path.to_path_buf(), needed, found: trajectory.frame() }),
    }
}

/// The 17 numbers of an epoch.
pub(super) fn record(trajectory: &Trajectory, index: usize) -> [f64; 17] {
    let ned_from_body = trajectory.ned_from_body()[index];
    let (roll, pitch, heading) = roll_pitch_heading_rad(&ned_from_body);
    let (before, after) = (index.saturating_sub(1), (index + 1).min(trajectory.len() - 1));
    let interval_s = trajectory.time_s()[after] - trajectory.time_s()[before];
    let velocity = super::csv::velocity_ned_mps(trajectory, index);
    let change = super::csv::velocity_ned_mps(trajectory, after) - super::csv::velocity_ned_mps(trajectory, before);
    let acceleration = ned_from_body.inverse_transform_vector(&(change / interval_s));
    let rate = body_rate_rad_s(&trajectory.ned_from_body()[before], &trajectory.ned_from_body()[after], interval_s);
    let position = trajectory.position()[index];
    [
        trajectory.time_s()[index],
        position.x,
        position.y,
        position.z,
        velocity.x,
        -velocity.y,
        -velocity.z,
        roll,
        pitch,
        heading,
        0.0,
        acceleration.x,
        acceleration.y,
        acceleration.z,
        rate.x,
        rate.y,
        rate.z,
    ]
}

/// Mean angular rate of the body relative to the navigation frame, in body axes \[rad/s\].
fn body_rate_rad_s(before: &UnitQuaternion<f64>, after: &UnitQuaternion<f64>, interval_s: f64) -> Vector3<f64> {
    (before.inverse() * after).scaled_axis() / interval_s
}
