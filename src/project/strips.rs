//! Sections of the project file on strips and their adjustment: `[[strips]]`, `[match]`, `[calibrate]`, `[solve]`, `[correct]`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use tieline_graph::CalibrationTerms;

use super::xyz::XyzChoice;
use crate::stage::drive::constants::Term;

/// `[[strips]]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StripsSection {
    /// File or pattern (`strips/*.laz`).
    pub path: String,
    /// What tells strips apart.
    #[serde(default)]
    pub split: SplitChoice,
    /// Longest gap in time within a strip \[s\].
    pub time_gap_s: Option<f64>,
    /// Where the number of the scanner stands.
    #[serde(default)]
    pub scanner: ScannerChoice,
    /// Whether these strips stay as they are.
    #[serde(default)]
    pub fixed: bool,
}

/// `split`: one word or a list of them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum SplitChoice {
    /// One.
    One(SplitWord),
    /// Several at once.
    Several(Vec<SplitWord>),
}

impl Default for SplitChoice {
    fn default() -> Self {
        Self::One(SplitWord::Auto)
    }
}

impl SplitChoice {
    /// Whether a word is among those chosen.
    #[must_use]
    pub fn has(&self, word: SplitWord) -> bool {
        match self {
            Self::One(w) => *w == word,
            Self::Several(words) => words.contains(&word),
        }
    }
}

/// What may tell strips apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SplitWord {
    /// By the values in the files.
    Auto,
    /// Each file is a strip or more.
    File,
    /// By point source id.
    PointSourceId,
    /// By gaps in GPS time.
    TimeGap,
}

/// `scanner`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScannerChoice {
    /// By the values in the files.
    #[default]
    Auto,
    /// One scanner.
    Single,
    /// LAS 1.4 scanner channel.
    Channel,
    /// User data.
    UserData,
    /// One file a scanner.
    File,
}

/// `[match]`: what is left out follows from the data.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MatchSection {
    /// Classes that take part; all but noise and water when left out.
    pub classes: Option<Vec<u8>>,
    /// Classes left out.
    pub exclude_classes: Option<Vec<u8>>,
    /// Returns that take part.
    pub returns: Option<ReturnsChoice>,
    /// Scanners that take part.
    pub scanners: Option<Vec<u16>>,
    /// Largest scan angle \[deg\].
    pub max_scan_angle_deg: Option<f32>,
    /// Nearest and farthest range \[m\].
    pub range_m: Option<[f64; 2]>,
    /// Largest angle between beam and normal of a surface \[deg\].
    pub max_incidence_deg: Option<f64>,
    /// Search area: west, south, east, north \[m\].
    pub area_m: Option<[f64; 4]>,
    /// Surfaces that take part; all when left out.
    pub surfaces: Option<Vec<SurfaceWord>>,
    /// XYZ points that are looked for in drives.
    pub xyz: XyzChoice,
    /// Width of the smallest patch \[m\] (taken to a power of two).
    pub patch_m: Option<f64>,
    /// How often the smallest patch may double.
    pub patch_levels: Option<u32>,
    /// Fewest points of a patch.
    pub min_points: Option<u32>,
    /// Largest standard deviation about the plane \[m\].
    pub max_roughness_m: Option<f64>,
    /// Largest distance between strips \[m\].
    pub search_m: Option<f64>,
    /// Largest angle between normals \[deg\].
    pub normal_angle_deg: Option<f64>,
    /// Least spacing of ties \[m\].
    pub min_spacing_m: Option<f64>,
    /// Least spacing of ties of one strip in time \[s\].
    pub min_spacing_s: Option<f64>,
    /// Most ties.
    pub max_ties: Option<usize>,
    /// Share of ties held out to judge the solution.
    pub hold_out: Option<f64>,
    /// Seed of the choice of held-out places.
    pub seed: Option<u64>,
    /// Drives: whether ties are measured again on the corrected cloud, and the adjustment made once more with them; so it is when left out.
    pub measure_again: Option<bool>,
}

/// `surfaces`: by the slope of their normal, whose height is 0.7 at 45°.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SurfaceWord {
    /// Ground and roofs up to 45°.
    Level,
    /// Façades, curb faces, walls.
    Steep,
}

impl SurfaceWord {
    /// The word for a surface by the height of its unit normal.
    #[must_use]
    pub fn of(normal_up: f64) -> Self {
        if normal_up.abs() > 0.7 { Self::Level } else { Self::Steep }
    }
}

/// `returns`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReturnsChoice {
    /// Single and last returns.
    Last,
    /// Single returns.
    Single,
    /// All returns.
    All,
}

/// `[calibrate]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateSection {
    /// Whether calibration terms are estimated at all.
    pub enabled: bool,
    /// Three boresight angles.
    pub boresight: bool,
    /// Three components of the lever arm.
    pub lever_arm: bool,
    /// Range offset.
    pub range_offset: bool,
    /// Range scale.
    pub range_scale: bool,
    /// What the range correction of a drive is over.
    pub range_over: Vec<RangeOver>,
    /// Latency of a scanner's stamps (drives).
    pub latency: bool,
    /// Calibration found before, taken as known (drives).
    pub known: Option<PathBuf>,
    /// Terms of it that are taken.
    pub known_terms: Vec<KnownTerm>,
    /// Prior sigma of each boresight angle \[deg\].
    pub boresight_sigma_deg: f64,
    /// Prior sigma of each lever arm component \[m\].
    pub lever_arm_sigma_m: f64,
    /// Prior sigma of the range offset \[m\].
    pub range_offset_sigma_m: f64,
    /// Prior sigma of the range scale \[ppm\].
    pub range_scale_sigma_ppm: f64,
}

/// `known_terms`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KnownTerm {
    /// Rotation of a scanner.
    Boresight,
    /// Place of a scanner.
    LeverArm,
    /// True time less stamp.
    Latency,
    /// Range correction.
    Range,
    /// Range correction over incidence.
    Incidence,
    /// Range correction over intensity.
    Intensity,
}

/// `range_over`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RangeOver {
    /// The range itself.
    Range,
    /// The angle between beam and normal.
    Incidence,
    /// The intensity.
    Intensity,
}

impl KnownTerm {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Boresight, Self::LeverArm, Self::Latency, Self::Range, Self::Incidence, Self::Intensity];

    /// The same among the constants of a drive.
    #[must_use]
    pub fn term(self) -> Term {
        match self {
            Self::Boresight => Term::Boresight,
            Self::LeverArm => Term::LeverArm,
            Self::Latency => Term::Latency,
            Self::Range => Term::Range,
            Self::Incidence => Term::Incidence,
            Self::Intensity => Term::Intensity,
        }
    }
}

impl Default for CalibrateSection {
    fn default() -> Self {
        Self {
            enabled: true,
            boresight: true,
            lever_arm: true,
            range_offset: true,
            range_scale: true,
            range_over: vec![RangeOver::Range],
            latency: true,
            known: None,
            known_terms: KnownTerm::ALL.to_vec(),
            boresight_sigma_deg: 0.1,
            lever_arm_sigma_m: 0.05,
            range_offset_sigma_m: 0.05,
            range_scale_sigma_ppm: 100.0,
        }
    }
}

impl CalibrateSection {
    /// Whether a drive's range correction over the range is estimated.
    #[must_use]
    pub fn has_range_curve(&self) -> bool {
        (self.range_offset || self.range_scale) && self.range_over.contains(&RangeOver::Range)
    }

    /// What is wrong with `range_over`, and what to do.
    pub(super) fn wrong_range_over(&self, is_drive: bool) -> Option<(String, &'static str)> {
        if self.range_over.is_empty() {
            let remedy = "name \"range\", \"incidence\", \"intensity\" or several of them, or leave it out";
            return Some((String::from("[]"), remedy));
        }
        let other = self.range_over.iter().find(|o| **o != RangeOver::Range && !is_drive)?;
        let value = format!("[.., \"{}\"]", format!("{other:?}").to_lowercase());
        Some((value, "corrections over incidence and intensity are for drives, which have [[strips]] and [imu]"))
    }

    /// The terms to estimate.
    #[must_use]
    pub fn terms(&self) -> CalibrationTerms {
        if !self.enabled {
            return CalibrationTerms::NONE;
        }
        CalibrationTerms {
            boresight: self.boresight,
            lever_arm: self.lever_arm,
            range_offset: self.range_offset,
            range_scale: self.range_scale,
        }
    }
}

/// `[solve]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SolveSection {
    /// Corrections of a strip over time; `auto` takes the most flexible that the held-out ties agree with.
    pub strips: StripModelChoice,
    /// Spacing of knots for `spline` \[s\].
    pub knot_spacing_s: Option<f64>,
    /// Prior sigma of strip positions, each axis \[m\]; the trajectory's accuracy when left out.
    pub position_sigma_m: Option<f64>,
    /// Prior sigma of strip attitudes, each axis \[deg\].
    pub attitude_sigma_deg: Option<f64>,
    /// Outer iterations: ties are measured anew after each.
    pub iterations: Option<usize>,
    /// Names of strips that stay as they are.
    pub fixed: Vec<String>,
}

/// `strips` in `[solve]`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StripModelChoice {
    /// As flexible as the held-out ties agree with.
    #[default]
    Auto,
    /// No strip corrections: calibration only.
    None,
    /// Constant.
    Constant,
    /// Constant and drift.
    Linear,
    /// Cubic spline.
    Spline,
}

/// `[correct]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CorrectSection {
    /// Scale of the output \[m\]; by the input's when left out.
    pub scale_m: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::project::parse_str;

    #[test]
    fn what_the_range_correction_is_over_is_looked_at() {
        let drive = "[[strips]]\npath = \"*.laz\"\n[imu]\npath = \"imu.txt\"\ngrade = \"ap60\"\n";
        let parsed = |first: &str, list: &str| parse_str(&format!("{first}[calibrate]\nrange_over = {list}\n"));
        assert_eq!(parse_str(drive).expect("a drive").calibrate.range_over, [RangeOver::Range]);
        let project = parsed(drive, "[\"range\", \"intensity\"]").expect("words");
        assert!(project.calibrate.has_range_curve() && project.calibrate.range_over.len() == 2);
        assert!(!parsed(drive, "[\"incidence\"]").expect("a word").calibrate.has_range_curve());
        let refuse = |first: &str, list: &str, words: &[&str]| {
            let message = parsed(first, list).expect_err("refused").to_string();
            assert!(words.iter().all(|w| message.contains(w)), "{message}");
        };
        refuse(drive, "[\"colour\"]", &["colour", "range", "incidence", "intensity", "line 7"]);
        refuse(drive, "[]", &["calibrate.range_over", "leave it out"]);
        refuse("[[strips]]\npath = \"*.laz\"\n", "[\"range\", \"incidence\"]", &["calibrate.range_over", "[imu]"]);
    }
}
