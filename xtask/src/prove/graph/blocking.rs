//! Line 2: Helmert blocking against the reference, in every way of running it.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use tieline::net::{pose_graph, simulated};
use tieline_graph::Problem;
use tieline_graph::factor::Convention;
use tieline_graph::helmert::out_of_core::Disk;
use tieline_graph::helmert::partition::PartitionOptions;
use tieline_graph::linear::blocks::Normal;
use tieline_graph::robust::Kernel;
use tieline_graph::system::{Method, Order, System};
use tieline_simulate::net::{NetKind, simulate_net};

use super::super::Row;
use super::super::real::program;
use super::{data, graph, number};

/// The linear step of a problem, variable by variable.
fn step(
    problem: &Problem,
    order: Order,
    partition: PartitionOptions,
    method: Method,
    refined: bool,
) -> Result<Vec<f64>> {
    let mut system = System::new(problem, order, partition, method)?;
    let mut normal = Normal::default();
    system.pattern.assemble(problem, &problem.values, &Kernel::None, &mut normal);
    let mut right = normal.right.clone();
    system.solve(problem, &normal.numbers, &mut right)?;
    if refined {
        system.refine(problem, &normal.numbers, &normal.right, &mut right)?;
    }
    let mut plain = Vec::with_capacity(right.len());
    for id in problem.variables().filter(|v| !problem.is_fixed(*v)) {
        let first = system.pattern.scalar[id.index()] as usize;
        plain.extend_from_slice(&right[first..first + problem.values.kind(id).dimension()]);
    }
    Ok(plain)
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    norm(&mut a.iter().zip(b).map(|(x, y)| x - y)) / norm(&mut b.iter().copied())
}

fn threads<R: Send>(count: usize, work: impl FnOnce() -> R + Send) -> Result<R> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(count).build()?.install(work))
}

/// Line 2.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let (net, _) = simulate_net(2500, NetKind::Directions, 3);
    let mut problems = vec![("net of 2,500 stations", simulated::problem(&net))];
    for name in ["M3500", "sphere2500"] {
        let file = tieline_io::pose_graph::read(&data(&format!("{name}.g2o")))?;
        let mut problem = pose_graph::problem(&file, Convention::Plain)?;
        problem.values = tieline_graph::initialise::chordal(&problem)?;
        problems.push((name, problem));
    }
    for (name, problem) in &problems {
        let whole = PartitionOptions::default();
        // both lose digits by the net's condition, so both are refined once
        let reference = step(problem, Order::Places, whole, Method::Cholesky, true)?;
        let plain = step(problem, Order::Places, whole, Method::Cholesky, false)?;
        let own = step(problem, Order::Places, whole, Method::Helmert, false)?;
        println!(
            "{name}: without refinement, Helmert {:.1e} and the reference {:.1e} off the refined reference",
            distance(&own, &reference),
            distance(&plain, &reference)
        );
        let mut worst = 0.0_f64;
        for leaf_nodes in [1, 2, 8, 16, 100, 100_000] {
            let options = PartitionOptions { leaf_nodes, ..whole };
            worst = worst.max(distance(&step(problem, Order::Places, options, Method::Helmert, true)?, &reference));
        }
        for depth in [0, 1, 3] {
            let options = PartitionOptions { depth, leaf_nodes: 1 };
            if depth > 0 || problem.unknown_count() < 8000 {
                worst = worst.max(distance(&step(problem, Order::Places, options, Method::Helmert, true)?, &reference));
            }
        }
        worst = worst.max(distance(&step(problem, Order::MinimumDegree, whole, Method::Helmert, true)?, &reference));
        rows.push(Row::at_most(
            format!("{name}: step off the reference's, relative, any leaf, refined once"),
            worst * 1e10,
            1.0,
            "1e-10",
        ));

        let folder = tempfile::tempdir()?;
        let disk = Disk { folder: folder.path().to_path_buf(), group_bytes: 200_000 };
        let one = threads(1, || step(problem, Order::Places, whole, Method::Helmert, false))??;
        let two = threads(2, || step(problem, Order::Places, whole, Method::Helmert, false))??;
        let on_disk = step(problem, Order::Places, whole, Method::HelmertOnDisk(disk.clone()), false)?;
        // what a killed run leaves: some files whole, one cut off
        std::fs::remove_file(folder.path().join("block-00002.panel"))?;
        let cut = folder.path().join("block-00001.panel");
        let bytes = std::fs::read(&cut)?;
        std::fs::write(&cut, &bytes[..bytes.len() / 2])?;
        let resumed = step(problem, Order::Places, whole, Method::HelmertOnDisk(disk), false)?;
        let differing = |other: &[f64]| one.iter().zip(other).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
        for (label, other) in [("2 threads", &two), ("on disk", &on_disk), ("on disk, resumed", &resumed)] {
            #[allow(clippy::cast_precision_loss)]
            rows.push(Row::at_most(
                format!("{name}: numbers not bit-identical, {label}"),
                differing(other) as f64,
                0.0,
                "",
            ));
        }
    }
    rows.extend(killed()?);
    Ok(rows)
}

/// A run that is killed in the middle and taken up again.
fn killed() -> Result<Vec<Row>> {
    let folder = tempfile::tempdir()?;
    let blocks = folder.path().to_str().context("a path in UTF-8")?;
    let arguments = [
        "generate",
        "--stations",
        "90000",
        "--kind",
        "directions",
        "--solve",
        "--iterations",
        "1",
        "--threads",
        "1",
        "--memory",
        "40",
    ];
    let whole = graph(&arguments)?;
    let with_blocks = [&arguments[..], &["--blocks", blocks]].concat();
    let mut child =
        Command::new(program()?).arg("graph").args(&with_blocks).stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
    let begin = Instant::now();
    while std::fs::read_dir(folder.path())?.count() < 5 && begin.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill()?;
    ensure!(!child.wait()?.success(), "the run was over before it could be killed");
    let again = graph(&with_blocks)?;
    let same = number(&again, "chi2").to_bits() == number(&whole, "chi2").to_bits();
    Ok(vec![
        Row::between(
            "90,000 stations, killed: groups of blocks taken over",
            number(&again, "resumed_blocks"),
            1.0,
            1e6,
            "",
        ),
        Row::at_most("90,000 stations, killed and resumed: chi2 differs", f64::from(u8::from(!same)), 0.0, ""),
    ])
}
