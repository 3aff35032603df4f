//! What a large drive costs against decoding and encoding its strips once.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, ensure};
use serde_json::Value;
use tieline::cpu;
use tieline_io::las::{LasFile, RewriteOptions, output_offset, output_scale, rewrite};

use super::super::Row;
use super::super::real::program;
use super::{number, simulate, text};

/// What else runs on a machine only ever adds to CPU seconds: the least counts.
const ROUNDS: usize = 3;
/// Pulses a second of each scanner, for more than 20 million points.
const PULSE_RATE: &str = "pulse_rate_hz = 40_000.0";

/// Line 7: CPU of the run without the smoother, passes over the strips, memory.
#[allow(clippy::cast_precision_loss)]
pub(crate) fn time() -> Result<Vec<Row>> {
    let folder = tempfile::tempdir()?;
    let denser = |t: String| t.replace("pulse_rate_hz = 25_000.0", PULSE_RATE);
    let project = simulate("loop113", 1, folder.path(), denser)?;
    let strips: Vec<PathBuf> = std::fs::read_dir(folder.path().join("data/strips"))?
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "laz"))
        .collect();
    let points: u64 = strips.iter().map(|f| LasFile::open(f).map(|l| l.header().point_count)).sum::<Result<_, _>>()?;
    let (mut least_recode_s, mut least_run_s, mut summary) = (f64::INFINITY, f64::INFINITY, Value::Null);
    for _ in 0..ROUNDS {
        least_recode_s = least_recode_s.min(recode(&strips, &folder.path().join("recoded"))?);
        let before_s = cpu::of_children_s();
        let out = folder.path().join("out");
        let ran = Command::new(program()?)
            .args(["run", "--json", "--overwrite", "--out", text(&out)?, text(&project)?])
            .output()?;
        ensure!(ran.status.success(), "tieline run: {}", String::from_utf8_lossy(&ran.stderr));
        let all_s = cpu::of_children_s() - before_s;
        let of_round: Value = serde_json::from_slice(&ran.stdout)?;
        let run_s = all_s - number(&of_round, &["timing", "cpu", "smoother"]);
        if run_s < least_run_s {
            (least_run_s, summary) = (run_s, of_round);
        }
    }
    let million = points as f64 / 1e6;
    println!("{million:.1} M points; least of {ROUNDS} rounds, CPU seconds of user and system");
    println!("decode and encode once, one thread: {least_recode_s:.2} s; run without the smoother: {least_run_s:.2} s");
    for (stage, seconds) in summary["timing"]["cpu"].as_object().into_iter().flatten() {
        let (cpu_s, wall_s) = (seconds.as_f64().unwrap_or(f64::NAN), number(&summary, &["timing", "stage", stage]));
        println!("    {stage:<12} {cpu_s:>7.2} s CPU  {wall_s:>7.2} s wall");
    }
    let passes: f64 = summary["timing"]["passes"].as_object().into_iter().flatten().filter_map(|p| p.1.as_f64()).sum();
    Ok(vec![
        Row::between("drive of 20 M points and more", million, 20.0, f64::INFINITY, "M"),
        Row::at_most("run without the smoother / decode and encode, CPU", least_run_s / least_recode_s, 3.0, ""),
        Row::at_most("passes over the strips, the sample included", passes, 2.25, ""),
        Row::at_most("peak memory", number(&summary, &["peak_memory_bytes"]) / 1_048_576.0, 2048.0, "MiB"),
    ])
}

/// CPU seconds of decoding and encoding files at the scale of corrected ones, coordinates as they are, on one thread.
fn recode(files: &[PathBuf], target: &Path) -> Result<f64> {
    std::fs::create_dir_all(target)?;
    let before_s = cpu::seconds();
    rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(|| -> Result<()> {
        for (k, file) in files.iter().enumerate() {
            let las = LasFile::open(file)?;
            let header = las.header();
            let scale = output_scale(header.scale);
            let offset = output_offset(header.min, header.max, scale);
            let options = RewriteOptions { scale, offset, generating_software: String::from("proof") };
            rewrite(&las, &target.join(format!("{k}.laz")), &options, |_, _, _, _| Ok(()))?;
        }
        Ok(())
    })?;
    Ok(cpu::seconds() - before_s)
}
