//! Settings that follow from the data, each with its reason; a key of the project file overrides any of them.

use std::collections::BTreeMap;

use anyhow::Result;
use serde::{Deserialize, Serialize};
use tieline_matching::{
    Accumulator, GridOptions, PairingOptions, PatchOptions, PointFilter, Returns, StripIndex, StripOptions, TileMerge,
    patches_of_tile,
};

use crate::project::{Project, ReturnsChoice, SplitWord, SurfaceWord, XyzChoice, XyzWord};
use crate::sample::{Sample, block};
use crate::survey::{Survey, SurveyFile};

/// Ties looked for in a second of a drive.
const TIES_PER_SECOND: f64 = 200.0;

/// One setting as it is reported: key, value, reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// Key in the project file.
    pub key: String,
    /// Value in use.
    pub value: String,
    /// Where it comes from.
    pub reason: String,
}

/// Limits that were asked for; none by default.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Limits {
    /// Scanners that take part, 0-based.
    pub scanners: Option<Vec<u16>>,
    /// Nearest and farthest range \[m\].
    pub range_m: Option<[f64; 2]>,
    /// Largest angle between beam and normal \[deg\].
    pub max_incidence_deg: Option<f64>,
    /// Lever arms \[m\] of scanners, forward, right, down: where beams come from.
    pub lever_arms_m: BTreeMap<u16, [f64; 3]>,
    /// West, south, east, north in map coordinates \[m\].
    pub area_m: Option<[f64; 4]>,
    /// Surfaces that take part.
    pub surfaces: Option<Vec<SurfaceWord>>,
}

/// All settings of matching.
#[derive(Debug, Clone)]
pub struct Settings {
    /// The grid and what is summed into it.
    pub grid: GridOptions,
    /// What makes a patch.
    pub patch: PatchOptions,
    /// What makes a tie.
    pub pairing: PairingOptions,
    /// Limits that were asked for.
    pub limits: Limits,
    /// What tells strips apart in time.
    pub strips: StripOptions,
    /// Most ties.
    pub max_ties: usize,
    /// Least spacing of ties \[m\].
    pub min_spacing_m: f64,
    /// Least spacing of ties of one strip \[s\].
    pub min_spacing_s: f64,
    /// Share held out.
    pub hold_out: f64,
    /// Seed of the choice of held-out places.
    pub seed: u64,
    /// Kinds of XYZ points looked for.
    pub xyz: Vec<XyzWord>,
    /// Whether these are chosen automatically: they are to cost no more time than all else.
    pub xyz_auto: bool,
    /// Whether surface lines take part in the solution, or judge it only.
    pub surface_lines: bool,
    /// Whether a vehicle drove through the survey, with inertial measurements of its own.
    pub is_drive: bool,
    /// The list for the report.
    pub list: Vec<Setting>,
}

/// How patches become ties: what it takes to do it again.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Grouping {
    /// When two patches count as the same surface.
    pub pairing: PairingOptions,
    /// Width of the tiles that patches are paired in \[m\].
    pub tile_m: f64,
    /// Most ties.
    pub max_ties: usize,
    /// Least spacing in space \[m\] and in time \[s\].
    pub spacing: (f64, f64),
    /// Share held out.
    pub hold_out: f64,
    /// Seed of the choice of held-out places.
    pub seed: u64,
    /// Width of the places that are held out \[m\].
    pub place_m: f64,
}

/// Points of one source wanted in the smallest patch.
const POINTS_WANTED: f64 = 8.0;
/// Largest incidence in drives \[deg\]: beyond it patches have few rows of points (docs/benchmarks.md, "Grazing beams").
const GRAZING_DEG: f64 = 75.0;
const CELL_BITS: std::ops::RangeInclusive<u32> = 12..=17;

impl Settings {
    /// Derives the settings from a sample of the survey.
    ///
    /// # Errors
    /// When the sample cannot be summed (a full temporary folder).
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // logarithms of widths, clamped
    pub fn derive(
        project: &Project,
        survey: &Survey,
        sample: &Sample,
        memory_bytes: u64,
        threads: usize,
    ) -> Result<Self> {
        let mut list = Vec::new();
        let mut tell = |key: &str, value: String, reason: &str| {
            list.push(Setting { key: key.to_string(), value, reason: reason.to_string() });
        };
        let m = &project.matching;
        let asked = "as asked";
        let (rule, why) = sample.source_rule(project);
        tell("strips.split, strips.scanner", format!("{:?}", rule.scanner).to_lowercase(), &why);

        let widths_m: Vec<f64> = CELL_BITS.map(|bits| f64::from(1_u32 << bits) / 16_384.0).collect();
        let counts = sample.points_per_cell(survey, &rule, &widths_m, POINTS_WANTED);
        let dense = counts.iter().position(|n| *n >= POINTS_WANTED).unwrap_or(counts.len().saturating_sub(1));
        let (cell_bits, reason) = match m.patch_m {
            Some(width_m) => ((width_m.log2().round() as i32 + 14).clamp(8, 18) as u32, String::from(asked)),
            None => {
                (*CELL_BITS.start() + dense as u32, format!("holds {} points of one strip (median)", counts[dense]))
            }
        };
        let cell_m = f64::from(1_u32 << cell_bits) / 16_384.0;
        tell("match.patch_m", format!("{cell_m}"), &reason);
        let levels = m.patch_levels.unwrap_or(1);
        let largest_m = cell_m * f64::from(1_u32 << levels);
        let reason = if m.patch_levels.is_some() { asked } else { "twice as wide where the surface is plane" };
        tell("match.patch_levels", format!("{levels} (up to {largest_m} m)"), reason);

        let filter = filter(project);
        tell("match.returns", format!("{:?}", filter.returns).to_lowercase(), "last returns reach the hard surface");
        // A cell takes about 170 bytes with its place in the index; half the budget is for cells.
        let cells_in_memory = ((memory_bytes / 2 / 170) as usize / threads.max(1)).clamp(20_000, 50_000_000);
        // a vehicle turns: what it sees of a place a second later it sees from elsewhere
        let time_bin_s = if project.imu.is_some() { 0.5 } else { 8.0 };
        let grid = GridOptions { origin_m: survey.origin_m, cell_bits, time_bin_s, cells_in_memory, filter, rule };

        // from a vehicle a façade is near: its foot and its eaves are seen at ranges that differ by metres
        let wall_layers = project.imu.is_some().then(|| 2_u32 << levels);
        if let Some(layers) = wall_layers {
            let reason = "twice the width of the largest patch: from a vehicle, ranges change along a façade";
            tell("match.patch_m, height on walls", format!("{}", f64::from(layers) * cell_m), reason);
        }

        let min_points = m.min_points.unwrap_or(8);
        tell("match.min_points", min_points.to_string(), "a plane with a residual that means something");
        let strips = strip_options(project);
        tell(
            "strips.time_gap_s",
            strips.time_gap_s.map_or_else(|| String::from("none"), |g| g.to_string()),
            "a gap in time begins a new strip",
        );

        let loose = PatchOptions { levels, min_points, max_roughness_m: 0.15, wall_layers };
        let noise_m = sample_noise_m(survey, sample, &grid, strips, &loose)?;
        let max_roughness_m = m.max_roughness_m.unwrap_or_else(|| (2.5 * noise_m).clamp(0.03, 0.08));
        let reason = if m.max_roughness_m.is_some() {
            String::from(asked)
        } else {
            format!("2.5 × the noise of smooth patches ({:.1} mm), 30 to 80 mm", noise_m * 1e3)
        };
        tell("match.max_roughness_m", format!("{max_roughness_m:.3}"), &reason);

        let defaults = PairingOptions::default();
        let search_m = m.search_m.unwrap_or_else(|| (0.25 * largest_m).clamp(0.3, 1.0));
        let reason = if m.search_m.is_some() { asked } else { "a quarter of the largest patch, 0.3 to 1 m" };
        tell("match.search_m", format!("{search_m}"), reason);
        let normal_angle_rad = m.normal_angle_deg.map_or(defaults.normal_angle_rad, f64::to_radians);
        let reason = if m.normal_angle_deg.is_some() { asked } else { "beyond three sigmas of the two normals" };
        tell("match.normal_angle_deg", format!("{:.1}", normal_angle_rad.to_degrees()), reason);

        let limits = Limits {
            scanners: m.scanners.clone(),
            range_m: m.range_m,
            max_incidence_deg: m.max_incidence_deg.or(project.imu.as_ref().map(|_| GRAZING_DEG)),
            lever_arms_m: project.platform.scanner.iter().map(|s| (s.id, s.lever_arm_m)).collect(),
            area_m: m.area_m,
            surfaces: m.surfaces.clone(),
        };
        if let Some(scanners) = &limits.scanners {
            tell("match.scanners", format!("{scanners:?}"), asked);
        }
        if let Some(range_m) = &limits.range_m {
            tell("match.range_m", format!("{range_m:?}"), asked);
        }
        if let Some(deg) = &limits.max_incidence_deg {
            let grazing = "beyond it few rows of points lie across a patch";
            tell(
                "match.max_incidence_deg",
                format!("{deg}"),
                if m.max_incidence_deg.is_some() { asked } else { grazing },
            );
        }
        if let Some(area_m) = &limits.area_m {
            tell("match.area_m", format!("{area_m:?}"), asked);
        }
        if let Some(surfaces) = &limits.surfaces {
            tell("match.surfaces", format!("{surfaces:?}").to_lowercase(), asked);
        }
        if m.xyz != XyzChoice::Off {
            let kinds = m.xyz.kinds(project.imu.is_some());
            let words: Vec<&str> = kinds.iter().map(|k| k.as_str()).collect();
            let meanings: Vec<&str> = kinds.iter().map(|k| k.meaning()).collect();
            tell("match.xyz", words.join(", "), &meanings.join(", "));
        }
        if m.surface_lines == Some(false) {
            tell(
                "match.surface_lines",
                String::from("false"),
                "surface lines judge the solution, and take no part in it",
            );
        }
        // a drive lives on increments: so many a second
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let of_drive = || {
            let seconds = |f: &SurveyFile| f.sampled_range_s.map_or(0.0, |[a, b]| b - a);
            ((TIES_PER_SECOND * survey.strip_files().map(seconds).sum::<f64>()) as usize).clamp(6_000, 200_000)
        };
        let (max_ties, reason) = match (m.max_ties, &project.imu) {
            (Some(given), _) => (given, asked),
            (None, Some(_)) => (of_drive(), "200 for each second of the drive; like ones go to the smoother as one"),
            (None, None) => (6_000, "far more than the unknowns need"),
        };
        tell("match.max_ties", max_ties.to_string(), reason);
        let hold_out = m.hold_out.unwrap_or(0.2);
        let seed = m.seed.unwrap_or(1);
        tell("match.hold_out", format!("{hold_out} (seed {seed})"), "by place, to judge the solution");
        Ok(Self {
            grid,
            patch: PatchOptions { levels, min_points, max_roughness_m, wall_layers },
            pairing: PairingOptions { search_m, normal_angle_rad, ..defaults },
            limits,
            strips,
            max_ties,
            min_spacing_m: m.min_spacing_m.unwrap_or(0.0),
            min_spacing_s: m.min_spacing_s.unwrap_or(0.0),
            hold_out,
            seed,
            xyz: m.xyz.kinds(project.imu.is_some()),
            xyz_auto: m.xyz == XyzChoice::Auto,
            surface_lines: m.surface_lines.unwrap_or(true),
            is_drive: project.imu.is_some(),
            list,
        })
    }

    /// How patches become ties.
    #[must_use]
    pub fn grouping(&self) -> Grouping {
        Grouping {
            pairing: self.pairing,
            tile_m: self.grid.cell_m() * 32.0,
            max_ties: self.max_ties,
            spacing: (self.min_spacing_m, self.min_spacing_s),
            hold_out: self.hold_out,
            seed: self.seed,
            place_m: (self.grid.cell_m() * 8.0).max(8.0),
        }
    }
}

fn strip_options(project: &Project) -> StripOptions {
    let defaults = StripOptions::default();
    let by_time = project.strips.iter().any(|s| s.split.has(SplitWord::Auto) || s.split.has(SplitWord::TimeGap));
    let gap = project.strips.iter().find_map(|s| s.time_gap_s).or(defaults.time_gap_s);
    StripOptions { time_gap_s: gap.filter(|_| by_time), ..defaults }
}

fn filter(project: &Project) -> PointFilter {
    let m = &project.matching;
    let mut filter = PointFilter::default();
    if let Some(classes) = &m.exclude_classes {
        filter.excluded_classes = [false; 256];
        for class in classes {
            filter.excluded_classes[usize::from(*class)] = true;
        }
    }
    filter.included_classes = m.classes.as_ref().map(|classes| {
        let mut set = Box::new([false; 256]);
        for class in classes {
            set[usize::from(*class)] = true;
        }
        set
    });
    filter.returns = match m.returns {
        None | Some(ReturnsChoice::Last) => Returns::Last,
        Some(ReturnsChoice::Single) => Returns::Single,
        Some(ReturnsChoice::All) => Returns::All,
    };
    if let Some(limit) = m.max_scan_angle_deg {
        filter.max_scan_angle_deg = limit;
    }
    filter
}

/// Roughness of the smoother quarter of the patches in the sample \[m\]: the noise of the scanner on smooth ground.
fn sample_noise_m(
    survey: &Survey,
    sample: &Sample,
    grid: &GridOptions,
    strips: StripOptions,
    patch: &PatchOptions,
) -> Result<f64> {
    let mut accumulator = Accumulator::new(grid.clone());
    for (f, columns, first) in &sample.chunks {
        accumulator.add(&block(&survey.files[*f], columns, &[], *first))?;
    }
    let (runs, sketches, _) = accumulator.finish();
    let index = StripIndex::new(&sketches.into_sorted(), strips, |_, _, _| String::new());
    let mut tiles = TileMerge::new(runs)?;
    let mut roughness = Vec::new();
    while let Some(cells) = tiles.next_tile()? {
        roughness.extend(patches_of_tile(&cells, grid, &index, patch).iter().map(|p| p.roughness_m));
    }
    roughness.sort_by(f64::total_cmp);
    Ok(roughness.get(roughness.len() / 4).copied().unwrap_or(0.03))
}
