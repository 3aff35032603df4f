//! Lines 1, 5 and 6: texture of pavement, judged at the true trajectory and calibration.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use nalgebra::{DMatrix, DVector, Rotation3, UnitQuaternion, Vector3};
use tieline::cpu;
use tieline::job::Matched;
use tieline_filter::Trajectory;
use tieline_io::trajectory::{ReadOptions, read};
use tieline_matching::xyz::texture::SpotEnd;

use crate::prove::Row;
use crate::prove::mobile::{seeds, simulate, text, tieline};
use crate::prove::real::{program, root};

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
    fn place_m(&self, matched: &Matched, end: &SpotEnd) -> Option<Vector3<f64>> {
        let (_, scanner) = matched.strips.find(end.source, end.time_s)?;
        let scanner = self.scanners.get(usize::from(scanner))?;
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

/// One tie against the truth, along what it holds: across and up, with a second direction of the plane or without.
struct Judged {
    error_m: DVector<f64>,
    covariance_m2: DMatrix<f64>,
    /// Between strips, or within one visit.
    passes: bool,
    spot: u32,
}

impl Judged {
    fn rank(&self) -> usize {
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

/// Matches a project and judges what it found; doubly driven way as well \[m\].
fn judged(project: &Path, data: &Path, out: &Path) -> Result<(Vec<Judged>, f64)> {
    tieline(&["match", "--quiet", "--out", text(out)?, text(project)?])?;
    let matched = tieline::state::load_match(&tieline::project::Project::load(project)?, out)?;
    let truth = Truth::load(data, &matched)?;
    let accepted = matched.spots.iter().filter(|s| s.rejection.is_none());
    let judged = accepted
        .map(|s| {
            let place = |k: usize| truth.place_m(&matched, &s.ends[k]).context("a pose of the truth");
            let strip = |k: usize| matched.strips.find(s.ends[k].source, s.ends[k].time_s).map(|f| f.0);
            let held = s.held();
            let held = DMatrix::from_fn(held.len(), 3, |i, k| held[i][k]);
            let (error_m, c) = (place(1)? - place(0)?, s.covariance_m2);
            Ok(Judged {
                error_m: &held * DVector::from_column_slice(error_m.as_slice()),
                covariance_m2: &held * DMatrix::from_column_slice(3, 3, c.as_slice()) * held.transpose(),
                passes: strip(0) != strip(1),
                spot: s.spot,
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

#[allow(clippy::cast_precision_loss)]
fn rows(name: &str, all: &[Judged]) -> Vec<Row> {
    let blunders = all.iter().filter(|j| j.is_blunder()).count() as f64;
    let largest = all.iter().map(|j| j.error_m.amax()).fold(0.0, f64::max);
    println!("{name}: {} ties, largest error {:.0} mm", all.len(), 1e3 * largest);
    let mut lines = vec![Row::at_most(format!("{name}: blunders"), 100.0 * blunders / all.len() as f64, 0.5, "%")];
    for (rank, low, high) in [(3, 2.5, 3.5), (2, 1.65, 2.35)] {
        let of_rank: Vec<&Judged> = all.iter().filter(|j| j.rank() == rank).collect();
        let square = |k: usize| of_rank.iter().map(|j| j.error_m[k].powi(2)).sum::<f64>() / of_rank.len() as f64;
        let rms_mm: Vec<f64> = (0..rank).map(|k| 1e3 * square(k).sqrt()).collect();
        let good: Vec<f64> = of_rank.iter().filter(|j| !j.is_blunder()).map(|j| j.square()).collect();
        let blunders = of_rank.len() - good.len();
        println!("{name}, rank {rank}: {} ties, rms {rms_mm:.1?} mm, {blunders} blunders", of_rank.len());
        let worst = rms_mm.iter().copied().fold(f64::NAN, f64::max);
        lines.push(Row::at_most(format!("{name}, rank {rank}: rms of the worst component"), worst, 12.0, "mm"));
        let mean = good.iter().sum::<f64>() / good.len() as f64;
        lines.push(Row::between(format!("{name}, rank {rank}: mean of eᵀΣ⁻¹e without them"), mean, low, high, ""));
    }
    lines
}

/// Line 1: ties against the truth; pulses come at twice the rate of the scenario, 260 points in a square metre and scanner at the median.
#[allow(clippy::cast_precision_loss)]
pub(crate) fn accuracy() -> Result<Vec<Row>> {
    let mut all = Vec::new();
    let mut fewest = f64::INFINITY;
    for seed in 1..=seeds() {
        let folder = tempfile::tempdir()?;
        let denser = |t: String| t.replace("pulse_rate_hz = 25_000.0", "pulse_rate_hz = 50_000.0");
        let project = asked(&simulate("loop113", seed, folder.path(), denser)?, "[\"texture\"]")?;
        let (found, doubly_m) = judged(&project, &folder.path().join("data"), &folder.path().join("out"))?;
        let count = |rank: usize| {
            let of_rank = found.iter().filter(|j| j.passes && j.rank() >= rank);
            of_rank.map(|j| j.spot).collect::<BTreeSet<u32>>().len()
        };
        println!(
            "seed {seed}: {} ties, {} spots between passes on {doubly_m:.0} m, {} of them hold three directions",
            found.len(),
            count(2),
            count(3)
        );
        fewest = fewest.min(100.0 * count(2) as f64 / doubly_m);
        all.extend(found);
    }
    let (passes, scanners): (Vec<_>, Vec<_>) = all.into_iter().partition(|j| j.passes);
    let name = "loop113 at 50 kHz";
    let mut lines =
        vec![Row::at_least(format!("{name}: spots per 100 m of doubly driven road, fewest"), fewest, 20.0, "")];
    lines.extend(rows(&format!("{name}, pass to pass"), &passes));
    lines.extend(rows(&format!("{name}, scanner to scanner"), &scanners));
    lines.extend(independent()?);
    Ok(lines)
}

/// The drive of an independent simulator.
#[allow(clippy::cast_precision_loss)]
fn independent() -> Result<Vec<Row>> {
    let out = tempfile::tempdir()?;
    let source = std::fs::read_to_string(root().join("samples/real/mms-sim-block.toml"))?;
    let data = root().join("../shared/data/mms-sim-block");
    let file = out.path().join("block.toml");
    std::fs::write(&file, source.replace("../../../shared/data/mms-sim-block", text(&data)?))?;
    let project = asked(&file, "[\"texture\"]")?;
    let (found, doubly_m) = judged(&project, &data, &out.path().join("out"))?;
    let beyond = found.iter().filter(|j| j.error_m.amax() > 0.03).count() as f64;
    let mut lines = rows("mms-sim-block, texture", &found);
    println!("mms-sim-block: {} ties on {doubly_m:.0} m of doubly driven road", found.len());
    lines.push(Row::at_most("mms-sim-block: ties beyond 3 cm of the truth", beyond, 0.0, ""));
    Ok(lines)
}

/// Line 5: what looking for spots costs.
pub(crate) fn time() -> Result<Vec<Row>> {
    let folder = tempfile::tempdir()?;
    let plain = simulate("loop113", 1, folder.path(), |t| t)?;
    let auto = asked(&plain, "\"auto\"")?;
    let mut least = [f64::INFINITY; 2];
    for _ in 0..2 {
        for (project, least_s) in [&plain, &auto].into_iter().zip(&mut least) {
            let before_s = cpu::of_children_s();
            let arguments =
                ["match", "--quiet", "--out", text(&folder.path().join("out"))?, text(project)?].map(String::from);
            let ran = Command::new(program()?).args(&arguments).output()?;
            ensure!(ran.status.success(), "tieline match: {}", String::from_utf8_lossy(&ran.stderr));
            *least_s = least_s.min(cpu::of_children_s() - before_s);
        }
    }
    println!("tieline match of loop113: {:.2} s CPU, with xyz = \"auto\" {:.2} s", least[0], least[1]);
    Ok(vec![Row::at_most("match with xyz = \"auto\" over without, CPU", least[1] / least[0], 2.0, "")])
}

/// Line 6: each has a test.
pub(crate) fn false_ties() -> Result<Vec<Row>> {
    let arguments = ["test", "--quiet", "--release", "-p", "tieline-matching", "--test", "texture"];
    let good = Command::new("cargo").args(arguments).current_dir(root()).status()?.success();
    Ok(vec![Row::at_most("asphalt, shadow, zebra, grid: tests that fail", f64::from(u8::from(!good)), 0.0, "")])
}
