//! Lines that say something else than others of their kind about them.
//!
//! A curb face with ground in its patch, a car that moved on between two scanners, a window seen by one of them: such lines are few, but they
//! err to one side and would bend a boresight. After a first adjustment, when calibration and trajectory are nearly right, what the last
//! end of a line lies off the first by is compared with the median of lines of like direction, by the same scanners in the same
//! order, a few seconds about it. The median takes with it what is still wrong in the model: such errors are not hidden by leaving out what
//! shows them.

use std::collections::{BTreeMap, BTreeSet};

use tieline_filter::Trajectory;

use super::choose::direction_class;
use super::merge::{Part, ends};
use super::ties::DriveLine;

/// Further off its neighbours' median than so many standard deviations a line is astray.
const ASTRAY: f64 = 4.0;
/// Neighbours are as far apart as this \[s\].
const NEAR_S: f64 = 3.0;
/// With fewer neighbours their median is not known well enough; the adjustment itself is taken for it.
const FEWEST: usize = 5;
/// Median of absolute values of a normal distribution over its standard deviation.
const MAD_PER_SIGMA: f64 = 0.674_489_750_196_081_7;

/// Direction, first and last scanner, whether of several visits.
type Kind = (u8, [u16; 2], bool);

/// What a part says.
struct Said {
    part: Part,
    time_s: f64,
    /// Last end less first along the normal, over its standard deviation.
    apart: f64,
}

/// The parts that are astray, by an adjustment: values of the constants, and the trajectory in the map on the strips' clock.
#[must_use]
pub fn find(lines: &[DriveLine], constants: &[f64], trajectory: &Trajectory, clock_shift_s: f64) -> BTreeSet<Part> {
    let mut by_kind: BTreeMap<Kind, Vec<Said>> = BTreeMap::new();
    for (row, line) in lines.iter().enumerate().filter(|(_, l)| !l.held_out) {
        let visits = (0..line.visits()).map(Some).chain((line.visits() > 1).then_some(None));
        for visit in visits {
            let of_part: Vec<_> = ends(line, visit).collect();
            let [first, .., last] = of_part[..] else { continue };
            let place = |end: &super::ties::End| {
                let pose = trajectory.pose_at(end.sighting.time_s - clock_shift_s)?;
                let body_m = end.sighting.calibrated(constants).body_vector_m;
                Some((pose.position + pose.map_from_ned * (pose.ned_from_body * body_m)).dot(&line.normal_map))
            };
            let (Some(a_m), Some(b_m)) = (place(first), place(last)) else { continue };
            let variance_m2 = first.sighting.covariance_m2[(0, 0)] + last.sighting.covariance_m2[(0, 0)];
            let said =
                Said { part: (row, visit), time_s: first.sighting.time_s, apart: (b_m - a_m) / variance_m2.sqrt() };
            let kind = (direction_class(line), [first.scanner, last.scanner], visit.is_none());
            by_kind.entry(kind).or_default().push(said);
        }
    }
    by_kind.into_values().flat_map(of_kind).collect()
}

/// Those of one kind.
fn of_kind(mut said: Vec<Said>) -> Vec<Part> {
    said.sort_by(|a, b| a.time_s.total_cmp(&b.time_s).then(a.part.cmp(&b.part)));
    let mut off = Vec::with_capacity(said.len());
    let (mut from, mut to) = (0, 0);
    for one in &said {
        while said[from].time_s < one.time_s - NEAR_S {
            from += 1;
        }
        while to < said.len() && said[to].time_s <= one.time_s + NEAR_S {
            to += 1;
        }
        let mut near: Vec<f64> = said[from..to].iter().map(|s| s.apart).collect();
        let middle = if near.len() < FEWEST { 0.0 } else { median(&mut near) };
        off.push((one.apart - middle).abs());
    }
    // where sigmas are too small by a factor, all of a kind are not astray
    let scale = (median(&mut off.clone()) / MAD_PER_SIGMA).max(1.0);
    said.iter().zip(&off).filter(|(_, off)| **off > ASTRAY * scale).map(|(one, _)| one.part).collect()
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive's worth of lines, one a tenth of a second, with what each says.
    fn said(apart: impl Fn(usize) -> f64) -> Vec<Said> {
        #[allow(clippy::cast_precision_loss)]
        (0..300).map(|k| Said { part: (k, None), time_s: 0.1 * k as f64, apart: apart(k) }).collect()
    }

    fn noise(k: usize) -> f64 {
        // evenly spread over ± 1.7 sigma, in no order
        ((k * 7919) % 101) as f64 / 101.0 * 3.4 - 1.7
    }

    #[test]
    fn one_that_differs_from_those_about_it_is_astray() {
        let found = of_kind(said(|k| if k == 120 { 6.0 } else { noise(k) }));
        assert_eq!(found, [(120, None)]);
    }

    #[test]
    fn what_all_say_is_not() {
        // an error of the model that all lines about a place show alike
        assert!(of_kind(said(|k| 8.0 + 0.02 * k as f64 + noise(k))).is_empty());
        // sigmas that are too small by a factor of three
        assert!(of_kind(said(|k| 3.0 * noise(k))).is_empty());
    }

    #[test]
    fn alone_a_line_is_compared_with_the_adjustment() {
        assert_eq!(of_kind(said(|k| if k == 0 { 9.0 } else { 0.1 }).into_iter().take(3).collect()), [(0, None)]);
    }
}
