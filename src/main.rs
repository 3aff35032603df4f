//! The `tieline` program: parses arguments, prints results, turns errors into exit codes.

use std::io::{self, Write};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{CommandFactory, Parser};
use tieline::cli::{Cli, Command};
use tieline::command::{calibrate, convert, difference, graph, info, project, simulate, trajectory};
use tracing_subscriber::filter::LevelFilter;

fn main() -> ExitCode {
    let cli = Cli::parse(); // prints usage and exits with 2 by itself
    let level = match (cli.common.quiet, cli.common.verbose) {
        (true, _) => LevelFilter::ERROR,
        (_, true) => LevelFilter::DEBUG,
        _ => LevelFilter::INFO,
    };
    tracing_subscriber::fmt()
        .with_max_level(level)
        .with_writer(io::stderr)
        .without_time()
        .with_target(false)
        .with_level(false)
        .init();
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(io::stderr(), "tieline: {}", message_of(&error));
            ExitCode::FAILURE
        }
    }
}

/// One readable message: the chain of causes, each said once, and what to do about a full disk.
fn message_of(error: &anyhow::Error) -> String {
    let mut message = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    if kinds_of(error).any(|kind| kind == io::ErrorKind::StorageFull) {
        message.push_str("; free some space, or name a folder on another disk with --out");
    }
    message
}

/// Kinds of the operating system's errors in a chain, whoever met them: a read, a write or the JSON serialiser.
fn kinds_of(error: &anyhow::Error) -> impl Iterator<Item = io::ErrorKind> {
    error.chain().filter_map(|cause| {
        let written = cause.downcast_ref::<io::Error>().map(io::Error::kind);
        written.or_else(|| cause.downcast_ref::<serde_json::Error>().and_then(serde_json::Error::io_error_kind))
    })
}

/// Whether the reader of standard output went away.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    kinds_of(error).any(|kind| kind == io::ErrorKind::BrokenPipe)
}

fn run(cli: &Cli) -> Result<()> {
    if let Some(threads) = cli.common.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("starting threads")?;
    }
    let common = &cli.common;
    let mut out = io::stdout().lock();
    match &cli.command {
        Command::Run { job, overwrite } => project::run(job, *overwrite, common, &mut out),
        Command::Calibrate(args) => calibrate::run(args, common, &mut out),
        Command::Match(job) => project::match_only(job, common, &mut out),
        Command::Solve { job, mask_gnss } => project::solve_only(job, mask_gnss, common, &mut out),
        Command::Report(job) => project::report_only(job, common, &mut out),
        Command::Correct(args) if args.from.is_some() => difference::correct(args, common, &mut out),
        Command::Correct(args) => project::correct(args, common, &mut out),
        Command::Info { files } => info::run(files, common, &mut out),
        Command::Convert(args) => convert::run(args, common, &mut out),
        Command::Trajectory(command) => trajectory::run(command, common, &mut out),
        Command::Simulate { scenario, out: folder, overwrite } => {
            simulate::run(scenario, folder, *overwrite, common, &mut out)
        }
        Command::Graph(args) => graph::run(args, common, &mut out),
        Command::Completions { shell } => {
            let mut script = Vec::new(); // the generator panics where a pipe is closed
            clap_complete::generate(*shell, &mut Cli::command(), "tieline", &mut script);
            Ok(out.write_all(&script)?)
        }
        Command::Man => Ok(clap_mangen::Man::new(Cli::command()).render(&mut out)?),
    }
}
