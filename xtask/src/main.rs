//! Proofs, man pages and completions: `cargo run --release -p xtask -- prove strips`.

#![allow(clippy::print_stdout)] // a program of proofs prints them

mod figures;
mod prove;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(about = "Proofs, man pages and completions of tieline")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Draws the figures of docs/graph.md
    Figures,
    /// Runs every line of a proof; prints name, value, bound, pass or fail; fails if any fails
    Prove {
        /// Which proof
        #[arg(value_parser = ["strips", "filter", "mobile", "graph", "xyz"])]
        what: String,
        /// Only the lines whose name begins with this, or with one of these between commas
        #[arg(long)]
        only: Option<String>,
        /// Seeds of simulated drives (mobile, xyz); ten when left out
        #[arg(long)]
        seeds: Option<u64>,
    },
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().task {
        Task::Figures => figures::draw(),
        Task::Prove { what, only, .. } if what == "filter" => prove::filter(only.as_deref()),
        Task::Prove { what, only, .. } if what == "graph" => prove::graph(only.as_deref()),
        Task::Prove { what, only, seeds } if what == "xyz" => prove::xyz(only.as_deref(), seeds),
        Task::Prove { what, only, seeds } if what == "mobile" => prove::mobile(only.as_deref(), seeds),
        Task::Prove { only, .. } => prove::strips(only.as_deref()),
    }
}
