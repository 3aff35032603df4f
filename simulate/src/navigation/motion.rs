//! The true motion over the ellipsoid.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tieline_filter::NavState;
use tieline_filter::earth::{
    EARTH_RATE_RADPS, ecef_from_geodetic, geodetic_from_ecef, ned_from_ecef, normal_gravity_mps2,
};
use tieline_filter::ned_from_body;

use super::spline::Spline;

/// What an ideal IMU feels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyRates {
    /// Rotation against inertial space, body axes \[rad/s\].
    pub rotation_radps: Vector3<f64>,
    /// Specific force, body axes \[m/s²\].
    pub force_mps2: Vector3<f64>,
}

/// Position and attitude over time, smooth, in a frame that is fixed to the earth: axes north, east, down at an origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    origin_ecef_m: Vector3<f64>,
    ecef_from_local: Matrix3<f64>,
    position: Spline,
    roll_pitch_heading: Spline,
}

impl Motion {
    /// A motion about an origin (latitude \[rad\], longitude \[rad\], height \[m\]): positions \[m\] and roll, pitch,
    /// heading \[rad\] in the axes north, east, down of the origin.
    #[must_use]
    pub fn new(origin: &Vector3<f64>, position: Spline, roll_pitch_heading: Spline) -> Self {
        Self {
            origin_ecef_m: ecef_from_geodetic(origin),
            ecef_from_local: ned_from_ecef(origin.x, origin.y).transpose(),
            position,
            roll_pitch_heading,
        }
    }

    fn local_from_body(&self, time_s: f64) -> UnitQuaternion<f64> {
        let angles = self.roll_pitch_heading.at(time_s).value;
        ned_from_body(angles.x, angles.y, angles.z)
    }

    /// Position \[m\] and attitude in the axes north, east, down of the origin.
    #[must_use]
    pub fn local_pose(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        (self.position.at(time_s).value, self.local_from_body(time_s))
    }

    /// Earth-centred position \[m\].
    #[must_use]
    pub fn ecef_m(&self, time_s: f64) -> Vector3<f64> {
        self.origin_ecef_m + self.ecef_from_local * self.position.at(time_s).value
    }

    /// Rotation from body to earth-centred axes.
    #[must_use]
    pub fn ecef_from_body(&self, time_s: f64) -> Matrix3<f64> {
        self.ecef_from_local * self.local_from_body(time_s).to_rotation_matrix().matrix()
    }

    /// Velocity against the earth, body axes \[m/s\].
    #[must_use]
    pub fn velocity_body_mps(&self, time_s: f64) -> Vector3<f64> {
        self.local_from_body(time_s).inverse() * self.position.at(time_s).first
    }

    /// The pose at a time.
    #[must_use]
    pub fn nav_at(&self, time_s: f64) -> NavState {
        let geodetic = geodetic_from_ecef(&self.ecef_m(time_s));
        let ned_from_local = ned_from_ecef(geodetic.x, geodetic.y) * self.ecef_from_local;
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(ned_from_local);
        NavState {
            time_s,
            geodetic,
            velocity_ned_mps: ned_from_local * self.position.at(time_s).first,
            ned_from_body: UnitQuaternion::from_rotation_matrix(&rotation) * self.local_from_body(time_s),
        }
    }

    /// Rotation of the body against the earth, body axes \[rad/s\].
    #[must_use]
    pub fn rotation_against_earth_radps(&self, time_s: f64) -> Vector3<f64> {
        let jet = self.roll_pitch_heading.at(time_s);
        let (sr, cr) = jet.value.x.sin_cos();
        let (sp, cp) = jet.value.y.sin_cos();
        let d = jet.first;
        // Groves, 2nd ed., equation 2.58
        Vector3::new(d.x - sp * d.z, cr * d.y + sr * cp * d.z, -sr * d.y + cr * cp * d.z)
    }

    /// What an ideal IMU feels at a time.
    #[must_use]
    pub fn body_rates(&self, time_s: f64) -> BodyRates {
        let jet = self.position.at(time_s);
        let body_from_local = self.local_from_body(time_s).inverse();
        let geodetic = geodetic_from_ecef(&(self.origin_ecef_m + self.ecef_from_local * jet.value));
        let local_from_ecef = self.ecef_from_local.transpose();
        let earth = local_from_ecef * Vector3::new(0.0, 0.0, EARTH_RATE_RADPS);
        let down = ned_from_ecef(geodetic.x, geodetic.y).transpose() * Vector3::z();
        let gravity = local_from_ecef * down * normal_gravity_mps2(geodetic.x, geodetic.z);
        BodyRates {
            rotation_radps: self.rotation_against_earth_radps(time_s) + body_from_local * earth,
            force_mps2: body_from_local * (jet.second + 2.0 * earth.cross(&jet.first) - gravity),
        }
    }
}
