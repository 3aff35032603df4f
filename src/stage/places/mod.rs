//! Ties of places of two strips, which hold up to three directions: submaps, corners, ridges.

pub mod corners;
pub mod keep;
pub mod row;
mod submaps;

use std::collections::BTreeMap;

use anyhow::Result;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tieline_matching::xyz::TilePoints;
use tieline_matching::{Sighting, StripIndex, mix};

use crate::project::XyzWord;
use crate::settings::Settings;
use corners::FacePatches;

/// What a tie of places is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlaceKind {
    /// A tile registered by all its surfaces.
    Submap,
    /// Where two planes meet.
    Ridge,
    /// Where three planes meet.
    Corner,
}

impl PlaceKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Submap, Self::Ridge, Self::Corner];

    /// The word used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Submap => "submap",
            Self::Ridge => "ridge",
            Self::Corner => "corner",
        }
    }
}

/// Displacements of one place in both strips that a direction depends on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Derivative of the distance along the direction by the displacement of this place; over all parts the direction itself.
    pub along: Vector3<f64>,
    /// The place in each strip, local frame, before any correction \[m\].
    pub points_m: [Vector3<f64>; 2],
    /// Survey times of both \[s\].
    pub time_s: [f64; 2],
}

/// One direction of a tie, independent of its others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Direction {
    /// Unit vector in map axes.
    pub direction: Vector3<f64>,
    /// First less second place along it before any correction \[m\].
    pub distance_m: f64,
    /// Sigma of that distance \[m\].
    pub sigma_m: f64,
    /// What it depends on.
    pub parts: Vec<Part>,
}

/// Two places of two strips, or of two scanners, that are one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlaceTie {
    /// What it is of.
    pub kind: PlaceKind,
    /// Who saw both places.
    pub sightings: [Sighting; 2],
    /// Both places, local frame, before any correction \[m\]: where they are not known, as far apart as nothing.
    pub points_m: [Vector3<f64>; 2],
    /// Mean survey times \[s\].
    pub time_s: [f64; 2],
    /// Directions that it holds.
    pub directions: Vec<Direction>,
    /// Whether it judges the solution instead of taking part.
    pub held_out: bool,
    /// Why it is no tie.
    pub why_not: Option<String>,
}

impl PlaceTie {
    /// Number of directions held.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.directions.len()
    }
}

/// Ties of places of a survey, and what became of those that are none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Places {
    /// Ties, and pairs of places that are none but were measured.
    pub ties: Vec<PlaceTie>,
    /// Why places are no ties: by kind and reason.
    pub rejected: BTreeMap<String, u64>,
}

impl Places {
    /// Ties in use or held out, with their rows.
    pub fn in_use(&self) -> impl Iterator<Item = (usize, &PlaceTie)> {
        self.ties.iter().enumerate().filter(|(_, t)| t.why_not.is_none())
    }

    fn reject(&mut self, kind: PlaceKind, why_not: &str) {
        *self.rejected.entry(format!("{}_{why_not}", kind.as_str())).or_default() += 1;
    }
}

/// Finds the ties of places that are asked for.
///
/// # Errors
/// When a temporary file cannot be read back.
pub fn find(
    points: Option<&TilePoints>,
    faces: Option<FacePatches>,
    strips: &StripIndex,
    settings: &Settings,
) -> Result<Places> {
    let mut places = Places::default();
    if let Some(points) = points.filter(|_| settings.xyz.contains(&XyzWord::Submap)) {
        submaps::find(points, strips, settings, &mut places)?;
    }
    if let Some(faces) = faces {
        corners::find(faces, strips, &mut places);
    }
    for tie in places.ties.iter_mut().filter(|t| t.why_not.is_none()) {
        tie.held_out = is_held_out(tie, settings);
    }
    Ok(places)
}

/// By place and by the pair of strips, by a seeded hash.
#[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss, clippy::cast_sign_loss)]
fn is_held_out(tie: &PlaceTie, settings: &Settings) -> bool {
    const SQUARE_M: f64 = 50.0;
    let square = |v: f64| (v / SQUARE_M).floor() as i64 as u64;
    let pair = tie.sightings.iter().fold(0, |h, s| mix(h ^ (u64::from(s.strip) << 16 | u64::from(s.scanner))));
    let hash = mix(mix(square(tie.points_m[0].x) ^ settings.seed.rotate_left(32)) ^ square(tie.points_m[0].y) ^ pair);
    (hash as f64 / u64::MAX as f64) < settings.hold_out
}
