//! Writes tieline's own `trajectory.csv`; [`super::text`] reads it back.
//!
//! Columns: `gps_week,gps_time_s,lat_deg,lon_deg,h_m,vn_mps,ve_mps,vd_mps,roll_deg,pitch_deg,heading_deg`, then,
//! where the trajectory has them, `sigma_n_m,sigma_e_m,sigma_d_m,sigma_vn_mps,sigma_ve_mps,sigma_vd_mps,`
//! `sigma_roll_deg,sigma_pitch_deg,sigma_heading_deg`. Heading counts from true north. Every number is printed with
//! the digits that lead back to the same f64.

use std::io::{self, Write};
use std::ops::Range;
use std::path::Path;

use nalgebra::Vector3;
use tieline_filter::earth::{meridian_radius_m, prime_vertical_radius_m};
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{PositionFrame, SurveyClock, Trajectory};

use super::error::TrajectoryFileError;
use super::writer::PieceFormat;

/// Writes a geodetic trajectory on the survey clock as `trajectory.csv`, whole or not at all. While the clock does
/// not know its week, `gps_week` is 0 and times past the week's end stay as they are.
///
/// # Errors
/// [`TrajectoryFileError::WrongFrame`] for map positions; [`TrajectoryFileError::Io`] when the disk refuses.
pub fn write_csv(path: &Path, trajectory: &Trajectory, clock: &SurveyClock) -> Result<(), TrajectoryFileError> {
    super::writer::write_all(path, trajectory, PieceFormat::Csv(*clock))
}

pub(super) fn header(out: &mut impl Write, with_sigma: bool) -> io::Result<()> {
    write!(out, "gps_week,gps_time_s,lat_deg,lon_deg,h_m,vn_mps,ve_mps,vd_mps,roll_deg,pitch_deg,heading_deg")?;
    if with_sigma {
        write!(out, ",sigma_n_m,sigma_e_m,sigma_d_m,sigma_vn_mps,sigma_ve_mps,sigma_vd_mps")?;
        write!(out, ",sigma_roll_deg,sigma_pitch_deg,sigma_heading_deg")?;
    }
    writeln!(out)
}

pub(super) fn rows(
    out: &mut impl Write,
    trajectory: &Trajectory,
    epochs: Range<usize>,
    with_sigma: bool,
    clock: &SurveyClock,
) -> io::Result<()> {
    for index in epochs {
        let time_s = trajectory.time_s()[index];
        match clock.gps_time(time_s) {
            Some(time) => write!(out, "{},{}", time.week, time.seconds_of_week)?,
            None => write!(out, "0,{time_s}")?,
        }
        let position = trajectory.position()[index];
        write!(out, ",{},{},{}", position.x.to_degrees(), position.y.to_degrees(), position.z)?;
        let velocity = velocity_ned_mps(trajectory, index);
        write!(out, ",{},{},{}", velocity.x, velocity.y, velocity.z)?;
        let (roll, pitch, heading) = roll_pitch_heading_rad(&trajectory.ned_from_body()[index]);
        write!(out, ",{},{},{}", roll.to_degrees(), pitch.to_degrees(), heading.to_degrees())?;
        if let Some(sigma) = trajectory.sigma().get(index).filter(|_| with_sigma) {
            for value in sigma.position_ned_m.iter().chain(&sigma.velocity_ned_mps) {
                write!(out, ",{value}")?;
            }
            for value in &sigma.attitude_rph_rad {
                write!(out, ",{}", value.to_degrees())?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// Velocity north, east, down \[m/s\] of an epoch; the difference of its neighbours where the trajectory has none.
pub(super) fn velocity_ned_mps(trajectory: &Trajectory, index: usize) -> Vector3<f64> {
    if let Some(velocity) = trajectory.velocity_ned_mps().get(index) {
        return *velocity;
    }
    let (before, after) = (index.saturating_sub(1), (index + 1).min(trajectory.len() - 1));
    let interval_s = trajectory.time_s()[after] - trajectory.time_s()[before];
    let change = (trajectory.position()[after] - trajectory.position()[before]) / interval_s;
    let pose = trajectory.epoch(index);
    match trajectory.frame() {
        PositionFrame::Geodetic => {
            let (latitude_rad, height_m) = (pose.position.x, pose.position.z);
            let north = (meridian_radius_m(latitude_rad) + height_m) * change.x;
            let east = (prime_vertical_radius_m(latitude_rad) + height_m) * latitude_rad.cos() * change.y;
            Vector3::new(north, east, -change.z)
        }
        PositionFrame::Map => pose.ned_vector_m(&(pose.position + change)),
    }
}
