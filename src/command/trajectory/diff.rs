//! The difference of two trajectories: statistics, CSV, plot.

use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use nalgebra::Vector3;
use serde_json::json;
use tieline_filter::earth::{ecef_from_geodetic, ned_from_ecef};
use tieline_filter::frames::roll_pitch_heading_rad;
use tieline_filter::{Pose, PositionFrame, Trajectory};
use tieline_io::crs::Crs;
use tieline_io::output::write_whole;
use tieline_io::trajectory::TrajectoryFile;

use super::plot::plot;
use crate::cli::Common;
use crate::navigation::{
    clock_of, common_pieces_s, counts_from_grid_north, in_geodetic, in_map, median_interval_s, on_clock, pieces_s,
    read_trajectory,
};

/// What the arguments ask for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Options<'a> {
    pub(super) crs: Option<&'a str>,
    pub(super) columns: Option<&'a [String]>,
    /// Where `difference.csv` and `difference.svg` go.
    pub(super) folder: Option<&'a Path>,
}

/// Names of the six components, as in the CSV.
pub(super) const NAMES: [&str; 6] = ["dE_m", "dN_m", "dU_m", "droll_deg", "dpitch_deg", "dheading_deg"];

/// B - A at one moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    /// On the common clock \[s\].
    pub(super) time_s: f64,
    /// East, north, up \[m\]; roll, pitch, heading \[deg\].
    pub(super) values: [f64; 6],
}

/// Compares `b` with `a`.
pub(super) fn run(a: &Path, b: &Path, options: &Options<'_>, common: &Common, out: &mut impl Write) -> Result<()> {
    let files = [read_trajectory(a, options.columns, None)?, read_trajectory(b, options.columns, None)?];
    let [first, second] = on_common_ground([a, b], &files, options.crs)?;
    let rows = differences(&first, &second);
    if rows.is_empty() {
        let (s, t) = (first.span_s(), second.span_s());
        bail!(
            "{} ({:.3} s to {:.3} s) and {} ({:.3} s to {:.3} s) have no time in common; \
             give two trajectories of one flight",
            a.display(),
            s.0,
            s.1,
            b.display(),
            t.0,
            t.1
        );
    }
    if let Some(folder) = options.folder {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("the output folder {} cannot be created", folder.display()))?;
        write(&folder.join("difference.csv"), &csv(&rows))?;
        write(&folder.join("difference.svg"), &plot(&rows)?)?;
    }
    let statistics: Vec<Statistics> = (0..6).map(|k| Statistics::of(&rows, k)).collect();
    let (start_s, end_s) = (rows[0].time_s, rows[rows.len() - 1].time_s);
    if common.json {
        let components: serde_json::Map<_, _> =
            NAMES.iter().zip(&statistics).map(|(name, s)| ((*name).to_string(), s.json())).collect();
        let value =
            json!({ "a": a, "b": b, "epochs": rows.len(), "span_s": [start_s, end_s], "difference": components });
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        writeln!(out, "B - A at {} epochs from {start_s:.3} s to {end_s:.3} s", rows.len())?;
        writeln!(out, "{:<14}{:>12}{:>12}{:>12}{:>12}", "", "mean", "sd", "rms", "max")?;
        for (name, s) in NAMES.iter().zip(&statistics) {
            writeln!(out, "{name:<14}{:>12.5}{:>12.5}{:>12.5}{:>12.5}", s.mean, s.sd, s.rms, s.max)?;
        }
        if let Some(folder) = options.folder {
            writeln!(out, "{}\n{}", folder.join("difference.csv").display(), folder.join("difference.svg").display())?;
        }
    }
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<()> {
    write_whole(path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
}

/// Both on one clock and in one frame: geodetic where both are or a reference system is named, else map axes.
fn on_common_ground(paths: [&Path; 2], files: &[TrajectoryFile; 2], crs: Option<&str>) -> Result<[Trajectory; 2]> {
    const REMEDY: &str = "name the reference system of the map with --crs";
    let crs = crs.map(|text| Crs::parse(text).with_context(|| format!("--crs {text}"))).transpose()?;
    let clock = clock_of(&[&files[0], &files[1]]);
    let both_map = files.iter().all(|f| f.trajectory.frame() == PositionFrame::Map);
    ensure!(
        crs.is_some() || counts_from_grid_north(&files[0]) == counts_from_grid_north(&files[1]),
        "the headings of one trajectory count from grid north, those of the other from true north; {REMEDY}"
    );
    let turn = |k: usize| {
        let trajectory = match both_map {
            true => in_map(&files[k], paths[k], crs.as_ref(), REMEDY)?,
            false => in_geodetic(&files[k], paths[k], crs.as_ref(), REMEDY)?,
        };
        let remedy = "give both in adjusted time, or both in seconds of week";
        on_clock(trajectory, &files[k], paths[k], files[k].time_encoding, &clock, remedy)
    };
    Ok([turn(0)?, turn(1)?])
}

/// `b` - `a` at the epochs of the one with fewer of them, where both have no gap.
fn differences(a: &Trajectory, b: &Trajectory) -> Vec<Row> {
    let pieces = common_pieces_s(&pieces_s(a), &pieces_s(b));
    // the denser one is interpolated; the usual intervals of equal rates differ by rounding only
    let times = if median_interval_s(b) > 1.001 * median_interval_s(a) { b.time_s() } else { a.time_s() };
    let mut rows = Vec::new();
    for (start_s, end_s) in pieces {
        let (first, last) = (times.partition_point(|t| *t < start_s), times.partition_point(|t| *t <= end_s));
        for &time_s in times.get(first..last).unwrap_or_default() {
            if let (Some(p), Some(q)) = (a.pose_at(time_s), b.pose_at(time_s)) {
                rows.push(difference(a.frame(), &p, &q));
            }
        }
    }
    rows
}

fn difference(frame: PositionFrame, a: &Pose, b: &Pose) -> Row {
    let ned_m = match frame {
        PositionFrame::Map => a.ned_vector_m(&b.position),
        PositionFrame::Geodetic => {
            let apart_m: Vector3<f64> = ecef_from_geodetic(&b.position) - ecef_from_geodetic(&a.position);
            ned_from_ecef(a.position.x, a.position.y) * apart_m
        }
    };
    let (roll, pitch, heading) = roll_pitch_heading_rad(&a.ned_from_body);
    let (roll_b, pitch_b, heading_b) = roll_pitch_heading_rad(&b.ned_from_body);
    let wrapped_deg = |d: f64| (d.to_degrees() + 180.0).rem_euclid(360.0) - 180.0;
    Row {
        time_s: a.time_s,
        values: [
            ned_m.y,
            ned_m.x,
            -ned_m.z,
            wrapped_deg(roll_b - roll),
            wrapped_deg(pitch_b - pitch),
            wrapped_deg(heading_b - heading),
        ],
    }
}

/// The rows with the distance in space; along true east and north, hence not a `correction.csv`.
fn csv(rows: &[Row]) -> String {
    let mut text = format!("gps_time_s,{},distance_m\n", NAMES.join(","));
    for row in rows {
        let _ = write!(text, "{}", row.time_s);
        for (k, value) in row.values.iter().enumerate() {
            let decimals = if k < 3 { 5 } else { 6 };
            let _ = write!(text, ",{value:.decimals$}");
        }
        let distance_m = row.values[..3].iter().map(|v| v * v).sum::<f64>().sqrt();
        let _ = writeln!(text, ",{distance_m:.5}");
    }
    text
}

/// Of one component, in its unit.
#[derive(Debug, Clone, Copy)]
struct Statistics {
    mean: f64,
    /// Standard deviation about the mean.
    sd: f64,
    rms: f64,
    /// The value of the greatest size, with its sign.
    max: f64,
}

impl Statistics {
    #[allow(clippy::cast_precision_loss)]
    fn of(rows: &[Row], component: usize) -> Self {
        let values = || rows.iter().map(|r| r.values[component]);
        let n = rows.len() as f64;
        let mean = values().sum::<f64>() / n;
        let sd = (values().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt();
        let rms = (values().map(|v| v * v).sum::<f64>() / n).sqrt();
        let max = values().fold(0.0_f64, |a, v| if v.abs() > a.abs() { v } else { a });
        Self { mean, sd, rms, max }
    }

    fn json(&self) -> serde_json::Value {
        json!({ "mean": self.mean, "sd": self.sd, "rms": self.rms, "max": self.max })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use tieline_filter::ned_from_body;

    use super::*;

    #[test]
    fn a_step_to_the_north_of_a_millionth_radian_is_six_metres_and_headings_wrap() {
        let pose = |latitude: f64, heading: f64| Pose {
            time_s: 1.0,
            position: Vector3::new(latitude, 0.2, 100.0),
            ned_from_body: ned_from_body(0.0, 0.0, heading),
            map_from_ned: tieline_filter::map_from_ned(0.0, 1.0),
        };
        let half_turn = std::f64::consts::PI;
        let row =
            difference(PositionFrame::Geodetic, &pose(0.8, half_turn - 1e-4), &pose(0.8 + 1e-6, half_turn + 1e-4));
        assert!((row.values[1] - 6.37).abs() < 0.02, "{row:?}");
        assert!((row.values[5] - 2e-4_f64.to_degrees()).abs() < 1e-9, "{row:?}");
    }

    #[test]
    fn only_times_that_both_cover_are_compared_at_the_slower_rate() {
        let of = |start: f64, step: f64, n: u32, east: f64| {
            let times: Vec<f64> = (0..n).map(|k| start + step * f64::from(k)).collect();
            let positions = times.iter().map(|t| Vector3::new(east, 50.0 * t, 300.0)).collect();
            let attitudes = vec![UnitQuaternion::identity(); times.len()];
            Trajectory::new(PositionFrame::Map, times, positions, attitudes, Vec::new()).expect("good epochs")
        };
        let rows = differences(&of(0.0, 0.01, 1001, 5.0), &of(5.0, 0.1, 101, 5.25));
        assert_eq!(rows.len(), 51);
        assert!(rows.iter().all(|r| (r.values[0] - 0.25).abs() < 1e-9 && r.values[1].abs() < 1e-9));
    }
}
