//! Tie observations: what matching emits and every estimator consumes.
//!
//! A tie end holds the body vector from the IMU to the feature and nothing that depends on the trajectory the
//! cloud was made with, so that any estimator can place the feature from its own trajectory.

use nalgebra::{Matrix3, Vector3};

/// What a tie is, by the words of the glossary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TieKind {
    /// A 1-D observation along the common normal of a plane seen twice or more.
    SurfaceLine,
    /// Two rows orthogonal to a line.
    Line,
    /// A 3-D tie.
    XyzPoint,
    /// A surface line between the two scanners of one drive, a second or less apart.
    Increment,
    /// A pose-to-pose link from two matched submaps.
    Submap,
    /// A surface or point known beforehand.
    Control,
}

impl TieKind {
    /// The name used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::SurfaceLine => "surface_line",
            Self::Line => "line",
            Self::XyzPoint => "xyz_point",
            Self::Increment => "increment",
            Self::Submap => "submap",
            Self::Control => "control",
        }
    }

    /// Rows of one sighting; `None` where that is not one number for the kind.
    #[must_use]
    pub fn rank(self) -> Option<usize> {
        match self {
            Self::SurfaceLine | Self::Increment => Some(1),
            Self::Line => Some(2),
            Self::XyzPoint => Some(3),
            Self::Submap | Self::Control => None,
        }
    }
}

/// What a tie of a drive binds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub enum TieClass {
    /// Two visits of one strip.
    PassToPass,
    /// Two scanners in one visit.
    ScannerToScanner,
    /// Two strips.
    StripToStrip,
}

impl TieClass {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::PassToPass, Self::ScannerToScanner, Self::StripToStrip];

    /// The words used in reports and tables.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::PassToPass => "pass to pass",
            Self::ScannerToScanner => "scanner to scanner",
            Self::StripToStrip => "strip to strip",
        }
    }

    /// The same as one word, for files whose fields blanks separate.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::PassToPass => "pass_to_pass",
            Self::ScannerToScanner => "scanner_to_scanner",
            Self::StripToStrip => "strip_to_strip",
        }
    }
}

/// One end of a tie: one sighting of the feature.
#[derive(Debug, Clone, PartialEq)]
pub struct TieEnd {
    /// Index of the strip in the survey's list.
    pub strip: u32,
    /// Visit of the strip to this place, from 0.
    pub pass: u16,
    /// Scanner on the platform, 0-based.
    pub scanner: u16,
    /// Survey time \[s\].
    pub time_s: f64,
    /// From the IMU to the feature, in the body frame \[m\].
    pub body_vector_m: Vector3<f64>,
    /// From the scanner to the feature \[m\].
    pub range_m: f64,
    /// Angle between the beam and the normal \[rad\].
    pub incidence_rad: f64,
    /// Mean intensity.
    pub intensity: f64,
    /// The feature as this end saw it, map frame \[m\].
    pub map_m: Vector3<f64>,
    /// Points behind the sighting.
    pub points: u32,
    /// Covariance of the feature as this end saw it, map axes \[m²\]; along the normal for a surface line.
    pub covariance_m2: Matrix3<f64>,
}

/// A tie: two or more sightings of one feature (or one sighting and known coordinates).
#[derive(Debug, Clone, PartialEq)]
pub struct TieObservation {
    /// Number of the tie, unique in a survey.
    pub id: u64,
    /// What it is.
    pub kind: TieKind,
    /// Unit normal of a surface line in map axes; zero for point ties.
    pub normal: Vector3<f64>,
    /// Its ends.
    pub ends: Vec<TieEnd>,
}
