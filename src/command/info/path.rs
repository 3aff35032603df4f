//! What a trajectory file and its accuracies hold.

use std::path::Path;

use anyhow::Result;
use nalgebra::Vector3;
use serde_json::{Value, json};
use tieline_filter::{PoseSigma, PositionFrame, SurveyClock, TimeEncoding};
use tieline_io::trajectory::smrmsg::read_smrmsg;
use tieline_io::trajectory::{HeadingReference, TrajectoryFile, TrajectoryFormat};

use super::{Description, count};
use crate::navigation::{clock_of, gaps_s, median_interval_s, read_trajectory};

pub(super) fn describe(path: &Path) -> Result<Description> {
    let file = read_trajectory(path, None, None)?;
    let trajectory = &file.trajectory;
    let (first_s, last_s) = trajectory.span_s();
    let interval_s = median_interval_s(trajectory);
    let gaps = gaps_s(trajectory);
    let (low, high) = range(trajectory.position());
    let format = match file.format {
        TrajectoryFormat::Sbet => "SBET",
        TrajectoryFormat::Trj => "TerraScan TRJ",
        TrajectoryFormat::Text => "text",
    };
    let heading = match file.heading {
        HeadingReference::TrueNorth => "true north",
        HeadingReference::GridNorth => "grid north",
    };
    let encoding = match file.time_encoding {
        TimeEncoding::AdjustedStandard => "adjusted GPS time",
        TimeEncoding::SecondsOfWeek => "seconds of a GPS week",
    };
    let utc = utc_span(&file);
    let mut lines = vec![
        ("format", format!("{format}, headings from {heading}")),
        ("epochs", format!("{} at {:.6} Hz", count(trajectory.len() as u64), 1.0 / interval_s)),
        ("time", format!("{encoding}, {first_s:.6} s to {last_s:.6} s ({:.1} s)", last_s - first_s)),
    ];
    if let Some(week) = file.week {
        lines.push(("GPS week", week.to_string()));
    }
    if let Some((first, last)) = &utc {
        lines.push(("date", format!("{first} to {last}")));
    }
    match trajectory.frame() {
        PositionFrame::Geodetic => {
            let degrees = |k: usize| format!("{:.7} to {:.7}", low[k].to_degrees(), high[k].to_degrees());
            lines.push(("latitude [deg]", degrees(0)));
            lines.push(("longitude [deg]", degrees(1)));
        }
        PositionFrame::Map => {
            lines.push(("east [m]", format!("{:.3} to {:.3}", low.x, high.x)));
            lines.push(("north [m]", format!("{:.3} to {:.3}", low.y, high.y)));
        }
    }
    lines.push(("height [m]", format!("{:.3} to {:.3}", low.z, high.z)));
    lines.push((
        "gaps",
        match gaps.iter().map(|(a, b)| b - a).max_by(f64::total_cmp) {
            Some(longest_s) => format!("{}, the longest of {longest_s:.3} s", gaps.len()),
            None => String::from("none"),
        },
    ));
    lines.push(("velocity", if trajectory.velocity_ned_mps().is_empty() { "no" } else { "yes" }.to_string()));
    let sigma = middle_sigma(trajectory.sigma());
    lines.push(("sigma, middle", sigma.as_ref().map_or_else(|| String::from("none in the file"), sigma_text)));
    lines.extend(file.notes.iter().map(|note| ("note", note.clone())));
    let position = match trajectory.frame() {
        PositionFrame::Geodetic => json!({
            "frame": "geodetic",
            "min": [low.x.to_degrees(), low.y.to_degrees(), low.z], "max": [high.x.to_degrees(), high.y.to_degrees(), high.z],
        }),
        PositionFrame::Map => json!({ "frame": "map", "min": low.as_slice(), "max": high.as_slice() }),
    };
    let json = json!({
        "format": format, "heading_from": heading, "epochs": trajectory.len(), "rate_hz": 1.0 / interval_s,
        "time": { "encoding": encoding, "span_s": [first_s, last_s], "week": file.week, "utc": utc },
        "position": position, "gaps_s": gaps, "velocity": !trajectory.velocity_ned_mps().is_empty(),
        "sigma": sigma.map(|s| sigma_json(&s)), "notes": file.notes,
    });
    Ok(Description { lines, json })
}

pub(super) fn describe_accuracy(path: &Path) -> Result<Description> {
    let accuracy = read_smrmsg(path)?;
    let times = accuracy.time_s();
    let (first_s, last_s) = (times[0], times[times.len() - 1]);
    let sigma = middle_sigma(accuracy.sigma());
    let mut lines = vec![
        ("epochs", count(times.len() as u64)),
        ("time", format!("{first_s:.6} s to {last_s:.6} s ({:.1} s)", last_s - first_s)),
        ("sigma, middle", sigma.as_ref().map_or_else(String::new, sigma_text)),
    ];
    lines.extend(accuracy.notes().iter().map(|note| ("note", note.clone())));
    let json = json!({
        "epochs": times.len(), "span_s": [first_s, last_s], "sigma": sigma.map(|s| sigma_json(&s)),
        "notes": accuracy.notes(),
    });
    Ok(Description { lines, json })
}

fn range(positions: &[Vector3<f64>]) -> (Vector3<f64>, Vector3<f64>) {
    let first = positions.first().copied().unwrap_or_default();
    positions.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)))
}

/// First and last moment in UTC, when the week is known.
fn utc_span(file: &TrajectoryFile) -> Option<(String, String)> {
    let clock: SurveyClock = clock_of(&[file]);
    let shift_s = clock.shift_s(file.time_encoding)?;
    let (first_s, last_s) = file.trajectory.span_s();
    let text = |time_s: f64| clock.gps_time(time_s + shift_s).map(|t| t.utc_text());
    text(first_s).zip(text(last_s))
}

/// The median of each component.
fn middle_sigma(sigma: &[PoseSigma]) -> Option<PoseSigma> {
    if sigma.is_empty() {
        return None;
    }
    let middle = |of: &dyn Fn(&PoseSigma) -> f64| {
        let mut values: Vec<f64> = sigma.iter().map(of).collect();
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f64::total_cmp).1
    };
    let vector = |of: &dyn Fn(&PoseSigma) -> Vector3<f64>| Vector3::from_fn(|k, _| middle(&|s| of(s)[k]));
    Some(PoseSigma {
        position_ned_m: vector(&|s| s.position_ned_m),
        velocity_ned_mps: vector(&|s| s.velocity_ned_mps),
        attitude_rph_rad: vector(&|s| s.attitude_rph_rad),
    })
}

fn sigma_text(sigma: &PoseSigma) -> String {
    let (p, a) = (sigma.position_ned_m, sigma.attitude_rph_rad.map(f64::to_degrees));
    format!(
        "north {:.3} m, east {:.3} m, down {:.3} m, roll {:.4}°, pitch {:.4}°, heading {:.4}°",
        p.x, p.y, p.z, a.x, a.y, a.z
    )
}

fn sigma_json(sigma: &PoseSigma) -> Value {
    json!({
        "position_ned_m": sigma.position_ned_m.as_slice(), "velocity_ned_mps": sigma.velocity_ned_mps.as_slice(),
        "attitude_rph_deg": sigma.attitude_rph_rad.map(f64::to_degrees).as_slice(),
    })
}
