//! The proofs: strips, filter, drives, graphs and XYZ points.

mod commands;
mod filter;
mod filter_statistics;
mod graph;
mod mobile;
mod real;
mod same;
mod statistics;
mod vehicle;
mod xyz;

/// One line of a proof.
pub(crate) struct Row {
    pub(crate) name: String,
    pub(crate) value: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
    pub(crate) unit: &'static str,
}

impl Row {
    pub(crate) fn at_most(name: impl Into<String>, value: f64, high: f64, unit: &'static str) -> Self {
        Self { name: name.into(), value, low: f64::NEG_INFINITY, high, unit }
    }
    pub(crate) fn between(name: impl Into<String>, value: f64, low: f64, high: f64, unit: &'static str) -> Self {
        Self { name: name.into(), value, low, high, unit }
    }
    pub(crate) fn at_least(name: impl Into<String>, value: f64, low: f64, unit: &'static str) -> Self {
        Self { name: name.into(), value, low, high: f64::INFINITY, unit }
    }
    fn passes(&self) -> bool {
        self.value >= self.low && self.value <= self.high
    }
    fn print(&self) {
        let bound = match (self.low.is_finite(), self.high.is_finite()) {
            (true, true) => format!("{} … {}", tidy(self.low), tidy(self.high)),
            (true, false) => format!("≥ {}", tidy(self.low)),
            _ => format!("≤ {}", tidy(self.high)),
        };
        let verdict = if self.passes() { "pass" } else { "FAIL" };
        println!("{:<64} {:>12.4} {:<6} bound {:<16} {verdict}", self.name, self.value, self.unit, bound);
    }
}

/// A bound without the digits that arithmetic leaves.
fn tidy(value: f64) -> f64 {
    if value.is_finite() { (value * 1e6).round() / 1e6 } else { value }
}

type Proof = fn() -> anyhow::Result<Vec<Row>>;

/// Runs the proofs on drives.
pub(crate) fn mobile(only: Option<&str>, seeds: Option<u64>) -> anyhow::Result<()> {
    mobile::set_seeds(seeds);
    let proofs: [(&str, Proof); 8] = [
        ("1 an independent simulator", mobile::block),
        ("2 loop through an outage", mobile::loop_closure),
        ("3 two scanners through an outage", mobile::odometer_of_two_scanners),
        ("4 calibration", mobile::calibration),
        ("5 ablations", mobile::ablations),
        ("6 false ties", mobile::false_ties),
        ("7 time", mobile::time),
        ("8 a real vehicle with three scanners", vehicle::scanners),
    ];
    run(&proofs, only)
}

/// Runs the proofs on strips.
pub(crate) fn strips(only: Option<&str>) -> anyhow::Result<()> {
    let proofs: [(&str, Proof); 7] = [
        ("1 zurich", real::zurich),
        ("2 dual scanner", real::dual_scanner),
        ("3 forest, alps, toronto", real::others),
        ("4 simulated block", statistics::rows),
        ("5 speed", commands::speed),
        ("6 same bytes, nothing lost, and back", same::rows),
        ("7 mistakes a person makes", commands::mistakes),
    ];
    run(&proofs, only)
}

/// Runs the proofs on the smoother.
pub(crate) fn filter(only: Option<&str>) -> anyhow::Result<()> {
    let proofs: [(&str, Proof); 10] = [
        ("1 mechanisation", commands::mechanisation),
        ("2 whu-sim27", filter::whole),
        ("3 outages", filter::outages),
        ("4 a real car", filter::car),
        ("5 honesty", filter_statistics::honesty),
        ("6 loop ties", filter_statistics::loop_ties),
        ("6 height increments", filter_statistics::height_increments),
        ("7 false ties", filter_statistics::false_ties),
        ("8 speed", commands::smoother_speed),
        ("9 mistakes a person makes", commands::navigation_mistakes),
    ];
    run(&proofs, only)
}

/// Runs the proofs on graphs.
pub(crate) fn graph(only: Option<&str>) -> anyhow::Result<()> {
    let proofs: [(&str, Proof); 12] = [
        ("1 known optima", graph::chi2),
        ("1 known sigmas", graph::sigmas),
        ("1 known nets", graph::nets),
        ("2 Helmert blocking is exact", graph::blocking),
        ("3 speed of pose graphs", graph::speed),
        ("4 size", graph::scale),
        ("5 all marginals", graph::marginals),
        ("6 false loops", graph::outliers),
        ("7 junctions and sections", graph::junctions),
        ("8 a block of strips", graph::strips),
        ("9 mistakes a person makes", commands::graph_mistakes),
        ("10 a survey vehicle", graph::vehicle),
    ];
    if only.is_some() {
        return run(&proofs, only);
    }
    // each line in a process of its own: peaks of memory are those of processes
    let mut failed = Vec::new();
    for number in 1..=10_u32 {
        let arguments = ["prove", "graph", "--only", &number.to_string()];
        let status = std::process::Command::new(std::env::current_exe()?).args(arguments).status()?;
        if !status.success() {
            failed.push(number);
        }
    }
    anyhow::ensure!(failed.is_empty(), "lines {failed:?} fail");
    Ok(())
}

/// Runs the proofs on XYZ points.
pub(crate) fn xyz(only: Option<&str>, seeds: Option<u64>) -> anyhow::Result<()> {
    mobile::set_seeds(seeds);
    let proofs: [(&str, Proof); 6] = [
        ("1 texture against the truth", xyz::accuracy),
        ("2 a straight street", xyz::straight),
        ("3 corners and submaps of strips", xyz::strips),
        ("4 registration of scan pairs", xyz::registration),
        ("5 time", xyz::time),
        ("6 what only looks like a spot", xyz::false_ties),
    ];
    run(&proofs, only)
}

fn run(proofs: &[(&str, Proof)], only: Option<&str>) -> anyhow::Result<()> {
    let mut failed = 0;
    for (name, proof) in proofs {
        // a number is a whole one: 1 is not 10
        let number = name.split(' ').next();
        let is_asked = |o: &str| name.starts_with(o) && (o.parse::<u32>().is_err() || number == Some(o));
        if only.is_some_and(|o| !o.split(',').any(is_asked)) {
            continue;
        }
        println!("== {name}");
        match proof() {
            Ok(rows) => {
                for row in rows {
                    row.print();
                    failed += usize::from(!row.passes());
                }
            }
            Err(error) => {
                println!("{name}: FAIL: {error:#}");
                failed += 1;
            }
        }
    }
    anyhow::ensure!(failed == 0, "{failed} lines fail");
    Ok(())
}
