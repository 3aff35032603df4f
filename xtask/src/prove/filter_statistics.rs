//! Is the smoother honest? Many simulated drives against their truth.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result};
use nalgebra::{Matrix3, Vector3};
use tieline_filter::innovation::MeasurementKind;
use tieline_filter::{ImuGrade, Options, Smoother, Solution};
use tieline_simulate::navigation::{
    IncrementScenario, LoopScenario, NavigationScenario, NavigationTruth, SimulatedNavigation,
};

use super::Row;

/// Seeds of the test of honesty.
const SEEDS: u64 = 30;
/// Seeds of the tests of ties.
const TIE_SEEDS: u64 = 20;
/// Length of a drive \[s\].
const DRIVE_S: f64 = 900.0;
/// Epochs of the test of honesty \[s\]: 200 s apart, the third is the middle of the outage.
const EPOCHS_S: [f64; 5] = [1140.0, 1340.0, 1540.0, 1740.0, 1895.0];
/// The outage of the test of honesty \[s\].
const OUTAGE_S: (f64, f64) = (1490.0, 1590.0);
/// About a lap of the simulated car \[s\].
const LAP_S: f64 = 190.0;

/// Bounds of a mean of 30 times χ² with three degrees of freedom, two-sided 95 %.
const NEES_BOUNDS: (f64, f64) = (2.19, 3.94);

/// Runs a function for every seed, on all cores; results in order of the seeds.
fn for_seeds<T: Send>(count: u64, function: impl Fn(u64) -> Result<T> + Sync) -> Result<Vec<T>> {
    let next = AtomicUsize::new(0);
    let slots: Mutex<Vec<Option<Result<T>>>> = Mutex::new((0..count).map(|_| None).collect());
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    if k as u64 >= count {
                        break;
                    }
                    let result = function(k as u64 + 1);
                    if let Ok(mut slots) = slots.lock() {
                        slots[k] = Some(result);
                    }
                }
            });
        }
    });
    let slots = slots.into_inner().map_err(|_| anyhow::anyhow!("a worker panicked"))?;
    slots.into_iter().map(|r| r.context("a seed without a result")?).collect()
}

/// What a user would type: the preset, the lever arm that was measured on the vehicle, and how much of the receiver's error is
/// slow; nothing else.
fn options(grade: ImuGrade, scenario: &NavigationScenario) -> Options {
    let mut options = Options::new(grade.noise());
    options.gnss.lever_arm_m = scenario.gnss.lever_arm_m;
    options.gnss.correlated_share = scenario.gnss.correlated_share;
    options
}

fn solve(grade: ImuGrade, scenario: &NavigationScenario) -> Result<(SimulatedNavigation, Solution)> {
    let simulated = scenario.simulate()?;
    let solution = Smoother::run(&simulated.inputs, &options(grade, scenario))?;
    Ok((simulated, solution))
}

/// Normalised error squared and errors over sigma of three components.
#[derive(Debug, Clone, Copy)]
struct Check {
    nees: f64,
    ratio: Vector3<f64>,
}

impl Check {
    fn new(error: &Vector3<f64>, covariance: &Matrix3<f64>) -> Result<Self> {
        let precision = covariance.cholesky().context("a covariance that is not positive definite")?.inverse();
        let sigma = covariance.diagonal().map(f64::sqrt);
        Ok(Self { nees: error.dot(&(precision * error)), ratio: error.component_div(&sigma) })
    }
}

/// Position and attitude at every epoch.
fn checks(solution: &Solution, simulated: &SimulatedNavigation) -> Result<Vec<[Check; 2]>> {
    EPOCHS_S
        .iter()
        .map(|time_s| {
            let pose = solution.pose_at(&simulated.inputs, *time_s).context("an epoch beyond the trajectory")?;
            let covariance = solution.covariance_at(*time_s).context("an epoch without covariance")?;
            let (position, attitude) = simulated.truth.error_of(&pose);
            Ok([
                Check::new(&position, &covariance.fixed_view::<3, 3>(0, 0).into_owned())?,
                Check::new(&attitude, &covariance.fixed_view::<3, 3>(3, 3).into_owned())?,
            ])
        })
        .collect()
}

/// The drive of the test of honesty.
fn drive(grade: ImuGrade, with_ties: bool, seed: u64) -> NavigationScenario {
    let mut scenario = NavigationScenario::car(grade.noise(), DRIVE_S, seed);
    scenario.gnss.outages_s = vec![OUTAGE_S];
    if with_ties {
        // planes all around the first lap, seen again in every lap
        let again_s = (0..4).map(|k| 1260.0 + LAP_S * f64::from(k)).map(|t| (t, (t + LAP_S).min(1898.0))).collect();
        scenario.loops = vec![LoopScenario {
            first_s: (1065.0, 1245.0),
            again_s,
            interval_s: 15.0,
            near_m: 2.0,
            sigma_m: 0.01,
            blunders: (0.0, 0.0),
        }];
    }
    scenario
}

/// Line 5: normalised errors of 30 seeds, tactical and MEMS, with and without ties.
#[allow(clippy::cast_precision_loss)]
pub(crate) fn honesty() -> Result<Vec<Row>> {
    let (mut averages, mut inside) = (Vec::new(), Vec::new());
    let mut first_seed = 0;
    for (grade, name) in [(ImuGrade::LeadorA15, "tactical"), (ImuGrade::Adis16465, "MEMS")] {
        for with_ties in [false, true] {
            // drives of their own: with the same GNSS errors the means would not be independent
            first_seed += 1000;
            let all = for_seeds(SEEDS, |seed| {
                let (simulated, solution) = solve(grade, &drive(grade, with_ties, first_seed + seed))?;
                checks(&solution, &simulated)
            })?;
            for (k, what) in ["position", "attitude"].into_iter().enumerate() {
                let of_epochs: Vec<f64> =
                    (0..EPOCHS_S.len()).map(|e| all.iter().map(|c| c[e][k].nees).sum::<f64>() / SEEDS as f64).collect();
                let ratios: Vec<f64> =
                    all.iter().flatten().flat_map(|c| c[k].ratio.iter().copied().collect::<Vec<_>>()).collect();
                let share = ratios.iter().filter(|r| r.abs() <= 2.0).count() as f64 / ratios.len() as f64;
                let shown: Vec<String> = of_epochs.iter().map(|v| format!("{v:.2}")).collect();
                let ties = if with_ties { "with ties" } else { "without ties" };
                println!("{name}, {ties}, {what}: mean NEES {}; 2 sigma {:.1} %", shown.join(" "), 100.0 * share);
                averages.extend(of_epochs);
                inside.extend(ratios);
            }
        }
    }
    let within = averages.iter().filter(|v| **v >= NEES_BOUNDS.0 && **v <= NEES_BOUNDS.1).count();
    let share = 100.0 * within as f64 / averages.len() as f64;
    let two_sigma = inside.iter().filter(|r| r.abs() <= 2.0).count() as f64 / inside.len() as f64;
    Ok(vec![
        Row::between(format!("mean NEES within 2.19 … 3.94, {} means", averages.len()), share, 90.0, 100.0, "%"),
        Row::between(format!("within 2 sigma, {} components", inside.len()), 100.0 * two_sigma, 93.0, 97.0, "%"),
    ])
}

/// Errors and sigmas of position at the nodes of a span.
fn in_span(solution: &Solution, truth: &NavigationTruth, span_s: (f64, f64)) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    solution
        .nodes
        .iter()
        .filter(|n| n.nominal.nav.time_s > span_s.0 && n.nominal.nav.time_s < span_s.1)
        .map(|n| {
            let sigma = Vector3::new(n.covariance[0], n.covariance[10], n.covariance[20]).map(f64::sqrt);
            (truth.error_of(&n.nominal.nav).0, sigma)
        })
        .collect()
}

#[allow(clippy::cast_precision_loss)]
fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |a, v| (a.0 + v * v, a.1 + 1));
    (sum / count.max(1) as f64).sqrt()
}

fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

/// The value that a share of all does not exceed.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    if sorted.len().is_multiple_of(2) && (share - 0.5).abs() < 1e-9 {
        return 0.5 * (sorted[sorted.len() / 2 - 1] + sorted[sorted.len() / 2]);
    }
    sorted[((sorted.len() as f64 * share).ceil() as usize).clamp(1, sorted.len()) - 1]
}

/// The outage in the second pass of the loop \[s\].
const LOOP_OUTAGE_S: (f64, f64) = (1300.0, 1413.0);
/// The stretch of it that was passed before \[s\]: the middle third.
const CROSSING_S: (f64, f64) = (1338.0, 1375.0);

/// Two laps; the middle third of the outage in the second crosses what the first has seen.
fn two_laps(grade: ImuGrade, with_ties: bool, false_share: f64, seed: u64) -> NavigationScenario {
    let mut scenario = NavigationScenario::car(grade.noise(), 600.0, seed);
    scenario.gnss.outages_s = vec![LOOP_OUTAGE_S];
    if with_ties {
        scenario.loops = vec![LoopScenario {
            first_s: CROSSING_S,
            again_s: vec![(1062.0, 1062.0 + LAP_S)],
            interval_s: 2.5,
            near_m: 2.0,
            sigma_m: 0.01,
            blunders: (false_share, 0.5),
        }];
    }
    scenario
}

/// Line 6, loop: what ties at a crossing take off the error within an outage.
pub(crate) fn loop_ties() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (grade, name) in [(ImuGrade::LeadorA15, "tactical"), (ImuGrade::Adis16465, "MEMS")] {
        let mut result = Vec::new();
        for with_ties in [false, true] {
            let all: Vec<_> = for_seeds(TIE_SEEDS, |seed| {
                let (simulated, solution) = solve(grade, &two_laps(grade, with_ties, 0.0, seed))?;
                if seed == 1 {
                    println!("{name}: {} ties, notes {:?}", simulated.inputs.ties.len(), solution.notes);
                }
                Ok(in_span(&solution, &simulated.truth, LOOP_OUTAGE_S))
            })?
            .concat();
            result.push((rms(all.iter().map(|e| e.0.norm())), rms(all.iter().map(|e| e.1.norm()))));
        }
        let [without, with] = [result[0], result[1]];
        println!(
            "{name}, loop: without ties rms {:.4} m (sigma {:.4} m), with {:.4} m (sigma {:.4} m)",
            without.0, without.1, with.0, with.1
        );
        let endless = f64::INFINITY;
        rows.extend([
            Row::between(format!("loop ties, {name}: error falls by"), without.0 / with.0, 3.0, endless, ""),
            Row::between(format!("loop ties, {name}: sigma falls by"), without.1 / with.1, 3.0, endless, ""),
            Row::between(format!("loop ties, {name}: rms error over sigma"), with.0 / with.1, 0.8, 1.25, ""),
        ]);
    }
    Ok(rows)
}

/// The outage bridged by height increments \[s\].
const LONG_OUTAGE_S: (f64, f64) = (1300.0, 1475.0);

fn with_increments(bias_m: f64, false_share: f64, seed: u64) -> NavigationScenario {
    let mut scenario = NavigationScenario::car(ImuGrade::Ap60.noise(), DRIVE_S, seed);
    scenario.gnss.outages_s = vec![LONG_OUTAGE_S];
    scenario.increments = vec![IncrementScenario {
        // all the way: where there is GNSS, a bias contradicts it
        span_s: (1061.0, 1000.0 + DRIVE_S),
        interval_s: 0.25,
        apart_s: 1.0,
        sigma_m: 0.002,
        bias_m,
        blunders: (false_share, 0.5),
    }];
    scenario
}

/// What a drive with increments shows.
struct Bridged {
    heights: Vec<(f64, f64)>,
    largest_m: f64,
    forward_m: f64,
    mean_test: f64,
    first_fix: f64,
}

/// Solves a drive with increments.
#[allow(clippy::cast_precision_loss)]
fn bridge(scenario: &NavigationScenario) -> Result<Bridged> {
    let (simulated, solution) = solve(ImuGrade::Ap60, scenario)?;
    let heights: Vec<(f64, f64)> =
        in_span(&solution, &simulated.truth, LONG_OUTAGE_S).iter().map(|(e, s)| (e.z, s.z)).collect();
    let last = solution
        .filter
        .iter()
        .rfind(|n| n.nominal.nav.time_s < LONG_OUTAGE_S.1)
        .context("no node within the outage")?;
    let of_ties: Vec<f64> =
        solution.innovations.iter().filter(|i| i.kind == MeasurementKind::Tie).map(|i| i.normalised[0]).collect();
    let first_fix = solution
        .innovations
        .iter()
        .find(|i| i.kind == MeasurementKind::Position && i.time_s > LONG_OUTAGE_S.1)
        .map_or(0.0, |i| i.normalised[2]);
    Ok(Bridged {
        largest_m: heights.iter().map(|h| h.0.abs()).fold(0.0, f64::max),
        heights,
        forward_m: simulated.truth.error_of(&last.nominal.nav).0.z.abs(),
        mean_test: of_ties.iter().sum::<f64>() / (of_ties.len().max(1) as f64).sqrt(),
        first_fix,
    })
}

/// Line 6, increments: a long outage bridged by height increments, and what a bias does to it.
pub(crate) fn height_increments() -> Result<Vec<Row>> {
    let good = for_seeds(TIE_SEEDS, |seed| bridge(&with_increments(0.0, 0.0, seed)))?;
    let biased = for_seeds(TIE_SEEDS, |seed| bridge(&with_increments(0.001, 0.0, seed)))?;
    let of = |all: &[Bridged], what: fn(&Bridged) -> f64| all.iter().map(what).collect::<Vec<f64>>();
    let largest = of(&good, |b| b.largest_m);
    let heights: Vec<(f64, f64)> = good.iter().flat_map(|b| b.heights.clone()).collect();
    let honest = rms(heights.iter().map(|h| h.0)) / rms(heights.iter().map(|h| h.1));
    let absolute = |values: &[f64]| values.iter().map(|v| v.abs()).collect::<Vec<f64>>();
    for (name, all) in [("without bias", &good), ("with bias", &biased)] {
        println!(
            "{name}: largest error median {:.4} m, forward error before the first fix median {:.4} m, mean of normalised \
             increments times root of count: median {:.2} (largest size {:.2}), first fix down median {:.2} (largest size {:.2})",
            median(&of(all, |b| b.largest_m)),
            median(&of(all, |b| b.forward_m)),
            median(&of(all, |b| b.mean_test)),
            quantile(&absolute(&of(all, |b| b.mean_test)), 1.0),
            median(&of(all, |b| b.first_fix)),
            quantile(&absolute(&of(all, |b| b.first_fix)), 1.0),
        );
    }
    let endless = f64::INFINITY;
    let grown = median(&of(&biased, |b| b.largest_m)) / median(&largest);
    let forward = median(&of(&biased, |b| b.forward_m));
    let mean_test = median(&absolute(&of(&biased, |b| b.mean_test)));
    let first_fix = median(&absolute(&of(&biased, |b| b.first_fix)));
    Ok(vec![
        Row::at_most("increments, 175 s: largest height error, median", median(&largest), 0.02, "m"),
        Row::at_most("increments, 175 s: largest height error, 95 %", quantile(&largest, 0.95), 0.035, "m"),
        Row::between("increments, 175 s: rms error over sigma", honest, 0.8, 1.25, ""),
        Row::between("biased increments: forward drift, median", forward, 0.1, endless, "m"),
        Row::between("biased increments: mean innovation over its sigma, median", mean_test, 2.0, endless, ""),
        Row::between("biased increments: first fix over its sigma, median", first_fix, 2.0, endless, ""),
        Row::between("biased increments: smoothed error grows by", grown, 2.0, endless, ""),
    ])
}

/// Line 7: what 5 % false ties of 0.5 m change, over sigma.
pub(crate) fn false_ties() -> Result<Vec<Row>> {
    let change =
        |grade: ImuGrade, clean: &NavigationScenario, bad: &NavigationScenario, span_s: (f64, f64)| -> Result<f64> {
            let (simulated, clean) = solve(grade, clean)?;
            let (_, bad) = solve(grade, bad)?;
            let errors = in_span(&clean, &simulated.truth, span_s);
            let moved = in_span(&bad, &simulated.truth, span_s);
            anyhow::ensure!(errors.len() == moved.len(), "nodes at different times");
            Ok(errors.iter().zip(&moved).map(|(a, b)| (a.0 - b.0).component_div(&a.1).amax()).fold(0.0, f64::max))
        };
    let mut rows = Vec::new();
    for (grade, name) in [(ImuGrade::LeadorA15, "tactical"), (ImuGrade::Adis16465, "MEMS")] {
        let loops = for_seeds(TIE_SEEDS, |seed| {
            change(grade, &two_laps(grade, true, 0.0, seed), &two_laps(grade, true, 0.05, seed), LOOP_OUTAGE_S)
        })?;
        rows.push(Row::at_most(
            format!("5 % false loop ties, {name}: largest change over sigma"),
            quantile(&loops, 1.0),
            1.0,
            "",
        ));
    }
    let increments = for_seeds(TIE_SEEDS, |seed| {
        change(ImuGrade::Ap60, &with_increments(0.0, 0.0, seed), &with_increments(0.0, 0.05, seed), LONG_OUTAGE_S)
    })?;
    rows.push(Row::at_most("5 % false increments: largest change over sigma", quantile(&increments, 1.0), 1.0, ""));
    Ok(rows)
}
