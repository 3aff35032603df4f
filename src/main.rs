//! The `tieline` program: parses arguments, prints results, turns errors into exit codes.

use std::io::{self, Write};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{CommandFactory, Parser};
use tieline::cli::{Cli, Command};
use tieline::command::{convert, difference, info, project, simulate, trajectory};
use tracing_subscriber::filter::LevelFilter;

fn main() -> ExitCode {
    let cli = Cli::parse(); // prints usage and exits with 2 by itself
    let level = if cli.common.quiet { LevelFilter::ERROR } else { LevelFilter::INFO };
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
            // one readable message: the chain of causes, without a backtrace
            let _ = writeln!(io::stderr(), "tieline: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| cause.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe))
}

fn run(cli: &Cli) -> Result<()> {
    if let Some(threads) = cli.common.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("starting threads")?;
    }
    let common = &cli.common;
    let mut out = io::stdout().lock();
    match &cli.command {
        Command::Run { job, overwrite } => project::run(job, *overwrite, common, &mut out),
        Command::Match(job) => project::match_only(job, common, &mut out),
        Command::Solve(job) => project::solve_only(job, common, &mut out),
        Command::Report(job) => project::report_only(job, common, &mut out),
        Command::Correct(args) if args.from.is_some() => difference::correct(args, common, &mut out),
        Command::Correct(args) => project::correct(args, common, &mut out),
        Command::Info { files } => info::run(files, common, &mut out),
        Command::Convert(args) => convert::run(args, common, &mut out),
        Command::Trajectory(command) => trajectory::run(command, common, &mut out),
        Command::Simulate { scenario, out: folder } => simulate::run(scenario, folder, common, &mut out),
        Command::Completions { shell } => {
            clap_complete::generate(*shell, &mut Cli::command(), "tieline", &mut out);
            Ok(())
        }
        Command::Man => Ok(clap_mangen::Man::new(Cli::command()).render(&mut out)?),
    }
}
