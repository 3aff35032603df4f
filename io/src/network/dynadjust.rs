//! `DynAdjust`'s station and measurement text, DNA 3.01: stations with latitude, longitude, height or X, Y, Z; GNSS
//! baselines (G), baseline clusters (X) and point clusters (Y).
//!
//! Baselines of another frame and epoch are turned into GDA2020: from ITRF2014 by the Australian plate motion, from
//! ITRF2008 by GDA94 (Dawson and Woods 2010), as `DynAdjust` does (GDA2020 Technical Manual, chapter 3).

use std::collections::HashMap;
use std::path::Path;

use super::{Fault, Network, NetworkError, Observation, Role, Station, read_text};

/// Half axis and flattening of GRS 80.
const A_M: f64 = 6_378_137.0;
const F: f64 = 1.0 / 298.257_222_101;
/// Rotation rates of the Australian plate about X, Y, Z \[mas/year\].
const PLATE_MAS: [f64; 3] = [1.50379, 1.18346, 1.20716];

/// ITRF2008 to GDA94 at 1994.0 and per year: rotations \[mas\], scale \[ppb\] (Dawson and Woods 2010).
const ITRF2008_TO_GDA94: [(f64, f64); 4] = [(-0.4254, 1.5461), (2.2578, 1.1820), (2.4015, 1.1551), (9.710, 0.109)];
/// GDA94 to GDA2020: rotations \[mas\], scale \[ppb\].
const GDA94_TO_GDA2020: [f64; 4] = [-39.4924, -32.7221, -32.8979, -9.994];

/// Position-vector rotation \[rad\] and scale less 1 from a frame at an epoch (years) to GDA2020.
fn to_gda2020(frame: &str, epoch: f64) -> Option<([f64; 3], f64)> {
    let radians = |mas: f64| (mas * 1e-3 / 3600.0).to_radians();
    match frame {
        "GDA2020" => Some(([0.0; 3], 0.0)),
        "ITRF2014" => Some((PLATE_MAS.map(|rate| radians(rate * (2020.0 - epoch))), 0.0)),
        "ITRF2008" => {
            let years = epoch - 1994.0;
            let sum = |k: usize| ITRF2008_TO_GDA94[k].0 + ITRF2008_TO_GDA94[k].1 * years + GDA94_TO_GDA2020[k];
            Some(([0, 1, 2].map(|k| -radians(sum(k))), sum(3) * 1e-9))
        }
        _ => None,
    }
}

/// Reads a station and a measurement file.
///
/// # Errors
/// [`NetworkError`], naming file and line.
pub fn read(stations: &Path, measurements: &Path) -> Result<Network, NetworkError> {
    let mut net = parse_stations(&read_text(stations)?).map_err(|f| f.of(stations))?;
    parse_measurements(&read_text(measurements)?, &mut net).map_err(|f| f.of(measurements))?;
    Ok(net)
}

/// Columns `from..to` of a line, without spaces around.
fn field(line: &str, from: usize, to: usize) -> &str {
    let end = to.min(line.len());
    if from >= end { "" } else { line.get(from..end).unwrap_or("").trim() }
}

fn number(line: usize, what: &str, word: &str) -> Result<f64, Fault> {
    let number = word.parse::<f64>().ok().filter(|v| v.is_finite());
    number.ok_or_else(|| Fault::new(line, format!("{what}: `{word}` is not a finite number")))
}

/// Degrees, minutes and seconds run together (`-36.3348…` is 36° 33′ 48″) \[rad\].
fn packed_degrees(value: f64) -> f64 {
    let v = value.abs() + 1e-13;
    let degrees = v.trunc();
    let minutes = ((v - degrees) * 100.0).trunc();
    let seconds = ((v - degrees) * 100.0 - minutes) * 100.0;
    value.signum() * (degrees + minutes / 60.0 + seconds / 3600.0).to_radians()
}

fn earth_fixed(latitude: f64, longitude: f64, height_m: f64) -> [f64; 3] {
    let e2 = F * (2.0 - F);
    let (sin, cos) = latitude.sin_cos();
    let n = A_M / (1.0 - e2 * sin * sin).sqrt();
    [(n + height_m) * cos * longitude.cos(), (n + height_m) * cos * longitude.sin(), (n * (1.0 - e2) + height_m) * sin]
}

/// Reads the text of a station file.
///
/// # Errors
/// [`Fault`], naming the line.
pub fn parse_stations(text: &str) -> Result<Network, Fault> {
    let mut net = Network { sigma_apriori: 1.0, ..Network::default() };
    let mut seen = HashMap::new();
    for (at, line) in text.lines().enumerate().map(|(k, l)| (k + 1, l)) {
        if line.starts_with("!#=DNA") {
            if !line.contains("STN") {
                return Err(Fault::new(at, "this is not a station file; give the .stn first, then the .msr"));
            }
            continue;
        }
        if line.starts_with('*') || line.trim().is_empty() {
            continue;
        }
        let name = field(line, 0, 20).to_string();
        let constraints = field(line, 20, 23);
        let kind = field(line, 24, 27);
        let words: Vec<&str> = line.get(27..).unwrap_or("").split_whitespace().collect();
        if words.len() < 3 {
            return Err(Fault::new(at, format!("station `{name}` needs three coordinates")));
        }
        let v = [number(at, "first", words[0])?, number(at, "second", words[1])?, number(at, "third", words[2])?];
        let xyz = match kind {
            "LLH" | "LLh" => earth_fixed(packed_degrees(v[0]), packed_degrees(v[1]), v[2]),
            "XYZ" => v,
            _ => {
                return Err(Fault::new(at, format!("coordinates of type `{kind}` are not supported; LLH and XYZ are")));
            }
        };
        let role = match constraints {
            "CCC" => Role::Fixed,
            "FFF" => Role::Adjusted,
            _ => return Err(Fault::new(at, format!("constraints `{constraints}` are not supported; CCC and FFF are"))),
        };
        if seen.insert(name.clone(), at).is_some() {
            return Err(Fault::new(at, format!("station `{name}` was there before")));
        }
        net.stations.push(Station { name, coordinates_m: xyz.map(Some), roles: [role; 3] });
    }
    if net.stations.is_empty() {
        return Err(Fault::new(1, "there is no station in the file"));
    }
    Ok(net)
}

/// A cluster that is being read.
struct Open {
    kind: char,
    line: usize,
    count: usize,
    scale: f64,
    turn: [f64; 3],
    stretch: f64,
    members: Vec<(Option<usize>, usize, [f64; 3])>,
    /// Lower triangle by rows: own block of each member, then its blocks with later members, as they come.
    numbers: Vec<Vec<[f64; 3]>>,
}

/// Reads the text of a measurement file into a net.
///
/// # Errors
/// [`Fault`], naming the line.
pub fn parse_measurements(text: &str, net: &mut Network) -> Result<(), Fault> {
    let index: HashMap<String, usize> = net.stations.iter().enumerate().map(|(k, s)| (s.name.clone(), k)).collect();
    let find = |at: usize, name: &str| {
        index
            .get(name)
            .copied()
            .ok_or_else(|| Fault::new(at, format!("station `{name}` is nowhere in the station file")))
    };
    let mut open: Option<Open> = None;
    let mut lines = text.lines().enumerate().map(|(k, l)| (k + 1, l)).peekable();
    while let Some((at, line)) = lines.next() {
        if line.starts_with("!#=DNA") {
            if !line.contains("MSR") {
                return Err(Fault::new(at, "this is not a measurement file; give the .stn first, then the .msr"));
            }
            continue;
        }
        let kind = line.chars().next().unwrap_or(' ');
        if kind == '*' || line.trim().is_empty() {
            continue;
        }
        if !matches!(kind, 'G' | 'X' | 'Y') {
            return Err(Fault::new(at, format!("measurements of type `{kind}` are not supported; G, X and Y are")));
        }
        let (first, second) = (find(at, field(line, 2, 22))?, field(line, 22, 42));
        if open.is_none() {
            open = Some(header(at, kind, line)?);
        }
        let Some(cluster) = open.as_mut() else { continue };
        let mut values = [0.0; 3];
        let mut rows = Vec::new();
        for (k, value) in values.iter_mut().enumerate() {
            let (l, text) = lines.next().ok_or_else(|| Fault::new(at, "the measurement is cut off"))?;
            *value = number(l, "value", field(text, 62, 82))?;
            rows.push(triple(l, text, k + 1)?);
        }
        // blocks with the members that follow
        let later = cluster.count - 1 - cluster.members.len();
        for _ in 0..3 * later {
            let (l, text) = lines.next().ok_or_else(|| Fault::new(at, "the covariance is cut off"))?;
            rows.push(triple(l, text, 3)?);
        }
        let member = if kind == 'Y' { (None, first) } else { (Some(first), find(at, second)?) };
        cluster.members.push((member.0, member.1, values));
        cluster.numbers.push(rows);
        if cluster.members.len() == cluster.count
            && let Some(cluster) = open.take()
        {
            net.observations.push(close(cluster)?);
        }
    }
    match open {
        Some(cluster) => Err(Fault::new(cluster.line, "the cluster is cut off")),
        None => Ok(()),
    }
}

/// Up to three numbers of a covariance row.
fn triple(at: usize, line: &str, count: usize) -> Result<[f64; 3], Fault> {
    let mut row = [0.0; 3];
    for (k, value) in row.iter_mut().enumerate().take(count) {
        *value = number(at, "covariance", field(line, 82 + 20 * k, 102 + 20 * k))?;
    }
    Ok(row)
}

fn header(at: usize, kind: char, line: &str) -> Result<Open, Fault> {
    let count = match kind {
        'G' => 1,
        _ => field(line, 42, 62)
            .parse()
            .ok()
            .filter(|n| (1..1000).contains(n))
            .ok_or_else(|| Fault::new(at, format!("`{}` is not a number of members", field(line, 42, 62))))?,
    };
    if kind == 'Y' && field(line, 22, 42) != "XYZ" {
        return Err(Fault::new(at, "point clusters in XYZ alone are supported"));
    }
    let words: Vec<&str> = line.get(62..).unwrap_or("").split_whitespace().collect();
    let scale = words.first().map_or(Ok(1.0), |w| number(at, "scale of the variances", w))?;
    if scale <= 0.0 {
        return Err(Fault::new(at, "the scale of the variances must be above 0"));
    }
    let frame = words.get(4).copied().unwrap_or("GDA2020");
    let epoch = words.get(5).and_then(|w| year(w)).unwrap_or(2020.0);
    let (turn, stretch) = to_gda2020(frame, epoch).ok_or_else(|| {
        Fault::new(at, format!("the frame `{frame}` is not supported; GDA2020, ITRF2014 and ITRF2008 are"))
    })?;
    Ok(Open { kind, line: at, count, scale, turn, stretch, members: Vec::new(), numbers: Vec::new() })
}

/// A date (day.month.year) as a year.
fn year(word: &str) -> Option<f64> {
    let mut parts = word.split('.').map(|p| p.parse::<u32>().ok());
    let (day, month, year) = (parts.next()??, parts.next()??, parts.next()??);
    let before = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334];
    let day = before.get(month.checked_sub(1)? as usize)? + day;
    Some(f64::from(year) + (f64::from(day) - 1.0) / 365.25)
}

fn close(cluster: Open) -> Result<Observation, Fault> {
    let n = 3 * cluster.count;
    let mut covariance = vec![0.0; n * n];
    for (i, rows) in cluster.numbers.iter().enumerate() {
        for (k, row) in rows.iter().enumerate() {
            for (c, value) in row.iter().enumerate() {
                // the own block is a lower triangle, those with later members follow whole
                let (r, column) = (3 * i + k % 3, 3 * (i + k / 3) + c);
                if k < 3 && c > k {
                    continue;
                }
                covariance[r * n + column] = value * cluster.scale;
                covariance[column * n + r] = value * cluster.scale;
            }
        }
    }
    let (w, s) = (cluster.turn, 1.0 + cluster.stretch);
    let members = cluster
        .members
        .into_iter()
        .map(|(a, b, v)| {
            // stations move with the plate: position vector rotation, forward in time
            let turned = if cluster.kind == 'Y' {
                v
            } else {
                [
                    s * v[0] - w[2] * v[1] + w[1] * v[2],
                    s * v[1] + w[2] * v[0] - w[0] * v[2],
                    s * v[2] - w[1] * v[0] + w[0] * v[1],
                ]
            };
            (a, b, turned)
        })
        .collect();
    if nalgebra::DMatrix::from_row_slice(n, n, &covariance).cholesky().is_none() {
        return Err(Fault::new(cluster.line, "the covariance is not positive definite"));
    }
    Ok(Observation::Cluster(members, covariance))
}
