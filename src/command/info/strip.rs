//! What a LAS, LAZ or COPC file says about itself, and what a sample of its points shows.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use serde_json::json;
use tieline_filter::{SurveyClock, TimeEncoding};
use tieline_io::crs::Crs;
use tieline_io::las::{Columns, LasFile, TimeGuess, guess_time};

use super::{Description, count};

/// Chunks of the sample, spread over the file.
const SAMPLED_CHUNKS: usize = 9;

pub(super) fn describe(path: &Path) -> Result<Description> {
    let file = LasFile::open(path)?;
    let header = file.header();
    let sample = Sample::of(&file)?;
    let guess = TimeGuess { sampled_range_s: sample.range_s, ..guess_time(&file)? };
    let of_sample = if sample.points == header.point_count { "" } else { " (of a sample)" };
    let extra = extra_bytes(&file.record("LASF_Spec", 4)?);
    let format = match (header.is_copc, header.is_compressed) {
        (true, _) => "COPC",
        (false, true) => "LAZ",
        (false, false) => "LAS",
    };
    let crs = match (&header.wkt, header.epsg) {
        (Some(wkt), _) => Some(Crs::parse(wkt)),
        (None, Some(code)) => Some(Crs::from_epsg(code)),
        (None, None) => None,
    };
    let crs_text = match &crs {
        Some(Ok(crs)) => match crs.vertical() {
            Some(vertical) => format!("{}, heights {vertical}", crs.name()),
            None => crs.name().to_string(),
        },
        Some(Err(error)) => format!("cannot be used: {error}"),
        None => String::from("not named"),
    };
    let utc = utc_span(&guess);
    let box_text = |k: usize| format!("{:.3} to {:.3}", header.min[k], header.max[k]);
    let vlrs: Vec<String> = header
        .vlrs
        .iter()
        .map(|v| {
            format!("{} {} ({} bytes{})", v.user_id, v.record_id, v.length, if v.is_extended { ", EVLR" } else { "" })
        })
        .collect();
    let mut lines = vec![
        ("format", format!("{format} {}.{}, point format {}", header.version.0, header.version.1, header.point_format)),
        ("points", count(header.point_count)),
        ("east [m]", box_text(0)),
        ("north [m]", box_text(1)),
        ("height [m]", box_text(2)),
        ("scale, offset [m]", format!("{:?}, {:?}", header.scale, header.offset)),
        ("reference system", crs_text.clone()),
        ("time", time_text(&guess, of_sample)),
    ];
    if let Some((first, last)) = &utc {
        lines.push(("date", format!("{first} to {last}{of_sample}")));
    }
    lines.push(("point source ids", format!("{} (of {} points)", list(&sample.sources), count(sample.points))));
    lines.push(("scanner channels", list(&sample.channels)));
    if sample.user_data.len() > 1 {
        lines.push(("user data", list(&sample.user_data)));
    }
    lines.push(("returns", list(&sample.returns)));
    lines.push(("classes", list(&sample.classes)));
    if !extra.is_empty() || header.extra_bytes_per_point > 0 {
        lines.push(("extra bytes", format!("{} a point: {}", header.extra_bytes_per_point, extra.join(", "))));
    }
    lines.push(("records", if vlrs.is_empty() { String::from("none") } else { vlrs.join(", ") }));
    lines.push(("software", format!("{} / {}", header.system_identifier, header.generating_software)));
    let json = json!({
        "format": format, "version": format!("{}.{}", header.version.0, header.version.1),
        "point_format": header.point_format, "points": header.point_count,
        "min_m": header.min, "max_m": header.max, "scale_m": header.scale, "offset_m": header.offset,
        "crs": match &crs { Some(Ok(crs)) => Some(crs.name()), _ => None },
        "epsg": header.epsg, "crs_note": crs_text,
        "time": {
            "encoding": guess.encoding.map(word), "claimed": word(guess.claimed), "note": guess.note,
            "sampled_range_s": guess.sampled_range_s, "utc": utc,
        },
        "sample": {
            "points": sample.points, "point_source_id": sample.sources, "scanner_channel": sample.channels,
            "user_data": sample.user_data, "number_of_returns": sample.returns, "class": sample.classes,
        },
        "extra_bytes": extra, "extra_bytes_per_point": header.extra_bytes_per_point,
        "records": header.vlrs.iter().map(|v| json!({
            "user_id": v.user_id, "record_id": v.record_id, "description": v.description, "bytes": v.length,
            "extended": v.is_extended,
        })).collect::<Vec<_>>(),
        "chunks": file.chunk_count(), "file_bytes": file.file_length(), "file_source_id": header.file_source_id,
        "system_identifier": header.system_identifier, "generating_software": header.generating_software,
    });
    Ok(Description { lines, json })
}

/// Values with the number of points that have them.
type Counts = BTreeMap<u16, u64>;

/// What a sample of the points shows.
#[derive(Default)]
struct Sample {
    points: u64,
    range_s: Option<[f64; 2]>,
    sources: Counts,
    channels: Counts,
    user_data: Counts,
    returns: Counts,
    classes: Counts,
}

impl Sample {
    fn of(file: &LasFile) -> Result<Self> {
        let mut sample = Self::default();
        let (mut records, mut columns) = (Vec::new(), Columns::default());
        let last = file.chunk_count().saturating_sub(1);
        let taken = SAMPLED_CHUNKS.min(last + 1);
        for k in 0..taken {
            file.read_columns(last * k / (taken - 1).max(1), &mut records, &mut columns)?;
            for time_s in columns.gps_time.iter().filter(|t| t.is_finite()) {
                let range = sample.range_s.get_or_insert([*time_s; 2]);
                *range = [range[0].min(*time_s), range[1].max(*time_s)];
            }
            sample.points += columns.len() as u64;
            let tally = |counts: &mut Counts, value: u16| *counts.entry(value).or_default() += 1;
            columns.point_source_id.iter().for_each(|v| tally(&mut sample.sources, *v));
            columns.scanner_channel.iter().for_each(|v| tally(&mut sample.channels, u16::from(*v)));
            columns.user_data.iter().for_each(|v| tally(&mut sample.user_data, u16::from(*v)));
            columns.number_of_returns.iter().for_each(|v| tally(&mut sample.returns, u16::from(*v)));
            columns.classification.iter().for_each(|v| tally(&mut sample.classes, u16::from(*v)));
        }
        Ok(sample)
    }
}

fn list(counts: &Counts) -> String {
    const MOST: usize = 12;
    let total: u64 = counts.values().sum();
    let mut text: Vec<String> = counts
        .iter()
        .take(MOST)
        .map(|(value, n)| match counts.len() {
            1 => value.to_string(),
            _ => format!("{value} ({} %)", (100 * n + total / 2) / total.max(1)),
        })
        .collect();
    if counts.len() > MOST {
        text.push(format!("and {} more", counts.len() - MOST));
    }
    text.join(", ")
}

/// Names and types of the attributes beyond the point format: records of 192 bytes (LAS 1.4, table 24).
fn extra_bytes(contents: &[u8]) -> Vec<String> {
    const TYPES: [&str; 10] = ["u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64"];
    contents
        .chunks_exact(192)
        .map(|record| {
            let name: Vec<u8> = record[4..36].iter().copied().take_while(|b| *b != 0).collect();
            let of_type = usize::from(record[2]).checked_sub(1).and_then(|k| TYPES.get(k)).unwrap_or(&"bytes");
            format!("{} ({of_type})", String::from_utf8_lossy(&name))
        })
        .collect()
}

fn word(encoding: TimeEncoding) -> &'static str {
    match encoding {
        TimeEncoding::AdjustedStandard => "adjusted",
        TimeEncoding::SecondsOfWeek => "gps-week",
    }
}

fn time_text(guess: &TimeGuess, of_sample: &str) -> String {
    let mut text = match guess.encoding {
        Some(TimeEncoding::AdjustedStandard) => String::from("adjusted GPS time"),
        Some(TimeEncoding::SecondsOfWeek) => String::from("seconds of a GPS week"),
        None => String::from("none that can be used"),
    };
    if let Some([least_s, greatest_s]) = guess.sampled_range_s {
        text.push_str(&format!(", {least_s:.6} s to {greatest_s:.6} s{of_sample}"));
    }
    if let Some(note) = &guess.note {
        text.push_str(&format!("; {note}"));
    }
    text
}

fn utc_span(guess: &TimeGuess) -> Option<(String, String)> {
    let [least_s, greatest_s] = guess.sampled_range_s?;
    let clock = SurveyClock::from_adjusted_s(least_s);
    (guess.encoding? == TimeEncoding::AdjustedStandard).then_some(())?;
    let shift_s = clock.shift_s(TimeEncoding::AdjustedStandard)?;
    let text = |time_s: f64| clock.gps_time(time_s + shift_s).map(|t| t.utc_text());
    text(least_s).zip(text(greatest_s))
}
