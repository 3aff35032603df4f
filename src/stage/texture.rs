//! Texture of pavement in a drive: which points are kept, and where spots are looked for.

use std::io;

use anyhow::{Context, Result};
use nalgebra::Vector3;
use tieline_filter::Trajectory;
use tieline_matching::xyz::texture::{
    JudgeOptions, PointKeeper, SpotTie, TextureOptions, TexturePoint, TexturePoints, find_spots, judge,
};
use tieline_matching::{GridOptions, PointBlock};

use crate::project::Project;

/// Farther away pavement is seen at a grazing angle and by few points \[m\].
const FARTHEST_M: f64 = 9.0;
/// Sine of the least angle at which a beam meets level ground.
const STEEPEST_LOOK: f64 = 0.17;
/// At rest a scanner sees one line over and over \[m/s\].
const SLOWEST_MPS: f64 = 0.3;
/// So long a pose serves for the choice of points \[s\].
const POSE_S: f64 = 0.005;
/// Search radii: so many standard deviations of both positions and a little more; between these; that where none is stated \[m\].
const SEARCH_SIGMAS: f64 = 4.0;
const SEARCH_MORE_M: f64 = 0.1;
const SEARCH_M: [f64; 2] = [0.25, 1.2];
const SEARCH_UNSTATED_M: f64 = 0.75;

/// The pavement about the vehicle's way.
#[derive(Debug)]
pub struct Pavement<'a> {
    trajectory: &'a Trajectory,
    /// Between the scanners, body frame \[m\].
    lever_arm_m: Vector3<f64>,
    origin_m: [f64; 3],
    /// Points that one thread keeps in memory.
    most: usize,
}

impl<'a> Pavement<'a> {
    /// The pavement along a trajectory in the map; half the memory is for points.
    #[must_use]
    #[allow(clippy::cast_precision_loss)] // scanners
    pub fn new(
        project: &Project,
        trajectory: &'a Trajectory,
        origin_m: [f64; 3],
        memory_bytes: u64,
        threads: usize,
    ) -> Self {
        let scanners = &project.platform.scanner;
        let sum: Vector3<f64> = scanners.iter().map(|s| Vector3::from(s.lever_arm_m)).sum();
        let most = usize::try_from(memory_bytes).unwrap_or(usize::MAX) / 2 / size_of::<TexturePoint>() / threads.max(1);
        Self {
            trajectory,
            lever_arm_m: sum / scanners.len().max(1) as f64,
            origin_m,
            most: most.clamp(20_000, 50_000_000),
        }
    }

    /// What one thread keeps.
    #[must_use]
    pub fn keeping(&self) -> Keeping<'_> {
        Keeping { pavement: self, keeper: PointKeeper::new(self.most), from_s: f64::NAN, near: None }
    }
}

/// One thread's choice of points.
#[derive(Debug)]
pub struct Keeping<'a> {
    pavement: &'a Pavement<'a>,
    keeper: PointKeeper,
    /// Time of the pose at hand \[s\].
    from_s: f64,
    /// The middle of the scanners at that time, local frame \[m\]; none at rest or beyond the trajectory.
    near: Option<Vector3<f64>>,
}

impl Keeping<'_> {
    /// Keeps those points of a block that lie on level ground near the vehicle, single or last returns.
    ///
    /// # Errors
    /// When a temporary file cannot be written.
    pub fn add(&mut self, block: &PointBlock<'_>, grid: &GridOptions) -> io::Result<()> {
        for i in 0..block.len() {
            let time_s = block.gps_time_s[i] + block.time_shift_s;
            if !time_s.is_finite() || block.intensity[i] == 0 || !grid.filter.takes(block, i) {
                continue;
            }
            let Some(scanner_m) = self.scanner_m(time_s) else { continue };
            let raw = [block.x[i], block.y[i], block.z[i]];
            let place_m: [f64; 3] = std::array::from_fn(|k| {
                f64::from(raw[k]) * block.scale_m[k] + (block.offset_m[k] - self.pavement.origin_m[k])
            });
            let ray_m = Vector3::from(place_m) - scanner_m;
            let range_m = ray_m.norm();
            if range_m <= FARTHEST_M && -ray_m.z >= STEEPEST_LOOK * range_m {
                let source = grid.rule.source(block, i);
                self.keeper.keep(place_m, (time_s, source), range_m, block.intensity[i])?;
            }
        }
        Ok(())
    }

    fn scanner_m(&mut self, time_s: f64) -> Option<Vector3<f64>> {
        // the pose of a step of the clock, whichever point comes first: all threads choose alike
        let middle_s = (time_s / POSE_S).floor() * POSE_S + 0.5 * POSE_S;
        if (middle_s - self.from_s).abs() < 0.5 * POSE_S {
            return self.near;
        }
        let Pavement { trajectory, lever_arm_m, origin_m, .. } = self.pavement;
        self.from_s = middle_s;
        let (from, to) = (trajectory.pose_at(self.from_s - 0.05), trajectory.pose_at(self.from_s + 0.05));
        self.near = from.zip(to).zip(trajectory.pose_at(self.from_s)).and_then(|((from, to), pose)| {
            let moves = (to.position - from.position).norm() > 0.1 * SLOWEST_MPS;
            let place_m = pose.position + pose.map_from_ned * (pose.ned_from_body * lever_arm_m);
            moves.then(|| place_m - Vector3::from(*origin_m))
        });
        self.near
    }

    /// The points that were kept.
    #[must_use]
    pub fn finish(self) -> PointKeeper {
        self.keeper
    }
}

/// Finds the spots of a drive and lets neighbours judge them; gives what there is to say as well.
///
/// # Errors
/// When a temporary file cannot be read.
pub fn spots(points: &TexturePoints, trajectory: &Trajectory) -> Result<(Vec<SpotTie>, String)> {
    let sigma_m = |time_s: f64| trajectory.sigma_at(time_s).map(|s| s.position_ned_m.xy().norm());
    let search_m = |a_s: f64, b_s: f64| {
        let stated = sigma_m(a_s).zip(sigma_m(b_s)).map(|(a, b)| SEARCH_SIGMAS * a.hypot(b) + SEARCH_MORE_M);
        stated.map_or(SEARCH_UNSTATED_M, |m| m.clamp(SEARCH_M[0], SEARCH_M[1]))
    };
    let worst_m = trajectory.sigma().iter().map(|s| s.position_ned_m.xy().norm()).fold(0.0, f64::max);
    let most_search_m = match trajectory.sigma() {
        [] => SEARCH_UNSTATED_M,
        _ => (SEARCH_SIGMAS * worst_m * std::f64::consts::SQRT_2 + SEARCH_MORE_M).clamp(SEARCH_M[0], SEARCH_M[1]),
    };
    let mut ties = find_spots(points, &search_m, most_search_m, &TextureOptions::default())
        .context("a temporary file of pavement cannot be read back")?;
    judge(&mut ties, &JudgeOptions::default());
    keep_pictures(&mut ties);
    let used = ties.iter().filter(|t| t.rejection.is_none()).count();
    let note = format!("texture of pavement: {used} of {} matches of spots are ties", ties.len());
    Ok((ties, note))
}

/// Pictures of the best matches, and of some for each reason, stay for the contact sheet.
fn keep_pictures(ties: &mut [SpotTie]) {
    const BEST: usize = 100;
    const OF_A_REASON: usize = 12;
    let mut order: Vec<usize> = (0..ties.len()).filter(|k| ties[*k].picture.is_some()).collect();
    let sigma = |t: &SpotTie| t.covariance_m2.fixed_view::<2, 2>(0, 0).trace();
    order.sort_by(|a, b| {
        let key = |k: usize| (ties[k].rejection, sigma(&ties[k]));
        key(*a).0.cmp(&key(*b).0).then(key(*a).1.total_cmp(&key(*b).1)).then(a.cmp(b))
    });
    let (mut last, mut count) = (None, 0);
    for k in order {
        let reason = ties[k].rejection;
        count = if last == Some(reason) { count + 1 } else { 1 };
        last = Some(reason);
        if count > reason.map_or(BEST, |_| OF_A_REASON) {
            ties[k].picture = None;
        }
    }
}
