//! Line 4: nets of the size of the North American datums.

use anyhow::Result;

use super::super::Row;
use super::{graph, median, number};

const GB: f64 = 1e9;

/// One linear solution of a generated net on one thread.
fn net(stations: &str, kind: &str, more: &[&str]) -> Result<serde_json::Value> {
    let arguments =
        ["generate", "--stations", stations, "--kind", kind, "--solve", "--iterations", "1", "--threads", "1"];
    graph(&[&arguments, more].concat())
}

/// Line 4.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let mut in_core = Vec::new();
    let (mut bytes, mut flops) = (0.0_f64, 0.0);
    for _ in 0..3 {
        let value = net("270400", "directions", &[])?;
        in_core.push(number(&value, "solve_cpu_s"));
        bytes = bytes.max(number(&value, "peak_memory_bytes"));
        flops = number(&value, "flops");
    }
    let seconds = median(in_core);
    rows.push(Row::at_most(
        "270,400 stations: order, form, factor, solve, CPU (CHOLMOD + METIS 12.9, faer 5.3)",
        seconds,
        5.3,
        "s",
    ));
    rows.push(Row::at_most("270,400 stations: peak resident memory", bytes / GB, 1.3, "GB"));
    rows.push(Row::at_most("270,400 stations: multiplications and additions", flops / 1e9, 1e3, "G"));
    let disk = net("270400", "directions", &["--memory", "120"])?;
    rows.push(Row::at_most(
        "270,400 stations out of core: peak resident memory",
        number(&disk, "peak_memory_bytes") / GB,
        0.3,
        "GB",
    ));
    let ratio = number(&disk, "solve_cpu_s") / seconds;
    rows.push(Row::at_most("270,400 stations out of core: CPU over in core", ratio, 2.0, ""));
    let small: Vec<f64> =
        (0..5).map(|_| net("24964", "directions", &[]).map(|v| number(&v, "solve_cpu_s"))).collect::<Result<_>>()?;
    rows.push(Row::at_most("24,964 stations: CPU (faer 0.21, CHOLMOD 0.66)", median(small), 0.25, "s"));
    for kind in ["directions", "baselines"] {
        let value = net("24964", kind, &["--sigmas"])?;
        let all = number(&value, "solve_cpu_s") + number(&value, "covariance_cpu_s");
        rows.push(Row::at_most(
            format!("24,964 stations, {kind}, all variances: CPU (DynAdjust 41-79)"),
            all,
            2.0,
            "s",
        ));
        let bytes = number(&value, "peak_memory_bytes");
        rows.push(Row::at_most(format!("24,964 stations, {kind}, all variances: memory"), bytes / GB, 0.3, "GB"));
    }
    // growth: seconds per station must not grow faster than nested dissection's root of the size
    let mut last: Option<(f64, f64)> = None;
    for stations in [10_000.0, 100_000.0, 1_000_000.0] {
        let value = net(&format!("{stations}"), "directions", &[])?;
        let cpu = number(&value, "solve_cpu_s");
        let exponent = last.map_or(1.0, |(n, s)| (cpu / s).ln() / f64::ln(stations / n));
        let label = format!(
            "{stations} stations: {cpu:.2} s, {:.2} GB; growth exponent",
            number(&value, "peak_memory_bytes") / GB
        );
        rows.push(Row::at_most(label, exponent, 1.5, ""));
        last = Some((stations, cpu));
    }
    Ok(rows)
}
