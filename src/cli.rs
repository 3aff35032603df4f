//! The command line. One definition feeds `--help`, the man page and the completions.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::stage::navigate::Mask;

/// Laser-scanning strip adjustment: finds ties, solves for errors with honest sigmas, corrects the strips
#[derive(Debug, Parser)]
#[command(name = "tieline", version, max_term_width = 110, arg_required_else_help = true)]
pub struct Cli {
    /// What is common to all commands
    #[command(flatten)]
    pub common: Common,
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

/// What is common to all commands.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Threads; all cores when left out. Results never depend on it
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<usize>,
    /// Print the result as JSON on standard output
    #[arg(long, global = true)]
    pub json: bool,
    /// Say nothing but errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Say more: settings with their reasons, models tried
    #[arg(short, long, global = true)]
    pub verbose: bool,
}

/// Where a job writes, and with how much memory.
#[derive(Debug, Clone, Args)]
pub struct JobArgs {
    /// Project file
    #[arg(value_name = "PROJECT.toml")]
    pub project: PathBuf,
    /// Output folder [default: out/<name of the project file>]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Memory for patches, in MiB
    #[arg(long, value_name = "MIB", default_value_t = 256)]
    pub memory: u64,
    /// Write ties.csv beside ties.parquet
    #[arg(long)]
    pub csv: bool,
}

/// `calibrate`.
#[derive(Debug, Clone, Args)]
pub struct CalibrateArgs {
    /// Project files
    #[arg(required = true, value_name = "PROJECT.toml")]
    pub projects: Vec<PathBuf>,
    /// Output folder [default: out/<name of the project file>]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write ties.csv beside ties.parquet
    #[arg(long)]
    pub csv: bool,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// The whole way: match, solve, correct, report
    Run {
        /// The job
        #[command(flatten)]
        job: JobArgs,
        /// Write into a folder that is not empty
        #[arg(long)]
        overwrite: bool,
    },
    /// Calibrate how scanners are mounted, from stations without a trajectory
    Calibrate(CalibrateArgs),
    /// Find the ties
    Match(JobArgs),
    /// Solve for the errors of strips (needs `match`); with [imu] in the project: estimate the trajectory
    Solve {
        /// The job
        #[command(flatten)]
        job: JobArgs,
        /// Leave GNSS out of windows: fixes after T0 and not after T0 + LEN [GPS seconds of week], comma separated
        #[arg(long, value_name = "T0:LEN", value_delimiter = ',')]
        mask_gnss: Vec<Mask>,
    },
    /// Write corrected strips; needs `solve`. With --from and --to: apply the difference of two trajectories
    Correct(CorrectArgs),
    /// Write the report anew; needs `solve`
    Report(JobArgs),
    /// What is in a file: strips, trajectory, ties, correction
    Info {
        /// Files
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Convert between trajectory formats, or between tie formats
    Convert(ConvertArgs),
    /// Compare or interpolate trajectories
    #[command(subcommand)]
    Trajectory(TrajectoryCommand),
    /// Simulate a survey with known errors
    Simulate {
        /// Scenario
        #[arg(value_name = "SCENARIO.toml")]
        scenario: PathBuf,
        /// Output folder
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// Write into a folder that is not empty
        #[arg(long)]
        overwrite: bool,
    },
    /// Print completions for a shell
    Completions {
        /// Shell
        shell: clap_complete::Shell,
    },
    /// Print the man page
    Man,
}

/// `correct`: of a project, or by two trajectories.
#[derive(Debug, Clone, Args)]
pub struct CorrectArgs {
    /// Project file; or, with --from and --to, the strips to correct
    #[arg(required = true, value_name = "PROJECT.toml | STRIPS")]
    pub inputs: Vec<PathBuf>,
    /// Output folder [default: out/<name of the project file>, or out/corrected]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Take the corrections off instead: give the corrected strips as STRIPS after the project file
    #[arg(long, conflicts_with_all = ["from", "to"])]
    pub inverse: bool,
    /// Trajectory that the strips were made with
    #[arg(long, requires = "to", value_name = "OLD")]
    pub from: Option<PathBuf>,
    /// Trajectory to correct to, or a correction.csv
    #[arg(long, requires = "from", value_name = "NEW")]
    pub to: Option<PathBuf>,
    /// Reference system of the strips, when their headers do not name it
    #[arg(long, value_name = "CRS")]
    pub crs: Option<String>,
    /// GPS week of times that are seconds of week
    #[arg(long, value_name = "WEEK")]
    pub week: Option<u32>,
    /// Columns of text trajectories, comma separated
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub columns: Option<Vec<String>>,
    /// With --from and --to: replace files of the output folder
    #[arg(long)]
    pub overwrite: bool,
}

/// `convert`.
#[derive(Debug, Clone, Args)]
pub struct ConvertArgs {
    /// Input
    pub input: PathBuf,
    /// Output; its extension names the format (.sbet/.out, .trj, .csv, .parquet). An SBET of a trajectory with
    /// sigmas gets its SMRMSG file beside it
    pub output: PathBuf,
    /// Reference system of map coordinates, in or out
    #[arg(long, value_name = "CRS")]
    pub crs: Option<String>,
    /// Columns of a text trajectory, comma separated
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub columns: Option<Vec<String>>,
    /// SMRMSG file of the input
    #[arg(long, value_name = "FILE")]
    pub accuracy: Option<PathBuf>,
    /// GPS week of times that are seconds of week
    #[arg(long, value_name = "WEEK")]
    pub week: Option<u32>,
    /// Format of the output, when the extension does not tell
    #[arg(long, value_enum)]
    pub to: Option<OutputFormat>,
}

/// Formats that can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OutputFormat {
    /// Applanix SBET
    Sbet,
    /// `TerraScan` trajectory
    Trj,
    /// Text
    Csv,
    /// Parquet (ties)
    Parquet,
}

/// `trajectory …`
#[derive(Debug, Subcommand)]
pub enum TrajectoryCommand {
    /// Difference B - A of two trajectories: statistics, CSV, plot
    Diff {
        /// Reference
        #[arg(value_name = "A")]
        a: PathBuf,
        /// Compared
        #[arg(value_name = "B")]
        b: PathBuf,
        /// Folder for difference.csv and difference.svg
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        /// Reference system of map coordinates, when one of them has these and the other has not
        #[arg(long, value_name = "CRS")]
        crs: Option<String>,
        /// Columns of text trajectories, comma separated
        #[arg(long, value_name = "NAMES", value_delimiter = ',')]
        columns: Option<Vec<String>>,
    },
    /// Poses with sigma at the times of a CSV
    At {
        /// Trajectory
        #[arg(value_name = "TRAJECTORY")]
        trajectory: PathBuf,
        /// One time a line, in the first column, in the trajectory's own time system [s]
        #[arg(value_name = "TIMES.csv")]
        times: PathBuf,
        /// SMRMSG file of the trajectory
        #[arg(long, value_name = "FILE")]
        accuracy: Option<PathBuf>,
        /// Columns of a text trajectory, comma separated
        #[arg(long, value_name = "NAMES", value_delimiter = ',')]
        columns: Option<Vec<String>>,
        /// Write here instead of standard output
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
}
