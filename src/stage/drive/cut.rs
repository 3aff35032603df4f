//! Cross-sections of the cloud at its worst places.
//!
//! Where sightings of one surface were furthest apart before anything was corrected, the cloud is cut: a slab along the surface and across the way,
//! a few decimetres thick. The pass that corrects the points collects those that lie in it before or after, a bounded number, the same
//! whatever the order that chunks come in.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tieline_matching::mix;

use super::DriveSolution;
use super::residuals::{Residual, place};
use super::ties::DriveLine;
use crate::job::Matched;
use crate::project::SurfaceWord;

/// What is set against what in a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Between {
    /// Visits to a place, by one strip or several.
    Visits,
    /// Scanners within a visit.
    Scanners,
}

/// Where the cloud is cut.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// What differed there.
    pub between: Between,
    /// Middle of the cut in the cloud as delivered, map \[m\].
    pub before_m: Vector3<f64>,
    /// The same in the corrected cloud.
    pub after_m: Vector3<f64>,
    /// Along the surface and across the way, of walls level: unit vector, map axes.
    pub along: Vector3<f64>,
    /// Normal of the surface, towards the vehicle.
    pub normal: Vector3<f64>,
    /// Half the height of what is shown off the surface \[m\].
    pub half_off_m: f64,
    /// Half the thickness of the slab \[m\].
    pub half_thickness_m: f64,
    /// Lines about the place that differences are the medians of.
    pub lines: usize,
    /// Median of the absolute differences of the lines about it, before and after \[m\].
    pub difference_m: (f64, f64),
    /// Whether the surface is steep.
    pub is_steep: bool,
    /// Survey times of the first and the last sighting of the line in the middle \[s\].
    pub time_s: (f64, f64),
}

/// A point of a cut: along the surface and off it, from the middle \[m\]; none where it does not lie in the slab.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CutPoint {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Scanner.
    pub scanner: u16,
    /// In the cloud as delivered.
    pub before_m: Option<[f32; 2]>,
    /// In the corrected cloud.
    pub after_m: Option<[f32; 2]>,
}

/// Half the length of a cut along the surface \[m\].
pub const HALF_LENGTH_M: f64 = 1.5;
/// Half the thickness of its slab \[m\]: along the way, and in height on walls, which are plumb and seldom hit.
const HALF_THICKNESS_M: f64 = 0.15;
const HALF_THICKNESS_ON_WALLS_M: f64 = 0.3;
/// Places are squares of this width \[m\], with so many lines at least.
const SQUARE_M: f64 = 8.0;
const LEAST_LINES: usize = 4;
/// Cuts of each kind, so far apart at least \[m\].
const CUTS: usize = 3;
const APART_M: f64 = 20.0;
/// What is shown off the surface: so many times the difference either way, and these at least and at most \[m\].
const TIMES_DIFFERENCE: f64 = 2.5;
const HALF_OFF_M: (f64, f64) = (0.03, 1.0);
/// Most points of a cut.
const MOST_POINTS: usize = 3_000;

/// A line seen twice: rows of the line and of two of its ends, their difference before and after \[m\].
struct Seen<'a> {
    line: &'a DriveLine,
    ends: (usize, usize),
    difference_m: (f64, f64),
}

/// The worst places of a drive: those between visits first, the worst of each kind in front.
#[must_use]
pub fn worst(matched: &Matched, drive: &DriveSolution, residuals: &[Residual]) -> Vec<Cut> {
    let mut by_kind: BTreeMap<Between, Vec<Seen<'_>>> = BTreeMap::new();
    for residual in residuals {
        let line = &drive.lines[residual.line];
        let mut put = |between: Between, (a, b): (usize, usize)| {
            let apart = |of: &[f64]| (of[b] - of[a]).abs();
            let difference_m = (apart(&residual.before_m), apart(&residual.after_m));
            if difference_m.0.is_finite() && difference_m.1.is_finite() {
                by_kind.entry(between).or_default().push(Seen { line, ends: (a, b), difference_m });
            }
        };
        if line.visits() > 1 {
            put(Between::Visits, (0, line.ends.len() - 1));
        }
        let of_first: Vec<usize> = (0..line.ends.len()).filter(|k| line.ends[*k].visit == 0).collect();
        if let Some(other) = of_first.iter().find(|k| line.ends[**k].scanner != line.ends[0].scanner) {
            put(Between::Scanners, (0, *other));
        }
    }
    let cut = |(between, seen): (Between, Vec<Seen<'_>>)| -> Vec<Cut> {
        let at = |seen: &Seen<'_>, median_m: (f64, f64), lines: usize| {
            cut_at(matched, drive, between, seen, median_m, lines)
        };
        chosen(&seen).into_iter().filter_map(|(k, median_m, lines)| at(&seen[k], median_m, lines)).collect()
    };
    by_kind.into_iter().flat_map(cut).collect()
}

/// Rows of the lines in the middle of the worst places, with medians there and numbers of lines; of either kind of surface one at least, where
/// there is one.
#[allow(clippy::cast_possible_truncation)] // squares of a survey
fn chosen(seen: &[Seen<'_>]) -> Vec<(usize, (f64, f64), usize)> {
    let mut squares: BTreeMap<(bool, [i64; 2]), Vec<usize>> = BTreeMap::new();
    for (k, s) in seen.iter().enumerate() {
        let square = [s.line.point_map_m.x, s.line.point_map_m.y].map(|v| (v / SQUARE_M).floor() as i64);
        squares.entry((is_steep(s.line), square)).or_default().push(k);
    }
    let mut places = Vec::new();
    for ((steep, _), mut rows) in squares {
        if rows.len() < LEAST_LINES {
            continue;
        }
        let after = median(rows.iter().map(|k| seen[*k].difference_m.1));
        rows.sort_by(|a, b| seen[*a].difference_m.0.total_cmp(&seen[*b].difference_m.0).then(a.cmp(b)));
        let middle = rows[rows.len() / 2];
        places.push((steep, middle, (seen[middle].difference_m.0, after), rows.len()));
    }
    places.sort_by(|a, b| b.2.0.total_cmp(&a.2.0).then(a.1.cmp(&b.1)));
    let mut taken: Vec<(bool, usize, (f64, f64), usize)> = Vec::new();
    for place in places {
        let away = |t: &(bool, usize, (f64, f64), usize)| {
            (seen[t.1].line.point_map_m - seen[place.1].line.point_map_m).xy().norm() >= APART_M
        };
        // the last room is for the other kind of surface, where none of it was taken
        let alike = taken.len() + 1 == CUTS && taken.iter().all(|t| t.0 == place.0);
        if taken.len() < CUTS && taken.iter().all(away) && !alike {
            taken.push(place);
        }
    }
    taken.into_iter().map(|(_, row, median_m, lines)| (row, median_m, lines)).collect()
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn is_steep(line: &DriveLine) -> bool {
    SurfaceWord::of(line.normal_up) == SurfaceWord::Steep
}

fn cut_at(
    matched: &Matched,
    drive: &DriveSolution,
    between: Between,
    seen: &Seen<'_>,
    difference_m: (f64, f64),
    lines: usize,
) -> Option<Cut> {
    let line = seen.line;
    let (a, b) = (&line.ends[seen.ends.0], &line.ends[seen.ends.1]);
    let time_s = |end: &super::ties::End| end.sighting.time_s - drive.clock_shift_s;
    let old = |end: &super::ties::End| place(&matched.poses.at(end.strip, time_s(end))?, &end.delivered_m);
    let constants = &drive.solution.calibration.value;
    let new =
        |end: &super::ties::End| place(&drive.pose_at(time_s(end))?, &end.sighting.calibrated(constants).body_vector_m);
    let pose = drive.pose_at(time_s(a))?;
    let normal = line.normal_map.normalize();
    let along = if is_steep(line) {
        Vector3::z().cross(&normal)
    } else {
        let right = pose.map_from_ned * (pose.ned_from_body * Vector3::y());
        right - normal * normal.dot(&right)
    };
    let along = along.try_normalize(1e-3)?;
    let (low_m, high_m) = HALF_OFF_M;
    Some(Cut {
        between,
        before_m: (old(a)? + old(b)?) * 0.5,
        after_m: (new(a)? + new(b)?) * 0.5,
        along,
        normal,
        half_off_m: (TIMES_DIFFERENCE * difference_m.0).clamp(low_m, high_m),
        half_thickness_m: if is_steep(line) { HALF_THICKNESS_ON_WALLS_M } else { HALF_THICKNESS_M },
        lines,
        difference_m,
        is_steep: is_steep(line),
        time_s: (time_s(a), time_s(b)),
    })
}

impl Cut {
    /// Along the surface and off it \[m\] of a place in the cloud as delivered or corrected; none beyond the slab.
    #[allow(clippy::cast_possible_truncation)] // single precision is far below a millimetre here
    fn within(&self, middle_m: &Vector3<f64>, point_m: &Vector3<f64>) -> Option<[f32; 2]> {
        let d = point_m - middle_m;
        let (along, off) = (self.along.dot(&d), self.normal.dot(&d));
        let across = self.normal.cross(&self.along).dot(&d);
        let inside =
            along.abs() <= HALF_LENGTH_M && off.abs() <= self.half_off_m && across.abs() <= self.half_thickness_m;
        inside.then_some([along as f32, off as f32])
    }
}

/// Collects the points of cuts while a survey is corrected.
#[derive(Debug)]
pub struct Collector<'a> {
    cuts: &'a [Cut],
    /// Middle of the box about each cut and half its width \[m\].
    boxes: Vec<(Vector3<f64>, f64)>,
    /// Points of each cut by a hash of their place in the survey: the lowest are kept.
    kept: Vec<Mutex<BTreeMap<u64, CutPoint>>>,
}

/// The points of cuts that one chunk gives.
pub type Found = Vec<(usize, u64, CutPoint)>;

impl<'a> Collector<'a> {
    /// A collector without points.
    #[must_use]
    pub fn new(cuts: &'a [Cut]) -> Self {
        let about = |c: &Cut| {
            let reach_m = HALF_LENGTH_M.hypot(c.half_off_m).hypot(c.half_thickness_m);
            ((c.before_m + c.after_m) * 0.5, reach_m + 0.5 * (c.before_m - c.after_m).norm())
        };
        let kept = cuts.iter().map(|_| Mutex::new(BTreeMap::new())).collect();
        Self { cuts, boxes: cuts.iter().map(about).collect(), kept }
    }

    /// Looks at a point: number of its file and of itself, its source, where it was and where it came to lie.
    #[inline]
    pub fn look(
        &self,
        found: &mut Found,
        (file, number): (u16, u64),
        (time_s, scanner): (f64, u16),
        before_m: &Vector3<f64>,
        after_m: &Vector3<f64>,
    ) {
        for (k, (middle_m, half_m)) in self.boxes.iter().enumerate() {
            if (before_m.x - middle_m.x).abs() > *half_m || (before_m.y - middle_m.y).abs() > *half_m {
                continue;
            }
            let cut = &self.cuts[k];
            let (was, is) = (cut.within(&cut.before_m, before_m), cut.within(&cut.after_m, after_m));
            if was.is_some() || is.is_some() {
                let point = CutPoint { time_s, scanner, before_m: was, after_m: is };
                found.push((k, mix(mix(u64::from(file) + 1) ^ number), point));
            }
        }
    }

    /// Takes what a chunk gave.
    pub fn take(&self, found: Found) {
        for (k, hash, point) in found {
            let Ok(mut kept) = self.kept[k].lock() else { continue };
            kept.insert(hash, point);
            if kept.len() > MOST_POINTS {
                kept.pop_last();
            }
        }
    }

    /// The points of each cut, in order of time.
    #[must_use]
    pub fn points(self) -> Vec<Vec<CutPoint>> {
        let in_order = |kept: Mutex<BTreeMap<u64, CutPoint>>| {
            let mut points: Vec<(u64, CutPoint)> = kept.into_inner().unwrap_or_default().into_iter().collect();
            points.sort_by(|a, b| a.1.time_s.total_cmp(&b.1.time_s).then(a.0.cmp(&b.0)));
            points.into_iter().map(|(_, point)| point).collect()
        };
        self.kept.into_iter().map(in_order).collect()
    }
}

/// Scanners of points, in order.
#[must_use]
pub fn scanners(points: &[CutPoint]) -> BTreeSet<u16> {
    points.iter().map(|p| p.scanner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut() -> Cut {
        Cut {
            between: Between::Visits,
            before_m: Vector3::new(100.0, 50.0, 2.0),
            after_m: Vector3::new(100.1, 50.0, 2.05),
            along: Vector3::x(),
            normal: Vector3::z(),
            half_off_m: 0.2,
            half_thickness_m: 0.1,
            lines: 5,
            difference_m: (0.08, 0.002),
            is_steep: false,
            time_s: (10.0, 70.0),
        }
    }

    #[test]
    fn points_are_told_before_and_after_from_the_middle_of_each() {
        let cuts = [cut()];
        let collector = Collector::new(&cuts);
        let mut found = Found::new();
        let mut look = |number: u64, before: [f64; 3], after: [f64; 3]| {
            collector.look(&mut found, (0, number), (10.0, 1), &Vector3::from(before), &Vector3::from(after));
        };
        look(0, [101.0, 50.05, 2.1], [101.1, 50.05, 2.05]);
        look(1, [101.0, 50.2, 2.1], [101.1, 50.05, 2.05]); // comes in
        look(2, [101.0, 50.2, 2.1], [101.1, 50.2, 2.05]); // beside
        look(3, [101.0, 50.0, 2.3], [101.1, 50.0, 2.4]); // above
        collector.take(found);
        let points = collector.points();
        assert_eq!(points[0].len(), 2);
        let near = |a: Option<[f32; 2]>, b: [f32; 2]| a.is_some_and(|a| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-5);
        let whole = points[0].iter().find(|p| p.before_m.is_some()).expect("in both");
        assert!(near(whole.before_m, [1.0, 0.1]) && near(whole.after_m, [1.0, 0.0]), "{whole:?}");
        assert!(points[0].iter().any(|p| p.before_m.is_none() && p.after_m.is_some()));
    }

    #[test]
    fn what_is_kept_is_bounded_and_does_not_depend_on_the_order_of_chunks() {
        let cuts = [cut()];
        let collected = |numbers: &mut dyn Iterator<Item = u64>| {
            let collector = Collector::new(&cuts);
            for number in numbers {
                let mut found = Found::new();
                let x = 99.0 + (number % 1000) as f64 * 0.002;
                let point = Vector3::new(x, 50.0, 2.0);
                collector.look(&mut found, (0, number), (number as f64 * 1e-3, 0), &point, &point);
                collector.take(found);
            }
            collector.points()
        };
        let (one, other) = (collected(&mut (0..9_000)), collected(&mut (0..9_000).rev()));
        assert!(one == other && one[0].len() == MOST_POINTS);
        assert!(one[0].windows(2).all(|w| w[0].time_s <= w[1].time_s));
    }

    #[test]
    fn the_worst_places_are_apart_and_of_both_kinds_of_surface() {
        let line = |east_m: f64, normal_up: f64| DriveLine {
            row: 0,
            direction: Vector3::z(),
            normal_map: Vector3::z(),
            point_map_m: Vector3::new(east_m, 0.0, 0.0),
            normal_up,
            ends: Vec::new(),
            held_out: false,
        };
        let mut lines = Vec::new();
        for k in 0..40 {
            // ten places 10 m apart, four lines each: ground gets worse with the way; one place of walls, hardly wrong
            lines.push((line(2.0 + 10.0 * f64::from(k / 4), if k < 4 { 0.0 } else { 1.0 }), 0.01 * f64::from(k / 4)));
        }
        let of = |(line, before): &'_ (DriveLine, f64)| (line.clone(), *before);
        let owned: Vec<(DriveLine, f64)> = lines.iter().map(of).collect();
        let seen: Vec<Seen<'_>> =
            owned.iter().map(|(line, before)| Seen { line, ends: (0, 1), difference_m: (*before, 0.001) }).collect();
        let places: Vec<f64> = chosen(&seen).iter().map(|c| seen[c.0].line.point_map_m.x).collect();
        assert_eq!(places, [92.0, 72.0, 2.0]);
        assert!(chosen(&seen).iter().all(|c| c.2 == 4));
    }
}
