//! Speed of the registration of two strips: `cargo bench --bench registration`.
//!
//! Two simulated strips over a village, registered whole on one thread. Lower bound in the same run: what any method that pairs points has
//! to do at the least, a k-d tree (kiddo) of each cloud and one search of the nearest neighbour of every moving point. Such methods search
//! ten times and more and take normals before: GICP of `small_gicp`, where its Python package is installed, stands beside it as the peer
//! (on real strips: `xtask prove xyz --only 4`). CPU seconds, the least of five rounds in turn. Prints name, value, bound, ratio; exits 1
//! when one fails.

#![allow(clippy::print_stdout)] // a bench prints its figures

use std::num::NonZero;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Vector3;
use tieline_io::las::{Columns, LasFile};
use tieline_matching::xyz::{Cloud, Registration, SubmapOptions, register};
use tieline_simulate::{Scenario, simulate};

const ROUNDS: usize = 5;

/// Points of a strip about its first one, and their times.
#[derive(Default)]
struct Strip {
    points_m: Vec<Vector3<f64>>,
    time_s: Vec<f64>,
}

impl Strip {
    fn read(path: &Path, zero_m: &mut Option<[f64; 3]>) -> Result<Self> {
        let file = LasFile::open(path)?;
        let (scale, offset) = (file.header().scale, file.header().offset);
        let (mut records, mut columns, mut strip) = (Vec::new(), Columns::default(), Self::default());
        for chunk in 0..file.chunk_count() {
            file.read_columns(chunk, &mut records, &mut columns)?;
            for k in 0..columns.len() {
                let raw = [columns.x[k], columns.y[k], columns.z[k]];
                let place_m: [f64; 3] = std::array::from_fn(|i| f64::from(raw[i]) * scale[i] + offset[i]);
                let zero_m = zero_m.get_or_insert(place_m);
                strip.points_m.push(Vector3::from_fn(|i, _| place_m[i] - zero_m[i]));
                strip.time_s.push(columns.gps_time[k]);
            }
        }
        Ok(strip)
    }
    fn cloud(&self) -> Cloud<'_> {
        Cloud { points_m: &self.points_m, time_s: &self.time_s }
    }
    fn tree(&self) -> Result<ImmutableKdTree<f64, 3>> {
        let places: Vec<[f64; 3]> = self.points_m.iter().map(|p| (*p).into()).collect();
        ImmutableKdTree::new_from_slice(&places).ok().context("a tree")
    }
}

/// Trees of both clouds and the mean distance of a moving point from its neighbour \[m\].
#[allow(clippy::cast_precision_loss)]
fn paired_once(fixed: &Strip, moving: &Strip) -> Result<f64> {
    let (tree, _) = (fixed.tree()?, moving.tree()?);
    let to_next_m = |p: &Vector3<f64>| {
        let place_m = [p.x, p.y, p.z];
        let next = tree.query(&place_m).nearest_n::<SquaredEuclidean<f64>>(NonZero::<usize>::MIN);
        next.execute().iter().map(|n| n.distance.sqrt()).sum::<f64>()
    };
    Ok(moving.points_m.iter().map(to_next_m).sum::<f64>() / moving.points_m.len() as f64)
}

fn main() -> Result<()> {
    // wall time of one thread that does not wait is CPU time
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let folder = tempfile::tempdir()?;
    let mut scenario = Scenario::airborne_sample();
    scenario.world.buildings = 50;
    scenario.scanners[0].pulse_rate_hz = 200_000.0;
    scenario.scanners[0].line_rate_hz = 150.0;
    simulate(&scenario, folder.path())?;
    let mut zero_m = None;
    let mut strip =
        |number: u32| Strip::read(&folder.path().join(format!("strips/strip_{number:02}.laz")), &mut zero_m);
    let (fixed, moving) = (strip(1)?, strip(2)?);
    let (mut least_s, mut paired_s) = (f64::INFINITY, f64::INFINITY);
    let mut found: Option<Registration> = None;
    for _ in 0..ROUNDS {
        let begin = Instant::now();
        found = Some(register(&fixed.cloud(), &moving.cloud(), &SubmapOptions::default())?);
        least_s = least_s.min(begin.elapsed().as_secs_f64());
        let begin = Instant::now();
        let apart_m = paired_once(&fixed, &moving)?;
        paired_s = paired_s.min(begin.elapsed().as_secs_f64());
        ensure!(apart_m.is_finite(), "no neighbours");
    }
    let found = found.context("a registration")?;
    ensure!(found.converged && found.held.rank() == 3, "not registered: rank {}", found.held.rank());
    println!(
        "{} and {} points, {} rounds, {} facets, shift {:.0} {:.0} {:.0} mm; least of {ROUNDS} rounds",
        fixed.points_m.len(),
        moving.points_m.len(),
        found.rounds,
        found.used.iter().filter(|u| **u).count(),
        found.shift_m.x * 1e3,
        found.shift_m.y * 1e3,
        found.shift_m.z * 1e3
    );
    println!("two k-d trees, each point paired once {paired_s:>8.2} s");
    let mut failed = 0;
    let mut line = |of: &str, ratio: f64, bound: f64| {
        let verdict = if ratio <= bound { "pass" } else { "FAIL" };
        failed += usize::from(ratio > bound);
        println!("registration {least_s:>8.2} s   over {of}: ratio {ratio:>6.3}  bound {bound:<4} {verdict}");
    };
    line("trees and one pairing", least_s / paired_s, 3.0);
    match peer_s(folder.path(), &fixed, &moving)? {
        Some(peer_s) => line(&format!("small_gicp's GICP, {peer_s:.2} s"), least_s / peer_s, 0.75),
        None => println!("small_gicp is not on this machine"),
    }
    ensure!(failed == 0, "{failed} lines fail");
    Ok(())
}

/// CPU seconds of the peer, if it is at hand.
fn peer_s(folder: &Path, fixed: &Strip, moving: &Strip) -> Result<Option<f64>> {
    let mut command = Command::new("python3");
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("xtask/peers/small_gicp.py"));
    for (name, strip) in [("fixed.f64", fixed), ("moving.f64", moving)] {
        let bytes: Vec<u8> = strip.points_m.iter().flat_map(|p| p.iter().flat_map(|v| v.to_le_bytes())).collect();
        std::fs::write(folder.join(name), bytes)?;
        command.arg(folder.join(name));
    }
    let Ok(output) = command.output() else { return Ok(None) };
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    Ok(text.split_whitespace().next().and_then(|word| word.parse().ok()).filter(|_| output.status.success()))
}
