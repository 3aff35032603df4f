//! Surface lines: patches of one surface, seen by two or more sightings, tied along their common normal.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use rstar::{AABB, RTree, RTreeObject};
use serde::{Deserialize, Serialize};

use crate::geometry::Footprint;
use crate::patch::{Patch, Sighting};

/// Why an end of a tie, or a whole tie, is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Rejection {
    /// The normals differ by more than their sigmas and the tolerance explain.
    NormalAngle,
    /// One sighting is much rougher than the other.
    Roughness,
    /// The planes are further apart than the search distance.
    Distance,
    /// The footprints share too little.
    Overlap,
    /// The distance does not fit the other ties of the two strips (robust, per pair).
    PairOutlier,
    /// The distance does not fit the neighbouring ties: the surface has changed between the sightings.
    ChangeOfSurface,
    /// Seen from different sides.
    OtherSide,
    /// No trajectory at that time.
    NoPose,
    /// Not needed: the budget is filled by ties that carry more information.
    Budget,
    /// The adjustment's outlier test.
    Outlier,
    /// Beyond the limits of range or scan angle that were asked for.
    Limits,
    /// The beam met it at a grazing angle.
    Grazing,
}

impl Rejection {
    /// The word used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NormalAngle => "normal_angle",
            Self::Roughness => "roughness",
            Self::Distance => "distance",
            Self::Overlap => "overlap",
            Self::PairOutlier => "pair_outlier",
            Self::ChangeOfSurface => "change_of_surface",
            Self::OtherSide => "other_side",
            Self::NoPose => "no_pose",
            Self::Budget => "budget",
            Self::Outlier => "outlier",
            Self::Limits => "limits",
            Self::Grazing => "grazing",
        }
    }

    /// The rejection of a word.
    #[must_use]
    pub fn parse(word: &str) -> Option<Self> {
        use Rejection as R;
        [
            R::NormalAngle,
            R::Roughness,
            R::Distance,
            R::Overlap,
            R::PairOutlier,
            R::ChangeOfSurface,
            R::OtherSide,
            R::NoPose,
            R::Budget,
            R::Outlier,
            R::Limits,
            R::Grazing,
        ]
        .into_iter()
        .find(|r| r.as_str() == word)
    }
}

/// When two patches count as the same surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PairingOptions {
    /// Largest distance along the normal \[m\], also the reach of the search.
    pub search_m: f64,
    /// Largest angle between normals beyond what their sigmas explain \[rad\].
    pub normal_angle_rad: f64,
    /// Largest ratio of roughnesses (above a floor).
    pub roughness_ratio: f64,
    /// Least share of the smaller footprint that both cover.
    pub min_overlap: f64,
    /// Floor of the sigma of a tie end \[m\]: what is common to all points of a patch.
    pub sigma_floor_m: f64,
}

impl Default for PairingOptions {
    fn default() -> Self {
        Self {
            search_m: 0.5,
            normal_angle_rad: 3.0_f64.to_radians(),
            roughness_ratio: 3.0,
            min_overlap: 0.3,
            sigma_floor_m: 0.001,
        }
    }
}

/// One end of a tie: the patch and, when it is not used, why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct End {
    /// The patch as measured in the cloud.
    pub patch: Patch,
    /// Why it is not used.
    pub rejection: Option<Rejection>,
}

/// A surface line: the first end is the one the others were compared with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SurfaceLine {
    /// Its ends, by sighting.
    pub ends: Vec<End>,
}

impl SurfaceLine {
    /// The ends in use.
    pub fn used(&self) -> impl Iterator<Item = (usize, &Patch)> {
        self.ends.iter().enumerate().filter(|(_, e)| e.rejection.is_none()).map(|(i, e)| (i, &e.patch))
    }
    /// Whether two ends or more are in use.
    #[must_use]
    pub fn is_tie(&self) -> bool {
        self.used().count() >= 2
    }
}

/// A surface line measured: plane offsets at one common point.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Common unit normal.
    pub normal: Vector3<f64>,
    /// The common point: centroid of what all footprints share \[m\].
    pub point_m: Vector3<f64>,
    /// For each end given: offset of its plane from the common point along the common normal \[m\], and its sigma \[m\].
    pub offsets: Vec<(f64, f64)>,
}

struct Boxed<'a> {
    row: usize,
    patch: &'a Patch,
}

impl RTreeObject for Boxed<'_> {
    type Envelope = AABB<[f64; 3]>;
    fn envelope(&self) -> Self::Envelope {
        let (low, high) = bounds(self.patch, 0.0);
        AABB::from_corners(low, high)
    }
}

/// Corners of the upright box about a patch, widened by a margin \[m\].
pub(crate) fn bounds(patch: &Patch, margin_m: f64) -> ([f64; 3], [f64; 3]) {
    let [a, b] = patch.half_extent_m();
    let reach = patch.long_axis.abs() * a + patch.cross_axis().abs() * b;
    let low = patch.centroid_m - reach;
    let high = patch.centroid_m + reach;
    (std::array::from_fn(|k| low[k] - margin_m), std::array::from_fn(|k| high[k] + margin_m))
}

/// The footprint of `patch` seen in the plane of `plane`, from the plane's centroid.
fn footprint_in(patch: &Patch, plane: &Patch) -> Footprint {
    let axes = [plane.long_axis, plane.cross_axis()];
    let flat = |v: &Vector3<f64>| [v.dot(&axes[0]), v.dot(&axes[1])];
    let [a, b] = patch.half_extent_m();
    Footprint::parallelogram(
        flat(&(patch.centroid_m - plane.centroid_m)),
        flat(&(patch.long_axis * a)),
        flat(&(patch.cross_axis() * b)),
    )
}

/// Compares a patch with the seed of a tie: the share of the smaller footprint that both cover, or why not.
///
/// # Errors
/// The [`Rejection`] that keeps the two apart.
pub fn compare(seed: &Patch, other: &Patch, options: &PairingOptions) -> Result<f64, Rejection> {
    let (of_seed, of_other) = (footprint_in(seed, seed), footprint_in(other, seed));
    let shared = of_seed.intersection(&of_other);
    let smaller = of_seed.area_m2().min(of_other.area_m2());
    let overlap = shared.map_or(0.0, |s| s.area_m2()) / smaller.max(1e-9);
    if overlap < options.min_overlap {
        return Err(Rejection::Overlap);
    }
    let sigma = seed.normal_sigma_rad().hypot(other.normal_sigma_rad());
    let angle = seed.normal.cross(&other.normal).norm().asin();
    if seed.normal.dot(&other.normal) < 0.0 || angle > options.normal_angle_rad + 3.0 * sigma {
        return Err(Rejection::NormalAngle);
    }
    let (rough, smooth) = (seed.roughness_m.max(other.roughness_m), seed.roughness_m.min(other.roughness_m));
    if rough > options.roughness_ratio * smooth.max(0.005) {
        return Err(Rejection::Roughness);
    }
    if seed.normal.dot(&(other.centroid_m - seed.centroid_m)).abs() > options.search_m {
        return Err(Rejection::Distance);
    }
    Ok(overlap)
}

/// Finds the surface lines among the patches of one tile.
///
/// Greedy from the patch with most points: of every other sighting the patch with the largest shared footprint
/// joins. Every patch belongs to one line at most. The order of the result is fixed.
#[must_use]
pub fn pair(patches: &[Patch], options: &PairingOptions) -> Vec<SurfaceLine> {
    pair_rows(patches, options).iter().map(|ends| line_of(patches, ends)).collect()
}

/// An end of a line as the row of its patch, and why it is not used.
pub type RowEnd = (usize, Option<Rejection>);

/// The line of some rows of a slice of patches.
#[must_use]
pub fn line_of(patches: &[Patch], ends: &[RowEnd]) -> SurfaceLine {
    let ends = ends.iter().map(|(row, rejection)| End { patch: patches[*row].clone(), rejection: *rejection });
    SurfaceLine { ends: ends.collect() }
}

/// The lines of [`pair`] as rows of the slice.
#[must_use]
pub fn pair_rows(patches: &[Patch], options: &PairingOptions) -> Vec<Vec<RowEnd>> {
    let tree = RTree::bulk_load(patches.iter().enumerate().map(|(row, patch)| Boxed { row, patch }).collect());
    let mut order: Vec<usize> = (0..patches.len()).collect();
    order.sort_by_key(|&row| (std::cmp::Reverse(patches[row].points), row));
    let mut taken = vec![false; patches.len()];
    let mut lines = Vec::new();
    for seed_row in order {
        if std::mem::replace(&mut taken[seed_row], true) {
            continue;
        }
        let seed = &patches[seed_row];
        let (low, high) = bounds(seed, options.search_m);
        // Of each sighting: an accepted patch with the largest overlap, else the rejected one nearest to it.
        let mut best: BTreeMap<Sighting, (f64, usize, Option<Rejection>)> = BTreeMap::new();
        for boxed in tree.locate_in_envelope_intersecting(AABB::from_corners(low, high)) {
            if taken[boxed.row] || boxed.patch.sighting == seed.sighting {
                continue;
            }
            let (score, rejection) = match compare(seed, boxed.patch, options) {
                Ok(overlap) => (1.0 + overlap, None),
                Err(Rejection::Overlap) => continue,
                Err(reason) => (-(boxed.patch.centroid_m - seed.centroid_m).norm(), Some(reason)),
            };
            let entry = best.entry(boxed.patch.sighting).or_insert((f64::NEG_INFINITY, boxed.row, None));
            if score > entry.0 || (score >= entry.0 && boxed.row < entry.1) {
                *entry = (score, boxed.row, rejection);
            }
        }
        if best.is_empty() {
            continue;
        }
        let mut ends = vec![(seed_row, None)];
        for (_, row, rejection) in best.into_values() {
            taken[row] |= rejection.is_none();
            ends.push((row, rejection));
        }
        lines.push(ends);
    }
    lines
}

/// Measures planes at one common point: the centroid of what all footprints share.
///
/// The sigma of an end is that of its plane at the common point (noise over √n, and the uncertainty of its normal
/// times the distance from its centroid), with a floor for what is common to its points. `None` for an empty slice
/// or when the footprints have nothing in common.
#[must_use]
pub fn measure(patches: &[&Patch], sigma_floor_m: f64) -> Option<Measurement> {
    let seed = *patches.iter().max_by_key(|p| p.points)?;
    let weight = |p: &Patch| 1.0 / (p.normal_sigma_rad().powi(2) + 1e-8);
    let normal = patches.iter().map(|p| p.normal * weight(p)).sum::<Vector3<f64>>().normalize();
    let mut shared = footprint_in(seed, seed);
    for patch in patches {
        if !std::ptr::eq(*patch, seed) {
            shared = shared.intersection(&footprint_in(patch, seed))?;
        }
    }
    let [u, v] = shared.centroid();
    let point_m = seed.centroid_m + seed.long_axis * u + seed.cross_axis() * v;
    let offsets = patches
        .iter()
        .map(|p| {
            let d = point_m - p.centroid_m;
            let offset_m = -p.normal.dot(&d) / p.normal.dot(&normal);
            (offset_m, p.plane_sigma_m(&d).hypot(sigma_floor_m).hypot(0.1 * p.roughness_m))
        })
        .collect();
    Some(Measurement { normal, point_m, offsets })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patch(strip: u32, centre: [f64; 3], normal: [f64; 3]) -> Patch {
        let normal = Vector3::from(normal).normalize();
        let long_axis = normal.cross(&Vector3::y()).cross(&normal).normalize();
        let long_axis = if long_axis.norm() > 0.5 { normal.cross(&Vector3::y()).normalize() } else { Vector3::x() };
        Patch {
            sighting: Sighting { strip, pass: 0, scanner: 0 },
            time_s: f64::from(strip) * 100.0,
            centroid_m: Vector3::from(centre),
            normal,
            long_axis,
            spread_m: [0.58, 0.58],
            roughness_m: 0.02,
            points: 40 - strip,
            intensity: 0.0,
        }
    }

    #[test]
    fn three_sightings_of_a_roof_become_one_line_measured_at_one_point() {
        // z = x / 2 seen three times: shifted along the slope, and the third 5 cm higher.
        let normal = [-0.5, 0.0, 1.0];
        let patches =
            [patch(0, [0.0, 0.0, 0.0], normal), patch(1, [0.4, 0.1, 0.2], normal), patch(2, [0.2, 0.0, 0.15], normal)];
        let lines = pair(&patches, &PairingOptions::default());
        assert_eq!(lines.len(), 1);
        assert_eq!(lines[0].used().count(), 3);
        let used: Vec<&Patch> = lines[0].used().map(|(_, p)| p).collect();
        let m = measure(&used, 0.001).expect("they overlap");
        let up = m.normal.z;
        assert!((m.offsets[1].0 - m.offsets[0].0).abs() < 1e-6);
        assert!((m.offsets[2].0 - m.offsets[0].0 - 0.05 * up).abs() < 1e-6);
    }

    #[test]
    fn a_patch_turned_away_keeps_its_reason() {
        let patches = [patch(0, [0.0; 3], [0.0, 0.0, 1.0]), patch(1, [0.0; 3], [0.3, 0.0, 1.0])];
        let lines = pair(&patches, &PairingOptions::default());
        assert_eq!(lines[0].ends[1].rejection, Some(Rejection::NormalAngle));
        assert!(!lines[0].is_tie());
    }

    #[test]
    fn the_sigma_grows_with_the_distance_from_the_centroid() {
        let p = patch(0, [0.0; 3], [0.0, 0.0, 1.0]);
        assert!(p.plane_sigma_m(&Vector3::new(1.0, 0.0, 0.0)) > 1.9 * p.plane_sigma_m(&Vector3::zeros()));
    }

    #[test]
    fn every_rejection_has_a_word_of_its_own() {
        for reason in [Rejection::NormalAngle, Rejection::Budget, Rejection::Outlier, Rejection::Limits] {
            assert_eq!(Rejection::parse(reason.as_str()), Some(reason));
        }
    }
}
