//! Speed of the smoother: `cargo bench --bench smoother`.
//!
//! An hour of a simulated drive at 200 Hz (720 000 samples), written as text and read back, run forward and backward
//! once; then the same with 10 000 ties: 9 000 increments that span a second and 1 000 loop ties that stay open for about ten
//! minutes. CPU seconds of this thread, the least of five rounds. KF-GINS takes 22 µs an epoch for its filter, 21 states,
//! text reading included, on the same machine (shared notes): the bound is told as a ratio to that.
//! Prints name, value, bound, ratio; exits 1 when one fails.

#![allow(clippy::print_stdout)] // a bench prints its figures

use std::io::Write;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use nalgebra::{Matrix3, Vector3};
use tieline_filter::earth::{ecef_from_geodetic, ned_from_ecef};
use tieline_filter::{FilterTie, ImuGrade, Inputs, NavState, Options, Sighting, Smoother, TieKind};
use tieline_io::measurements::{ImuReadOptions, read_imu};
use tieline_simulate::navigation::{NavigationScenario, NavigationTruth};

/// CPU time of KF-GINS an epoch \[µs\].
const PEER_US: f64 = 22.0;
const ROUNDS: usize = 5;
const DURATION_S: f64 = 3600.0;

fn main() -> Result<()> {
    let noise = ImuGrade::LeadorA15.noise();
    let mut scenario = NavigationScenario::car(noise, DURATION_S, 1);
    scenario.imu.rate_hz = 200.0;
    let simulated = scenario.simulate()?;
    let (inputs, truth) = (simulated.inputs, simulated.truth);
    let file = tempfile::NamedTempFile::new()?;
    {
        let mut out = std::io::BufWriter::new(file.as_file());
        for s in inputs.imu.samples() {
            let (a, v) = (s.angle_rad, s.velocity_mps);
            writeln!(out, "{:.4} {:.12} {:.12} {:.12} {:.12} {:.12} {:.12}", s.time_s, a.x, a.y, a.z, v.x, v.y, v.z)?;
        }
    }
    let mut options = Options::new(noise);
    options.gnss.lever_arm_m = scenario.gnss.lever_arm_m;
    options.gnss.correlated_share = scenario.gnss.correlated_share;
    options.most_runs = 1;
    #[allow(clippy::cast_precision_loss)]
    let epochs = inputs.imu.samples().len() as f64;
    let (mut read_s, mut plain_s, mut tied_s) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
    let tied = Inputs { ties: ties(&truth, scenario.span_s.0), ..inputs.clone() };
    for _ in 0..ROUNDS {
        read_s = read_s.min(seconds(|| {
            read_imu(file.path(), &ImuReadOptions::default())?;
            Ok(())
        })?);
        plain_s = plain_s.min(seconds(|| {
            Smoother::run(&inputs, &options)?;
            Ok(())
        })?);
        tied_s = tied_s.min(seconds(|| {
            let solution = Smoother::run(&tied, &options)?;
            ensure!(solution.ties.iter().filter(|t| t.why_not.is_none()).count() > 5_000, "too few ties in use");
            Ok(())
        })?);
    }
    let used = Smoother::run(&tied, &options)?.ties.iter().filter(|t| t.why_not.is_none()).count();
    let mut failed = 0;
    let mut line = |name: &str, value: f64, unit: &str, bound: f64, ratio: f64| {
        let verdict = if ratio <= bound { "pass" } else { "FAIL" };
        failed += usize::from(ratio > bound);
        println!("{name:<58} {value:>9.2} {unit:<8} ratio {ratio:>6.3}  bound {bound:<5} {verdict}");
    };
    let per_epoch = |s: f64| s / epochs * 1e6;
    println!("{epochs:.0} samples, {} ties of which {used} are used; least of {ROUNDS} rounds", tied.ties.len());
    line("reading text", per_epoch(read_s), "µs/epoch", 1.0, per_epoch(read_s) / PEER_US);
    let both = per_epoch(read_s + plain_s);
    line("reading, forward and backward / KF-GINS' filter", both, "µs/epoch", 1.0, both / PEER_US);
    line("with ties / without (forward and backward)", per_epoch(tied_s), "µs/epoch", 1.5, tied_s / plain_s);
    println!("the same with reading counted in both: {:.3}", (read_s + tied_s) / (read_s + plain_s));
    ensure!(failed == 0, "{failed} lines fail");
    Ok(())
}

/// CPU seconds of a closure: wall time of one thread that does not wait.
fn seconds(work: impl FnOnce() -> Result<()>) -> Result<f64> {
    let start = Instant::now();
    work().context("a round")?;
    Ok(start.elapsed().as_secs_f64())
}

/// Sightings of level planes 3 m below and beside the platform: increments over a second, loop ties over ten minutes.
fn ties(truth: &NavigationTruth, start_s: f64) -> Vec<FilterTie> {
    let nav = |time_s: f64| -> NavState { truth.nav_at(time_s) };
    let sighting = |time_s: f64, hit_ecef_m: &Vector3<f64>, sigma_m: f64| {
        let n = nav(time_s);
        let ned = ned_from_ecef(n.geodetic.x, n.geodetic.y) * (hit_ecef_m - ecef_from_geodetic(&n.geodetic));
        let body_vector_m = n.ned_from_body.inverse_transform_vector(&ned);
        Sighting {
            time_s,
            body_vector_m,
            covariance_m2: Matrix3::identity() * sigma_m.powi(2),
            by_constant: Vec::new(),
        }
    };
    let tie = |id: u64, from_s: f64, to_s: f64, sigma_m: f64| {
        let n = nav(from_s);
        let to_ned = ned_from_ecef(n.geodetic.x, n.geodetic.y);
        let hit = ecef_from_geodetic(&n.geodetic) + to_ned.transpose() * Vector3::new(1.0, 2.0, 3.0);
        FilterTie {
            id,
            kind: TieKind::SurfaceLine,
            directions: vec![to_ned.transpose() * Vector3::z()],
            sightings: vec![sighting(from_s, &hit, sigma_m), sighting(to_s, &hit, sigma_m)],
            known_m: None,
        }
    };
    let (first_s, spread) = (start_s + 60.0, DURATION_S - 800.0);
    let increments = (0..9_000_u32).map(|k| {
        let from_s = first_s + f64::from(k) * spread / 9_000.0 + 0.0137;
        tie(u64::from(k), from_s, from_s + 0.95, 0.002)
    });
    let loops = (0..1_000_u32).map(|k| {
        let from_s = first_s + f64::from(k) * spread / 1_000.0 + 0.0271;
        tie(10_000 + u64::from(k), from_s, from_s + 600.0, 0.01)
    });
    increments.chain(loops).collect()
}
