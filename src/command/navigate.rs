//! `solve` and `run` of a project with `[imu]`: the trajectory, and everything that was learnt on the way.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use tieline_filter::innovation::MeasurementKind;
use tieline_filter::solution::EpochEstimate;
use tieline_filter::{Inputs, PositionFrame, Solution, SurveyClock, Trajectory};
use tieline_io::output::WholeFile;
use tieline_io::trajectory::{PieceFormat, PieceWriter};

use crate::cli::{Common, JobArgs};
use crate::command::project::out_folder;
use crate::memory::peak_bytes;
use crate::progress::Progress;
use crate::project::Project;
use crate::stage::navigate::{Mask, load, navigate};

/// Estimates the trajectory and writes it.
///
/// # Errors
/// Whatever is wrong with a file, the alignment or the solution.
pub fn solve(project: &Project, args: &JobArgs, masks: &[Mask], common: &Common, out: &mut impl Write) -> Result<()> {
    let folder = out_folder(&args.project, args.out.as_ref());
    let start = Instant::now();
    let measurements = load(project, masks)?;
    let read_s = start.elapsed().as_secs_f64();
    let bar = Progress::new(common.quiet || common.json).spinner("estimating the trajectory");
    let solution = navigate(project, &measurements, args.memory.max(16) << 20)?;
    bar.finish_and_clear();
    let solve_s = start.elapsed().as_secs_f64() - read_s;
    let (inputs, clock) = (&measurements.inputs, &measurements.clock);
    let smoothed = write_navigation(&folder, &solution, inputs, clock)?;
    let write_s = start.elapsed().as_secs_f64() - read_s - solve_s;
    let mut notes = measurements.notes.clone();
    notes.extend(solution.notes.iter().cloned());
    let value = summary(
        project,
        &solution,
        inputs,
        &smoothed,
        &notes,
        &[("read", read_s), ("solve", solve_s), ("write", write_s)],
    );
    whole(&folder.join("summary.json"), |w| writeln!(w, "{value:#}"))?;
    if common.json {
        writeln!(out, "{value:#}")?;
    } else if !common.quiet {
        for note in &notes {
            tracing::info!("{note}");
        }
        tell(out, &solution, &smoothed)?;
        writeln!(out, "Trajectory: {}", folder.join("trajectory.csv").display())?;
    }
    Ok(())
}

/// Writes trajectory, forward solution, innovations and states into a folder.
///
/// # Errors
/// When a file cannot be written.
pub fn write_navigation(folder: &Path, solution: &Solution, inputs: &Inputs, clock: &SurveyClock) -> Result<Written> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("the output folder {} cannot be created", folder.display()))?;
    let csv = |name: &str| PieceWriter::create(&folder.join(name), PieceFormat::Csv(*clock));
    let smoothed = write_epochs(
        solution.epochs(inputs),
        solution.clock_offset_s(),
        vec![
            csv("trajectory.csv")?,
            PieceWriter::create(&folder.join("trajectory.sbet"), PieceFormat::Sbet)?,
            PieceWriter::create(&folder.join("trajectory_rms.out"), PieceFormat::Smrmsg)?,
        ],
    )?;
    write_epochs(solution.filter_epochs(inputs), solution.clock_offset_s(), vec![csv("forward.csv")?])?;
    whole(&folder.join("innovations.csv"), |w| innovations(w, solution, clock))?;
    whole(&folder.join("states.csv"), |w| states(w, solution, clock))?;
    Ok(smoothed)
}

/// Epochs that are in memory at a time.
const PIECE: usize = 1 << 16;

/// What is to be said of a trajectory as a whole.
#[derive(Debug, Clone, Copy, Default)]
pub struct Written {
    /// Epochs.
    pub epochs: usize,
    /// First and last \[s\].
    pub span_s: (f64, f64),
    /// Root mean squares of the standard deviations north, east, down \[m\].
    pub position_sigma_m: [f64; 3],
    /// The same of roll, pitch, heading \[rad\].
    pub attitude_sigma_rad: [f64; 3],
}

/// Writes epochs in GPS time, piece by piece.
#[allow(clippy::cast_precision_loss)]
fn write_epochs(
    epochs: impl Iterator<Item = EpochEstimate>,
    clock_offset_s: f64,
    mut writers: Vec<PieceWriter>,
) -> Result<Written> {
    let mut written = Written::default();
    let mut piece: Vec<EpochEstimate> = Vec::with_capacity(PIECE + 2);
    let mut done = 0; // epochs of the piece that are written already: those an SBET looks back at
    let mut epochs = epochs.peekable();
    while let Some(mut epoch) = epochs.next() {
        epoch.nav.time_s -= clock_offset_s;
        if written.epochs == 0 {
            written.span_s.0 = epoch.nav.time_s;
        }
        written.epochs += 1;
        written.span_s.1 = epoch.nav.time_s;
        for k in 0..3 {
            written.position_sigma_m[k] += epoch.sigma.position_ned_m[k].powi(2);
            written.attitude_sigma_rad[k] += epoch.sigma.attitude_rph_rad[k].powi(2);
        }
        piece.push(epoch);
        let last = epochs.peek().is_none();
        if piece.len() > PIECE || last {
            let trajectory = trajectory_of(&piece)?;
            // but for the last piece, its last epoch waits for the one after it
            let to = if last { piece.len() } else { piece.len() - 1 };
            for writer in &mut writers {
                writer.append(&trajectory, done..to)?;
            }
            let keep = piece.len().saturating_sub(2);
            piece.drain(..keep);
            done = 1;
        }
    }
    for writer in writers {
        writer.finish()?;
    }
    let root = |sum: f64| (sum / written.epochs.max(1) as f64).sqrt();
    written.position_sigma_m = written.position_sigma_m.map(root);
    written.attitude_sigma_rad = written.attitude_sigma_rad.map(root);
    Ok(written)
}

fn trajectory_of(piece: &[EpochEstimate]) -> Result<Trajectory> {
    let trajectory = Trajectory::new(
        PositionFrame::Geodetic,
        piece.iter().map(|e| e.nav.time_s).collect(),
        piece.iter().map(|e| e.nav.geodetic).collect(),
        piece.iter().map(|e| e.nav.ned_from_body).collect(),
        piece.iter().map(|e| e.nav.velocity_ned_mps).collect(),
    )?;
    Ok(trajectory.with_sigma(piece.iter().map(|e| e.sigma).collect())?)
}

/// Writes a file whole or not at all.
fn whole(path: &Path, write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    let context = || format!("{} cannot be written", path.display());
    let mut file = WholeFile::create(path).with_context(context)?;
    write(file.writer()).with_context(context)?;
    file.finish().with_context(context)
}

/// A few lines for a person.
fn tell(out: &mut impl Write, solution: &Solution, smoothed: &Written) -> Result<()> {
    writeln!(
        out,
        "{} epochs over {:.0} s, {} rests, {} runs (last change {:.3} sigma)",
        smoothed.epochs,
        smoothed.span_s.1 - smoothed.span_s.0,
        solution.rests.len(),
        solution.runs,
        solution.change
    )?;
    let [n, e, d] = smoothed.position_sigma_m;
    let [roll, pitch, heading] = smoothed.attitude_sigma_rad.map(f64::to_degrees);
    writeln!(
        out,
        "sigma: north {n:.3} m, east {e:.3} m, down {d:.3} m, roll {roll:.4}°, pitch {pitch:.4}°, heading {heading:.4}° (rms)"
    )?;
    Ok(())
}

/// GPS seconds of week of a survey time.
fn second_of_week(clock: &SurveyClock, time_s: f64) -> f64 {
    clock.gps_time(time_s).map_or(time_s, |t| t.seconds_of_week)
}

/// `innovations.csv`: what each measurement said against what was expected of it.
fn innovations(out: &mut dyn Write, solution: &Solution, clock: &SurveyClock) -> std::io::Result<()> {
    writeln!(out, "gps_time_s,kind,component,value,normalised,nis,weight")?;
    let offset_s = solution.clock_offset_s();
    for i in &solution.innovations {
        let time_s = second_of_week(clock, i.time_s - offset_s);
        for (component, (value, normalised)) in i.value.iter().zip(&i.normalised).enumerate() {
            let kind = i.kind.as_str();
            writeln!(out, "{time_s:.4},{kind},{component},{value:e},{normalised:.4},{:.4},{:.4}", i.squared, i.weight)?;
        }
    }
    Ok(())
}

/// `states.csv`: biases, scale errors and the other parameters over time, with their standard deviations.
fn states(out: &mut dyn Write, solution: &Solution, clock: &SurveyClock) -> std::io::Result<()> {
    let names: Vec<String> = solution.layout.names().split_off(9);
    let column = |name: &String| name.replace([' ', ','], "_").replace(['[', ']'], "");
    write!(out, "gps_time_s")?;
    for name in &names {
        write!(out, ",{}", column(name))?;
    }
    for name in &names {
        write!(out, ",sigma_{}", column(name))?;
    }
    writeln!(out)?;
    let offset_s = solution.clock_offset_s();
    let mut next_s = f64::NEG_INFINITY;
    for node in &solution.nodes {
        if node.nominal.nav.time_s < next_s {
            continue;
        }
        next_s = node.nominal.nav.time_s + 1.0;
        write!(out, "{:.3}", second_of_week(clock, node.nominal.nav.time_s - offset_s))?;
        for value in node.nominal.parameter_values(&solution.layout) {
            write!(out, ",{value:e}")?;
        }
        for sigma in &node.parameter_sigma {
            write!(out, ",{sigma:e}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

/// The machine's view.
fn summary(
    project: &Project,
    solution: &Solution,
    inputs: &Inputs,
    smoothed: &Written,
    notes: &[String],
    timing: &[(&str, f64)],
) -> serde_json::Value {
    let mut kinds: BTreeMap<&str, (usize, usize, usize, f64, f64)> = BTreeMap::new();
    for i in &solution.innovations {
        let entry = kinds.entry(i.kind.as_str()).or_default();
        entry.0 += 1;
        entry.1 += usize::from(i.weight > 0.0 && i.weight < 1.0);
        entry.2 += usize::from(i.weight <= 0.0);
        entry.3 += i.squared / i.value.len().max(1) as f64;
        entry.4 += i.normalised[0];
    }
    let innovations: serde_json::Map<String, serde_json::Value> = kinds
        .into_iter()
        .map(|(kind, (count, down_weighted, left_out, nis, mean))| {
            let n = count.max(1) as f64;
            let value = serde_json::json!({
                "count": count, "down_weighted": down_weighted, "left_out": left_out,
                "mean_nis_per_component": nis / n, "mean_normalised": mean / n,
            });
            (kind.to_string(), value)
        })
        .collect();
    let last = solution.nodes.last();
    let states: serde_json::Map<String, serde_json::Value> = last
        .map(|node| {
            let names = solution.layout.names().split_off(9);
            let values = node.nominal.parameter_values(&solution.layout);
            let pairs = values.iter().zip(&node.parameter_sigma);
            names
                .into_iter()
                .zip(pairs)
                .map(|(name, (value, sigma))| (name, serde_json::json!({ "value": value, "sigma": sigma })))
                .collect()
        })
        .unwrap_or_default();
    let mut ties_left_out: BTreeMap<&str, usize> = BTreeMap::new();
    for why in solution.ties.iter().filter_map(|t| t.why_not) {
        *ties_left_out.entry(why).or_default() += 1;
    }
    let ties_used = solution.ties.iter().filter(|t| t.why_not.is_none()).count();
    let attitude_deg = smoothed.attitude_sigma_rad.map(f64::to_degrees);
    let (from_s, to_s) = smoothed.span_s;
    let rejected =
        |kind: MeasurementKind| solution.innovations.iter().filter(|i| i.kind == kind && i.weight <= 0.0).count();
    let stages: serde_json::Map<String, serde_json::Value> =
        timing.iter().map(|(k, v)| ((*k).to_string(), serde_json::json!(v))).collect();
    serde_json::json!({
        "version": env!("CARGO_PKG_VERSION"),
        "name": project.name(),
        "inputs": {
            "imu_samples": inputs.imu.samples().len(), "imu_interval_s": inputs.imu.interval_s(),
            "gnss_fixes": inputs.gnss.len(), "odometer_readings": inputs.odometer.len(),
            "known_points": inputs.points.len(), "ties": inputs.ties.len(),
        },
        "trajectory": {
            "epochs": smoothed.epochs, "from_s": from_s, "to_s": to_s, "runs": solution.runs,
            "last_change_sigma": if solution.change.is_finite() { solution.change } else { -1.0 },
            "sigma_position_ned_m": smoothed.position_sigma_m, "sigma_roll_pitch_heading_deg": attitude_deg,
            "clock_offset_s": solution.clock_offset_s(),
            "rests_s": solution.rests.iter().map(|r| [r.start_s, r.end_s]).collect::<Vec<_>>(),
            "gnss_left_out": rejected(MeasurementKind::Position),
            "ties_used": ties_used, "ties_left_out": ties_left_out,
            "innovations": innovations, "states": states,
        },
        "notes": notes,
        "timing": { "stage": stages },
        "peak_memory_bytes": peak_bytes(),
    })
}
