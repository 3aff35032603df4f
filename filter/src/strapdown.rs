//! Strapdown mechanisation in north, east, down over the ellipsoid.
//!
//! Two-sample coning and sculling (Savage, *Strapdown Inertial Navigation Integration Algorithm Design*, JGCD 21 (1998),
//! part 1 eq. 46 ff., part 2 eq. 53 ff.); earth rate, transport rate and gravity at the middle of the step, extrapolated
//! from the step before (Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems*, 2nd ed.,
//! sections 5.4 and 5.5).

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::earth::{
    earth_rate_ned_radps, meridian_radius_m, normal_gravity_mps2, prime_vertical_radius_m, transport_rate_ned_radps,
};
use crate::imu::ImuSample;

/// Position, velocity and attitude at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NavState {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Latitude \[rad\], longitude \[rad\], ellipsoidal height \[m\] of the IMU.
    pub geodetic: Vector3<f64>,
    /// North, east, down \[m/s\].
    pub velocity_ned_mps: Vector3<f64>,
    /// Rotation from body to north-east-down.
    pub ned_from_body: UnitQuaternion<f64>,
}

/// Errors of the IMU that are taken off its increments: measured = (1 + scale) true + bias.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImuErrors {
    /// Bias of the gyros \[rad/s\].
    pub gyro_bias_radps: Vector3<f64>,
    /// Bias of the accelerometers \[m/s²\].
    pub accelerometer_bias_mps2: Vector3<f64>,
    /// Scale error of the gyros.
    pub gyro_scale: Vector3<f64>,
    /// Scale error of the accelerometers.
    pub accelerometer_scale: Vector3<f64>,
}

impl ImuErrors {
    /// What lies on the way to others, 0 here and 1 there.
    #[must_use]
    pub fn towards(&self, other: &Self, share: f64) -> Self {
        Self {
            gyro_bias_radps: self.gyro_bias_radps.lerp(&other.gyro_bias_radps, share),
            accelerometer_bias_mps2: self.accelerometer_bias_mps2.lerp(&other.accelerometer_bias_mps2, share),
            gyro_scale: self.gyro_scale.lerp(&other.gyro_scale, share),
            accelerometer_scale: self.accelerometer_scale.lerp(&other.accelerometer_scale, share),
        }
    }
}

/// A part of a sample: increments free of the errors known, with what coning and sculling add.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Increment {
    /// Length \[s\].
    pub interval_s: f64,
    /// Increment of angle \[rad\], body axes.
    pub angle_rad: Vector3<f64>,
    /// Increment of velocity \[m/s\], body axes.
    pub velocity_mps: Vector3<f64>,
    /// Coning \[rad\].
    pub coning_rad: Vector3<f64>,
    /// Sculling \[m/s\].
    pub sculling_mps: Vector3<f64>,
}

impl Increment {
    /// A whole sample free of errors; coning and sculling from the sample before it.
    #[must_use]
    pub fn new(sample: &ImuSample, before: Option<&ImuSample>, interval_s: f64, errors: &ImuErrors) -> Self {
        let (angle_rad, velocity_mps) = free_of(sample, interval_s, errors);
        let (coning_rad, sculling_mps) = before.map_or((Vector3::zeros(), Vector3::zeros()), |before| {
            let (angle_before, velocity_before) = free_of(before, interval_s, errors);
            (
                angle_before.cross(&angle_rad) / 12.0,
                (angle_before.cross(&velocity_mps) + velocity_before.cross(&angle_rad)) / 12.0,
            )
        });
        Self { interval_s, angle_rad, velocity_mps, coning_rad, sculling_mps }
    }

    /// A share of it, 0 to 1, rates taken as constant.
    #[must_use]
    pub fn share(&self, share: f64) -> Self {
        Self {
            interval_s: self.interval_s * share,
            angle_rad: self.angle_rad * share,
            velocity_mps: self.velocity_mps * share,
            coning_rad: self.coning_rad * share,
            sculling_mps: self.sculling_mps * share,
        }
    }
}

fn free_of(sample: &ImuSample, interval_s: f64, errors: &ImuErrors) -> (Vector3<f64>, Vector3<f64>) {
    let one = Vector3::repeat(1.0);
    (
        (sample.angle_rad - errors.gyro_bias_radps * interval_s).component_div(&(one + errors.gyro_scale)),
        (sample.velocity_mps - errors.accelerometer_bias_mps2 * interval_s)
            .component_div(&(one + errors.accelerometer_scale)),
    )
}

/// Radii of curvature, gravity and rates where the platform is; they change so slowly that a few seconds share them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Locality {
    /// Meridian radius plus height \[m\].
    pub meridian_m: f64,
    /// Prime vertical radius plus height \[m\].
    pub prime_vertical_m: f64,
    /// Cosine and tangent of the latitude.
    pub cos_tan: (f64, f64),
    /// Normal gravity \[m/s²\].
    pub gravity_mps2: f64,
    /// Earth rate \[rad/s\].
    pub earth_rate_radps: Vector3<f64>,
    latitude_rad: f64,
    height_m: f64,
}

impl Locality {
    /// At a place.
    #[must_use]
    pub fn at(geodetic: &Vector3<f64>) -> Self {
        let (sin, cos) = geodetic.x.sin_cos();
        Self {
            meridian_m: meridian_radius_m(geodetic.x) + geodetic.z,
            prime_vertical_m: prime_vertical_radius_m(geodetic.x) + geodetic.z,
            cos_tan: (cos, sin / cos),
            gravity_mps2: normal_gravity_mps2(geodetic.x, geodetic.z),
            earth_rate_radps: earth_rate_ned_radps(geodetic.x),
            latitude_rad: geodetic.x,
            height_m: geodetic.z,
        }
    }

    /// Renews itself when the platform has moved by more than 10 m in latitude or 10 m in height.
    pub fn follow(&mut self, geodetic: &Vector3<f64>) {
        if (geodetic.x - self.latitude_rad).abs() > 1.5e-6 || (geodetic.z - self.height_m).abs() > 10.0 {
            *self = Self::at(geodetic);
        }
    }

    /// Normal gravity \[m/s²\] at a height near by.
    #[must_use]
    pub fn gravity_at_mps2(&self, height_m: f64) -> f64 {
        self.gravity_mps2 * (1.0 - 2.0 * (height_m - self.height_m) / self.meridian_m)
    }

    /// Transport rate \[rad/s\] at a velocity.
    #[must_use]
    pub fn transport_rate_radps(&self, velocity_ned_mps: &Vector3<f64>) -> Vector3<f64> {
        let (vn, ve) = (velocity_ned_mps.x, velocity_ned_mps.y);
        Vector3::new(ve / self.prime_vertical_m, -vn / self.meridian_m, -ve * self.cos_tan.1 / self.prime_vertical_m)
    }
}

/// What one step of the mechanisation passed through, for the linearised model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepTrace {
    /// Rotation from body to north-east-down at the middle of the step.
    pub ned_from_body: Matrix3<f64>,
    /// Integral of specific force, north-east-down \[m/s\].
    pub force_ned_mps: Vector3<f64>,
}

/// Moves the state over an increment.
pub fn advance(state: &mut NavState, increment: &Increment, locality: &mut Locality) -> StepTrace {
    let dt = increment.interval_s;
    locality.follow(&state.geodetic);
    let earth = locality.earth_rate_radps;
    let transport = locality.transport_rate_radps(&state.velocity_ned_mps);

    // velocity: rotation of the body within the step, sculling, rotation of the navigation frame by half the step
    let force_body =
        increment.velocity_mps + 0.5 * increment.angle_rad.cross(&increment.velocity_mps) + increment.sculling_mps;
    let from_body = *state.ned_from_body.to_rotation_matrix().matrix();
    let zeta = (earth + transport) * dt;
    let unturned = from_body * force_body;
    let force_ned = unturned - 0.5 * zeta.cross(&unturned);
    // Coriolis with the velocity of the middle of the step
    let gravity = Vector3::new(0.0, 0.0, locality.gravity_at_mps2(state.geodetic.z));
    let coriolis_rate = 2.0 * earth + transport;
    let first = gravity - coriolis_rate.cross(&state.velocity_ned_mps);
    let middle_velocity = state.velocity_ned_mps + 0.5 * (force_ned + first * dt);
    let velocity = state.velocity_ned_mps + force_ned + (gravity - coriolis_rate.cross(&middle_velocity)) * dt;

    // position by the mean velocity
    let mean = 0.5 * (state.velocity_ned_mps + velocity);
    state.geodetic.x += mean.x * dt / locality.meridian_m;
    state.geodetic.y += mean.y * dt / (locality.prime_vertical_m * locality.cos_tan.0);
    state.geodetic.z -= mean.z * dt;

    // attitude: body turns by angle and coning, navigation frame by earth and transport rate
    let turn = UnitQuaternion::from_scaled_axis(increment.angle_rad + increment.coning_rad);
    let frame = (earth + locality.transport_rate_radps(&mean)) * dt;
    let mut attitude = UnitQuaternion::from_scaled_axis(-frame) * state.ned_from_body * turn;
    attitude.renormalize_fast();
    let half = 0.5 * (increment.angle_rad + increment.coning_rad);
    let middle = from_body + from_body * half.cross_matrix();
    state.velocity_ned_mps = velocity;
    state.ned_from_body = attitude;
    state.time_s += dt;
    StepTrace { ned_from_body: middle, force_ned_mps: force_ned }
}

/// Rate of the navigation frame against the inertial one, north-east-down \[rad/s\].
#[must_use]
pub fn frame_rate_radps(state: &NavState) -> Vector3<f64> {
    earth_rate_ned_radps(state.geodetic.x) + transport_rate_ned_radps(&state.geodetic, &state.velocity_ned_mps)
}
