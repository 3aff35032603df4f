//! `convert IN OUT`: between trajectory formats, or between tie formats.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use tieline_filter::{PositionFrame, SurveyClock};
use tieline_io::crs::Crs;
use tieline_io::ties::{TieTable, read_ties, write_csv as write_ties_csv, write_parquet};
use tieline_io::trajectory::{write_csv, write_sbet, write_smrmsg, write_trj};

use crate::cli::{Common, ConvertArgs, OutputFormat};
use crate::command::info::kind::{FileKind, kind_of};
use crate::navigation::{clock_of, in_geodetic, in_map, on_clock, read_trajectory};

/// Where a reference system is named.
const CRS_REMEDY: &str = "name the reference system of the map with --crs";

/// Converts a file.
///
/// # Errors
/// When the input is neither a trajectory nor ties, the output format does not fit it, or the disk refuses.
pub fn run(args: &ConvertArgs, common: &Common, out: &mut impl Write) -> Result<()> {
    let kind = kind_of(&args.input)?;
    let format = match args.to {
        Some(format) => format,
        None => format_of(&args.output)?,
    };
    if same_file(&args.input, &args.output) {
        bail!("{} is the input: name another file for the output", args.output.display());
    }
    let written = match kind {
        FileKind::TiesParquet | FileKind::TiesCsv => ties(args, format)?,
        FileKind::Trajectory => trajectory(args, format)?,
        other => bail!("{} is {}: only trajectories and ties are converted", args.input.display(), other.name()),
    };
    if common.json {
        writeln!(out, "{:#}", serde_json::json!({ "input": args.input, "written": written }))?;
    } else if !common.quiet {
        for path in written {
            writeln!(out, "{}", path.display())?;
        }
    }
    Ok(())
}

fn same_file(a: &Path, b: &Path) -> bool {
    std::fs::canonicalize(a).ok().zip(std::fs::canonicalize(b).ok()).is_some_and(|(a, b)| a == b)
}

fn format_of(path: &Path) -> Result<OutputFormat> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    Ok(match extension.as_str() {
        "sbet" | "out" => OutputFormat::Sbet,
        "trj" => OutputFormat::Trj,
        "csv" | "txt" => OutputFormat::Csv,
        "parquet" => OutputFormat::Parquet,
        _ => bail!(
            "{}: its extension names no format (.sbet, .out, .trj, .csv, .parquet do); say which with --to",
            path.display()
        ),
    })
}

fn ties(args: &ConvertArgs, format: OutputFormat) -> Result<Vec<PathBuf>> {
    let table: TieTable = read_ties(&args.input)?;
    match format {
        OutputFormat::Csv => write_ties_csv(&args.output, &table)?,
        OutputFormat::Parquet => write_parquet(&args.output, &table)?,
        OutputFormat::Sbet | OutputFormat::Trj => {
            bail!("{} holds ties: they are written as .csv or .parquet", args.input.display())
        }
    }
    Ok(vec![args.output.clone()])
}

fn trajectory(args: &ConvertArgs, format: OutputFormat) -> Result<Vec<PathBuf>> {
    let file = read_trajectory(&args.input, args.columns.as_deref(), args.accuracy.as_deref())?;
    for note in &file.notes {
        tracing::info!("{note}");
    }
    let crs = args.crs.as_deref().map(|text| Crs::parse(text).with_context(|| format!("--crs {text}"))).transpose()?;
    let mut clock = clock_of(&[&file]);
    if let Some(week) = args.week {
        clock = SurveyClock { reference_week: Some(week) };
    }
    let (input, output) = (args.input.as_path(), args.output.as_path());
    let on_survey_clock = |t| on_clock(t, &file, input, file.time_encoding, &clock, "name it with --week");
    match format {
        OutputFormat::Parquet => bail!("{} is a trajectory: it is written as .sbet, .trj or .csv", input.display()),
        OutputFormat::Trj => {
            // TerraScan keeps the times of the strips: those of the input
            if file.trajectory.frame() == PositionFrame::Geodetic && crs.is_none() {
                bail!("{}: latitude and longitude become map coordinates in a .trj; {CRS_REMEDY}", input.display());
            }
            let trajectory = in_map(&file, input, crs.as_ref(), CRS_REMEDY)?;
            write_trj(output, &trajectory)?;
        }
        OutputFormat::Csv => {
            let geodetic = in_geodetic(&file, input, crs.as_ref(), CRS_REMEDY)?;
            write_csv(output, &on_survey_clock(geodetic)?, &clock)?;
        }
        OutputFormat::Sbet => {
            let geodetic = on_survey_clock(in_geodetic(&file, input, crs.as_ref(), CRS_REMEDY)?)?;
            write_sbet(output, &geodetic)?;
            if !geodetic.sigma().is_empty() {
                let rms = rms_path(output);
                write_smrmsg(&rms, &geodetic)?;
                return Ok(vec![output.to_path_buf(), rms]);
            }
        }
    }
    Ok(vec![output.to_path_buf()])
}

/// `trajectory_rms.out` beside `trajectory.sbet`.
fn rms_path(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}_rms.out"))
}
