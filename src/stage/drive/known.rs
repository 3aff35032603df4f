//! A calibration found before, taken as known: `calibrate.known`.
//!
//! `[platform]` of a project says what the strips were made with. `calibration.toml` of an earlier run, of this drive or another with the same
//! scanners, says what is known better; the difference goes into every sighting before the adjustment, which estimates what may still be
//! missing, or nothing.

use std::path::{Path, PathBuf};

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::constants::{Beam, Term};
use super::curve::RangeSpline;
use super::over::{self, Over, OverCurve, Target};
use crate::project::{PlatformSection, Project, ScannerSection};

/// What is known of a scanner against the platform that the strips were made with.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Known {
    /// Rotation vector in the body frame, on the left of the mounting \[rad\].
    pub boresight_rad: Vector3<f64>,
    /// Added to the lever arm, body frame \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// True time less stamp \[s\].
    pub latency_s: f64,
    /// Range corrections, to be added: splines and coefficients \[m\].
    pub ranges: Vec<(RangeSpline, Vec<f64>)>,
    /// Those over incidence and intensity.
    pub over: Vec<OverCurve>,
}

impl Known {
    /// The beam with the known calibration in its body vector; `lever_arm_m` is that of the platform.
    #[must_use]
    pub fn applied(&self, beam: &Beam, lever_arm_m: &Vector3<f64>) -> Beam {
        let turned = Rotation3::new(self.boresight_rad);
        let ray_m = turned * (beam.body_vector_m - lever_arm_m);
        let target = Target { normal_body: turned * beam.target.normal_body, ..beam.target };
        let longer = |ray_m: &Vector3<f64>, range_m: f64| {
            let of_range: f64 = self.ranges.iter().map(|(spline, c)| spline.at(c, range_m)).sum();
            of_range + over::longer_m(&self.over, &target, ray_m)
        };
        let longer_m = beam.patch.mean_m(&ray_m, longer);
        let moved = (beam.velocity_body_mps + beam.rate_body_radps.cross(&beam.body_vector_m)) * self.latency_s;
        Beam { body_vector_m: lever_arm_m + self.lever_arm_m + ray_m + longer_m + moved, target, ..*beam }
    }
}

/// Beyond these a calibration is none: lever arms \[m\], latencies \[s\], range corrections \[m\].
const MOST_LEVER_ARM_M: f64 = 100.0;
const MOST_LATENCY_S: f64 = 1.0;
const MOST_RANGE_M: f64 = 1.0;

/// Why a calibration cannot be taken as known.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KnownError {
    /// Cannot be read.
    #[error("calibrate.known {}: cannot be read: {source}", path.display())]
    Read {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not a calibration.
    #[error("calibrate.known {}: {message}give the calibration.toml of a drive", path.display())]
    Parse {
        /// File.
        path: PathBuf,
        /// Line, caret and cause.
        message: String,
    },
    /// A scanner of the strips is not in it.
    #[error(
        "calibrate.known {}: scanner {scanner} is missing; it has {found:?}: give the calibration of this vehicle",
        path.display()
    )]
    Scanner {
        /// File.
        path: PathBuf,
        /// Which.
        scanner: u16,
        /// Those that it has.
        found: Vec<u16>,
    },
    /// A number that cannot be right.
    #[error("calibrate.known {}: {key} of scanner {scanner} is {value:?}: {due}", path.display())]
    Value {
        /// File.
        path: PathBuf,
        /// Which.
        scanner: u16,
        /// Key.
        key: &'static str,
        /// What stands there.
        value: Vec<f64>,
        /// What is to stand there.
        due: &'static str,
    },
    /// A range correction that cannot be right.
    #[error("calibrate.known {}: the range correction of scanner {scanner} {what}", path.display())]
    Range {
        /// File.
        path: PathBuf,
        /// Which.
        scanner: u16,
        /// What is wrong.
        what: &'static str,
    },
}

/// `calibration.toml`, as far as it is taken.
#[derive(Deserialize)]
struct File {
    platform: PlatformSection,
    #[serde(default)]
    latency: Vec<Latency>,
    #[serde(default)]
    range_correction: Vec<RangeCorrection>,
    #[serde(default)]
    range_correction_over: Vec<CorrectionOver>,
}

#[derive(Deserialize)]
struct Latency {
    scanner: u16,
    latency_s: f64,
}

#[derive(Deserialize)]
struct RangeCorrection {
    scanner: u16,
    first_m: f64,
    last_m: f64,
    coefficients_m: Vec<f64>,
}

#[derive(Deserialize)]
struct CorrectionOver {
    scanner: u16,
    over: Over,
    first: f64,
    last: f64,
    coefficients_m: Vec<f64>,
}

/// What is known of each scanner of the platform by its id, nothing where the project names no calibration.
///
/// # Errors
/// File, scanner and remedy.
pub fn load(project: &Project) -> Result<Vec<Known>, KnownError> {
    let Some(path) = &project.calibrate.known else { return Ok(Vec::new()) };
    let path = project.resolve(path);
    let text = std::fs::read_to_string(&path).map_err(|source| KnownError::Read { path: path.clone(), source })?;
    parse(&text, &path, project)
}

/// What the text of a `calibration.toml` says beyond the platform of a project; `path` is named in errors.
///
/// # Errors
/// File, scanner and remedy.
pub fn parse(text: &str, path: &Path, project: &Project) -> Result<Vec<Known>, KnownError> {
    let file: File = toml::from_str(text)
        .map_err(|error| KnownError::Parse { path: path.to_path_buf(), message: error.to_string() })?;
    let is_taken = |term: Term| project.calibrate.known_terms.iter().any(|t| t.term() == term);
    let scanners = project.platform.scanner.iter().map(|s| usize::from(s.id) + 1).max().unwrap_or(0);
    (0..scanners)
        .map(|scanner| {
            let id = u16::try_from(scanner).unwrap_or(u16::MAX);
            let of = |platform: &PlatformSection| platform.scanner.iter().find(|s| s.id == id).cloned();
            let Some(nominal) = of(&project.platform) else { return Ok(Known::default()) };
            let known = of(&file.platform).ok_or_else(|| KnownError::Scanner {
                path: path.to_path_buf(),
                scanner: id,
                found: file.platform.scanner.iter().map(|s| s.id).collect(),
            })?;
            let latency_s = file.latency.iter().find(|l| l.scanner == id).map_or(0.0, |l| l.latency_s);
            let limited = |key, value: &[f64], limit: f64, due| {
                let is_right = value.iter().all(|v| v.abs() <= limit); // not so for what is no number
                is_right.then_some(()).ok_or_else(|| KnownError::Value {
                    path: path.to_path_buf(),
                    scanner: id,
                    key,
                    value: value.to_vec(),
                    due,
                })
            };
            limited("lever_arm_m", &known.lever_arm_m, MOST_LEVER_ARM_M, "metres on a vehicle are due")?;
            limited("mounting_deg", &known.mounting_deg, 360.0, "degrees within a turn are due")?;
            limited("boresight_deg", &known.boresight_deg, 360.0, "degrees within a turn are due")?;
            limited("latency_s", &[latency_s], MOST_LATENCY_S, "seconds, less than one, are due")?;
            let turned = body_from_scanner(&known) * body_from_scanner(&nominal).inverse();
            let wrong = |what| KnownError::Range { path: path.to_path_buf(), scanner: id, what };
            let check = |coefficients_m: &[f64]| match coefficients_m.iter().all(|c| c.abs() <= MOST_RANGE_M) {
                true => Ok(()),
                false => Err(wrong("holds a coefficient that is not a number, or beyond a metre")),
            };
            let curve = |r: &RangeCorrection| {
                check(&r.coefficients_m)?;
                let spline = RangeSpline::of_coefficients(r.first_m, r.last_m, r.coefficients_m.len())
                    .ok_or_else(|| wrong("needs 0 < first_m < last_m and four coefficients or more"))?;
                Ok((spline, r.coefficients_m.clone()))
            };
            let curve_over = |r: &CorrectionOver| {
                check(&r.coefficients_m)?;
                let spline = r.over.spline_of(r.first, r.last, r.coefficients_m.len()).ok_or_else(|| {
                    wrong("over incidence or intensity needs first < last on its scale and four coefficients or more")
                })?;
                Ok(OverCurve { over: r.over, spline, coefficients_m: r.coefficients_m.clone() })
            };
            let over = file.range_correction_over.iter().filter(|r| r.scanner == id && is_taken(r.over.term()));
            let curves = file.range_correction.iter().filter(|r| r.scanner == id && is_taken(Term::Range));
            Ok(Known {
                boresight_rad: if is_taken(Term::Boresight) { turned.scaled_axis() } else { Vector3::zeros() },
                lever_arm_m: if is_taken(Term::LeverArm) {
                    Vector3::from(known.lever_arm_m) - Vector3::from(nominal.lever_arm_m)
                } else {
                    Vector3::zeros()
                },
                latency_s: if is_taken(Term::Latency) { latency_s } else { 0.0 },
                ranges: curves.map(curve).collect::<Result<_, _>>()?,
                over: over.map(curve_over).collect::<Result<_, _>>()?,
            })
        })
        .collect()
}

fn body_from_scanner(scanner: &ScannerSection) -> UnitQuaternion<f64> {
    let [roll, pitch, yaw] = scanner.mounting_deg.map(f64::to_radians);
    UnitQuaternion::new(Vector3::from(scanner.boresight_deg).map(f64::to_radians))
        * UnitQuaternion::from_euler_angles(roll, pitch, yaw)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::project::parse_str;
    use crate::stage::drive::constants::Spread;

    const PLATFORM: &str = "[platform]\n[[platform.scanner]]\nid = 0\nlever_arm_m = [1.0, 0.2, -0.3]\nmounting_deg = [0.0, 20.0, 135.0]\n\
                            boresight_deg = [0.1, 0.0, 0.0]\n";

    fn project(more: &str) -> Project {
        parse_str(&format!("[[strips]]\npath = \"*.laz\"\n[imu]\npath = \"imu.txt\"\ngrade = \"ap60\"\n{PLATFORM}[calibrate]\nknown = \"c.toml\"\n{more}"))
            .expect("a project")
    }

    /// A beam of the first scanner that meets an upright surface, at 10 m/s in a gentle turn.
    pub(in super::super) fn beam() -> Beam {
        Beam {
            scanner: 0,
            body_vector_m: Vector3::new(4.0, -3.0, 2.0),
            velocity_body_mps: Vector3::new(10.0, 0.0, 0.0),
            rate_body_radps: Vector3::new(0.0, 0.0, 0.2),
            patch: Spread::default(),
            target: Target { normal_body: Vector3::new(-0.6, 0.8, 0.0), intensity: 900.0 },
        }
    }

    #[test]
    fn the_platform_itself_changes_nothing() {
        let known = parse(PLATFORM, Path::new("c.toml"), &project("")).expect("known");
        let l = known[0].applied(&beam(), &Vector3::new(1.0, 0.2, -0.3)).body_vector_m;
        assert!((l - beam().body_vector_m).norm() < 1e-14, "{l}");
    }

    #[test]
    fn every_term_moves_the_beam_as_its_equation_says_and_only_when_it_is_taken() {
        let file = "[platform]\n[[platform.scanner]]\nid = 0\nlever_arm_m = [1.1, 0.2, -0.3]\nmounting_deg = [0.0, 20.0, 135.0]\n\
                    boresight_deg = [0.1, 0.0, 0.0]\n[[latency]]\nscanner = 0\nlatency_s = 0.001\n\
                    [[range_correction]]\nscanner = 0\nfirst_m = 2.0\nlast_m = 20.0\ncoefficients_m = [0.004, 0.004, 0.004, 0.004]\n\
                    [[range_correction_over]]\nscanner = 0\nover = \"incidence\"\nfirst = 0.0\nlast = 80.0\ncoefficients_m = [0.001, 0.001, 0.001, 0.001]\n\
                    [[range_correction_over]]\nscanner = 0\nover = \"intensity\"\nfirst = 10.0\nlast = 9000.0\ncoefficients_m = [0.002, 0.002, 0.002, 0.002]\n";
        let moved = |more: &str| {
            let known = parse(file, Path::new("c.toml"), &project(more)).expect("known");
            known[0].applied(&beam(), &Vector3::new(1.0, 0.2, -0.3)).body_vector_m - beam().body_vector_m
        };
        let ray = beam().body_vector_m - Vector3::new(1.0, 0.2, -0.3);
        let arm = Vector3::new(0.1, 0.0, 0.0);
        let latency = (Vector3::new(10.0, 0.0, 0.0) + Vector3::new(0.0, 0.0, 0.2).cross(&beam().body_vector_m)) * 0.001;
        let range = ray.normalize() * 0.004;
        for (more, expected) in [
            ("", arm + latency + range * 1.75),
            ("known_terms = [\"lever_arm\"]\n", arm),
            ("known_terms = [\"latency\"]\n", latency),
            ("known_terms = [\"range\"]\n", range),
            ("known_terms = [\"incidence\"]\n", range * 0.25),
            ("known_terms = [\"intensity\"]\n", range * 0.5),
            ("known_terms = []\n", Vector3::zeros()),
        ] {
            assert!((moved(more) - expected).norm() < 1e-12, "{more}: {} {expected}", moved(more));
        }
    }

    #[test]
    fn what_cannot_be_taken_is_named() {
        let refuse = |text: &str, word: &str| {
            let error = parse(text, Path::new("c.toml"), &project("")).expect_err("refused").to_string();
            assert!(error.contains("c.toml") && error.contains(word), "{error}");
        };
        refuse("[platform]\n", "scanner 0 is missing");
        refuse("nothing = 1\n", "platform");
        let with = |coefficients: &str, last: &str| {
            format!(
                "{PLATFORM}[[range_correction]]\nscanner = 0\nfirst_m = 2.0\nlast_m = {last}\ncoefficients_m = {coefficients}\n"
            )
        };
        refuse(&with("[0.0, 0.0]", "20.0"), "four coefficients");
        refuse(&with("[0.0, 0.0, 0.0, nan]", "20.0"), "not a number");
        refuse(&with("[0.0, 0.0, 0.0, 0.0]", "1.0"), "first_m < last_m");
        refuse(&with("[0.0, 0.0, 0.0, 1e9]", "20.0"), "beyond a metre");
        let over = |over: &str, last: &str, coefficients: &str| {
            format!(
                "{PLATFORM}[[range_correction_over]]\nscanner = 0\nover = \"{over}\"\nfirst = 2.0\nlast = {last}\ncoefficients_m = {coefficients}\n"
            )
        };
        refuse(&over("incidence", "95.0", "[0.0, 0.0, 0.0, 0.0]"), "first < last on its scale");
        refuse(&over("intensity", "1.0", "[0.0, 0.0, 0.0, 0.0]"), "first < last on its scale");
        refuse(&over("intensity", "9.0", "[0.0, 0.0, 0.0, inf]"), "beyond a metre");
        refuse(&over("colour", "9.0", "[0.0, 0.0, 0.0, 0.0]"), "colour");
        refuse(&PLATFORM.replace("[1.0, 0.2", "[nan, 0.2"), "lever_arm_m of scanner 0 is [NaN");
        refuse(&PLATFORM.replace("135.0]", "inf]"), "mounting_deg");
        refuse(&PLATFORM.replace("[0.1, 0.0, 0.0]", "[1e300, 0.0, 0.0]"), "boresight_deg");
        refuse(&format!("{PLATFORM}[[latency]]\nscanner = 0\nlatency_s = 1e12\n"), "latency_s");
    }

    /// All that a file may hold.
    const WHOLE: &str = "[platform]\n[[platform.scanner]]\nid = 0\nlever_arm_m = [1.1, 0.2, -0.3]\nmounting_deg = [0.0, 20.0, 135.0]\n\
                         boresight_deg = [0.1, 0.0, 0.0]\n[[latency]]\nscanner = 0\nlatency_s = 0.001\n[[range_correction]]\nscanner = 0\n\
                         first_m = 2.0\nlast_m = 20.0\ncoefficients_m = [0.004, 0.004, 0.004, 0.004]\n[[range_correction_over]]\nscanner = 0\nover = \"intensity\"\n\
                         first = 10.0\nlast = 9000.0\ncoefficients_m = [0.002, 0.002, 0.002, 0.002]\n";

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(4000))]

        /// Pieces put in place of others: no panic, and what is taken moves a beam to a place that is a number.
        #[test]
        fn no_text_makes_a_panic_or_a_place_that_is_no_number(
            edits in proptest::collection::vec(
                (0..WHOLE.len(), 0..12_usize, "nan|inf|-inf|1e300|-1e-300|0|-1|4294967296|[\\[\\]=,.\"\n0-9a-z_-]{0,6}"),
                0..5,
            ),
        ) {
            let mut text = String::from(WHOLE);
            for (at, length, piece) in &edits {
                let from = (*at).min(text.len());
                text.replace_range(from..(from + length).min(text.len()), piece);
            }
            if let Ok(known) = parse(&text, Path::new("c.toml"), &project("")) {
                for one in &known {
                    let moved = one.applied(&beam(), &Vector3::new(1.0, 0.2, -0.3)).body_vector_m;
                    proptest::prop_assert!(moved.iter().all(|v| v.is_finite()), "{one:?} {text}");
                }
            }
        }
    }
}
