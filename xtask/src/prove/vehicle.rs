//! A real vehicle with three scanners at three stations: do they agree on ground and walls?

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use super::Row;
use super::real::{program, root};

/// Robust sd that planes common to two scanners may have \[m\].
const BOUND_M: f64 = 0.03;
/// Other choices of the held-out planes, for the record.
const SEEDS: std::ops::RangeInclusive<u64> = 2..=5;

/// Calibrates the sample, with another seed of the held-out planes when asked.
fn calibrate(seed: Option<u64>) -> Result<Value> {
    let folder = tempfile::tempdir()?;
    let sample = root().join("samples/real/mls-vehicle-multiscanner.toml");
    let project = folder.path().join("project.toml");
    let text = std::fs::read_to_string(&sample)?;
    let beside = sample.parent().context("a folder")?.canonicalize()?;
    let text = text.replace("\"../", &format!("\"{}/../", beside.display()));
    let seed = seed.map_or_else(String::new, |s| format!("\n[match]\nseed = {s}\n"));
    std::fs::write(&project, text + &seed)?;
    let output = std::process::Command::new(program()?)
        .args(["calibrate", "--json", "--out"])
        .arg(folder.path().join("out"))
        .arg(&project)
        .output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}

fn of<'a>(summary: &'a Value, kind: &str) -> &'a Value {
    let groups = summary["groups"].as_array().map_or(&[][..], Vec::as_slice);
    let group = groups.iter().find(|g| g["pair"] == "" && g["kind"] == kind);
    group.map_or(&Value::Null, |g| &g["discrepancy"])
}

fn sd_m(discrepancy: &Value, stage: &str) -> f64 {
    discrepancy[stage]["sigma_mad_m"].as_f64().unwrap_or(f64::NAN)
}

/// Line 8: real vehicle data.
pub(crate) fn scanners() -> Result<Vec<Row>> {
    let summary = calibrate(None)?;
    let mut rows = Vec::new();
    let all = &summary["discrepancy"];
    let count = |d: &Value, stage: &str| d[stage]["n"].as_u64().unwrap_or(0);
    for (name, d) in [("all planes", all), ("ground", of(&summary, "ground")), ("walls", of(&summary, "wall"))] {
        for (words, stage, before) in [("used", "after", "before"), ("held out", "held_out_after", "held_out_before")] {
            println!("{name}, {words}: {} planes, {:.4} m before", count(d, stage), sd_m(d, before));
            rows.push(Row::at_most(format!("vehicle: {name}, {words}, robust sd"), sd_m(d, stage), BOUND_M, "m"));
        }
    }
    let (used, held) = (count(all, "after"), count(all, "held_out_after"));
    #[allow(clippy::cast_precision_loss)] // hundreds
    let share = held as f64 / (used + held).max(1) as f64;
    rows.push(Row::between("vehicle: share of the planes held out", share, 0.15, 0.25, ""));
    let words = summary["calibration"]["not_seen"].as_array().context("what is not seen")?;
    words.iter().filter_map(Value::as_str).for_each(|w| println!("{w}"));
    let said = words.iter().filter_map(Value::as_str).any(|w| w.starts_with("not seen: boresight roll, pitch, yaw"));
    rows.push(Row::between("vehicle: says which angles it cannot see", f64::from(u8::from(said)), 1.0, 1.0, ""));
    // how much hangs on which planes were held out; walls are few
    for seed in SEEDS {
        let other = calibrate(Some(seed))?;
        let wall = of(&other, "wall");
        println!(
            "other planes held out (seed {seed}): all {:.4} m ({}), ground {:.4} m, walls {:.4} m ({})",
            sd_m(&other["discrepancy"], "held_out_after"),
            count(&other["discrepancy"], "held_out_after"),
            sd_m(of(&other, "ground"), "held_out_after"),
            sd_m(wall, "held_out_after"),
            count(wall, "held_out_after")
        );
    }
    Ok(rows)
}
