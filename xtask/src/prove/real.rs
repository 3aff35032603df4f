//! Real strips, judged by an independent program.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use super::Row;

pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The tieline program of the same build.
pub(crate) fn program() -> Result<PathBuf> {
    let program = std::env::current_exe()?.with_file_name("tieline");
    ensure!(program.is_file(), "{} is not built: cargo build --release", program.display());
    Ok(program)
}

/// Runs a project into a folder and gives its summary.
pub(crate) fn run(project: &Path, out: &Path, threads: usize) -> Result<Value> {
    let output = Command::new(program()?)
        .args(["run", "--json", "--overwrite", "--threads", &threads.to_string(), "--out"])
        .arg(out)
        .arg(project)
        .output()?;
    ensure!(output.status.success(), "{}: {}", project.display(), String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// The judge's pairs and totals for files.
pub(crate) fn judge(files: &[PathBuf], by: &str) -> Result<Value> {
    let json = tempfile::NamedTempFile::new()?;
    let output = Command::new("python3")
        .arg(root().join("../shared/check/strip_dz.py"))
        .args(files)
        .args(["--by", by, "--json"])
        .arg(json.path())
        .output()
        .context("python3 with laspy[lazrs] and numpy")?;
    ensure!(output.status.success(), "the judge: {}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_str(&std::fs::read_to_string(json.path())?)?)
}

pub(crate) fn laz_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "laz"))
        .collect();
    files.sort();
    Ok(files)
}

pub(crate) fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// Runs one data set; gives its summary and the judge's word before and after.
fn one(name: &str, by: &str) -> Result<(Value, Value, Value)> {
    let out = tempfile::tempdir()?;
    let summary = run(&root().join(format!("samples/real/{name}.toml")), out.path(), 2)?;
    let before = judge(&laz_in(&root().join(format!("../shared/data/{name}")))?, by)?;
    let after = judge(&laz_in(&out.path().join("corrected"))?, by)?;
    Ok((summary, before, after))
}

fn mm(value: &Value, key: &str) -> f64 {
    number(&value["total"][key]) * 1e3
}

fn bounds(name: &str, by: &str, medians: f64, cells: f64) -> Result<(Vec<Row>, Value, Value)> {
    let (summary, before, after) = one(name, by)?;
    println!(
        "{name} before: medians {:.1} mm, cells {:.1} mm, shift {:.1} mm",
        mm(&before, "rms_of_medians_m"),
        mm(&before, "cell_rms_m"),
        mm(&before, "rms_shift_xy_m")
    );
    let rows = vec![
        Row::at_most(format!("{name}: rms of pair medians"), mm(&after, "rms_of_medians_m"), medians, "mm"),
        Row::at_most(format!("{name}: cell rms"), mm(&after, "cell_rms_m"), cells, "mm"),
    ];
    Ok((rows, summary, after))
}

/// Line 1: Zürich.
pub(crate) fn zurich() -> Result<Vec<Row>> {
    let (mut rows, summary, after) = bounds("als-zurich-8strips", "psid", 2.0, 10.0)?;
    rows.push(Row::at_most("zurich: horizontal shift rms", mm(&after, "rms_shift_xy_m"), 20.0, "mm"));
    let worst = |key: &str| {
        after["pairs"].as_array().into_iter().flatten().map(|p| number(&p[key]).abs() * 1e3).fold(0.0, f64::max)
    };
    rows.push(Row::at_most("zurich: worst robust sd of a pair", worst("robust_sd_m"), 9.5, "mm"));
    rows.push(Row::at_most("zurich: worst median of a pair", worst("median_m"), 3.0, "mm"));
    let d = &summary["discrepancy"];
    let ratio = number(&d["held_out_after"]["rms_m"]) / number(&d["after"]["rms_m"]);
    rows.push(Row::at_most("zurich: rms of held-out over used ties", ratio, 1.10, ""));
    let median = number(&d["held_out_after"]["median_m"]).abs() * 1e3;
    rows.push(Row::at_most("zurich: |median| of held-out ties", median, 1.0, "mm"));
    Ok(rows)
}

/// Line 2: two heads on one aircraft.
pub(crate) fn dual_scanner() -> Result<Vec<Row>> {
    let (mut rows, summary, _) = bounds("als-ign-dual-scanner", "psid+user", 1.0, 10.5)?;
    let empty = Vec::new();
    let parameters = summary["calibration"]["parameters"].as_array().unwrap_or(&empty);
    let heads = parameters.iter().filter(|p| p["name"] == "boresight roll").count() - 1; // less the difference of the two
    let relative = |name: &str| {
        let of_both = |p: &&Value| p["name"] == name && p["block"].as_str().is_some_and(|b| b.contains(" less "));
        parameters.iter().find(of_both).map_or(f64::NAN, |p| number(&p["observed"]))
    };
    rows.push(Row::between(
        "ign: relative roll, share determined by the ties",
        relative("boresight roll"),
        0.99,
        1.0,
        "",
    ));
    #[allow(clippy::cast_precision_loss)]
    rows.push(Row::between("ign: heads with a boresight of their own", heads as f64, 2.0, 2.0, ""));
    for p in parameters.iter().filter(|p| p["block"].as_str().is_some_and(|b| b.starts_with("scanner"))) {
        println!(
            "  {} {}: {:+.4} ± {:.4} {} (prior {:.4}), determined by the ties to {:.0} %",
            p["block"].as_str().unwrap_or(""),
            p["name"].as_str().unwrap_or(""),
            number(&p["value"]),
            number(&p["sigma"]),
            p["unit"].as_str().unwrap_or(""),
            number(&p["prior_sigma"]),
            number(&p["observed"]) * 100.0
        );
    }
    Ok(rows)
}

/// Line 3: forest in tiles, the Alps, strips without ids.
pub(crate) fn others() -> Result<Vec<Row>> {
    let mut rows = bounds("als-bcts-3strips", "psid", 3.0, 17.0)?.0;
    rows.extend(bounds("als-alps-9strips", "psid", 6.0, 30.0)?.0);
    let out = tempfile::tempdir()?;
    let summary = run(&root().join("samples/real/als-toronto-nopsid.toml"), out.path(), 2)?;
    let d = &summary["discrepancy"];
    let gain = number(&d["held_out_after"]["rms_m"]) / number(&d["held_out_before"]["rms_m"]);
    rows.push(Row::at_most("toronto: held-out rms after over before", gain, 0.999, ""));
    let told = summary["calibration"]["unobservable"].as_array().map_or(0, Vec::len);
    #[allow(clippy::cast_precision_loss)]
    rows.push(Row::between("toronto: combinations it says it cannot know", told as f64, 1.0, 1e9, ""));
    Ok(rows)
}
