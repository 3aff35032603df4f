//! What files of ties and of corrections hold.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::Result;
use nalgebra::Vector3;
use serde_json::json;
use tieline_io::correction::read_correction;
use tieline_io::ties::read_ties;
use tieline_io::ties::text::TieTextReader;

use super::{Description, count};

pub(super) fn describe_ties(path: &Path) -> Result<Description> {
    let table = read_ties(path)?;
    // a tie is counted once, by its ends together
    let mut ties: BTreeMap<i64, Tie<'_>> = BTreeMap::new();
    let mut strips = BTreeSet::new();
    for row in 0..table.len() {
        let tie = ties.entry(table.tie_id[row]).or_insert_with(|| Tie {
            kind: table.kind.get(row),
            why_not: table.why_not.get(row),
            ..Tie::default()
        });
        tie.used |= table.used[row];
        tie.held_out |= table.held_out[row];
        if !table.strip.get(row).is_empty() {
            strips.insert(table.strip.get(row));
        }
    }
    let (mut kinds, mut reasons): (BTreeMap<&str, u64>, BTreeMap<&str, u64>) = Default::default();
    for tie in ties.values() {
        *kinds.entry(tie.kind).or_default() += 1;
        if !tie.used && !tie.held_out && !tie.why_not.is_empty() {
            *reasons.entry(tie.why_not).or_default() += 1;
        }
    }
    let used = ties.values().filter(|t| t.used).count() as u64;
    let held_out = ties.values().filter(|t| t.held_out).count() as u64;
    let list = |counts: &BTreeMap<&str, u64>| {
        let text: Vec<String> = counts.iter().map(|(name, n)| format!("{} {name}", count(*n))).collect();
        if text.is_empty() { String::from("none") } else { text.join(", ") }
    };
    let (before, after) = (middle_size(&table.residual_before_m), middle_size(&table.residual_after_m));
    let mm = |value: Option<f64>| value.map_or_else(|| String::from("unknown"), |v| format!("{:.1} mm", v * 1e3));
    let lines = vec![
        (
            "ties",
            format!("{} with {} ends in {} strips", count(ties.len() as u64), count(table.len() as u64), strips.len()),
        ),
        ("kinds", list(&kinds)),
        ("used", count(used)),
        ("held out", count(held_out)),
        ("not used", list(&reasons)),
        ("residuals", format!("middle size {} before, {} after", mm(before), mm(after))),
    ];
    let json = json!({
        "ties": ties.len(), "ends": table.len(), "strips": strips, "kinds": kinds, "used": used, "held_out": held_out,
        "not_used": reasons, "residual_median_size_m": { "before": before, "after": after },
    });
    Ok(Description { lines, json })
}

pub(super) fn describe_tie_text(path: &Path) -> Result<Description> {
    let reader = TieTextReader::open(path)?;
    let week = reader.header().week;
    let (mut ties, mut sightings, mut used) = (0_u64, 0_u64, 0_u64);
    let mut classes: BTreeMap<&str, u64> = BTreeMap::new();
    let (mut first_s, mut last_s) = (f64::INFINITY, f64::NEG_INFINITY);
    for tie in reader {
        let tie = tie?;
        ties += 1;
        sightings += tie.sightings.len() as u64;
        used += u64::from(tie.for_smoother(0.0).is_some());
        *classes.entry(tie.class.as_str()).or_default() += 1;
        first_s = first_s.min(tie.sightings[0].time_s);
        last_s = tie.sightings.iter().map(|s| s.time_s).fold(last_s, f64::max);
    }
    let of_week = week.map_or_else(|| String::from("an unknown week"), |w| format!("week {w}"));
    let span_s = (ties > 0).then_some([first_s, last_s]);
    let listed: Vec<String> = classes.iter().map(|(name, n)| format!("{} {name}", count(*n))).collect();
    let lines = vec![
        ("ties", format!("{} with {} sightings", count(ties), count(sightings))),
        ("classes", if listed.is_empty() { String::from("none") } else { listed.join(", ") }),
        ("used", count(used)),
        (
            "time",
            span_s.map_or_else(|| String::from("none"), |s| format!("{:.1} s to {:.1} s of {of_week}", s[0], s[1])),
        ),
    ];
    let json = json!({
        "ties": ties, "sightings": sightings, "classes": classes, "used": used, "gps_week": week, "span_s": span_s,
    });
    Ok(Description { lines, json })
}

#[derive(Default)]
struct Tie<'a> {
    kind: &'a str,
    why_not: &'a str,
    used: bool,
    held_out: bool,
}

/// Median of the absolute values that are known.
fn middle_size(values: &[f64]) -> Option<f64> {
    let mut sizes: Vec<f64> = values.iter().filter(|v| v.is_finite()).map(|v| v.abs()).collect();
    if sizes.is_empty() {
        return None;
    }
    let half = sizes.len() / 2;
    Some(*sizes.select_nth_unstable_by(half, f64::total_cmp).1)
}

pub(super) fn describe_correction(path: &Path) -> Result<Description> {
    let correction = read_correction(path)?;
    let rows = correction.rows();
    let (first_s, last_s) = (rows[0].time_s, rows[rows.len() - 1].time_s);
    let largest =
        |of: &dyn Fn(usize) -> Vector3<f64>| (0..rows.len()).map(of).fold(Vector3::zeros(), |a, v| a.sup(&v.abs()));
    let position = largest(&|k| rows[k].position_enu_m);
    let attitude = largest(&|k| rows[k].attitude_rph_rad).map(f64::to_degrees);
    let lines = vec![
        ("rows", count(rows.len() as u64)),
        ("time", format!("{first_s:.3} s to {last_s:.3} s")),
        ("largest shift", format!("east {:.3} m, north {:.3} m, up {:.3} m", position.x, position.y, position.z)),
        ("largest turn", format!("roll {:.4}°, pitch {:.4}°, heading {:.4}°", attitude.x, attitude.y, attitude.z)),
    ];
    let json = json!({
        "rows": rows.len(), "span_s": [first_s, last_s],
        "largest_enu_m": position.as_slice(), "largest_rph_deg": attitude.as_slice(),
    });
    Ok(Description { lines, json })
}
