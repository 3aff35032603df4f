//! Registration of two submaps, or of two strips where they overlap, by the facets that they share.

use nalgebra::{DVector, Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use thiserror::Error;

use super::facet::{Facet, FacetLimits};
use super::held::Held;
use super::normal_equations::{Adjusted, Bounds, Carrier, adjust, frame};
use super::voxels::Grid;

/// The points of one submap: places and times, one of each for every point.
#[derive(Debug, Clone, Copy)]
pub struct Cloud<'a> {
    /// Places \[m\] in a local frame with z up; places that are not numbers are left out.
    pub points_m: &'a [Vector3<f64>],
    /// Survey times \[s\].
    pub time_s: &'a [f64],
}

/// How two submaps are registered.
#[derive(Debug, Clone, PartialEq)]
pub struct SubmapOptions {
    /// Whether turns are estimated beside shifts.
    pub rotation: bool,
    /// Width of the smallest cells \[m\]; left out: the smallest power of two, from 0.25 to 8 m, that holds four points
    /// of the sparser cloud.
    pub cell_m: Option<f64>,
    /// Fewest points of each cloud in a facet.
    pub min_points: u32,
    /// Largest standard deviation of points about a facet's plane \[m\].
    pub max_roughness_m: f64,
    /// Largest angle between the two normals of a facet beyond what noise explains \[rad\].
    pub normal_angle_rad: f64,
    /// What all points of a cloud in a facet have in common \[m\].
    pub sigma_floor_m: f64,
    /// Largest sigma \[m\] of a direction that counts as held.
    pub max_sigma_m: f64,
    /// Fewest facets.
    pub min_facets: usize,
    /// Largest mismatch \[m\] that is looked for: the first rounds take cells twice as wide.
    pub search_m: f64,
}

impl Default for SubmapOptions {
    fn default() -> Self {
        Self {
            rotation: false,
            cell_m: None,
            min_points: 6,
            max_roughness_m: 0.06,
            normal_angle_rad: 3.0_f64.to_radians(),
            sigma_floor_m: 0.0005,
            max_sigma_m: 0.05,
            min_facets: 20,
            search_m: 0.5,
        }
    }
}

/// Why two submaps are not tied.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum NotRegistered {
    /// A cloud has no points, or none that are numbers.
    #[error("a cloud has no points")]
    NoPoints,
    /// The columns of a cloud differ in length.
    #[error("{points} points have {times} times: one is needed for each")]
    Columns {
        /// Number of places.
        points: usize,
        /// Number of times.
        times: usize,
    },
    /// The clouds reach too far for their cells.
    #[error("the clouds reach over {extent_m:.0} m, more than a million cells of {cell_m} m: divide them")]
    TooWide {
        /// Largest extent \[m\].
        extent_m: f64,
        /// Width of a cell \[m\].
        cell_m: f64,
    },
    /// Too few planes are seen by both.
    #[error("{found} facets are seen by both clouds: {needed} are needed")]
    TooFewFacets {
        /// Facets found.
        found: usize,
        /// Facets asked for.
        needed: usize,
    },
    /// No direction is held within the largest sigma.
    #[error("the surfaces in common hold no direction within the largest sigma allowed")]
    NothingHeld,
}

/// How one submap lies on another.
#[derive(Debug, Clone)]
pub struct Registration {
    /// To be applied to the moving cloud: turns about, and shift of, the frame's own zero.
    pub fixed_from_moving: Isometry3<f64>,
    /// Where the shift is best known: the centre of the facets \[m\].
    pub origin_m: Vector3<f64>,
    /// Shift \[m\] of the moving cloud at that centre.
    pub shift_m: Vector3<f64>,
    /// Turn \[rad\] of the moving cloud, a rotation vector.
    pub turn_rad: Vector3<f64>,
    /// Length \[m\] by which a turn counts as a displacement in `held`: the radius of gyration of the facets.
    pub gyration_m: f64,
    /// Directions that are held, over shift \[m\] and, when asked for, turn times `gyration_m` \[m\]; with their sigmas.
    pub held: Held,
    /// For each direction of `held` the places that say it, and how much each does: where the clouds do not differ by one shift (a tilt
    /// between strips), these tell what the shift along it is a mean of. Centres are in the frame of the fixed cloud.
    pub carriers: Vec<Vec<Carrier>>,
    /// Mean time \[s\] of the fixed and of the moving points in use, by their information.
    pub time_s: [f64; 2],
    /// The facets at the solution.
    pub facets: Vec<Facet>,
    /// Which of them are in use.
    pub used: Vec<bool>,
    /// Factors of the a-priori sigmas of level, sloped and steep facets.
    pub scale: [f64; 3],
    /// Sigma \[m\] of the errors that level, sloped and steep facets of one orientation and place have in common.
    pub common_sigma_m: [f64; 3],
    /// Number of facets in use times the least share of a direction's information that is left by these errors.
    pub effective_facets: f64,
    /// Width of the smallest cells \[m\].
    pub cell_m: f64,
    /// Rounds until the clouds stood still.
    pub rounds: usize,
    /// Whether they did.
    pub converged: bool,
}

/// Most rounds of cells, facets and adjustment.
const ROUNDS: usize = 20;
/// Rounds of whole steps; of those after them a half, a third, … is taken: where points hop to and fro over the faces of
/// cells, and slabs in and out, that is the mean of the places they lead to.
const WHOLE_STEPS: usize = 6;
/// The clouds stand still when what is taken of a step is below this many sigmas in every held direction,
const STILL: f64 = 0.1;
/// and the step itself below this many.
const CLOSE: f64 = 2.0;
/// Share of the smallest cells' width by which a step in wider ones may still move the cloud before those take over.
const NEAR: f64 = 0.1;
/// Widths of cells tried \[m\].
const WIDTHS_M: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
/// Points of the sparser cloud in the cell of a median point.
const POINTS_IN_CELL: i64 = 4;
/// Edge of a neighbourhood, in cells: three of the largest facets, so that one roof or one bank is about one slab.
const NEIGHBOURHOOD_CELLS: f64 = 24.0;
/// Cells along one axis that a place can be counted in.
const MOST_CELLS: f64 = 1_048_576.0;

/// Registers a moving cloud on a fixed one.
///
/// Point-to-plane without pairing points: both clouds are summed into the same cells, every cell that is a plane in
/// both gives one distance along its normal ([`Facet`]), a robust adjustment moves the moving cloud, and it is put
/// into the cells anew until it stands still. Directions that the facets do not hold are left as they were given. The
/// result does not depend on the number of threads. Cost: some ten additions for each moving point and round.
///
/// # Errors
/// [`NotRegistered`], when the clouds do not share what it takes.
pub fn register(fixed: &Cloud<'_>, moving: &Cloud<'_>, options: &SubmapOptions) -> Result<Registration, NotRegistered> {
    for cloud in [fixed, moving] {
        if cloud.points_m.len() != cloud.time_s.len() {
            return Err(NotRegistered::Columns { points: cloud.points_m.len(), times: cloud.time_s.len() });
        }
    }
    let first_s = [first_time_s(fixed)?, first_time_s(moving)?];
    let grid = Grid::about(fixed, moving, options.cell_m, &WIDTHS_M, POINTS_IN_CELL, MOST_CELLS)?;
    let limits = FacetLimits {
        min_points: i64::from(options.min_points),
        max_roughness_m: options.max_roughness_m,
        normal_angle_rad: options.normal_angle_rad,
        sigma_floor_m: options.sigma_floor_m,
    };
    let pair = Pair { fixed, moving, first_s, limits, options };
    let (wide, mut start) = (grid.widened(2.0 * options.search_m), Isometry3::identity());
    if wide.width_m > grid.width_m {
        start = pair.register(&wide, start, Some(NEAR * grid.width_m))?.fixed_from_moving;
    }
    pair.register(&grid, start, None)
}

/// Two clouds and how they are to be registered.
struct Pair<'a> {
    fixed: &'a Cloud<'a>,
    moving: &'a Cloud<'a>,
    first_s: [f64; 2],
    limits: FacetLimits,
    options: &'a SubmapOptions,
}

impl Pair<'_> {
    /// Rounds of cells, facets and adjustment in one grid, until the moving cloud stands still; on the way to a finer grid until a step is
    /// shorter than `near_m` \[m\].
    fn register(&self, grid: &Grid, start: Isometry3<f64>, near_m: Option<f64>) -> Result<Registration, NotRegistered> {
        let still = grid.voxels(self.fixed, &Isometry3::identity(), self.first_s[0]);
        let bounds = Bounds {
            unknowns: if self.options.rotation { 6 } else { 3 },
            max_sigma_m: self.options.max_sigma_m,
            neighbourhood_m: NEIGHBOURHOOD_CELLS * grid.width_m,
        };
        let mut motion = start;
        let mut round = 0_usize;
        loop {
            round += 1;
            let moved = grid.voxels(self.moving, &motion, self.first_s[1]);
            let facets = grid.facets(&still, &moved, &self.limits);
            if facets.len() < self.options.min_facets {
                return Err(NotRegistered::TooFewFacets { found: facets.len(), needed: self.options.min_facets });
            }
            let about = frame(&facets);
            let adjusted = adjust(&facets, &about, &bounds).ok_or(NotRegistered::NothingHeld)?;
            #[allow(clippy::cast_precision_loss)] // twenty rounds
            let share = 1.0 / (round.saturating_sub(WHOLE_STEPS) + 1) as f64;
            let length = length_in_sigmas(&adjusted, about.gyration_m);
            let converged = length < CLOSE && share * length < STILL;
            let is_near = near_m.is_some_and(|near_m| length_m(&adjusted.step, about.gyration_m) < near_m);
            motion = step_about(&about.origin_m, &(adjusted.step * share)) * motion;
            if converged || is_near || round == ROUNDS {
                let count = adjusted.used.iter().filter(|u| **u).count();
                #[allow(clippy::cast_precision_loss)]
                let effective_facets = count as f64 * adjusted.independent;
                return Ok(Registration {
                    fixed_from_moving: motion,
                    origin_m: about.origin_m,
                    shift_m: about.origin_m - motion.inverse_transform_point(&about.origin_m.into()).coords,
                    turn_rad: motion.rotation.scaled_axis(),
                    gyration_m: about.gyration_m,
                    time_s: mean_time_s(&facets, &adjusted, self.first_s),
                    held: adjusted.held,
                    carriers: survey_times(adjusted.carriers, self.first_s),
                    facets,
                    used: adjusted.used,
                    scale: adjusted.scale,
                    common_sigma_m: adjusted.common_sigma_m,
                    effective_facets,
                    cell_m: grid.width_m,
                    rounds: round,
                    converged,
                });
            }
        }
    }
}

fn first_time_s(cloud: &Cloud<'_>) -> Result<f64, NotRegistered> {
    cloud.time_s.iter().copied().filter(|t| t.is_finite()).reduce(f64::min).ok_or(NotRegistered::NoPoints)
}

/// The motion x ← o + δt + exp(δθ)(x - o).
fn step_about(origin_m: &Vector3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
    let shift = origin_m + step.fixed_rows::<3>(0) - turn * origin_m;
    Isometry3::from_parts(Translation3::from(shift), turn)
}

/// What a step moves the facets by, shift and turn at their radius of gyration \[m\].
fn length_m(step: &Vector6<f64>, gyration_m: f64) -> f64 {
    step.fixed_rows::<3>(0).norm() + step.fixed_rows::<3>(3).norm() * gyration_m
}

/// The longest part of a step along a held direction, in sigmas.
fn length_in_sigmas(adjusted: &Adjusted, gyration_m: f64) -> f64 {
    let held = &adjusted.held;
    let unknowns = held.directions.nrows();
    let step = DVector::from_fn(unknowns, |k, _| adjusted.step[k] * if k < 3 { 1.0 } else { gyration_m });
    (held.directions.transpose() * step).component_div(&held.sigma_m).amax()
}

/// Carriers with survey times instead of times after the clouds' first.
fn survey_times(mut carriers: Vec<Vec<Carrier>>, first_s: [f64; 2]) -> Vec<Vec<Carrier>> {
    for carrier in carriers.iter_mut().flatten() {
        carrier.time_s.iter_mut().zip(first_s).for_each(|(t, first)| *t += first);
    }
    carriers
}

/// Mean times of the facets in use, by their information.
fn mean_time_s(facets: &[Facet], adjusted: &Adjusted, first_s: [f64; 2]) -> [f64; 2] {
    let used = || facets.iter().zip(&adjusted.used).filter(|(_, used)| **used).map(|(f, _)| (f, f.sigma_m.powi(-2)));
    let total: f64 = used().map(|(_, w)| w).sum();
    std::array::from_fn(|k| first_s[k] + used().map(|(f, w)| f.time_s[k] * w).sum::<f64>() / total.max(1e-300))
}
