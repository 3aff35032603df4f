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
    /// Adjust pose graphs and geodetic nets
    Graph(GraphArgs),
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

/// `graph …`; `graph FILE…` is short for `graph solve FILE…`.
#[derive(Debug, Clone, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct GraphArgs {
    /// What to do
    #[command(subcommand)]
    pub command: Option<GraphCommand>,
    /// Without a command: solve
    #[command(flatten)]
    pub solve: Option<GraphSolveArgs>,
}

/// Commands on graphs.
#[derive(Debug, Clone, Subcommand)]
pub enum GraphCommand {
    /// Adjust a pose graph (.g2o, TORO .graph) or a net (GNU Gama .gkf; `DynAdjust` .stn and .msr)
    Solve(GraphSolveArgs),
    /// Make a net of any size, with noise
    Generate(GraphGenerateArgs),
}

/// `graph solve`.
#[derive(Debug, Clone, Args)]
pub struct GraphSolveArgs {
    /// Pose graph or net; `DynAdjust` takes its .stn and .msr
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// How the normal equations are solved
    #[arg(long, value_enum, default_value = "helmert")]
    pub method: GraphMethod,
    /// What a section counts as between its junctions (bowie; schur when left out)
    #[arg(long, value_enum)]
    pub sections: Option<GraphSections>,
    /// Error of relations of poses
    #[arg(long, value_enum, default_value = "plain")]
    pub convention: GraphConvention,
    /// Kernel of loop edges and ties: none, huber[:K], cauchy[:C], dcs[:PHI], switch[:PHI], gnc[:C]; or snooping[:LIMIT]
    #[arg(long, default_value = "none", value_name = "KERNEL")]
    pub robust: String,
    /// First values of poses
    #[arg(long, value_enum, default_value = "auto")]
    pub initial: GraphInitial,
    /// First values from the vertices of another file
    #[arg(long, value_name = "FILE")]
    pub start: Option<PathBuf>,
    /// Standard deviations of all unknowns
    #[arg(long)]
    pub sigmas: bool,
    /// Most iterations
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub iterations: usize,
    /// Most nodes of a block that is not cut further
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub leaf: usize,
    /// Memory for the factorisation, in MiB; what is larger goes to disk (helmert)
    #[arg(long, value_name = "MIB")]
    pub memory: Option<u64>,
    /// Folder for block files; a run that was killed is taken up from there [default: one in --out or the system's]
    #[arg(long, value_name = "DIR")]
    pub blocks: Option<PathBuf>,
    /// Output folder: solved graph or coordinates, sigmas, plots
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// `graph generate`.
#[derive(Debug, Clone, Args)]
pub struct GraphGenerateArgs {
    /// Stations; the next square number is taken
    #[arg(long, value_name = "N")]
    pub stations: usize,
    /// What is measured
    #[arg(long, value_enum)]
    pub kind: GraphKind,
    /// Seed of the noise
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Adjust the net as well, with --method and the rest of `solve` at their defaults
    #[arg(long)]
    pub solve: bool,
    /// How the normal equations are solved
    #[arg(long, value_enum, default_value = "helmert")]
    pub method: GraphMethod,
    /// Standard deviations of all unknowns
    #[arg(long)]
    pub sigmas: bool,
    /// Most iterations
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub iterations: usize,
    /// Most nodes of a block that is not cut further
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub leaf: usize,
    /// Memory for the factorisation, in MiB; what is larger goes to disk (helmert)
    #[arg(long, value_name = "MIB")]
    pub memory: Option<u64>,
    /// Folder for block files
    #[arg(long, value_name = "DIR")]
    pub blocks: Option<PathBuf>,
    /// Output folder for the net as `DynAdjust` (baselines) or GNU Gama (directions) files
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// How the normal equations are solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GraphMethod {
    /// A library's sparse Cholesky on the same order, as reference
    Cholesky,
    /// Helmert blocking
    Helmert,
    /// Bowie's junctions and sections
    Bowie,
}

/// What a section counts as between its junctions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GraphSections {
    /// Its Schur complement: exact where no line is left out, iterated elsewhere
    Schur,
    /// Bowie's own: a weight by its length, every coordinate adjusted for itself
    Length,
}

/// Error of relations of poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GraphConvention {
    /// Translation of what is left; wrapped angle or rotation vector
    Plain,
    /// Logarithm of the rigid motion
    Log,
    /// Vector part of the quaternion
    G2o,
}

/// First values of poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GraphInitial {
    /// Those of the file or the chordal ones, whichever fits better
    Auto,
    /// Those of the file
    File,
    /// Chordal rotations, linear translations
    Chordal,
    /// One piece of the trajectory after the other
    Incremental,
}

/// What is measured in a generated net.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GraphKind {
    /// Direction sets and some distances, in the plane
    Directions,
    /// GNSS baselines
    Baselines,
}
