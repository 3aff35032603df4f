//! The points of stations, scanner by scanner.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context, Result, bail};
use nalgebra::Vector3;
use tieline_io::las::{Columns, FLAG_WITHHELD, LasFile};

use super::{Mounts, Spin, Station};
use crate::project::{Project, ScannerChoice};
use crate::survey::expand;

/// Points nearer than this are the vehicle or none \[m\].
const LEAST_RANGE_M: f64 = 0.3;
/// Classes of noise in LAS 1.4.
const NOISE: [u8; 2] = [7, 18];

/// Stations and the files they came from with their points.
#[derive(Debug, Clone, Default)]
pub struct Read {
    /// Stations, in the order of their files.
    pub stations: Vec<Station>,
    /// Files and their points.
    pub inputs: Vec<(String, u64)>,
    /// What a user should be told.
    pub notes: Vec<String>,
}

/// Reads the stations of a project.
///
/// # Errors
/// Files that cannot be read; scanners that are in the points and not in the mounting, and the other way round.
pub fn stations(project: &Project, mounts: &Mounts) -> Result<Read> {
    let mut read = Read::default();
    let mut found: BTreeMap<u16, u64> = BTreeMap::new();
    let mut seen = BTreeSet::new();
    for section in &project.stations {
        let paths = expand(project, &section.path).with_context(|| format!("stations.path = \"{}\"", section.path))?;
        for path in paths {
            if !seen.insert(path.clone()) {
                bail!("{} is named by two [[stations]]; name each file once", path.display());
            }
            file(&path, section.scanner, mounts, &mut found, &mut read)?;
        }
    }
    let known: Vec<u16> = mounts.heads.iter().map(|h| h.scanner).collect();
    let numbers: Vec<u16> = found.keys().copied().collect();
    if let Some(missing) = numbers.iter().find(|n| !known.contains(n)) {
        bail!(
            "the points hold scanners {numbers:?} and the rough extrinsics {known:?}: scanner {missing} has no row; \
             add it, or say with stations.scanner where the number of the scanner stands"
        );
    }
    if let Some(head) = mounts.heads.iter().find(|h| !found.contains_key(&h.scanner)) {
        bail!(
            "the rough extrinsics hold scanner {} ({}) and the points only {numbers:?}: remove its row, or say with \
             stations.scanner where the number of the scanner stands",
            head.scanner,
            head.name
        );
    }
    if mounts.heads.len() < 2 {
        bail!("one scanner alone cannot be calibrated against another; a second one is needed");
    }
    Ok(read)
}

fn file(
    path: &Path,
    choice: ScannerChoice,
    mounts: &Mounts,
    found: &mut BTreeMap<u16, u64>,
    read: &mut Read,
) -> Result<()> {
    let las = LasFile::open(path)?;
    let header = las.header();
    let (scale, offset) = (header.scale, header.offset);
    let mut sums: BTreeMap<u16, Vec<Spin>> = BTreeMap::new();
    let (mut records, mut columns, mut points) = (Vec::new(), Columns::default(), 0_u64);
    for chunk in 0..las.chunk_count() {
        las.read_columns(chunk, &mut records, &mut columns)?;
        points += columns.len() as u64;
        for i in 0..columns.len() {
            if columns.flags[i] & FLAG_WITHHELD != 0 || NOISE.contains(&columns.classification[i]) {
                continue;
            }
            let scanner = match choice {
                ScannerChoice::Auto | ScannerChoice::Channel => u16::from(columns.scanner_channel[i]),
                ScannerChoice::UserData => u16::from(columns.user_data[i]),
                ScannerChoice::Single => mounts.heads.first().map_or(0, |h| h.scanner),
                ScannerChoice::File => bail!(
                    "stations.scanner = \"file\": a station's scanners stand in one file; use \"channel\" or \"user-data\""
                ),
            };
            *found.entry(scanner).or_default() += 1;
            let Some(head) = mounts.heads.iter().position(|h| h.scanner == scanner) else { continue };
            let steps = [columns.x[i], columns.y[i], columns.z[i]];
            let point_m = Vector3::from_fn(|k, _| f64::from(steps[k]) * scale[k] + offset[k]);
            if point_m.norm() < LEAST_RANGE_M {
                continue;
            }
            let spins = sums.entry(columns.point_source_id[i]).or_default();
            spins.resize(mounts.heads.len(), Spin::default());
            spins[head].points_m.push(point_m);
            spins[head].intensity.push(columns.intensity[i]);
            spins[head].time_s.push(columns.gps_time.get(i).copied().filter(|t| t.is_finite()).unwrap_or(0.0));
        }
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    if sums.is_empty() {
        read.notes.push(format!("{}: no points of these scanners", path.display()));
    }
    let several = sums.len() > 1;
    for (id, spins) in sums {
        let name = if several { format!("{stem}/{id}") } else { stem.clone() };
        read.stations.push(Station { name, spins });
    }
    read.inputs.push((path.display().to_string(), points));
    Ok(())
}
