//! What a file of inertial, GNSS or odometer measurements holds.

use std::path::Path;

use serde_json::json;
use tieline_filter::{FixQuality, SurveyClock, TimeEncoding};
use tieline_io::measurements::{
    GnssFile, GnssReadOptions, ImuFile, ImuReadOptions, OdometerFile, read_gnss, read_imu, read_odometer,
};

use super::kind::FileKind;
use super::{Description, count};

/// Mean specific force of a platform near the earth's surface \[m/s²\]: what else has seven columns has another.
const PLAUSIBLE_FORCE_MPS2: std::ops::Range<f64> = 8.0..12.0;

/// Tells what measurements a file holds; `None` when it holds none that can be read without a project file.
pub(super) fn describe(path: &Path) -> Option<(FileKind, Description)> {
    if let Ok(file) = read_imu(path, &ImuReadOptions::default())
        && PLAUSIBLE_FORCE_MPS2.contains(&mean_force_mps2(&file))
    {
        return Some((FileKind::Imu, imu(&file)));
    }
    if let Ok(file) = read_gnss(path, &GnssReadOptions::default())
        && !file.fixes.is_empty()
    {
        return Some((FileKind::Gnss, gnss(&file)));
    }
    read_odometer(path, None).ok().filter(|f| !f.samples.is_empty()).map(|file| (FileKind::Odometer, odometer(&file)))
}

#[allow(clippy::cast_precision_loss)]
fn mean_force_mps2(file: &ImuFile) -> f64 {
    let samples = file.imu.samples();
    let sum: f64 = samples.iter().map(|s| s.velocity_mps.norm()).sum();
    sum / samples.len().max(1) as f64 / file.imu.interval_s()
}

/// Time of the first and last record, as lines for people and fields for machines.
fn span(
    encoding: TimeEncoding,
    week: Option<u32>,
    first_s: f64,
    last_s: f64,
) -> (Vec<(&'static str, String)>, serde_json::Value) {
    let name = match encoding {
        TimeEncoding::AdjustedStandard => "adjusted GPS time",
        TimeEncoding::SecondsOfWeek => "seconds of a GPS week",
    };
    let clock = match (encoding, week) {
        (TimeEncoding::AdjustedStandard, _) => SurveyClock::from_adjusted_s(first_s),
        (TimeEncoding::SecondsOfWeek, week) => SurveyClock { reference_week: week },
    };
    let shift_s = clock.shift_s(encoding).unwrap_or_default();
    let utc = clock.gps_time(first_s + shift_s).map(|t| t.utc_text());
    let mut lines = vec![("time", format!("{name}, {first_s:.3} s to {last_s:.3} s ({:.1} s)", last_s - first_s))];
    lines.extend(week.map(|w| ("GPS week", w.to_string())));
    lines.extend(utc.clone().map(|t| ("begins", t)));
    (lines, json!({ "first_s": first_s, "last_s": last_s, "week": week, "utc": utc }))
}

fn describe_with(
    mut lines: Vec<(&'static str, String)>,
    of_time: (Vec<(&'static str, String)>, serde_json::Value),
    mut json: serde_json::Value,
    notes: &[String],
) -> Description {
    lines.extend(of_time.0);
    lines.extend(notes.iter().map(|n| ("note", n.clone())));
    json["time"] = of_time.1;
    json["notes"] = json!(notes);
    Description { lines, json }
}

fn imu(file: &ImuFile) -> Description {
    let (first_s, last_s) = file.imu.span_s();
    let samples = file.imu.samples().len();
    let rate_hz = 1.0 / file.imu.interval_s();
    let force = mean_force_mps2(file);
    let lines = vec![
        ("samples", format!("{} at {rate_hz:.3} Hz", count(samples as u64))),
        ("numbers are", format!("{:?}", file.kind).to_lowercase()),
        ("specific force", format!("{force:.3} m/s² (mean)")),
    ];
    let json = json!({ "samples": samples, "rate_hz": rate_hz, "mean_force_mps2": force });
    describe_with(lines, span(file.time_encoding, file.week, first_s, last_s), json, &file.notes)
}

#[allow(clippy::cast_precision_loss)]
fn gnss(file: &GnssFile) -> Description {
    let n = file.fixes.len();
    let (first, last) = (&file.fixes[0], &file.fixes[n.max(1) - 1]);
    let interval_s = (last.time_s - first.time_s) / (n.max(2) - 1) as f64;
    let sigma = |k: usize| {
        let mut all: Vec<f64> = file.fixes.iter().map(|f| f.covariance_ned_m2[(k, k)].max(0.0).sqrt()).collect();
        all.sort_by(f64::total_cmp);
        all[n / 2]
    };
    let fixed = file.fixes.iter().filter(|f| f.quality == FixQuality::Fixed).count();
    let velocities = file.fixes.iter().filter(|f| f.velocity.is_some()).count();
    let g = &first.geodetic;
    let lines = vec![
        (
            "fixes",
            format!("{}, one every {interval_s:.2} s on average, {} fixed", count(n as u64), count(fixed as u64)),
        ),
        ("velocities", count(velocities as u64)),
        ("first at", format!("{:.7}° {:.7}° {:.3} m", g.x.to_degrees(), g.y.to_degrees(), g.z)),
        ("sigma", format!("north {:.3}, east {:.3}, down {:.3} m (median)", sigma(0), sigma(1), sigma(2))),
    ];
    let json = json!({ "fixes": n, "fixed": fixed, "velocities": velocities, "interval_s": interval_s,
        "sigma_ned_m": [sigma(0), sigma(1), sigma(2)] });
    describe_with(lines, span(file.time_encoding, file.week, first.time_s, last.time_s), json, &file.notes)
}

fn odometer(file: &OdometerFile) -> Description {
    let n = file.samples.len();
    let (first_s, last_s) = (file.samples[0].time_s, file.samples[n.max(1) - 1].time_s);
    let fastest = file.samples.iter().map(|s| s.speed_mps.abs()).fold(0.0, f64::max);
    let lines = vec![("readings", count(n as u64)), ("speed", format!("up to {fastest:.2} m/s"))];
    let json = json!({ "readings": n, "largest_speed_mps": fastest });
    describe_with(lines, span(file.time_encoding, file.week, first_s, last_s), json, &file.notes)
}
