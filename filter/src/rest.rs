//! Rest: when the platform stands still, found in the inertial measurements.
//!
//! An idling engine shakes, but it shakes about a mean: means over a quarter of a second are quiet at rest, and loud on the
//! road, where the vehicle pitches, rolls and accelerates. What is quiet is learnt from the data: from the times when GNSS
//! says that the platform does not move, else from the quietest part of the recording.

use nalgebra::Vector3;

use crate::aiding::GnssFix;
use crate::imu::Imu;

/// A rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// Beginning \[s\].
    pub start_s: f64,
    /// End \[s\].
    pub end_s: f64,
}

/// Length of a mean \[s\].
const MEAN_S: f64 = 0.25;
/// Means that are looked at together: one second.
const WINDOW: usize = 4;
/// Shortest rest \[s\], after the cut.
const SHORTEST_S: f64 = 0.5;
/// Cut off at both ends of a rest, where the platform still rocks \[s\].
const MARGIN_S: f64 = 0.25;
/// Difference of the specific force from that of other rests that is always let pass \[m/s²\]: what even braking by
/// 0.9 m/s² adds to gravity. A bias that wanders may make it larger.
const FORCE_MPS2: f64 = 0.04;
/// A vehicle slower than this by GNSS stands \[m/s\].
const STANDING_MPS: f64 = 0.15;

/// A second of inertial measurements.
#[derive(Debug, Clone, Copy)]
struct Level {
    /// Its middle \[s\].
    time_s: f64,
    /// Restlessness of rotation \[rad/s\].
    turning: f64,
    /// Restlessness of acceleration \[m/s²\].
    shaking: f64,
    /// Size of the mean specific force \[m/s²\]: even braking is quiet, but it adds to gravity.
    force: f64,
}

/// How restless the platform is, window by window.
fn levels_of(imu: &Imu) -> Vec<Level> {
    let mut means: Vec<(f64, Vector3<f64>, Vector3<f64>)> = Vec::new();
    let mut sum = (0.0, Vector3::zeros(), Vector3::zeros());
    let mut start_s = imu.samples()[0].time_s;
    for pair in imu.samples().windows(2) {
        let interval_s = (pair[1].time_s - pair[0].time_s).min(1.5 * imu.interval_s());
        sum = (sum.0 + interval_s, sum.1 + pair[1].angle_rad, sum.2 + pair[1].velocity_mps);
        if pair[1].time_s - start_s >= MEAN_S - 1e-6 {
            means.push((0.5 * (start_s + pair[1].time_s), sum.1 / sum.0, sum.2 / sum.0));
            sum = (0.0, Vector3::zeros(), Vector3::zeros());
            start_s = pair[1].time_s;
        }
    }
    #[allow(clippy::cast_precision_loss)]
    let mean_and_spread = |values: &mut dyn Iterator<Item = Vector3<f64>>| {
        let all: Vec<Vector3<f64>> = values.collect();
        let mean = all.iter().sum::<Vector3<f64>>() / all.len() as f64;
        (mean, (all.iter().map(|v| (v - mean).norm_squared()).sum::<f64>() / all.len() as f64).sqrt())
    };
    means
        .windows(WINDOW)
        .map(|w| {
            let (force, shaking) = mean_and_spread(&mut w.iter().map(|m| m.2));
            let turning = mean_and_spread(&mut w.iter().map(|m| m.1)).1;
            Level { time_s: 0.5 * (w[0].0 + w[WINDOW - 1].0), turning, shaking, force: force.norm() }
        })
        .collect()
}

/// Speed by GNSS around a time: velocity where there is one, else from positions 1 s apart \[m/s\].
fn speed_mps(gnss: &[GnssFix], time_s: f64) -> Option<f64> {
    let next = gnss.partition_point(|f| f.time_s < time_s);
    let near = |i: usize| gnss.get(i).filter(|f| (f.time_s - time_s).abs() < 1.5);
    let (before, after) = (near(next.checked_sub(1)?)?, near(next)?);
    let moved =
        (crate::earth::ecef_from_geodetic(&after.geodetic) - crate::earth::ecef_from_geodetic(&before.geodetic)).norm()
            / (after.time_s - before.time_s).max(0.2);
    let measured = before.velocity.iter().chain(&after.velocity).map(|v| v.ned_mps.norm()).fold(0.0, f64::max);
    Some(if before.velocity.is_some() { measured } else { moved })
}

/// Finds the rests.
#[must_use]
#[allow(clippy::cast_precision_loss)] // a few means
pub fn find(imu: &Imu, gnss: &[GnssFix]) -> Vec<Rest> {
    let levels = levels_of(imu);
    let Some((limit, force_apart)) = limits(&levels, gnss) else { return Vec::new() };
    let half_s = 0.5 * MEAN_S * WINDOW as f64;
    let mut rests: Vec<Rest> = Vec::new();
    for Level { time_s, turning, shaking, force } in &levels {
        let quiet = *turning <= limit.turning && *shaking <= limit.shaking;
        let unforced = (force - limit.force).abs() <= force_apart;
        let slow = speed_mps(gnss, *time_s).is_none_or(|v| v < 2.0 * STANDING_MPS);
        if !(quiet && unforced && slow) {
            continue;
        }
        let (start_s, end_s) = (time_s - half_s, time_s + half_s);
        match rests.last_mut() {
            Some(last) if start_s <= last.end_s => last.end_s = end_s,
            _ => rests.push(Rest { start_s, end_s }),
        }
    }
    rests
        .into_iter()
        .map(|r| Rest { start_s: r.start_s + MARGIN_S, end_s: r.end_s - MARGIN_S })
        .filter(|r| r.end_s - r.start_s >= SHORTEST_S)
        .collect()
}

/// Largest restlessness of rotation and acceleration at rest, and the specific force there, as a level of which only the
/// time says nothing; and how far the force may be from that. `None` when the platform never rests.
fn limits(levels: &[Level], gnss: &[GnssFix]) -> Option<(Level, f64)> {
    let quantile = |mut values: Vec<f64>, share: f64| -> Option<f64> {
        if values.is_empty() {
            return None;
        }
        values.sort_by(f64::total_cmp);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
        Some(values[((values.len() - 1) as f64 * share) as usize])
    };
    let standing: Vec<bool> =
        levels.iter().map(|l| speed_mps(gnss, l.time_s).is_some_and(|v| v < STANDING_MPS)).collect();
    let moving: Vec<bool> = levels.iter().map(|l| speed_mps(gnss, l.time_s).is_some_and(|v| v > 1.0)).collect();
    let of = |flags: &[bool], what: fn(&Level) -> f64| -> Vec<f64> {
        levels.iter().zip(flags).filter(|(_, f)| **f).map(|(l, _)| what(l)).collect()
    };
    let stands = standing.iter().filter(|s| **s).count() >= 8;
    let pick = |what: fn(&Level) -> f64| -> Option<f64> {
        if stands {
            // between what rest and road look like; where they mix, nearer to rest
            let rest = quantile(of(&standing, what), 0.5)?;
            let road = quantile(of(&moving, what), 0.02).unwrap_or(f64::INFINITY);
            Some((rest * road).sqrt().clamp(1.5 * rest, 3.0 * rest))
        } else if gnss.is_empty() {
            quantile(levels.iter().map(what).collect(), 0.02).map(|q| 3.0 * q)
        } else {
            None
        }
    };
    let (turning, shaking) = (pick(|l| l.turning)?, pick(|l| l.shaking)?);
    let resting: Vec<bool> =
        if stands { standing } else { levels.iter().map(|l| l.turning <= turning && l.shaking <= shaking).collect() };
    let force = quantile(of(&resting, |l| l.force), 0.5)?;
    let apart = of(&resting, |l| l.force).iter().map(|f| (f - force).abs()).collect();
    Some((Level { time_s: 0.0, turning, shaking, force }, FORCE_MPS2.max(3.0 * quantile(apart, 0.75)?)))
}
