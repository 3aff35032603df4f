//! Real and simulated drives through the program, judged by an independent program against truth that it never sees.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};

use super::Row;
use super::real::{program, root};

/// Windows of whu-sim27 \[s of week\].
const WINDOWS_S: [u32; 6] = [358_190, 358_330, 358_450, 358_560, 358_660, 358_820];
/// First fix of drive0708 \[s of week\], and the windows from it.
const FIRST_FIX_S: f64 = 243_258.499;
const DRIVE_WINDOWS_S: [f64; 5] = [120.0, 200.0, 300.0, 400.0, 460.0];
/// Largest horizontal error of `GNSS_IMU`'s combined solution in these windows \[m\].
const PEER_H_MAX_M: [f64; 5] = [5.3, 281.0, 19.3, 13.3, 7.9];

/// Root mean squares and maxima of one line of the judge.
#[derive(Debug, Clone, Default)]
struct Judged(BTreeMap<String, f64>);

impl Judged {
    fn get(&self, key: &str) -> f64 {
        self.0.get(key).copied().unwrap_or(f64::NAN)
    }
}

/// Solves a sample into a folder.
fn solve(sample: &str, out: &Path, mask: Option<String>) -> Result<serde_json::Value> {
    let mut command = Command::new(program()?);
    command.args(["solve", "--json", "--out"]).arg(out);
    if let Some(mask) = mask {
        command.args(["--mask-gnss", &mask]);
    }
    let output = command.arg(root().join(format!("samples/real/{sample}.toml"))).output()?;
    ensure!(output.status.success(), "{sample}: {}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// The judge's word on a solution: the whole run, or a window.
fn judge(solution: &Path, reference: &str, extra: &[&str], window: Option<&str>) -> Result<Judged> {
    let mut command = Command::new("python3");
    command.arg(root().join("../shared/check/eval_nav.py")).arg("eval").arg(solution);
    command.arg(root().join("../shared/data").join(reference)).args(extra);
    if let Some(window) = window {
        command.args(["--window", window]);
    }
    let output = command.output().context("python3 with numpy")?;
    ensure!(output.status.success(), "the judge: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let head = if window.is_some() { "window" } else { "run" };
    let mut lines = text.lines().skip_while(|l| !l.starts_with(head));
    let mut judged = Judged::default();
    for (prefix, line) in ["pos", "vel", "att"].into_iter().zip(lines.by_ref()) {
        let Some((rms, largest)) = line.split_once('|') else { break };
        for (kind, part) in [("rms", rms), ("max", largest)] {
            let words: Vec<&str> = part.split_whitespace().collect();
            for pair in words.windows(2) {
                if let Ok(value) = pair[1].parse::<f64>() {
                    judged.0.insert(format!("{prefix} {kind} {}", pair[0]), value);
                }
            }
        }
    }
    Ok(judged)
}

/// Line 2: whu-sim27 without outage.
pub(crate) fn whole() -> Result<Vec<Row>> {
    let out = tempfile::tempdir()?;
    solve("whu-sim27", out.path(), None)?;
    let truth = "whu-sim27/truth.nav.gz";
    // the figures of KF-GINS begin 120 s after 357820
    let from = (357_820.0 + 120.0 - first_time(&out.path().join("forward.csv"))?).to_string();
    let skip = ["--skip", &from];
    let filter = judge(&out.path().join("forward.csv"), truth, &skip, None)?;
    let smooth = judge(&out.path().join("trajectory.csv"), truth, &skip, None)?;
    let mm = |j: &Judged, axis: &str| j.get(&format!("pos rms {axis}")) * 1e3;
    let mut rows = Vec::new();
    for (axis, bound) in [("N", 9.7), ("E", 7.4), ("D", 13.6)] {
        rows.push(Row::at_most(format!("filter, rms {axis}"), mm(&filter, axis), bound, "mm"));
    }
    rows.push(Row::at_most("filter, rms yaw", filter.get("att rms y"), 0.0047, "deg"));
    for (axis, bound) in [("N", 9.0), ("E", 6.0), ("D", 11.5)] {
        rows.push(Row::at_most(format!("smoother, rms {axis}"), mm(&smooth, axis), bound, "mm"));
        let ratio = mm(&smooth, axis) / mm(&filter, axis);
        rows.push(Row::at_most(format!("smoother over filter, rms {axis}"), ratio, 1.0, ""));
    }
    rows.push(Row::at_most("smoother, rms yaw", smooth.get("att rms y"), 0.004, "deg"));
    let ratio = smooth.get("att rms y") / filter.get("att rms y");
    rows.push(Row::at_most("smoother over filter, rms yaw", ratio, 1.0, ""));
    Ok(rows)
}

/// First time of a trajectory \[s of week\].
fn first_time(path: &Path) -> Result<f64> {
    let text = std::fs::read_to_string(path)?;
    let line = text.lines().nth(1).context("an epoch")?;
    Ok(line.split(',').nth(1).context("a time")?.parse()?)
}

#[allow(clippy::cast_precision_loss)]
fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Line 3: outages of whu-sim27.
pub(crate) fn outages() -> Result<Vec<Row>> {
    // KF-GINS over the six windows: horizontal and vertical rms [m]
    let peer = [(60, 0.21, 0.18), (113, 0.65, 0.49), (175, 1.59, 1.07)];
    let mut rows = Vec::new();
    for (sample, bounds) in [("whu-sim27", [f64::NAN, 0.09, 0.16]), ("whu-sim27-odometer", [f64::NAN, 0.06, 0.09])] {
        for ((length, peer_h, peer_v), bound) in peer.into_iter().zip(bounds) {
            let (mut filter_h, mut filter_v, mut smooth_h) = (vec![], vec![], vec![]);
            for window in WINDOWS_S {
                let out = tempfile::tempdir()?;
                let mask = format!("{window}:{length}");
                solve(sample, out.path(), Some(mask.clone()))?;
                let truth = "whu-sim27/truth.nav.gz";
                let filter = judge(&out.path().join("forward.csv"), truth, &[], Some(&mask))?;
                let smooth = judge(&out.path().join("trajectory.csv"), truth, &[], Some(&mask))?;
                filter_h.push(filter.get("pos rms H"));
                filter_v.push(filter.get("pos rms D"));
                smooth_h.push(smooth.get("pos rms H"));
            }
            let name = |what: &str| format!("{sample}, {length} s: {what}");
            if sample == "whu-sim27" {
                rows.push(Row::at_most(name("filter, H rms over windows"), rms(&filter_h), 1.1 * peer_h, "m"));
                rows.push(Row::at_most(name("filter, V rms over windows"), rms(&filter_v), 1.1 * peer_v, "m"));
            }
            if bound.is_finite() {
                rows.push(Row::at_most(name("smoothed, H rms over windows"), rms(&smooth_h), bound, "m"));
            }
        }
    }
    Ok(rows)
}

/// Line 4: a real car.
pub(crate) fn car() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let reference = "drive0708/gnss_ref.txt.gz";
    let judge_as = ["--ref-kind", "gnss", "--lever=0,-0.05,0"];
    for (window, peer) in DRIVE_WINDOWS_S.into_iter().zip(PEER_H_MAX_M) {
        let out = tempfile::tempdir()?;
        let mask = format!("{:.3}:60", FIRST_FIX_S + window);
        solve("drive0708", out.path(), Some(mask.clone()))?;
        let smooth = judge(&out.path().join("trajectory.csv"), reference, &judge_as, Some(&mask))?;
        rows.push(Row::at_most(
            format!("drive0708, window {window}: H max (peer {peer})"),
            smooth.get("pos max H"),
            peer.min(5.0),
            "m",
        ));
    }
    let out = tempfile::tempdir()?;
    let summary = solve("drive0708", out.path(), None)?;
    let rests: Vec<(f64, f64)> = summary["trajectory"]["rests_s"]
        .as_array()
        .context("rests")?
        .iter()
        .filter_map(|r| Some((r[0].as_f64()?, r[1].as_f64()?)))
        .collect();
    let stops = stops_by_gnss(&root().join("../shared/data").join(reference))?;
    let missed = stops.iter().filter(|s| !rests.iter().any(|r| r.0 < s.1 && r.1 > s.0)).count();
    #[allow(clippy::cast_precision_loss)]
    rows.push(Row::at_most(
        format!("drive0708: of {} stops (1.5 s and longer) missed", stops.len()),
        missed as f64,
        0.0,
        "",
    ));
    let offset = summary["trajectory"]["clock_offset_s"].as_f64().unwrap_or(f64::NAN);
    rows.push(Row::between("drive0708: IMU clock against GNSS, estimated", offset, 0.05, 0.15, "s"));
    let whole = judge(&out.path().join("trajectory.csv"), reference, &judge_as, None)?;
    rows.push(Row::at_most("drive0708 without outage: H rms at the fixes", whole.get("pos rms H"), 0.06, "m"));
    Ok(rows)
}

/// stops of one and a half seconds and longer by the receiver's velocity: speed below 0.1 m/s.
fn stops_by_gnss(path: &Path) -> Result<Vec<(f64, f64)>> {
    let output = Command::new("gzip").arg("-dc").arg(path).output().context("gzip")?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let mut stops: Vec<(f64, f64)> = Vec::new();
    let mut last_slow = false;
    for line in text.lines() {
        let v: Vec<f64> = line.split_whitespace().filter_map(|w| w.parse().ok()).collect();
        if v.len() < 10 {
            continue;
        }
        let slow = v[7].hypot(v[8]) < 0.1;
        match stops.last_mut() {
            Some(last) if slow && last_slow => last.1 = v[0],
            _ if slow => stops.push((v[0], v[0])),
            _ => {}
        }
        last_slow = slow;
    }
    // shorter ones are the moment between rolling forward and back: the platform rocks, and its velocity is not zero
    stops.retain(|s| s.1 - s.0 >= 1.5);
    Ok(stops)
}
