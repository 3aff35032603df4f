//! The trajectory of every strip: read from a file, or rebuilt from the points.

use anyhow::{Result, bail};
use nalgebra::{Quaternion, UnitQuaternion, Vector3, Vector4};
use tieline_filter::{Pose, PoseSigma, PositionFrame, TimeEncoding, Trajectory, TrajectoryError, ned_from_body};
use tieline_io::trajectory::{ReadOptions, TrajectoryFormat, read};
use tieline_matching::{
    BinSketch, PathSource, ReturnPair, SamplePoint, SensorPath, SourceKey, StripIndex, level_path,
    path_from_return_pairs,
};

use crate::navigation::{in_map, on_clock};
use crate::project::{Project, TimeChoice, TrajectoryFormatChoice};
use crate::survey::Survey;

/// Where the poses of a strip come from, for the report.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PathReport {
    /// Strip.
    pub strip: String,
    /// `file`, `return pairs`, `scan angle` or `assumed height`.
    pub source: String,
    /// Course \[deg\] from grid north.
    pub course_deg: f64,
    /// Speed \[m/s\].
    pub speed_mps: f64,
    /// Height above the points \[m\].
    pub height_m: f64,
    /// Sigma of the position \[m\], where it was rebuilt.
    pub sigma_m: Option<f64>,
    /// What else there is to say.
    pub note: String,
}

/// A rebuilt path between stages, to the last bit.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct StoredPath {
    time_s: Vec<f64>,
    position_m: Vec<Vector3<f64>>,
    /// Quaternions x, y, z, w from body to north-east-down.
    attitude: Vec<Vector4<f64>>,
    velocity_ned_mps: Vec<Vector3<f64>>,
    /// Position \[m\], velocity \[m/s\], attitude \[rad\]; empty when unknown.
    sigma: Vec<[Vector3<f64>; 3]>,
}

impl StoredPath {
    fn of(t: &Trajectory) -> Self {
        Self {
            time_s: t.time_s().to_vec(),
            position_m: t.position().to_vec(),
            attitude: t.ned_from_body().iter().map(|q| q.coords).collect(),
            velocity_ned_mps: t.velocity_ned_mps().to_vec(),
            sigma: t.sigma().iter().map(|s| [s.position_ned_m, s.velocity_ned_mps, s.attitude_rph_rad]).collect(),
        }
    }

    /// Positions and attitudes alone.
    pub(crate) fn of_poses(t: &Trajectory) -> Self {
        Self {
            time_s: t.time_s().to_vec(),
            position_m: t.position().to_vec(),
            attitude: t.ned_from_body().iter().map(|q| q.coords).collect(),
            velocity_ned_mps: Vec::new(),
            sigma: Vec::new(),
        }
    }

    /// The trajectory in the map.
    pub(crate) fn trajectory(self) -> Result<Trajectory, TrajectoryError> {
        let attitude = self.attitude.into_iter().map(|q| UnitQuaternion::new_unchecked(Quaternion::from(q))).collect();
        let frame = PositionFrame::Map;
        let path = Trajectory::new(frame, self.time_s, self.position_m, attitude, self.velocity_ned_mps)?;
        if self.sigma.is_empty() {
            return Ok(path);
        }
        let sigma = |[position_ned_m, velocity_ned_mps, attitude_rph_rad]: [Vector3<f64>; 3]| PoseSigma {
            position_ned_m,
            velocity_ned_mps,
            attitude_rph_rad,
        };
        path.with_sigma(self.sigma.into_iter().map(sigma).collect())
    }
}

/// The poses of all strips.
#[derive(Debug)]
pub struct Poses {
    shared: Option<Trajectory>,
    by_strip: Vec<Option<Trajectory>>,
    /// How each strip got its poses.
    pub reports: Vec<PathReport>,
    /// What a user should be told.
    pub notes: Vec<String>,
}

impl Poses {
    /// Pose of a strip at a survey time \[s\], in map coordinates; `None` outside its trajectory.
    #[must_use]
    pub fn at(&self, strip: u32, time_s: f64) -> Option<Pose> {
        self.of(strip)?.pose_at(time_s)
    }

    /// The trajectory that a strip is georeferenced with.
    #[must_use]
    pub fn of(&self, strip: u32) -> Option<&Trajectory> {
        self.by_strip.get(strip as usize).and_then(Option::as_ref).or(self.shared.as_ref())
    }

    /// The trajectory of a file, when one was given.
    #[must_use]
    pub fn shared(&self) -> Option<&Trajectory> {
        self.shared.as_ref()
    }

    /// The rebuilt paths, to be stored between stages; the trajectory of a file is read anew.
    #[must_use]
    pub fn stored(&self) -> Vec<Option<StoredPath>> {
        self.by_strip.iter().map(|path| path.as_ref().map(StoredPath::of)).collect()
    }

    /// Poses of stored paths, or of the project's trajectory.
    ///
    /// # Errors
    /// When the trajectory cannot be read.
    pub fn restored(
        project: &Project,
        survey: &Survey,
        paths: Vec<Option<StoredPath>>,
        reports: Vec<PathReport>,
        notes: Vec<String>,
    ) -> Result<Self> {
        let shared = load(project, survey, &mut Vec::new())?;
        let by_strip =
            paths.into_iter().map(|p| p.map(StoredPath::trajectory).transpose()).collect::<Result<_, _>>()?;
        Ok(Self { shared, by_strip, reports, notes })
    }

    /// Poses by the project's trajectory as [`load`] gives it, or rebuilt for each strip.
    ///
    /// # Errors
    /// When the trajectory does not cover a strip; when a strip's course cannot be told.
    pub fn new(
        project: &Project,
        survey: &Survey,
        given: Option<Trajectory>,
        strips: &StripIndex,
        sketches: &[((SourceKey, i64), BinSketch)],
    ) -> Result<Self> {
        match given {
            Some(trajectory) => from_file(project, survey, trajectory, strips, sketches),
            None => rebuilt(survey, strips, sketches),
        }
    }
}

/// Reads the project's trajectory into map coordinates and survey time.
///
/// # Errors
/// As the readers; when a geodetic trajectory meets strips without a reference system.
pub fn load(project: &Project, survey: &Survey, notes: &mut Vec<String>) -> Result<Option<Trajectory>> {
    let Some(section) = &project.trajectory else { return Ok(None) };
    let path = project.resolve(&section.path);
    let format = section.format.map(|f| match f {
        TrajectoryFormatChoice::Sbet => TrajectoryFormat::Sbet,
        TrajectoryFormatChoice::Trj => TrajectoryFormat::Trj,
        TrajectoryFormatChoice::Text => TrajectoryFormat::Text,
    });
    let accuracy = section.accuracy.as_ref().map(|p| project.resolve(p));
    let file = read(&path, &ReadOptions { format, columns: section.columns.clone(), accuracy })?;
    notes.extend(file.notes.iter().cloned());
    let trajectory = in_map(&file, &path, survey.crs.as_ref(), "set project.crs")?;
    let encoding = match section.time {
        TimeChoice::Auto => file.time_encoding,
        TimeChoice::GpsWeek => TimeEncoding::SecondsOfWeek,
        TimeChoice::Adjusted => TimeEncoding::AdjustedStandard,
    };
    Ok(Some(on_clock(trajectory, &file, &path, encoding, &survey.clock, "set project.week")?))
}

fn from_file(
    project: &Project,
    survey: &Survey,
    trajectory: Trajectory,
    strips: &StripIndex,
    sketches: &[((SourceKey, i64), BinSketch)],
) -> Result<Poses> {
    let mut notes = Vec::new();
    let name = project.trajectory.as_ref().map(|t| t.path.display().to_string()).unwrap_or_default();
    let (first, last) = trajectory.span_s();
    let mut reports = Vec::new();
    for (i, strip) in strips.strips().iter().enumerate() {
        if strip.source.file() >= tieline_matching::CONTROL_FILE {
            continue;
        }
        if strip.start_s < first - 1e-3 || strip.end_s > last + 1e-3 {
            bail!(
                "strip {} ({:.3} s to {:.3} s) is not covered by {name} ({first:.3} s to {last:.3} s): give the trajectory \
                 of this flight, or check time systems (project.time, project.week, trajectory.time)",
                strip.name,
                strip.start_s,
                strip.end_s
            );
        }
        let middle = 0.5 * (strip.start_s + strip.end_s);
        let Some(pose) = trajectory.pose_at(middle) else { continue };
        let ground = samples_of(sketches, strips, i);
        let height_m = pose.position.z - survey.origin_m[2] - mean_height(&ground);
        // a vehicle drives among its points
        if project.imu.is_none() && !(0.5..20_000.0).contains(&height_m) && !ground.is_empty() {
            notes.push(format!(
                "strip {}: the trajectory is {height_m:.0} m above the points; are heights and reference system the same?",
                strip.name
            ));
        }
        let (a, b) = (trajectory.pose_at(strip.start_s), trajectory.pose_at(strip.end_s));
        let moved = a.zip(b).map_or_else(Vector3::zeros, |(a, b)| b.position - a.position);
        reports.push(PathReport {
            strip: strip.name.clone(),
            source: String::from("file"),
            course_deg: moved.x.atan2(moved.y).to_degrees().rem_euclid(360.0),
            speed_mps: moved.xy().norm() / (strip.end_s - strip.start_s).max(1e-3),
            height_m,
            sigma_m: trajectory.sigma_at(middle).map(|s| s.position_ned_m.norm()),
            note: String::new(),
        });
    }
    Ok(Poses { shared: Some(trajectory), by_strip: vec![None; strips.strips().len()], reports, notes })
}

fn of_strip<'a>(
    sketches: &'a [((SourceKey, i64), BinSketch)],
    strips: &'a StripIndex,
    strip: usize,
) -> impl Iterator<Item = &'a BinSketch> {
    sketches
        .iter()
        .filter_map(move |((source, _), bin)| (strips.find(*source, bin.first_s)?.0 as usize == strip).then_some(bin))
}

fn samples_of(sketches: &[((SourceKey, i64), BinSketch)], strips: &StripIndex, strip: usize) -> Vec<SamplePoint> {
    of_strip(sketches, strips, strip).flat_map(|bin| bin.samples().copied()).collect()
}

#[allow(clippy::cast_precision_loss)]
fn mean_height(samples: &[SamplePoint]) -> f64 {
    samples.iter().map(|s| s.point_m[2]).sum::<f64>() / samples.len().max(1) as f64
}

fn rebuilt(survey: &Survey, strips: &StripIndex, sketches: &[((SourceKey, i64), BinSketch)]) -> Result<Poses> {
    let mut poses = Poses { shared: None, by_strip: Vec::new(), reports: Vec::new(), notes: Vec::new() };
    for (i, strip) in strips.strips().iter().enumerate() {
        if strip.source.file() >= tieline_matching::CONTROL_FILE {
            poses.by_strip.push(None);
            continue;
        }
        let pairs: Vec<ReturnPair> = of_strip(sketches, strips, i).flat_map(|bin| bin.pairs().copied()).collect();
        let samples = samples_of(sketches, strips, i);
        let (path, note) = match path_from_return_pairs(&pairs, strip.start_s, strip.end_s) {
            Ok(path) => (path, String::new()),
            Err(refused) => {
                let Some(path) = level_path(&samples, strip.start_s, strip.end_s) else {
                    bail!(
                        "strip {}: no trajectory was given, return pairs do not give one ({refused}), and the course cannot \
                         be told from the times of its points; give [trajectory] or leave the strip out",
                        strip.name
                    );
                };
                (path, format!("return pairs refused: {refused}"))
            }
        };
        poses.reports.push(report(
            &path,
            &strip.name,
            note,
            0.5 * (strip.start_s + strip.end_s),
            mean_height(&samples),
        ));
        poses.by_strip.push(Some(trajectory_of(&path, strip.start_s, strip.end_s, &survey.origin())?));
    }
    poses.notes.push(String::from(
        "no trajectory was given: positions and courses are rebuilt, attitudes taken as level; boresight and lever arm \
         are known only as far as that",
    ));
    Ok(poses)
}

fn report(path: &SensorPath, strip: &str, note: String, middle_s: f64, ground_m: f64) -> PathReport {
    let (position, velocity) = path.at(middle_s);
    let source = match path.source {
        PathSource::ReturnPairs { pairs, misfit_m } => format!("{pairs} return pairs, misfit {:.0} mm", misfit_m * 1e3),
        PathSource::ScanAngle { .. } => String::from("level flight, height by scan angle"),
        PathSource::AssumedHeight => String::from("level flight, height assumed"),
    };
    PathReport {
        strip: strip.to_string(),
        source,
        course_deg: velocity.x.atan2(velocity.y).to_degrees().rem_euclid(360.0),
        speed_mps: velocity.xy().norm(),
        height_m: position.z - ground_m,
        sigma_m: Some(path.sigma_m(middle_s).norm()),
        note,
    }
}

/// Epochs of a rebuilt path ten times a second, level, heading along the course.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn trajectory_of(path: &SensorPath, start_s: f64, end_s: f64, origin: &Vector3<f64>) -> Result<Trajectory> {
    let (start_s, end_s) = (start_s - 0.2, end_s + 0.2);
    let steps = ((end_s - start_s) / 0.1).ceil().max(1.0) as usize;
    let (mut times, mut positions, mut attitudes, mut velocities, mut sigmas) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for k in 0..=steps {
        let time_s = start_s + (end_s - start_s) * k as f64 / steps as f64;
        let (position, velocity) = path.at(time_s);
        let sigma = path.sigma_m(time_s);
        times.push(time_s);
        positions.push(position + origin);
        attitudes.push(ned_from_body(0.0, 0.0, velocity.x.atan2(velocity.y)));
        velocities.push(Vector3::new(velocity.y, velocity.x, -velocity.z));
        sigmas.push(PoseSigma {
            position_ned_m: Vector3::new(sigma.y, sigma.x, sigma.z),
            velocity_ned_mps: Vector3::zeros(),
            // unknown: a few degrees of roll and pitch, some of crab
            attitude_rph_rad: Vector3::new(5.0, 5.0, 10.0).map(f64::to_radians),
        });
    }
    Ok(Trajectory::new(PositionFrame::Map, times, positions, attitudes, velocities)?.with_sigma(sigmas)?)
}
