//! Poses with their sigma at event times, as CSV or JSON.

use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::json;
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{Pose, PoseSigma, PositionFrame, Trajectory};
use tieline_io::output::write_whole;
use tieline_io::trajectory::TrajectoryFile;

use crate::cli::Common;
use crate::navigation::{counts_from_grid_north, pieces_s, read_trajectory};

/// What the arguments ask for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Options<'a> {
    pub(super) columns: Option<&'a [String]>,
    pub(super) accuracy: Option<&'a Path>,
    /// Where the CSV goes; standard output when left out.
    pub(super) file: Option<&'a Path>,
}

/// Writes the poses of `trajectory` at the times of a file.
pub(super) fn run(
    trajectory: &Path,
    times: &Path,
    options: &Options<'_>,
    common: &Common,
    out: &mut impl Write,
) -> Result<()> {
    let events_s = read_times(times)?;
    let file = read_trajectory(trajectory, options.columns, options.accuracy)?;
    let poses = poses_at(&file.trajectory, &events_s);
    let outside = poses.iter().filter(|p| p.is_none()).count();
    let (first_s, last_s) = file.trajectory.span_s();
    if outside == events_s.len() {
        bail!(
            "none of the {outside} times of {} lies in {} ({first_s:.3} s to {last_s:.3} s); \
             give them in the trajectory's own time system",
            times.display(),
            trajectory.display()
        );
    }
    if outside > 0 {
        tracing::warn!(
            "{outside} of {} times lie outside of {} ({first_s:.3} s to {last_s:.3} s) or in its gaps: their poses are left empty",
            events_s.len(),
            trajectory.display()
        );
    }
    let table = Table { file: &file, events_s: &events_s, poses: &poses };
    let text = if common.json { format!("{:#}\n", table.json()) } else { table.csv() };
    match options.file {
        Some(path) => write_whole(path, text.as_bytes()).with_context(|| format!("writing {}", path.display())),
        None => Ok(out.write_all(text.as_bytes())?),
    }
}

/// First column of a text; a first line without a number is a header, `#` starts a remark.
fn read_times(path: &Path) -> Result<Vec<f64>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}", path.display()))?;
    let mut times_s = Vec::new();
    let lines = text.lines().enumerate().map(|(k, line)| (k + 1, line.trim()));
    for (number, line) in lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#')) {
        let field = line.split([',', ';', '\t', ' ']).next().unwrap_or_default().trim_matches('"');
        match field.parse::<f64>() {
            Ok(time_s) if time_s.is_finite() => times_s.push(time_s),
            _ if times_s.is_empty() && number == 1 => {} // a header
            _ => bail!(
                "{}, line {number}: a time in seconds was due in the first column, found \"{field}\"",
                path.display()
            ),
        }
    }
    if times_s.is_empty() {
        bail!("{}: there is no time in the file; one a line is due, in the first column", path.display());
    }
    Ok(times_s)
}

/// A pose with its sigma.
type Found = Option<(Pose, Option<PoseSigma>)>;

/// Poses at times \[s\]; none outside of the trajectory and in its gaps.
fn poses_at(trajectory: &Trajectory, times_s: &[f64]) -> Vec<Found> {
    let pieces = pieces_s(trajectory);
    let covered = |t: f64| {
        let after = pieces.partition_point(|p| p.0 - 1e-3 <= t);
        after > 0 && t <= pieces[after - 1].1 + 1e-3
    };
    let find = |t: &f64| covered(*t).then(|| trajectory.pose_at(*t)).flatten().map(|p| (p, trajectory.sigma_at(*t)));
    times_s.iter().map(find).collect()
}

struct Table<'a> {
    file: &'a TrajectoryFile,
    events_s: &'a [f64],
    poses: &'a [Found],
}

impl Table<'_> {
    fn names(&self) -> Vec<&'static str> {
        let mut names = vec!["gps_time_s"];
        names.extend(match self.file.trajectory.frame() {
            PositionFrame::Geodetic => ["lat_deg", "lon_deg", "h_m"],
            PositionFrame::Map => ["east_m", "north_m", "height_m"],
        });
        let heading = if counts_from_grid_north(self.file) { "grid_heading_deg" } else { "heading_deg" };
        names.extend(["roll_deg", "pitch_deg", heading]);
        if !self.file.trajectory.sigma().is_empty() {
            names.extend(["sigma_n_m", "sigma_e_m", "sigma_d_m"]);
            names.extend(["sigma_roll_deg", "sigma_pitch_deg", "sigma_heading_deg"]);
        }
        names
    }

    /// The columns after the time, with their decimals.
    fn values(&self, pose: &Pose, sigma: Option<&PoseSigma>) -> Vec<(f64, usize)> {
        let p = pose.position;
        let mut values = match self.file.trajectory.frame() {
            PositionFrame::Geodetic => vec![(p.x.to_degrees(), 10), (p.y.to_degrees(), 10), (p.z, 4)],
            PositionFrame::Map => vec![(p.x, 4), (p.y, 4), (p.z, 4)],
        };
        let (roll, pitch, heading) = roll_pitch_heading_rad(&pose.ned_from_body);
        values.extend([roll.to_degrees(), pitch.to_degrees(), heading.to_degrees().rem_euclid(360.0)].map(|v| (v, 6)));
        if let Some(sigma) = sigma {
            values.extend(sigma.position_ned_m.iter().map(|v| (*v, 4)));
            values.extend(sigma.attitude_rph_rad.iter().map(|v| (v.to_degrees(), 6)));
        }
        values
    }

    fn csv(&self) -> String {
        let names = self.names();
        let mut text = names.join(",");
        text.push('\n');
        for (time_s, found) in self.events_s.iter().zip(self.poses) {
            let _ = write!(text, "{time_s}");
            match found {
                Some((pose, sigma)) => {
                    for (value, decimals) in self.values(pose, sigma.as_ref()) {
                        let _ = write!(text, ",{value:.decimals$}");
                    }
                }
                None => text.extend(std::iter::repeat_n(',', names.len() - 1)),
            }
            text.push('\n');
        }
        text
    }

    fn json(&self) -> serde_json::Value {
        let names = self.names();
        let row = |(time_s, found): (&f64, &Found)| {
            let mut object = serde_json::Map::new();
            object.insert(names[0].to_string(), json!(time_s));
            let values = found.as_ref().map(|(pose, sigma)| self.values(pose, sigma.as_ref()));
            for (k, name) in names.iter().enumerate().skip(1) {
                let value = values.as_ref().and_then(|v| v.get(k - 1)).map(|v| v.0);
                object.insert((*name).to_string(), json!(value));
            }
            serde_json::Value::Object(object)
        };
        self.events_s.iter().zip(self.poses).map(row).collect()
    }
}
