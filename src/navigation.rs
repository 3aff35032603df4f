//! Trajectories of files brought onto one clock and into one frame, and what is to be known about their epochs.

use std::path::Path;

use anyhow::{Context, Result, bail};
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{PositionFrame, SurveyClock, TimeEncoding, Trajectory};
use tieline_io::crs::Crs;
use tieline_io::trajectory::{HeadingReference, ReadOptions, TrajectoryFile, read};

/// Reads a trajectory of any format; `columns` are those of a text file, `accuracy` its SMRMSG file.
///
/// # Errors
/// As the readers: file, place, value and remedy.
pub fn read_trajectory(path: &Path, columns: Option<&[String]>, accuracy: Option<&Path>) -> Result<TrajectoryFile> {
    let options = ReadOptions {
        format: None,
        columns: columns.map(<[String]>::to_vec),
        accuracy: accuracy.map(Path::to_path_buf),
    };
    Ok(read(path, &options)?)
}

/// A trajectory in map coordinates; `remedy` says where a reference system is named.
///
/// # Errors
/// When a geodetic trajectory meets no reference system, or one that cannot hold it.
pub fn in_map(file: &TrajectoryFile, path: &Path, crs: Option<&Crs>, remedy: &str) -> Result<Trajectory> {
    match crs {
        Some(crs) => file.to_map(crs).with_context(|| format!("{}", path.display())),
        None if file.trajectory.frame() == PositionFrame::Map => Ok(file.trajectory.clone()),
        None => bail!(
            "{}: positions are latitude and longitude, and no reference system of the map is known; {remedy}",
            path.display()
        ),
    }
}

/// A trajectory with headings from true north and geodetic positions; `remedy` says where a reference system is named.
///
/// # Errors
/// When a map trajectory meets no reference system, or one that cannot hold it.
pub fn in_geodetic(file: &TrajectoryFile, path: &Path, crs: Option<&Crs>, remedy: &str) -> Result<Trajectory> {
    match crs {
        _ if file.trajectory.frame() == PositionFrame::Geodetic => Ok(file.trajectory.clone()),
        Some(crs) => {
            let map = file.to_map(crs).with_context(|| format!("{}", path.display()))?;
            crs.to_geodetic(&map).with_context(|| format!("{}", path.display()))
        }
        None => bail!("{}: positions are map coordinates of an unnamed reference system; {remedy}", path.display()),
    }
}

/// A trajectory of a file with its times on a clock: `encoding` says how they are to be read.
///
/// # Errors
/// When the file holds adjusted time and the clock does not know its week; `remedy` says where it is named.
pub fn on_clock(
    trajectory: Trajectory,
    file: &TrajectoryFile,
    path: &Path,
    encoding: TimeEncoding,
    clock: &SurveyClock,
    remedy: &str,
) -> Result<Trajectory> {
    let mut shift_s = clock.shift_s(encoding).with_context(|| {
        format!("{}: adjusted GPS time, while the week of the other times is unknown; {remedy}", path.display())
    })?;
    if let (TimeEncoding::SecondsOfWeek, Some(week), Some(reference)) = (encoding, file.week, clock.reference_week) {
        shift_s += (f64::from(week) - f64::from(reference)) * SECONDS_PER_WEEK;
    }
    Ok(trajectory.shifted_in_time(shift_s))
}

/// The clock that trajectories are compared on: the week that one of them names, or that of the earliest adjusted time.
#[must_use]
pub fn clock_of(files: &[&TrajectoryFile]) -> SurveyClock {
    let adjusted = files
        .iter()
        .filter(|f| f.time_encoding == TimeEncoding::AdjustedStandard)
        .map(|f| f.trajectory.span_s().0)
        .min_by(f64::total_cmp);
    match (files.iter().find_map(|f| f.week), adjusted) {
        (Some(week), _) => SurveyClock { reference_week: Some(week) },
        (None, Some(time_s)) => SurveyClock::from_adjusted_s(time_s),
        (None, None) => SurveyClock { reference_week: None },
    }
}

/// Whether the headings of a map trajectory count from grid north, so that a reference system is needed to compare them.
#[must_use]
pub fn counts_from_grid_north(file: &TrajectoryFile) -> bool {
    file.heading == HeadingReference::GridNorth
}

/// Middle interval between epochs \[s\].
#[must_use]
pub fn median_interval_s(trajectory: &Trajectory) -> f64 {
    let mut intervals: Vec<f64> = trajectory.time_s().windows(2).map(|t| t[1] - t[0]).collect();
    let middle = intervals.len() / 2;
    *intervals.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Intervals \[s\] between epochs over which no pose may be interpolated: longer than half a second and than five
/// usual intervals.
#[must_use]
pub fn gaps_s(trajectory: &Trajectory) -> Vec<(f64, f64)> {
    let longest_s = (5.0 * median_interval_s(trajectory)).max(0.5);
    trajectory.time_s().windows(2).filter(|t| t[1] - t[0] > longest_s).map(|t| (t[0], t[1])).collect()
}

/// Intervals \[s\] without gaps, in order.
#[must_use]
pub fn pieces_s(trajectory: &Trajectory) -> Vec<(f64, f64)> {
    let (mut start_s, end_s) = trajectory.span_s();
    let mut pieces = Vec::new();
    for (from_s, to_s) in gaps_s(trajectory) {
        pieces.push((start_s, from_s));
        start_s = to_s;
    }
    pieces.push((start_s, end_s));
    pieces
}

/// Intervals \[s\] that lie in one of `a` and one of `b`, both in order.
#[must_use]
pub fn common_pieces_s(a: &[(f64, f64)], b: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let (mut i, mut j, mut common) = (0, 0, Vec::new());
    while let (Some(x), Some(y)) = (a.get(i), b.get(j)) {
        let (start_s, end_s) = (x.0.max(y.0), x.1.min(y.1));
        if start_s <= end_s {
            common.push((start_s, end_s));
        }
        if x.1 <= y.1 {
            i += 1;
        } else {
            j += 1;
        }
    }
    common
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    #[test]
    fn a_trajectory_falls_into_pieces_at_its_gaps() {
        let times: Vec<f64> = [0.0, 0.1, 0.2, 0.3, 5.0, 5.1, 5.2].to_vec();
        let n = times.len();
        let trajectory = Trajectory::new(
            PositionFrame::Map,
            times,
            vec![Vector3::zeros(); n],
            vec![UnitQuaternion::identity(); n],
            Vec::new(),
        )
        .expect("good epochs");
        assert_eq!(pieces_s(&trajectory), vec![(0.0, 0.3), (5.0, 5.2)]);
        assert_eq!(common_pieces_s(&pieces_s(&trajectory), &[(0.2, 5.05)]), vec![(0.2, 0.3), (5.0, 5.05)]);
    }
}
