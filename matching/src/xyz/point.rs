//! Points and lines that several sightings have: what texture, corners, poles and people find, in one shape.

use nalgebra::{Matrix3, Vector3};

/// How a point was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum XyzKind {
    /// By the brightness of pavement.
    Texture,
    /// Where two walls and the ground meet, or two walls.
    Corner,
    /// By the trunk or the post that stands there.
    Pole,
    /// By a person.
    Picked,
}

impl XyzKind {
    /// The word used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Texture => "texture",
            Self::Corner => "corner",
            Self::Pole => "pole",
            Self::Picked => "picked",
        }
    }
}

/// A point as one sighting has it.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct XyzEnd {
    /// Strip.
    pub strip: u32,
    /// Scanner, by its place among those of the survey.
    pub scanner: u16,
    /// When the scan passed it \[s\].
    pub time_s: f64,
    /// The place, local frame \[m\].
    pub place_m: Vector3<f64>,
    /// What the sighting's own noise makes of it \[m²\]. It says nothing along what is free.
    pub covariance_m2: Matrix3<f64>,
    /// Unit normal of the surface there, local frame.
    pub normal: Vector3<f64>,
    /// Points behind it.
    pub points: u32,
    /// Mean intensity of the points about it, as in the file.
    pub intensity: f64,
}

/// A point, or a line where one direction is free, with its sightings.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct XyzPoint {
    /// How it was found.
    pub kind: XyzKind,
    /// Its name, where a person gave one.
    pub name: Option<String>,
    /// The unit vector along which nothing is known, local frame; none where all directions are held.
    pub free: Option<Vector3<f64>>,
    /// Sightings: two or more, or one and more where the point is known.
    pub ends: Vec<XyzEnd>,
    /// Where it is known to be, local frame \[m\], and how well \[m²\].
    pub known: Option<(Vector3<f64>, Matrix3<f64>)>,
}

impl XyzPoint {
    /// Unit vectors that it holds, at right angles to each other: see [`held_beside`].
    #[must_use]
    pub fn held(&self) -> Vec<Vector3<f64>> {
        held_beside(self.free)
    }
}

/// Unit vectors at right angles to what is free and to each other: east, north and up where nothing is; a level one and that across it, upwards, beside a free direction that lies or slopes;
/// two about level ones beside one that stands.
#[must_use]
pub fn held_beside(free: Option<Vector3<f64>>) -> Vec<Vector3<f64>> {
    /// Above, a direction stands: sine of its elevation.
    const STANDS: f64 = 0.9;
    match free {
        None => vec![Vector3::x(), Vector3::y(), Vector3::z()],
        Some(free) if free.z.abs() > STANDS => {
            let first = (Vector3::x() - free * free.x).normalize();
            vec![first, free.cross(&first) * free.z.signum()]
        }
        Some(free) => {
            let across = Vector3::new(-free.y, free.x, 0.0).normalize();
            vec![across, free.cross(&across)]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_held_stands_at_right_angles_to_what_is_free() {
        assert_eq!(held_beside(None).len(), 3);
        for free in [[0.8, 0.5, 0.06], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.1, -0.2, 0.97], [0.0, 1.0, 0.0]] {
            let free = Vector3::from(free).normalize();
            let held = held_beside(Some(free));
            assert_eq!(held.len(), 2);
            for d in &held {
                assert!((d.norm() - 1.0).abs() < 1e-12 && d.dot(&free).abs() < 1e-12, "{free} {d}");
            }
            assert!(held[0].dot(&held[1]).abs() < 1e-12);
        }
        // a line on the ground holds across and up, a pole both level directions
        assert!(held_beside(Some(Vector3::x()))[1].z > 0.999);
        assert!(held_beside(Some(Vector3::z())).iter().all(|d| d.z.abs() < 1e-12));
    }
}
