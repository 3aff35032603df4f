//! Two scanners through an outage without a loop.

use std::path::Path;

use anyhow::Result;

use super::super::Row;
use super::{Errors, errors, median, seeds, simulate, text, tieline};

/// The whole; the range bias alone left in the cloud, all else as found with it removed; no façades, curb faces and walls.
const ARMS: [(&str, &str); 3] = [
    ("whole", ""),
    (
        "bias",
        "[calibrate]\nenabled = false\nknown = \"../whole/calibration.toml\"\nknown_terms = [\"boresight\", \"lever_arm\", \"latency\"]\n",
    ),
    ("level", "[match]\nsurfaces = [\"level\"]\n"),
];

/// Line 3: two scanners through an outage without a loop, with and without the range bias, with and without steep surfaces.
pub(crate) fn odometer_of_two_scanners() -> Result<Vec<Row>> {
    let (mut height, mut plan) = ([const { Vec::new() }; 4], [const { Vec::new() }; 4]);
    for seed in 1..=seeds() {
        let folder = tempfile::tempdir()?;
        let project = simulate("tunnel175", seed, folder.path(), |t| t)?;
        let data = folder.path().join("data");
        let mut found = vec![errors(&data, &data)?];
        for (name, more) in ARMS {
            found.push(arm(&project, name, more)?);
        }
        let words: Vec<String> = ["handed out", "now", "range bias left in", "level surfaces only"]
            .iter()
            .zip(&found)
            .map(|(name, e)| format!("{name} {:.3} m / {:.3} m", e.largest_ned_m[2], e.largest_plan_m))
            .collect();
        println!("seed {seed}, height / plan: {}", words.join(", "));
        for (k, e) in found.iter().enumerate() {
            height[k].push(e.largest_ned_m[2]);
            plan[k].push(e.largest_plan_m);
        }
    }
    let (height, plan) = (height.map(|mut v| median(&mut v)), plan.map(|mut v| median(&mut v)));
    println!("medians of seeds, handed out: height {:.3} m, plan {:.3} m", height[0], plan[0]);
    println!("now: height {:.4} m, plan {:.4} m", height[1], plan[1]);
    println!("range bias left in: height {:.4} m; level surfaces only: plan {:.4} m", height[2], plan[3]);
    Ok(vec![
        Row::at_most("tunnel175: largest height error, median of seeds", height[1], 0.02, "m"),
        Row::between(
            "tunnel175: range bias left in: the height error grows by",
            height[2] / height[1],
            2.0,
            f64::INFINITY,
            "",
        ),
        Row::at_most("tunnel175: plan error with façades over without", plan[1] / plan[3], 0.5, ""),
    ])
}

/// Runs the project with more in its file, beside the others.
fn arm(project: &Path, name: &str, more: &str) -> Result<Errors> {
    let file = project.with_file_name(format!("{name}.toml"));
    std::fs::write(&file, format!("{}\n{more}", std::fs::read_to_string(project)?))?;
    let data = project.parent().unwrap_or(Path::new("."));
    let out = data.with_file_name(name);
    tieline(&["run", "--quiet", "--out", text(&out)?, text(&file)?])?;
    errors(data, &out)
}
