//! Strips streamed through their correction: every point at its own time, chunk-parallel, written whole or not at all.

mod rays;

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, Result, anyhow};
use nalgebra::Vector3;
use tieline_graph::{Model, PointMap, PoseCorrection};
use tieline_io::las::{EditError, LasFile, RewriteOptions, output_offset, output_scale, rewrite};
use tieline_matching::{End, Rejection, SourceKey, SourceRule, StripIndex};

use crate::job::Matched;
use crate::report::data::FileSummary;
use crate::stage::drive::correction::DriveCorrection;
use crate::stage::drive::cut::{Collector, Found};
use crate::stage::drive::surfaces::Piece;
use crate::stage::solve::Setup;
use crate::stage::trajectory::Poses;
use crate::survey::{Survey, SurveyFile};
use rays::Rays;

/// Spacing of the knots between which corrections are interpolated \[s\].
const KNOT_SPACING_S: f64 = 0.05;

/// The corrections of one strip and scanner, at knots in time.
#[derive(Debug, Clone)]
pub struct Knots {
    start_s: f64,
    per_second: f64,
    maps: Vec<PointMap>,
}

impl Knots {
    /// Knots from `start_s` to `end_s` of a correction over time.
    ///
    /// # Errors
    /// What `map_at` returns.
    pub fn new(start_s: f64, end_s: f64, map_at: impl Fn(f64) -> Result<PointMap>) -> Result<Self> {
        Self::spaced(start_s, end_s, KNOT_SPACING_S, map_at)
    }

    /// Knots from `start_s` to `end_s`, at most `spacing_s` apart.
    ///
    /// # Errors
    /// What `map_at` returns.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    pub fn spaced(start_s: f64, end_s: f64, spacing_s: f64, map_at: impl Fn(f64) -> Result<PointMap>) -> Result<Self> {
        let count = ((end_s - start_s) / spacing_s).ceil().max(1.0) as usize;
        let length_s = (end_s - start_s).max(1e-6);
        let maps = (0..=count).map(|k| map_at(start_s + length_s * k as f64 / count as f64)).collect::<Result<_>>()?;
        Ok(Self { start_s, per_second: count as f64 / length_s, maps })
    }

    /// The map at a time, linear between knots, held beyond the ends.
    #[must_use]
    #[inline]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    pub fn at(&self, time_s: f64) -> PointMap {
        let x = ((time_s - self.start_s) * self.per_second).clamp(0.0, (self.maps.len() - 1) as f64);
        let i = (x as usize).min(self.maps.len() - 2);
        self.maps[i].between(&self.maps[i + 1], x - i as f64)
    }
}

/// Corrections of a survey, ready to be applied to points.
#[derive(Debug)]
pub struct Corrections<'a> {
    strips: &'a StripIndex,
    rule: SourceRule,
    knots: Vec<Vec<Option<Knots>>>,
    /// Range corrections by scanner.
    rays: Rays,
    inverse: bool,
}

impl<'a> Corrections<'a> {
    /// Corrections of a solved model. With `inverse` they are taken off instead of applied.
    ///
    /// # Errors
    /// When a strip has no pose at one of its times.
    pub fn new(
        setup: &Setup,
        model: &Model,
        strips: &'a StripIndex,
        poses: &Poses,
        rule: SourceRule,
        inverse: bool,
    ) -> Result<Self> {
        let mut knots = Vec::new();
        for (i, strip) in strips.strips().iter().enumerate() {
            let number = u32::try_from(i)?;
            let mut of_strip = Vec::new();
            for scanner in 0..strips.scanner_numbers().len() {
                let scanner = u16::try_from(scanner)?;
                if !strip.scanners.contains(&scanner) || setup.is_control[i] {
                    of_strip.push(None);
                    continue;
                }
                let block = setup.block(number, scanner);
                let calibration = model.calibration(block);
                let lever_arm_m = setup.lever_arms_m[block];
                let map_at = |time_s: f64| {
                    let pose = poses
                        .at(number, time_s)
                        .ok_or_else(|| anyhow!("strip {}: no pose at {time_s:.3} s", strip.name))?;
                    let correction = model.pose_correction(i, time_s);
                    Ok(PointMap::new(&pose, &lever_arm_m, &correction, &calibration))
                };
                of_strip.push(Some(Knots::new(strip.start_s, strip.end_s, map_at)?));
            }
            knots.push(of_strip);
        }
        Ok(Self { strips, rule, knots, rays: Rays::none(strips.scanner_numbers().len()), inverse })
    }

    /// Corrections of a drive: the difference of the trajectories and the calibration, range corrections included. With `inverse` they
    /// are taken off instead of applied.
    ///
    /// # Errors
    /// When a trajectory does not cover a strip.
    pub fn of_drive(drive: &DriveCorrection, matched: &'a Matched, inverse: bool) -> Result<Self> {
        let strips = &matched.strips;
        let mut knots = Vec::new();
        for (i, strip) in strips.strips().iter().enumerate() {
            let number = u32::try_from(i)?;
            let mut of_strip = Vec::new();
            for (scanner, corrected) in drive.scanners.iter().enumerate() {
                if !strip.scanners.contains(&u16::try_from(scanner)?) {
                    of_strip.push(None);
                    continue;
                }
                let map_at = |time_s: f64| {
                    let not_covered = || anyhow!("strip {}: no pose at {time_s:.3} s", strip.name);
                    let old = matched.poses.at(number, time_s).ok_or_else(not_covered)?;
                    let new = drive.pose_at(time_s + corrected.latency_s).ok_or_else(not_covered)?;
                    let correction = PoseCorrection {
                        position_ned_m: old.ned_vector_m(&new.position),
                        rotation_ned_rad: (new.ned_from_body * old.ned_from_body.inverse()).scaled_axis(),
                    };
                    Ok(PointMap::new(&old, &corrected.lever_arm_m, &correction, &corrected.calibration))
                };
                of_strip.push(Some(Knots::new(strip.start_s, strip.end_s, map_at)?));
            }
            knots.push(of_strip);
        }
        let rays = Rays::new(&drive.scanners, matched.survey.origin());
        let mut corrections = Self { strips, rule: matched.rule, knots, rays, inverse };
        if corrections.rays.is_over_incidence() {
            let pieces: Vec<Piece> = corrections.pieces(matched).collect();
            corrections.rays.learn(pieces.into_iter());
        }
        Ok(corrections)
    }

    /// The matched patches where the corrections take them; what was not taken for a false one.
    fn pieces(&self, matched: &'a Matched) -> impl Iterator<Item = Piece> {
        let origin_m = matched.survey.origin();
        let is_right = |end: &&End| end.rejection.is_none_or(|why| why == Rejection::Budget);
        let ends = matched.ties.lines.iter().flat_map(|line| &line.ends).filter(is_right).map(|end| &end.patch);
        ends.chain(&matched.ties.lone).filter_map(move |patch| {
            let scanner = usize::from(patch.sighting.scanner);
            let knots = self.knots.get(usize::try_from(patch.sighting.strip).ok()?)?.get(scanner)?.as_ref()?;
            let map = knots.at(patch.time_s);
            let middle_m = patch.centroid_m + origin_m;
            let moved = |point_m: Vector3<f64>| point_m + map.delta_m(&point_m);
            let there_m = moved(middle_m);
            let scanner_m = map.scanner_m + map.shift_m;
            let lengthened_m = self.rays.lengthened(scanner, &scanner_m, f64::from(patch.intensity), &there_m);
            let normal = (moved(middle_m + patch.normal) - there_m).normalize();
            Some(Piece { middle_m: lengthened_m - origin_m, normal, points: patch.points })
        })
    }

    /// Moves a point \[m\] of a source at a survey time \[s\]; `None` when the source is not known.
    #[inline]
    fn apply(
        &self,
        (source, time_s): (SourceKey, f64),
        intensity: u16,
        point: &Vector3<f64>,
        last: &mut LastStrip,
    ) -> Option<Vector3<f64>> {
        if last.source != source || !(time_s >= last.start_s && time_s <= last.end_s) {
            let (strip, scanner) = self.strips.find(source, time_s)?;
            let s = &self.strips.strips()[strip as usize];
            *last = LastStrip {
                source,
                start_s: s.start_s,
                end_s: s.end_s,
                strip: strip as usize,
                scanner: usize::from(scanner),
                off_surface: last.off_surface,
            };
        }
        let map = self.knots[last.strip][last.scanner].as_ref()?.at(time_s);
        let (scanner_m, intensity) = (map.scanner_m + map.shift_m, f64::from(intensity));
        if self.inverse {
            return Some(map.undo(&self.rays.measured(last.scanner, &scanner_m, intensity, point)));
        }
        let moved = point + map.delta_m(point);
        let (corrected, is_known) = self.rays.corrected(last.scanner, &scanner_m, intensity, &moved);
        last.off_surface += u64::from(!is_known);
        Some(corrected)
    }
}

struct LastStrip {
    source: SourceKey,
    start_s: f64,
    end_s: f64,
    strip: usize,
    scanner: usize,
    /// Points whose surface is not known well enough for the incidence.
    off_surface: u64,
}

/// Scale of a file's output \[m\]: as asked, else by the rule of [`output_scale`].
#[must_use]
pub fn scale_of(file: &LasFile, asked_m: Option<f64>) -> [f64; 3] {
    asked_m.map_or_else(|| output_scale(file.header().scale), |s| [s; 3])
}

/// Writes one corrected file; points of cuts are collected on the way.
///
/// # Errors
/// When a chunk cannot be read, a point has no strip, or the output cannot be written.
pub fn correct_file(
    file: &SurveyFile,
    output: &Path,
    corrections: &Corrections<'_>,
    collector: &Collector<'_>,
    scale_m: Option<f64>,
    advance: &(dyn Fn(u64) + Sync),
) -> Result<FileSummary> {
    let fields = Fields::new(file, corrections.rule)?;
    let off_surface = AtomicU64::new(0);
    let mut summary = rewrite_moved(&file.las, output, scale_m, advance, |first, records, record_length, points| {
        let source = SourceKey(u64::MAX);
        let mut last = LastStrip { source, start_s: 0.0, end_s: 0.0, strip: 0, scanner: 0, off_surface: 0 };
        let mut largest_square = 0.0_f64;
        let mut found = Found::new();
        for (i, (record, xyz)) in records.chunks_exact(record_length).zip(points.iter_mut()).enumerate() {
            let (source, time_s) = fields.of(record);
            // at the same place in all formats
            let intensity = u16::from_le_bytes([record[12], record[13]]);
            let point = Vector3::from(*xyz);
            let moved = corrections
                .apply((source, time_s), intensity, &point, &mut last)
                .ok_or_else(|| format!("point {} at {time_s:.6} s belongs to no strip", first + i as u64))?;
            largest_square = largest_square.max((moved - point).norm_squared());
            #[allow(clippy::cast_possible_truncation)] // scanners are numbered in 16 bits
            let seen = (time_s, last.scanner as u16);
            collector.look(&mut found, (file.number, first + i as u64), seen, &point, &moved);
            *xyz = moved.into();
        }
        collector.take(found);
        off_surface.fetch_add(last.off_surface, Ordering::Relaxed);
        Ok(largest_square.sqrt())
    })?;
    if corrections.rays.is_over_incidence() && !corrections.inverse {
        summary.notes.push(format!(
            "{} of {} points lie off the matched surfaces: the range correction over incidence leaves them out, or fades towards them",
            off_surface.into_inner(),
            summary.points
        ));
    }
    Ok(summary)
}

/// Writes a file again with its points moved, and says what changed.
///
/// `edit` is given the index of the first point of a block, its raw records, their length and the coordinates \[m\] to
/// change in place; it answers with the largest shift \[m\].
///
/// # Errors
/// When a chunk cannot be read, the edit fails, or the output cannot be written.
pub fn rewrite_moved(
    file: &LasFile,
    output: &Path,
    scale_m: Option<f64>,
    advance: &(dyn Fn(u64) + Sync),
    edit: impl Fn(u64, &[u8], usize, &mut [[f64; 3]]) -> Result<f64, EditError> + Sync,
) -> Result<FileSummary> {
    let header = file.header();
    let scale = scale_of(file, scale_m);
    let options = RewriteOptions {
        scale,
        offset: output_offset(header.min, header.max, scale),
        generating_software: format!("tieline {}", env!("CARGO_PKG_VERSION")),
    };
    let largest = Mutex::new(0.0_f64);
    let report = rewrite(file, output, &options, |first, records, layout, points| {
        let shift_m = edit(first, records, layout.record_length, points)?;
        if let Ok(mut largest) = largest.lock() {
            *largest = largest.max(shift_m);
        }
        advance(points.len() as u64);
        Ok(())
    })
    .with_context(|| format!("correcting {}", file.path().display()))?;
    let mut notes = report.notes;
    let kept = header.scale.iter().zip(scale).all(|(a, b)| (a - b).abs() < 1e-12);
    notes.push(if kept {
        String::from("header: scale kept; offset, bounds and generating software are new")
    } else {
        format!(
            "header: scale {} → {} m, so that millimetres are not lost; offset, bounds and generating software are new",
            header.scale[0], scale[0]
        )
    });
    Ok(FileSummary {
        input: file.path().display().to_string(),
        output: output.display().to_string(),
        points: report.points,
        largest_shift_m: largest.into_inner().unwrap_or_default(),
        scale_m: scale,
        notes,
    })
}

/// Source and time of a raw record.
struct Fields {
    rule: SourceRule,
    file: u16,
    time_at: usize,
    extended: bool,
    time_shift_s: f64,
}

impl Fields {
    fn new(file: &SurveyFile, rule: SourceRule) -> Result<Self> {
        let layout = file.las.layout();
        let time_at = layout.gps_time.ok_or_else(|| anyhow!("{}: no GPS time", file.las.path().display()))?;
        Ok(Self { rule, file: file.number, time_at, extended: layout.extended, time_shift_s: file.time_shift_s })
    }

    #[inline]
    fn of(&self, record: &[u8]) -> (SourceKey, f64) {
        let mut bytes = [0_u8; 8];
        bytes.copy_from_slice(&record[self.time_at..self.time_at + 8]);
        let time_s = f64::from_le_bytes(bytes) + self.time_shift_s;
        // LAS 1.4 R15, tables 7 and 14: user data and point source id stand at 17, 18 or at 17, 20
        let id_at = if self.extended { 20 } else { 18 };
        let id = u16::from_le_bytes([record[id_at], record[id_at + 1]]);
        let channel = if self.extended { (record[15] >> 4) & 3 } else { 0 };
        (self.rule.source_of(self.file, id, channel, record[17]), time_s)
    }
}

/// The files of strips of a survey with the names of their outputs: equal names get their folder's name in front.
#[must_use]
pub fn output_names(survey: &Survey) -> Vec<(usize, String)> {
    let name = |f: &SurveyFile| f.las.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
    let names: Vec<String> = survey.strip_files().map(name).collect();
    survey
        .strip_files()
        .enumerate()
        .map(|(i, file)| {
            let twice = names.iter().filter(|n| **n == names[i]).count() > 1;
            let folder = file.las.path().parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy();
            (i, if twice { format!("{folder}_{}", names[i]) } else { names[i].clone() })
        })
        .collect()
}
