//! What the adjustment is about: strips and scanners with their priors.

use nalgebra::Vector3;
use tieline_filter::PoseSigma;
use tieline_graph::{CalibrationSigmas, CalibrationTerms, Model, StripSpec, TimeModel};
use tieline_matching::{CONTROL_FILE, StripIndex};

use crate::project::Project;
use crate::stage::trajectory::Poses;
use crate::survey::Survey;

/// A scanner in a mission: what a set of calibration terms belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CalibrationBlock {
    /// Scanner, 0-based.
    pub scanner: u16,
    /// Mission.
    pub mission: u16,
}

/// Strips, scanners, priors.
#[derive(Debug, Clone)]
pub struct Setup {
    /// One for each strip of the survey, control surfaces included (as fixed).
    pub strips: Vec<StripSpec>,
    /// Calibration blocks.
    pub blocks: Vec<CalibrationBlock>,
    /// Nominal lever arm of each block, body frame \[m\].
    pub lever_arms_m: Vec<Vector3<f64>>,
    /// Block of each strip and scanner.
    block_of: Vec<Vec<usize>>,
    /// Which strips are control surfaces.
    pub is_control: Vec<bool>,
    terms: CalibrationTerms,
    sigmas: CalibrationSigmas,
    /// Local origin \[m\].
    pub origin_m: Vector3<f64>,
    /// Floor of the sigma of a tie end \[m\].
    pub sigma_floor_m: f64,
    /// Whether the prior of the strips is that of a trajectory file rather than an assumption.
    pub prior_is_given: bool,
    /// How the priors were chosen.
    pub notes: Vec<String>,
}

/// Prior of the position where nothing is known, each axis \[m\].
const UNKNOWN_POSITION_M: f64 = 0.15;
/// Prior of the attitude where nothing is known, each axis \[deg\].
const UNKNOWN_ATTITUDE_DEG: f64 = 0.02;

impl Setup {
    /// The setup of a survey.
    #[must_use]
    pub fn new(project: &Project, survey: &Survey, index: &StripIndex, poses: &Poses, sigma_floor_m: f64) -> Self {
        let mut notes = Vec::new();
        let prior_is_given = prior_is_given(project, poses);
        if !prior_is_given {
            notes.push(format!(
                "no accuracy of the trajectory is given: {UNKNOWN_POSITION_M} m and {UNKNOWN_ATTITUDE_DEG}° are taken as the \
                 prior sigmas of its corrections (solve.position_sigma_m, solve.attitude_sigma_deg)"
            ));
        }
        let mut blocks: Vec<CalibrationBlock> = Vec::new();
        let (mut strips, mut block_of, mut is_control) = (Vec::new(), Vec::new(), Vec::new());
        for (i, strip) in index.strips().iter().enumerate() {
            let control = strip.source.file() >= CONTROL_FILE;
            let section = survey.files.iter().find(|f| f.number == strip.source.file()).map_or(0, |f| f.section);
            let by_section = project.strips.iter().any(|s| s.fixed)
                && (project.strips.len() == 1 || project.strips.get(section).is_some_and(|s| s.fixed));
            let fixed = control || by_section || project.solve.fixed.contains(&strip.name);
            #[allow(clippy::cast_possible_truncation)]
            let (position_sigma_m, rotation_sigma_rad) = priors(project, poses, i as u32, strip.start_s, strip.end_s);
            strips.push(StripSpec {
                start_s: strip.start_s,
                end_s: strip.end_s,
                fixed,
                position_sigma_m,
                rotation_sigma_rad,
            });
            is_control.push(control);
            let mut of_strip = Vec::new();
            for scanner in 0..index.scanner_numbers().len().max(1) {
                #[allow(clippy::cast_possible_truncation)]
                let block = CalibrationBlock { scanner: scanner as u16, mission: strip.mission };
                if !strip.scanners.contains(&block.scanner) || control {
                    of_strip.push(0);
                    continue;
                }
                let known = blocks.iter().position(|b| *b == block).unwrap_or_else(|| {
                    blocks.push(block);
                    blocks.len() - 1
                });
                of_strip.push(known);
            }
            block_of.push(of_strip);
        }
        let lever_arms_m = blocks
            .iter()
            .map(|b| {
                let scanner = project.platform.scanner.iter().find(|s| s.id == b.scanner);
                scanner.map_or_else(Vector3::zeros, |s| Vector3::from(s.lever_arm_m))
            })
            .collect();
        let c = &project.calibrate;
        Self {
            strips,
            blocks,
            lever_arms_m,
            block_of,
            is_control,
            terms: c.terms(),
            sigmas: CalibrationSigmas {
                boresight_rad: c.boresight_sigma_deg.to_radians(),
                lever_arm_m: c.lever_arm_sigma_m,
                range_offset_m: c.range_offset_sigma_m,
                range_scale: c.range_scale_sigma_ppm * 1e-6,
            },
            origin_m: survey.origin(),
            sigma_floor_m,
            prior_is_given,
            notes,
        }
    }

    /// Calibration block of a strip's scanner.
    #[must_use]
    pub fn block(&self, strip: u32, scanner: u16) -> usize {
        self.block_of.get(strip as usize).and_then(|b| b.get(usize::from(scanner))).copied().unwrap_or(0)
    }

    /// A model of this setup, at zero.
    #[must_use]
    pub fn model(&self, time_models: &[Option<TimeModel>]) -> Model {
        Model::new(&self.strips, time_models, self.blocks.len(), self.terms, &self.sigmas)
    }
}

fn prior_is_given(project: &Project, poses: &Poses) -> bool {
    let stated = project.solve.position_sigma_m.is_some()
        || project.trajectory.as_ref().is_some_and(|t| t.position_sigma_m.is_some());
    stated || poses.shared().is_some_and(|t| !t.sigma().is_empty())
}

/// Prior sigmas of a strip's corrections: as asked, else the trajectory's accuracy, else an assumption.
fn priors(project: &Project, poses: &Poses, strip: u32, start_s: f64, end_s: f64) -> (Vector3<f64>, Vector3<f64>) {
    let of_file = poses.shared().and_then(|t| {
        let rows: Vec<PoseSigma> =
            [0.0, 0.25, 0.5, 0.75, 1.0].iter().filter_map(|u| t.sigma_at(start_s + u * (end_s - start_s))).collect();
        #[allow(clippy::cast_precision_loss)]
        let mean = |f: fn(&PoseSigma) -> Vector3<f64>| rows.iter().map(f).sum::<Vector3<f64>>() / rows.len() as f64;
        if rows.is_empty() {
            return None;
        }
        let heading = poses.at(strip, 0.5 * (start_s + end_s)).map_or(0.0, |p| p.ned_from_body.euler_angles().2);
        let rph = mean(|s| s.attitude_rph_rad);
        let (sin, cos) = heading.sin_cos();
        // roll and pitch are about body axes; the prior is about north and east
        let rotation = Vector3::new((rph.x * cos).hypot(rph.y * sin), (rph.x * sin).hypot(rph.y * cos), rph.z);
        Some((mean(|s| s.position_ned_m), rotation))
    });
    let section = project.trajectory.as_ref();
    let position = project.solve.position_sigma_m.or_else(|| section.and_then(|t| t.position_sigma_m));
    let attitude = project.solve.attitude_sigma_deg.or_else(|| section.and_then(|t| t.attitude_sigma_deg));
    let (file_position, file_attitude) = of_file.map_or((None, None), |(p, a)| (Some(p), Some(a)));
    let least = |v: Vector3<f64>, floor: f64| v.map(|x| x.max(floor));
    (
        position
            .map(Vector3::repeat)
            .or(file_position)
            .map_or_else(|| Vector3::repeat(UNKNOWN_POSITION_M), |v| least(v, 1e-4)),
        attitude
            .map(|a| Vector3::repeat(a.to_radians()))
            .or(file_attitude)
            .map_or_else(|| Vector3::repeat(UNKNOWN_ATTITUDE_DEG.to_radians()), |v| least(v, 1e-7)),
    )
}
