//! Points near the vehicle that are kept while all are read: pavement for its texture, what stands beside it for posts and trunks.

use std::io;

use nalgebra::Vector3;
use tieline_filter::Trajectory;
use tieline_matching::xyz::PostKeeper;
use tieline_matching::xyz::texture::{PointKeeper, TexturePoint};
use tieline_matching::{GridOptions, PointBlock};

use crate::project::Project;

/// Farther away pavement is seen at a grazing angle and by few points \[m\].
const FARTHEST_M: f64 = 9.0;
/// Sine of the least angle at which a beam meets level ground.
const STEEPEST_LOOK: f64 = 0.17;
/// Posts and trunks are looked for between these distances in plan \[m\], and from so far below the scanners to so far above \[m\]: half a metre to three above the ground.
const NEAREST_POST_M: f64 = 1.5;
const FARTHEST_POST_M: f64 = 18.0;
const POST_M: [f64; 2] = [-1.6, 1.2];
/// At rest a scanner sees one line over and over \[m/s\].
const SLOWEST_MPS: f64 = 0.3;
/// So long a pose serves for the choice of points \[s\].
const POSE_S: f64 = 0.005;
/// What lies about the vehicle's way.
#[derive(Debug)]
pub struct Nearby<'a> {
    trajectory: &'a Trajectory,
    /// Between the scanners, body frame \[m\].
    lever_arm_m: Vector3<f64>,
    origin_m: [f64; 3],
    /// Whether pavement and what stands beside it are kept.
    wanted: [bool; 2],
    /// Points that one thread keeps in memory.
    most: usize,
}

impl<'a> Nearby<'a> {
    /// Pavement, or what stands, or both along a trajectory in the map; half the memory is for points.
    #[must_use]
    #[allow(clippy::cast_precision_loss)] // scanners
    pub fn new(
        project: &Project,
        trajectory: &'a Trajectory,
        origin_m: [f64; 3],
        wanted: [bool; 2],
        (memory_bytes, threads): (u64, usize),
    ) -> Self {
        let scanners = &project.platform.scanner;
        let sum: Vector3<f64> = scanners.iter().map(|s| Vector3::from(s.lever_arm_m)).sum();
        let keepers = threads.max(1) * wanted.iter().filter(|w| **w).count().max(1);
        let most = usize::try_from(memory_bytes).unwrap_or(usize::MAX) / 2 / size_of::<TexturePoint>() / keepers;
        Self {
            trajectory,
            lever_arm_m: sum / scanners.len().max(1) as f64,
            origin_m,
            wanted,
            most: most.clamp(20_000, 50_000_000),
        }
    }

    /// What one thread keeps.
    #[must_use]
    pub fn keeping(&self) -> Keeping<'_> {
        let [pavement, posts] = self.wanted;
        Keeping {
            nearby: self,
            pavement: pavement.then(|| PointKeeper::new(self.most)),
            posts: posts.then(|| PostKeeper::new(self.most)),
            from_s: f64::NAN,
            near: None,
        }
    }
}

/// One thread's choice of points.
#[derive(Debug)]
pub struct Keeping<'a> {
    nearby: &'a Nearby<'a>,
    pavement: Option<PointKeeper>,
    posts: Option<PostKeeper>,
    /// Time of the pose at hand \[s\].
    from_s: f64,
    /// The middle of the scanners at that time, local frame \[m\]; none at rest or beyond the trajectory.
    near: Option<Vector3<f64>>,
}

impl Keeping<'_> {
    /// Keeps those points of a block that lie on level ground near the vehicle, or beside it at the heights of posts and trunks, single or last returns.
    ///
    /// # Errors
    /// When a temporary file cannot be written.
    pub fn add(&mut self, block: &PointBlock<'_>, grid: &GridOptions) -> io::Result<()> {
        for i in 0..block.len() {
            let time_s = block.gps_time_s[i] + block.time_shift_s;
            if !time_s.is_finite() || !grid.filter.takes(block, i) {
                continue;
            }
            let Some(scanner_m) = self.scanner_m(time_s) else { continue };
            let raw = [block.x[i], block.y[i], block.z[i]];
            let place_m: [f64; 3] = std::array::from_fn(|k| {
                f64::from(raw[k]) * block.scale_m[k] + (block.offset_m[k] - self.nearby.origin_m[k])
            });
            let ray_m = Vector3::from(place_m) - scanner_m;
            let range_m = ray_m.norm();
            let is_pavement = range_m <= FARTHEST_M && -ray_m.z >= STEEPEST_LOOK * range_m;
            if let Some(keeper) = self.pavement.as_mut().filter(|_| is_pavement && block.intensity[i] > 0) {
                keeper.keep(place_m, (time_s, grid.rule.source(block, i)), range_m, block.intensity[i])?;
            }
            let is_beside = (NEAREST_POST_M..=FARTHEST_POST_M).contains(&ray_m.xy().norm());
            let is_post = is_beside && (POST_M[0]..=POST_M[1]).contains(&ray_m.z);
            if let Some(keeper) = self.posts.as_mut().filter(|_| is_post) {
                let azimuth_rad = ray_m.x.atan2(ray_m.y);
                keeper.keep(place_m, (time_s, grid.rule.source(block, i)), azimuth_rad, block.intensity[i])?;
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
        let Nearby { trajectory, lever_arm_m, origin_m, .. } = self.nearby;
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
    pub fn finish(self) -> (Option<PointKeeper>, Option<PostKeeper>) {
        (self.pavement, self.posts)
    }
}
