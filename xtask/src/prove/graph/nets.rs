//! Line 1: geodetic nets with known results.

use std::collections::HashMap;

use anyhow::{Context, Result};

use super::super::Row;
use super::{data, graph, number};

const GAMA: [&str; 6] = [
    "Niemeier_Height_free",
    "Ghilani_Wolf_Distance_Angle",
    "Wolf_DistanceDirectionAngle_free",
    "Ghilani_GNSS_Baselines",
    "jezerka-dir",
    "zoltan-test_2d_gon",
];

/// All texts of an element, in order.
fn texts<'a>(xml: &'a str, tag: &str) -> Vec<&'a str> {
    let (open, close) = (format!("<{tag}>"), format!("</{tag}>"));
    xml.split(&open).skip(1).filter_map(|rest| rest.split(&close).next()).map(str::trim).collect()
}

fn first(xml: &str, tag: &str) -> f64 {
    texts(xml, tag).first().and_then(|t| t.parse().ok()).unwrap_or(f64::NAN)
}

/// Coordinates and sigmas by station.
type Stations = HashMap<String, (Vec<Option<f64>>, Vec<f64>)>;

fn stations(value: &serde_json::Value) -> Stations {
    let list = value["stations"].as_array().cloned().unwrap_or_default();
    list.iter()
        .map(|s| {
            let numbers = |key: &str| s[key].as_array().cloned().unwrap_or_default();
            let coordinates = numbers("coordinates_m").iter().map(serde_json::Value::as_f64).collect();
            let sigmas = numbers("sigmas_m").iter().filter_map(serde_json::Value::as_f64).collect();
            (s["name"].as_str().unwrap_or_default().to_string(), (coordinates, sigmas))
        })
        .collect()
}

/// The net of Ghilani with the signs of the covariances between y and the others turned.
///
/// GNU Gama turns y where axes and angles run against each other, but leaves the covariances of vectors as they are:
/// its result is that of a file with these signs.
fn with_gamas_signs(text: &str) -> String {
    let mut out = String::new();
    let mut row = usize::MAX;
    for line in text.lines() {
        let mut line = line.to_string();
        if line.contains("<cov-mat") {
            row = 0;
        } else if row < 3 {
            let mut words: Vec<String> = line.split_whitespace().map(str::to_string).collect();
            for (k, word) in words.iter_mut().enumerate() {
                let column = row + k;
                if (row == 1) != (column == 1) {
                    *word = word.strip_prefix('-').map_or_else(|| format!("-{word}"), str::to_string);
                }
            }
            line = words.join(" ");
            row += 1;
        }
        out += &line;
        out.push('\n');
    }
    out
}

/// Nets of GNU Gama and `DynAdjust`.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for name in GAMA {
        let mut path = data(&format!("gama/{name}.gkf"));
        let folder = tempfile::tempdir()?;
        if name == "Ghilani_GNSS_Baselines" {
            let own = graph(&[path.to_str().context("path")?])?;
            println!(
                "{name} as it stands: m0 {:.7}; below with the covariances' signs as GNU Gama takes them",
                number(&own, "m0")
            );
            let turned = folder.path().join("turned.gkf");
            std::fs::write(&turned, with_gamas_signs(&std::fs::read_to_string(&path)?))?;
            path = turned;
        }
        let value = graph(&[path.to_str().context("path")?])?;
        let xml = std::fs::read_to_string(data(&format!("gama/{name}.xml")))?;
        let found = stations(&value);
        let adjusted = *texts(&xml, "adjusted").first().context("adjusted coordinates")?;
        let flat: Vec<f64> = texts(&xml, "flt").iter().filter_map(|t| t.parse().ok()).collect();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let count = first(&xml, "dim") as usize;
        // rows of the upper triangle begin with the variances
        let mut variances = Vec::new();
        let mut at = 0;
        for k in 0..count {
            variances.push(flat.get(at).copied().unwrap_or(f64::NAN));
            at += count - k;
        }
        let (mut off_mm, mut off_sigma, mut next) = (0.0_f64, 0.0_f64, 0);
        for point in texts(adjusted, "point") {
            let id = *texts(point, "id").first().context("id")?;
            let (coordinates, sigmas) = found.get(id).context("a station of this name")?;
            let mut own = 0;
            for (k, tag) in ["x", "y", "z"].iter().enumerate() {
                let wanted = [first(point, tag), first(point, &tag.to_uppercase())];
                let Some(wanted) = wanted.into_iter().find(|v| v.is_finite()) else { continue };
                off_mm = off_mm.max(1e3 * (coordinates[k].unwrap_or(f64::NAN) - wanted).abs());
                let sigma_mm = variances[next].sqrt();
                off_sigma = off_sigma.max((1e3 * sigmas[own] / sigma_mm - 1.0).abs());
                (own, next) = (own + 1, next + 1);
            }
        }
        rows.push(Row::at_most(format!("{name}: coordinates off"), off_mm, 0.1, "mm"));
        rows.push(Row::at_most(format!("{name}: sigmas off, relative"), off_sigma * 1e4, 1.0, "1e-4"));
        let defect = (number(&value, "defect") - first(&xml, "defect")).abs();
        rows.push(Row::at_most(
            format!("{name}: defect {} and degrees of freedom off", first(&xml, "defect")),
            defect + (number(&value, "dof") - first(&xml, "degrees-of-freedom")).abs(),
            0.0,
            "",
        ));
        // its stored m0 has the a-priori sigma of another version, see the data's README
        let scale = if name.starts_with("Wolf") { 100.0 } else { 1.0 };
        let off = (number(&value, "m0") / scale / first(&xml, "aposteriori") - 1.0).abs();
        rows.push(Row::at_most(format!("{name}: m0 off, relative"), off * 1e6, 1.0, "ppm"));
    }
    for (name, stn, expected, chi2, within) in [
        ("gnss", "gnss-network", "gnss.simult.adj.expected", 336.64, 0.01),
        ("grid20", "grid20", "grid20.coords.expected", 1283.72, 0.01),
    ] {
        let file = |e: &str| data(&format!("dynadjust/{stn}.{e}"));
        let (stn, msr) = (file("stn"), file("msr"));
        let value = graph(&[stn.to_str().context("path")?, msr.to_str().context("path")?])?;
        let found = stations(&value);
        let text = std::fs::read_to_string(data(&format!("dynadjust/{expected}")))?;
        let (mut off_mm, mut off_sigma_mm, mut seen) = (0.0_f64, 0.0_f64, 0.0);
        for line in text.lines().skip_while(|l| !l.starts_with("Adjusted Coordinates")) {
            let Some((coordinates, _)) = line.get(..20).and_then(|n| found.get(n.trim())) else { continue };
            let words: Vec<f64> = line[23..].split_whitespace().filter_map(|w| w.parse().ok()).collect();
            for k in 0..3 {
                off_mm = off_mm.max(1e3 * (coordinates[k].unwrap_or(f64::NAN) - words[4 + k]).abs());
            }
            let (_, sigmas) = &found[line[..20].trim()];
            // the sum of the variances is the same in any frame
            let sum = |v: &[f64]| v.iter().map(|s| s * s).sum::<f64>().sqrt();
            off_sigma_mm = off_sigma_mm.max(1e3 * (sum(sigmas) - sum(&words[7..10])).abs());
            seen += 1.0;
        }
        rows.push(Row::between(format!("{name}: stations compared"), seen, 43.0, 400.0, ""));
        rows.push(Row::at_most(format!("{name}: coordinates off"), off_mm, 0.1, "mm"));
        rows.push(Row::at_most(format!("{name}: sigmas off (printed to 0.1 mm)"), off_sigma_mm, 0.15, "mm"));
        rows.push(Row::at_most(format!("{name}: chi2 {chi2} off"), (number(&value, "chi2") - chi2).abs(), within, ""));
    }
    Ok(rows)
}
