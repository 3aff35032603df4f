//! Ties of spots, and why a spot is none.

use nalgebra::{Matrix3, Vector3};

use crate::block::SourceKey;

/// Why a spot is not tied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum SpotRejection {
    /// One of the sightings does not see all sides of it.
    Support,
    /// It looks like its own surroundings.
    Repeated,
    /// Nothing like it within the search.
    NoneFound,
    /// Likest at the rim of the search.
    SearchRim,
    /// A second place looks nearly as much like it.
    Ambiguous,
    /// The peak has no minimum below a cell, or another contrast.
    NotConverged,
    /// Its place is not known well enough in some direction.
    Imprecise,
    /// Looked for from the other sighting it is found elsewhere.
    NotReciprocal,
    /// Another spot of a tile beside shares its window.
    Near,
    /// No plane, or one that the scan passed twice.
    NoPlane,
    /// Fewer than three others about it: nobody can judge it.
    Alone,
    /// It disagrees with the others about it.
    Neighbours,
}

impl SpotRejection {
    /// The word used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Support => "support",
            Self::Repeated => "repeated",
            Self::NoneFound => "none_found",
            Self::SearchRim => "search_rim",
            Self::Ambiguous => "ambiguous",
            Self::NotConverged => "not_converged",
            Self::Imprecise => "imprecise",
            Self::NotReciprocal => "not_reciprocal",
            Self::Near => "near",
            Self::NoPlane => "no_plane",
            Self::Alone => "alone",
            Self::Neighbours => "neighbours",
        }
    }
}

/// One end of a tie.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SpotEnd {
    /// Whose.
    pub source: SourceKey,
    /// When the scan passed the place \[s\].
    pub time_s: f64,
    /// The place, local frame \[m\].
    pub place_m: Vector3<f64>,
    /// Points behind its height and time.
    pub points: u32,
    /// Mean intensity of the points about it, as in the file.
    pub intensity: f64,
}

/// What a person looks at: both windows and the surface of the correlation, row by row from the south-west.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Picture {
    /// Cells along the edge of a window; 0 is a gap, 1 to 255 dark to bright.
    pub side: usize,
    /// Edge of a cell \[m\].
    pub cell_m: f64,
    /// Both windows, about the place where each sighting has the spot.
    pub windows: [Vec<u8>; 2],
    /// Cells along the edge of the surface.
    pub surface_side: usize,
    /// Correlation from 0 to 1 as 1 to 255; 0 where too little is seen.
    pub surface: Vec<u8>,
    /// The peak in the surface \[cells\].
    pub peak: [f64; 2],
}

/// A spot that was looked for in a second sighting.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SpotTie {
    /// Number of the spot: ties of one spot share the first sighting.
    pub spot: u32,
    /// As the first sighting has it, and as the second has.
    pub ends: [SpotEnd; 2],
    /// Covariance of the second place less the first \[m²\]. It says nothing along `free`.
    pub covariance_m2: Matrix3<f64>,
    /// The unit vector along the ground in which the place is not known, local frame; none where all directions are held.
    pub free: Option<Vector3<f64>>,
    /// Correlation at the peak.
    pub correlation: f64,
    /// That of the second peak.
    pub second: f64,
    /// Why it is no tie.
    pub rejection: Option<SpotRejection>,
    /// For the contact sheet.
    pub picture: Option<Picture>,
}

impl SpotTie {
    /// Second place less first \[m\].
    #[must_use]
    pub fn shift_m(&self) -> Vector3<f64> {
        self.ends[1].place_m - self.ends[0].place_m
    }

    /// Unit vectors that the tie holds, at right angles: east, north and up, or across the free direction and up from the ground.
    #[must_use]
    pub fn held(&self) -> Vec<Vector3<f64>> {
        match self.free {
            None => vec![Vector3::x(), Vector3::y(), Vector3::z()],
            Some(free) => {
                let across = Vector3::new(-free.y, free.x, 0.0).normalize();
                vec![across, free.cross(&across)]
            }
        }
    }

    /// Variance of the shift along a unit vector \[m²\].
    #[must_use]
    pub fn variance_along_m2(&self, direction: &Vector3<f64>) -> f64 {
        direction.dot(&(self.covariance_m2 * direction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_held_stands_at_right_angles_to_what_is_not() {
        let end = SpotEnd {
            source: SourceKey::new(0, 0, 0),
            time_s: 0.0,
            place_m: Vector3::zeros(),
            points: 1,
            intensity: 1.0,
        };
        let free = Vector3::new(0.8, 0.5, 0.06).normalize();
        let tie = SpotTie {
            spot: 0,
            ends: [end; 2],
            covariance_m2: Matrix3::from_diagonal(&Vector3::new(4.0, 1.0, 0.01)),
            free: Some(free),
            correlation: 1.0,
            second: 0.0,
            rejection: None,
            picture: None,
        };
        let held = tie.held();
        assert_eq!(held.len(), 2);
        for d in &held {
            assert!((d.norm() - 1.0).abs() < 1e-12 && d.dot(&free).abs() < 1e-12, "{d}");
        }
        assert!(held[0].dot(&held[1]).abs() < 1e-12 && held[0].z == 0.0 && held[1].z > 0.99);
        assert_eq!(SpotTie { free: None, ..tie.clone() }.held().len(), 3);
        assert!((tie.variance_along_m2(&Vector3::x()) - 4.0).abs() < 1e-12);
    }
}
