//! Line 2: a straight street without façades, driven there and back, without GNSS and odometer on the way back.

use std::path::Path;

use anyhow::{Result, ensure};
use nalgebra::Vector3;
use tieline_filter::Trajectory;

use crate::prove::Row;
use crate::prove::mobile::{apart_ned_m, load, median, seeds, simulate, text, tieline, windows};

use super::judged::asked;

/// What is looked for: spots of pavement, and posts beside the road.
const KINDS: &str = "[\"texture\", \"pole\"]";

/// Largest error along the way and across it within the outages \[m\].
fn largest_m(data: &Path, trajectory: &Trajectory) -> Result<[f64; 2]> {
    const AHEAD_S: f64 = 0.5;
    let truth = load(&data.join("truth/truth.sbet"), None)?;
    let outages = windows(&data.join("truth/outages.csv"), 0)?;
    let mut largest = [0.0_f64; 2];
    let mut epochs = 0;
    for (place, time_s) in trajectory.position().iter().zip(trajectory.time_s()).step_by(20) {
        if !outages.iter().any(|(from_s, to_s)| time_s > from_s && time_s <= to_s) {
            continue;
        }
        let pose = |at_s: f64| truth.pose_at(at_s).map(|p| p.position);
        let (Some(here), Some(ahead)) = (pose(*time_s), pose(time_s + AHEAD_S)) else { continue };
        let way = apart_ned_m(&ahead, &here);
        let Some(along) = Vector3::new(way.x, way.y, 0.0).try_normalize(0.1) else { continue };
        let error = apart_ned_m(place, &here);
        let across = error.x * along.y - error.y * along.x;
        largest = [largest[0].max(error.dot(&along).abs()), largest[1].max(across.abs())];
        epochs += 1;
    }
    ensure!(epochs > 0, "no epoch within {outages:?}");
    Ok(largest)
}

/// Line 2.
pub(crate) fn straight() -> Result<Vec<Row>> {
    let mut largest: Vec<[[f64; 2]; 3]> = Vec::new();
    for seed in 1..=seeds() {
        let folder = tempfile::tempdir()?;
        let project = simulate("straight", seed, folder.path(), |t| t)?;
        let data = folder.path().join("data");
        let solved = |project: &Path, name: &str| -> Result<[f64; 2]> {
            let out = folder.path().join(name);
            tieline(&["run", "--quiet", "--out", text(&out)?, text(project)?])?;
            largest_m(&data, &load(&out.join("trajectory.sbet"), None)?)
        };
        let of_seed = [
            largest_m(&data, &load(&data.join("trajectory.sbet"), None)?)?,
            solved(&project, "lines")?,
            solved(&asked(&project, KINDS)?, "points")?,
        ];
        let [without, lines, points] = of_seed.map(|[along, across]| format!("{along:.3} {across:.3}"));
        println!(
            "seed {seed}, largest error along and across [m]: without ties {without}, surface lines {lines}, with points {points}"
        );
        largest.push(of_seed);
    }
    let middle = |of: &dyn Fn(&[[f64; 2]; 3]) -> f64| median(&mut largest.iter().map(of).collect::<Vec<_>>());
    Ok(vec![
        Row::at_least("straight: along the way without XYZ points, largest, median", middle(&|l| l[1][0]), 0.10, "m"),
        Row::at_least("straight: surface lines over none, along, median", middle(&|l| l[1][0] / l[0][0]), 0.8, ""),
        Row::at_most("straight: along the way with XYZ points, largest, median", middle(&|l| l[2][0]), 0.03, "m"),
    ])
}
