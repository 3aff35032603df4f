//! Line 4: registration of scan pairs, beside `small_gicp`'s GICP in the same run.

use std::path::Path;
use std::process::Command;

use anyhow::{Result, ensure};
use nalgebra::{DVector, Vector3};
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};
use tieline::cpu::of_living_threads_s as cpu_s;
use tieline_matching::xyz::{Registration, SubmapOptions, register};

use super::clouds::{Points, flight_lines};
use crate::prove::Row;
use crate::prove::graph::median;
use crate::prove::real::root;

/// CPU seconds of `small_gicp`'s GICP on the pair, of an earlier run on this kind of machine, where it is not installed.
const PEER_CPU_S: f64 = 1.2;
/// The known shift of one half of a strip \[m\].
const SHIFT_M: Vector3<f64> = Vector3::new(0.3, -0.4, 0.2);

/// CPU seconds and shift \[m\] by the peer, where its Python package is at hand.
fn peer(folder: &Path, fixed: &Points, moving: &Points) -> Result<Option<(f64, Vector3<f64>)>> {
    let mut command = Command::new("python3");
    command.arg(root().join("xtask/peers/small_gicp.py"));
    for (name, points) in [("fixed.f64", fixed), ("moving.f64", moving)] {
        let bytes: Vec<u8> =
            points.points_m.iter().flat_map(|p| p.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()).collect();
        std::fs::write(folder.join(name), bytes)?;
        command.arg(folder.join(name));
    }
    let Ok(output) = command.output() else { return Ok(None) };
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let numbers: Vec<f64> = text.split_whitespace().filter_map(|n| n.parse().ok()).collect();
    Ok(match numbers[..] {
        [cpu, x, y, z] if output.status.success() => Some((cpu, Vector3::new(x, y, z))),
        _ => None,
    })
}

fn told(found: Option<&(f64, Vector3<f64>)>, tell: impl Fn(&(f64, Vector3<f64>)) -> String) -> String {
    found.map_or_else(|| "not on this machine".to_string(), tell)
}

fn ours(fixed: &Points, moving: &Points) -> Result<Registration> {
    let found = register(&fixed.cloud(), &moving.cloud(), &SubmapOptions::default())?;
    ensure!(found.converged, "no rest after {} rounds", found.rounds);
    Ok(found)
}

fn mm(shift_m: &Vector3<f64>) -> String {
    format!("{:.1} {:.1} {:.1} mm", shift_m.x * 1e3, shift_m.y * 1e3, shift_m.z * 1e3)
}

/// Line 4.
pub(crate) fn registration() -> Result<Vec<Row>> {
    let folder = tempfile::tempdir()?;
    let [first, second] = flight_lines()?;
    let mut rows = speed(folder.path(), &first, &second)?;
    rows.extend(split(folder.path(), &first)?);
    rows.extend(halves(folder.path(), &first, &second)?);
    Ok(rows)
}

/// CPU on the whole pair: medians of five of ours, three of the peer's.
fn speed(folder: &Path, first: &Points, second: &Points) -> Result<Vec<Row>> {
    let mut seconds = Vec::new();
    for _ in 0..5 {
        let begin = cpu_s();
        ours(first, second)?;
        seconds.push(cpu_s() - begin);
    }
    let mut of_peer = Vec::new();
    for _ in 0..3 {
        of_peer.extend(peer(folder, first, second)?.map(|(cpu, _)| cpu));
    }
    let peer_s = if of_peer.is_empty() { None } else { Some(median(of_peer)) };
    let word = peer_s.map_or_else(|| "not on this machine: 1.2 s".to_string(), |s| format!("{s:.2} s in this run"));
    let bound_s = 0.5 * peer_s.unwrap_or(PEER_CPU_S);
    let name = format!("706 on 707: CPU (small_gicp GICP: {word})");
    Ok(vec![Row::at_most(name, median(seconds), bound_s, "s")])
}

/// Flight line 706 split in two, one half shifted: in blocks of 300 points by turns, as the peer was measured, and pulse by pulse, where the
/// returns of a pulse stay together as in two flights; and point by point, where they do not.
fn split(folder: &Path, line: &Points) -> Result<Vec<Row>> {
    type Half<'a> = &'a dyn Fn(usize, usize) -> usize;
    let splits: [(&str, Half<'_>); 3] = [
        ("blocks of 300 points", &|point, _| point / 300 % 2),
        ("odd and even pulses", &|_, pulse| pulse % 2),
        ("odd and even points", &|point, _| point % 2),
    ];
    let mut rows = Vec::new();
    for (what, half) in splits {
        let [fixed, moving] = [0, 1].map(|wanted| line.only(|point, _, pulse| half(point, pulse) == wanted));
        let moving = moving.shifted(&-SHIFT_M);
        let found = ours(&fixed, &moving)?;
        let error_m = found.shift_m - SHIFT_M;
        let covariance_m2 = found.held.covariance_m2();
        let of_peer = peer(folder, &fixed, &moving)?;
        println!(
            "706 by {what}: rank {}, error {}, sigma {} (small_gicp: {})",
            found.held.rank(),
            mm(&error_m),
            mm(&Vector3::from_fn(|k, _| covariance_m2[(k, k)].sqrt())),
            told(of_peer.as_ref(), |(_, shift)| mm(&(shift - SHIFT_M)))
        );
        let name = format!("706 by {what}: error, largest component");
        rows.push(Row::at_most(name, error_m.amax() * 1e3, 1.0, "mm"));
        let square = found.held.normalised_square(&DVector::from_column_slice(error_m.as_slice()));
        rows.push(Row::at_most(format!("706 by {what}: eᵀΣ⁻¹e, 99 % of χ²₃"), square, 11.34, ""));
    }
    rows.extend(by_chance(folder, line)?);
    Ok(rows)
}

/// The same, its points dealt into halves by chance again and again: what one split comes to by luck, and whether sigmas hold.
#[allow(clippy::cast_precision_loss)]
fn by_chance(folder: &Path, line: &Points) -> Result<Vec<Row>> {
    const DEALS: u64 = 24;
    const OF_PEER: u64 = 6;
    let (mut squares_m2, mut of_peer_m2, mut normalised) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    let (mut within, mut by_peer) = (0, 0_u32);
    for deal in 0..DEALS {
        let mut chance = SmallRng::seed_from_u64(deal);
        let side: Vec<bool> = (0..line.points_m.len()).map(|_| chance.random()).collect();
        let [fixed, moving] = [false, true].map(|wanted| line.only(|point, _, _| side[point] == wanted));
        let moving = moving.shifted(&-SHIFT_M);
        let found = ours(&fixed, &moving)?;
        let error_m = found.shift_m - SHIFT_M;
        squares_m2 += error_m.component_mul(&error_m);
        within += u32::from(error_m.amax() <= 1e-3);
        normalised += found.held.normalised_square(&DVector::from_column_slice(error_m.as_slice()));
        if deal < OF_PEER
            && let Some((_, shift_m)) = peer(folder, &fixed, &moving)?
        {
            by_peer += 1;
            of_peer_m2 += (shift_m - SHIFT_M).component_mul(&(shift_m - SHIFT_M));
        }
    }
    let rms_mm = (squares_m2 / DEALS as f64).map(|v| v.sqrt() * 1e3);
    let of_peer_mm = (of_peer_m2 / f64::from(by_peer.max(1))).map(|v| v.sqrt() * 1e3);
    println!(
        "706 by chance, {DEALS} times: rms {:.1?} mm, {within} within 1 mm in every component (small_gicp, {by_peer} times: rms {:.1?} mm)",
        rms_mm.as_slice(),
        of_peer_mm.as_slice()
    );
    // 3 ± three sigmas of a mean of 24
    let mean = normalised / DEALS as f64;
    Ok(vec![Row::between("706 by chance: mean of eᵀΣ⁻¹e, three sigmas about 3", mean, 1.5, 4.5, "")])
}

/// The real pair in two halves, each registered alone: cut across the flight (west, east: the lines run along x), and along it (south, north).
fn halves(folder: &Path, first: &Points, second: &Points) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (axis, middle_m, words) in [(0, 75.0, ["west", "east"]), (1, 50.0, ["south", "north"])] {
        let (mut found, mut of_peer) = (Vec::new(), Vec::new());
        for low in [true, false] {
            let half = |points: &Points| points.only(|_, p, _| (p[axis] < middle_m) == low);
            let (fixed, moving) = (half(first), half(second));
            found.push(ours(&fixed, &moving)?);
            of_peer.extend(peer(folder, &fixed, &moving)?);
        }
        for (word, half) in words.iter().zip(&found) {
            println!("706 on 707, {word}: rank {}, shift {}", half.held.rank(), mm(&half.shift_m));
        }
        let peers_plan_m = match of_peer[..] {
            [(_, a), (_, b)] => Some((0.0, a - b)),
            _ => None,
        };
        let word = told(peers_plan_m.as_ref(), |(_, d)| format!("{:.0} mm", d.xy().amax() * 1e3));
        // a half that does not hold a direction says nothing about it: compared is what both hold
        let (weaker, other) = if found[0].held.rank() <= found[1].held.rank() { (0, 1) } else { (1, 0) };
        let held = &found[weaker].held;
        let difference_m = found[weaker].shift_m - found[other].shift_m;
        let along = held.directions.transpose() * DVector::from_column_slice(difference_m.as_slice());
        let shared = &held.directions * along;
        let rank = held.rank();
        let name = format!("{} against {}, rank {rank}: plan (small_gicp: {word})", words[0], words[1]);
        rows.push(Row::at_most(name, shared[0].abs().max(shared[1].abs()) * 1e3, 15.0, "mm"));
    }
    Ok(rows)
}
