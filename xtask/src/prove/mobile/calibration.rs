//! Calibration of a simulated drive against its truth.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use nalgebra::{Rotation3, Vector3};

use super::median;

/// Ranges that are judged \[m\].
const RANGES_M: std::ops::RangeInclusive<f64> = 3.0..=60.0;
/// Ranges whose intervals are judged \[m\]: further apart than the curve's knots.
const INTERVALS_AT_M: [f64; 7] = [3.0, 4.0, 5.5, 7.5, 10.0, 13.5, 18.0];

/// What there is to say of one drive.
pub(super) struct Judged {
    /// rms of the curves' errors, common constant removed: by number of points, and every range alike \[m\].
    pub(super) curve_rms_m: [f64; 2],
    /// Farthest range of a curve \[m\], and share of points from 3 to 60 m that lie within the curves.
    pub(super) reach_m: f64,
    pub(super) covered: f64,
    /// Boresight of the second scanner less the first, error \[deg\].
    pub(super) relative_deg: [f64; 3],
    /// Errors over sigmas: boresight between the scanners, and the curves.
    pub(super) ratios: Vec<f64>,
}

/// Rows of a table below a header.
fn table(path: &Path) -> Result<Vec<Vec<f64>>> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let rows = text.lines().skip(1).map(|l| l.split(',').map(|f| f.parse().unwrap_or(f64::NAN)).collect());
    Ok(rows.collect())
}

/// Value at a place of a table sorted by its first column, linear between rows.
fn between(rows: &[(f64, f64)], at: f64) -> f64 {
    let next = rows.partition_point(|r| r.0 < at).clamp(1, rows.len() - 1);
    let (a, b) = (rows[next - 1], rows[next]);
    a.1 + (b.1 - a.1) * (at - a.0) / (b.0 - a.0)
}

fn of_scanner(rows: &[Vec<f64>], scanner: f64) -> Vec<(f64, f64)> {
    rows.iter().filter(|r| (r[0] - scanner).abs() < 0.5).map(|r| (r[1], r[2])).collect()
}

/// Judges the calibration in a folder of results.
pub(super) fn judge(data: &Path, out: &Path) -> Result<Judged> {
    let truth = table(&data.join("truth/bias_functions.csv"))?;
    let counts = table(&data.join("truth/range_hist.csv"))?;
    let found = table(&out.join("range_bias.csv"))?;
    let (mut errors, mut ratios, mut reach_m) = (Vec::new(), Vec::new(), 0.0_f64);
    let (mut inside, mut all) = (0.0, 0.0);
    for scanner in [0.0, 1.0] {
        // the truth counts scanners from 1
        let (bias, hits) = (of_scanner(&truth, scanner + 1.0), of_scanner(&counts, scanner + 1.0));
        let curve: Vec<&Vec<f64>> = found.iter().filter(|r| (r[0] - scanner).abs() < 0.5).collect();
        let (near_m, far_m) = (curve.first().map_or(0.0, |r| r[1]), curve.last().map_or(0.0, |r| r[1]));
        reach_m = reach_m.max(far_m);
        for (range_m, count) in hits.iter().filter(|h| RANGES_M.contains(&h.0)) {
            all += count;
            inside += if (near_m..=far_m).contains(range_m) { *count } else { 0.0 };
        }
        for row in curve.iter().filter(|r| RANGES_M.contains(&r[1])) {
            let error_m = row[2] - between(&bias, row[1]);
            errors.push((error_m, between(&hits, row[1]).max(0.0)));
            if row[3] > 0.0 && INTERVALS_AT_M.iter().any(|m| (m - row[1]).abs() < 1e-6) {
                ratios.push(error_m / row[3]);
            }
        }
    }
    let rms = |weight: &dyn Fn(f64) -> f64| {
        let sum: f64 = errors.iter().map(|e| weight(e.1)).sum();
        let mean = errors.iter().map(|e| weight(e.1) * e.0).sum::<f64>() / sum;
        (errors.iter().map(|e| weight(e.1) * (e.0 - mean).powi(2)).sum::<f64>() / sum).sqrt()
    };
    let (relative_deg, sigma_deg) = relative(data, out)?;
    ratios.extend(relative_deg.iter().zip(sigma_deg).filter(|(_, s)| *s > 0.0).map(|(e, s)| e / s));
    Ok(Judged { curve_rms_m: [rms(&|n| n), rms(&|_| 1.0)], reach_m, covered: inside / all, relative_deg, ratios })
}

/// Error of the boresight between the scanners \[deg\], and its sigma where it was estimated.
fn relative(data: &Path, out: &Path) -> Result<([f64; 3], [f64; 3])> {
    let read = |path: &Path| -> Result<toml::Table> { Ok(std::fs::read_to_string(path)?.parse()?) };
    let truth = read(&data.join("truth/calibration_true.toml"))?;
    let found = read(&out.join("calibration.toml"))?;
    let vector = |value: &toml::Value| -> Vector3<f64> {
        let numbers = value.as_array().into_iter().flatten().filter_map(toml::Value::as_float);
        Vector3::from_iterator(numbers.chain(std::iter::repeat(0.0)).take(3)).map(f64::to_radians)
    };
    let of_truth = |k: usize| -> Result<Rotation3<f64>> {
        let scanner = truth.get(&format!("scanner{}", k + 1)).context("a scanner of the truth")?;
        Ok(Rotation3::new(vector(scanner.get("misalignment_body_deg").context("a boresight of the truth")?)))
    };
    let scanners = found["platform"]["scanner"].as_array().context("scanners")?;
    let of_found = |k: usize| Rotation3::new(vector(&scanners[k]["boresight_deg"]));
    let difference =
        (of_found(1) * of_found(0).inverse()).scaled_axis() - (of_truth(1)? * of_truth(0)?.inverse()).scaled_axis();
    let rows = found.get("relative").and_then(toml::Value::as_array);
    let sigmas: BTreeMap<&str, f64> =
        rows.into_iter().flatten().filter_map(|r| Some((r["name"].as_str()?, r["sigma"].as_float()?))).collect();
    let sigma = ["x", "y", "z"].map(|axis| sigmas.get(format!("boresight {axis}").as_str()).copied().unwrap_or(0.0));
    Ok((difference.map(f64::to_degrees).into(), sigma))
}

/// Share of ratios within the 95 % interval \[%\].
#[allow(clippy::cast_precision_loss)]
pub(super) fn inside_95(ratios: &[f64]) -> f64 {
    100.0 * ratios.iter().filter(|r| r.abs() <= 1.96).count() as f64 / ratios.len().max(1) as f64
}

/// Median and largest of absolute values.
pub(super) fn middle_and_worst(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let mut values: Vec<f64> = values.map(f64::abs).collect();
    (median(&mut values), values.last().copied().unwrap_or(f64::NAN))
}
