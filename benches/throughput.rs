//! Speed as a ratio to a lower bound in the same run: `cargo bench --bench throughput`.
//!
//! zurich.laz is repeated in space (each copy shifted east and later, so that it is a block of strips of its own) to
//! 20 million points and more. `match` is measured against decoding the LAZ alone with the laz crate, `correct` against
//! decoding and encoding at the scale of the output; each in a process of its own, CPU seconds of user and system:
//! the least of five rounds in turn, for what else runs on a machine only ever adds to them.
//! With `--large` memory is also taken at 80 million points. Prints name, value, bound, ratio; exits 1 when one fails.

#![allow(clippy::print_stdout)] // a bench prints its figures

use std::io::{BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use laz::{LasZipDecompressor, LazVlr};
use rayon::prelude::*;
use tieline_io::las::{LasFile, LasWriter, LasWriterOptions, RewriteOptions, output_offset, output_scale, rewrite};

const COPIES: u32 = 31;
const ROUNDS: usize = 5;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.first().map(String::as_str) {
        Some("decode") => decode(&arguments[1..]),
        Some("recode") => recode(Path::new(&arguments[1]), &arguments[2..]),
        _ => bench(arguments.iter().any(|a| a == "--large")),
    }
}

/// CPU seconds of this process's finished children (Linux: /proc/self/stat, fields 16 and 17, hundredths).
fn cpu_of_children_s() -> Result<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let rest = stat.rsplit_once(')').context("/proc/self/stat")?.1;
    let fields: Vec<f64> = rest.split_whitespace().filter_map(|f| f.parse().ok()).collect();
    // after the name and the state letter come fields 4, 5, …: cutime is field 16
    Ok((fields[12] + fields[13]) / 100.0)
}

struct Measured {
    cpu_s: f64,
    wall_s: f64,
    output: String,
}

fn run(command: &mut Command) -> Result<Measured> {
    let (cpu, wall) = (cpu_of_children_s()?, Instant::now());
    let output = command.stderr(Stdio::inherit()).output()?;
    ensure!(output.status.success(), "{command:?} failed");
    Ok(Measured {
        wall_s: wall.elapsed().as_secs_f64(),
        cpu_s: cpu_of_children_s()? - cpu,
        output: String::from_utf8_lossy(&output.stdout).into_owned(),
    })
}

fn bench(large: bool) -> Result<()> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/als-zurich-8strips/zurich.laz");
    if !source.is_file() {
        println!("zurich.laz is not there (samples/real/README.md says where to put it): nothing is measured");
        return Ok(());
    }
    let folder = tempfile::tempdir()?;
    let files = replicate(&source, folder.path(), COPIES)?;
    let points: u64 = files.iter().map(|f| LasFile::open(f).map(|l| l.header().point_count)).sum::<Result<u64, _>>()?;
    let program = env!("CARGO_BIN_EXE_tieline");
    let me = std::env::current_exe()?;
    let project = folder.path().join("project.toml");
    // the model is not what is measured: one solution of the constant model does
    std::fs::write(&project, "[[strips]]\npath = \"tile_*.laz\"\n[solve]\nstrips = \"constant\"\n")?;
    let out = folder.path().join("out");
    let matching = || {
        let mut command = Command::new(program);
        command.args(["match", "--json", "--out"]).arg(&out).arg(&project);
        run(&mut command)
    };
    let decoding = || run(Command::new(&me).arg("decode").args(&files));
    let mut failed = 0;
    let mut line = |name: &str, value: f64, unit: &str, bound: f64, ratio: f64| {
        let verdict = if ratio <= bound { "pass" } else { "FAIL" };
        failed += usize::from(ratio > bound);
        println!("{name:<44} {value:>9.2} {unit:<8} ratio {ratio:>6.3}  bound {bound:<5} {verdict}");
    };
    let (mut match_cpu, mut decode_cpu, mut cores, mut memory) = (vec![], vec![], vec![], 0.0_f64);
    for _ in 0..ROUNDS {
        let (d, m) = (decoding()?, matching()?);
        cores.push(m.cpu_s / m.wall_s);
        match_cpu.push(m.cpu_s);
        decode_cpu.push(d.cpu_s);
        memory = memory.max(peak_bytes(&m.output)?);
    }
    #[allow(clippy::cast_precision_loss)]
    let million = points as f64 / 1e6;
    println!("{million:.1} M points; least of {ROUNDS} rounds, each pair in turn");
    println!(
        "{:<44} {:>9.2} s CPU    ({:.2} M points a CPU second)",
        "decode alone",
        least(&decode_cpu),
        million / least(&decode_cpu)
    );
    line("match / decode", least(&match_cpu), "s CPU", 1.5, least(&match_cpu) / least(&decode_cpu));
    println!(
        "{:<44} {:>9.2} of {} cores",
        "match: cores in use",
        median(&cores),
        std::thread::available_parallelism()?
    );
    line("match: peak memory / 1.5 GiB", memory / 1_048_576.0, "MiB", 1.0, memory / (1.5 * 1_073_741_824.0));

    // correct: solve on a part of the strips would not cover all; a solution of all copies is one of all strips
    run(Command::new(program).args(["solve", "-q", "--out"]).arg(&out).arg(&project))?;
    let target = folder.path().join("recoded");
    let (mut correct_cpu, mut recode_cpu, mut cores) = (vec![], vec![], vec![]);
    for _ in 0..ROUNDS {
        let r = run(Command::new(&me).arg("recode").arg(&target).args(&files))?;
        let c = run(Command::new(program).args(["correct", "-q", "--out"]).arg(&out).arg(&project))?;
        cores.push(c.cpu_s / c.wall_s);
        correct_cpu.push(c.cpu_s);
        recode_cpu.push(r.cpu_s);
    }
    println!("{:<44} {:>9.2} s CPU", "decode and encode alone", least(&recode_cpu));
    line("correct / (decode + encode)", least(&correct_cpu), "s CPU", 1.15, least(&correct_cpu) / least(&recode_cpu));
    println!(
        "{:<44} {:>9.2} of {} cores",
        "correct: cores in use",
        median(&cores),
        std::thread::available_parallelism()?
    );
    if large {
        std::fs::remove_dir_all(&target).ok();
        std::fs::remove_dir_all(out.join("corrected")).ok();
        replicate(&source, folder.path(), 4 * COPIES)?;
        let at_80 = peak_bytes(&matching()?.output)?;
        line("match: memory at four times the points", at_80 / 1_048_576.0, "MiB", 1.25, at_80 / memory);
    }
    ensure!(failed == 0, "{failed} lines fail");
    Ok(())
}

fn peak_bytes(json: &str) -> Result<f64> {
    let value: serde_json::Value = serde_json::from_str(json)?;
    value["peak_memory_bytes"].as_f64().context("peak_memory_bytes")
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// Copies of a file, each shifted 120 m east and 100 s later, as tiles of their own.
fn replicate(source: &Path, folder: &Path, copies: u32) -> Result<Vec<PathBuf>> {
    let las = LasFile::open(source)?;
    let (header, layout) = (las.header().clone(), las.layout());
    let time_at = layout.gps_time.context("GPS time")?;
    let mut files = Vec::new();
    for copy in 0..copies {
        let path = folder.join(format!("tile_{copy:04}.laz"));
        files.push(path.clone());
        if path.is_file() {
            continue;
        }
        let mut writer = LasWriter::create(
            &path,
            LasWriterOptions {
                version: header.version,
                point_format: header.point_format,
                scale: header.scale,
                offset: header.offset,
                ..LasWriterOptions::default()
            },
        )?;
        #[allow(clippy::cast_possible_truncation)]
        let step = (120.0 / header.scale[0]).round() as i32 * i32::try_from(copy)?;
        let mut records = Vec::new();
        for chunk in 0..las.chunk_count() {
            las.read_chunk(chunk, &mut records)?;
            for record in records.chunks_exact_mut(layout.record_length) {
                let x = i32::from_le_bytes([record[0], record[1], record[2], record[3]]) + step;
                record[0..4].copy_from_slice(&x.to_le_bytes());
                let mut bytes = [0; 8];
                bytes.copy_from_slice(&record[time_at..time_at + 8]);
                let time_s = f64::from_le_bytes(bytes) + 100.0 * f64::from(copy);
                record[time_at..time_at + 8].copy_from_slice(&time_s.to_le_bytes());
            }
            writer.write_records(&records)?;
        }
        writer.finish()?;
    }
    Ok(files)
}

/// Decodes files with the laz crate alone, side by side on all cores as `match` does, and throws the points away. (Two
/// busy cores share a memory bus and a clock: CPU seconds on one core alone are fewer, for any program.)
fn decode(files: &[String]) -> Result<()> {
    files.par_iter().try_for_each(|file| {
        let mut buffer = Vec::new();
        let las = LasFile::open(Path::new(file))?;
        let header = las.header();
        let mut source = BufReader::with_capacity(1 << 20, std::fs::File::open(file)?);
        source.seek(SeekFrom::Start(header.point_data_offset))?;
        let mut decompressor =
            LasZipDecompressor::new(source, LazVlr::from_buffer(&las.record("laszip encoded", 22_204)?)?)?;
        let mut left = header.point_count;
        while left > 0 {
            let now = left.min(50_000);
            buffer.resize(usize::try_from(now)? * usize::from(header.record_length), 0);
            decompressor.decompress_many(&mut buffer)?;
            left -= now;
        }
        Ok(())
    })
}

/// Decodes and encodes files at the scale of corrected ones, side by side as `correct` does, coordinates as they are.
fn recode(target: &Path, files: &[String]) -> Result<()> {
    std::fs::create_dir_all(target)?;
    files.par_iter().try_for_each(|file| {
        let las = LasFile::open(Path::new(file))?;
        let header = las.header();
        let scale = output_scale(header.scale);
        let options = RewriteOptions {
            scale,
            offset: output_offset(header.min, header.max, scale),
            generating_software: "bench".into(),
        };
        let name = Path::new(file).file_name().context("a name")?;
        rewrite(&las, &target.join(name), &options, |_, _, _, _| Ok(()))?;
        Ok(())
    })
}
