//! Ties of points against the truth of a simulated drive: errors at the true trajectory and calibration.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, UnitQuaternion, Vector3};
use tieline::job::Matched;
use tieline_filter::Trajectory;
use tieline_io::trajectory::{ReadOptions, read};
use tieline_matching::xyz::texture::SpotEnd;
use tieline_matching::xyz::{XyzEnd, XyzKind};

use crate::prove::Row;
use crate::prove::mobile::{text, tieline};

/// Component errors beyond so many sigmas are blunders.
const BLUNDER: f64 = 5.0;

/// What is true of a drive.
struct Truth {
    /// In the map, on the clock of the strips.
    trajectory: Trajectory,
    scanners: Vec<TrueScanner>,
}

/// A scanner as it was taken to be, and as it is.
struct TrueScanner {
    arm_m: [Vector3<f64>; 2],
    body_from_scanner: [UnitQuaternion<f64>; 2],
    /// Measured range and what it is too long by \[m\].
    bias: Vec<(f64, f64)>,
}

fn trajectory(path: &Path) -> Result<Trajectory> {
    Ok(read(path, &ReadOptions { format: None, columns: None, accuracy: None })?.trajectory)
}

fn vector(value: Option<&toml::Value>) -> Vector3<f64> {
    let numbers = value.and_then(toml::Value::as_array).into_iter().flatten().filter_map(toml::Value::as_float);
    Vector3::from_iterator(numbers.chain(std::iter::repeat(0.0)).take(3))
}

impl Truth {
    fn load(data: &Path, matched: &Matched) -> Result<Self> {
        let crs = matched.survey.crs.as_ref().context("a reference system")?;
        let delivered = matched.poses.shared().context("a trajectory")?;
        // the clock of the strips against that of the files
        let shift_s = delivered.span_s().0 - trajectory(&data.join("trajectory.sbet"))?.span_s().0;
        let truth = crs.to_map(&trajectory(&data.join("truth/truth.sbet"))?)?.shifted_in_time(shift_s);
        let table = |name: &str| -> Result<toml::Table> { Ok(std::fs::read_to_string(data.join(name))?.parse()?) };
        let (nominal, real) = (table("calibration.toml")?, table("truth/calibration_true.toml")?);
        let curves = std::fs::read_to_string(data.join("truth/bias_functions.csv"))?;
        let scanners = ["scanner1", "scanner2"].into_iter().zip(["1", "2"]).map(|(name, number)| {
            let of = |table: &toml::Table, key: &str| {
                vector(table.get(name).and_then(toml::Value::as_table).and_then(|t| t.get(key)))
            };
            let mounting = |table: &toml::Table| {
                let a = of(table, "rpy_deg").map(f64::to_radians);
                UnitQuaternion::from_euler_angles(a.x, a.y, a.z)
            };
            let turned = Rotation3::new(of(&real, "misalignment_body_deg").map(f64::to_radians));
            let bias = curves.lines().filter_map(|l| {
                let mut f = l.split(',');
                (f.next()? == number).then(|| Some((f.next()?.parse().ok()?, f.next()?.parse().ok()?)))?
            });
            TrueScanner {
                arm_m: [of(&nominal, "lever_arm_m"), of(&nominal, "lever_arm_m") + of(&real, "lever_arm_error_m")],
                body_from_scanner: [mounting(&nominal), UnitQuaternion::from(turned) * mounting(&nominal)],
                bias: bias.collect(),
            }
        });
        Ok(Self { trajectory: truth, scanners: scanners.collect() })
    }

    /// Where an end's points really are \[m\].
    fn place_m(&self, matched: &Matched, end: &End) -> Option<Vector3<f64>> {
        let scanner = self.scanners.get(usize::from(end.scanner))?;
        let delivered = matched.poses.shared()?.pose_at(end.time_s)?;
        let body_m = delivered.body_vector_m(&(end.place_m + matched.survey.origin()));
        let ray_m = scanner.body_from_scanner[0].inverse_transform_vector(&(body_m - scanner.arm_m[0]));
        let measured_m = ray_m.norm();
        let next = scanner.bias.partition_point(|b| b.0 < measured_m).clamp(1, scanner.bias.len() - 1);
        let (a, b) = (scanner.bias[next - 1], scanner.bias[next]);
        let bias_m = a.1 + (b.1 - a.1) * (measured_m - a.0) / (b.0 - a.0);
        let body_m = scanner.arm_m[1] + scanner.body_from_scanner[1] * (ray_m * ((measured_m - bias_m) / measured_m));
        let pose = self.trajectory.pose_at(end.time_s)?;
        Some(pose.position + pose.map_from_ned * (pose.ned_from_body * body_m))
    }
}

/// One tie against the truth, along what it holds.
pub(super) struct Judged {
    /// How it was found.
    pub(super) kind: XyzKind,
    pub(super) error_m: DVector<f64>,
    covariance_m2: DMatrix<f64>,
    /// Between strips, or within one visit.
    pub(super) passes: bool,
    /// Number of what it is a tie of, among its kind.
    pub(super) feature: u32,
}

/// An end of any kind of tie.
struct End {
    strip: u32,
    scanner: u16,
    time_s: f64,
    place_m: Vector3<f64>,
}

/// What there is to judge of any kind of tie.
struct Tie {
    kind: XyzKind,
    ends: [End; 2],
    held: Vec<Vector3<f64>>,
    covariance_m2: Matrix3<f64>,
    feature: u32,
}

impl Judged {
    pub(super) fn rank(&self) -> usize {
        self.error_m.len()
    }

    fn is_blunder(&self) -> bool {
        (0..self.rank()).any(|k| self.error_m[k].abs() > BLUNDER * self.covariance_m2[(k, k)].sqrt())
    }

    fn square(&self) -> f64 {
        let inverse = self.covariance_m2.clone().try_inverse();
        inverse.map_or(f64::NAN, |inverse| self.error_m.dot(&(inverse * &self.error_m)))
    }
}

/// A project with `xyz` in its `[match]`, beside the original.
pub(super) fn asked(project: &Path, xyz: &str) -> Result<PathBuf> {
    let source = std::fs::read_to_string(project)?;
    ensure!(!source.contains("[match]"), "{}: has a [match] already", project.display());
    let beside = project.with_file_name("asked.toml");
    std::fs::write(&beside, format!("{source}\n[match]\nxyz = {xyz}\n"))?;
    Ok(beside)
}

/// The accepted ties of a job, whoever found them.
fn accepted(matched: &Matched) -> Result<Vec<Tie>> {
    let of_spot = |end: &SpotEnd| -> Result<End> {
        let (strip, scanner) = matched.strips.find(end.source, end.time_s).context("a strip")?;
        Ok(End { strip, scanner, time_s: end.time_s, place_m: end.place_m })
    };
    let mut ties = Vec::new();
    for s in matched.spots.iter().filter(|s| s.rejection.is_none()) {
        let ends = [of_spot(&s.ends[0])?, of_spot(&s.ends[1])?];
        let (kind, feature) = (XyzKind::Texture, s.spot);
        ties.push(Tie { kind, ends, held: s.held(), covariance_m2: s.covariance_m2, feature });
    }
    for f in matched.features.iter().filter(|f| f.rejection.is_none()) {
        let end = |e: &XyzEnd| End { strip: e.strip, scanner: e.scanner, time_s: e.time_s, place_m: e.place_m };
        let (kind, feature) = (f.kind, f.feature);
        let ends = f.ends.each_ref().map(end);
        ties.push(Tie { kind, ends, held: f.held(), covariance_m2: f.covariance_m2(), feature });
    }
    Ok(ties)
}

/// Matches a project and judges what it found; doubly driven way as well \[m\].
pub(super) fn judged(project: &Path, data: &Path, out: &Path) -> Result<(Vec<Judged>, f64)> {
    tieline(&["match", "--quiet", "--out", text(out)?, text(project)?])?;
    let matched = tieline::state::load_match(&tieline::project::Project::load(project)?, out)?;
    let truth = Truth::load(data, &matched)?;
    let judged = accepted(&matched)?
        .iter()
        .map(|tie| {
            let place = |k: usize| truth.place_m(&matched, &tie.ends[k]).context("a pose of the truth");
            let held = DMatrix::from_fn(tie.held.len(), 3, |i, k| tie.held[i][k]);
            let (error_m, c) = (place(1)? - place(0)?, tie.covariance_m2);
            Ok(Judged {
                kind: tie.kind,
                error_m: &held * DVector::from_column_slice(error_m.as_slice()),
                covariance_m2: &held * DMatrix::from_column_slice(3, 3, c.as_slice()) * held.transpose(),
                passes: tie.ends[0].strip != tie.ends[1].strip,
                feature: tie.feature,
            })
        })
        .collect::<Result<Vec<_>>>()?;
    Ok((judged, doubly_driven_m(&matched)?))
}

/// Way of the last strip that an earlier one passed within three metres \[m\].
fn doubly_driven_m(matched: &Matched) -> Result<f64> {
    let trajectory = matched.poses.shared().context("a trajectory")?;
    let strips = matched.strips.strips();
    let way = |k: usize| {
        let mut places: Vec<Vector3<f64>> = Vec::new();
        let mut time_s = strips[k].start_s;
        while time_s < strips[k].end_s {
            let place = trajectory.pose_at(time_s).map(|p| p.position);
            places.extend(place.filter(|p| places.last().is_none_or(|last| (p - last).norm() >= 0.5)));
            time_s += 0.02;
        }
        places
    };
    let ways: Vec<Vec<Vector3<f64>>> = (0..strips.len()).map(way).collect();
    let (last, before) = ways.split_last().context("strips")?;
    let near = |p: &Vector3<f64>| before.iter().flatten().any(|q| (p - q).xy().norm() < 3.0);
    Ok(last.windows(2).filter(|w| near(&w[0])).map(|w| (w[1] - w[0]).norm()).sum())
}

/// Fewest ties whose mean of eᵀΣ⁻¹e is bounded: that of 100 of rank 2 spreads by 0.2 about its expectation, half the bound and more.
const ENOUGH: usize = 100;

/// Mean of eᵀΣ⁻¹e of the ties of a rank without blunders.
#[allow(clippy::cast_precision_loss)]
fn mean_square(name: &str, of_rank: &[&Judged]) -> Option<Row> {
    let (rank, low, high) = match of_rank.first()?.rank() {
        3 => (3, 2.5, 3.5),
        rank => (rank, 1.65, 2.35),
    };
    let good: Vec<f64> = of_rank.iter().filter(|j| !j.is_blunder()).map(|j| j.square()).collect();
    let mean = good.iter().sum::<f64>() / good.len() as f64;
    let name = format!("{name}, rank {rank}: mean of eᵀΣ⁻¹e without blunders");
    if good.len() < ENOUGH {
        println!("{name}: {mean:.2} of {}, too few for the bound of {low} to {high}", good.len());
        return None;
    }
    Some(Row::between(name, mean, low, high, ""))
}

/// Whether sigmas are right, whatever the kind of tie.
pub(super) fn of_all_kinds(name: &str, all: &[Judged]) -> Vec<Row> {
    let of_rank = |rank: usize| all.iter().filter(|j| j.rank() == rank).collect::<Vec<_>>();
    [3, 2].into_iter().filter_map(|rank| mean_square(name, &of_rank(rank))).collect()
}

/// Blunders, errors and whether sigmas are right, by rank.
#[allow(clippy::cast_precision_loss)]
pub(super) fn rows(name: &str, all: &[&Judged], most_rms_mm: f64) -> Vec<Row> {
    let blunders = all.iter().filter(|j| j.is_blunder()).count() as f64;
    let largest = all.iter().map(|j| j.error_m.amax()).fold(0.0, f64::max);
    println!("{name}: {} ties, largest error {:.0} mm", all.len(), 1e3 * largest);
    let mut lines = vec![Row::at_most(format!("{name}: blunders"), 100.0 * blunders / all.len() as f64, 0.5, "%")];
    for rank in [3, 2] {
        let of_rank: Vec<&Judged> = all.iter().copied().filter(|j| j.rank() == rank).collect();
        if of_rank.is_empty() {
            println!("{name}, rank {rank}: none");
            continue;
        }
        let square = |k: usize| of_rank.iter().map(|j| j.error_m[k].powi(2)).sum::<f64>() / of_rank.len() as f64;
        let rms_mm: Vec<f64> = (0..rank).map(|k| 1e3 * square(k).sqrt()).collect();
        let blunders = of_rank.iter().filter(|j| j.is_blunder()).count();
        println!("{name}, rank {rank}: {} ties, rms {rms_mm:.1?} mm, {blunders} blunders", of_rank.len());
        let worst = rms_mm.iter().copied().fold(f64::NAN, f64::max);
        lines.push(Row::at_most(format!("{name}, rank {rank}: rms of the worst component"), worst, most_rms_mm, "mm"));
        lines.extend(mean_square(name, &of_rank));
    }
    lines
}
