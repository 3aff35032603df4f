//! Clouds of the real flight lines 706 and 707.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use nalgebra::Vector3;
use tieline_io::las::{Columns, LasFile};
use tieline_matching::xyz::Cloud;

use crate::prove::real::root;

/// Points in a local frame, in order of time.
#[derive(Debug, Clone, Default)]
pub(super) struct Points {
    pub(super) points_m: Vec<Vector3<f64>>,
    pub(super) time_s: Vec<f64>,
}

impl Points {
    pub(super) fn cloud(&self) -> Cloud<'_> {
        Cloud { points_m: &self.points_m, time_s: &self.time_s }
    }

    /// The points whose number, place and pulse are wanted; a pulse is all points of one time.
    pub(super) fn only(&self, wanted: impl Fn(usize, &Vector3<f64>, usize) -> bool) -> Self {
        let (mut kept, mut pulse) = (Self::default(), 0);
        for (k, (point, time)) in self.points_m.iter().zip(&self.time_s).enumerate() {
            pulse += usize::from(k > 0 && *time > self.time_s[k - 1]);
            if wanted(k, point, pulse) {
                kept.points_m.push(*point);
                kept.time_s.push(*time);
            }
        }
        kept
    }

    pub(super) fn shifted(mut self, shift_m: &Vector3<f64>) -> Self {
        self.points_m.iter_mut().for_each(|p| *p += shift_m);
        self
    }
}

/// South-west corner of the six tiles \[m\], the zero of the local frame.
const CORNER_M: [f64; 3] = [770_500.0, 6_277_500.0, 0.0];

/// Flight lines 706 and 707, all points.
pub(super) fn flight_lines() -> Result<[Points; 2]> {
    let folder = root().join("../shared/data/als-ign-dual-scanner");
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)?.filter_map(|e| e.ok().map(|e| e.path())).collect();
    files.retain(|p| p.extension().is_some_and(|e| e == "laz"));
    files.sort();
    ensure!(files.len() == 6, "{}: six tiles are expected, {} found", folder.display(), files.len());
    let mut found: [Vec<(f64, Vector3<f64>)>; 2] = Default::default();
    for file in &files {
        let file = LasFile::open(file)?;
        let (scale, offset) = (file.header().scale, file.header().offset);
        let (mut records, mut columns) = (Vec::new(), Columns::default());
        for chunk in 0..file.chunk_count() {
            file.read_columns(chunk, &mut records, &mut columns)?;
            for k in 0..columns.len() {
                let raw = [columns.x[k], columns.y[k], columns.z[k]];
                let at = |i: usize| f64::from(raw[i]) * scale[i] + (offset[i] - CORNER_M[i]);
                let line = usize::from(columns.point_source_id[k] == 707);
                found[line].push((columns.gps_time[k], Vector3::new(at(0), at(1), at(2))));
            }
        }
    }
    Ok(found.map(|mut line| {
        line.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (time_s, points_m) = line.into_iter().unzip();
        Points { points_m, time_s }
    }))
}
