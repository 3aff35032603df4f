//! Line 10: a survey vehicle with a drifting gyro and a misaligned sensor, over many seeds.

#![allow(clippy::cast_precision_loss)] // counts are small

use anyhow::{Context, Result};
use nalgebra::{DVector, Matrix3, Vector3};
use tieline::cpu::of_living_threads_s as cpu_s;
use tieline::net::survey_vehicle::{
    LinkUse, VehicleGraph, VehicleModel, explicit_map, implicit_map, pinch, submap_links,
};
use tieline_graph::covariance::{Covariances, covariances};
use tieline_graph::linear::blocks::Normal;
use tieline_graph::nonlinear::{SolveOptions, solve, solve_system};
use tieline_graph::robust::Kernel;
use tieline_graph::system::System;
use tieline_graph::undetermined::{component_name, undetermined};
use tieline_graph::{Values, VariableId};
use tieline_simulate::survey_vehicle::{Route, VehicleTruth, simulate_vehicle};

use super::super::Row;
use super::median;

const SEEDS: u64 = 50;
/// A pose across the second block, where the first lap is farthest from what is held.
const FAR: usize = 180;
/// Quantile of the normal distribution that leaves 0.1 % outside, on both sides.
const Z: f64 = 3.290_527;

/// Bounds of a mean of squares over `count` degrees of freedom, 99.9 % (chi² by Wilson and Hilferty 1931).
fn bounds(count: f64) -> [f64; 2] {
    let w = 2.0 / (9.0 * count);
    [-Z, Z].map(|z| (1.0 - w + z * w.sqrt()).powi(3))
}

/// Sums of normalised squares and their degrees of freedom.
#[derive(Debug, Clone, Copy, Default)]
struct Squares {
    sum: f64,
    count: f64,
}

impl Squares {
    fn add(&mut self, square: Option<f64>, count: usize) {
        if let Some(square) = square {
            self.sum += square;
            self.count += count as f64;
        }
    }
    fn mean(self) -> f64 {
        self.sum / self.count
    }
}

/// What one way of adjusting came to, over all seeds.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    square_m2: f64,
    unknowns: usize,
    cpu_s: f64,
    chi2: Squares,
    far: Squares,
    last: Squares,
    mount: Squares,
    rate: Squares,
    all: Squares,
}

/// The truth as values of a graph; what the graph holds stays.
fn truth_values(graph: &VehicleGraph, truth: &VehicleTruth) -> Values {
    let mut values = graph.problem.values.clone();
    let mut set = |id: VariableId, value: &[f64]| {
        if !graph.problem.is_fixed(id) {
            values.get_mut(id).copy_from_slice(value);
        }
    };
    graph.poses.iter().zip(&truth.poses).for_each(|(id, v)| set(*id, v));
    graph.rates.iter().zip(&truth.rates_radps).for_each(|(id, v)| set(*id, &[*v]));
    set(graph.mount, &truth.mount);
    graph.landmarks.iter().zip(&truth.landmarks_m).for_each(|(id, v)| {
        if let Some(id) = id {
            set(*id, v);
        }
    });
    values
}

/// Mean square distance of the poses from their true places \[m²\].
fn square_m2(graph: &VehicleGraph, truth: &Values) -> f64 {
    let off = |p: &VariableId| (graph.problem.values.xy(*p) - truth.xy(*p)).norm_squared();
    graph.poses.iter().map(off).sum::<f64>() / graph.poses.len() as f64
}

/// CPU seconds of one thread from a graph to its solution: the least of a few rounds.
fn solve_cpu_s(mut graph: VehicleGraph) -> Result<f64> {
    const SOLUTIONS: usize = 10;
    let start = graph.problem.values.clone();
    let mut least = f64::INFINITY;
    for _ in 0..3 {
        let begin = cpu_s();
        for _ in 0..SOLUTIONS {
            graph.problem.values = start.clone();
            solve(&mut graph.problem, &SolveOptions::default())?;
        }
        least = least.min((cpu_s() - begin) / SOLUTIONS as f64);
    }
    Ok(least)
}

/// A pose's error and covariance.
type PoseError = (Vector3<f64>, Matrix3<f64>);

/// Adjusts a graph, adds to a tally how far it is off; error of the far pose, in the axes of the map.
fn adjust(mut graph: VehicleGraph, truth: &VehicleTruth, tally: &mut Tally) -> Result<PoseError> {
    let options = SolveOptions::default();
    let mut system = System::new(&graph.problem, options.order, options.partition, options.method.clone())?;
    let solved = solve_system(&mut graph.problem, &mut system, &options)?;
    tally.unknowns = graph.problem.unknown_count();
    tally.chi2.add(Some(solved.cost), usize::try_from(solved.degrees_of_freedom)?);
    let covariances = covariances(&graph.problem, &mut system, &Kernel::None, false)?;
    let truth = truth_values(&graph, truth);
    let values = &graph.problem.values;
    tally.square_m2 += square_m2(&graph, &truth);
    let nees = |id: VariableId| {
        let free = !graph.problem.is_fixed(id);
        free.then(|| covariances.normalised_square(id, &values.tangent_to(id, &truth))).flatten()
    };
    let (far, last) = (graph.poses[FAR], *graph.poses.last().context("a drive")?);
    tally.far.add(nees(far), 3);
    tally.last.add(nees(last), 3);
    tally.mount.add(nees(graph.mount), 3);
    tally.rate.add(nees(graph.rates[graph.rates.len() / 2]), 1);
    tally.all.add(Some(joint(&graph, &system, &truth)), tally.unknowns);
    Ok(in_map(values, &truth, far, &covariances))
}

/// Normalised square of the errors of all unknowns together: eᵀ N e.
fn joint(graph: &VehicleGraph, system: &System, truth: &Values) -> f64 {
    let mut normal = Normal::default();
    system.pattern.assemble(&graph.problem, &graph.problem.values, &Kernel::None, &mut normal);
    let mut error = vec![0.0; system.scalars()];
    for id in graph.problem.variables().filter(|v| !graph.problem.is_fixed(*v)) {
        let first = system.pattern.scalar[id.index()] as usize;
        let step = graph.problem.values.tangent_to(id, truth);
        error[first..first + step.len()].copy_from_slice(&step);
    }
    system.pattern.multiply(&normal.numbers, &error).iter().zip(&error).map(|(n, e)| n * e).sum()
}

fn in_map(values: &Values, truth: &Values, id: VariableId, covariances: &Covariances) -> PoseError {
    let (sin, cos) = values.get(id)[2].sin_cos();
    let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    let error = DVector::from_vec(values.tangent_to(id, truth));
    let covariance = covariances.of(id);
    (turn * error.fixed_rows::<3>(0), turn * covariance.fixed_view::<3, 3>(0, 0) * turn.transpose())
}

/// What is estimated in each case: error of the heading rate, place of the sensor.
const CASES: [(bool, bool); 4] = [(true, true), (false, true), (true, false), (false, false)];

/// All seeds, adjusted in all ways.
#[derive(Debug, Default)]
struct Trials {
    explicit: [Tally; 4],
    implicit: [Tally; 4],
    /// Links that use sightings more than once.
    again: Tally,
    /// Explicit less implicit, by the difference of their covariances.
    between: Squares,
    dead_reckoned_m2: f64,
    /// Sigma of links on streets for a known heading: along the street over across.
    weakness: Vec<f64>,
}

/// CPU seconds of all cases, of the first seed.
fn time(trials: &mut Trials) -> Result<()> {
    let (drive, _) = simulate_vehicle(Route::FigureOfEight(2), 1);
    let links = submap_links(&drive, LinkUse::Once);
    for (k, (rate, mount)) in CASES.into_iter().enumerate() {
        let model = VehicleModel { rate, mount, ..VehicleModel::default() };
        trials.explicit[k].cpu_s = solve_cpu_s(explicit_map(&drive, model)?)?;
        trials.implicit[k].cpu_s = solve_cpu_s(implicit_map(&drive, &links, model)?)?;
    }
    let again = submap_links(&drive, LinkUse::Again);
    trials.again.cpu_s = solve_cpu_s(implicit_map(&drive, &again, VehicleModel::default())?)?;
    Ok(())
}

fn trials() -> Result<Trials> {
    let mut trials = Trials::default();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    one.install(|| time(&mut trials))?;
    for seed in 1..=SEEDS {
        let (drive, truth) = simulate_vehicle(Route::FigureOfEight(2), seed);
        let links = submap_links(&drive, LinkUse::Once);
        for (k, (rate, mount)) in CASES.into_iter().enumerate() {
            let model = VehicleModel { rate, mount, ..VehicleModel::default() };
            let a = adjust(explicit_map(&drive, model)?, &truth, &mut trials.explicit[k])?;
            let b = adjust(implicit_map(&drive, &links, model)?, &truth, &mut trials.implicit[k])?;
            if k == 0 {
                // the explicit map has all that the implicit one has: the covariance of the difference is that of the
                // covariances (Hausman 1978)
                let difference = a.0 - b.0;
                let spread = (b.1 - a.1).cholesky().context("the explicit map is the better one")?;
                trials.between.add(Some(difference.dot(&spread.solve(&difference))), 3);
            }
        }
        let start = explicit_map(&drive, VehicleModel::default())?;
        trials.dead_reckoned_m2 += square_m2(&start, &truth_values(&start, &truth));
        let again = submap_links(&drive, LinkUse::Again);
        adjust(implicit_map(&drive, &again, VehicleModel::default())?, &truth, &mut trials.again)?;
        trials.weakness.extend(links.iter().filter_map(|link| {
            let straight = link.registered.second_in_first[2].abs() < 0.1;
            let translation = link.registered.information.fixed_view::<2, 2>(0, 0).into_owned();
            let covariance = translation.try_inverse().filter(|_| straight)?;
            Some((covariance[(0, 0)] / covariance[(1, 1)]).sqrt())
        }));
    }
    Ok(trials)
}

/// Line 10.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let trials = trials()?;
    table(&trials);
    let mut rows = Vec::new();
    for (map, tallies) in [("explicit", &trials.explicit), ("implicit", &trials.implicit)] {
        let [right, no_rate, no_mount, neither] = tallies;
        for (what, squares) in [
            ("chi2 over degrees of freedom", right.chi2),
            ("NEES of the far pose", right.far),
            ("NEES of the last pose", right.last),
            ("NEES of the misalignment", right.mount),
            ("NEES of the rate half way", right.rate),
            ("NEES of all unknowns together", right.all),
        ] {
            let [low, high] = bounds(squares.count);
            rows.push(Row::between(format!("{map}: {what}, {SEEDS} seeds"), squares.mean(), low, high, ""));
        }
        for (what, other) in [("rate", no_rate), ("misalignment", no_mount), ("both", neither)] {
            let outside = 3.0 * bounds(other.last.count)[1];
            rows.push(Row::at_least(
                format!("{map} without {what}: NEES of the last pose"),
                other.last.mean(),
                outside,
                "",
            ));
        }
        rows.push(Row::at_most(
            format!("{map}: rms with rate over without"),
            right.rms_m() / no_rate.rms_m(),
            0.25,
            "",
        ));
        rows.push(Row::at_most(
            format!("{map}: rms with misalignment over without"),
            right.rms_m() / no_mount.rms_m(),
            0.7,
            "",
        ));
        rows.push(Row::at_most(format!("{map}: CPU to convergence"), 1e3 * right.cpu_s, 100.0, "ms"));
    }
    let [low, high] = bounds(trials.between.count);
    rows.push(Row::between(
        "explicit less implicit, far pose, by its covariance",
        trials.between.mean(),
        low,
        high,
        "",
    ));
    let high = bounds(trials.again.all.count)[1];
    rows.push(Row::at_least("sightings used again and again: NEES of all", trials.again.all.mean(), high, ""));
    let weakness = median(trials.weakness);
    rows.push(Row::at_least("links on streets: sigma along over across, median", weakness, 2.0, ""));
    rows.extend(named()?);
    Ok(rows)
}

impl Tally {
    fn rms_m(&self) -> f64 {
        (self.square_m2 / SEEDS as f64).sqrt()
    }
}

fn table(trials: &Trials) {
    println!("dead reckoned: rms {:.1} m", (trials.dead_reckoned_m2 / SEEDS as f64).sqrt());
    println!(
        "| map | rate | misalignment | unknowns | CPU ms | rms m | chi2/dof | NEES far | last | misalignment | rate | all |"
    );
    let word = |known: bool| if known { "estimated" } else { "taken as nominal" };
    let print = |name: &str, (rate, mount): (bool, bool), t: &Tally| {
        println!(
            "| {name} | {} | {} | {} | {:.1} | {:.3} | {:.3} | {:.2} | {:.2} | {:.2} | {:.2} | {:.3} |",
            word(rate),
            word(mount),
            t.unknowns,
            1e3 * t.cpu_s,
            t.rms_m(),
            t.chi2.mean(),
            t.far.mean(),
            t.last.mean(),
            t.mount.mean(),
            t.rate.mean(),
            t.all.mean()
        );
    };
    for (k, case) in CASES.into_iter().enumerate() {
        print("explicit", case, &trials.explicit[k]);
        print("implicit", case, &trials.implicit[k]);
    }
    print("implicit, sightings again and again", CASES[0], &trials.again);
}

/// What is not observable, by its leading unknowns, in drives of which it is known.
fn named() -> Result<Vec<Row>> {
    let alone = VehicleModel { tolerances: false, ..VehicleModel::default() };
    let free = VehicleModel { start_known: false, ..alone };
    let offset = ["sensor on vehicle forward", "sensor on vehicle left", "rate 0"];
    let datum = ["pose 0 forward", "pose 0 left", "pose 0 heading"];
    let blind = [&offset[..], &["sensor on vehicle heading"]].concat();
    let cases: [(&str, Route, VehicleModel, bool, &[&str]); 4] = [
        ("straight on", Route::Straight(20), alone, true, &offset),
        ("with turns", Route::FigureOfEight(1), alone, true, &[]),
        ("with turns, no control", Route::FigureOfEight(1), free, true, &datum),
        ("straight on, nothing sighted", Route::Straight(20), alone, false, &blind),
    ];
    let mut rows = Vec::new();
    for (name, route, model, sighted, expected) in cases {
        let (mut drive, _) = simulate_vehicle(route, 1);
        if !sighted {
            drive.sightings.clear();
        }
        // at the solution that control and the makers' tolerances give
        let mut solved = explicit_map(&drive, VehicleModel::default())?;
        solve(&mut solved.problem, &SolveOptions::default())?;
        let mut graph = explicit_map(&drive, model)?;
        graph.problem.values = solved.problem.values;
        let found = undetermined(&graph.problem, pinch(&graph))?;
        for f in &found {
            println!("{name}: not determined: {} (sigma {:.1})", f.describe(&graph.problem), f.sigma);
        }
        let leading: Vec<String> =
            found.iter().map(|f| component_name(&graph.problem, f.leading().variable, f.leading().component)).collect();
        let wrong = leading.iter().filter(|l| !expected.contains(&l.as_str())).count()
            + expected.iter().filter(|e| !leading.iter().any(|l| l == *e)).count();
        let label = format!("{name}: {} not observable, wrongly named or missed", expected.len());
        rows.push(Row::at_most(label, wrong as f64, 0.0, ""));
    }
    Ok(rows)
}
