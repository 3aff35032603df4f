//! What aids the inertial measurements: GNSS, odometer, known points.

use nalgebra::{Matrix3, Vector3};

/// How a GNSS position came about, in RTKLIB's words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FixQuality {
    /// Ambiguities fixed.
    Fixed,
    /// Ambiguities float.
    Float,
    /// With satellite-based augmentation.
    Sbas,
    /// Code differential.
    Differential,
    /// Single point.
    Single,
    /// Precise point positioning.
    Ppp,
    /// The file does not say.
    Unknown,
}

/// A GNSS fix of the antenna.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssFix {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Latitude \[rad\], longitude \[rad\], ellipsoidal height \[m\].
    pub geodetic: Vector3<f64>,
    /// Covariance north, east, down \[m²\].
    pub covariance_ned_m2: Matrix3<f64>,
    /// Velocity north, east, down \[m/s\] with its covariance \[m²/s²\], where the file has it.
    pub velocity: Option<GnssVelocity>,
    /// How it came about.
    pub quality: FixQuality,
}

/// Velocity of a GNSS fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssVelocity {
    /// North, east, down \[m/s\].
    pub ned_mps: Vector3<f64>,
    /// Covariance north, east, down \[m²/s²\].
    pub covariance_m2ps2: Matrix3<f64>,
}

/// A reading of the odometer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometerSample {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Speed forward \[m/s\].
    pub speed_mps: f64,
}

/// A point of the platform whose place is known at a moment: a coordinate update.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownPoint {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Latitude \[rad\], longitude \[rad\], ellipsoidal height \[m\].
    pub geodetic: Vector3<f64>,
    /// Covariance north, east, down \[m²\].
    pub covariance_ned_m2: Matrix3<f64>,
    /// From the IMU to the point, body axes \[m\].
    pub body_vector_m: Vector3<f64>,
}
